"""Plans that the audit refuses are made again more slowly, or with stops on corners."""

import numpy as np
import pytest

import cnc.planner.window as window_module
from cnc.model.blocks import Dwell, Held, PathMode
from cnc.model.diagnostics import MotionLimitError
from cnc.model.operator_control import Control
from cnc.path.kernels.curve import SPAN, START
from cnc.planner.acceptance import accepted_plan
from cnc.planner.audit import Audit
from cnc.planner.lookahead import MOST_CAUTION, LookAhead
from cnc.planner.plan import PlanChunk
from cnc.planner.window import MORE_SLOWLY
from tests.planner.test_random_programs import random_machine, random_program
from tests.support.planner.motions import lines, machine, path_of
from tests.support.planner.operated import (
    assert_legal_by_positions,
    assert_on_the_path,
    operate,
)
from tests.support.soak import share


@pytest.fixture
def too_fast(monkeypatch):
    """Return a function that makes the plans of all windows too fast by a factor."""

    def make(factor: float) -> None:
        def plan(path, start, goal, v_start, work):
            slower = path.under(path.limits.slower(factor))
            return accepted_plan(slower, start, goal, v_start, work)

        monkeypatch.setattr(window_module, "accepted_plan", plan)

    return make


def run(mill, blocks, control=None, rng=None) -> list[PlanChunk]:
    """Return the plans; an operator with ``rng`` makes requests at random moments."""
    ahead, plans = LookAhead(mill, control), []
    for item in ahead.plan(path_of(blocks)):
        if isinstance(item, PlanChunk):
            plans.append(item)
        elif isinstance(item, Held):
            control.resume()
        if rng is not None:
            operate(rng, control, 0.1, 1.0)
    assert not ahead.audit.violations
    return plans


def duration(plans: list[PlanChunk]) -> float:
    return sum(plan.duration for plan in plans)


@pytest.mark.parametrize("factor", [1.02, 1.2, 2.0])
def test_a_refused_plan_is_made_again_more_slowly(too_fast, factor):
    blocks = [lines([(30, 0, 0), (30, 20, 0), (0, 0, 0)], 80.0)]
    best = duration(run(machine(), blocks))
    too_fast(factor)
    plans = run(machine(), blocks)
    assert_legal_by_positions(plans, machine())
    assert_on_the_path(plans)
    assert best <= duration(plans) <= best / MORE_SLOWLY * 1.001


@pytest.mark.parametrize("seed", range(share(200, 2)))
def test_refused_plans_of_random_programs_end_in_legal_motion(too_fast, seed):
    rng = np.random.default_rng([seed, 34])
    mill = random_machine(rng)
    blocks = [b for b in random_program(rng, mill) if not isinstance(b, Dwell)]
    too_fast(10 ** rng.uniform(0.0, 0.3))
    operated = rng.random() < 0.5
    plans = run(mill, blocks, *((Control(), rng) if operated else ()))
    if plans:
        assert (plans[-1].phase_v[-1], plans[-1].phase_a[-1]) == (0.0, 0.0)
        assert_on_the_path(plans)


def test_a_plan_that_is_illegal_at_any_speed_is_an_error(too_fast):
    too_fast(1.1 / MORE_SLOWLY**MOST_CAUTION)
    with pytest.raises(MotionLimitError, match="plan-illegal"):
        run(machine(), [lines([(30, 0, 0)], 80.0)])


def test_a_refused_motion_past_a_corner_is_left_out(monkeypatch):
    """Its corner stays a stop; other corners of the same plan are passed."""
    mill = machine(axis=(2400.0, 48000.0), tangential=None, normal=None, jerk=None)
    ends = [(60, 0, 0), (60, 60, 0), (0, 60, 0), (0, 120, 0)]
    blocks = [PathMode("t.nc", 1, "blend", 0.1), lines(ends, 80.0)]
    passed, stopped = duration(run(mill, blocks)), duration(run(mill, blocks[1:]))
    examined = Audit.examined

    def past(chunk, corner):
        place = np.array(ends[corner][:2])
        timed = np.flatnonzero(chunk.path.kind == SPAN)
        start = chunk.path.data[chunk.path.at[timed, None] + START + np.arange(2)]
        return (np.abs(start - place).max(axis=1) < 5.0).any()

    for refused in ((0,), (1,), (2,), (0, 2), (0, 1, 2)):
        monkeypatch.setattr(
            Audit,
            "examined",
            lambda audit, chunk, refused=refused: (
                ([("jerk", "")], audit.copy())
                if any(past(chunk, corner) for corner in refused)
                else examined(audit, chunk)
            ),
        )
        plans = run(mill, blocks)
        assert_legal_by_positions(plans, mill)
        for corner in range(3):
            assert any(past(plan, corner) for plan in plans) == (corner not in refused)
        each = (stopped - passed) / 3
        assert duration(plans) == pytest.approx(passed + len(refused) * each, rel=1e-3)


def test_a_request_whose_plan_is_refused_waits(monkeypatch):
    """The motion goes on as before, legally, until a plan for the hold is accepted."""
    control, plans, refused = Control(), [], []
    ahead = LookAhead(machine(), control)
    made = LookAhead._requested

    def requested(self, factor):
        if factor == 0.0 and len(refused) < 2:
            refused.append(factor)
            return False
        return made(self, factor)

    monkeypatch.setattr(LookAhead, "_requested", requested)
    held = 0
    for item in ahead.plan(path_of([lines([(100, 0, 0)], 50.0)])):
        if isinstance(item, Held):
            held += 1
            control.resume()
        else:
            plans.append(item)
            if len(plans) == 3:
                control.hold()
    assert held == 1
    assert len(refused) == 2
    assert_on_the_path(plans)
