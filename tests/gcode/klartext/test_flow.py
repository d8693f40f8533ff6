"""Labels, repetitions, jumps and Q parameters of Klartext."""

from __future__ import annotations

import pytest

from cnc.gcode.core.call_stack import Limits
from tests.support.gcode.gcode_cases import block_summaries, error_of


def places(source: str) -> list[str]:
    """X of each move of a program."""
    found = block_summaries(f"BEGIN PGM A MM\n{source}\nEND PGM A MM", dialect="heidenhain")
    return [row.split()[1] for row in found if row.startswith(("rapid", "line"))]


FLOW = {
    # TNC 640, "Program section repeats": once, and as often again as REP says
    "LBL 1\nL IX+1 FMAX\nCALL LBL 1 REP 3": "1 2 3 4",
    "LBL 1\nL IX+1 FMAX\nCALL LBL 1 REP 2/2": "1 2 3",
    "LBL 1\nL IX+1 FMAX\nCALL LBL 1 REP 0": "1",
    # nested: the inner section is repeated in each round
    "LBL 1\nL IX+10 FMAX\nLBL 2\nL IX+1 FMAX\nCALL LBL 2 REP 1\nCALL LBL 1 REP 1":
    "10 11 12 22 23 24",
    # "Subprogramming": LBL to LBL 0, behind the M30 of the main program
    "CALL LBL 5\nCALL LBL \"in\"\nL X+9 FMAX M30\nLBL 5\nL X+1 FMAX\nCALL LBL \"in\"\nLBL 0\n"
    'LBL "in"\nL IX+2 FMAX\nLBL 0': "1 3 5 9",
    # a subprogram that is reached without a call is executed, and its LBL 0 has no effect
    "LBL 3\nL IX+1 FMAX\nLBL 0\nCALL LBL 3": "1 2",
    # a repetition within a subprogram begins anew in each call
    "CALL LBL 1\nCALL LBL 1\nL X+0 FMAX M2\nLBL 1\nLBL 2\nL IX+1 FMAX\nCALL LBL 2 REP 1\nLBL 0":
    "1 2 3 4 0",
    # FN 9 to FN 12
    "Q1 = 0\nLBL 1\nQ1 = Q1 + 1\nL X+Q1 FMAX\nFN 12: IF +Q1 LT +3 GOTO LBL 1": "1 2 3",
    'Q1 = 5\nFN 9: IF +Q1 EQU +5 GOTO LBL "a"\nL X+1 FMAX\nLBL "a"\nL X+2 FMAX': "2",
    "Q1 = 5\nFN 10: IF +Q1 NE +5 GOTO LBL 1\nL X+1 FMAX\nLBL 1\nL X+2 FMAX": "1 2",
    "Q1 = 5\nFN 11: IF +Q1 GT -5 GOTO LBL 1\nL X+1 FMAX\nLBL 1\nL X+2 FMAX": "2",
}  # fmt: skip


@pytest.mark.parametrize("source", FLOW)
def test_flow(source: str) -> None:
    assert places(source) == FLOW[source].split()


VALUES = {
    # TNC 640, "Calculation with mathematical functions" and "Entering formulas"
    "FN 0: Q5 = +10": 10, "FN 1: Q5 = +12.5 + -Q1": 9.5, "FN 2: Q5 = +10 - +5": 5,
    "FN 3: Q5 = +3 * -3": -9, "FN 4: Q5 = +4 DIV +Q2": 2, "FN 5: Q5 = SQRT 4": 2,
    "FN 6: Q5 = SIN-Q3": -0.5, "FN 7: Q5 = COS Q3": 3**0.5 / 2, "FN 8: Q5 = +3 LEN +4": 5,
    "FN 13: Q5 = +10 ANG -10": 135, "FN 13: Q5 = -10 ANG -10": 225,
    "Q5 = 5 * 3 + 2 * 10": 35, "Q5 = SQ 10 - 3^3": 73, "Q5 = Q2 + 3 * SIN 30": 3.5,
    "Q5 = SIN 30 + 1": 1.5, "Q5 = 2 * (1 + 2)": 6, "Q5 = 8 / 4 / 2": 1, "Q5 = 8 - 4 - 2": 2,
    "Q5 = 3 * -2": -6, "Q5 = -Q1 + 1": -2, "Q5 = 2^3 * 2": 16, "Q5 = -(3^2)": -9,
    "Q5 = INT -3.7": -3, "Q5 = FRAC -3.75": -0.75, "Q5 = ABS -3": 3, "Q5 = NEG 3": -3,
    "Q5 = SGN -7": -1, "Q5 = SGN 0": 0, "Q5 = LN EXP 2": 2, "Q5 = TAN 45": 1, "Q5 = ATAN 1": 45,
    "Q5 = ASIN 0.5": 30, "Q5 = ACOS 0.5": 60, "Q5 = PI * 1000": 3141.592654,
    "Q5 = SQRT 9 + 16": 19, "Q5 = COS SIN 0": 1,
}  # fmt: skip


@pytest.mark.parametrize("source", VALUES)
def test_values(source: str) -> None:
    (place,) = places(f"Q1 = 3\nQ2 = 2\nQ3 = 30\n{source}\nL X+Q5 FMAX")
    assert float(place) == pytest.approx(VALUES[source], abs=1e-6)


ERRORS = {
    "CALL LBL 7": "label-missing",
    "CALL LBL 0": "label-missing",
    "LBL 1\nLBL 1\nCALL LBL 1": "label-repeated",
    "CALL LBL 1 REP 3\nLBL 1": "jump-target-bad",
    "CALL LBL 1\nLBL 1\nL X+1 FMAX": "subprogram-not-ended",
    "LBL 1\nCALL LBL 1\nLBL 0": "call-too-deep",
    "LBL 1\nFN 9: IF +1 EQU +1 GOTO LBL 1": "loop-endless",
    "Q1 = 0\nLBL 1\nQ1 = Q1 + 1\nFN 12: IF +Q1 LT +9999999 GOTO LBL 1": "loop-endless",
    "L X+Q7 FMAX": "parameter-undefined",
    "Q1 = 1 / 0": "division-by-zero",
    "Q1 = SQRT -1": "argument-out-of-range",
    "FN 14: ERROR = 1000": "program-abort",
    "Q1 = 3000000\nL X+Q1 FMAX\nQ1 = Q1 * 1000\nL X+Q1 FMAX": "number-too-large",
}


@pytest.mark.parametrize("source", ERRORS)
def test_what_flow_refuses(source: str) -> None:
    text = f"BEGIN PGM A MM\n{source}\nEND PGM A MM"
    found = error_of(text, dialect="heidenhain", limits=Limits(repeated_lines=20_000))
    assert found.code == ERRORS[source], found.render()
    assert found.line > 1


@pytest.mark.parametrize("name", ["FRAC", "SGN", "SQ"])
def test_deep_formulas_are_refused(name: str) -> None:
    """Each of these functions takes its argument twice."""
    source = f"BEGIN PGM A MM\nQ1 = 1\nQ2 = {f'{name} ' * 500}Q1\nEND PGM A MM"
    assert error_of(source, dialect="heidenhain").code == "expression-too-deep"


def test_a_long_repetition_is_not_endless() -> None:
    found = places("LBL 1\nL X+1 FMAX\nL X+2 FMAX\nCALL LBL 1 REP 9000")
    assert found == ["1", "2"] * 9001


def test_a_parameter_is_named_as_klartext_writes_it() -> None:
    found = error_of("BEGIN PGM A MM\nL X+Q7 FMAX\nEND PGM A MM", dialect="heidenhain")
    assert found.message == "Q7 was never set"
    assert found.column == 5
