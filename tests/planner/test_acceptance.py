"""Refined plans are compared with the path where its samples are too far apart for them."""

from functools import cache

import numpy as np
import pytest

from cnc.model.blocks import PathMode
from cnc.model.diagnostics import MotionLimitError
from cnc.planner.acceptance import accepted_plan
from cnc.planner.kernels.arrays import PHASE
from cnc.planner.known_path import REFINED, KnownPath, intervals_of
from cnc.planner.limits import Limits
from cnc.planner.phases import cut_at_length
from cnc.planner.work import Work
from tests.support.planner.hairpins import duration
from tests.support.planner.motions import arc, lines, machine, path_of
from tests.support.soak import share

WRONG = 0.95
"""Wrong samples have the derivatives of the path times this."""


SEEDS = (0, 2, 3)


@cache
def usual_duration(seed: int) -> float:
    """Return the duration of the plan from right samples, s."""
    return duration(seed)


@pytest.fixture
def wrong_samples(monkeypatch):
    """Let the usual intervals have samples that are wrong, and that are said to be unreliable."""

    def cut(path, limits, before, after, refined, begin):
        known = intervals_of(path, limits, before, after, refined, begin)
        if refined > REFINED:
            return known
        return known._replace(samples=WRONG * known.samples, reliable=np.zeros_like(known.reliable))

    monkeypatch.setattr("cnc.planner.known_path.intervals_of", cut)


def test_plans_from_wrong_samples_are_illegal(wrong_samples, monkeypatch):
    monkeypatch.setattr("cnc.planner.acceptance.exceeding_sections", lambda *_: [])
    monkeypatch.setattr("cnc.planner.lookahead.MOST_CAUTION", 0)
    with pytest.raises(MotionLimitError, match="plan-illegal"):
        _ = [duration(seed) for seed in SEEDS]


# One is enough in every run: each seed is 5 % slower without the finer intervals, see below.
@pytest.mark.parametrize("seed", share(SEEDS, SEEDS[2:]))
def test_a_plan_from_wrong_samples_is_made_again_from_finer_intervals(seed, request):
    usual = usual_duration(seed)
    request.getfixturevalue("wrong_samples")
    assert duration(seed) == pytest.approx(usual, rel=0.02)


@pytest.mark.parametrize("seed", share(SEEDS, SEEDS[2:]))
def test_a_plan_is_not_refined_where_no_intervals_are_finer(seed, request, monkeypatch):
    usual = usual_duration(seed)
    request.getfixturevalue("wrong_samples")
    monkeypatch.setattr("cnc.planner.known_path.FINEST", 0.0)
    assert duration(seed) > 1.05 * usual


def test_a_motion_that_rested_beside_a_junction_speeds_up_in_finite_time():
    """Beside the junction of a line and an arc the speed has to be constant: no motion begins."""
    blocks = [PathMode("", 1, "exact-path"), lines([[10.0, 0.0, 0.0]])]
    blocks.append(arc((10.0, 0.0, 0.0), (10.0, 1.0), 0.5))
    limits = Limits.of(machine(axis=(1000.0, 10_000.0)))
    path = KnownPath(limits)
    (chunk,) = path_of(blocks)
    path.add(chunk, None, None)
    known = path.intervals(limits, 0.0, float(chunk.length.sum()))
    level = np.flatnonzero(known.flat & (known.speed > 0.0))
    start = float(known.end[level[0]]) - 1e-6
    goal, _ = path.goal(start)
    _, phases, _ = accepted_plan(path, start, goal, 0.0, Work())
    seconds = float(phases["duration"].sum())
    _, later, _ = accepted_plan(path, float(known.end[level[-1]]) + 1e-6, goal, 0.0, Work())
    assert seconds < 1.2 * float(later["duration"].sum())


@pytest.mark.parametrize(("place", "before"), [(1.0, 1), (1.0 + 1e-13, 1), (1.0 - 1e-12, 1)])
def test_a_cut_at_the_end_of_a_phase_leaves_no_phase_of_no_length(place, before):
    phases = np.array([(0.5, 0.0, 2.0, 0.0, 0.0), (0.1, 1.0, 2.0, 0.0, 300.0)], PHASE)
    head, tail = cut_at_length(phases, place)
    assert (len(head), len(tail)) == (before, 2 - before)
    assert tail[0]["duration"] == 0.1


def test_a_cut_inside_a_phase_is_exact():
    phases = np.array([(0.5, 0.0, 2.0, 0.0, 0.0), (0.1, 1.0, 2.0, 0.0, 300.0)], PHASE)
    head, tail = cut_at_length(phases, 0.25)
    assert head["duration"] == pytest.approx([0.125])
    assert tail["duration"] == pytest.approx([0.375, 0.1])
    assert tail[0]["s"] == 0.25
