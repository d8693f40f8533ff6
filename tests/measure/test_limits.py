"""Limits by lost steps: the procedure on an axis written anew, and on a board that loses steps."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.boards.loopback import SwitchedLoopback
from cnc.boards.protocols import board_error
from cnc.machine.models import Axis, Homing, Machine, PathLimits
from cnc.measure.limits import KEPT, START, STEP, Bounds, Home, Raised, limits
from cnc.measure.procedures import Scale
from cnc.model.diagnostics import CncError, UsageError
from cnc.model.operator_control import Control, HomingStopped
from cnc.operate.measuring import LimitTest
from tests.support.soak import share

BASE = Bounds(100.0, 1000.0, 40_000.0)
SCALE = Scale("x", 200.0, 2.0, (0.0, 500.0))


def carried_out(procedure, error_of, repeats=0.0) -> tuple[Raised, list]:
    """Carry out a procedure; ``error_of`` bounds and ways returns the error after the strokes."""
    strokes, error = [], repeats
    step = next(procedure)
    try:
        while True:
            if isinstance(step, Home):
                step, error = procedure.send(error), repeats
            else:
                strokes.append(step)
                error, step = error_of(step), procedure.send(0.0)
    except StopIteration as end:
        return end.value, strokes


def first_above(base: float, true: float, most: float) -> float | None:
    """Return the first value of the series above ``true``."""
    value = START * base
    while value <= most * base * (1.0 + 1e-9):
        if value > true:
            return value
        value *= STEP
    return None


@given(st.floats(0.4, 2.5), st.floats(0.4, 2.5), st.floats(0.4, 2.5), st.sampled_from([-1, 1]))
def test_seven_tenths_of_the_first_value_that_loses_steps_are_proposed(v, a, j, away):
    true = Bounds(v * BASE.velocity, a * BASE.acceleration, j * BASE.jerk)
    scale = SCALE if away > 0 else SCALE._replace(place=498.0)

    def error_of(step):
        # All at half of the file's limits is legal, or each is lost from the beginning.
        over = [
            tried > most for tried, most in zip(map(max, step.out, step.back), true, strict=True)
        ]
        return 0.1 if any(over) else 0.02

    raised, strokes = carried_out(
        limits(scale, BASE, away=away, fastest=1e4), error_of, repeats=0.02
    )
    for step in strokes:
        outward = sum(step.ways) * away
        assert 0.0 < outward <= 0.95 * 498.0
    if min(v, a, j) > START:
        value = first_above(BASE.velocity, true.velocity, 2.0)
        key = raised.measured.keys.get(("axes", "x", "max_velocity"))
        if value is not None:
            assert key == pytest.approx(KEPT * value, rel=0.01)
            assert key <= KEPT * value
    # What is proposed has been tried, with a margin.
    for name, least in zip(Bounds._fields, BASE, strict=True):
        tried = [trial.value for trial in raised.trials if trial.name == name]
        key = raised.measured.keys.get(("axes", "x", f"max_{name}"))
        if key is not None:
            # But for the rounding of the product.
            assert key <= KEPT * max(tried) * (1.0 + 1e-12) <= 2.0 * KEPT * least * (1.0 + 1e-12)


def test_nothing_is_raised_beyond_what_a_stroke_or_the_board_reaches():
    """A stroke of 54 mm at 1000 mm/s^2 and 40 000 mm/s^3 reaches 213 mm/s, the board makes 150."""
    scale = SCALE._replace(travel=(0.0, 102.0))
    raised, _ = carried_out(limits(scale, BASE, away=1, fastest=150.0, most=10.0), lambda step: 0.0)
    tried = {name: [t.value for t in raised.trials if t.name == name] for name in Bounds._fields}
    assert max(tried["velocity"]) <= 150.0 < STEP * max(tried["velocity"])
    for value in tried["acceleration"]:
        # a^2 = v j is the highest acceleration that a ramp to v has.
        assert value**2 <= 150.0 * BASE.jerk


def test_a_switch_that_does_not_repeat_is_told():
    with pytest.raises(UsageError, match=r"differ by 0\.300 mm"):
        carried_out(limits(SCALE, BASE, away=1, fastest=1e4), lambda step: 0.0, repeats=0.3)


@pytest.mark.parametrize("most", [0.5, 0.0, -1.0, 11.0, math.nan, math.inf])
def test_a_wrong_factor_is_refused(most):
    with pytest.raises(UsageError, match="--most"):
        next(limits(SCALE, BASE, away=1, fastest=1e4, most=most))


QUICK = Homing(seek=40.0, latch=20.0, pull_off=1.0, end="low")
PERIOD = 0.02
"""s; speed and acceleration of the motor are those over this time, at which a step is little."""


def machine() -> Machine:
    axis = Axis(
        steps_per_mm=SCALE.steps_per_mm,
        max_velocity=BASE.velocity,
        max_acceleration=BASE.acceleration,
        max_jerk=BASE.jerk,
        travel=(0.0, 120.0),
        homing=QUICK,
    )
    # A limit along the path below that of the axis.
    return Machine(axes={"x": axis, "y": axis}, path=PathLimits(max_feed=60.0))


class WeakMotor(SwitchedLoopback):
    """A board whose first motor loses 16 steps of a motion above its speed or acceleration.

    It loses them towards plus, towards minus, or in both directions.
    """

    def __init__(
        self, of: Machine, velocity: float, acceleration: float, weak: tuple[int, ...] = (1, -1)
    ) -> None:
        super().__init__(of)
        self.velocity, self.acceleration, self.weak = velocity, acceleration, weak
        self.played = []

    def start(self, origin_steps):
        self.played = []
        super().start(origin_steps)

    def _play(self, chunk, rows):
        super()._play(chunk, rows)
        moved = np.flatnonzero(chunk.step[:rows, 0])
        self.played += zip(chunk.time_ns[moved] * 1e-9, chunk.step[moved, 0], strict=True)

    def finish(self):
        super().finish()
        if len(self.played) < 100:
            return
        times, steps = np.array(self.played).T
        # Pulses are at exact places, but for the way to the first one.
        grid = np.arange(times[0], times[-1], PERIOD / 4)
        place = np.interp(grid, times, np.cumsum(steps)) / SCALE.steps_per_mm
        speed = (place[4:] - place[:-4]) / PERIOD
        push = (speed[4:] - speed[:-4]) / PERIOD
        over = np.abs(speed).max() > self.velocity or np.abs(push).max() > self.acceleration
        if over and (towards := int(np.sign(steps.sum()))) in self.weak:
            self.motor_steps[0][0] -= 16 * towards


@pytest.mark.parametrize(
    ("velocity", "acceleration", "weak"),
    share([(6, 4, (1, -1)), (3, 5, (1,)), (4, 3, (-1,))], [(4, 3, (-1,))]),
)
def test_the_limits_of_a_weak_motor_are_found_by_its_switch(velocity, acceleration, weak):
    """Each lies between the values number n - 1 and n of its series."""
    lost = [
        START * base * STEP**n
        for base, n in ((BASE.velocity, velocity), (BASE.acceleration, acceleration))
    ]
    known = machine()
    board = WeakMotor(known, lost[0] / STEP**0.5, lost[1] / STEP**0.5, weak)
    raised = LimitTest(board, known, "x", Control()).raised(1.0, lambda step: None)
    keys = raised.measured.keys
    assert keys["axes", "x", "max_velocity"] == pytest.approx(KEPT * lost[0], rel=0.01)
    assert keys["axes", "x", "max_acceleration"] == pytest.approx(KEPT * lost[1], rel=0.01)
    assert ("axes", "x", "max_jerk") not in keys
    first = next(trial for trial in raised.trials if abs(trial.error) > raised.allowed)
    assert first.value == pytest.approx(lost[0])
    assert "steps lost" in raised.measured.remark


class Stalling(WeakMotor):
    """A board whose motor stalls above its speed, so that the axis runs into its switch."""

    def finish(self):
        before = self.motor_steps[0][0]
        super().finish()
        if self.motor_steps[0][0] != before:
            self.stop()
            raise board_error("board-limit", "the limit switch of X was hit")


def test_an_axis_that_runs_into_its_switch_has_lost_steps():
    known = machine()
    board = Stalling(known, START * BASE.velocity * STEP**1.5, math.inf)
    raised = LimitTest(board, known, "x", Control()).raised(0.65, lambda step: None)
    errors = {trial.value: trial.error for trial in raised.trials if trial.name == "velocity"}
    assert [*errors.values()][:-1] == pytest.approx([0.0] * (len(errors) - 1), abs=raised.allowed)
    assert [*errors.values()][-1] == math.inf
    assert [*errors][-1] == pytest.approx(START * BASE.velocity * STEP**2)


def test_a_stop_ends_it_and_nothing_is_proposed():
    known, control = machine(), Control()
    board = WeakMotor(known, math.inf, math.inf)
    with pytest.raises(HomingStopped):
        LimitTest(board, known, "x", control).raised(1.3, lambda step: control.stop())


def test_an_axis_without_travel_is_refused():
    known = machine()
    axes = {"x": known.axes["x"].model_copy(update={"travel": None}), "y": known.axes["y"]}
    known = known.model_copy(update={"axes": axes})
    with pytest.raises(CncError, match="travel"):
        LimitTest(WeakMotor(machine(), 1.0, 1.0), known, "x", Control()).raised(
            1.3, lambda step: None
        )
