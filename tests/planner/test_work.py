"""Searches take no more computing time than the motion allows, by the count of their steps."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cnc.api import InlineProgram, from_text, plan
from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import PathMode
from cnc.path.chunk import PathChunk
from cnc.planner import corner_choice, corner_motions, lookahead, phases, slowing
from cnc.planner.acceptance import accepted_plan
from cnc.planner.kernels.lookahead import START_TOO_FAST
from cnc.planner.kernels.refine import refine
from cnc.planner.known_path import KnownPath
from cnc.planner.limits import Limits
from cnc.planner.plan import PlanChunk
from cnc.planner.work import FIRST, FIRST_OF_TRIALS, RATE, RATE_OF_TRIALS, Work
from tests.support.planner.motions import lines, machine, path_of
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


def waves(length: float) -> tuple[KnownPath, int]:
    """Return a path of waves so long, mm, and the number of its intervals."""
    x = np.arange(0.0, length, 0.2)
    points = np.stack((x, 0.3 * np.sin(x), 0.0 * x), axis=1)[1:]
    blocks = [PathMode("t.nc", 1, "blend", 0.01), lines(points, 50.0)]
    path = KnownPath(Limits.of(machine(axis=(1000.0, 20_000.0))))
    for item in path_of(blocks):
        assert isinstance(item, PathChunk)
        path.add(item, None, None)
    return path, sum(len(section.intervals.end) for section in path.sections)


def test_a_try_to_plan_that_fails_costs_little():
    """Behind a request they are many. Counted as searches, they left a plan 1.6 s behind."""
    path, intervals = waves(60.0)
    work = Work(1.0)
    goal, _ = path.goal(0.0)
    status, _, _ = accepted_plan(path, 0.0, goal, 500.0, work)
    assert status == START_TOO_FAST
    assert 1.0 - work.left[0] < 0.5e-6 * intervals


def test_a_longer_plan_behind_a_request_is_refined_for_longer(monkeypatch):
    allowed = []

    def counted(*arguments):
        allowed.append(float(arguments[4][0]))
        return refine(*arguments)

    monkeypatch.setattr(slowing, "refine", counted)
    for length in (60.0, 240.0):
        path, _ = waves(length)
        goal, _ = path.goal(0.0)
        _, plan, _ = accepted_plan(path, 0.0, goal, 0.0, Work())
        seconds = float(plan["duration"].sum())
        slower = path.under(replace(path.limits, feed_factor=0.999))
        assert slowing.slower_plan(slowing.Request(slower, plan, 0.0, goal, True, False), 0.0)
        assert allowed.pop() == pytest.approx(FIRST + phases.BEFORE * RATE * seconds, rel=1e-2)


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
