"""Compensated contours against rows computed by hand: sides, corners, full circles, slots."""

from __future__ import annotations

import cmath
import math

import pytest

from tests.support.gcode.compensation_cases import (
    Arc,
    Line,
    Move,
    Row,
    record,
    same,
)

H = math.sqrt(0.5)


# The tool, of radius 2, runs around a square of side 10: clockwise on its left, so outside; the
# entry comes up along the left side.
def test_around_a_square_from_outside() -> None:
    moves: list[Move] = [Line(0, 0), Line(0, 10), Line(10, 10), Line(10, 0), Line(-5, 0)]
    found = record(moves, "left", 2.0, start=(0.0, -8.0, 0.0))
    expected: list[Row] = [
        ("line", -2, 0, 0),
        ("line", -2, 10, 0),
        ("arc", 0, 12, 0, 0, 10, 2, -0.25),
        ("line", 10, 12, 0),
        ("arc", 12, 10, 0, 10, 10, 2, -0.25),
        ("line", 12, 0, 0),
        ("arc", 10, -2, 0, 10, 0, 2, -0.25),
        ("line", -5, -2, 0),
    ]
    same(found.rows, expected)
    assert found.lines == [1, 2, 3, 3, 4, 4, 5, 5]


def test_along_a_square_from_inside() -> None:
    moves: list[Move] = [Line(5, 0), Line(10, 0), Line(10, 10), Line(0, 10), Line(0, 0), Line(5, 0)]
    found = record(moves, "left", 2.0, start=(5.0, 5.0, 0.0))
    ends = [(7, 2), (8, 2), (8, 8), (2, 8), (2, 2), (5, 2)]
    same(found.rows, [("line", x, y, 0) for x, y in ends])


# A circle of radius 5 about 0, 0 from 5, 0 and the tool of radius 2, straight in: compensated
# radius 7 outside, 3 inside.
@pytest.mark.parametrize(
    ("side", "turns", "radius", "start"),
    [
        ("right", 1.0, 7.0, (5.0, -9.0)),
        ("left", -1.0, 7.0, (5.0, 9.0)),
        ("left", 1.0, 3.0, (5.0, -9.0)),
        ("right", -1.0, 3.0, (5.0, 9.0)),
    ],
)
def test_a_full_circle_keeps_its_centre(
    side: str, turns: float, radius: float, start: tuple[float, float]
) -> None:
    found = record([Line(5, 0), Arc(5, 0, 0, 0, turns)], side, 2.0, start=(*start, 0.0))
    same(found.rows, [("line", radius, 0, 0), ("arc", radius, 0, 0, 0, 0, radius, turns)])


# Along X, then an arc about 10, -5 or 10, 5 whose tangent at 10, 0 is X: both convexities pass
# straight.
@pytest.mark.parametrize(
    ("side", "arc", "expected"),
    [
        ("left", Arc(15, -5, 10, -5, -0.25), ("arc", 17, -5, 0, 10, -5, 7, -0.25)),
        ("right", Arc(15, -5, 10, -5, -0.25), ("arc", 13, -5, 0, 10, -5, 3, -0.25)),
        ("left", Arc(15, 5, 10, 5, 0.25), ("arc", 13, 5, 0, 10, 5, 3, 0.25)),
        ("right", Arc(15, 5, 10, 5, 0.25), ("arc", 17, 5, 0, 10, 5, 7, 0.25)),
    ],
)
def test_tangent_moves_have_no_corner(side: str, arc: Arc, expected: Row) -> None:
    y = 2.0 if side == "left" else -2.0
    found = record([Line(5, 0), Line(10, 0), arc], side, 2.0)
    same(found.rows, [("line", 5, y, 0), ("line", 10, y, 0), expected])


# A line up to 10, 0 and an arc that leaves at a right angle to the tool's side: circles about 15, 0
# (radius 5) and 5, 0. Offset line y = 2; offset circles: 5 + 2 = 7 outside the first one, 5 - 2 = 3
# inside the second.
@pytest.mark.parametrize(
    ("arc", "enter", "radius"),
    [
        (Arc(20, 0, 15, 0, -0.5), (15 - math.sqrt(45), 2.0), 7.0),
        (Arc(0, 0, 5, 0, 0.5), (5 + math.sqrt(5), 2.0), 3.0),
    ],
)
def test_inside_corner_of_line_and_arc(arc: Arc, enter: tuple[float, float], radius: float) -> None:
    found = record([Line(5, 0), Line(10, 0), arc], "left", 2.0)
    spin = math.copysign(1.0, arc.turns)
    swept = math.asin(2.0 / radius) / math.tau
    end = arc.cx + math.copysign(radius, arc.x - arc.cx), arc.cy
    expected: list[Row] = [
        ("line", 5, 2, 0),
        ("line", *enter, 0),
        ("arc", *end, 0, arc.cx, arc.cy, radius, spin * (0.5 - swept)),
    ]
    same(found.rows, expected)


def test_inside_corner_of_arc_and_line() -> None:
    """The same contour backwards, on the other side, has the same corner."""
    moves: list[Move] = [Line(20, 0), Arc(10, 0, 15, 0, 0.5), Line(-10, 0)]
    found = record(moves, "right", 2.0, start=(20.0, -10.0, 0.0))
    swept = 0.5 - math.asin(2 / 7) / math.tau
    corner = 15 - math.sqrt(45)
    same(
        found.rows,
        [("line", 22, 0, 0), ("arc", corner, 2, 0, 15, 0, 7, swept), ("line", -10, 2, 0)],
    )


# Two half circles of radius 5 about 5, 0 and 15, 0 over the X axis meet in a cusp that points down:
# offsets of radius 7 cross at x = 10.
def test_inside_corner_of_two_arcs() -> None:
    moves: list[Move] = [Line(0, 0), Arc(10, 0, 5, 0, -0.5), Arc(20, 0, 15, 0, -0.5)]
    found = record(moves, "left", 2.0, start=(0.0, -9.0, 0.0))
    swept = 0.5 - math.acos(5 / 7) / math.tau
    y = math.sqrt(49 - 25)
    same(
        found.rows,
        [
            ("line", -2, 0, 0),
            ("arc", 10, y, 0, 5, 0, 7, -swept),
            ("arc", 22, 0, 0, 15, 0, 7, -swept),
        ],
    )


# The cusp is 1e-4 rad off: the second arc begins below the first, or above, where its centre is
# lower or higher by 5e-4.
@pytest.mark.parametrize("off", [-5e-4, 5e-4])
def test_an_inexact_cusp(off: float) -> None:
    half = math.sqrt(25 - off * off)
    second = Arc(10 + 2 * half, 0, 10 + half, off, -0.5 - math.asin(off / 5) / math.pi)
    moves: list[Move] = [Line(0, 0), Arc(10, 0, 5, 0, -0.5), second]
    found = record(moves, "left", 2.0, start=(0.0, -9.0, 0.0))
    assert [row[0] for row in found.rows] == ["line", "arc", "arc"]
    assert found.rows[1][1:3] == pytest.approx((10, math.sqrt(24)), abs=1e-3)


# The same two seen from below: offsets of radius 3, and half a turn of the tool about the cusp.
def test_outside_corner_of_two_arcs() -> None:
    moves: list[Move] = [Line(0, 0), Arc(10, 0, 5, 0, -0.5), Arc(20, 0, 15, 0, -0.5)]
    found = record(moves, "right", 2.0, start=(0.0, -9.0, 0.0))
    expected: list[Row] = [
        ("line", 2, 0, 0),
        ("arc", 8, 0, 0, 5, 0, 3, -0.5),
        ("arc", 12, 0, 0, 10, 0, 2, 0.5),
        ("arc", 18, 0, 0, 15, 0, 3, -0.5),
    ]
    same(found.rows, expected)


def test_a_reversal_goes_around_the_end() -> None:
    moves: list[Move] = [Line(10, 0), Line(20, 0), Line(5, 0)]
    found = record(moves, "left", 2.0)
    same(
        found.rows,
        [
            ("line", 10, 2, 0),
            ("line", 20, 2, 0),
            ("arc", 20, -2, 0, 20, 0, 2, -0.5),
            ("line", 5, -2, 0),
        ],
    )


# The tool's centre leaves the arc of radius 2 along the lines that touch it every 45 degrees: they
# meet at 2 / cos 22.5 from the corner.
def test_a_traverse_stays_outside_the_corner() -> None:
    found = record([Line(10, 0, rapid=True), Line(20, 0), Line(20, -10, rapid=True)], "left", 2.0)
    far = 2 / math.cos(math.pi / 8)
    vertices = [20 + cmath.rect(far, math.radians(angle)) for angle in (67.5, 22.5)]
    expected: list[Row] = [("rapid", 10, 2, 0), ("line", 20, 2, 0)]
    expected += [("rapid", vertex.real, vertex.imag, 0) for vertex in vertices]
    same(found.rows, [*expected, ("rapid", 22, 0, 0), ("rapid", 22, -10, 0)])


@pytest.mark.parametrize(("angle", "arcs"), [(0.049, 0), (0.051, 1)])
def test_slight_outside_corners_extend_to_the_crossing(angle: float, arcs: int) -> None:
    found = record(
        [Line(10, 0), Line(20, 0), Line(20 + 10 * math.cos(angle), -10 * math.sin(angle))],
        "left",
        2.0,
    )
    assert [row[0] for row in found.rows].count("arc") == arcs
    if not arcs:
        same(found.rows[1:2], [("line", 20 + 2 * math.tan(angle / 2), 2, 0)])


def test_slight_outside_corner_of_line_and_arc() -> None:
    """An arc of radius 5 begins 0.01 rad to the right of the line before it: its offset crosses the
    line's behind the corner.
    """
    off = 0.01
    center = 10 - 5j * cmath.exp(-1j * off)
    end = 2 * center - 10
    found = record(
        [Line(5, 0), Line(10, 0), Arc(end.real, end.imag, center.real, center.imag, -0.5)],
        "left",
        2.0,
    )
    x = center.real + math.sqrt(49 - (2 - center.imag) ** 2)
    same(found.rows[1:2], [("line", x, 2, 0)])
    assert 10 < x < 10.03


def test_helix_of_many_turns() -> None:
    found = record(
        [Line(5, 0), Arc(5, 0, 0, 0, 3.0, z=-6.0), Line(5, 9)], "right", 2.0, start=(5.0, -9.0, 0.0)
    )
    same(found.rows, [("line", 7, 0, 0), ("arc", 7, 0, -6, 0, 0, 7, 3), ("line", 7, 9, -6)])


def test_an_inside_corner_cuts_a_helix_in_the_plane_only() -> None:
    found = record(
        [Line(10, 0), Arc(20, 0, 15, 0, -1.5, z=3.0), Line(40, 0)],
        "left",
        2.0,
        start=(-10.0, 0.0, 0.0),
    )
    off, swept = math.sqrt(45), 1.5 - 2 * math.asin(2 / 7) / math.tau
    same(
        found.rows,
        [("line", 15 - off, 2, 0), ("arc", 15 + off, 2, 3, 15, 0, 7, -swept), ("line", 40, 2, 3)],
    )


@pytest.mark.parametrize(
    ("side", "radius", "y"),
    [("left", 2.0, 2), ("left", -2.0, -2), ("right", 2.0, -2), ("right", -2.0, 2)],
)
def test_a_negative_radius_swaps_the_sides(side: str, radius: float, y: float) -> None:
    same(
        record([Line(10, 0), Line(20, 0)], side, radius).rows,
        [("line", 10, y, 0), ("line", 20, y, 0)],
    )


def test_a_radius_of_0_changes_nothing() -> None:
    moves: list[Move] = [
        Line(1, 0),
        Arc(1, 0, 0, 0, 1.0),
        "dwell",
        Line(1, 0, 4),
        Line(0.5, 0),
        Line(0.5, 0.25, rapid=True),
    ]
    found = record(moves, "left", 0.0)
    expected: list[Row] = [("line", 1, 0, 0), ("arc", 1, 0, 0, 0, 0, 1, 1), ("dwell",)]
    same(found.rows, [*expected, ("line", 1, 0, 4), ("line", 0.5, 0, 4), ("rapid", 0.5, 0.25, 4)])


def test_a_slot_as_wide_as_the_tool_just_fits() -> None:
    """A slot of width 4: at its end the middle move has no length left, and none is sent."""
    found = record([Line(10, 0), Line(10, 4), Line(-10, 4)], "left", 2.0, start=(-10.0, 0.0, 0.0))
    same(found.rows, [("line", 8, 2, 0), ("line", -10, 2, 0)])
    found = record(
        [Line(10, 0), Line(10, 4, -1), Line(-10, 4)], "left", 2.0, start=(-10.0, 0.0, 0.0)
    )
    same(found.rows, [("line", 8, 2, 0), ("line", 8, 2, -1), ("line", -10, 2, -1)])


# An arc whose end is 0.01 mm off its circle becomes an arc of a circle; of a nearly full one, two.
@pytest.mark.parametrize(("angle", "pieces"), [(90.0, 1), (200.0, 1), (300.0, 1), (359.0, 2)])
def test_an_inexact_arc_becomes_an_exact_one(angle: float, pieces: int) -> None:
    end = cmath.rect(10.01, math.radians(angle) - math.pi / 2)
    found = record(
        [Line(0, -10), Arc(end.real, end.imag, 0, 0, angle / 360, z=-3.6)],
        "right",
        2.0,
        start=(-30.0, -10.0, 0.0),
    )
    here, arcs = complex(0, -12), [row for row in found.rows if row[0] == "arc"]
    assert len(arcs) == pieces
    for row in arcs:
        center, there = complex(row[4], row[5]), complex(row[1], row[2])
        assert abs(abs(there - center) - row[6]) < 1e-9
        assert abs(center) < 0.03
        assert abs(abs(there) - 12) < 0.02
        here = there
    assert abs(here - end * 12.01 / 10.01) < 0.02
    assert found.rows[-1][3] == -3.6
    assert sum(row[7] for row in arcs) == pytest.approx(angle / 360, abs=1e-3)
