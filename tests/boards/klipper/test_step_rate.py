"""Steps that are too fast for a microcontroller: refused by the check, and a shutdown if played."""

from __future__ import annotations

import numpy as np
import pytest

from cnc.boards.klipper.driver import Klipper
from cnc.boards.klipper.feasibility import KlipperFeasibility
from cnc.boards.klipper.profile import profile_of
from cnc.boards.klipper.simulator.steppers import Motor
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError, MotionLimitError
from tests.support.boards.klipper_rig import board, machine
from tests.support.boards.stepper_rig import chunks, line

ROWS, GAP_NS = 6000, 16_000
"""A motor at 62 500 steps/s. An AVR has 256 ticks for each of them, and an edge takes 161."""


def with_pulse(mcu: str, pulse_s: float) -> Machine:
    known = machine(mcu)
    changes = {"step_pulse": pulse_s, "max_step_rate": 200_000.0}
    return known.model_copy(update={"board": known.board.model_copy(update=changes)})


def check(known: Machine, gap_ns: int) -> KlipperFeasibility:
    found = KlipperFeasibility(known, profile_of(known))
    for part in chunks(*line(ROWS, gap_ns, (1.0, 0.0, 0.0)), 500):
        found.add(part)
    return found


def play(driver: Klipper) -> None:
    driver.start(np.zeros(3, np.int64))
    for part in chunks(*line(ROWS, GAP_NS, (1.0, 0.0, 0.0)), 500):
        driver.send(part)
    driver.finish()


@pytest.mark.parametrize(("mcu", "pulse_s"), [("atmega328p", 2.5e-6), ("rp2040", 5e-6)])
def test_steps_that_the_processor_can_make(mcu: str, pulse_s: float) -> None:
    known = with_pulse(mcu, pulse_s)
    assert check(known, GAP_NS).entries
    with board(known) as (driver, simulator):
        play(driver)
    assert simulator.reason == ""


def test_ends_of_pulses_take_the_processor_as_long_as_their_beginnings() -> None:
    """Above 40 ticks of a pulse, an AVR needs a second event for each step.

    Four inputs are sampled every 150 us: 4 x 161 of 2400 ticks. The rest is for steps of 322 ticks.
    """
    known = with_pulse("atmega328p", 3e-6)
    with pytest.raises(MotionLimitError) as caught:
        check(known, GAP_NS)
    assert caught.value.diagnostic.code == "board-step-rate"
    assert "the 36356 per second of the board" in caught.value.diagnostic.message
    with board(known) as (driver, _), pytest.raises(BoardError) as shut:
        play(driver)
    assert shut.value.diagnostic.code == "klipper-shutdown"
    assert "Rescheduled timer in the past" in shut.value.diagnostic.message


@pytest.mark.parametrize(("gap_ns", "fits"), [(10_000, True), (9_990, False)])
def test_pulses_of_an_axis_do_not_overlap(gap_ns: int, fits: bool) -> None:
    known = with_pulse("rp2040", 5e-6)
    if fits:
        assert check(known, gap_ns).entries
        return
    with pytest.raises(MotionLimitError) as caught:
        check(known, gap_ns)
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
