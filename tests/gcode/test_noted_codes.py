"""Codes that have no effect here, by the manuals of their controllers.

Source: FANUC Series 30i, "Operator's Manual", lists of G-codes; Haas, "Mill Operator's Manual",
G-codes and M-codes; "Using Mach3Mill", M-codes.
"""

from __future__ import annotations

import pytest

from cnc.gcode import dialects
from cnc.gcode.state.reading_policy import ReadingPolicy
from tests.support.gcode.gcode_cases import block_summaries, error_of, points, warnings

NOTED = [
    ("auto", "G40.1 G13.1"), ("auto", "M47"), ("mach3", "M47"),
    ("fanuc", "G13.1 G40.1 G50.2"), ("fanuc", "G25"), ("fanuc", "G26 P100 Q5 R10 I50"),
    ("haas", "G255"), ("haas", "G269"), ("haas", "M70"), ("haas", "M71"), ("haas", "M131"),
    ("haas", "M160"), ("haas", "M161 P5"), ("haas", "M162"), ("haas", "M163 P2"),
]  # fmt: skip


@pytest.mark.parametrize(("dialect", "line"), NOTED)
@pytest.mark.parametrize("lenient", [False, True])
def test_the_code_has_no_effect(dialect: str, line: str, *, lenient: bool) -> None:
    rules = dialects.load(dialect, lenient=lenient)
    assert block_summaries(f"{line}\nG0 X1.", dialect=rules) == ["rapid 1 0 0"]


@pytest.mark.parametrize("dialect", ["fanuc", "haas", "grbl", "linuxcnc"])
def test_a_recognised_program_may_have_a_builders_code_with_the_number(dialect: str) -> None:
    lenient = dialects.load(dialect, lenient=True)
    assert error_of("M47\nM30", dialect=lenient).code == "code-unknown"


@pytest.mark.parametrize(("dialect", "line"), [("linuxcnc", "G13.1"), ("siemens", "G25 X1")])
def test_other_controllers_lack_it(dialect: str, line: str) -> None:
    assert error_of(f"{line}\nM30", dialect=dialect).code == "code-not-supported"


ENGRAVING = (
    "O12345\nG20 G90\nG0 X1. Y2. Z1.\nG47 P0 E7.5 F15. I45. J.5 R.05 Z-.005 (TEXT)\nG0 X3.\nM30"
)


@pytest.mark.parametrize("lenient", [False, True])
def test_a_check_continues_without_the_letters_of_haas(*, lenient: bool) -> None:
    """Haas, "Mill Operator's Manual", G47: the control draws the letters."""
    check = ReadingPolicy(missing_programs="warn")
    ends = points(ENGRAVING, "haas", lenient=lenient, policy=check)
    assert ends == [pytest.approx((25.4, 50.8, 25.4)), pytest.approx((76.2, 50.8, 25.4))]
    found = warnings(ENGRAVING, "haas", lenient=lenient, policy=check)
    assert [(each.code, each.line) for each in found] == [("moves-not-checked", 4)]


def test_a_run_refuses_the_letters_of_haas() -> None:
    found = error_of(ENGRAVING, dialect="haas")
    assert (found.code, found.line) == ("code-not-supported", 4)
