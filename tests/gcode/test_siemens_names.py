"""SINUMERIK: variables with names, and patterns of holes."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.model.blocks import Polyline
from tests.support.gcode.gcode_cases import error_of, run


def points(source: str) -> list[tuple[float, ...]]:
    """The ends of the moves of a program, X Y Z."""
    return [
        tuple(row)
        for block in run(source, dialect="siemens")
        if isinstance(block, Polyline)
        for row in block.points.tolist()
    ]


def test_variables_with_any_name() -> None:
    """Types keep their values: INT rounds, BOOL is 0 or 1; FOR counts a variable."""
    source = (
        "DEF REAL RTP=10, DP=-RTP/4, _X\nDEF INT NUM=2.6, COUNT\nDEF BOOL FLAG=7, OFF=FALSE\n"
        "NUM=NUM+0.4 _X=SIN(90)*NUM\nG0 X=RTP Y=-DP+_X Z=FLAG-OFF\nNUM=2.5\nX=NUM\n"
        "FOR COUNT=1 TO NUM-1\nG0 X=COUNT\nENDFOR\nIF (FLAG==TRUE) AND (NUM>2) GOTOF END_\nX9\n"
        "END_: G0 X=IC(NUM)"
    )
    ends = [(10, 5.5, 1), (3, 5.5, 1), (1, 5.5, 1), (2, 5.5, 1), (5, 5.5, 1)]
    assert points(f"{source}\nM30") == [pytest.approx(end) for end in ends]


@pytest.mark.parametrize("line", ["G0 X=DEPHT", "DEPHT=5", "R1=DEPTH+DEPHT"])
def test_a_name_that_is_not_defined_is_no_variable(line: str) -> None:
    found = error_of(f"DEF REAL DEPTH=5\n{line}\nM30", dialect="siemens")
    assert (found.code, found.line) == ("code-not-supported", 2)
    assert "DEPHT" in found.message


HOLE = "G0 Z20 F100\nMCALL CYCLE81(10,0,1,-3)\n"


def bottoms(source: str) -> list[tuple[float, ...]]:
    """The places of the holes of a program, in their order."""
    return [(x, y) for x, y, z in points(source) if z == -3]


@pytest.mark.parametrize(
    ("pattern", "places"),
    [
        ("HOLES1(30,20,0,10,20,3)", [(40, 20), (60, 20), (80, 20)]),
        ("HOLES1(10,0,90,5,5,2)", [(10, 5), (10, 10)]),
        (
            "G0 X100 Y20\nHOLES1(30,20,0,10,20,2)",
            [(60, 20), (40, 20)],
        ),
        ("HOLES2(0,0,10,0,0,4)", [(10, 0), (0, 10), (-10, 0), (0, -10)]),
        ("HOLES2(5,5,10,90,-90,2)", [(5, 15), (15, 5)]),
        ("R1=2\nHOLES2(R1,0,R1*2,0,,1)", [(6, 0)]),
        ("ROT RPL=90\nHOLES1(10,0,0,0,10,2)", [(0, 10), (0, 20)]),
        ("G91\nHOLES1(10,0,0,0,10,2)\nMCALL\nX1\nG90", [(10, 0), (20, 0)]),
    ],
)
def test_patterns_of_holes(pattern: str, places: list[tuple[float, ...]]) -> None:
    """Expected from the definition: polar steps from the reference point, nearest end first."""
    found = [place for place in bottoms(f"{HOLE}{pattern}\nMCALL\nM30") if place != (100, 20)]
    assert found == [pytest.approx(each, abs=1e-9) for each in places]


@pytest.mark.parametrize(
    ("source", "code"),
    [
        ("HOLES1(0,0,0,5,5,3)", "cycle-not-active"),
        (f"{HOLE}HOLES2(0,0,5,0,0,0)", "cycle-word-missing"),
        (f"{HOLE}HOLES1(0,0,0,5,5,1.5)", "cycle-word-missing"),
        (f"{HOLE}HOLES1(0,0,0,5,5,3,1)", "cycle-word-missing"),
        (f"{HOLE}G18\nHOLES1(0,0,0,5,5,3)", "code-not-supported"),
    ],
)
def test_a_pattern_that_is_not_clear_is_refused(source: str, code: str) -> None:
    found = error_of(f"{source}\nM30", dialect="siemens")
    assert found.code == code
    assert "HOLES" in found.message or "MCALL" in found.message
    found = error_of("G0 X=_none", dialect="siemens")
    assert found.code == "parameter-undefined"


@pytest.mark.parametrize(
    ("source", "ends"),
    [
        ("DEF REAL A[10], BB=2\nA[3]=5 A[BB+2]=7\nG0 X=A[3] Y=A[4] Z=A[0]", [(5, 7, 0)]),
        ("R1=2\nR[R1]=7\nR[1+R1*2]=4\nG0 X=R2+R[R1]*2 Y=R5", [(21, 4, 0)]),
        ("DEF INT AA[2,3]=SET(1,2,3.6)\nG0 X=AA[0,2] Y=AA[1,0]", [(4, 0, 0)]),
        ("DEF REAL AA[2,2]=SET(1,2,3,4)\nAA[1,0]=SET(8,9)\nG0 X=AA[0,1] Y=AA[1,1]", [(2, 9, 0)]),
        ("DEF REAL AA[3,2]\nAA[0,1]=SET(5,6,7,8)\nG0 X=AA[1,0] Y=AA[1,1] Z=AA[2,0]", [(6, 7, 8)]),
        ("DEF REAL AA[3,2]\nR1=1\nAA[R1,R1]=SET(5,6)\nG0 X=AA[1,1] Y=AA[2,0]", [(5, 6, 0)]),
        ("DEF REAL AA[2,2]\nAA[0,1]=REP(4)\nG0 X=AA[0,0] Y=AA[0,1] Z=AA[1,1]", [(0, 4, 4)]),
        ("DEF REAL AA[4]=SET(1)\nAA[2]=REP(3)\nG0 X=AA[0] Y=AA[2] Z=AA[3]", [(1, 3, 3)]),
        ("DEF REAL C[4]=REP(5)\nC[1]=REP(2,2)\nG0 X=C[0]+C[1]+C[2]+C[3]", [(14, 0, 0)]),
        ("DEF BOOL ON[2]=SET(TRUE)\nG0 X=ON[0]+ON[1]", [(1, 0, 0)]),
        (
            "DEF REAL PP[3]\nFOR R1=0 TO 2\nPP[R1]=R1*R1\nENDFOR\nG0 X=PP[PP[1]+1] Y=SIN(PP[1]*30)",
            [(4, 0.5, 0)],
        ),
    ],
)
def test_arrays(source: str, ends: list[tuple[float, ...]]) -> None:
    """A definition fills the elements with the last index first; the rest is 0."""
    assert points(f"{source}\nM30") == [pytest.approx(end) for end in ends]


@pytest.mark.parametrize(
    ("source", "code", "words"),
    [
        ("DEF REAL A[3]\nG0 X=A[3]", "parameter-number", "A[3]"),
        ("DEF REAL A[3]\nA[-1]=5", "parameter-number", "0 to 2"),
        ("DEF REAL A[2,3]\nG0 X=A[0,3]", "parameter-number", "0 to 1 and 0 to 2"),
        ("DEF REAL A[3]\nG0 X=A[0.5]", "parameter-number", "whole"),
        ("DEF REAL AA[3]\nG0 X=AA", "code-not-supported", "without an index"),
        ("DEF REAL AA[3]\nG0 X=AA[1,1]", "code-not-supported", "number of indices"),
        ("R1=1\nG0 X=R[IC(1)]", "code-not-supported", "IC in an expression"),
        ("G0 X=BB[1]", "code-not-supported", "no array"),
        ("DEF REAL A[3]=5", "code-not-supported", "SET"),
        ("DEF REAL A[2]=SET(1,2,3)", "code-not-supported", "array A"),
        ("DEF REAL A[0]", "code-not-supported", "DEF REAL"),
        ("DEF REAL A[3]\nR1=0\nA[R1]=REP(5)", "code-not-supported", "REP"),
        ("DEF REAL AA[2,2]\nAA[1,1]=SET(1,2)", "parameter-number", "AA[2,2]"),
        ("DEF REAL AA[3,2]\nAA[0,2]=SET(1,2)", "parameter-number", "AA[3,2]"),
        ("DEF STRING[20] NAME", "code-not-supported", ""),
        ("G0 X=R5", "parameter-undefined", "R5 was never set"),
        ("G0 X=_none", "parameter-undefined", "_NONE was never set"),
        ("L9\nM30\n%_N_L9_SPF\nDEF REAL LOC[3]\nRET", "code-not-supported", "main program"),
    ],
)
def test_faults_of_arrays(source: str, code: str, words: str) -> None:
    found = error_of(f"{source}\nM30", dialect="siemens")
    assert found.code == code
    assert words in f"{found.message} {found.hint}"


HOLE_AT = "PROC HOLE_AT(REAL XP, REAL YP, INT NUM)\nG0 X=XP Y=YP\nXP=XP+NUM\nG0 X=XP\nRET\n"


@pytest.mark.parametrize(
    ("main", "ends"),
    [
        ("HOLE_AT(10, 20, 2.6)", [(10, 20, 0), (13, 20, 0)]),
        ("R1=3\nHOLE_AT(R1*2, , 1)\nN5 HOLE_AT(1)", [(6, 0, 0), (7, 0, 0), (1, 0, 0), (1, 0, 0)]),
        ("HOLE_AT", [(0, 0, 0), (0, 0, 0)]),
        ("DEF REAL LEFT=4\nHOLE_AT(LEFT,1,0)\nG0 X=LEFT+1", [(4, 1, 0), (4, 1, 0), (5, 1, 0)]),
    ],
)
def test_a_call_hands_values_over(main: str, ends: list[tuple[float, ...]]) -> None:
    """They are copies: values that are left out are 0, and INT is rounded."""
    assert points(f"G0 Z1\nG0 Z0\n{main}\nM30\n%_N_HOLE_AT_SPF\n; hole\n{HOLE_AT}")[2:] == ends


def test_values_belong_to_a_call() -> None:
    """The depth of each call counts down by itself, and DEF makes a variable of the call."""
    sub = (
        "PROC DOWN(INT LEVEL)\nDEF REAL OWN=LEVEL\nG0 X=OWN\n"
        "IF LEVEL>1\nDOWN(LEVEL-1)\nENDIF\nG0 X=OWN\nRET"
    )
    assert points(f"DOWN(3)\nM30\n{sub}") == [(x, 0, 0) for x in (3, 2, 1, 1, 2, 3)]


def test_a_file_has_its_own_parameters(tmp_path: Path) -> None:
    (tmp_path / "hole_at.spf").write_text(HOLE_AT)
    found = run(
        "DEF INT XP=7\nHOLE_AT(1,2,3)\nG0 X=XP\nM30", dialect="siemens",
        folders=(tmp_path,),
    )  # fmt: skip
    ends = [row for block in found if isinstance(block, Polyline) for row in block.points.tolist()]
    assert ends == [[1, 2, 0], [4, 2, 0], [7, 2, 0]]


@pytest.mark.parametrize(
    ("source", "code", "words"),
    [
        ("HOLE_AT(1,2,3,4)\nM30\n" + HOLE_AT, "call-arguments", "3 parameters"),
        ("MISSING(1)\nM30", "sub-unknown", "MISSING"),
        ("ONE(R5)\nM30\nPROC ONE(VAR REAL XP)\nRET", "code-not-supported", "PROC"),
        ("DEF INT XP\nXP=1\nM30\n" + HOLE_AT, "code-not-supported", "more than one program"),
    ],
)
def test_a_fault_of_a_call_is_named(source: str, code: str, words: str) -> None:
    found = error_of(source, dialect="siemens")
    assert found.code == code
    assert words in found.message
