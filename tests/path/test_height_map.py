"""The warp of blocks to a surface, against scipy's interpolation of the same grid."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline, CubicSpline, RegularGridInterpolator

from cnc.model.blocks import (
    ArcFeed,
    Dwell,
    NurbsFeed,
    PathMode,
    Polyline,
    Probe,
    Spindle,
    SpindleSync,
)
from cnc.model.diagnostics import GcodeError
from cnc.path.build import build
from cnc.path.warp import MOVES_AT_ONCE, PIECES_AT_ONCE, Surface, Warp
from tests.support.soak import share

AXES = ("x", "y", "z")
TOLERANCE = 0.004
BLEND = PathMode("p", 1, "blend", 0.01)


class Reference:
    """The surface by scipy: bilinear, or natural cubic splines in both directions."""

    def __init__(self, x, y, heights, smooth):
        self.x, self.y, self.values = x, y, heights
        self.linear = None if smooth else RegularGridInterpolator((y, x), heights)
        # The splines of unit values: the surface is the sum of their products.
        self.of_x, self.of_y = (
            CubicSpline(knots, np.eye(len(knots)), bc_type="natural") for knots in (x, y)
        )

    def __call__(self, x, y):
        x = np.clip(x, self.x[0], self.x[-1])
        y = np.clip(y, self.y[0], self.y[-1])
        if self.linear is not None:
            return self.linear(np.stack((y, x), axis=1))
        return np.einsum("nj,ji,ni->n", self.of_y(y), self.values, self.of_x(x))


def random_surface(seed):
    random = np.random.default_rng(seed)
    x = -20.0 + np.cumsum(random.uniform(2.0, 15.0, random.integers(2, 7)))
    y = 5.0 + np.cumsum(random.uniform(2.0, 15.0, random.integers(2, 7)))
    heights = random.normal(0.0, 0.4, (len(y), len(x)))
    smooth = bool(random.integers(2))
    surface = Surface(x, y, heights, smooth=smooth)
    return random, surface, Reference(x, y, heights, smooth)


def on_grid(random, surface, count):
    low = (surface.x[0], surface.y[0], -3.0)
    high = (surface.x[-1], surface.y[-1], 3.0)
    return random.uniform(low, high, (count, 3))


def moves(points, feeds=10.0):
    count = len(points)
    feeds = np.broadcast_to(np.asarray(feeds, np.float64), count).copy()
    return Polyline("p", 1, np.array(points), feeds, np.arange(1, count + 1, dtype=np.int32))


def lead(point):
    """Return a traverse to a point: it leads to the warped path."""
    return Polyline("p", 0, np.array([point]), np.array([math.nan]), np.zeros(1, np.int32))


def warped(surface, blocks, start, tolerance=TOLERANCE, **options):
    warp = Warp(surface, AXES, tolerance, **options)
    return list(warp.blocks(blocks, np.asarray(start, np.float64)))


def vertices(blocks):
    """Return points (n, 3) and lines (n,) of the straight moves."""
    lines = [each for each in blocks if isinstance(each, Polyline)]
    points = np.concatenate([each.points for each in lines])
    return points, np.concatenate([each.lines for each in lines])


def distances_to_warped(begin, end, whole, reference):
    """Return the largest distances in Z and sideways of pieces (n + 1, 3) from a warped move."""
    share_of_piece = np.linspace(0.0, 1.0, 9)[:, None, None]
    points = (whole[:-1] + share_of_piece * (whole[1:] - whole[:-1])).reshape(-1, 3)
    way = (end - begin)[:2]
    at = (points[:, :2] - begin[:2]) @ way / float(way @ way)
    expected = begin + at[:, None] * (end - begin)
    height = expected[:, 2] + reference(expected[:, 0], expected[:, 1])
    aside = np.abs(points[:, :2] - expected[:, :2]).max()
    return np.abs(points[:, 2] - height).max(), aside


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=share(2000, 11), deadline=None)
def test_heights_are_those_of_scipy(seed):
    random, surface, reference = random_surface(seed)
    points = on_grid(random, surface, 20)
    points[0, :2] = surface.x[-1], surface.y[-1]
    found = surface.heights(points[:, 0], points[:, 1])
    assert found == pytest.approx(reference(points[:, 0], points[:, 1]), abs=1e-12)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=share(1000, 7), deadline=None)
def test_pieces_of_straight_moves_are_within_a_quarter_of_the_tolerance(seed):
    random, surface, reference = random_surface(seed)
    points = on_grid(random, surface, 12)
    # Moves along a line of the grid, across a corner of it, and straight down.
    points[3, 0] = points[4, 0] = surface.x[-2]
    points[6, :2] = surface.x[0], surface.y[0]
    points[7, :2] = surface.x[1], surface.y[1]
    points[9, :2] = points[8, :2]
    found = warped(surface, [BLEND, lead(points[0]), moves(points[1:])], points[0] + [0, 0, 9])
    at, lines = vertices(found)
    ends = points + np.column_stack((np.zeros((12, 2)), reference(points[:, 0], points[:, 1])))
    for k in range(1, 12):
        own = at[lines == k]
        assert own[-1] == pytest.approx(ends[k], abs=1e-9)
        if k == 9:
            assert len(own) == 1
            continue
        whole = np.vstack((at[np.flatnonzero(lines == k)[0] - 1], own))
        off, aside = distances_to_warped(points[k - 1], points[k], whole, reference)
        assert off <= 0.25 * TOLERANCE + 1e-9
        assert aside <= 1e-9
        way = (points[k] - points[k - 1])[:2]
        assert (np.diff(whole[:, :2], axis=0) @ way > 0.0).all()


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=share(500, 6), deadline=None)
def test_arcs_and_splines_are_within_half_the_tolerance(seed):
    """A quarter for the chords in the plane of X and Y, a quarter for their pieces."""
    random, surface, reference = random_surface(seed)
    low, high = np.array((surface.x[0], surface.y[0])), np.array((surface.x[-1], surface.y[-1]))
    radius = 0.4 * (high - low).min()
    center = 0.5 * (low + high)
    turns, first = random.uniform(-1.5, 1.5), random.uniform(0.0, 6.0)
    angle = first + 2.0 * math.pi * turns * np.linspace(0.0, 1.0, 1601)
    circle = center + radius * np.column_stack((np.cos(angle), np.sin(angle)))
    z = np.linspace(-1.0, -2.0, 1601)
    begin, end = np.r_[circle[0], -1.0], np.r_[circle[-1], -2.0]
    arc = ArcFeed("p", 1, "XY", tuple(center), end, radius, turns, 10.0)
    control = np.vstack((end, on_grid(random, surface, 5)))
    knots = np.array([0, 0, 0, 0, 1, 2, 3, 3, 3, 3], np.float64)
    nurbs = NurbsFeed("p", 2, 3, knots, control, np.ones(6), 10.0)
    found = warped(surface, [BLEND, lead(begin), arc, nurbs], begin + [0, 0, 9])
    at, lines = vertices(found)
    spline = BSpline(knots, control, 3)(np.linspace(0.0, 3.0, 1601))
    for line, curve in ((1, np.column_stack((circle, z))), (2, spline)):
        true = curve + np.column_stack((np.zeros((1601, 2)), reference(curve[:, 0], curve[:, 1])))
        own = np.vstack((true[0], at[lines == line]))
        assert own[-1] == pytest.approx(true[-1], abs=1e-9)
        middles = np.vstack((own, 0.5 * (own[1:] + own[:-1])))
        near = np.linalg.norm(middles[:, None] - true[None, ::2], axis=2).min(axis=1)
        spacing = np.linalg.norm(np.diff(true[::2], axis=0), axis=1).max()
        assert (near <= np.hypot(0.55 * TOLERANCE, 0.51 * spacing)).all()


def flat(height=0.5):
    return Surface(np.array([0.0, 50.0, 100.0]), np.array([0.0, 60.0]), np.full((2, 3), height),
                   smooth=False)  # fmt: skip


def ridge():
    """A ridge of 1 mm at X 50."""
    heights = np.array([[0.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    return Surface(np.array([0.0, 50.0, 100.0]), np.array([0.0, 60.0]), heights, smooth=False)


@pytest.mark.parametrize(
    "block",
    [
        moves([[101.0, 10.0, -1.0]]),
        ArcFeed("p", 1, "XY", (90.0, 20.0), np.array([90.0, 40.0, -1.0]), 20.0, 0.5, 10.0),
    ],
)
def test_a_feed_move_outside_the_grid_is_refused_at_its_line(block):
    begin = [90.0, 0.0, -1.0]
    with pytest.raises(GcodeError, match="height-map-outside") as caught:
        warped(flat(), [lead(begin), block], begin)
    assert caught.value.diagnostic.line == 1


def test_a_traverse_from_outside_meets_the_warped_path_at_the_border():
    start = [-20.0, 10.0, 5.0]
    points, _ = vertices(warped(ridge(), [BLEND, lead([25.0, 10.0, 5.0])], start))
    assert points.tolist() == [
        pytest.approx([0.0, 10.0, 5.0], abs=1e-5),
        pytest.approx([25.0, 10.0, 5.5]),
    ]


def test_a_traverse_across_the_grid_follows_it_and_ends_unwarped():
    points, _ = vertices(warped(ridge(), [BLEND, lead([120.0, 10.0, 5.0])], [-20.0, 10.0, 5.0]))
    assert points.tolist() == [
        pytest.approx(each, abs=1e-5)
        for each in ([0, 10, 5], [50, 10, 6], [100, 10, 5], [120, 10, 5])
    ]
    around, _ = vertices(warped(ridge(), [BLEND, lead([120.0, 99.0, 5.0])], [-20.0, 99.0, 5.0]))
    assert around.tolist() == [[120.0, 99.0, 5.0]]


def test_the_first_move_leads_to_the_warped_path():
    """A feed along the surface from an unwarped start is refused; down or by G0 is not."""
    start = [10.0, 10.0, 5.0]
    with pytest.raises(GcodeError, match="height-map-start"):
        warped(flat(), [moves([[20.0, 10.0, 5.0]])], start)
    points, _ = vertices(warped(flat(), [moves([[10.0, 10.0, -1.0]])], start))
    assert points == pytest.approx(np.array([[10.0, 10.0, -0.5]]))
    points, _ = vertices(warped(flat(), [lead([20.0, 10.0, 5.0])], start))
    assert points[-1] == pytest.approx(np.array([20.0, 10.0, 5.5]))


def test_no_traverse_is_raised_above_the_travel():
    top = 10.0
    blocks = [
        BLEND,
        lead([20.0, 10.0, top]),
        lead([80.0, 10.0, top]),
        moves([[80.0, 10.0, -1.0], [70.0, 10.0, -1.0]]),
    ]
    points, lines = vertices(warped(flat(), blocks, [10.0, 10.0, top], top=top))
    assert points[lines == 0][:, 2].max() == top
    ends = np.array([[80.0, 10.0, -0.5], [70.0, 10.0, -0.5]])
    assert points[lines > 0] == pytest.approx(ends)
    # A feed move is raised in any case: the check of the travel refuses it.
    points, _ = vertices(
        warped(flat(), [lead([10, 10, 9]), moves([[20.0, 10.0, 9.9]])], [10, 10, 9], top=top)
    )
    assert points[-1, 2] == pytest.approx(10.4)


@pytest.mark.parametrize("control", ["exact-path", "exact-stop"])
def test_pieces_of_an_exact_move_are_blended_within_the_tolerance(control):
    """The motion does not rest at pieces, and it rests at the end of an exact stop."""
    mode = PathMode("p", 1, control)
    blocks = warped(
        ridge(),
        [mode, lead([10.0, 10.0, 0.0]), moves([[90.0, 10.0, 0.0], [91.0, 10.0, 0.0]])],
        [10.0, 10.0, 9.0],
    )
    kinds = [each.control if isinstance(each, PathMode) else type(each).__name__ for each in blocks]
    rest = ["Dwell"] if control == "exact-stop" else []
    assert kinds == [
        control, "Polyline", "blend", "Polyline", control, *rest, "Polyline",
    ]  # fmt: skip
    assert [each.seconds for each in blocks if isinstance(each, Dwell)] == [0.0] * len(rest)
    assert blocks[2].tolerance == TOLERANCE / 2.0
    chunks = [
        each
        for each in build(blocks, axes=AXES, start=np.array([10.0, 10.0, 9.0]))
        if not isinstance(each, Dwell)
    ]
    lines = np.concatenate([each.line for each in chunks])
    stops = np.concatenate([each.stop_after for each in chunks])
    assert stops[lines == 1][:-1].sum() == 0
    assert stops[lines == 1][-1] == (control == "exact-stop")


@pytest.mark.parametrize(
    "block",
    [
        Probe("p", 3, np.array([10.0, 10.0, -5.0]), 1.0, True, True),
        SpindleSync("p", 3, 1.5),
    ],
)
def test_codes_that_depend_on_the_true_position_are_refused(block):
    with pytest.raises(GcodeError, match="height-map-code") as caught:
        warped(flat(), [lead([10.0, 10.0, 5.0]), block], [10.0, 10.0, 5.0])
    assert caught.value.diagnostic.line == 3


def test_the_turn_of_a_rotary_axis_is_refused():
    turn = Polyline("p", 4, np.array([[1.0, 1, 1, 30.0]]), np.array([1.0]), np.array([4]))
    with pytest.raises(GcodeError, match="height-map-code"):
        list(Warp(flat(), ("x", "y", "z", "a"), 0.01).blocks([turn], np.array([1.0, 1, 1.5, 0])))


def test_commands_stay_at_the_begin_of_their_move():
    power = Spindle("p", 2, "cw", 500.0, with_motion=True)
    commands = np.array([None, (power,)], object)
    block = moves([[10.0, 10.0, 0.0], [90.0, 10.0, 0.0]])
    block = Polyline("p", 1, block.points, block.feeds, block.lines, commands)
    found = warped(ridge(), [BLEND, lead([5.0, 10.0, 0.0]), block], [5.0, 10.0, 9.0])[-1]
    assert found.lines.tolist() == [1, 2, 2]
    assert found.commands.tolist() == [None, (power,), None]


def test_feeds_and_lines_of_many_moves_are_kept_in_limited_parts():
    random = np.random.default_rng(3)
    count = 5 * MOVES_AT_ONCE
    points = np.column_stack((random.uniform(0, 100, count), random.uniform(0, 60, count),
                              np.zeros(count)))  # fmt: skip
    feeds = np.arange(1.0, count + 1.0)
    found = warped(ridge(), [BLEND, lead(points[0]), moves(points, feeds)], points[0])
    lines = [each for each in found if isinstance(each, Polyline)][1:]
    assert max(len(each.points) for each in lines) <= PIECES_AT_ONCE
    every = np.concatenate([each.lines for each in lines])
    assert (np.concatenate([each.feeds for each in lines]) == every).all()
    assert np.unique(every).tolist() == list(range(1 if every[0] == 1 else 2, count + 1))
