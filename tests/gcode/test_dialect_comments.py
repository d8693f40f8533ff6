"""Brackets inside comments, by dialect."""

from __future__ import annotations

import pytest

from cnc.gcode import dialects
from tests.support.gcode.gcode_cases import error_of, points, warnings


@pytest.mark.parametrize("dialect", ["fanuc", "haas", "grbl"])
def test_a_comment_ends_at_the_first_bracket(dialect: str) -> None:
    assert points("G0 X1 (see (1) Y2", dialect) == [(1.0, 2.0, 0.0)]
    assert error_of("( hole (1) ) G0 X1", dialect=dialect).code == "comment-not-open"


@pytest.mark.parametrize("dialect", ["linuxcnc", "mach3"])
def test_a_bracket_inside_a_comment_is_an_error(dialect: str) -> None:
    assert error_of("G0 X1 (see (1)\nM2", dialect=dialect).code == "comment-nested"


def test_a_lenient_program_keeps_its_comment_of_rules() -> None:
    """Equals signs behind the first bracket are no code if nothing stands before them."""
    rules = dialects.load("fanuc", lenient=True)
    found = warnings("(=== OFFSETS (edit as needed) ===)\nG0 X1.", "fanuc", lenient=True)
    assert [each.code for each in found] == ["comment-mended"]
    assert error_of("( a (b) #1=5 )\nG0 X1.", dialect=rules).code == "comment-nested"
    assert error_of("( a (b) R1 =5 )\nG0 X1.", dialect=rules).code == "comment-nested"


@pytest.mark.parametrize(
    "comment",
    ["( 7.0 cut(s) at 0.286mm per cut )", "(ORIGIN (0,0) AT LEFT OF PART (G54))",
     "(see (b) for G1 X5)"],
)  # fmt: skip
def test_prose_behind_a_nested_bracket_is_a_comment(comment: str) -> None:
    """No control executes a line with a word that it does not know."""
    found = warnings(f"{comment}\nG0 X1.", "fanuc", lenient=True)
    assert [each.code for each in found] == ["comment-mended"]


@pytest.mark.parametrize("rest", ["G1 X5", "GOTO 10", "IF [#1 EQ 2] GOTO 5", "X SIN[30]"])
def test_code_behind_a_nested_bracket_is_refused(rest: str) -> None:
    """A control whose comments end at the first ) would execute it."""
    rules = dialects.load("fanuc", lenient=True)
    assert error_of(f"(a (b) {rest})\nG0 X1.", dialect=rules).code == "comment-nested"
