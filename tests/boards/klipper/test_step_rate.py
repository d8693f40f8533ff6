"""Steps that are too fast for a microcontroller: refused by the check, and a shutdown if played."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cnc.boards.klipper import feasibility
from cnc.boards.klipper.driver import Klipper
from cnc.boards.klipper.feasibility import KlipperFeasibility, profile_of
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError, MotionLimitError
from cnc.model.streams import PulseChunk
from cnc.simulators.klipper.objects import Motor
from tests.support.boards.klipper_rig import board, machine, pins, played
from tests.support.boards.stepper_rig import chunks, line
from tests.support.soak import share

ROWS = 6000
FIRMWARE = [
    # (steps/s of an axis, axes, pulse us, switches, plays)
    (10_000, 3, 2.5, 4, True),
    (11_000, 3, 2.5, 4, True),
    (16_500, 2, 2.5, 4, True),
    (33_000, 1, 2.5, 4, True),
    (14_000, 3, 2.5, 4, False),
    (25_000, 2, 2.5, 4, False),
    (22_000, 3, 2.5, 0, True),
    (4_000, 3, 5.0, 4, True),
    (6_000, 2, 5.0, 4, True),
    (5_000, 3, 5.0, 4, False),
    (8_500, 2, 5.0, 4, False),
    (8_000, 3, 5.0, 0, True),
    (8_400, 3, 5.0, 0, False),
]
"""Motions that Klipper's firmware played, or shut down in, on a simulated ATmega328P of 16 MHz."""


def with_pulse(mcu: str, pulse_s: float, switches: int = 4) -> Machine:
    known = machine(mcu)
    changes: dict[str, Any] = {"step_pulse": pulse_s, "max_step_rate": 200_000.0}
    if not switches:
        axes: dict[str, Any] = {
            letter: getattr(pins(known), letter).model_copy(update={"endstop": None})
            for letter in known.axes
        }
        open_board = pins(known).model_copy(update={**axes, "emergency_stop": None})
        changes["klipper"] = open_board
    return known.model_copy(update={"board": known.board.model_copy(update=changes)})


def motion(rate: float, axes: int) -> Iterator[PulseChunk]:
    """Yield a motion of some axes in step: slow, then fast, then slow."""
    speed = np.clip(np.minimum(np.arange(ROWS), np.arange(ROWS)[::-1]) / 1500.0, 0.2, 1.0)
    time_ns = np.cumsum(np.rint(1e9 / (rate * speed)).astype(np.int64))
    step = np.zeros((ROWS, 3), np.int8)
    step[:, :axes] = 1
    return chunks(time_ns, step, 500)


def line_of(gap_ns: int) -> Iterator[PulseChunk]:
    return chunks(*line(ROWS, gap_ns, (1.0, 0.0, 0.0)), 500)


def check(known: Machine, parts: Iterable[PulseChunk]) -> KlipperFeasibility:
    found = KlipperFeasibility(known, profile_of(known))
    for part in parts:
        found.add(part)
    return found


def play(driver: Klipper, parts: Iterable[PulseChunk]) -> None:
    driver.start(np.zeros(3, np.int64))
    for part in parts:
        driver.send(part)
    driver.finish()


@pytest.mark.parametrize(("rate", "axes", "pulse_us", "switches", "plays"), FIRMWARE)
def test_step_rates_of_the_firmware(
    rate: float, axes: int, pulse_us: float, switches: int, plays: bool
) -> None:
    """Check and model agree with the firmware: samples of switches take half of an AVR's time."""
    known = with_pulse("atmega328p", pulse_us * 1e-6, switches)
    with board(known) as (driver, simulator):
        if plays:
            assert check(known, motion(rate, axes)).entries
            play(driver, motion(rate, axes))
            assert simulator.reason == ""
            return
        with pytest.raises(MotionLimitError, match="board-step-rate"):
            check(known, motion(rate, axes))
        with pytest.raises(BoardError, match="klipper-shutdown") as shut:
            play(driver, motion(rate, axes))
    assert "Rescheduled timer in the past" in shut.value.diagnostic.message


def turning(tolerance_us: float) -> Machine:
    """Return a machine with an ATmega328P whose two axes make up to 33 000 steps/s on a circle."""
    known = load_machine("klipper-uno")
    axes = {
        letter: axis.model_copy(
            update={
                "homing": None,
                "travel": (-900.0, 900.0),
                "steps_per_mm": 200.0,
                "max_velocity": 200.0,
                "max_acceleration": 4000.0,
                "max_jerk": 200_000.0,
            }
        )
        for letter, axis in known.axes.items()
    }
    pins = known.board.klipper
    assert pins is not None
    board = known.board.model_copy(
        update={
            "max_step_rate": 40_000.0,
            "step_pulse": 2.5e-6,
            "klipper": pins.model_copy(update={"tolerance_us": tolerance_us}),
        }
    )
    path = known.path.model_copy(update={"max_feed": 12_000.0})
    return known.model_copy(update={"axes": axes, "board": board, "path": path})


@pytest.mark.parametrize(("tolerance_us", "checked"), [(2.0, True), (1.5, True), (1.2, False)])
def test_messages_need_the_time_that_steps_leave(
    tolerance_us: float, checked: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Klipper's firmware on a simulated ATmega328P played 12 turns with 2 us.

    A smaller tolerance needs more moves: with 1.5 and 1.2 us it shut down, "Timer too close".
    """
    if not checked:
        monkeypatch.setattr(feasibility.KlipperFeasibility, "add", lambda _, chunk: None)
    turns = share(12, 4) * "G3 X30 Y0 I-30 J0\n"
    (tmp_path / "turns.ngc").write_text(f"G21 G90 G17\nG1 X30 F7000\n{turns}M2\n")
    known = turning(tolerance_us)
    report, simulator = played(tmp_path / "turns.ngc", tmp_path, known)
    found = [(fault.diagnostic.code, fault.diagnostic.message) for fault in report.faults]
    if tolerance_us == 2.0:
        assert found == []
        assert simulator.reason == ""
    elif checked:
        assert found[0][0] == "board-too-dense"
        assert "the processor of the board" in found[0][1]
        assert report.faults[0].diagnostic.line == 3
    else:
        assert found[0][0] == "klipper-shutdown"
        assert "Timer too close" in found[0][1]


def test_step_rate_of_a_fast_microcontroller() -> None:
    known = with_pulse("rp2040", 5e-6)
    with board(known) as (driver, simulator):
        assert check(known, motion(62_500, 1)).entries
        play(driver, motion(62_500, 1))
    assert simulator.reason == ""


def test_message_names_the_step_rate_of_the_board() -> None:
    """16 MHz (1 - 0.06 - 4 x 281 / 2400) / (2 x 313): messages, samples, both edges of a pulse."""
    with pytest.raises(MotionLimitError, match="the 12055 per second of the board"):
        check(with_pulse("atmega328p", 3e-6), motion(20_000, 1))


@pytest.mark.parametrize(("gap_ns", "fits"), [(10_000, True), (9_990, False)])
def test_pulses_of_an_axis_do_not_overlap(gap_ns: int, fits: bool) -> None:
    known = with_pulse("rp2040", 5e-6)
    if fits:
        assert check(known, line_of(gap_ns)).entries
        return
    with pytest.raises(MotionLimitError) as caught:
        check(known, line_of(gap_ns))
    assert caught.value.diagnostic.code == "board-step-rate"
    assert caught.value.diagnostic.line == 2
    assert "5 us and the pause after it take 10 us" in caught.value.diagnostic.message


@pytest.mark.parametrize(
    ("interval", "count", "add", "past"),
    [
        (10, 3, -4, False),  # 10, 6 and 2 ticks
        (10, 4, -4, True),  # and -2
        (10, 1, -40, False),
        (10, 2, -11, True),
        (0, 5, 3, False),
    ],
)
def test_intervals_below_zero_are_in_the_past(
    interval: int, count: int, add: int, past: bool
) -> None:
    motor = Motor(0, 1, 2, 0)
    assert motor.add(interval, count, add, 0) == ""
    assert bool(motor.past) == past
