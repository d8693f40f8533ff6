"""Offsets and returns in which controllers differ, each by the controller's manual."""

from __future__ import annotations

import pytest

from tests.support.gcode.gcode_cases import error_of, points, warnings
from tests.support.gcode.offset_tools import table


@pytest.mark.parametrize(("line", "height"), [("G53 G0 Z0 H0", 6.0), ("G53 G0 Z0", 106.0)])
def test_h0_beside_g53_ends_the_length(line: str, height: float) -> None:
    """The move has no offset in any case; those behind it have none after H0 (H2 is 100 mm)."""
    program = f"G21\nG43 H2 G0 Z5.\n{line}\nG0 Z6.\nM30"
    assert points(program, "fanuc", tools=table())[1:] == [(0, 0, 0), (0, 0, height)]


@pytest.mark.parametrize(
    ("lines", "heights"),
    [
        ("G43 H1 G0 Z1.\nH2 Z2.\nH0 Z3.\nZ4.", [41, 102, 3, 4]),
        ("G44 H1 G0 Z1.\nH2 Z2.", [-39, -98]),
        ("G43 H1 G0 Z1.\nT2 H2\nZ5.", [41, 105]),
        ("G43 H1 G0 Z1.\nG91 G28 Z0 H0\nG90 Z5.", [41, 41, 0, 5]),
    ],
)
@pytest.mark.parametrize("dialect", ["fanuc", "haas"])
def test_h_alone_changes_the_offset_in_effect(
    dialect: str, lines: str, heights: list[float]
) -> None:
    """FANUC, "Tool length offset": G43 and G44 are modal, and another H is another offset.

    Tool 1 is 40 mm long, tool 2 100 mm. H0 is no offset.
    """
    lengths = "G21 G90 G10 L10 P1 R40\nG10 L10 P2 R100"
    assert [z for *_, z in points(f"{lengths}\n{lines}\nM30", dialect)] == heights
    assert error_of("G43 H1\nG0 H2 Z1", dialect="linuxcnc", tools=table()).code == "word-unused"


@pytest.mark.parametrize("code", ["G92", "G52"])
def test_an_offset_of_an_axis_that_the_machine_lacks_does_nothing(code: str) -> None:
    program = f"G21\nG0 X1.\n{code} A0\nG0 X2.\nM30"
    assert points(program, "fanuc", lenient=True) == [(1, 0, 0), (2, 0, 0)]
    found = warnings(program, "fanuc", lenient=True)
    assert "axis-idle" in [each.code for each in found]
    assert error_of(f"{code}\nM30", dialect="fanuc").code == "axis-words-missing"


def test_a_return_without_numbers_says_how_it_is_written() -> None:
    found = error_of("G21\nG28 X Y\nM30", dialect="fanuc")
    assert found.code == "number-missing"
    assert "G91 G28 X0" in found.hint
    assert "G28" not in error_of("G21\nG0 X Y\nM30", dialect="fanuc").hint


@pytest.mark.parametrize("dialect", ["fanuc", "haas", "auto", "linuxcnc"])
@pytest.mark.parametrize(
    ("line", "code"), [("GOO X1.", "G00"), ("GO X1.", "G0"), ("MO6 T1", "M0"), ("GOO Z.5", "G00")]
)
def test_the_letter_o_in_a_code_is_named(line: str, code: str, dialect: str) -> None:
    found = error_of(f"G21\n{line}\nM30", dialect=dialect)
    assert found.line == 2
    assert found.hint.endswith(f": {code}")


def test_an_arc_with_an_absolute_centre_says_what_it_needs() -> None:
    """As a position the centre (5, 5) is 5 mm from both ends; as an offset it is not."""
    found = error_of("G21\nG0 X10. Y5.\nG3 X5. Y10. I5. J5. F60.\nM30", dialect="fanuc")
    assert found.code == "arc-radius-mismatch"
    assert "G90.1" in found.hint
