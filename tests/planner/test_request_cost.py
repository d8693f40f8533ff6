"""Cost of a hold or an override: only what it needs is cut into intervals and refined."""

import math
from dataclasses import replace

import numpy as np
import pytest

import cnc.planner.known_path as section_module
from cnc.model.blocks import PathMode
from cnc.path.chunk import PathChunk
from cnc.planner import slowing
from cnc.planner.kernels import fastest
from cnc.planner.kernels.arrays import PHASE
from cnc.planner.kernels.cells import Stretch, describe, plan_cells
from cnc.planner.kernels.descent import centre
from cnc.planner.kernels.refine import refine, sum_limits
from cnc.planner.known_path import STANDSTILL, KnownPath, between, intervals_of
from cnc.planner.limits import Limits
from cnc.planner.phases import plan_to_rest
from cnc.planner.slowing import Request, slower_plan
from tests.support.planner.motions import arc, lines, machine, path_of


def chunks_of(blocks) -> list[PathChunk]:
    return [item for item in path_of(blocks) if isinstance(item, PathChunk)]


def bent_path(seed: int) -> PathChunk:
    """Return lines, arcs and corners with stops."""
    rng = np.random.default_rng(seed)
    here, blocks = np.zeros(3), [PathMode("t.nc", 1, "exact-path")]
    for _ in range(8):
        there = here + rng.normal(0.0, 6.0, 3)
        blocks.append(lines([there], 10 ** rng.uniform(1.0, 2.0)))
        centre = there[:2] + rng.normal(0.0, 3.0, 2)
        blocks.append(arc(there, centre, rng.uniform(0.1, 0.9)))
        here = np.asarray(blocks[-1].end)
    (chunk,) = chunks_of(blocks)
    return chunk


@pytest.mark.parametrize("seed", range(6))
def test_intervals_of_a_part_of_a_chunk_are_those_of_the_whole_chunk(seed, monkeypatch):
    chunk, rng = bent_path(seed), np.random.default_rng(seed)
    limits = Limits.of(machine(axis=(800.0, 9000.0)))
    path = KnownPath(limits)
    path.add(chunk, None, None)
    other = replace(limits, feed_factor=0.4)
    whole = intervals_of(chunk, other, STANDSTILL, STANDSTILL)
    ends = np.cumsum(chunk.length)
    pieces = []
    real = section_module.intervals_of
    monkeypatch.setattr(
        section_module, "intervals_of", lambda part, *rest: pieces.append(part) or real(part, *rest)
    )
    ranges = [tuple(sorted(rng.uniform(0.0, ends[-1], 2))) for _ in range(20)]
    ranges += [(0.0, ends[3]), (ends[1], ends[4]), (ends[-2], ends[-1])]
    for start, stop in ranges:
        found, expected = path.intervals(other, start, stop), between(whole, start + 1e-11, stop)
        for mine, wanted in zip(found, expected, strict=True):
            np.testing.assert_array_equal(mine, wanted)
        most = np.searchsorted(ends, stop + 1e-6) - np.searchsorted(ends, start - 1e-6) + 1
        assert len(pieces.pop()) <= most


def test_a_legal_plan_on_a_straight_path_is_kept_where_it_may_be_illegal():
    mill = machine(axis=(800.0, 9000.0))
    limits = Limits.of(mill)
    (chunk,) = chunks_of([PathMode("t.nc", 1, "exact-path"), lines([(30.0, 0.0, 0.0)], 50.0)])
    known = intervals_of(chunk, limits, STANDSTILL, STANDSTILL)
    known = known._replace(flat=np.zeros_like(known.flat))
    _, phases = plan_to_rest(0.0, known, 0.0, limits)
    unlimited = np.full(1, np.inf)
    legal, kept = refine(phases, known, limits.arrays, True, unlimited)
    assert legal
    cruise = int(np.argmax(phases["duration"]))
    assert len(kept) <= len(phases) + 2  # the cruise is in up to three parts
    assert kept[0] == phases[0]
    assert kept["duration"].sum() == pytest.approx(phases["duration"].sum(), rel=1e-12)
    assert kept["v"].max() == phases[cruise]["v"]
    # one that is illegal is not kept
    ahead, accel = 30.0 * 0.5, 3.0 * 800.0
    fast = np.array(
        [
            (math.sqrt(2.0 * ahead / accel), 0.0, 0.0, accel, 0.0),
            (math.sqrt(2.0 * ahead / accel), ahead, math.sqrt(2.0 * ahead * accel), -accel, 0.0),
        ],
        PHASE,
    )
    legal, found = refine(fast, known, limits.arrays, True, unlimited)
    assert not legal or found["v"].max() < fast["v"].max()


def test_a_plan_that_gains_nothing_is_not_cut_further_by_each_request():
    """A refinement cuts a phase into up to ten; without a gain the phases stay as they are."""
    limits = Limits.of(machine(axis=(1000.0, 50_000.0)))
    (chunk,) = chunks_of(
        [PathMode("t.nc", 1, "exact-path"), arc((0.0, 0.0, 0.0), (0.0, 10.0), 0.9, 100.0)]
    )
    path = KnownPath(limits)
    path.add(chunk, None, None)
    goal = float(chunk.length.sum())
    _, plan = plan_to_rest(0.0, path.intervals(limits, 0.0, goal), 0.0, limits)
    once = slower_plan(Request(path, plan, 0.0, goal, False, False), 0.0)
    twice = slower_plan(Request(path, once.phases, 0.0, goal, False, False), 0.0)
    np.testing.assert_array_equal(twice.phases, once.phases)


def descents_of(ramp, known, limits, monkeypatch) -> tuple[bool, int]:
    """Return whether a ramp is brought inside the limits, and the number of descents for it."""
    made = 0

    def counted(*arguments):
        nonlocal made
        made += 1
        return centre(*arguments)

    monkeypatch.setattr(fastest, "centre", counted)
    monkeypatch.setattr(fastest, "search", fastest.search.py_func)
    stretch = Stretch(ramp, 0, len(ramp), float(known.end[-1]), 0.0, True)
    sums = sum_limits(limits.arrays)
    cells = plan_cells(stretch, known, sums)
    describe(cells, known)
    legal, _ = fastest.fastest.py_func(cells, known, sums, np.full(1, np.inf))
    return legal, made


@pytest.mark.parametrize(("length", "possible"), [(4.0, True), (0.5, False)])
def test_a_ramp_that_is_too_short_is_given_up_soon(length, possible, monkeypatch):
    limits = Limits.of(machine(axis=(1000.0, 50_000.0)))
    (chunk,) = chunks_of(
        [PathMode("t.nc", 1, "exact-path"), arc((0.0, 0.0, 0.0), (0.0, 10.0), 0.9, 100.0)]
    )
    whole = intervals_of(chunk, limits, STANDSTILL, STANDSTILL)
    # In v^2 / (2 a) no motion stops, with any jerk.
    v, s = 60.0, length * 60.0**2 / 2000.0
    ramp = np.array([(2.0 * s / v, 0.0, v, -0.5 * v * v / s, 0.0)], PHASE)
    legal, made = descents_of(ramp, between(whole, 0.0, s), limits, monkeypatch)
    assert legal == possible
    assert made <= 20


def test_the_ramps_that_are_tried_for_a_lower_feed_are_few(monkeypatch):
    """On a plan that no clock slows, each ramp makes some way and leaves more to do."""
    count = 0

    def little(plan, *_):
        nonlocal count
        count += 1
        return 1, plan, 0.98

    monkeypatch.setattr(slowing, "slower_copy", little)
    plan = np.array([(0.001, 0.1 * k, 100.0, 0.0, 0.0) for k in range(1000)], PHASE)
    chunk = bent_path(1)
    path = KnownPath(Limits.of(machine(axis=(800.0, 9000.0))))
    path.add(chunk, None, None)
    known = path.intervals(path.limits, 0.0, float(chunk.length.sum()))
    calm = known._replace(flat=np.zeros_like(known.flat))
    assert slowing.copy_by_clock(plan, 0.2, calm, path.limits.arrays, 0.1) is None
    assert count == slowing.MOST_RAMPS
