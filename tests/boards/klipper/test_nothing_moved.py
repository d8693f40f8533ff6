"""Dead stops before the first step: nothing was lost, so the position is kept."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cnc.boards.klipper.driver import Klipper
from cnc.boards.klipper.sender import LineTracker
from cnc.model.diagnostics import BoardError, Diagnostic
from cnc.simulators.klipper.klipper_simulator import KlipperSimulator
from cnc.simulators.klipper.ports import simulator_for
from tests.support.boards.klipper_rig import board, connected, count, machine, pins, place
from tests.support.boards.stepper_rig import chunks, eased

HOMED = np.array([1200, -800, 400])
ROWS, GAP_NS = 1500, 60_000


def stopped(
    driver: Klipper,
    simulator: KlipperSimulator,
    due: Callable[[], bool],
    stop: Callable[[], None],
    *,
    returns: bool = False,
) -> Diagnostic:
    """Play a motion from HOMED; ``stop`` happens once ``due``. Return the fault."""
    advance = simulator.advance
    done: list[bool] = []

    def watched(until: float, *, answer: bool = False) -> None:
        if done:
            advance(until, answer=answer)
            return
        advance(min(until, simulator.now + 1e-4), answer=answer)
        if due():
            done.append(True)
            stop()

    driver.start(HOMED)
    simulator.advance = watched  # type: ignore[method-assign]
    with pytest.raises(BoardError) as caught:
        play(driver, returns=returns)
    assert done
    simulator.advance(simulator.now + 0.5)
    return caught.value.diagnostic


def play(driver: Klipper, *, returns: bool) -> None:
    """Move away from HOMED, and back to its other side without a stop there."""
    time_ns, step = eased(ROWS, GAP_NS)
    for part in chunks(time_ns, step, 100):
        driver.send(part)
    if returns:
        back_ns, back = eased(2 * ROWS, GAP_NS)
        for part in chunks(back_ns + time_ns[-1] + GAP_NS, -back, 100):
            driver.send(part)
    driver.finish()


def queued(simulator: KlipperSimulator) -> bool:
    return any(motor.active for motor in simulator.motors)


@pytest.mark.parametrize("mcu", ["atmega328p", "rp2040"])
def test_shutdown_before_the_first_step_keeps_the_position(
    mcu: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    known = machine(mcu)
    simulator = simulator_for(known)
    driver = connected(known, simulator, identity="mill")
    fault = stopped(
        driver,
        simulator,
        lambda: queued(simulator),
        lambda: simulator.shut_down("Rescheduled timer in the past"),
    )
    assert place(known, simulator) == [0, 0, 0]
    assert fault.code == "klipper-shutdown"
    assert "nothing has moved" in fault.message
    assert "home" not in str(fault.hint)
    assert driver.known_steps == tuple(HOMED)
    driver.close()
    assert connected(known, simulator, identity="mill").known_steps == tuple(HOMED)


def test_first_steps_that_arrive_too_late_lose_no_position() -> None:
    """The cable stalls for longer than the time to the first step, then delivers everything."""
    known = machine()
    simulator = simulator_for(known)
    with board(known, simulator) as (driver, simulator):
        down, until = simulator.cable.down, [0.0]

        def late(data: bytes, now: float) -> list[tuple[float, bytes]]:
            if driver._supervisor.sender.running and not until[0]:
                until[0] = now + 0.3
            return [(max(at, until[0]), part) for at, part in down(data, now)]

        simulator.cable.down = late  # type: ignore[method-assign]
        fault = stopped(driver, simulator, lambda: bool(simulator.reason), lambda: None)
        assert fault.code == "klipper-shutdown"
        assert "Timer too close" in fault.message
        assert place(known, simulator) == [0, 0, 0]
        assert driver.known_steps == tuple(HOMED)


def test_a_stop_ends_on_a_line_that_is_slower_than_the_questions_for_the_clock() -> None:
    """There is always a question on its way, so the line never falls idle."""
    known = machine()
    simulator = simulator_for(known)
    with board(known, simulator) as (driver, simulator):
        down = simulator.cable.down

        def slow(data: bytes, now: float) -> list[tuple[float, bytes]]:
            assert now < 10.0
            held = 0.3 if driver._supervisor.sender.running else 0.0
            return [(at + held, part) for at, part in down(data, now)]

        simulator.cable.down = slow  # type: ignore[method-assign]
        fault = stopped(driver, simulator, lambda: bool(simulator.reason), lambda: None)
        assert fault.code == "klipper-shutdown"
        assert driver.known_steps == tuple(HOMED)


def test_emergency_stop_before_the_first_step_loses_the_position() -> None:
    """Its button cuts the power of the motors, so they may turn."""
    known = machine()
    simulator = simulator_for(known)
    with board(known, simulator) as (driver, simulator):
        stop = str(pins(known).emergency_stop).strip("^!")
        fault = stopped(
            driver, simulator, lambda: queued(simulator), lambda: simulator.set_pin(stop, 0)
        )
        assert fault.code == "board-emergency-stop"
        assert place(known, simulator) == [0, 0, 0]
        assert driver.known_steps == (None, None, None)


@pytest.mark.parametrize("steps", [1, ROWS // 2])
def test_a_stop_after_a_step_loses_the_position(steps: int) -> None:
    known = machine()
    simulator = simulator_for(known)
    with board(known, simulator) as (driver, simulator):
        fault = stopped(
            driver,
            simulator,
            lambda: count(known, simulator, "x") >= steps,
            lambda: simulator.shut_down("Rescheduled timer in the past"),
        )
        assert "may be wrong" in fault.message
        assert driver.position_steps.tolist() == (HOMED + place(known, simulator)).tolist()
        assert driver.known_steps == (None, None, None)


def test_a_stop_at_speed_where_the_motion_began_loses_the_position() -> None:
    """Every motor has the count of the beginning, but it was stopped on its way back."""
    known = machine()
    simulator = simulator_for(known)
    far: list[bool] = []

    def shut_down() -> None:
        simulator.shut_down("Timer too close")

    def back() -> bool:
        x = count(known, simulator, "x")
        far.extend([True] if x == ROWS else [])
        return bool(far) and x <= 1

    with board(known, simulator) as (driver, simulator):
        fault = stopped(driver, simulator, back, shut_down, returns=True)
        made = place(known, simulator)
        assert driver.position_steps.tolist() == (HOMED + made).tolist()
        assert "may be wrong" in fault.message
        assert driver.known_steps == (None, None, None)


def test_tracker_knows_an_axis_that_was_there_and_back() -> None:
    """One axis returns while the other is on its way: no grid point is the first one again."""
    draw = np.random.default_rng(77013)
    for _ in range(50):
        step = draw.integers(-1, 2, (30, 2))
        points = HOMED[:2] + np.cumsum(step, axis=0)
        clock = np.cumsum(draw.integers(1, 50, 30))
        tracker = LineTracker()
        tracker.clear(HOMED[:2])
        cut = int(draw.integers(1, 29))
        tracker.add(clock[:cut], points[:cut], np.zeros(cut, np.int32))
        tracker.add(clock[cut:], points[cut:], np.zeros(30 - cut, np.int32))
        back = [
            int(clock[k])
            for k in range(30)
            for a in range(2)
            if points[k, a] == HOMED[a] and (points[:k, a] != HOMED[a]).any()
        ]
        first = min(back, default=int(clock[-1]) + 9)
        assert tracker.unmoved(HOMED[:2], first - 1)
        assert tracker.unmoved(HOMED[:2], first) == (not back)
        assert not tracker.unmoved(HOMED[:2] + [0, 1], 0)


@pytest.mark.parametrize(("mcu", "steps"), [("atmega328p", 0), ("rp2040", 0), ("rp2040", 400)])
def test_shutdown_of_a_board_that_falls_silent_tells_where_it_stopped(
    mcu: str, steps: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Its counts cannot be read, but the shutdown has told its clock."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    known = machine(mcu)
    simulator = simulator_for(known)
    driver = connected(known, simulator, identity="mill")

    def stop() -> None:
        simulator.shut_down("Missed scheduling of next hard pwm event")
        soon = simulator.clock + simulator.firmware.frequency // 100
        simulator.at(soon, simulator.cable.unplug)

    fault = stopped(
        driver,
        simulator,
        lambda: queued(simulator) and max(map(abs, place(known, simulator))) >= steps,
        stop,
    )
    assert fault.code == "klipper-shutdown"
    moved = np.array(place(known, simulator))
    # The last step before the shutdown may have been a little late.
    assert np.abs(driver._supervisor.grid_point - HOMED - moved).max() <= (1 if steps else 0)
    assert None in driver.known_steps
