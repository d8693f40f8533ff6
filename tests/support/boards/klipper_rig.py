"""Shared parts of the Klipper board's tests: machines, boards on a simulator, checks of edges."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cnc.api import Report
from cnc.boards.klipper.driver import Klipper
from cnc.boards.klipper.firmware import FIRMWARES
from cnc.boards.klipper.guards import REST_S
from cnc.machine.klipper import KlipperAxis, KlipperBoard, KlipperSpindle
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.session.options import Outputs
from cnc.simulators.klipper.klipper_simulator import KlipperSimulator
from cnc.simulators.klipper.objects import EndLevel
from cnc.simulators.klipper.ports import KlipperSimulatorPort, simulator_for
from tests.support.session.runs import run_with

MCUS = tuple(FIRMWARES)
AVR = ("atmega328p", "atmega2560")
LONG_PULSE, SHORT_PULSE = 5e-6, 2.5e-6
NAMES = {
    True: [f"gpio{number}" for number in range(30)],
    False: [f"P{letter}{number}" for letter in "ABCD" for number in range(8)],
}


def with_board(known: Machine, mcu: str = "rp2040", **changes: Any) -> Machine:
    """Return a machine with the pins of a microcontroller: motors, switches, probe, e-stop."""
    pins = iter(NAMES[mcu == "rp2040"])
    axes = {
        letter: KlipperAxis(
            step=(next(pins),),
            direction=((("!" if k % 2 else "") + next(pins)),),
            endstop=f"^!{next(pins)}",
        )
        for k, letter in enumerate(known.axes)
    }
    klipper = KlipperBoard(
        mcu=mcu,
        spindle=KlipperSpindle(pin=next(pins), pwm=True, backward=next(pins)),
        flood=next(pins),
        mist=next(pins),
        probe=f"^!{next(pins)}",
        emergency_stop=f"^!{next(pins)}",
    ).model_copy(update={**axes, **changes})
    return known.model_copy(
        update={"board": known.board.model_copy(update={"klipper": klipper, "kind": "klipper"})}
    )


def machine(mcu: str = "rp2040", **changes: Any) -> Machine:
    """Return the router of the stepper board with the pins of a microcontroller.

    An AVR gets short pulses: longer ones leave it 12 000 steps per second.
    """
    known = with_board(load_machine("stepper-uno"), mcu, **changes)
    if mcu not in AVR:
        return known
    return known.model_copy(
        update={"board": known.board.model_copy(update={"step_pulse": SHORT_PULSE})}
    )


def event_ticks(simulator: KlipperSimulator) -> float:
    """Return the longest time of an event of a step, while all switches are sampled."""
    firmware, pulse = simulator.firmware, simulator.motors[0].pulse
    samples = len(simulator.switches) / (REST_S * firmware.frequency)
    return firmware.event_time(pulse, samples)


def pins(known: Machine) -> KlipperBoard:
    assert known.board.klipper is not None
    return known.board.klipper


def connected(
    known: Machine,
    simulator: KlipperSimulator,
    port: KlipperSimulatorPort | None = None,
    identity: str = "",
) -> Klipper:
    """Return a driver on a simulated board, which may have to reset it."""
    port = port or KlipperSimulatorPort(simulator)
    return Klipper(
        port,
        known,
        "the simulator",
        clock=port,
        identity=identity,
        reopen=lambda: KlipperSimulatorPort(simulator),
    )


@contextmanager
def board(
    known: Machine,
    simulator: KlipperSimulator | None = None,
    port: KlipperSimulatorPort | None = None,
) -> Iterator[tuple[Klipper, KlipperSimulator]]:
    """Provide a driver on a simulated board."""
    simulator = simulator or simulator_for(known)
    port = port or KlipperSimulatorPort(simulator)
    driver = connected(known, simulator, port)
    try:
        yield driver, simulator
    finally:
        driver.close()


def played(
    program: Path,
    folder: Path,
    known: Machine,
    simulator: KlipperSimulator | None = None,
    **options: Any,
) -> tuple[Report, KlipperSimulator]:
    """Run a program on a simulated board, and write its pulses to ``folder``/pulses.npz."""
    with board(known, simulator) as (driver, simulator):
        report = run_with(
            program,
            known,
            board=driver,
            outputs=Outputs(pulses=str(folder / "pulses.npz")),
            **options,
        )
    return report, simulator


def _is_backward(known: Machine, letter: str, motor: int) -> bool:
    """Return whether a high level of the direction pin of a motor moves its axis backward."""
    inverted = next(axis.invert for name, axis in known.axes.items() if name == letter)
    return bool(getattr(pins(known), letter).direction[motor].startswith("!") != inverted)


def steps_of(
    known: Machine, simulator: KlipperSimulator, letter: str, motor: int = 0
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return clocks (n,) and signs (n,) of the steps of a motor, from the edges of its pins."""
    axis = getattr(pins(known), letter)
    clock, level = simulator.edges(axis.step[motor].lstrip("!"))
    backward = _is_backward(known, letter, motor)
    return clock, level.astype(np.int64) * (-1 if backward else 1)


def place(known: Machine, simulator: KlipperSimulator) -> list[int]:
    """Return the position that the edges add up to, steps."""
    return [int(steps_of(known, simulator, letter)[1].sum()) for letter in known.axes]


def end_level(
    known: Machine,
    simulator: KlipperSimulator,
    letter: str,
    end: tuple[int, float],
    motor: int = 0,
) -> EndLevel:
    """Return the level of a switch that is closed, and low, from a place on.

    The simulator skips its samples while the motor is far away, which a function would not permit.

    Args:
        known: The machine.
        simulator: The board.
        letter: The axis.
        end: Direction and place of the switch, steps of the axis.
        motor: The motor of the axis.
    """
    axis = getattr(pins(known), letter)
    backward = _is_backward(known, letter, motor)
    sign = -1 if backward else 1
    towards, at = end
    step_pin = simulator.pin(axis.step[motor].lstrip("!"))
    return EndLevel(simulator.positions, step_pin, (sign * towards, sign * at), active=0)


def count(known: Machine, simulator: KlipperSimulator, letter: str) -> int:
    """Return the position of an axis by the simulator's own count, which is quick to read."""
    axis = getattr(pins(known), letter)
    backward = _is_backward(known, letter, 0)
    counted = simulator.positions.get(simulator.pin(axis.step[0].lstrip("!")), 0)
    return -counted if backward else counted


def check_queues(known: Machine, simulator: KlipperSimulator, folder: Path) -> None:
    """Check that the queued times are those of the plan, within the tolerance and a tick.

    The processor then makes a step at most the time of the edges of one step of each motor later.
    """
    assert known.board.klipper is not None
    with np.load(folder / "pulses.npz") as planned:
        time_ns, step = planned["time_ns"], planned["step"]
    frequency, offsets = simulator.firmware.frequency, []
    for column, letter in enumerate(known.axes):
        rows = np.flatnonzero(step[:, column])
        pin = simulator.pin(getattr(pins(known), letter).step[0].lstrip("!"))
        if len(rows):
            due = np.concatenate(simulator.due_of[pin])
            offsets.append(due - time_ns[rows] * 1e-9 * frequency)
            delays = steps_of(known, simulator, letter)[0] - due
            assert delays.min() >= 0
            edges = len(known.axes) * simulator.firmware.events(simulator.motors[column].pulse)
            assert delays.max() <= edges * event_ticks(simulator)
    late = np.concatenate(offsets)
    tolerance = known.board.klipper.tolerance_us * 1e-6 * frequency
    assert late.max() - late.min() <= 2.0 * (tolerance + 1.0)


def check_pulses(
    known: Machine, simulator: KlipperSimulator, folder: Path, tolerance_us: float
) -> None:
    """Check that each axis made the planned steps, in order, and in time.

    The start of the motion is where most steps are in time.
    """
    with np.load(folder / "pulses.npz") as planned:
        time_ns, step = planned["time_ns"], planned["step"]
    offsets: list[NDArray[np.float64]] = []
    for column, letter in enumerate(known.axes):
        clock, sign = steps_of(known, simulator, letter)
        rows = np.flatnonzero(step[:, column])
        np.testing.assert_array_equal(sign, step[rows, column])
        offsets.append(clock / simulator.firmware.frequency * 1e6 - time_ns[rows] * 1e-3)
    late = np.concatenate(offsets)
    if len(late):
        assert (late.max() - late.min()) <= 2 * tolerance_us


def after(simulator: KlipperSimulator, seconds: float, action: Callable[[], None]) -> None:
    """Carry out an action some time after the first step."""
    advance, done = simulator.advance, []

    def watched(until: float, *, answer: bool = False) -> None:
        if not done:
            until = min(until, simulator.now + 1e-3)
        advance(until, answer=answer)
        first = [parts[0][0] for parts in simulator.edges_of.values()]
        if not done and first:
            begin = simulator.time_of(int(min(abs(int(clock)) for clock in first)))
            if simulator.now - begin >= seconds:
                done.append(simulator.now)
                action()

    simulator.advance = watched  # type: ignore[method-assign]


def last_step(simulator: KlipperSimulator) -> float:
    """Return the time of the last step, s."""
    return max(
        simulator.time_of(int(np.abs(parts[-1]).max())) for parts in simulator.edges_of.values()
    )
