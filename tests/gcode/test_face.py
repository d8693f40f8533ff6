"""Polar coordinate interpolation: chords of X and C against the curve on the face, errors."""

from __future__ import annotations

import cmath
import math
from itertools import pairwise

import pytest

from cnc.gcode import dialects
from cnc.gcode.core.modal_groups import ReadingPolicy
from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from cnc.gcode.turning.virtual_axis import TOLERANCE
from cnc.model.blocks import PathMode, Polyline
from cnc.model.diagnostics import GcodeError
from tests.support.gcode.gcode_cases import block_summaries, run

AXES = ("x", "c", "z")
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
LIVE = "G98 G97 S600 M3\nG0 X60. C0. Z5.\n"


def options(dialect: str, axes: tuple[str, ...] = AXES) -> dict[str, object]:
    """Options of a lathe with a C axis."""
    lathe = None if dialect == "siemens" else "A"
    return {
        "dialect": dialects.load(dialect, lathe=lathe),  # type: ignore[arg-type]
        "axes": axes,
        "lathe": True,
        "policy": ReadingPolicy(tool_lengths="zero"),
        "tools": ToolTable([ToolEntry(1, 1, {}, 8.0)]),
    }


Move = tuple[list[float], list[float], float]


def chords(source: str, dialect: str) -> list[Move]:
    """The moves between the two changes of the path control: start, end, and feed (mm/s)."""
    moves: list[Move] = []
    here, inside = [0.0] * len(AXES), 0
    for block in run(f"{source}\nM30", **options(dialect)):
        inside += isinstance(block, PathMode)
        if isinstance(block, Polyline):
            for end, feed in zip(block.points.tolist(), block.feeds.tolist(), strict=True):
                if inside == 1:
                    moves.append((here, end, feed))
                here = end
    assert inside == 2
    return moves


def points(move: Move) -> list[complex]:
    """Points of the face during a move, of which X and C are linear."""
    (x0, c0, _), (x1, c1, _), _ = move
    return [
        cmath.rect(x0 + share * (x1 - x0), math.radians(c0 + share * (c1 - c0))) for share in SHARES
    ]


def seconds(moves: list[Move]) -> float:
    """Time of the feed moves: along X and Z, or of C where only that moves."""
    time = 0.0
    for (x0, c0, z0), (x1, c1, z1), feed in moves:
        if not math.isnan(feed):
            time += (math.hypot(x1 - x0, z1 - z0) or abs(c1 - c0)) / feed
    return time


def off_line(point: complex, a: complex, b: complex) -> float:
    """Distance of a point from a stretch."""
    share = ((point - a) * (b - a).conjugate()).real / abs(b - a) ** 2
    return abs(point - a - min(max(share, 0.0), 1.0) * (b - a))


SQUARE = [30 + 0j, 30 + 10j, 10 + 10j, 10 - 10j, -10 - 10j, -10 + 10j, 10 + 10j]
FORMS = {
    "haas": (
        f"{LIVE}G17\nG112\nG1 X30. Y10. F300.\nX10.\nY-10.\nX-10.\nY10.\nX10.\nG113\nG18",
        SQUARE,
    ),
    "fanuc": (
        f"{LIVE}G12.1\nG1 X60. C10. F300.\nX20.\nC-10.\nX-20.\nC10.\nX20.\nG13.1",
        SQUARE,
    ),
    "siemens": (
        "G94 G97 S600 M3 DIAMOF\nG0 X30 C0 Z5\nTRANSMIT\nG17\nG1 X30 Y10 F300\nX10\nY-10\nX-10\n"
        "Y10\nX10\nTRAFOOF\nG18",
        SQUARE,
    ),
}


@pytest.mark.parametrize("dialect", FORMS)
def test_chords_stay_on_straight_lines_and_keep_the_feed(dialect: str) -> None:
    source, corners = FORMS[dialect]
    moves = chords(source, dialect)
    sides = list(pairwise(corners))
    at = 0
    for move in moves:
        if abs(points(move)[0] - corners[at + 1]) < 1e-9:
            at += 1
        assert all(off_line(point, *sides[at]) <= TOLERANCE * 1.2 for point in points(move))
    assert abs(points(moves[-1])[-1] - corners[-1]) < 1e-9
    length = sum(abs(b - a) for a, b in sides)
    assert seconds(moves) == pytest.approx(length / 5.0, rel=1e-4)
    assert max(abs(move[1][1] - move[0][1]) for move in moves) <= 22.5
    assert moves[-1][1][1] == pytest.approx(45.0 - 360.0)


def test_an_arc_and_a_helix_follow_the_circle() -> None:
    source = f"{LIVE}G17 G112\nG1 X15. Y0 F600.\nG3 X15. Y0 Z3. I-5. J0\nG113"
    moves = chords(source, "haas")
    arc = [move for move in moves if move[1][2] < 5.0]
    for move in arc:
        assert all(abs(abs(point - 10.0) - 5.0) <= TOLERANCE * 1.2 for point in points(move))
    assert seconds(arc) == pytest.approx(math.hypot(math.tau * 5.0, 2.0) / 10.0, rel=1e-4)
    turned = [(point - 10.0) / 5.0 for point in (points(move)[0] for move in arc)]
    assert all((b / a).imag > 0.0 for a, b in pairwise(turned))


def test_a_circle_about_the_spindle_turns_c_only() -> None:
    source = f"{LIVE}G17 G112\nG1 X20. F600.\nG2 X20. Y0 I-20. J0\nG113"
    circle = [move for move in chords(source, "haas") if move[0][1] != move[1][1]]
    assert {move[1][0] for move in circle} == {20.0}
    assert circle[-1][1][1] == pytest.approx(-360.0)
    assert {round(move[2], 6) for move in circle} == {round(math.degrees(10.0 / 20.0), 6)}


def test_c_turns_at_the_pole() -> None:
    moves = chords(f"{LIVE}G17 G112\nG1 X10. F600.\nX-10.\nY5.\nG113", "haas")
    ends = [(round(x, 6), round(c, 6)) for _, (x, c, _), _ in moves]
    assert ends[:4] == [(10.0, 0.0), (0.0, 0.0), (0.0, 180.0), (10.0, 180.0)]
    assert math.isnan(moves[2][2])
    assert ends[-1] == pytest.approx((math.hypot(10, 5), 180.0 - math.degrees(math.atan(0.5))))


def test_the_virtual_axis_of_fanuc_begins_at_0_and_x_is_a_diameter() -> None:
    source = f"{LIVE}G0 C30.\nG12.1\nG1 X40. F600.\nG3 X0 C20. R20.\nG13.1\nG0 X90. C0."
    found = block_summaries(f"{source}\nM30", **options("fanuc"))
    assert found[-3] == "rapid 45 0 5"
    x, c, _ = chords(source, "fanuc")[-1][1]
    assert (x, c) == pytest.approx((20.0, 120.0))


def test_cutter_compensation_acts_on_the_face() -> None:
    source = (
        f"{LIVE}T0101\nG0 X60. C0.\nG12.1\nG1 G42 X40. F600.\nC10.\nX-40.\nC-10.\nX40.\nC5.\n"
        "G40 X60.\nG13.1"
    )
    places = [points(move)[-1] for move in chords(source, "fanuc")]
    # The path is a rectangle of 40 by 20 mm; the centre of the cutter, of 8 mm, is 4 mm outside.
    for corner in (24 + 14j, -24 + 14j, -24 - 14j, 24 - 14j):
        assert min(abs(place - corner) for place in places) < 4.0
    inside = [place for place in places if abs(place.real) < 23.9 and abs(place.imag) < 13.9]
    assert all(abs(place.real) > 19.9 or abs(place.imag) > 9.9 for place in inside)


def test_blending_and_plane_are_as_before_afterwards() -> None:
    source = f"{LIVE}G12.1\nG1 X40. F600.\nG13.1\nG3 X50. Z0. R5."
    blocks = run(f"{source}\nM30", **options("fanuc"))
    controls = [block.control for block in blocks if isinstance(block, PathMode)]
    assert controls == ["blend", "exact-path"]


ERRORS = {
    "no C axis": ("fanuc", "G0 X60. Z5.\nG12.1", "axis-missing", ("x", "z")),
    "a traverse": ("fanuc", "G12.1\nG0 X10.", "face-code", AXES),
    "a letter Y": ("fanuc", "G12.1\nG1 X10. Y5. F100.", "face-code", AXES),
    "a letter C": ("haas", "G112\nG1 X10. C5. F100.", "face-code", AXES),
    "a tool": ("fanuc", "G12.1\nT0101", "face-code", AXES),
    "an offset": ("haas", "G112\nG55", "face-code", AXES),
    "a return": ("haas", "G112\nG28 U0", "face-code", AXES),
    "machine coordinates": ("haas", "G112\nG53 G0 X0", "face-code", AXES),
    "a cycle": ("fanuc", "G12.1\nG90 X30. Z-5.", "face-code", AXES),
    "below the axis": ("fanuc", "G0 X-10.\nG12.1", "face-start", AXES),
}


@pytest.mark.parametrize("name", ERRORS)
def test_errors(name: str) -> None:
    dialect, source, code, axes = ERRORS[name]
    start = "" if dialect == "siemens" else "G98 G97 S600 M3\n"
    with pytest.raises(GcodeError) as caught:
        run(f"{start}{source}\nM30", **options(dialect, axes))
    assert caught.value.diagnostic.code == code
