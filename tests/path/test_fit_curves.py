"""Arcs and NURBS in fitted chains: within the tolerance, smooth, exact where they stay arcs."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import BSpline

from benchmarks.arcs import FAMILIES, case, run
from cnc.model.blocks import ArcFeed, Dwell, NurbsFeed, PathMode, Polyline
from cnc.path.build import build
from cnc.path.kernels.curve import ARC, LINE, SPAN
from tests.support.path.fitted import assert_sound, blend, distances, pieces, sampled
from tests.support.path.path_cases import XYZ, arc, ends, evaluate, evaluate_s, lines
from tests.support.soak import share

COLUMNS = {"XY": (0, 1), "ZX": (2, 0), "YZ": (1, 2)}


def built(moves, tolerance, start=(0.0, 0.0, 0.0), axes=XYZ):
    return list(build([blend(tolerance), *moves], axes=axes, start=np.array(start, float)))


def along_arc(block, start, sagitta):
    """Return points along an arc, from angles."""
    i, j = COLUMNS[block.plane]
    (x0, y0), (x1, y1) = (np.array([p[i], p[j]]) - block.center for p in (start, block.end))
    r0, r1 = math.hypot(x0, y0), math.hypot(x1, y1)
    angle = math.atan2(y0, x0)
    sweep = math.atan2(y1, x1) - angle
    sweep += 2.0 * math.pi * round(block.turns - sweep / (2.0 * math.pi))
    count = int(abs(sweep) / math.sqrt(8.0 * sagitta / max(r0, r1))) + 2
    u = np.linspace(0.0, 1.0, count)[1:]
    points = start + u[:, None] * (block.end - start)
    points[:, i] = block.center[0] + (r0 + (r1 - r0) * u) * np.cos(angle + sweep * u)
    points[:, j] = block.center[1] + (r0 + (r1 - r0) * u) * np.sin(angle + sweep * u)
    return points


def programmed(moves, start, tolerance):
    """Return points along the programmed path, with chords of 0.002 tolerances of sagitta."""
    parts = [np.array(start, float)[None]]
    for block in moves:
        here = parts[-1][-1]
        match block:
            case Polyline():
                parts.append(block.points)
            case ArcFeed():
                parts.append(along_arc(block, here, 0.002 * tolerance))
            case NurbsFeed():
                spline = BSpline(block.knots, block.control_points, block.degree)
                parts.append(spline(np.linspace(block.knots[0], block.knots[-1], 4000))[1:])
    points = np.concatenate(parts)
    keep = np.append(True, np.abs(np.diff(points, axis=0)).max(axis=1) > 1e-12)
    return points[keep]


def assert_near(chunks, moves, tolerance, start=(0.0, 0.0, 0.0), step=math.inf):
    """Check that neither path is farther from the other than the tolerance.

    step: largest length between samples of the curve, mm; there are 50 in a piece at least.
    """
    points = programmed(moves, start, tolerance)
    curve = np.array(
        [
            evaluate(chunk, k, u)[0]
            for chunk, k in pieces(chunks)
            for u in np.linspace(*ends(chunk, k), 50 + int(chunk.length[k] / step))
        ]
    )
    assert distances(curve, points, tolerance).max() <= 1.003 * tolerance
    some = points[:: max(1, len(points) // 3000)]
    assert distances(some, curve, tolerance).max() <= 1.03 * tolerance


@pytest.mark.parametrize("family", [*FAMILIES][:: share(1, 2)])
@pytest.mark.parametrize("seed", share(range(700, 850), [703]))
def test_random_programs_keep_within_the_tolerance(family, seed):
    moves, tolerance = case(family, seed)
    chunks = built(moves, tolerance)
    assert_sound(chunks)
    # An exact helix of several turns is one piece.
    assert_near(chunks, moves, tolerance, step=5.0 * tolerance)


@pytest.mark.parametrize("kind", ["path", "axis"])
@pytest.mark.parametrize(
    "family", share(["rectangles", "slots", "adaptive"], ["rectangles", "slots"])
)
def test_the_motion_does_not_slow_down_at_tangent_joints(family, kind):
    one = case(family, 31)
    assert run(*one, kind).duration < 0.99 * run(one.moves, 0.0, kind).duration


def bow(start, radius, heading, turn, plane="XY", rise=0.0):
    """Return an arc from ``start`` in a direction of its plane, and its end heading."""
    i, j = COLUMNS[plane]
    k = 3 - i - j
    aside = math.copysign(radius, turn)
    center = (start[i] - aside * math.sin(heading), start[j] + aside * math.cos(heading))
    end = np.array(start, float)
    end[i] = center[0] + aside * math.sin(heading + turn)
    end[j] = center[1] - aside * math.cos(heading + turn)
    end[k] += rise
    return arc(end, center, turn / (2.0 * math.pi), plane)


@pytest.mark.parametrize(
    ("plane", "turn", "rise", "radius"),
    [
        (plane, turn, rise, radius)
        for plane in COLUMNS
        for turn in (0.4, -2.0, 2 * math.pi, -6 * math.pi)
        for rise in (0.0, 3.0)
        for radius in (0.05, 0.5, 20.0, 300.0, 3000.0)
    ][:: share(1, 26)],
)
def test_an_arc_between_tangent_lines(plane, turn, rise, radius):
    i, j = COLUMNS[plane]
    first = np.array([1.0, 2.0, 3.0])
    first[i] += 7.0
    bend = bow(first, radius, 0.0, turn, plane, rise)
    last = bend.end.copy()
    last[i] += 5.0 * math.cos(turn)
    last[j] += 5.0 * math.sin(turn)
    moves = [lines([first]), bend, lines([last])]
    chunks = built(moves, 0.02, (1.0, 2.0, 3.0))
    assert_sound(chunks)
    assert_near(chunks, moves, 0.02, (1.0, 2.0, 3.0), math.sqrt(0.08 * radius * 0.02))
    everything = pieces(chunks)
    end = evaluate(*everything[-1], ends(*everything[-1])[1])[0]
    assert end == pytest.approx(last, abs=1e-9)


def test_the_middle_of_a_long_arc_is_exact():
    first = np.array([10.0, 0.0, 0.0])
    circle = bow(first, 20.0, 0.0, 2.0 * math.pi)
    moves = [lines([first]), circle, lines([[20.0, 0.0, 0.0]])]
    chunks = built(moves, 0.01)
    assert_sound(chunks)
    exact = [(chunk, k) for chunk, k in pieces(chunks) if chunk.kind[k] == ARC]
    # The spline takes 11 sqrt(radius tolerance) at either end.
    assert sum(chunk.length[k] for chunk, k in exact) == pytest.approx(
        40.0 * math.pi - 22.0 * math.sqrt(0.2), abs=1e-9
    )
    for chunk, k in exact:
        for u in np.linspace(*ends(chunk, k), 9):
            distance = math.hypot(*(evaluate(chunk, k, u)[0][:2] - circle.center))
            assert distance == pytest.approx(20.0, abs=1e-12)
    # There the spline has the arc's third derivative too.
    for (a, i), (b, k) in pairwise(pieces(chunks)):
        if {a.kind[i], b.kind[k]} == {SPAN, ARC}:
            left, right = evaluate_s(a, i, ends(a, i)[1])[1], evaluate_s(b, k, ends(b, k)[0])[1]
            assert left[2] == pytest.approx(right[2], abs=1e-8)
            assert left[3] == pytest.approx(right[3], abs=1e-6)


@pytest.mark.parametrize(
    ("before", "behind"),
    [
        ([], []),
        ([lines([[5, 0, 0]], np.nan)], [lines([[50, 0, 0]], np.nan)]),
        ([lines([[10, 5, 0], [5, 0, 0]])], [lines([[0, 5, 0]])]),
        ([Dwell("part.nc", 2, 0.1)], [Dwell("part.nc", 2, 0.1)]),
    ],
)
def test_an_arc_beside_no_tangent_move_is_exact(before, behind):
    start = np.array([5.0, 0.0, 0.0])
    circle = bow(start, 8.0, 0.0, 2.0 * math.pi)
    begin = start if not before or isinstance(before[0], Dwell) else (0.0, 0.0, 0.0)
    chunks = [c for c in built([*before, circle, *behind], 0.05, begin) if hasattr(c, "kind")]
    kinds = {int(chunk.kind[k]) for chunk, k in pieces(chunks)}
    assert ARC in kinds and kinds <= {ARC, LINE}
    (length,) = [c.length[k] for c, k in pieces(chunks) if c.kind[k] == ARC]
    assert length == pytest.approx(16.0 * math.pi, abs=1e-12)


@pytest.mark.parametrize("mode", ["exact-path", "exact-stop"])
@pytest.mark.parametrize("family", FAMILIES)
def test_without_a_tolerance_the_path_is_exact(mode, family):
    moves, _ = case(family, 5)
    start = np.zeros(3)
    (path,) = build([PathMode("", 1, mode, 0.0), *moves], axes=XYZ, start=start)
    (plain,) = build(moves, axes=XYZ, start=start)
    for name in ("kind", "at", "data", "length", "feed", "line", "tolerance"):
        assert np.array_equal(getattr(path, name), getattr(plain, name))
    assert not path.tolerance.any()


def test_other_axes_follow_an_arc():
    axes = ("x", "y", "z", "a")
    turn = arc([10.0, 10.0, 0.0, 90.0], (0.0, 10.0), 0.25)
    moves = [lines([[0.0, 0.0, 0.0, 0.0]]), turn, lines([[10.0, 20.0, 0.0, 90.0]])]
    chunks = built(moves, 0.02, (-5.0, 0.0, 0.0, 0.0), axes)
    assert_sound(chunks)
    curve, _, _ = sampled(chunks, 200)
    part = np.clip(np.arctan2(curve[:, 0], 10.0 - curve[:, 1]) / (0.5 * math.pi), 0.0, 1.0)
    inside = (curve[:, 0] > 0.0) & (curve[:, 1] < 10.0)
    # An axis that does not measure the length may be off where the arc is, or as far along it.
    along = 0.02 * 90.0 / (0.5 * math.pi * 10.0)
    assert np.abs(curve[:, 3] - 90.0 * part)[inside].max() <= 0.02 + along
    assert np.abs(np.hypot(curve[:, 0], curve[:, 1] - 10.0) - 10.0)[inside].max() <= 0.02


def test_a_curve_with_a_corner_keeps_it():
    control = np.array([[0, 0, 0], [5, 0, 0], [10, 0, 0], [10, 5, 0], [10, 10, 0]], float)
    knots = np.array([0, 0, 0, 0.5, 0.5, 1, 1, 1])
    block = NurbsFeed("part.nc", 2, 2, knots, control, np.ones(5), 20.0)
    chunks = built([block, lines([[10.0, 20.0, 0.0]])], 0.01)
    (corner,) = [k for k, (chunk, i) in enumerate(pieces(chunks)) if chunk.tolerance[i] > 0]
    chunk, k = pieces(chunks)[corner]
    assert evaluate(chunk, k, ends(chunk, k)[1])[0] == pytest.approx([10.0, 0.0, 0.0])


def test_a_long_chain_with_curves_goes_on_from_window_to_window():
    rng = np.random.default_rng(3)
    here, heading, moves = np.zeros(3), 0.0, []
    for _ in range(share(400, 70)):
        turn = float(rng.uniform(0.1, 0.6) * rng.choice([-1.0, 1.0]))
        moves.append(bow(here, float(rng.uniform(2.0, 6.0)), heading, turn))
        here, heading = moves[-1].end, heading + turn
    chunks = built(moves, 0.01)
    assert_sound(chunks)
    assert sum((chunk.tolerance > 0.0).sum() for chunk in chunks) == 0
    assert_near(chunks, moves, 0.01)
