"""Programs with offset codes: blocks computed by hand or by formula."""

from __future__ import annotations

import math

import pytest

from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from cnc.gcode.reader.parameters import Parameters
from tests.support.gcode.gcode_cases import assert_blocks, error_of, run
from tests.support.gcode.offset_tools import table

INCH = 25.4
ROOT = math.sqrt(3.0) / 2.0
XYZ = ("x", "y", "z")


def ends(*points: tuple[float, ...]) -> list[tuple[str | float, ...]]:
    return [("rapid", *point) for point in points]


CASES = {
    # rotation
    "R turns counter-clockwise": (
        "G10 L2 P1 R30\nG0 X10\nY10",
        ends((10 * ROOT, 5, 0), (10 * ROOT - 5, 5 + 10 * ROOT, 0)),
    ),
    "R about the origin": ("G10 L2 P1 X100 Y50 R90\nG0 X1 Y2 Z3", ends((98, 51, 3))),
    "R0 turns back": ("G10 L2 P1 R90\nG10 L2 P1 R0\nG0 X1 Y2", ends((1, 2, 0))),
    "R of a system not in use": (
        "G10 L2 P2 R90\nG0 X1 Y2\nG55 X1 Y2\nG54 X0",
        ends((1, 2, 0), (-2, 1, 0), (0, 1, 0)),
    ),
    "one word moves both axes": ("G10 L2 P1 R90\nG0 X1 Y2\nX5", ends((-2, 1, 0), (-2, 5, 0))),
    "increments turn": ("G10 L2 P1 X100 R90\nG91 G0 X1\nY2 Z3", ends((0, 1, 0), (-2, 1, 3))),
    "Z alone": ("G10 L2 P1 Z5 R45\nG0 Z1", ends((0, 0, 6))),
    "arc under R": ("G10 L2 P1 R90\nG2 X10 I5 F60", [("arc", "XY", 0, 5, 0, 10, 0, 5, -0.5, 60)]),
    "G53 does not turn": ("G10 L2 P1 R90\nG53 G0 X1 Y2\nG0 X1", ends((1, 2, 0), (1, 1, 0))),
    "G52 turns": ("G10 L2 P1 X100 R90\nG52 X10\nG0 X1 Y2", ends((98, 11, 0))),
    "G92 under R": ("G10 L2 P1 R90\nG53 G0 X10 Y20\nG92 X1\nX0 Y0", ends((10, 20, 0), (0, 19, 0))),
    "R without a change": ("G10 L2 P0\nG0 X1", ends((1, 0, 0))),
    # G10 L20
    "L20": ("G0 X10 Y5\nG10 L20 P1 X2\nX2 Y5", ends((10, 5, 0), (10, 5, 0))),
    "L20 of another system": (
        "G0 X10 Y5\nG10 L20 P2 X2 Y1\nG55 X0 Y0",
        ends((10, 5, 0), (8, 4, 0)),
    ),
    "L20 counts the tool": (
        "G43 H2\nG53 G0 Z150\nG10 L20 P1 Z10\nZ0",
        ends((0, 0, 150), (0, 0, 140)),
    ),
    "L20 under R keeps the other coordinate": (
        "G10 L2 P1 R90\nG53 G0 X10 Y20\nG10 L20 P1 X5\nG0 X5 Y-10",
        ends((10, 20, 0), (10, 20, 0)),
    ),
    "L20 P0": ("G55 G0 X3\nG10 L20 P0 X0\nX1\nG54 X1", ends((3, 0, 0), (4, 0, 0), (1, 0, 0))),
    # G52
    "G52": ("G52 X10 Y20\nG0 X1 Y1\nG52 X0 Y0\nX1 Y1", ends((11, 21, 0), (1, 1, 0))),
    "G52 keeps the axes without a word": ("G52 X10\nG52 Y5\nG0 X1 Y1", ends((11, 6, 0))),
    "G52 does not add": ("G52 X10\nG52 X3\nG0 X1", ends((4, 0, 0))),
    "G52 takes the place of G92": ("G92 X100\nG52 X5\nG0 X1", ends((6, 0, 0))),
    "G52 in every system": ("G10 L2 P2 X100\nG52 X5\nG55 G0 X1", ends((106, 0, 0))),
    "G52 in inches": ("G20 G52 X1\nG0 X1", ends((2 * INCH, 0, 0))),
    "G52 is not incremental": ("G91 G52 X5\nG52 X6\nG90 G0 X0", ends((6, 0, 0))),
    # G28, G30
    "G28": ("G0 X5 Y6 Z7\nG28", ends((5, 6, 7), (0, 0, 0))),
    "G28.1": ("G0 X1 Y2 Z3\nG28.1\nX9 Y9 Z9\nG28", ends((1, 2, 3), (9, 9, 9), (1, 2, 3))),
    "G30 is another place": (
        "G0 X1\nG30.1\nX9\nG28\nG30",
        ends((1, 0, 0), (9, 0, 0), (0, 0, 0), (1, 0, 0)),
    ),
    "G28 by a point": ("G0 X5 Y6 Z7\nG28 Z20", ends((5, 6, 7), (5, 6, 20), (5, 6, 0))),
    "G28 up first": ("G0 X5 Y6 Z7\nG91 G28 Z0\nG28 X0 Y0\nG90 G0 X1",
        ends((5, 6, 7), (5, 6, 7), (5, 6, 0), (5, 6, 0), (0, 0, 0), (1, 0, 0))),
    "the point has offsets, the stored place has none": (
        "G10 L2 P1 X100 Z10\nG92 Z-3\nG43 H1\nG28 X1 Z5", ends((101.5, 0, 48), (0, 0, 0))),
    "the point in inches": ("G20 G28 X1", ends((INCH, 0, 0), (0, 0, 0))),
    "the axes under R": (
        "#5161=1 #5162=2\nG10 L2 P1 R90\nG28 X5\nG28 Y3",
        ends((0, 5, 0), (0, 2, 0), (-3, 2, 0), (1, 2, 0)),
    ),
    "G28.1 stores what the machine is at": (
        "G10 L2 P1 X100 R90\nG43 H2\nG0 X1 Y0 Z1\nG28.1\nG49 G54\n"
        "#1=[#5161+#5162+#5163]\nG53 G0 X#1", ends(
            (100, 1, 101), (202, 1, 101))),
    "a parameter is a place": ("#5163=30\nG28 Z50", ends((0, 0, 50), (0, 0, 30))),
    "a motion code beside G28": (
        "G1 X1 F60\nG0 G28 Z5\nX2",
        [("line", 1, 0, 0, 60), *ends((1, 0, 5), (1, 0, 0), (2, 0, 0))],
    ),
    # tool offsets
    "G43 H": ("G43 H1\nG0 X0 Z0", ends((0.5, 0, 40))),
    "G43 and a move": ("G0 G43 H1 Z5", ends((0, 0, 45))),
    "G43 of the loaded tool": ("T2 M6\nG43\nG0 Z1", [("tool", 2), ("rapid", 0, 0, 101)]),
    "G43 H0 is the loaded tool": ("T2 M6\nG43 H0\nG0 Z1", [("tool", 2), ("rapid", 0, 0, 101)]),
    "M6 alone applies nothing": ("T2 M6\nG0 Z1", [("tool", 2), ("rapid", 0, 0, 1)]),
    "a tool change keeps the offset": ("G43 H1\nT2 M6\nG0 Z1", [("tool", 2), ("rapid", 0, 0, 41)]),
    "M61 and G43": ("M61 Q2\nG43\nG0 Z1", [("tool", 2), ("rapid", 0, 0, 101)]),
    "G43 with no tool": ("G43\nG0 Z1", ends((0, 0, 1))),
    "G43 is not added": ("G43 H1\nG43 H2\nG0 X1 Z1", ends((1, 0, 101))),
    "G49": ("G43 H1\nG49\nG0 Z1", ends((0, 0, 1))),
    "G43.1": ("G43.1 X1 Z2\nG0 X0 Y0 Z0", ends((1, 0, 2))),
    "G43.1 replaces what it names": ("G43 H1\nG43.1 Z2\nG0 X0 Z0", ends((0.5, 0, 2))),
    "G43.1 in inches": ("G20 G43.1 Z1\nG0 Z0", ends((0, 0, INCH))),
    "G43.2 H adds": ("G43 H1\nG43.2 H2\nG43.2 H2\nG0 X0 Z0", ends((0.5, 0, 240))),
    "G43.2 axes add": ("G43 H1\nG43.2 X1 Z2\nG0 X0 Z0", ends((1.5, 0, 42))),
    "the tool does not turn": ("G10 L2 P1 R90\nG43.1 X5\nG0 X1 Y0", ends((5, 1, 0))),
    "G92 counts the tool": (
        "G43 H2\nG53 G0 Z150\nG92 Z0\nG49 G0 Z0",
        ends((0, 0, 150), (0, 0, 50)),
    ),
    "the loaded tool in parameters": (
        "T1 M6\n#1=[#5400*1000+#5401*100+#5403+#5410]\nG0 X#1",
        [("tool", 1), ("rapid", 1096, 0, 0)],
    ),
    "_tool_offset": (
        "G43 H1\n#1=#<_tool_offset>\nG49\nG0 X[#1*10+#<_tool_offset>]",
        ends((10, 0, 0)),
    ),
    # the tool table written
    "G10 L1": ("G10 L1 P2 Z7\nG43 H2\nG0 Z0", ends((0, 0, 7))),
    "G10 L1 in inches": ("G20 G10 L1 P2 Z1\nG43 H2\nG0 Z0", ends((0, 0, INCH))),
    "G10 L1 keeps the other axes": ("G10 L1 P1 Z7\nG43 H1\nG0 X0 Z0", ends((0.5, 0, 7))),
    "G10 L1 waits for G43": (
        "G43 H2\nG10 L1 P2 Z7\nG0 Z0\nG43 H2 Z0",
        ends((0, 0, 100), (0, 0, 7)),
    ),
    "G10 L1 R I J Q": (
        "M61 Q3\nG10 L1 P3 R2 I10 J20 Q5\nG0 X[#5410*1000+#5411*10+#5412+#5413/10]",
        [("tool", 3), ("rapid", 4120.5, 0, 0)],
    ),
    "G10 L10": (
        "G10 L2 P1 Z5\nG92 Z-3\nG53 G0 Z100\nG10 L10 P3 Z10\nG43 H3 Z10",
        ends((0, 0, 100), (0, 0, 100)),
    ),
    "G10 L10 under a tool": (
        "G43 H2\nG53 G0 Z100\nG10 L10 P2 Z10\nG0 Z10\nG43 H2 Z10",
        ends((0, 0, 100), (0, 0, 110), (0, 0, 100)),
    ),
    "G10 L11": (
        "G10 L2 P9 Z5\nG10 L2 P1 Z77\nG92 Z-3\nG53 G0 Z100\nG10 L11 P3 Z10\nG43 H3\n"
        "G92.1 G59.3 G0 Z10",
        ends((0, 0, 100), (0, 0, 100))),
    "G10 L0 without a file": ("G10 L1 P2 Z7\nG10 L0\nG43 H2\nG0 Z0", ends((0, 0, 7))),
    # parameters
    "present position": (
        "G10 L2 P1 X10 R90\nG43 H2\nG53 G0 X10 Y5 Z102\nG0 X[#5420*100+#5421*10+#5422] Y0",
        ends((10, 5, 102), (10, 502, 102))),
    "present position in inches": ("G20 G0 X2\nG1 X[#5420+#<_abs_x>+#<_x>] F60",
        [("rapid", 2 * INCH, 0, 0), ("line", 6 * INCH, 0, 0, 60 * INCH)]),
    "the number of the system": ("G56\nG0 X[#5220*1000+#<_coord_system>]", ends((3560, 0, 0))),
    "an assignment waits": (
        "#5221=10\nG0 X0\nG54 X0\nG55 X0\nG54 X0",
        ends((0, 0, 0), (0, 0, 0), (0, 0, 0), (10, 0, 0)),
    ),
    "an assignment and G10": ("#5221=10\nG10 L2 P1 Y5\nG0 X0 Y0", ends((10, 5, 0))),
    "an assignment and an empty G10": ("#5221=10\nG10 L2 P0\nG0 X0 Y0", ends((10, 0, 0))),
    "an assignment and G92.3": ("#5211=10\nG0 X0\nG92.3\nX0", ends((0, 0, 0), (10, 0, 0))),
    "M70 saves the system and the tool": (
        "G55 G43 H2\nM70\nG54 G49\nM72\nG0 Z[#5220]",
        ends((0, 0, 102)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_blocks(name: str) -> None:
    source, expected = CASES[name]
    assert_blocks(source, *expected, tools=table())


FANUC = {
    "G43 H": ("G43 H1\nG0 X1 Z0", ends((1, 0, 40))),
    "G44 H": ("G44 H1\nG0 X1 Z0", ends((1, 0, -40))),
    "G43 Z H": ("G90 G0 G43 Z5 H2", ends((0, 0, 105))),
    "H0": ("G43 H2\nG43 H0\nG0 Z1", ends((0, 0, 1))),
    "L10 and L11": ("G10 L10 P5 R50\nG10 L11 P5 R-0.5\nG43 H5\nG0 Z0", ends((0, 0, 49.5))),
    "L10 adds under G91": (
        "G10 L10 P5 R50\nG91 G10 L10 P5 R1\nG90 G43 H5\nG0 Z0",
        ends((0, 0, 51)),
    ),
    "L11 adds under G91": (
        "G10 L11 P2 R1\nG91 G10 L11 P2 R1\nG90 G43 H2\nG0 Z0",
        ends((0, 0, 102)),
    ),
    "L10 in inches": ("G20 G10 L10 P5 R1\nG43 H5\nG0 Z0", ends((0, 0, INCH))),
    "P0 is everywhere": (
        "G10 L2 P0 X1\nG10 L2 P2 X100\nG0 X0\nG55 X0",
        ends((1, 0, 0), (101, 0, 0)),
    ),
    "G52 and G92 are two": ("G92 X10\nG52 X5\nG0 X0\nG52 X0\nX0", ends((-5, 0, 0), (-10, 0, 0))),
    "G52 stays": ("G10 L2 P2 X100\nG52 X5\nG55 G0 X0", ends((105, 0, 0))),
    "G92 ends G52": ("G52 X5 Y5\nG92 X0\nG0 X1 Y0", ends((1, 5, 0))),
    "G28": ("G0 X5 Z5\nG91 G28 Z0\nG90 X5", ends((5, 0, 5), (5, 0, 5), (5, 0, 0), (5, 0, 0))),
    "G0 G28": ("G0 G91 G28 X0 Y0 Z0", ends((0, 0, 0), (0, 0, 0))),
    "G30": ("#5183=30\nG91 G30 Z0\nG30 P2 Z0", ends((0, 0, 0), (0, 0, 30), (0, 0, 30), (0, 0, 30))),
    "G54.1": (
        "G10 L20 P1 X10\nG10 L20 P48 X480\nG0 G54.1 P1 X1\nG54.1 P48 X1\nG54 X1",
        ends((11, 0, 0), (481, 0, 0), (1, 0, 0)),
    ),
    "G54.1 and its variables": (
        "#7001=10\n#7941=480\nG0 G54.1 P1 X0\nG54.1 P48 X0\n#7941=0\nX0",
        ends((10, 0, 0), (480, 0, 0), (0, 0, 0)),
    ),
    "L20 adds under G91": (
        "G10 L20 P1 X10\nG91 G10 L20 P1 X5\nG90 G54.1 P1 G0 X0",
        ends((15, 0, 0)),
    ),
    "the external offset's variable": (
        "#5201=7\nG0 X0\nG10 L2 P0 X[#5201+1]\nX0",
        ends((7, 0, 0), (8, 0, 0)),
    ),
    "a variable is in effect at once": ("#5221=10\nG0 X0", ends((10, 0, 0))),
}


@pytest.mark.parametrize("name", FANUC)
def test_fanuc_blocks(name: str) -> None:
    source, expected = FANUC[name]
    assert_blocks(source, *expected, dialect="fanuc", tools=table())


GRBL = {
    "G43.1": ("G43.1 Z5\nG0 X0 Z0\nG49 Z0", ends((0, 0, 5), (0, 0, 0))),
    "G28.1": (
        "G0 X1 Y2\nG28.1\nX5\nG28 X9\nG28",
        ends((1, 2, 0), (5, 2, 0), (9, 2, 0), (1, 2, 0), (1, 2, 0)),
    ),
    "L20 P0": ("G0 X10\nG10 L20 P0 X2\nX3", ends((10, 0, 0), (11, 0, 0))),
    "G53 under G91": ("G0 X5\nG91 G53 X1", ends((5, 0, 0), (1, 0, 0))),
    "G92.1": ("G92 X5\nG0 X0\nG92.1\nX0", ends((-5, 0, 0), (0, 0, 0))),
}


@pytest.mark.parametrize("name", GRBL)
def test_grbl_blocks(name: str) -> None:
    source, expected = GRBL[name]
    assert_blocks(source, *expected, dialect="grbl")


def test_without_a_tool_table() -> None:
    found = error_of("G43 H1")
    assert found.code == "tool-table-missing"
    assert "tool_table" in found.hint


def test_the_hint_names_the_tool_table() -> None:
    tools = ToolTable([ToolEntry(1)], file="mill.tbl")
    assert error_of("G43 H2", tools=tools).hint == "add T2 to mill.tbl"


def test_rotation_needs_both_axes() -> None:
    assert error_of("G10 L2 P1 R5", axes=("x", "z")).code == "axis-missing"


def test_offsets_of_additional_axes() -> None:
    axes = ("x", "z", "u", "a")
    assert_blocks(
        "G43 H1\nG0 X0 Z0 U0 A0\nG10 L1 P1 A5\nG43 H1 A0",
        *ends((0.5, 40, 9, 0), (0.5, 40, 9, 5)),
        axes=axes,
        tools=table(),
    )


def test_state_after_a_program() -> None:
    parameters = Parameters()
    run("G55\nG10 L2 P2 X1 R45\nG53 G0 X9\nG28.1\nG52 Y3\nM2", parameters=parameters)
    stored = parameters.stored()
    assert [stored[number] for number in (5220, 5241, 5250, 5161, 5210, 5211, 5212)] == [
        1,
        1,
        45,
        9,
        1,
        0,
        3,
    ]
    assert 5420 not in stored


def test_without_m2_the_system_stays() -> None:
    parameters = Parameters()
    run("G55\nG10 L2 P2 X1", parameters=parameters)
    assert parameters.stored()[5220] == 2
    assert_blocks("G0 X1", *ends((2, 0, 0)), parameters=Parameters(parameters.stored()))


def test_fanuc_clears_the_local_offset() -> None:
    parameters = Parameters(macro=True)
    run("G52 X5\nM30", dialect="fanuc", parameters=parameters)
    assert_blocks(
        "G0 X1",
        *ends((1, 0, 0)),
        dialect="fanuc",
        parameters=Parameters(parameters.stored(), macro=True),
    )


@pytest.mark.parametrize(
    ("dialect", "x"), [("linuxcnc", 6.0), ("auto", 6.0), ("fanuc", 1.0), ("grbl", 6.0)]
)
def test_a_shift_after_the_program_by_dialect(dialect: str, x: float) -> None:
    """M2 of GRBL 1.1 keeps the shift of G92, which only a reset of the board ends."""
    stored = {5210: 1.0, 5211: 5.0}
    parameters = Parameters(stored, macro=dialect == "fanuc")
    assert_blocks("G0 X1\nM2", ("rapid", x, 0, 0), ("end",), dialect=dialect, parameters=parameters)


def test_a_program_changes_the_table_not_its_file() -> None:
    tools = table()
    run("G10 L1 P1 Z3", tools=tools)
    assert tools.changed
    entry = tools.tool(1)
    assert entry is not None
    assert (entry.offsets, entry.diameter) == ({"X": 0.5, "Z": 3.0, "U": 9.0}, 6.0)


def test_radii_of_the_offset_memory() -> None:
    tools = ToolTable()
    run("G10 L12 P4 R3\nG10 L13 P4 R-0.25", dialect="fanuc", tools=tools)
    entry = tools.tool(4)
    assert entry is not None
    assert (entry.diameter, entry.radius) == (6.0, 2.75)
