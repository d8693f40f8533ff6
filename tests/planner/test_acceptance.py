"""Refined plans are compared with the path where its samples are too far apart for them."""

import numpy as np
import pytest

from cnc.kernels.planner.phases import PHASE
from cnc.model.diagnostics import MotionLimitError
from cnc.planner.intervals import REFINED, intervals_of
from cnc.planner.phases import cut_at_length
from tests.support.planner.hairpins import duration
from tests.support.soak import share

WRONG = 0.95
"""Wrong samples have the derivatives of the path times this."""


SEEDS = (0, 2, 3)


@pytest.fixture
def wrong_samples(monkeypatch):
    """Let the usual intervals have samples that are wrong, and that are said to be unreliable."""

    def cut(path, limits, before, after, refined):
        known = intervals_of(path, limits, before, after, refined)
        if refined > REFINED:
            return known
        return known._replace(samples=WRONG * known.samples, reliable=np.zeros_like(known.reliable))

    monkeypatch.setattr("cnc.planner.section.intervals_of", cut)


def test_plans_from_wrong_samples_are_illegal(wrong_samples, monkeypatch):
    monkeypatch.setattr("cnc.planner.acceptance.exceeding_sections", lambda *_: [])
    monkeypatch.setattr("cnc.planner.lookahead.MOST_CAUTION", 0)
    with pytest.raises(MotionLimitError, match="plan-illegal"):
        _ = [duration(seed) for seed in SEEDS]


# One is enough in every run: each seed is 5 % slower without the finer intervals, see below.
@pytest.mark.parametrize("seed", share(SEEDS, SEEDS[2:3]))
def test_a_plan_from_wrong_samples_is_made_again_from_finer_intervals(seed, request):
    usual = duration(seed)
    request.getfixturevalue("wrong_samples")
    assert duration(seed) == pytest.approx(usual, rel=0.02)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_plan_is_not_refined_where_no_intervals_are_finer(seed, request, monkeypatch):
    usual = duration(seed)
    request.getfixturevalue("wrong_samples")
    monkeypatch.setattr("cnc.planner.section.FINEST", 0.0)
    assert duration(seed) > 1.05 * usual


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
