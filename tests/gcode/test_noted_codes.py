"""Codes that have no effect here, by the manuals of their controllers.

Source: FANUC Series 30i, list of G-codes (G13.1, G25, G26, G40.1, G50.2); the posts of CAM systems
for Haas (G255, G269); Mach3, list of M-codes (M47); SINUMERIK, gear stages (M40 to M45).
The names of Haas' accessories (M70, M71, M131, M160 to M163) have no section that was read.
"""

from __future__ import annotations

import pytest

from cnc.gcode import dialects
from cnc.gcode.core.modal_groups import ReadingPolicy
from tests.support.gcode.gcode_cases import block_summaries, error_of, points, warnings

NOTED = [
    ("auto", "G40.1 G13.1"), ("auto", "M47"), ("mach3", "M47"),
    ("fanuc", "G13.1 G40.1 G50.2"), ("fanuc", "G25"), ("fanuc", "G26 P100 Q5 R10 I50"),
    ("siemens", "M44"), ("siemens", "M45"),
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
    "O02345\nG20 G90\nG0 X1. Y2. Z1.\nG47 P0 E7.5 F15. I45. J.5 R.05 Z-.005 (TEXT)\nG0 X3.\nM30"
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


@pytest.mark.parametrize("code", ["M21", "M25", "M51", "M58", "M59 P1134", "M61", "M68", "M69 P2"])
def test_a_check_continues_without_the_relays_of_haas(code: str) -> None:
    """Haas, "Mill Operator's Manual", M-codes: relays and outputs, which may move something."""
    program = f"O02345\nG21\n{code}\nG0 X3.\nM30"
    check = ReadingPolicy(missing_programs="warn")
    assert points(program, "haas", lenient=True, policy=check) == [(3, 0, 0)]
    found = warnings(program, "haas", lenient=True, policy=check)
    assert [each.code for each in found] == ["moves-not-checked"]
    refused = error_of(program, dialect=dialects.load("haas", lenient=True))
    assert (refused.code, refused.line) == ("code-not-supported", 3)


@pytest.mark.parametrize(
    "code", ["M50", "M51", "M52", "M53", "M61", "M64", "M68", "M70", "M71", "M72", "M73", "M429"]
)
@pytest.mark.parametrize("dialect", ["fanuc", "siemens"])
def test_linuxcncs_codes_are_a_builders_on_other_controls(dialect: str, code: str) -> None:
    """FANUC's own are M0 to M2, M30, M98, M99. SINUMERIK's M70 makes a spindle an axis."""
    rules = dialects.load(dialect, lenient=True)
    found = error_of(f"G90\n{code}\nG0 X1.\nM30", dialect=rules)
    assert found.code in ("code-unknown", "code-not-in-dialect", "code-not-supported")
    assert f'[program.codes] {code} = ".."' in found.hint
    warned = ReadingPolicy(unknown_codes="warn")
    assert block_summaries(f"{code}\nG0 X1.", dialect=rules, policy=warned) == ["rapid 1 0 0"]
