"""SINUMERIK: variables with names, and patterns of holes."""

from __future__ import annotations

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
        "FOR COUNT=1 TO NUM-1\nG0 X=COUNT\nENDFOR\nIF FLAG==TRUE AND NUM>2 GOTOF END_\nX9\n"
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
    assert "HOLES" in found.message
    found = error_of("G0 X=_none", dialect="siemens")
    assert found.code == "parameter-undefined"
    sub = "L10\nM30\n%_N_L10_SPF\nDEF REAL _a\nM17"
    assert error_of(sub, dialect="siemens").code == "code-not-supported"
