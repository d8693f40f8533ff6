"""Outputs that change between motions: sent shortly before their time, off soon after a death."""

from __future__ import annotations

import numpy as np
import pytest

from cnc.boards.klipper.driver import Klipper
from cnc.machine.models import Machine
from cnc.model.blocks import Spindle
from cnc.simulators.klipper.klipper_simulator import KlipperSimulator
from cnc.simulators.klipper.ports import simulator_for
from tests.support.boards.klipper_rig import connected, last_step, machine, pins, steps_of
from tests.support.boards.stepper_rig import chunks, eased
from tests.support.soak import share

MOMENTS = np.random.default_rng(2311).uniform(0.5, 4.0, share(50, 2))
OFF_S = 0.5
"""Longest time from the death of the host until the spindle is off."""
SPEEDS = (400.0, 700.0, 0.0, 950.0)
MOTION = eased(1000, 100_000, (1.0, 0.0, 0.0))
"""A motion that the queue of an AVR holds."""


class HostDied(BaseException):
    """The host is dead: nothing catches this."""


def die_at(simulator: KlipperSimulator, moment: float) -> None:
    """Let the host die at a time, in the middle of whatever it does."""
    advance = simulator.advance

    def watched(until: float, *, answer: bool = False) -> None:
        if simulator.now < moment <= until:
            advance(moment)
            simulator.advance = advance  # type: ignore[method-assign]
            raise HostDied
        advance(until, answer=answer)

    simulator.advance = watched  # type: ignore[method-assign]


def play(driver: Klipper, motions: int, *, with_motion: bool = False) -> list[tuple[int, float]]:
    """Play motions from rest to rest, each with a speed; return the times (ns) of the speeds."""
    time_ns, step = MOTION
    at, changes = 0, []
    driver.start(np.zeros(3, np.int64))
    for k in range(motions):
        rpm = SPEEDS[k % len(SPEEDS)]
        block = Spindle("p", k + 1, "cw" if rpm else "off", rpm, with_motion=with_motion)
        driver.execute(block, at)
        changes.append((at, rpm))
        for part in chunks(time_ns + at, -step if k % 2 else step, 100):
            driver.send(part)
        at = int(part.time_ns[-1])
    driver.finish()
    return changes


def spindle_changes(known: Machine, simulator: KlipperSimulator) -> list[tuple[float, int]]:
    """Return times (s) and values of the spindle output."""
    spindle = pins(known).spindle
    assert spindle is not None
    pin = simulator.pin(spindle.pin)
    return [
        (simulator.time_of(c), value) for c, number, value in simulator.history if number == pin
    ]


@pytest.mark.parametrize("moment", MOMENTS.tolist())
@pytest.mark.parametrize("mcu", ["atmega328p", "rp2040"])
def test_spindle_is_off_soon_after_the_death_of_the_host(mcu: str, moment: float) -> None:
    """Also where the host dies after it has sent the motion up to a change of the speed."""
    known = machine(mcu)
    simulator = simulator_for(known)
    driver = connected(known, simulator)
    die_at(simulator, moment)
    with pytest.raises(HostDied):
        play(driver, 40)
    simulator.advance(moment + 3.0)
    changes = spindle_changes(known, simulator)
    if changes:
        assert changes[-1][1] == 0
        assert changes[-1][0] - moment <= OFF_S
    assert last_step(simulator) - moment <= OFF_S


@pytest.mark.parametrize("with_motion", [False, True])
def test_speeds_change_at_the_time_of_their_motion(with_motion: bool) -> None:
    """The power of a laser changes in motion; before its first motion it stays off."""
    known = machine()
    simulator = simulator_for(known)
    driver = connected(known, simulator)
    planned = play(driver, 8, with_motion=with_motion)
    driver.close()
    found = spindle_changes(known, simulator)[1:]  # The first one is the configuration.
    first = simulator.time_of(int(steps_of(known, simulator, "x")[0][0]))
    due = [(time_ns - int(MOTION[0][0])) * 1e-9 + first for time_ns, _ in planned]
    begin = 0 if with_motion else 1
    made = [time for time, _ in found][begin : len(planned)]
    np.testing.assert_allclose(made, due[begin:], atol=1e-3)
    powers = [value > 0 for _, value in found]
    assert powers[: len(planned)] == [rpm > 0 for _, rpm in planned]
