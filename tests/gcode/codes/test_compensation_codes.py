"""Programs with G40 to G42.1: blocks computed by hand, and errors with their places."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from cnc.gcode.core.program import ProgramOptions, interpret
from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from cnc.gcode.reader.source_text import Text
from cnc.model.blocks import Polyline
from cnc.model.diagnostics import Diagnostic, GcodeError
from tests.support.gcode.gcode_cases import (
    Row,
    assert_blocks,
    assert_error_at,
    error_of,
    run,
)

OFF = math.sqrt(0.5)
END: Row = ("end",)


def tools() -> ToolTable:
    """Tools of 10 mm and 4 mm, one that is 0.2 mm too small for its contour, one without a
    diameter, one for turning.
    """
    return ToolTable(
        [
            ToolEntry(1, diameter=10.0),
            ToolEntry(2, diameter=4.0),
            ToolEntry(3, diameter=-0.2),
            ToolEntry(4),
            ToolEntry(5, diameter=10.0, orientation=2),
        ]
    )


ALONG = "G1 F60 X20\nX40\n"
"""Entry and a move along X; compensated by r to the left, both end at Y r."""


# how the radius is told: D of the table, the tool in the spindle, D0, G10, units, the diameter
# itself
@pytest.mark.parametrize(
    ("source", "y"),
    [
        ("G41 D1\n" + ALONG, 5.0),
        ("G42 D1\n" + ALONG, -5.0),
        ("G41 D3\n" + ALONG, -0.1),
        ("G42 D3\n" + ALONG, 0.1),
        ("T2 M6\nG41\n" + ALONG, 2.0),
        ("T2 M6\nG41 D0\n" + ALONG, 2.0),
        ("T2 M6\nG42 D1\n" + ALONG, -5.0),
        ("M61 Q2\nG41\n" + ALONG, 2.0),
        ("G10 L1 P1 R3\nG41 D1\n" + ALONG, 3.0),
        ("#1 = 2\nG41 D#1\n" + ALONG, 2.0),
        ("G41.1 D8\n" + ALONG, 4.0),
        ("G42.1 D8\n" + ALONG, -4.0),
        ("G42.1 D-8\n" + ALONG, 4.0),
        ("G41.1 D[2*3+1]\n" + ALONG, 3.5),
        ("G20 G41.1 D.1\nG21\n" + ALONG, 1.27),
        ("G20 G41 D2\nG21\n" + ALONG, 2.0),
        ("G41 D4\n" + ALONG, 0.0),
        ("G41\n" + ALONG, 0.0),
        ("G41 D0\n" + ALONG, 0.0),
        ("G41.1 D0\n" + ALONG, 0.0),
        ("G41 D5\n" + ALONG, 5.0),
        ("G41 D1\n(a block between) G4 P0\n" + ALONG, 5.0),
        ("G41 D1 G1 F60 X20\nX40\n", 5.0),
        ("G41 D1\nG1 F60 X20\nG17 G21 G90\nX40\n", 5.0),
    ],
)
def test_the_radius(source: str, y: float) -> None:
    lines = [block for block in run(source, tools=tools()) if isinstance(block, Polyline)]
    points = [point for block in lines for point in block.points.tolist()]
    assert [value for point in points for value in point] == pytest.approx(
        [20, y, 0, 40, y, 0], abs=1e-12
    )


def test_fanuc_keeps_the_number_of_the_offset() -> None:
    source = (
        "G10 L12 P7 R4.\nG10 L13 P7 R.5\nG41 D7\nG1 F60. X20.\nG40 X30. Y-9.\nG42 X60. Y0\nX80.\n"
    )
    length = math.hypot(30, 9)
    right = 4.5 * 9 / length, -4.5 * 30 / length
    end: tuple[float, float] = (60 + right[0], right[1])
    around: Row = ("line", *end, 0, 60)
    turn = math.atan2(9, 30)
    expected = [("line", 20, 4.5, 0, 60), ("line", 30, -9, 0, 60)]
    # the next move turns right, to the tool: both end where the offset lines cross
    cut = 4.5 * math.tan(turn / 2)
    crossing: Row = ("line", end[0] - cut * 30 / length, end[1] - cut * 9 / length, 0, 60)
    assert around[0] == crossing[0]
    assert_blocks(source, *expected, crossing, ("line", 80, -4.5, 0, 60), dialect="fanuc")


SQUARE = """\
G0 X-10 Y-10
G41 D1
G1 X0 Y0 F600
Y30
X30
Y0
X-10
G40
G0 X-20 Y-20
M2
"""


def test_a_square() -> None:
    """From 45 degrees below: the end of the entry lies beside it, and the corner there is an inside
    one: y is where x + 5 sqrt 2 = y.
    """
    assert_blocks(
        SQUARE,
        ("rapid", -10, -10, 0),
        ("line", -5, -5 + 10 * OFF, 0, 600),
        ("line", -5, 30, 0, 600),
        ("arc", "XY", 0, 30, 0, 35, 0, 5, -0.25, 600),
        ("line", 30, 35, 0, 600),
        ("arc", "XY", 30, 30, 35, 30, 0, 5, -0.25, 600),
        ("line", 35, 0, 0, 600),
        ("arc", "XY", 30, 0, 30, -5, 0, 5, -0.25, 600),
        ("line", -10, -5, 0, 600),
        ("rapid", -20, -20, 0),
        END,
        tools=tools(),
    )


def test_blocks_between_moves_keep_their_place() -> None:
    source = """\
G41 D2
G1 X10 F60
X20
Z-1
M3 S100
(MSG, corner)
F120
G4 P2
G64 P0.1
Y10
M0
M9
G0 Z5
X40
M62 P3
M30
"""
    far = 2 / math.cos(math.pi / 8)
    vertices = [
        (20 + far * math.cos(math.radians(a)), 10 + far * math.sin(math.radians(a)))
        for a in (157.5, 112.5)
    ]
    found = run(source, tools=tools())
    kinds = [type(block).__name__ for block in found]
    assert (
        " ".join(kinds)
        == "Polyline Spindle Message Dwell PathMode Polyline Stop Coolant Polyline DigitalOutput "
        "Spindle End"
    )
    first, second, third = (block for block in found if isinstance(block, Polyline))
    assert first.points.tolist() == [[10, 2, 0], [18, 2, 0], [18, 2, -1]]
    assert second.points.tolist() == [[18, 10, -1]]
    assert second.feeds.tolist() == [2.0]
    assert third.points[0].tolist() == [18, 10, 5]
    assert third.points[1:3, :2].tolist() == [pytest.approx(vertex) for vertex in vertices]
    assert third.points[3:].tolist() == [[20, 12, 5], [40, 12, 5]]
    assert third.lines.tolist() == [13, 14, 14, 14, 14]


def test_an_arc_in_another_plane() -> None:
    """ZX, where left of +X is -Z, and G2 turns X towards Z."""
    assert_blocks(
        "G18 G41.1 D4\nG1 X10 F60\nG2 X20 Z10 K10\nG1 Z20\n",
        ("line", 10, 0, -2, 60),
        ("arc", "ZX", 10, 10, 22, 0, 10, 12, -0.25, 60),
        ("line", 22, 0, 20, 60),
    )


# the control point seen from the nose's centre, Z and X, in radii
@pytest.mark.parametrize(
    ("orientation", "z", "x"),
    [
        (0, 0, 0),
        (1, 1, -1),
        (2, -1, -1),
        (3, -1, 1),
        (4, 1, 1),
        (5, 1, 0),
        (6, 0, -1),
        (7, -1, 0),
        (8, 0, 1),
        (9, 0, 0),
    ],
)
def test_turning_tools(orientation: int, z: int, x: int) -> None:
    expected = [("line", end + 5 * x, 0, 5 * z - 5, 60) for end in (20, 40)]
    assert_blocks(f"G18 G41.1 D10 L{orientation}\n{ALONG}", *expected)
    assert_blocks(f"G18\nG10 L1 P5 Q{orientation}\nG41 D5\n{ALONG}", *expected, tools=tools())


def test_the_coordinate_system_may_be_shifted_rotated_and_in_inches() -> None:
    half = 0.5 * math.sqrt(3)
    assert_blocks(
        "G10 L2 P1 X100 R30\nG20 G41.1 D[4/25.4]\nG0 X[10/25.4] Y0\nX[20/25.4]\n",
        ("rapid", 100 + 10 * half - 1, 5 + 2 * half, 0),
        ("rapid", 100 + 20 * half - 1, 10 + 2 * half, 0),
        start=[100.0, 0.0, 0.0],
    )


def test_the_move_after_g40_leads_out_even_across_the_plane() -> None:
    assert_blocks(
        "G41.1 D4\nG1 X10 F60\nG40\nZ5\nX20\n",
        ("line", 10, 2, 0, 60),
        ("line", 10, 0, 5, 60),
        ("line", 20, 0, 5, 60),
    )


def test_arcs_and_splines_may_follow_the_lead_out() -> None:
    source = "G41.1 D4\nG1 X10 F60\nG40 X20\nG3 X20 Y10 J5\nG5.1 X30 Y0 I5 J5\n"
    assert [type(block).__name__ for block in run(source)] == ["Polyline", "ArcFeed", "NurbsFeed"]


def test_loops_and_subroutines_read_the_programmed_position() -> None:
    source = "G41.1 D2\nG1 F60 X10\nO1 repeat [3]\nX[#5420+10]\nO1 endrepeat\nM2\n"
    assert_blocks(source, *[("line", 10.0 * n, 1, 0, 60) for n in (1, 2, 3, 4)], END)


def test_a_contour_over_two_files_names_both(tmp_path: Path) -> None:
    (tmp_path / "side.ngc").write_text("o<side> sub\nG1 X20\nX30\no<side> endsub\n")
    source = "G41.1 D2\nG1 F60 X10\no<side> call\nG1 X40\nX50\nM2\n"
    blocks = interpret(
        Text.of_lines(source.split("\n"), "main.ngc"), options=ProgramOptions(folders=[tmp_path])
    )
    found = [
        (Path(block.file).name, line)
        for block in blocks
        if isinstance(block, Polyline)
        for line in block.lines.tolist()
    ]
    assert found == [
        ("main.ngc", 2),
        ("side.ngc", 2),
        ("side.ngc", 3),
        ("main.ngc", 4),
        ("main.ngc", 5),
    ]


def test_an_error_in_the_file_before(tmp_path: Path) -> None:
    (tmp_path / "side.ngc").write_text("o<side> sub\nG1 X20\n  Y1\no<side> endsub\n")
    source = "G41.1 D4\nG1 F60 X10\no<side> call\nG1 X40\nX50\nM2\n"
    with pytest.raises(GcodeError) as caught:
        list(
            interpret(
                Text.of_lines(source.split("\n"), "main.ngc"),
                options=ProgramOptions(folders=[tmp_path]),
            )
        )
    found = caught.value.diagnostic
    assert (found.code, Path(found.file).name, found.line, found.column) == (
        "compensation-gouge",
        "side.ngc",
        3,
        3,
    )


def test_a_radius_of_0_is_a_warning() -> None:
    said: list[Diagnostic] = []
    run("G41\nG1 F60 X20\n", warn=said.append)
    assert [(one.code, one.line, one.column) for one in said] == [
        ("compensation-radius-zero", 1, 1)
    ]


ON = "G41 D2\nG1 F60 X20\nX40\n"


# ¦ stands before the column of the error
@pytest.mark.parametrize(
    ("source", "code"),
    [
        # the codes themselves
        (ON + "¦G41 D2", "compensation-already-on"),
        (ON + "X50 ¦G42 D2", "compensation-already-on"),
        (ON + "¦G42.1 D3", "compensation-already-on"),
        ("¦G41.1", "compensation-diameter-missing"),
        ("¦G42.1 L3", "compensation-diameter-missing"),
        ("G41.1 D3 ¦L2", "compensation-orientation"),
        ("G18 G41.1 D3 ¦L10", "value-out-of-range"),
        ("G41 ¦D77", "tool-unknown"),
        ("G41 ¦D1.5", "value-out-of-range"),
        ("G41 ¦D-1", "value-out-of-range"),
        ("T77 M6\n¦G41", "tool-unknown"),
        ("G41 ¦L3 D2", "word-unused"),
        ("G40 ¦D2", "word-unused"),
        ("G1 F60 X3 ¦D2", "word-unused"),
        ("G40 ¦G41 D2", "modal-conflict"),
        # what may not stand under it
        (ON + "¦G18", "compensation-active"),
        (ON + "¦G53 G0 X3", "compensation-active"),
        (ON + "¦G28", "compensation-active"),
        (ON + "¦G30 X3", "compensation-active"),
        (ON + "¦G28.1", "compensation-active"),
        (ON + "¦G92 X3", "compensation-active"),
        (ON + "¦G92.1", "compensation-active"),
        (ON + "¦G52 X3", "compensation-active"),
        (ON + "¦G55", "compensation-active"),
        (ON + "¦G10 L2 P1 X3", "compensation-active"),
        (ON + "¦G10 L20 P1 X3", "compensation-active"),
        (ON + "¦G10 L1 P2 R3", "compensation-active"),
        (ON + "¦G43 H1", "compensation-active"),
        (ON + "¦G43.1 Z3", "compensation-active"),
        (ON + "T1 ¦M6", "compensation-active"),
        (ON + "¦M66 P1 L0", "compensation-active"),
        (ON + "¦G81 X3 Z-1 R1", "compensation-active"),
        (ON + "¦G38.2 X3", "compensation-active"),
        ("S100 M3\n" + ON + "¦G33 Z-1 K1", "compensation-active"),
        (ON + "¦G5.1 X60 Y0 I5 J5", "compensation-active"),
        (ON + "¦G6.2 P3 K0 X1", "fanuc-1006"),
        ("M70\nG55\n" + ON + "¦M72", "compensation-active"),
        # the first move after G40
        (ON + "G40\n¦G2 X50 Y0 R5", "compensation-exit"),
        (ON + "G40 ¦G3 X50 Y0 I5", "compensation-exit"),
        (ON + "G40\n¦G5.1 X60 Y0 I5 J5", "compensation-exit"),
        (ON + "G40\n¦G6.2 P3 K0 X1", "compensation-exit"),
        # moves that can't be cut: of this line, of the line before, or of one further up
        ("G41 D2\n¦G1 F60 X2", "compensation-entry"),
        ("G41 D2\n¦G2 X0 Y0 I5 F60", "compensation-entry"),
        (ON + "¦G3 X41 Y1 J1", "compensation-arc-radius"),
        ("G41 D2\nG1 F60 X20\n ¦Y1\nX0", "compensation-gouge"),
        ("G41 D2\nG1 F60 X20\n ¦Y3\nZ1\nM8\nG4 P1\nX0", "compensation-gouge"),
        ("G41 D2\nG1 F60 X20\n¦X40\nX0 Y0.1", "compensation-gouge"),
        ("G41 D2\nO1 sub\nG1 F60 X20\n¦G1 Y[1+1]\nX0\nO1 endsub\nO1 call", "compensation-gouge"),
    ],
)
def test_refused(source: str, code: str) -> None:
    assert_error_at(code, source, tools=tools())


@pytest.mark.parametrize(
    ("dialect", "source"), [("grbl", "G41 D1"), ("grbl", "G42.1 D1"), ("fanuc", "G41.1 D1")]
)
def test_not_in_every_dialect(dialect: str, source: str) -> None:
    assert error_of(source, dialect=dialect).code == "code-not-in-dialect"


def test_fanuc_needs_the_offset_number_once() -> None:
    assert error_of("G41 G1 X10. F60.", dialect="fanuc").code == "compensation-offset-missing"


@pytest.mark.parametrize(
    ("dialect", "hint"),
    [("linuxcnc", "write G41.1 D3.175"), ("auto", "write G41.1 D3.175"), ("fanuc", "")],
)
def test_a_diameter_beside_g41_gets_the_code_for_it(dialect: str, hint: str) -> None:
    """The firmware of Makera has the diameter of the tool as D of G41."""
    found = error_of("G41 D3.175", dialect=dialect)
    assert (found.code, found.column) == ("value-out-of-range", 5)
    assert found.hint.endswith(hint)
    assert bool(found.hint) == bool(hint)


def test_without_a_tool_table() -> None:
    assert error_of("G41 D1").code == "tool-table-missing"


def test_the_end_of_the_program_ends_the_last_move() -> None:
    for end in ("", "M2", "%"):
        options: dict[str, Any] = {"dialect": "auto"}
        source = f"{'%' if end == '%' else ''}\nG41.1 D4\nG1 X10 F60\n{end}"
        assert_blocks(source, ("line", 10, 2, 0, 60), *([END] if end == "M2" else []), **options)
