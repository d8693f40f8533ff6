"""Cost of the search for the fastest motion: what is done again after a limit was exceeded."""

import numpy as np
import pytest

from cnc.api import from_text, plan
from cnc.model.blocks import Block, Dwell, PathMode
from cnc.path.chunk import PathChunk
from cnc.planner import known_path as intervals_module
from cnc.planner import phases as phases_module
from cnc.planner import slowing
from cnc.planner.kernels import fastest, refine
from cnc.planner.kernels.cells import Stretch, describe, plan_cells
from cnc.planner.kernels.descent import STEP, STEPS, TOUCH, centre
from cnc.planner.kernels.examination import examine
from cnc.planner.kernels.refine import sum_limits
from cnc.planner.known_path import STANDSTILL, intervals_of
from cnc.planner.limits import Limits
from cnc.planner.phases import plan_to_rest
from tests.support.planner.motions import lines, machine, path_of
from tests.support.planner.operated import driven
from tests.support.planner.requests import FAMILIES, plans_of, random_program
from tests.support.soak import share


def bends(seed: int) -> PathChunk:
    """Return the fitted path of random bends in short moves."""
    random = np.random.default_rng(seed)
    heading = np.cumsum(random.normal(0.0, 0.5, 60))
    steps = 10 ** random.uniform(-1.0, 0.2, 60)
    moves = np.stack((steps * np.cos(heading), steps * np.sin(heading), 0.0 * steps), axis=1)
    blocks = [PathMode("t.nc", 1, "blend", 0.02), lines(np.cumsum(moves, axis=0), 50.0)]
    chunks = [item for item in path_of(blocks) if isinstance(item, PathChunk)]
    return chunks[0]


@pytest.mark.parametrize("seed", range(6)[:: share(1, 2)])
def test_the_descent_does_not_begin_anew_where_a_limit_is_exceeded(seed, monkeypatch):
    limits = Limits.of(machine(axis=(1000.0, 50_000.0)))
    known = intervals_of(bends(seed), limits, STANDSTILL, STANDSTILL)
    _, phases = plan_to_rest(0.0, known, 0.0, limits)
    sums = sum_limits(limits.arrays)
    first_rest = int(np.flatnonzero(np.append(phases["v"][1:], 0.0) == 0.0)[0]) + 1
    end = float(phases["s"][first_rest]) if first_rest < len(phases) else float(known.end[-1])
    cells = plan_cells(Stretch(phases, 0, first_rest, end, 0.0, False), known, sums)
    describe(cells, known)
    weights, used = [], []

    def counted(*arguments):
        weights.append(arguments[4])
        return centre(*arguments)

    def examined(*arguments):
        used.append(examine(*arguments))
        return used[-1]

    monkeypatch.setattr(fastest, "centre", counted)
    monkeypatch.setattr(fastest, "examine", examined)
    left = np.full(1, np.inf)
    solved, _ = fastest.search.py_func(cells, known, sums, fastest.WEIGHT_STEP, left)
    assert solved
    assert used[0] > 1.0 + TOUCH, "the case shows nothing"
    assert weights.count(fastest.FIRST_WEIGHT) == 1
    # Only motions of the last step are examined, the last of them with success.
    assert len(used) == weights.count(fastest.LAST_WEIGHT)
    assert used[-1] <= 1.0 + TOUCH


def test_each_window_of_a_chain_with_many_feeds_has_a_result(monkeypatch):
    """The plan is at its feed where a window ends: there the window uses all of the limits.

    A window without a result takes eight times as long as another one.
    """
    random, angles = np.random.default_rng(4), 0.01 * np.arange(1400)
    text = ["G21 G90 G94 G64 P0.01", "F1000"]
    for t in angles:
        feed = random.uniform(700.0, 1300.0)
        x, y = 100.0 + 40.0 * np.cos(t), 100.0 + 40.0 * np.sin(1.3 * t)
        text.append(f"G1 X{x:.3f} Y{y:.3f} F{feed:.1f}")
    solved = []
    search = refine.fastest

    def counted(*arguments):
        found = search(*arguments)
        solved.append(found[0])
        return found

    monkeypatch.setattr(refine, "fastest", counted)
    monkeypatch.setattr(refine, "refine_stretch", refine.refine_stretch.py_func)
    monkeypatch.setattr(phases_module, "refine", refine.refine.py_func)
    for _ in plan(from_text("\n".join([*text, "M2"]))):
        pass
    assert len(solved) > 20, "the case shows nothing"
    assert all(solved)


@pytest.mark.parametrize("stop", [None, 20])
def test_pieces_are_cut_once_where_their_intervals_need_more_space(stop, monkeypatch):
    """Tight bends have many intervals. The result is the same in space that was large enough."""
    path, limits = bends(3), Limits.of(machine(axis=(1000.0, 50_000.0)))
    if stop is not None:
        path.stop_after[stop] = True
    done = []
    cut, space = intervals_module.chunk_intervals, intervals_module._space

    def counted(*arguments):
        done.append(cut(*arguments))
        return done[-1]

    monkeypatch.setattr(intervals_module, "chunk_intervals", counted)
    monkeypatch.setattr(intervals_module, "_space", lambda count, axes: space(100 * count, axes))
    whole = intervals_of(path, limits, STANDSTILL, STANDSTILL, begin=1.0)
    assert done == [(len(path), len(whole.end))]
    done.clear()
    small = len(whole.end) // 10
    sizes = iter([small, 3 * small, 20 * small])
    monkeypatch.setattr(intervals_module, "_space", lambda count, axes: space(next(sizes), axes))
    found = intervals_of(path, limits, STANDSTILL, STANDSTILL, begin=1.0)
    assert len(done) == 3
    assert min(pieces for pieces, _ in done) > 0
    assert np.sum(done, axis=0).tolist() == [len(path), len(whole.end)]
    for array, expected in zip(found, whole, strict=True):
        assert np.array_equal(array, expected)


def zigzag() -> tuple[PathChunk, Limits]:
    """Return a zigzag below the tolerance: thousands of short bends a second, and hardly a gain."""
    moves = np.arange(1, 301)
    corners = np.stack((0.05 * moves, 0.05 * (moves % 2), 0.0 * moves), axis=1)
    blocks = [PathMode("t.nc", 1, "blend", 0.025), lines(corners, 85.0)]
    path = next(item for item in path_of(blocks) if isinstance(item, PathChunk))
    return path, Limits.of(machine(tangential=1000.0, jerk=10_000.0))


def steps_counted(monkeypatch) -> list[float]:
    """Record the computing time of each descent, s."""
    taken = []

    def counted(*arguments):
        before = arguments[-1][0]
        worst = centre(*arguments)
        taken.append(before - arguments[-1][0])
        return worst

    monkeypatch.setattr(fastest, "centre", counted)
    monkeypatch.setattr(fastest, "search", fastest.search.py_func)
    monkeypatch.setattr(refine, "fastest", fastest.fastest.py_func)
    return taken


def test_a_stretch_takes_no_more_steps_than_its_time_allows(monkeypatch):
    """The last descent and the examination behind it may be over. A failed window counts, too."""
    path, limits = zigzag()
    known = intervals_of(path, limits, STANDSTILL, STANDSTILL)
    _, phases = plan_to_rest(0.0, known, 0.0, limits)
    taken = steps_counted(monkeypatch)
    stretch = Stretch(phases, 0, len(phases), float(known.end[-1]), 0.0, False)
    out = np.empty(8 * len(phases) + 4096, phases.dtype)
    left = np.full(1, 0.02)
    legal, out, count = refine.refine_stretch.py_func(
        stretch, known, sum_limits(limits.arrays), left, out, 0
    )
    assert legal
    assert len(taken) > 1, "the case shows nothing"
    assert sum(taken[:-1]) <= 0.02
    assert left[0] <= 0.0
    assert out[:count]["duration"].sum() <= phases["duration"].sum()


@pytest.mark.parametrize("seed", share(range(4), [2]))
def test_a_stretch_with_too_many_cells_is_refined_as_far_as_its_time_allows(seed):
    """Half of the cells give about half of the gain; behind them the plan stays."""
    petals, size = np.random.default_rng(seed).uniform((4.0, 6.0), (6.0, 9.0))
    turn = np.linspace(0.0, 36.0, 3000)
    radius = size * (1.0 + 0.5 * np.cos(petals * turn))
    points = np.stack((radius * np.cos(turn), radius * np.sin(turn), 0.0 * turn), axis=1)
    blocks = [PathMode("t.nc", 1, "blend", 0.01), lines(points - points[0], 100.0)]
    path = next(item for item in path_of(blocks) if isinstance(item, PathChunk))
    limits = Limits.of(machine(axis=(1000.0, 20_000.0)))
    known = intervals_of(path, limits, STANDSTILL, STANDSTILL)
    _, phases = plan_to_rest(0.0, known, 0.0, limits)
    stretch = Stretch(phases, 0, len(phases), float(known.end[-1]), 0.0, False)
    cells = len(plan_cells(stretch, known, sum_limits(limits.arrays)).length)
    assert cells > 4 * refine.WINDOW, "the case shows nothing"
    times, whole = [], 0.0
    for part in (1.0, 0.0, 0.5):
        left = np.full(1, part * whole if whole else 1e3)
        out = np.empty(8 * len(phases) + 8192, phases.dtype)
        legal, out, count = refine.refine_stretch(
            stretch, known, sum_limits(limits.arrays), left, out, 0
        )
        assert legal
        # No more than a descent and an examination of a window are over.
        assert left[0] > -(refine.WINDOW + refine.OVERLAP) * (STEPS * STEP + fastest.EXAMINATION)
        whole = whole or 1e3 - float(left[0])
        times.append(float(out[:count]["duration"].sum()))
        assert (np.diff(out[:count]["s"]) > 0.0).all()
    all_of_it, none, half = times
    assert none == pytest.approx(float(phases["duration"].sum()), rel=1e-12)
    gain = none - all_of_it
    assert gain > 0.02 * none, times
    assert none - half > 0.3 * gain


def test_corners_of_micrometres_in_five_axes_have_few_intervals(monkeypatch, tmp_path):
    """Cut for twice the speed at which they are crossed they were 229 000, for the same motion."""
    cut = []

    def counted(*arguments):
        intervals = intervals_of(*arguments)
        cut.append(len(intervals.end))
        return intervals

    monkeypatch.setattr(intervals_module, "intervals_of", counted)
    rng = np.random.default_rng([30131501, FAMILIES.index("five axes"), 0])
    plans = plans_of(random_program("five axes", rng, tmp_path), 100.0)
    assert sum(cut) < 120_000
    assert plans[-1].t0 + plans[-1].duration < 14.0


@pytest.mark.parametrize("seed", range(share(12, 3)))
def test_a_request_on_straight_moves_seeks_no_slower_clock_again_and_again(seed, monkeypatch):
    """Each search takes up to 0.3 s. There were 20 to 41, while the board waited for the plan."""
    tries = []
    copy = slowing.slower_copy
    monkeypatch.setattr(slowing, "slower_copy", lambda *given: (tries.append(0), copy(*given))[1])
    rng = np.random.default_rng([seed, 20261201])
    blocks: list[Block] = []
    place = np.zeros(3)
    for _ in range(4):
        place = place + [*rng.uniform(-8.0, 8.0, 2), 0.0]
        blocks += [lines(tuple(place)), Dwell("t.nc", 2, 0.1)]
    for number in range(1, 9):
        for percent in (10.0, 50.0):

            def slower(control, chunks, held, at=number, to=percent):
                if len(chunks) == at:
                    control.override(to)

            tries.clear()
            driven(blocks, machine(), slower)
            assert len(tries) <= 2, (number, percent)
