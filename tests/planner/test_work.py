"""Searches take no more computing time than the motion allows, by the count of their steps."""

import math

import numpy as np
import pytest

from cnc.api import InlineProgram, from_text, plan
from cnc.machine.models import Axis, Machine, PathLimits
from cnc.planner import corner_choice, corner_motions, lookahead, phases
from cnc.planner.plan import PlanChunk
from cnc.planner.work import FIRST, FIRST_OF_TRIALS, RATE, RATE_OF_TRIALS, Work
from tests.support.soak import share


def test_what_is_left_of_a_long_motion_is_not_kept():
    work = Work(0.5, 0.1)
    work.left[0] = -1.0
    work.reach(4.0)
    assert work.left[0] == pytest.approx(-0.6)
    work.reach(3.0)
    assert work.left[0] == pytest.approx(-0.6)
    work.reach(1000.0)
    assert work.left[0] == 0.5


def test_a_request_allows_what_is_allowed_at_first():
    work = Work(0.5, 0.1)
    work.left[0] = -1.0
    work.begin_again()
    assert work.left[0] == 0.5
    work.left[0] = 2.0
    work.begin_again()
    assert work.left[0] == 2.0


def test_motion_that_is_not_under_way_is_a_loan():
    work = Work(0.5, 0.1)
    with work.ahead(10.0):
        assert work.left[0] == 1.5
        work.left -= 1.2
    assert work.left[0] == pytest.approx(-0.7)


def test_the_accounts_allow_a_tenth_of_the_motion():
    assert RATE + RATE_OF_TRIALS <= 0.1
    assert FIRST + FIRST_OF_TRIALS <= 0.9


def random_polygon(rng: np.random.Generator) -> tuple[InlineProgram, Machine]:
    """Return a polygon of short legs, and a machine: limits of axes, along the path, or both."""
    accel, family = 10 ** rng.uniform(3.0, 4.0), rng.integers(3)
    jerk, tolerance = accel * 10 ** rng.uniform(1.0, 2.0), 10 ** rng.uniform(-3.0, -1.0)
    axis = Axis(
        steps_per_mm=200.0,
        max_velocity=300.0,
        max_acceleration=accel if family < 2 else None,
        max_jerk=jerk if family == 0 else None,
    )
    along = PathLimits(
        max_feed=300.0,
        max_jerk=jerk if family else None,
        max_tangential_acceleration=accel if family == 2 else None,
        max_normal_acceleration=accel if family == 2 else None,
    )
    moves = int(rng.integers(60, 160))
    heading = np.cumsum(rng.uniform(-math.pi, math.pi, moves))
    legs = tolerance * rng.uniform(3.0, 24.0) * 10 ** rng.uniform(-0.5, 0.5, moves)
    points = np.cumsum(legs * np.stack((np.cos(heading), np.sin(heading))), axis=1)
    text = [f"G21 G90 G94 G64 P{tolerance:.5f}", f"F{60.0 * 10 ** rng.uniform(1.0, 2.5):.1f}"]
    text += [f"G1 X{x:.5f} Y{y:.5f}" for x, y in points.T]
    return from_text("\n".join([*text, "M2"])), Machine(axes=dict.fromkeys("xyz", axis), path=along)


LITTLE = 0.02
"""s, and s of computing time by the motion, so that all programs are at the bound."""

ONE_STEP = 0.1
"""s; a search that has begun may be over by one step. That of a motion past corners is long."""


@pytest.mark.parametrize("seed", range(share(40, 3)))
def test_no_program_takes_more_computing_time_than_its_motion_allows(seed, monkeypatch):
    """Without the account they take more."""
    taken = [0.0]

    def counted(module, name, left_of):
        kernel = getattr(module, name)

        def count(*arguments):
            left = left_of(arguments)
            before = float(left[0])
            result = kernel(*arguments)
            taken[0] += before - float(left[0])
            return result

        monkeypatch.setattr(module, name, count)

    counted(phases, "refine", lambda arguments: arguments[4])
    counted(corner_motions, "pass_corners", lambda arguments: arguments[6].left)
    program, mill = random_polygon(np.random.default_rng([20261130, seed]))
    for module in (lookahead, corner_choice):
        monkeypatch.setattr(module, "Work", lambda *_: Work(LITTLE, LITTLE))
    items = plan(program, mill)
    motion = sum(item.duration for item in items if isinstance(item, PlanChunk))
    # The planner and the trials before it have an account each.
    assert taken[0] <= 2.0 * LITTLE * (1.0 + motion) + ONE_STEP
