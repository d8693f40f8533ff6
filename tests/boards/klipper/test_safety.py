"""Stops of the Klipper board: switches, e-stop, probe, silence, a slow host, shutdowns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.api import Control, run
from cnc.boards.klipper.driver import Klipper
from cnc.boards.klipper.sender import PIECE_S, RUN, ramp_seconds, stretched
from cnc.model.blocks import Spindle
from cnc.model.diagnostics import BoardError
from cnc.simulators.klipper.ports import KlipperSimulatorPort, simulator_for
from tests.support.boards.klipper_rig import (
    after,
    board,
    count,
    last_step,
    machine,
    pins,
    place,
    played,
    steps_of,
)
from tests.support.boards.stepper_rig import chunks, eased, line
from tests.support.soak import share

LONG = "G21 G90\nM3 S500\nG1 X30 Y20 F1500\nM2\n"
SWITCHES = [("stop", "board-emergency-stop"), ("x", "board-limit")]
STOP_S = 0.3e-3
"""Longest time from a switch to the last step."""
CLOSED = np.random.default_rng(1409).uniform(0.0, 0.9, share(20, 1)).tolist()
"""Times at which a switch closes, anywhere between two samples, s."""


@pytest.mark.parametrize(
    ("mcu", "key", "code"),
    [(mcu, *switch) for mcu in ("atmega328p", "rp2040", "stm32f446") for switch in SWITCHES][
        :: share(1, 3)
    ],
)
@pytest.mark.parametrize("moment", CLOSED[:: share(1, 2)])
def test_switches_stop_all_motors(
    mcu: str, key: str, code: str, moment: float, tmp_path: Path
) -> None:
    known = machine(mcu)
    (tmp_path / "p.ngc").write_text(LONG)
    text = pins(known).emergency_stop if key == "stop" else pins(known).x.endstop[0]  # type: ignore[index,union-attr]
    assert text is not None
    simulator, closed = simulator_for(known), []

    def close() -> None:
        closed.append(simulator.now + moment)
        simulator.set_pin(text.strip("^!"), lambda: int(simulator.now < closed[0]))

    after(simulator, 0.1, close)
    report, _ = played(tmp_path / "p.ngc", tmp_path, known, simulator)
    found = report.faults[0].diagnostic
    assert found.code == code
    assert found.line == 3
    assert 0.0 < last_step(simulator) - closed[0] + STOP_S <= 2 * STOP_S
    steps = known.steps_per_mm
    at = place(known, simulator)
    assert at[0] > 0
    assert [round(v * s) for v, s in zip(report.end_position.values(), steps, strict=True)] == at
    spindle = pins(known).spindle
    assert spindle is not None
    simulator.advance(simulator.now + 0.15)
    assert simulator.value(spindle.pin) == 0
    assert simulator.reason == ""


def test_pressed_e_stop_refuses_the_start() -> None:
    known = machine()
    with board(known) as (driver, simulator):
        simulator.set_pin(str(pins(known).emergency_stop).strip("^!"), 0)
        with pytest.raises(BoardError) as caught:
            driver.start(np.zeros(3, np.int64))
    assert caught.value.diagnostic.code == "board-emergency-stop"


def test_a_refused_jog_does_not_shorten_the_ramp_of_the_next_motion() -> None:
    known = machine()
    with board(known) as (driver, simulator):
        stop = str(pins(known).emergency_stop).strip("^!")
        simulator.set_pin(stop, 0)
        driver.prepare_jog(1.0)
        with pytest.raises(BoardError):
            driver.start(np.zeros(3, np.int64))
        simulator.set_pin(stop, 1)
        driver.start(np.zeros(3, np.int64))
        assert driver._sender.ramp_s == ramp_seconds(known) > ramp_seconds(known, 1.0)


PROBING = "G21 G90\nG38.{kind} X20 F300\nG1 X#5061 Y2 F600\nG0 X1 Y0\nM2\n"


@pytest.mark.parametrize("kind", share([2, 3], [3]))
def test_probe_position_is_exact_to_a_step(kind: int, tmp_path: Path) -> None:
    """The probe closes at 1000 steps; at 2 steps a millisecond it is seen within a step."""
    known = machine()
    (tmp_path / "p.ngc").write_text(PROBING.format(kind=kind))
    simulator = simulator_for(known)
    probe = str(pins(known).probe).strip("^!")
    simulator.set_pin(probe, lambda: int(count(known, simulator, "x") < 1000))
    report, _ = played(tmp_path / "p.ngc", tmp_path, known, simulator)
    assert report.ok, report.faults
    x = np.cumsum(steps_of(known, simulator, "x")[1])
    y = steps_of(known, simulator, "y")[0]
    contact = int(x[np.searchsorted(steps_of(known, simulator, "x")[0], y[0]) - 1])
    assert 1000 <= contact <= 1002
    assert x.max() == contact
    assert place(known, simulator) == [400, 0, 0]


def test_contact_that_is_read_after_the_end_of_its_move_is_a_contact(tmp_path: Path) -> None:
    """The probe closes near the end of its move, and a slow computer reads that later."""
    known = machine()
    (tmp_path / "p.ngc").write_text("G21 G90\nG38.2 X4 F300\nG1 X#5061 Y2 F600\nM2\n")
    simulator = simulator_for(known)
    probe = str(pins(known).probe).strip("^!")
    simulator.set_pin(probe, lambda: int(count(known, simulator, "x") < 1590))
    advance, late = simulator.advance, []

    def slows_down(until: float, *, answer: bool = False) -> None:
        advance(min(until, simulator.now + 1e-3), answer=answer)
        if not late and count(known, simulator, "x") >= 1550:
            late.append(simulator.now)
            simulator.cable.latency_s += 0.06

    simulator.advance = slows_down  # type: ignore[method-assign]
    report, _ = played(tmp_path / "p.ngc", tmp_path, known, simulator)
    assert report.ok, report.faults
    assert late
    x, y = place(known, simulator)[:2]
    assert 1590 <= x <= 1592
    assert y == 800


def test_probe_without_contact(tmp_path: Path) -> None:
    known = machine()
    (tmp_path / "p.ngc").write_text("G21 G90\nG38.2 X4 F600\nM2\n")
    report, simulator = played(tmp_path / "p.ngc", tmp_path, known)
    assert [fault.diagnostic.code for fault in report.faults] == ["probe-no-contact"]
    assert place(known, simulator) == [1600, 0, 0]


def test_slow_host_comes_to_rest_on_the_path() -> None:
    """Without more motion in time, the reserve becomes a ramp within the accelerations."""
    known = machine()
    time_ns, step = line(20_000, 100_000)
    with board(known) as (driver, simulator):
        driver.start(np.zeros(3, np.int64))
        sent = 0
        for part in chunks(time_ns, step, 100):
            driver.send(part)
            sent = int(part.line[-1])
            if sent >= 8000:
                break
        with pytest.raises(BoardError) as caught:
            driver._supervisor.connection.wait(2.0, driver._supervisor.pump)
        assert caught.value.diagnostic.code == "board-underrun"
        assert "came to rest on the path" in caught.value.diagnostic.message
        made = place(known, simulator)
        assert driver.position_steps.tolist() == made
        assert driver.known_steps == tuple(made)
    assert simulator.reason == ""
    # The rows sent lead to every grid point of the motion, so it ended at one of them.
    points = np.cumsum(step[:sent], axis=0, dtype=np.int64)
    assert (points == made).all(axis=1).any()
    clock, _ = steps_of(known, simulator, "x")
    gaps = np.diff(clock) / simulator.firmware.frequency
    assert gaps[-1] > 5 * gaps[1000]
    # The speed falls no faster than the ramp allows.
    speed, moment = 1.0 / gaps, (clock[1:] / simulator.firmware.frequency)
    braking = -np.diff(np.convolve(speed, np.ones(20) / 20, "valid")) / np.diff(moment)[:-19]
    full = 1.0 / gaps[1000]
    assert np.median(braking[-400:-50]) < 1.6 * full / ramp_seconds(known)


def test_ramp_covers_half_its_time_and_keeps_the_order() -> None:
    time_ns = np.arange(0, 200_000_000, 50_000, dtype=np.int64) + 7
    late = stretched(time_ns, 7, 0.2)
    assert len(late) == pytest.approx(0.1 / 50e-6, abs=2)
    assert (np.diff(late) > 0).all()
    assert late[-1] <= 7 + 200_000_000
    # 1 - 3u^2 + 2u^3 at the middle is half of the speed.
    middle = int(np.searchsorted(late, 7 + 100_000_000))
    assert 50_000 / np.diff(late)[middle] == pytest.approx(0.5, abs=0.01)


def test_dead_host_stops_motors_and_spindle(tmp_path: Path) -> None:
    """Nobody sends any more: the motion ends, the spindle goes off, and nothing resumes."""
    known = machine()
    simulator = simulator_for(known)
    port = KlipperSimulatorPort(simulator)
    driver = Klipper(port, known, "the simulator", clock=port)
    time_ns, step = line(20_000, 100_000)
    driver.start(np.zeros(3, np.int64))
    driver.execute(Spindle("p", 1, "cw", 500.0), 0)
    for part in chunks(time_ns, step, 100):
        driver.send(part)
        if part.line[-1] >= 9000:
            break
    died = simulator.now
    made = place(known, simulator)
    simulator.advance(died + 5.0)
    assert last_step(simulator) - died <= RUN.horizon_s + PIECE_S + 0.01
    spindle = pins(known).spindle
    assert spindle is not None
    off = [c for c, pin, v in simulator.history if pin == simulator.pin(spindle.pin) and v == 0]
    assert simulator.time_of(off[-1]) - died <= 0.5
    assert simulator.value(spindle.pin) == 0
    assert simulator.reason == "Missed scheduling of next hard pwm event"
    rested = place(known, simulator)
    assert rested != made
    # A new program finds the board at the position of its edges.
    after_it = Klipper(KlipperSimulatorPort(simulator), known, "again", clock=port)
    counts = after_it._position.counts(after_it._supervisor.read_positions())
    assert counts == rested
    assert after_it.known_steps == (None, None, None)
    simulator.advance(simulator.now + 5.0)
    assert place(known, simulator) == rested


def test_pulled_cable_is_reported(tmp_path: Path) -> None:
    known = machine()
    (tmp_path / "p.ngc").write_text(LONG)
    simulator = simulator_for(known)
    after(simulator, 0.3, simulator.cable.unplug)
    report, _ = played(tmp_path / "p.ngc", tmp_path, known, simulator)
    assert [fault.diagnostic.code for fault in report.faults] == ["port-lost"]
    ended = place(known, simulator)
    simulator.advance(simulator.now + 3.0)
    moved = place(known, simulator)
    simulator.advance(simulator.now + 3.0)
    assert place(known, simulator) == moved
    assert moved[0] >= ended[0]
    told = [
        f"{letter.upper()}{mm:.4f}".rstrip("0").rstrip(".")
        for letter, mm in report.end_position.items()
    ]
    assert f"the machine is at about {' '.join(told)}" in report.faults[0].diagnostic.message


@pytest.mark.parametrize("moment", share([0.3, 0.9, 1.7], [0.9]))
def test_next_run_does_not_skip_what_a_board_that_was_reset_has_not_played(
    moment: float, tmp_path: Path
) -> None:
    """The board says that it starts half a second after its last step."""
    known = machine("atmega2560")
    lines = ["G21 G90", *(f"G1 X{0.5 * k} F1500" for k in range(1, 60)), "M2", ""]
    (tmp_path / "p.ngc").write_text("\n".join(lines))
    simulator = simulator_for(known)
    after(simulator, moment, simulator.reset)
    report, _ = played(tmp_path / "p.ngc", tmp_path, known, simulator)
    assert report.faults[0].diagnostic.code == "board-reset"
    reached = place(known, simulator)[0] / float(known.steps_per_mm[0])
    assert report.resume_line is not None
    # Line 2 ends at X0.5, line 3 at X1.
    assert 0.0 <= reached - 0.5 * (report.resume_line - 2) <= 0.5 + 25.0 * 0.15
    assert "the machine is at about X" in report.faults[0].diagnostic.message


@pytest.mark.parametrize("way", ["up", "down"])
def test_cable_that_damages_most_messages_is_named(way: str, tmp_path: Path) -> None:
    """The moves come too late, but the load of the computer is not the cause."""
    known = machine("atmega328p")
    (tmp_path / "p.ngc").write_text(LONG)
    simulator = simulator_for(known)
    cable, sends = simulator.cable, getattr(simulator.cable, way)
    noise: list[float] = []

    def damaged(data: bytes, now: float) -> object:
        cable.noise.damaged = noise[0] if noise else 0.0
        sent = sends(data, now)
        cable.noise.damaged = 0.0
        return sent

    setattr(cable, way, damaged)
    after(simulator, 0.3, lambda: noise.append(0.25))
    report, _ = played(tmp_path / "p.ngc", tmp_path, known, simulator)
    fault = report.faults[0].diagnostic
    assert fault.code in ("board-underrun", "board-silence", "board-silent", "klipper-shutdown")
    assert "check cable" in fault.hint or "check the cable" in fault.hint
    assert "load" not in fault.hint
    assert "the machine is at" in fault.message


@pytest.mark.parametrize("question", ["trsync_trigger", "stepper_get_position"])
def test_cable_that_fails_after_the_motion_leaves_the_end_of_the_moves(
    question: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The questions after a motion get no answer, but the board has played all its moves."""
    known = machine("atmega328p")
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X2 F1500\nM2\n")
    simulator = simulator_for(known)
    respond = simulator.respond
    asked = {"trsync_trigger": "trsync_state", "stepper_get_position": "stepper_position"}

    def lost(name: str, **values: int | bytes) -> None:
        if not (name == asked[question] and place(known, simulator)[0] > 0):
            respond(name, **values)

    monkeypatch.setattr(simulator, "respond", lost)
    report, _ = played(tmp_path / "p.ngc", tmp_path, known, simulator)
    fault = report.faults[0].diagnostic
    assert fault.code == "board-silent"
    assert "the machine is at about X2 " in fault.message


@pytest.mark.parametrize(("mcu", "code"), [("atmega2560", "board-reset"), ("rp2040", "port-lost")])
def test_reset_of_the_board_is_reported(mcu: str, code: str, tmp_path: Path) -> None:
    """A board with USB vanishes; another one says after a while that it starts."""
    known = machine(mcu)
    (tmp_path / "p.ngc").write_text(LONG)
    simulator = simulator_for(known)
    after(simulator, 0.3, simulator.reset)
    report, _ = played(tmp_path / "p.ngc", tmp_path, known, simulator)
    assert [fault.diagnostic.code for fault in report.faults] == [code]


def test_shutdown_is_reported_with_its_reason(tmp_path: Path) -> None:
    known = machine()
    (tmp_path / "p.ngc").write_text(LONG)
    simulator = simulator_for(known)
    after(simulator, 0.3, lambda: simulator.shut_down("Rescheduled timer in the past"))
    report, _ = played(tmp_path / "p.ngc", tmp_path, known, simulator)
    found = report.faults[0].diagnostic
    assert found.code == "klipper-shutdown"
    assert "Rescheduled timer in the past" in found.message
    steps = known.steps_per_mm
    at = [round(v * s) for v, s in zip(report.end_position.values(), steps, strict=True)]
    assert at == place(known, simulator)


@pytest.mark.parametrize("fault", share(["damaged", "dropped", "doubled"], ["damaged"]))
@pytest.mark.parametrize("mcu", share(["atmega328p", "rp2040"], ["rp2040"]))
@pytest.mark.parametrize("seed", range(share(50, 1)))
def test_bad_cable(fault: str, mcu: str, seed: int, tmp_path: Path) -> None:
    """With 1 % of the bytes spoilt, the steps are right, or the fault and the position are told."""
    known = machine(mcu)
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X6 Y4 F1200\nG3 X2 Y8 R5\nG1 X0 Y0.3\nM2\n")
    clean, reference = played(tmp_path / "p.ngc", tmp_path, known)
    assert clean.ok
    simulator = simulator_for(known)
    simulator.cable._random.seed(seed)
    setattr(simulator.cable.noise, fault, 0.01)
    report, _ = played(tmp_path / "p.ngc", tmp_path, known, simulator)
    for letter in known.axes:
        made = steps_of(known, simulator, letter)[1]
        wanted = steps_of(known, reference, letter)[1]
        np.testing.assert_array_equal(made, wanted[: len(made)])
        if report.ok:
            assert len(made) == len(wanted)
    if report.ok:
        assert simulator.reason == ""
    moved = place(known, simulator)
    simulator.advance(simulator.now + 2.0)
    if not report.ok:
        assert report.faults[0].diagnostic.code.startswith(("board-", "klipper-"))
    else:
        assert place(known, simulator) == moved


@pytest.mark.parametrize("moment", share([0.2, 0.6], [0.2]))
def test_abort_comes_to_rest_on_the_path(moment: float) -> None:
    known = machine()
    time_ns, step = eased(12_000, 60_000)
    with board(known) as (driver, simulator):
        driver.start(np.zeros(3, np.int64))
        for part in chunks(time_ns, step, 100):
            driver.send(part)
            if part.time_ns[-1] > moment * time_ns[-1]:
                break
        driver.abort()
        made = place(known, simulator)
        assert driver.position_steps.tolist() == made
    points = np.cumsum(step, axis=0, dtype=np.int64)
    assert (points == made).all(axis=1).any()
    assert simulator.reason == ""
    simulator.advance(simulator.now + 1.0)
    assert place(known, simulator) == made


def test_stop_by_the_operator_ends_on_the_path(tmp_path: Path) -> None:
    known = machine()
    (tmp_path / "p.ngc").write_text(LONG)
    control = Control()
    with board(known) as (driver, simulator):
        after(simulator, 0.4, control.stop)
        report = run(tmp_path / "p.ngc", known, board=driver, control=control)
    assert report.stopped_at_line == 3
    at = [
        round(v * s) for v, s in zip(report.end_position.values(), known.steps_per_mm, strict=True)
    ]
    assert at == place(known, simulator)
    assert at[0] * 20 == pytest.approx(at[1] * 30, abs=30)
