"""Reports of the trigger, which the firmware repeats until the watch ends (Klipper, trsync.c).

A report that was on the wire when the next motion began belongs to the motion before.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.api import home
from cnc.boards.klipper.guards import REPORT_S
from cnc.boards.klipper.layout import BY_HOST
from cnc.boards.klipper.protocol import Message
from cnc.simulators.klipper.klipper_simulator import Commands, KlipperSimulator
from cnc.simulators.klipper.ports import KlipperSimulatorPort, simulator_for
from tests.support.boards.homing_bench import small
from tests.support.boards.klipper_rig import (
    board,
    connected,
    count,
    end_level,
    machine,
    pins,
    place,
    with_board,
)
from tests.support.boards.stepper_rig import chunks, line
from tests.support.session.runs import run_with
from tests.support.soak import share

TRIGGER, PERIOD = 0, 1_200_000
EXPIRES, STOPS = 7, 9
LATENCIES = share(np.linspace(0.0, 0.03, 60).tolist(), [0.0225])
"""Delays of the cable in each direction, s. The worst USB serial adapters have 16 ms."""


class Reports:
    """A board with a trigger, and the reports that it sends."""

    def __init__(self) -> None:
        self.board = KlipperSimulator()
        self._commands = Commands(self.board)
        self.found: list[dict[str, object]] = []
        self.board.respond = self._respond  # type: ignore[method-assign]
        self.do("allocate_oids", count=1)
        self.do("config_trsync", oid=TRIGGER)
        self.do("finalize_config", crc=1)

    def do(self, name: str, **values: int) -> bool:
        return self._commands.carry_out(Message(name, values))

    def start(self, clock: int) -> None:
        values = {"report_clock": clock, "report_ticks": PERIOD, "expire_reason": EXPIRES}
        assert self.do("trsync_start", oid=TRIGGER, **values)

    def wait(self, periods: float) -> list[tuple[object, object]]:
        """Return ``can_trigger`` and ``trigger_reason`` of the reports in some periods."""
        self.found.clear()
        self.board.advance(self.board.now + periods * PERIOD / self.board.frequency)
        return self.take()

    def take(self) -> list[tuple[object, object]]:
        found = [(each["can_trigger"], each["trigger_reason"]) for each in self.found]
        self.found.clear()
        return found

    def _respond(self, name: str, **values: int | bytes) -> None:
        if name == "trsync_state":
            self.found.append(dict(values))


def test_reports_go_on_after_a_trigger_until_the_watch_ends() -> None:
    reports = Reports()
    reports.start(reports.board.clock)
    assert reports.do("trsync_set_timeout", oid=TRIGGER, clock=round(2.5 * PERIOD))
    # Two reports of the armed trigger, the trigger at its timeout, and two reports of it.
    assert reports.wait(4.2) == [(1, 0)] * 3 + [(0, EXPIRES)] * 3
    # A timeout is no more set, so one in the past is no fault.
    assert reports.do("trsync_set_timeout", oid=TRIGGER, clock=0)
    assert reports.wait(2.0) == [(0, EXPIRES)] * 2
    reports.do("trsync_trigger", oid=TRIGGER, reason=STOPS)
    # One answer, with the reason of the trigger and without a clock.
    assert reports.found[0]["clock"] == 0
    assert reports.take() == [(0, EXPIRES)]
    assert reports.wait(5.0) == []
    reports.start(reports.board.clock)
    assert reports.wait(1.5) == [(1, 0)] * 2
    reports.do("trsync_trigger", oid=TRIGGER, reason=STOPS)
    assert reports.take() == [(0, STOPS)]
    assert reports.wait(5.0) == []


def test_reports_that_begin_in_the_past_shut_the_board_down() -> None:
    reports = Reports()
    reports.wait(2.0)
    values = {"report_clock": 0, "report_ticks": PERIOD, "expire_reason": EXPIRES}
    assert not reports.do("trsync_start", oid=TRIGGER, **values)
    assert reports.board.reason == "Timer too close"


@pytest.mark.parametrize("mcu", share(["atmega328p", "rp2040"], ["rp2040"]))
@pytest.mark.parametrize("latency", LATENCIES)
def test_homing_with_a_slow_cable(mcu: str, latency: float) -> None:
    """Contacts, and the moves off the switches, which begin while reports are on the wire."""
    known = with_board(small(), mcu)
    simulator = simulator_for(known)
    simulator.cable.latency_s = latency
    places = {"x": -300, "y": -410, "z": 150}
    for letter, at in places.items():
        pin = getattr(pins(known), letter).endstop[0].strip("^!")
        end = (1 if at > 0 else -1, at)
        simulator.set_pin(pin, end_level(known, simulator, letter, end))
    driver = connected(known, simulator)
    assert home(known, (), board=driver) == {"x": 0.0, "y": -2.0, "z": 1.0}
    driver.close()
    for at, switch in zip(place(known, simulator), (-250, -360, 100), strict=True):
        assert abs(at - switch) <= 1
    seen = len(simulator.cable._up)
    simulator.advance(simulator.now + 10 * REPORT_S)
    assert len(simulator.cable._up) == seen


@pytest.mark.parametrize("latency", LATENCIES)
def test_probing_twice_with_a_slow_cable(latency: float, tmp_path: Path) -> None:
    known = machine()
    text = "G21 G90\nG38.2 X20 F300\nG38.4 X-4 F60\nG38.2 X20 F60\nG0 X1 Y0\nM2\n"
    (tmp_path / "p.ngc").write_text(text)
    simulator = simulator_for(known)
    simulator.cable.latency_s = latency
    probe = str(pins(known).probe).strip("^!")
    simulator.set_pin(probe, lambda: int(count(known, simulator, "x") < 1000))
    with board(known, simulator) as (driver, _):
        report = run_with(tmp_path / "p.ngc", known, board=driver)
    assert report.ok, report.faults
    assert place(known, simulator) == [400, 0, 0]


@pytest.mark.parametrize("latency", LATENCIES)
def test_next_program_ignores_the_reports_of_a_killed_one(latency: float, tmp_path: Path) -> None:
    """The board has stopped by its timeout, and says so until it is armed again."""
    known = machine()
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X1 Y1 F600\nM2\n")
    simulator = simulator_for(known)
    killed = connected(known, simulator)
    killed.start(np.zeros(3, np.int64))
    for part in chunks(*line(20_000, 100_000), 100):
        killed.send(part)
        if part.line[-1] >= 9000:
            break
    simulator.advance(simulator.now + 3.0)
    simulator.cable.latency_s = latency
    port = KlipperSimulatorPort(simulator)
    before = place(known, simulator)
    with board(known, simulator, port) as (driver, _):
        report = run_with(tmp_path / "p.ngc", known, board=driver)
    assert report.ok, report.faults
    moved = [b - a for a, b in zip(before, place(known, simulator), strict=True)]
    assert moved[2] == 0
    assert driver._supervisor._stop.trigger in (0, BY_HOST)
