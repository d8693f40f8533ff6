"""Parameters, expressions and comments in whole programs.

Expected blocks were worked out by hand; errors are those at run time.
"""

from __future__ import annotations

import math

import pytest

from cnc.gcode.reader.parameters import Parameters
from tests.support.gcode.gcode_cases import assert_error_at, block_summaries, rows, run

PROGRAMS: dict[str, tuple[str, list[str]]] = {
    "a value after a letter": ("#1=2.5\nG0 X#1 Y-#1 Z[#1*2]", ["rapid 2.5 -2.5 5"]),
    "functions": ("G0 XSQRT[16] YATAN[1]/[1] Z-ABS[-3]", ["rapid 4 45 -3"]),
    "assignments count after their line": (
        "#1=1 #2=2\n#1=#2 #2=#1 G0 X#1 Y#2\nX#1 Y#2",
        ["rapid 1 2 0", "rapid 2 1 0"],
    ),
    "the last of two assignments counts": ("#3=15 #3=6\nG0 X#3", ["rapid 6 0 0"]),
    "assignments around words": (
        "#1=1\nG0 #1=[#1+1] X#1 #2=[#1*10]\nX#1 Y#2",
        ["rapid 1 0 0", "rapid 2 10 0"],
    ),
    "a number that is computed": ("#5=7 #7=3\nG0 X##5 Y#[#7+2]", ["rapid 3 7 0"]),
    "names": (
        "#<Depth of cut>=-1.5 #<_Safe>=5\nG0 X#<depthofcut> Y#< _ s a f e >",
        ["rapid -1.5 5 0"],
    ),
    "a code that is computed": ("#1=1\nG#1 X1 F60\nG[#1-1] X2", ["line 1 0 0 F60", "rapid 2 0 0"]),
    "a code with a point": ("#1=61\nG[#1+.1]", ["path exact-stop 0"]),
    "a feed that is computed": ("#1=60\nG1 X1 F[#1*2]", ["line 1 0 0 F120"]),
    "an arc that is computed": ("#1=10\nG2 X#1 I[#1/2] F60", ["arc xy 5 0 10 0 0 5 -0.5 60"]),
    "inches": ("G20\n#1=1\nG0 X#1 Y#5420\nY#<_x>", ["rapid 25.4 0 0", "rapid 25.4 25.4 0"]),
    "where the tool is": (
        "G0 X3 Y4\nX[#5420*2] Y[#<_y>+1]\nZ[#5421]",
        ["rapid 3 4 0", "rapid 6 5 0", "rapid 6 5 5"],
    ),
    "coordinate systems": (
        "G10 L2 P2 X10\nG55 G0 X#5241\nX[#5220]",
        ["rapid 20 0 0", "rapid 12 0 0"],
    ),
    "an origin that is set by number counts when its system is chosen": (
        "#5221=7\nG54 G0 X1\nG55\nG54 X1",
        ["rapid 1 0 0", "rapid 8 0 0"],
    ),
    "a whole number that is computed": (
        "#1=.1\nT[#1*30] M6\nG[#1*30-3] X1",
        ["tool 3", "rapid 1 0 0"],
    ),
    "the state": (
        "G91 G20\nG0 X[#<_absolute>+#<_metric>*2] Y#<_incremental>\nG90 G21\nG0 X0 Y#<_metric>",
        ["rapid 0 25.4 0", "rapid 0 1 0"],
    ),
    "the motion code": ("G1 F60 X1\nX[#<_motion_mode>]", ["line 1 0 0 F60", "line 10 0 0 F60"]),
    "a tool": (
        "T5\nG0 X#<_selected_tool> Y#5400\nM6\nX0 Y#5400",
        ["rapid 5 0 0", "tool 5", "rapid 0 5 0"],
    ),
    "what exists": ("#<a>=1\nG0 X[EXISTS[#<a>]] Y[EXISTS[#<b>]+5]", ["rapid 1 5 0"]),
    "the call level": (
        "o1 sub\nG0 X#<_call_level>\no1 endsub\nG0 Y#<_call_level>\no1 call",
        ["rapid 0 0 0", "rapid 1 0 0"],
    ),
    "a comment with values": (
        "#1=2.5 #<a>=3\n(debug, x=%.1f#1 a=%d#<a>)\n(msg, #1)",
        ["message x=2.5 a=3", "message #1"],
    ),
    "a block that is not run computes nothing": (
        "o1 if [0]\n#1=[1/0]\no1 endif\nG0 X1",
        ["rapid 1 0 0"],
    ),
    "a name of a call": (
        "o<f> sub\n#<a>=#1\nG0 X#<a> Y#<_g>\n#<_g>=9\no<f> endsub\n#<a>=1 #<_g>=2\no<f> call [5]\n"
        "X#<a> Y#<_g>",
        ["rapid 5 2 0", "rapid 1 9 0"],
    ),
}
MACROS: dict[str, tuple[str, list[str]]] = {
    "assignment without brackets": ("#1=3.+2.*2.\nG0 X#1", ["rapid 7 0 0"]),
    "a vacant word is as if not written": (
        "#1=#0\nG0 X5. Y#1\nX[#1+1.] Y3.",
        ["rapid 5 0 0", "rapid 1 3 0"],
    ),
    "vacant is not 0": (
        "#2=0\nIF [#1 EQ #0] GOTO 1\nG0 X99.\nN1 IF [#2 NE #0] GOTO 2\nG0 X98.\nN2 G0 X1.",
        ["rapid 1 0 0"],
    ),
    "ROUND in a word": (
        "#1=1.23456\nG0 X[ROUND[#1]]\n#2=ROUND[#1]\nY#2",
        ["rapid 1.235 0 0", "rapid 1.235 1 0"],
    ),
    "ROUND in a word, inches": ("G20\n#1=1.23456\nG0 X[ROUND[#1]]", ["rapid 31.35884 0 0"]),
    "positions": (
        "G54 G0 X3. Y4.\n#1=#5041 #2=#5002\nX[#1*2] Y[#2*2]\nZ#5021",
        ["rapid 3 4 0", "rapid 6 8 0", "rapid 6 8 6"],
    ),
    "positions in a system, in inches": (
        "G10 L2 P2 X25.4\nG55 G20 G0 X1.\nY#5041 Z#5021",
        ["rapid 50.8 0 0", "rapid 50.8 25.4 50.8"],
    ),
    "codes in effect": (
        "G91 G17 G55 G1 F60.\n#1=#4003 #2=#4001 #3=#4014 #4=#4109\nG90 G0 X#1 Y[#2*10+#3] Z#4",
        ["rapid 91 65 60"],
    ),
    "a code that is put back": (
        "G91\n#1=#4003\nG90 G0 X1.\nG#1 X1.",
        ["rapid 1 0 0", "rapid 2 0 0"],
    ),
    "a stop with a message": (
        "G0 X1.\n#3006=1 (TURN THE PART)\nX2.",
        ["rapid 1 0 0", "stop", "rapid 2 0 0"],
    ),
    "switches remember": ("#3003=1 #3004=7\nG0 X#3004 Y#3003", ["rapid 7 1 0"]),
    "IF THEN": ("#1=1\nIF [#1 EQ 1] THEN #2=5.\nIF [#1 EQ 2] THEN #2=6.\nG0 X#2", ["rapid 5 0 0"]),
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_programs_with_parameters(name: str) -> None:
    source, wanted = PROGRAMS[name]
    assert block_summaries(source) == wanted


@pytest.mark.parametrize("name", MACROS)
def test_macros_with_variables(name: str) -> None:
    source, wanted = MACROS[name]
    assert block_summaries(source, dialect="fanuc") == wanted


ERRORS: dict[str, tuple[str, str]] = {
    "division by zero": ("division-by-zero", "#1=0\nG0 X[5¦/#1]"),
    "in an assignment": ("argument-out-of-range", "#1=-4\n#2=¦SQRT[#1] #3=1"),
    "in a condition": ("division-by-zero", "o1 if [1 ¦/ #1]\no1 endif"),
    "in an argument": ("power-undefined", "o1 sub\no1 endsub\no1 call [1] [0 ¦** -1]"),
    "a name that was never set": ("parameter-undefined", "G0 X¦#<a>"),
    "a name of the caller": (
        "parameter-undefined",
        "o1 sub\nG0 X¦#<a>\no1 endsub\n#<a>=1\no1 call",
    ),
    "a number that there is not": ("parameter-number", "#1=6000\nG0 X¦##1"),
    "a number that there is not, set": ("parameter-number", "¦#5603=1"),
    "a number that can't be set": ("parameter-read-only", "G0 X1\n¦#5420=1"),
    "a name that can't be set": ("parameter-read-only", "¦#<_metric>=1"),
    "a word that is too large": ("number-too-large", "#1=1000000000\nG0 ¦X[#1*2]"),
    "a tool that is no tool": ("value-out-of-range", "#1=1.5\n¦T#1"),
    "a code that is unknown": ("code-unknown", "#1=123\n¦G#1"),
    "a code that is negative": ("code-unknown", "¦M[1-4]"),
    "half a code": ("code-unknown", "¦G[.05]"),
    "a feed of nothing": ("feed-not-positive", "G1 X1 ¦F[1-1]"),
}


@pytest.mark.parametrize("name", ERRORS)
def test_errors_at_run_time(name: str) -> None:
    assert_error_at(*ERRORS[name])


@pytest.mark.parametrize(
    ("code", "source"),
    [
        ("syntax-not-in-dialect", "G0 X¦[1]"),
        ("syntax-not-in-dialect", "¦#1=5"),
        ("syntax-not-in-dialect", "¦o1 sub"),
    ],
)
def test_grbl_has_no_parameters(code: str, source: str) -> None:
    assert "grbl" in assert_error_at(code, source, dialect="grbl").message


NAMES = """
vmajor vminor line motion_mode plane ccomp metric imperial absolute incremental inverse_time
units_per_minute units_per_rev coord_system tool_offset retract_r_plane retract_old_z
spindle_rpm_mode spindle_css_mode ijk_absolute_mode lathe_diameter_mode lathe_radius_mode spindle_on
spindle_cw mist flood speed_override feed_override adaptive_feed feed_hold feed rpm x y z a b c u v
w current_tool current_pocket selected_tool selected_pocket value value_returned task call_level
remap_level
"""
"""Predefined names in LinuxCNC's manual."""


def test_predefined_names_of_linuxcnc() -> None:
    names = NAMES.split()
    block_summaries = [
        value.text
        for value in run(
            "\n".join(f"(print,{name}=#<_{name}>)" for name in names), axes=tuple("xyzabcuvw")
        )
    ]  # type: ignore[attr-defined]
    assert [value for value in block_summaries if "######" in value] == []


def test_parameters_outlast_the_program() -> None:
    known = Parameters({31: 4.0})
    assert list(rows(run("#32=[#31*2] #5=1\nG10 L2 P1 X5\nG0 X0", parameters=known))) == [
        ("rapid", 5.0, 0.0, 0.0)
    ]
    stored = known.stored()
    assert (stored[31], stored[32], stored[5221]) == (4.0, 8.0, 5.0)
    assert 5 not in stored
    assert list(rows(run("G0 X0", parameters=Parameters(stored)))) == [("rapid", 5.0, 0.0, 0.0)]


def test_a_long_loop_computes_correct_values() -> None:
    """A polygon of 1000 corners, each computed by expressions."""
    move = "G1 X[COS[#1*.36]*10] Y[SIN[#1*.36]*10] F600"
    source = f"#1=0\no1 while [#1 LT 1000]\n{move}\n#1=[#1+1]\no1 endwhile"
    found = list(rows(run(source)))
    assert len(found) == 1000
    for index, (kind, x, y, _, feed) in enumerate(found):
        angle = math.radians(index * 0.36)
        assert (kind, feed) == ("line", 600.0)
        assert (x, y) == (
            pytest.approx(10 * math.cos(angle), abs=1e-12),
            pytest.approx(10 * math.sin(angle), abs=1e-12),
        )
