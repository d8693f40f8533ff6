"""Reference pulses where the path lies on a half-grid line, turns back on it or grazes it."""

from __future__ import annotations

import numpy as np
import pytest

from cnc.model.streams import PulseChunk
from cnc.pulses import reference_pulse
from cnc.pulses.reference_pulse import ReferencePulse
from tests.support.pulses.plans import arc, cut, path_of, plan_of, polyline
from tests.support.pulses.reference_rows import (
    check_rows,
    run,
    spacing,
)
from tests.support.soak import share


@pytest.mark.parametrize("noise", [0.0, 1e-13, -1e-13])
def test_an_axis_on_a_half_grid_line_is_quiet(noise: float) -> None:
    """Between two equally near grid points the axis keeps its own."""
    start = np.array([0.0, 0.005])
    points = [[0.1 * k, 0.005 + noise * (-1) ** k] for k in range(1, 9)]
    rows, interpolator = run([plan_of(path_of([polyline(points)], start))], [100.0, 100.0], start)
    assert not rows.step[:, 1].any()
    assert interpolator.error_blu <= 0.5 + 1e-9
    bend = arc([0.0, 0.0, 0.005], (1.0, 0.0), 0.75)
    rows, _ = run([plan_of(path_of([bend], [0.0, 0.0, 0.005]))], [100.0] * 3, [0.0, 0.0, 0.005])
    assert not rows.step[:, 2].any()


def test_turning_back_on_a_half_grid_line_gives_nothing() -> None:
    rows, _ = run(
        [plan_of(path_of([polyline([[0.005], [0.0], [-0.005], [0.0]])], [0.0]))], [100.0], [0.0]
    )
    assert len(rows.step) == 0
    # the top of this circle lies on the line between 50 and 51
    rows, _ = run(
        [plan_of(path_of([arc([0.005, 0.0], (0.0, 0.0), 1.0)], [0.005, 0.0]))],
        [100.0, 100.0],
        [0.005, 0.0],
    )
    assert not rows.step[:, 1].any()


def test_turning_back_beyond_a_half_grid_line_steps_there_and_back() -> None:
    rows, _ = run([plan_of(path_of([polyline([[0.0051], [0.0]])], [0.0]))], [100.0], [0.0])
    assert rows.step.tolist() == [[1], [-1]]
    assert rows.line.tolist() == [1, 2]
    rows, interpolator = run(
        [plan_of(path_of([arc([0.0051, 0.0], (0.0, 0.0), 1.0)], [0.0051, 0.0]))],
        [100.0, 100.0],
        [0.0051, 0.0],
    )
    assert (
        rows.step.tolist() == [[0, 1], [-1, 0], [0, -1], [-1, 0], [0, -1], [1, 0], [0, 1], [1, 0]]
        or len(rows.step) == 8
    )
    assert interpolator.position_steps.tolist() == [1, 0]


def test_reaching_a_half_grid_line_and_going_on_steps_once() -> None:
    rows, _ = run([plan_of(path_of([polyline([[0.005], [0.008]])], [0.0]))], [100.0], [0.0])
    assert rows.step.tolist() == [[1]]
    assert rows.line.tolist() == [2]


def test_a_start_off_the_grid() -> None:
    rows, interpolator = run(
        [plan_of(path_of([polyline([[0.0349, -0.0251]])], [0.0149, 0.0149]))],
        [100.0, 100.0],
        [0.0149, 0.0149],
    )
    assert interpolator.origin_steps.tolist() == [1, 1]
    assert interpolator.position_steps.tolist() == [3, -3]
    check_rows(rows, interpolator, [0.0349, -0.0251])


def test_a_move_within_a_cell_gives_nothing() -> None:
    rows, interpolator = run(
        [plan_of(path_of([polyline([[0.004, -0.004]])], [0.0, 0.0]))], [100.0, 100.0], [0.0, 0.0]
    )
    assert len(rows.step) == 0
    assert interpolator.error_blu == 0.0


@pytest.mark.parametrize("beyond", share([1e-7, 1e-5], [1e-7]))
@pytest.mark.parametrize("rows_at_once", share([1, 2, 65536], [2]))
def test_a_graze_faster_than_the_board_makes_no_steps(
    beyond: float, rows_at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The peaks of these waves pass a half-grid line by a little, for microseconds."""
    monkeypatch.setattr(reference_pulse, "ROWS", rows_at_once)
    radius = (50.5 + beyond) / 100.0
    start = np.array([-radius, 0.0])
    p = start
    waves = []
    for _ in range(5):
        waves.append(arc(p, (float(p[0] + radius), 0.0), -0.5))
        p = waves[-1].end
        waves.append(polyline([[p[0] + 0.01, -0.02], [p[0] + 0.02, 0.0]]))
        p = waves[-1].points[-1]
    plan = plan_of(path_of(waves, start), v=200.0, a=2000.0, j=1e5)
    bare, plain = run([plan], [100.0, 100.0], start)
    assert spacing(bare) < 20_000
    for count in (0, 500):
        parts = cut(plan, list(np.random.default_rng(2).uniform(0.0, plan.duration, count)))
        interpolator = ReferencePulse([100.0, 100.0], start, 20_000, algorithm="crossings")
        chunks = [c for part in parts for c in interpolator.pulses(part)]
        rows = PulseChunk(
            *(
                np.concatenate([getattr(c, name) for c in chunks])
                for name in ("time_ns", "step", "line")
            )
        )
        if rows_at_once > 2:
            assert spacing(rows) >= 20_000
            assert np.abs(rows.step).sum() == np.abs(bare.step).sum() - 10
        check_rows(rows, interpolator, p)
        assert interpolator.position_steps.tolist() == plain.position_steps.tolist()


@pytest.mark.parametrize("end", [1.005, 1.015, 0.995, -1.005, -1.015, 0.5 / 100, 1.5 / 100])
@pytest.mark.parametrize("via", [0.0, 2.0])
def test_the_path_settles_on_the_rounded_end_point(end: float, via: float) -> None:
    # Half-grid points, some a rounding error off them, reached from below and from above.
    blocks = [polyline([[via, 1.0], [end, 2.0]])] if via else [polyline([[end, 2.0]])]
    _, interpolator = run([plan_of(path_of(blocks, [0.0, 0.0]))], 100.0 * np.ones(2), [0.0, 0.0])
    before = interpolator.position_steps
    moves = list(interpolator.settle())
    np.testing.assert_array_equal(
        interpolator.position_steps, np.rint(np.array([end, 2.0]) * 100.0)
    )
    np.testing.assert_array_equal(
        before + sum(move.step.sum(axis=0, dtype=np.int64) for move in moves),
        interpolator.position_steps,
    )
    assert not list(interpolator.settle())
