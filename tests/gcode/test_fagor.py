"""Fagor's controls for mills: what the sources have plainly is read, the rest is named.

Golden values are worked out from Autodesk's post "FAGOR 8037/8055": it writes Z for the level of a
cycle, I for its bottom, K in hundredths of a second, and centres from the start of an arc.
"""

from __future__ import annotations

import pytest

from cnc.gcode import dialects
from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from cnc.gcode.dialects.recognition import recognise
from cnc.model.blocks import Dwell, PathMode, Tool
from tests.support.gcode.gcode_cases import error_of, points, run, warnings

HEAD = "G71 G90\n"
END = "\nM30"
RULES = pytest.mark.parametrize("lenient", [False, True], ids=["named", "recognised"])


def table(**lengths: float) -> ToolTable:
    tools = ToolTable()
    for name, length in lengths.items():
        tools.put(ToolEntry(int(name[1:]), offsets={"Z": length}, diameter=4.0))
    return tools


def ends(source: str, **options: object) -> list[tuple[float, float, float]]:
    return points(HEAD + source + END, "fagor", **options)


@pytest.mark.parametrize(
    ("source", "dialect"),
    [
        ("%00000\nN0 T1.1\nN10 M6\nG0 X1 Y2", "fagor"),
        ("%PART,MX--,\nN10 G90 G94 G17\nN15 G71\nG0 X1 Y2", "fagor"),
        ("; MACHINE: FAGOR 8055\nG0 X1 Y2", "fagor"),
        ("T1\nM6\nG0 X1 Y2", "auto"),
    ],
)
def test_fagor_programs_are_recognised(source: str, dialect: str) -> None:
    assert recognise(source.split("\n")).dialect == dialect


def test_a_program_without_y_may_be_for_a_lathe() -> None:
    found = recognise(["N0 T1.1", "G0 X20 Z5", "G1 Z-5"])
    assert "may be for a lathe" in found.refusal


@RULES
def test_moves_and_arcs(lenient: bool) -> None:
    """A quarter about (0, 5) from (0, 0) ends at (-5, 5) clockwise."""
    program = f"{HEAD}G0 X0 Y0 Z0\nG2 X-5 Y5 I0 J5 F100\nG91 G1 X1{END}"
    assert points(program, "fagor", lenient=lenient)[-1] == (-4.0, 5.0, 0.0)


@RULES
def test_units(lenient: bool) -> None:
    assert points(f"G70\nG0 X1 Y0 Z0{END}", "fagor", lenient=lenient)[0][0] == 25.4
    assert points(f"G71\nG0 X1 Y0 Z0{END}", "fagor", lenient=lenient)[0][0] == 1.0


@RULES
def test_the_head_and_comments_have_no_effect(lenient: bool) -> None:
    program = f"%00000\nN0000 T1.1 (PLATE D63)\nN10 M6 ; a = 5\nn20 G0 X1 Y2 Z3{END}"
    assert points(program, "fagor", lenient=lenient) == [(1.0, 2.0, 3.0)]


def test_a_tool_with_its_offset() -> None:
    blocks = run(f"{HEAD}T09.09\nM6{END}", dialect="fagor")
    assert [each.number for each in blocks if isinstance(each, Tool)] == [9]
    tools = table(T9=30.0)
    assert ends("T9.9\nM6\nG0 G43 Z5\nG44\nZ5", tools=tools) == [(0, 0, 35.0), (0, 0, 5.0)]


@RULES
@pytest.mark.parametrize(
    ("source", "code"),
    [
        ("T2.12\nM6", "tool-offset-other"),
        ("T1.1\nM6\nG0 X0\nG41 D2 G1 X9 F9", "tool-offset-other"),
        ("T1.1\nG0 G43 Z5", "tool-not-chosen"),
        ("G4 K0.5", "decimal-point-place"),
        ("G54 X10 Y10", "offset-without-motion"),
        ("G53 X10", "offset-without-motion"),
        ("(CALL 5)", "code-not-supported"),
        ("(P100 = 5)", "code-not-supported"),
        ("G0 X1 (IF P1 EQ 2 GOTO N5)", "code-not-supported"),
        ("G0 X1 Y1\nG18\nG81 X1 Z2 I-5 F9", "cycle-plane"),
        ("G0 X1 Y1\nG91 G81 X1 Z2 I-5 F9", "cycle-distance-mode"),
        ("G83 X1 Z2 I-5 F9", "cycle-word-missing"),
        ("G83 X1 Z2 I-5 J1.5 F9", "value-out-of-range"),
        ("G81 X1 Z2 R1 I-5 F9", "word-unused"),
        ("G85 X1 Z2 I-5 K9 F9", "word-unused"),
        ("G81 X1 Z2 F9", "cycle-word-missing"),
    ],
)
def test_what_is_not_sure_is_refused(lenient: bool, source: str, code: str) -> None:
    rules = dialects.load("fagor", lenient=lenient)
    found = error_of(HEAD + source + END, dialect=rules, tools=table(T1=0.0, T2=0.0))
    assert found.code == code


@RULES
@pytest.mark.parametrize(
    "code",
    [
        "G6", "G8", "G9", "G10", "G20", "G21", "G28", "G36 R2", "G49 X1", "G51", "G52", "G58",
        "G61", "G64", "G61.1", "G72", "G73", "G74", "G84 X1", "G86 X1", "G87 X1", "G93 I1 J2",
        "G95", "G96",
    ],
)  # fmt: skip
def test_functions_of_fagor_are_named(lenient: bool, code: str) -> None:
    """Most of these numbers mean something else on other controls."""
    found = error_of(
        f"{HEAD}G0 X0 Y0\n{code}{END}", dialect=dialects.load("fagor", lenient=lenient)
    )
    assert found.code == "code-not-supported"
    assert found.line == 3


@RULES
@pytest.mark.parametrize("line", ["G1 X10 A30 F9", "G2 A90 I5 J0 F9", "G0 B5", "G1 R10 A45 F9"])
def test_angles_in_the_plane_are_no_rotary_axes(lenient: bool, line: str) -> None:
    """On Fagor's controls A is the angle of a straight line or of a polar point."""
    rules = dialects.load("fagor", lenient=lenient)
    found = error_of(f"{HEAD}G0 X0 Y0\n{line}{END}", dialect=rules, axes=("x", "y", "z", "a", "b"))
    assert (found.code, found.line) in (("axis-not-in-dialect", 3), ("word-unused", 3))


@pytest.mark.parametrize("words", ["Z2", "I-5", ""])
def test_a_missing_word_of_a_cycle_has_its_letter_of_fagor(words: str) -> None:
    found = error_of(f"{HEAD}G0 X0 Y0\nG81 X1 {words} F9{END}", dialect="fagor")
    assert (found.code, found.line) == ("cycle-word-missing", 3)
    assert "needs Z, the level, and I, the bottom" in found.message


@RULES
def test_g53_alone_selects_nothing(lenient: bool) -> None:
    rules = dialects.load("fagor", lenient=lenient)
    assert error_of(f"{HEAD}G0 X0 Y0\nG53{END}", dialect=rules).line == 3


def test_the_length_of_a_new_tool_needs_g43() -> None:
    start = "T1.1\nM6\nG0 G43 Z5\nT2.2\nM6\n"
    tools = {"T1": 10.0, "T2": 20.0}
    assert error_of(HEAD + start + "Z8" + END, dialect="fagor", tools=table(**tools)).code == (
        "tool-length-open"
    )
    assert ends(start + "X1\nG43 Z8", tools=table(**tools))[-1] == (1.0, 0.0, 28.0)
    assert ends(start + "G44\nZ8", tools=table(**tools))[-1][2] == 8.0
    assert ends(start + "Z8", tools=table(T1=10.0, T2=10.0))[-1][2] == 18.0


def test_drilling_has_its_level_in_z_and_its_bottom_in_i() -> None:
    """Worked out: over the hole at 50, down to 2, to -5 at feed, dwell, back to 50 (G98) or 2."""
    source = "G0 Z50\nG98 G81 X10 Y20 Z2 I-5 K50 F100\nX30\nG80"
    assert ends(source)[1:] == [
        (10, 20, 50), (10, 20, 2), (10, 20, -5), (10, 20, 50),
        (30, 20, 50), (30, 20, 2), (30, 20, -5), (30, 20, 50),
    ]  # fmt: skip
    assert ends(source.replace("G98", "G99"))[4] == (10, 20, 2)
    blocks = run(HEAD + source + END, dialect="fagor")
    assert [each.seconds for each in blocks if isinstance(each, Dwell)] == [0.5, 0.5]


@pytest.mark.parametrize("code", ["G82", "G89"])
def test_cycles_with_a_dwell(code: str) -> None:
    blocks = run(f"{HEAD}G0 Z9\nG99 {code} X1 Y1 Z2 I-5 K20 F100\nG80{END}", dialect="fagor")
    assert [each.seconds for each in blocks if isinstance(each, Dwell)] == [0.2]


@pytest.mark.parametrize("code", ["G81", "G82", "G85", "G89"])
def test_cycles_without_a_dwell(code: str) -> None:
    found = ends(f"G0 Z9\nG99 {code} X1 Y1 Z2 I-5 F100\nG80")
    assert [z for _, _, z in found] == [9, 9, 2, -5, 2]


def test_deep_drilling_has_a_peck_and_their_number() -> None:
    """Z2 I-3 J4: the bottom is at 2 - 4 * 3 = -10."""
    found = [z for _, _, z in ends("G0 Z9\nG99 G83 X1 Y1 Z2 I-3 J4 F100\nG80")]
    assert min(found) == -10
    assert [z for z in found if z in (-1, -4, -7, -10)] == [-1, -4, -7, -10]
    assert found.count(2) == 5


def test_dwells_are_in_hundredths_of_a_second() -> None:
    blocks = run(f"{HEAD}G4 K150{END}", dialect="fagor")
    assert [each.seconds for each in blocks if isinstance(each, Dwell)] == [1.5]
    codes = [each.code for each in warnings(f"{HEAD}G4 K150\nG4 K20{END}", "fagor")]
    assert codes == ["dwell-short"]
    assert error_of(f"{HEAD}G4 P2{END}", dialect="fagor").code == "dwell-time-missing"


@RULES
def test_edges(lenient: bool) -> None:
    found = [
        each.control
        for each in run(f"{HEAD}G7\nG5{END}", dialect=dialects.load("fagor", lenient=lenient))
        if isinstance(each, PathMode)
    ]
    assert found[-2:] == ["exact-stop", "blend"]
