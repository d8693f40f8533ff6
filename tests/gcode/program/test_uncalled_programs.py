"""Files with several numbered programs: the ones that the first one does not call."""

from __future__ import annotations

import pytest

from tests.support.gcode.gcode_cases import error_of, points, warnings

MAIN = "O1\nG0 X1.\nM98 P2\nM30\n"
SUB = "O2\nG0 X2.\nM99\n"


def _found(program: str, dialect: str = "fanuc") -> list[tuple[str, int]]:
    return [(each.code, each.line) for each in warnings(program, dialect)]


@pytest.mark.parametrize("dialect", ["fanuc", "haas", "auto"])
def test_a_program_that_is_not_called_is_named(dialect: str) -> None:
    program = MAIN + SUB + "O3 (SPARE)\nG0 X99.\nM30\nO4\nM99"
    assert _found(program, dialect) == [("program-not-called", 8)]
    assert warnings(program, dialect)[0].message == (
        "O3 and 1 more behind the end of the program: not called, and not checked"
    )
    assert points(program, dialect) == [(1.0, 0.0, 0.0), (2.0, 0.0, 0.0)]


@pytest.mark.parametrize(
    "program",
    [
        MAIN + SUB,
        MAIN + SUB + "%\n",
        f"%\n{MAIN}{SUB}%\n\n\n",
        "O1\nG0 X1.\nG65 P2 A1.\nM30\n" + SUB,
        "O1\nG66 P2 A1.\nG0 X1.\nG67\nM30\n" + SUB,
        "O1\nM98 P3\nM30\nO2\nM99\nO3\nM98 P2\nM99",
        "O1\nG0 X1.\nM30\n(O2)\n(remarks)\n",
    ],
)
def test_called_programs_and_remarks_are_not_named(program: str) -> None:
    assert _found(program) == []


def test_a_program_behind_the_percent_is_named() -> None:
    assert _found(f"%\n{MAIN}{SUB}%\n%\nO7\nG0 X9.\nM30\n%") == [("program-not-called", 11)]


def test_a_call_under_a_condition_that_is_false_is_no_call() -> None:
    program = "O1\n#1=0\nIF[#1EQ1]THEN M98 P2\nM30\n" + SUB
    assert _found(program.replace("THEN M98 P2", "GOTO 5\nN6 M30\nN5 M98 P2")) == [
        ("program-not-called", 7)
    ]


LATER = [
    (f"{SUB}{MAIN}", "fanuc"),
    (f"%\n{SUB}%\n\n%\n{MAIN}%", "fanuc"),
    (f"{SUB}{MAIN}", "haas"),
    (f"{SUB}{MAIN.replace('M98 P2', 'G65 P2 X1.')}", "fanuc"),
    (f"{SUB}{MAIN.replace('M98 P2', 'M98 P30002')}", "fanuc"),
    (f"{SUB}{MAIN.replace('M98 P2', 'IF[#1EQ0] THEN M98 (CALL) P0002 L3')}", "fanuc"),
]


@pytest.mark.parametrize(("program", "dialect"), LATER)
def test_a_subprogram_before_its_main_program_is_not_read_as_the_program(
    program: str, dialect: str
) -> None:
    found = error_of(program, dialect=dialect)
    assert found.code == "main-program-later"
    assert "O1 of line" in found.message
    assert "calls O2, which ends with M99" in found.message


def test_number_zero_is_a_number() -> None:
    assert _found("O0000 (PART)\nG0 X1.\nM30\nO0001\nG0 X2.\nM30") == [("program-not-called", 4)]


def test_a_text_without_a_number_is_read_to_its_end_only() -> None:
    """It may be a stream."""
    assert _found("G0 X1.\nM30\nO0001\nG0 X2.\nM30") == []


def test_a_first_program_with_m99_that_no_other_calls_is_the_main_program() -> None:
    found = _found(f"O5\nG0 X1.\nM99\n{MAIN}{SUB}", "auto")
    assert found == [("program-ends-once", 3), ("program-not-called", 4)]
