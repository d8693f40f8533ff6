"""A computer that is slow between two calls: at rest on the path, or a position that is right."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from cnc.boards.klipper.driver import BACKGROUND_S, Klipper
from cnc.boards.klipper.feasibility import KlipperFeasibility, profile_of
from cnc.model.blocks import Spindle
from cnc.model.diagnostics import BoardError
from cnc.simulators.klipper.klipper_simulator import KlipperSimulator
from tests.support.boards.klipper_rig import board, count, machine, place, steps_of
from tests.support.boards.stepper_rig import chunks, eased, line
from tests.support.soak import share

ROWS, GAP_NS = 12_000, 100_000
HARMLESS_S = 0.19
"""The board has so much motion for certain, see HORIZON_S and PIECE_S of the sender."""
DELAYS = [0.05, 0.15, 0.4, 1.5]
REASONS = ["Timer too close", "Missed scheduling of next hard pwm event"]


def delayed(
    driver: Klipper,
    simulator: KlipperSimulator,
    motion: tuple[NDArray[np.int64], NDArray[np.int8]],
    at: float,
    seconds: float,
    *,
    alive: bool,
) -> BoardError | None:
    """Send a motion with a delay at a share of its time; return the fault of the board.

    With ``alive`` only the computation is late, and the thread of the driver goes on.
    """
    time_ns, step = motion
    late_at = at * float(time_ns[-1])
    try:
        driver.start(np.zeros(3, np.int64))
        for part in chunks(time_ns, step, 100):
            driver.send(part)
            if part.time_ns[-1] > late_at:
                late_at, end = np.inf, simulator.now + seconds
                while alive and simulator.now < end:
                    simulator.advance(simulator.now + BACKGROUND_S)
                    driver._board.pump_in_background()
                simulator.advance(end)
        driver.finish()
    except BoardError as fault:
        return fault
    return None


@pytest.mark.parametrize("seconds", share([*DELAYS, 0.1, 0.25, 0.7, 1.1, 2.0], DELAYS[2:3]))
@pytest.mark.parametrize("at", np.random.default_rng(11).uniform(0.05, 0.9, share(12, 1)).tolist())
@pytest.mark.parametrize("alive", [True, False])
def test_delay_between_two_calls(seconds: float, at: float, alive: bool) -> None:
    known = machine()
    motion = eased(ROWS, GAP_NS)
    points = np.cumsum(motion[1], axis=0, dtype=np.int64)
    with board(known) as (driver, simulator):
        fault = delayed(driver, simulator, motion, at, seconds, alive=alive)
        made = place(known, simulator)
        assert driver.position_steps.tolist() == made
        simulator.advance(simulator.now + 2.0)
        assert place(known, simulator) == made
        if seconds < HARMLESS_S and (fault is None or not alive):
            assert fault is None
            assert made == points[-1].tolist()
            return
        assert fault is not None
        assert fault.diagnostic.code == "board-underrun"
        assert driver.known_steps == ((tuple(made)) if alive else (None, None, None))
    if alive:
        assert simulator.reason == ""
        assert (points == made).all(axis=1).any()
        clocks = steps_of(known, simulator, "x")[0] / simulator.firmware.frequency
        assert clocks[-1] - clocks[-2] > 20 * GAP_NS * 1e-9
    else:
        assert "the machine is at" in fault.diagnostic.message


@pytest.mark.parametrize("spindle", share([True, False], [True]))
def test_delay_before_the_end_of_a_motion(spindle: bool) -> None:
    """The rest of a motion is sent by a block at rest, or by the end of the program."""
    known = machine()
    with board(known) as (driver, simulator):
        driver.start(np.zeros(3, np.int64))
        for part in chunks(*eased(ROWS, GAP_NS), 100):
            driver.send(part)
            if part.line[-1] >= ROWS // 2:
                break
        simulator.advance(simulator.now + 0.5)
        block = Spindle("p", ROWS, "cw", 500.0)
        with pytest.raises(BoardError) as caught:
            driver.execute(block, int(part.time_ns[-1]) + 1) if spindle else driver.finish()
        assert caught.value.diagnostic.code == "board-underrun"
        assert driver.position_steps.tolist() == place(known, simulator)


@pytest.mark.parametrize("reason", REASONS[:: share(1, 2)])
@pytest.mark.parametrize("answers", share([0, 1, 2], [1]))
def test_shutdown_while_the_position_is_read(reason: str, answers: int) -> None:
    """A board that shuts down in the middle of a stop answers no question until that is ended."""
    known = machine()
    motion = eased(ROWS, GAP_NS)
    with board(known) as (driver, simulator):
        send, left = simulator.respond, [answers]

        def respond(name: str, **values: int | bytes) -> None:
            send(name, **values)
            if driver._supervisor._stopping and name in ("config", "stepper_position"):
                if left[0] == 0:
                    simulator.shut_down(reason)
                left[0] -= 1

        simulator.respond = respond  # type: ignore[method-assign]
        fault = delayed(driver, simulator, motion, 0.5, 1.5, alive=True)
        assert left[0] < 0
        made = place(known, simulator)
        assert fault is not None
        assert driver.position_steps.tolist() == made
        assert "the machine is at" in fault.diagnostic.message
        assert driver.known_steps == (None, None, None)
        assert simulator.reason == ""


def test_an_answer_is_awaited_through_a_standstill_of_the_process() -> None:
    """The system stops the process for seconds before it reads the answer."""
    known = machine()
    with board(known) as (driver, simulator):
        port = driver._supervisor.connection.port.port
        read = port.read
        stopped: list[float] = []

        def late(timeout: float) -> bytes:
            if stopped:
                return bytes(read(timeout))
            stopped.append(simulator.now)
            simulator.advance(simulator.now + 2.0)
            return b""

        port.read = late  # type: ignore[method-assign]
        counts = driver._supervisor.read_positions()
        assert simulator.now > stopped[0] + 2.0
        assert driver._position.counts(counts) == place(known, simulator)


def test_an_abort_plays_a_ramp_as_long_as_the_timeout_of_the_board() -> None:
    """The board waits 0.4 s for a sign of the host, also while the host waits for the ramp."""
    known = machine()
    time_ns, step = line(20_000, 400_000)
    with board(known) as (driver, simulator):
        driver.start(np.zeros(3, np.int64))
        for part in chunks(time_ns, step, 50):
            driver.send(part)
            if part.line[-1] >= 1000:
                break
        driver.abort()
        assert driver.known_steps == tuple(place(known, simulator))
        points = np.cumsum(step, axis=0, dtype=np.int64)
        assert (points == driver.position_steps).all(axis=1).any()


def test_board_that_receives_nothing_more_ends_where_its_queue_ends() -> None:
    """Nothing arrives any more: what was sent after that has moved nothing."""
    known = machine()
    motion = eased(ROWS, GAP_NS)
    with board(known) as (driver, simulator):
        down, up = simulator.cable.down, simulator.cable.up

        def cut() -> bool:
            return count(known, simulator, "x") > ROWS // 4

        simulator.cable.down = (  # type: ignore[method-assign]
            lambda data, now: [] if cut() else down(data, now)
        )
        simulator.cable.up = (  # type: ignore[method-assign]
            lambda data, now: None if cut() else up(data, now)
        )
        fault = delayed(driver, simulator, motion, 2.0, 0.0, alive=True)
        assert fault is not None
        assert fault.diagnostic.code == "board-silent"
        made = place(known, simulator)
        assert made[0] > ROWS // 4
        assert driver.position_steps.tolist() == made
        assert 0 < fault.diagnostic.line <= made[0]
        assert driver.known_steps == (None, None, None)


@pytest.mark.parametrize("stops", share([False, True], [True]))
def test_dense_motion_that_fills_the_queue_early(stops: bool) -> None:
    """86 entries hold 0.07 s of it. That is no underrun, unless no more moves come."""
    known = machine("atmega328p")
    time_ns, step = line(3000, 480_000)
    check = KlipperFeasibility(known, profile_of(known))
    for part in chunks(time_ns, step, 50):
        check.add(part)
    with board(known) as (driver, simulator):
        driver.start(np.zeros(3, np.int64))
        for part in chunks(time_ns, step, 50):
            driver.send(part)
            driver._supervisor.pump(0.0)
            if stops and part.line[-1] >= 1500:
                with pytest.raises(BoardError) as caught:
                    driver._supervisor.connection.wait(2.0, driver._supervisor.pump)
                assert "came to rest on the path" in caught.value.diagnostic.message
                assert driver.known_steps == tuple(place(known, simulator))
                break
        else:
            driver.finish()
            assert place(known, simulator) == step.sum(axis=0, dtype=np.int64).tolist()
        assert simulator.reason == ""
