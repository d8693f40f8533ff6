"""Reference pulses by crossings: order, half a BLU, counts, ends and times, against an independent
evaluation.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from cnc.model.blocks import ArcFeed, Block, NurbsFeed
from cnc.planner.plan import PlanChunk
from cnc.pulses import reference_pulse
from cnc.pulses.reference_pulse import ReferencePulse
from tests.support.pulses.plans import FILE, arc, cut, path_of, plan_of, polyline, state_at, trident
from tests.support.pulses.reference_rows import (
    check,
    check_rows,
    check_time,
    random_nurbs,
    run,
)
from tests.support.soak import share


@pytest.mark.parametrize("axes", share([1, 2, 3, 4, 5, 6, 9], [1, 3, 9]))
def test_lines_in_all_directions(axes: int) -> None:
    size = np.array([0.31, 0.17, 0.053, 0.2, 0.11, 0.07, 0.02, 0.05, 0.29])[:axes]
    scale = np.array([100.0, 160.0, 400.0, 10.0, 20.0, 100.0, 50.0, 200.0, 30.0])[:axes]
    every = list(itertools.product((-1, 0, 1), repeat=min(axes, 3)))
    for signs in every[:: share(1, 10 if axes > 2 else 1)]:
        if any(signs):
            direction = np.resize(signs, axes)
            check([polyline([direction * size])], np.zeros(axes), scale, dense=4)
            check([polyline([direction * size + 0.0123])], np.full(axes, 0.0123), scale, dense=4)


def test_the_diagonal_steps_all_axes_at_once() -> None:
    rows = check([polyline([[1.0, 1.0, -1.0]])], np.zeros(3), 100.0, dense=4)
    assert rows.step.tolist() == [[1, 1, -1]] * 100


@pytest.mark.parametrize("octant", range(0, 8, share(1, 3)))
@pytest.mark.parametrize("turns", share([0.125, -0.125, 1.0, -0.7], [-0.7]))
def test_arcs_in_all_octants(octant: int, turns: float) -> None:
    angle = octant * np.pi / 4
    center = (0.0137, -0.3)
    start = np.array([center[0] + 0.5 * np.cos(angle), center[1] + 0.5 * np.sin(angle)])
    check([arc(start, center, turns)], start, [100.0, 80.0])


def test_many_turns_helix_and_spiral() -> None:
    start = np.array([1.0, 0.0, 0.0])
    check([arc(start, (0.0, 0.0), 2.25, rise=0.333)], start, share(100.0, 40.0), dense=1000)
    spiral = ArcFeed(FILE, 1, "XY", (0.0, 0.0), np.array([0.0, 1.2, 0.1]), 1.0, 0.25, 10.0)
    check([spiral], start, 100.0)


def test_a_circle_has_the_counts_of_theory() -> None:
    start = np.array([1.0, 0.0])
    rows, interpolator = run(
        [plan_of(path_of([arc(start, (0.0, 0.0), 1.0)], start))], [1000.0, 1000.0], start
    )
    assert interpolator.position_steps.tolist() == [1000, 0]
    assert np.abs(rows.step).sum(axis=0).tolist() == [4000, 4000]
    assert len(rows.step) <= 8000


def test_nurbs() -> None:
    check([trident()], np.array([10.0, 10.0]), [20.0, 30.0], dense=2000)


@pytest.mark.parametrize("seed", range(share(60, 1)))
def test_random_nurbs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    degree = int(rng.integers(1, 6))
    block = random_nurbs(rng, int(rng.integers(2, 5)), degree, degree + 1 + int(rng.integers(0, 4)))
    check(
        [block],
        block.control_points[0],
        rng.uniform(10.0, 60.0, block.control_points.shape[1]),
        dense=2000,
    )


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=share(300, 3))
def test_mixed_paths(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start = rng.uniform(-1, 1, 3)
    p = start
    blocks: list[Block] = []
    for number in range(1, 4):
        match rng.integers(3):
            case 0:
                points = p + np.cumsum(
                    rng.uniform(-0.4, 0.4, (3, 3)).round(int(rng.integers(1, 4))), axis=0
                )
                blocks.append(polyline(points, line=10 * number))
                p = points[-1]
            case 1:
                center = tuple(float(c) for c in p[:2] + rng.uniform(-0.5, 0.5, 2))
                block = arc(
                    p,
                    center,
                    float(rng.uniform(-1.2, 1.2)),
                    rise=float(rng.uniform(-0.3, 0.3)),
                    line=10 * number,
                )  # type: ignore[arg-type]
                blocks.append(block)
                p = block.end
            case _:
                spline = random_nurbs(rng, 3, 3, 5)
                spline.control_points[0] = p
                blocks.append(spline)
                p = spline.control_points[-1]
    check(blocks, start, rng.choice([40.0, 50.0, 80.0, 100.0], 3), dense=1500)


def test_a_chunk_may_be_cut_anywhere() -> None:
    start = np.array([10.0, 10.0])
    spline = trident()
    blocks = [
        spline,
        polyline([[10.5, 0.3], [10.7, -1.0]], line=5),
        arc([10.7, -1.0], (11.7, -1.2), -0.8, line=7),
    ]
    plan = plan_of(path_of(blocks, start), t0=3.25)
    whole, first = run([plan], [100.0, 100.0], start)
    rng = np.random.default_rng(5)
    for count in (1, 3, 40, 400):
        parts = cut(plan, list(rng.uniform(0.0, plan.duration, count)))
        assert len(parts) == count + 1
        rows, second = run(parts, [100.0, 100.0], start)
        np.testing.assert_array_equal(rows.step, whole.step)
        np.testing.assert_array_equal(rows.line, whole.line)
        assert (
            np.abs(rows.time_ns - whole.time_ns).max() <= 200
        )  # next to the stop 1e-12 mm is as much
        slow = 20
        assert np.abs(rows.time_ns - whole.time_ns)[slow:-slow].max() <= 1
        assert first.position_steps.tolist() == second.position_steps.tolist()


def test_cut_at_the_ends_of_pieces() -> None:
    start = np.zeros(2)
    plan = plan_of(path_of([polyline([[0.5, 0.1], [0.9, 0.7], [-0.3, 0.2]])], start))
    whole, _ = run([plan], 100.0 * np.ones(2), start)
    t = [
        brentq(lambda t, s=s: state_at(plan, np.array([t]))[0, 0] - s, 0, plan.duration, xtol=1e-16)
        for s in plan.piece_s[1:-1]
    ]
    rows, _ = run(cut(plan, t), 100.0 * np.ones(2), start)
    np.testing.assert_array_equal(rows.step, whole.step)
    np.testing.assert_array_equal(rows.line, whole.line)


def test_a_buffer_smaller_than_the_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    start = np.array([10.0, 10.0])
    blocks = [trident(), polyline([[10.0, 0.5], [10.3, 0.8]], line=5)]
    plan = plan_of(path_of(blocks, start))
    whole, _ = run([plan], [50.0, 40.0], start)
    for rows_at_once in (1, 7, len(whole.step), len(whole.step) + 1):
        monkeypatch.setattr(reference_pulse, "ROWS", rows_at_once)
        rows, interpolator = run([plan], [50.0, 40.0], start)
        np.testing.assert_array_equal(rows.step, whole.step)
        np.testing.assert_array_equal(rows.line, whole.line)
        assert np.abs(rows.time_ns - whole.time_ns).max() <= 200
        check_rows(rows, interpolator, [10.3, 0.8])


def test_lines_are_those_of_the_pieces() -> None:
    rows, _ = run(
        [
            plan_of(
                path_of([polyline([[0.1, 0.0], [0.1, 0.05], [0.02, 0.05]], line=30)], [0.0, 0.0])
            )
        ],
        [100.0, 100.0],
        [0.0, 0.0],
    )
    assert rows.line.tolist() == [30] * 10 + [31] * 5 + [32] * 8


def test_times_are_exact_after_hours() -> None:
    path = path_of([polyline([[1.0]])], [0.0])
    early, _ = run([plan_of(path)], [100.0], [0.0])
    late, _ = run([plan_of(path, t0=1e6)], [100.0], [0.0])
    assert (late.time_ns - early.time_ns == 10**15).all()
    quarter, _ = run([plan_of(path, t0=1e7 + 0.25)], [100.0], [0.0])
    assert np.abs(quarter.time_ns - early.time_ns - 10**16 - 250_000_000).max() <= 1


def test_times_never_decrease_from_chunk_to_chunk() -> None:
    """This holds even where rounding makes the clocks of two chunks overlap."""
    interpolator = ReferencePulse([100.0], [0.0])
    (first,) = interpolator.pulses(plan_of(path_of([polyline([[0.01]])], [0.0])))
    (second,) = interpolator.pulses(plan_of(path_of([polyline([[0.02]])], [0.01])))
    assert second.time_ns[0] == first.time_ns[0]


def test_constant_speed_is_evenly_timed() -> None:
    path = path_of([polyline([[10.0]])], [0.0])
    plan = PlanChunk(
        path,
        np.array([0.0, 10.0]),
        0.0,
        0.0,
        np.array([0.0, 1.0]),
        np.array([0.0, 10.0]),
        np.full(2, 10.0),
        np.zeros(2),
        np.zeros(1),
    )
    rows, _ = run([plan], [100.0], [0.0])
    np.testing.assert_array_equal(rows.time_ns, 500_000 + 1_000_000 * np.arange(1000))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=share(200, 6))
def test_times_under_random_phases(seed: int) -> None:
    """Between two rests with random jerks, each row comes when s(t) reaches its place."""
    rng = np.random.default_rng(seed)
    rise = [
        (float(t), float(j))
        for t, j in zip(rng.uniform(0.01, 0.2, 3), rng.uniform(1.0, 300.0, 3), strict=True)
    ]
    acc = sum(t * j for t, j in rise)
    faster = [*rise, (float(rng.uniform(0.0, 0.3)), 0.0), (0.1, -acc / 0.1)]
    phases = [*faster, (float(rng.uniform(0.0, 0.3)), 0.0), *((t, -j) for t, j in faster)]
    s = v = a = 0.0
    for t, j in phases:
        s, v, a = s + t * (v + t * (a / 2 + t * j / 6)), v + t * (a + t * j / 2), a + t * j
    slope = float(rng.uniform(0.01, 1.0))
    along = np.array([1.0, slope]) / np.hypot(1.0, slope)
    plan = plan_of(path_of([polyline([s * along])], [0.0, 0.0]), phases)
    rows, interpolator = run([plan], [100.0, 100.0], [0.0, 0.0])
    check_rows(rows, interpolator, s * along)
    moved = np.flatnonzero(rows.step[:, 0])
    for count in range(0, len(moved), max(len(moved) // 40, 1)):
        check_time(plan, (count + 0.5) / 100.0 / along[0], int(rows.time_ns[moved[count]]))


def test_cusps_and_repeated_control_points() -> None:
    """|dr/du| vanishes at a start with a doubled control point, and at a cusp inside a span."""
    doubled = NurbsFeed(
        FILE,
        1,
        3,
        np.array([0.0, 0, 0, 0, 1, 1, 1, 1]),
        np.array([[0.0, 0], [0, 0], [1, 1], [2, 0]]),
        np.ones(4),
        10.0,
    )
    check([doubled], [0.0, 0.0], 50.0, dense=2000)
    cusp = NurbsFeed(
        FILE,
        1,
        3,
        np.array([0.0, 0, 0, 0, 1, 1, 1, 1]),
        np.array([[0.0, 0], [1, 1], [0, 1], [1, 0]]),
        np.ones(4),
        10.0,
    )
    check([cusp], [0.0, 0.0], 50.0, dense=2000)


@pytest.mark.parametrize("weight", [1e2, 1e3, 1e4])
def test_a_strained_conic(weight: float) -> None:
    """A large weight rounds positions by more than the tolerance of the polynomials, however narrow
    their windows are.
    """
    points = np.array([[0.0, 0, 0], [5, 5, 0], [10, 0, 0]])
    block = NurbsFeed(
        FILE, 1, 2, np.array([0.0, 0, 0, 1, 1, 1]), points, np.array([1.0, weight, 1.0]), 10.0
    )
    scale = np.array([1000.0, 80.0, 400.0])
    rows, interpolator = run([plan_of(path_of([block], np.zeros(3)))], scale, np.zeros(3))
    check_rows(rows, interpolator, points[-1])
    # y of the conic at its middle, by de Casteljau
    highest = round(5.0 * weight / (1.0 + weight) * scale[1])
    assert np.abs(rows.step).sum(axis=0).tolist() == [10_000, 2 * highest, 0]
    assert np.cumsum(rows.step[:, 1], dtype=int).max() == highest
