"""SINUMERIK: rounding, the precision of comparisons, and the order of logic operators.

The values are those of Siemens, "SINUMERIK 840D sl Programming Manual, Job Planning".
"""

from __future__ import annotations

import pytest

from tests.support.gcode.gcode_cases import error_of, points


def value(expression: str, head: str = "") -> float:
    """The value of an expression, as the end of a move."""
    return points(f"{head}\nG0 X={expression}\nM30", "siemens")[-1][0]


def holds(condition: str, head: str = "") -> bool:
    """Whether a condition is true."""
    program = f"{head}\nG0 X5\nIF {condition}\nG0 X1\nELSE\nG0 X2\nENDIF\nM30"
    return points(program, "siemens")[-1][0] == 1.0


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("ROUNDUP(3.1)", 4.0),
        ("ROUNDUP(3.6)", 4.0),
        ("ROUNDUP(-3.1)", -3.0),
        ("ROUNDUP(-3.6)", -3.0),
        ("ROUNDUP(3.0)", 3.0),
        ("ROUNDUP(3)", 3.0),
        ("1+ROUNDUP(R1/0.3)", 8.0),
        ("TRUNC(2.8)", 2.0),
        ("TRUNC(-2.8)", -2.0),
        ("TRUNC(-R1)", -2.0),
        ("TRUNC(-3)", -3.0),
    ],
)
def test_rounding(expression: str, expected: float) -> None:
    """TRUNC leaves out the decimals, so that negative numbers become larger."""
    assert value(expression, "R1=2" if "0.3" in expression else "R1=2.5") == expected


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("ATAN2(30.5,80.1)", 20.8455),
        ("ATAN2(1,-1)", 135.0),
        ("ATAN2(-R1,-R1)", -135.0),
        ("atan2(R1-1, POT(2)-3)", 56.3099),
        ("POT(3)", 9.0),
        ("1+POT(R1-0.5)*2", 9.0),
        ("POT(POT(2))", 16.0),
    ],
)
def test_squares_and_angles(expression: str, expected: float) -> None:
    """ATAN2 is the angle from the second value to the sum, from -180 to 180 degrees.

    Source: "Job Planning", "Arithmetic functions", which gives the first value.
    """
    assert value(expression, "R1=2.5") == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("expression", ["ATAN2(1)", "POT(1,2)", "ATAN(1)", "7 DIV 2", "NOT R1"])
def test_functions_that_are_not_read(expression: str) -> None:
    found = error_of(f"R1=1\nR2={expression}\nG0 X=R2\nM30", dialect="siemens")
    assert found.code in ("code-not-supported", "text-after-control", "bracket-missing")


@pytest.mark.parametrize(("compared", "passes"), [(">=", 4), (">", 3)])
def test_a_loop_makes_its_last_pass_in_spite_of_rounding_errors(compared: str, passes: int) -> None:
    """0 less 0.1 three times is -0.30000000000000004: for SINUMERIK that is -0.3."""
    program = f"R1=0\nWHILE (R1{compared}-0.3)\nG0 X=R1\nX9\nR1=R1-0.1\nENDWHILE\nM30"
    assert len([x for x, _, _ in points(program, "siemens") if x == 9.0]) == passes


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        ("R1+R2==R3", True),
        ("R1+R2<>R3", False),
        ("R1+R2<=R3", True),
        ("R1+R2>R3", False),
        ("R3<R1+R2", False),
        ("R3>=R1+R2", True),
        ("R3==R3+0.0000001", False),
        ("R3<R3+0.00000001", True),
        ("1000000==1000000.0000001", True),
        ("0==0.0000001", False),
        ("2>1", True),
        ("1>=2", False),
    ],
)
def test_numbers_with_a_relative_difference_of_1e_12_are_equal(
    condition: str, expected: bool
) -> None:
    assert holds(condition, "R1=0.1 R2=0.2\nR3=0.3") is expected


def test_the_example_of_the_manual_for_the_precision_of_comparisons() -> None:
    """ABS(R2-R1) is 0.01000000000000512. The jump was made before there was a relative equality."""
    assert not holds("ABS(R2-R1)>R3", "R1=61.01 R2=61.02\nR3=0.01")
    assert not holds("ABS(TRUNC(R2*1000)-TRUNC(R1*1000))>TRUNC(R3*1000)", "R1=61.01\nR2=61.02 R3=1")


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        ("(1==1) OR (1==1) AND (1==2)", True),
        ("(1==2) AND (1==1) OR (1==1)", True),
        ("((1==1) OR (1==1)) AND (1==2)", False),
        ("(1==1) OR (1==1) XOR (1==1)", True),
        ("(1==1) XOR (1==1) AND (1==2)", True),
        ("(R[1]==7) OR (R[1]==1) AND (1==2)", True),
        ("(1==1) and (2==2) and (3==3)", True),
    ],
)
def test_and_is_before_xor_and_xor_before_or(condition: str, expected: bool) -> None:
    assert holds(condition, "R1=7") is expected


@pytest.mark.parametrize(
    "condition", ["R1>2 AND R2<5", "(R1>2) AND R2<5", "R1 OR R2==1", "1<R1<3", "((R1>2 OR R2))"]
)
def test_comparisons_without_brackets_are_refused(condition: str) -> None:
    """SINUMERIK compares after AND and OR: R1>2 AND R2<5 would be R1>(2 AND R2)<5."""
    found = error_of(f"R1=3\nR2=4\nIF {condition} GOTOF END_\nEND_: M30", dialect="siemens")
    assert (found.code, found.line) == ("code-not-supported", 3)
    assert "brackets" in found.hint


@pytest.mark.parametrize("line", ["#1=[1 ~EQ 1]", "G0 X~FIX[2]"])
@pytest.mark.parametrize("dialect", ["linuxcnc", "auto"])
def test_the_marks_of_translated_lines_are_none_of_the_language(line: str, dialect: str) -> None:
    assert error_of(f"{line}\nM2", dialect=dialect).code == "character-unknown"


def test_an_error_shows_the_translation_without_the_marks() -> None:
    found = error_of("R1=1\nG0 X=SQRT(TRUNC(-R1*3))\nM30", dialect="siemens")
    assert "~" not in found.message
