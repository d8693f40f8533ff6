"""Length of the window: a longer one saves little time, and memory and cost are bounded."""

import tracemalloc

import numpy as np
import pytest

import cnc.planner.acceptance
from cnc.model.blocks import Block, Polyline
from cnc.model.operator_control import Control
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.planner.window import LONG, STOPS_KNOWN, Window
from tests.support.planner.motions import arc, lines, machine, nurbs, path_of
from tests.support.soak import share


def chain(rng: np.random.Generator) -> list[Block]:
    """A finishing pass: 6000 moves that turn a little."""
    turn = 0.4 * np.sin(np.arange(6000) * 0.02) + rng.normal(0, 1e-4, 6000)
    return [
        lines(
            np.cumsum(0.15 * np.stack((np.cos(turn), np.sin(turn), 0 * turn), axis=1), axis=0),
            120.0,
        )
    ]


def straight(_: np.random.Generator) -> list[Block]:
    """Straight on, in moves of feeds that change."""
    points = np.zeros((4000, 3))
    points[:, 0] = np.linspace(0.25, 1000, 4000)
    feeds = 150.0 + 100.0 * np.sin(np.arange(4000) * 0.003)
    return [Polyline("t.nc", 1, points, feeds, np.arange(1, 4001, dtype=np.int32))]


def arcs(rng: np.random.Generator) -> list[Block]:
    """A hundred tangent half circles of many sizes."""
    blocks, here, sense = [], np.zeros(3), 1
    for line in range(1, 101):
        radius = 10 ** rng.uniform(-0.3, 1.3)
        bow = arc(here, (here[0] + radius, here[1]), sense * 0.5, 200.0, line=line)
        blocks.append(bow)
        here, sense = bow.end, -sense
    return blocks


def splines(rng: np.random.Generator) -> list[Block]:
    """One long curve."""
    points = np.concatenate(([np.zeros(3)], np.cumsum(rng.normal(4, 4, (300, 3)), axis=0)))
    return [nurbs(points, feed=200.0)]


def seconds(blocks, mill, stops_known) -> float:
    chunks = [
        item
        for item in LookAhead(mill, stops_known=stops_known).plan(path_of(blocks))
        if isinstance(item, PlanChunk)
    ]
    return chunks[-1].t0 + chunks[-1].duration


@pytest.mark.parametrize("make", [chain, straight, arcs, *share([splines], [])][:: share(1, 2)])
@pytest.mark.parametrize("axis", [None, (2400.0, 48000.0)])
def test_a_window_ten_times_longer_changes_the_time_by_less_than_a_hundredth(
    make, axis, monkeypatch
):
    # Chunks of few pieces, so that the window is as short as it may be.
    monkeypatch.setattr("cnc.path.block_pieces.MOST_PIECES", 32)
    blocks, mill = make(np.random.default_rng(3)), machine(axis=axis)
    short, long = (seconds(blocks, mill, STOPS_KNOWN * times) for times in (1.0, 10.0))
    assert short == pytest.approx(long, rel=0.01)


def test_each_stretch_is_planned_about_twice(monkeypatch):
    monkeypatch.setattr("cnc.path.block_pieces.MOST_PIECES", 64)
    planned, cut = [0], [0]
    plan, add = cnc.planner.acceptance.plan_to_rest, Window.add

    def counted(start, known, *others, **options):
        planned[0] += len(known.end)
        return plan(start, known, *others, **options)

    def added(self, *chunk):
        before = self._plan.arrived
        add(self, *chunk)
        cut[0] += self._plan.arrived - before

    monkeypatch.setattr(cnc.planner.acceptance, "plan_to_rest", counted)
    monkeypatch.setattr(Window, "add", added)
    for make in (chain, straight, splines):
        planned[0] = cut[0] = 0
        seconds(make(np.random.default_rng(4)), machine(), STOPS_KNOWN)
        assert planned[0] <= 2.1 * cut[0]


def test_memory_does_not_grow_with_the_path():
    def endless(count: int):
        for k in range(count):
            x = 600.0 * k + np.arange(1, 4001) * 0.15
            yield lines(np.stack((x, np.sin(x / 20.0), 0 * x), axis=1), 25.0, 4000 * k + 1)

    def peak(count: int) -> int:
        ahead = LookAhead(machine(chord_error=0.01))
        tracemalloc.start()
        for _ in ahead.plan(path_of(endless(count))):
            pass
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    peak(2)
    few = share(10, 4)
    assert peak(3 * few) <= 1.2 * peak(few)


def test_slow_motion_is_not_cut_by_time_where_nobody_may_change_it():
    """A check has a control for its feed override, too; its slices are as long as without one."""
    blocks = [lines([(1.0, 0.0, 0.0)], 1e-5)]
    plain = list(LookAhead(machine()).plan(path_of(blocks)))
    checked = list(LookAhead(machine(), Control(), slice_s=LONG).plan(path_of(blocks)))
    assert [chunk.duration for chunk in checked] == [chunk.duration for chunk in plain]
    assert min(chunk.duration for chunk in checked[1:-1]) > 10.0 * LONG


def test_slices_are_short_with_an_operator():
    blocks = [lines([(300, 0, 0)], 50.0), arc((300, 0, 0), (300, 50), 1.0, 50.0)]
    plain = list(LookAhead(machine()).plan(path_of(blocks)))
    sliced = list(LookAhead(machine(), Control()).plan(path_of(blocks)))
    assert len(plain) < 5
    assert max(chunk.duration for chunk in sliced) <= 0.151
    assert sum(chunk.duration for chunk in sliced) == pytest.approx(
        sum(chunk.duration for chunk in plain), rel=1e-12
    )
