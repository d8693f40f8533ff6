"""M98 Q of FANUC: a call of the lines from an N number on, in the same program."""

from __future__ import annotations

import pytest

from tests.support.gcode.gcode_cases import error_of, points

SUB = "N2100\nG0 Z[#1]\nG91 X2.\nG90\nM99\n"


def _sub(call: str) -> str:
    return f"O1\n#1=3.\nG0 X1.\n{call}\nG0 Y5.\nM30\n{SUB}"


@pytest.mark.parametrize(
    ("call", "reached"),
    [
        ("M98 Q2100", 3.0),
        ("M98Q2100", 3.0),
        ("N10 M98 Q2100 L3", 7.0),
        ("#100=2100\nM98 Q#100", 3.0),
        ("M98 Q2100 L0", 1.0),
    ],
)
def test_lines_of_the_same_program_are_called(call: str, reached: float) -> None:
    assert points(_sub(call), "fanuc")[-1][:2] == (reached, 5.0)


def test_lines_of_a_program_that_is_called_are_its_own() -> None:
    """The N number is searched in the program of the call, not in the main program."""
    program = "O1\nM98 P2\nM30\nN7\nG0 X9.\nM99\nO2\nM98 Q7\nM99\nN7\nG0 X4.\nM99\n"
    assert points(program, "fanuc") == [(4.0, 0.0, 0.0)]


def test_calls_within_calls() -> None:
    program = "O1\nM98 Q1\nM30\nN1\nG0 X1.\nM98 Q2 L2\nG0 X4.\nM99\nN2\nG91 G0 X1.\nG90\nM99\n"
    assert [x for x, _, _ in points(program, "fanuc")] == [1.0, 2.0, 3.0, 4.0]


def test_a_number_over_9999_has_no_repeats_in_it() -> None:
    """M98 P30200 has three repeats before the number; a sequence number has five digits."""
    program = "O1\nM98 Q30200\nM30\nN200\nG0 X9.\nM99\nN30200\nG0 X4.\nM99\n"
    assert points(program, "fanuc") == [(4.0, 0.0, 0.0)]


@pytest.mark.parametrize(
    ("dialect", "call", "code"),
    [
        ("fanuc", "M98 Q99", "block-unknown"),
        ("fanuc", "M98 Q1.5", "value-out-of-range"),
        ("fanuc", "M98 Q2100 Q2100", "word-repeated"),
        ("fanuc", "M98", "program-number-missing"),
        ("haas", "M98 Q2100", "program-number-missing"),
        ("linuxcnc", "M98 Q2100", "program-number-missing"),
        ("mach3", "M98 Q2100", "program-number-missing"),
    ],
)
def test_other_calls_are_refused(dialect: str, call: str, code: str) -> None:
    assert error_of(_sub(call).replace("Z[#1]", "Z3."), dialect=dialect).code == code


def test_a_program_with_a_q_is_refused() -> None:
    """Parameter 6005 decides whether Q is read beside P: the program would begin elsewhere."""
    program = "O1\nM98 P2 Q7\nM30\nO2\nG0 X1.\nN7\nG0 X4.\nM99\n"
    assert error_of(program, dialect="fanuc").code == "word-unused"
