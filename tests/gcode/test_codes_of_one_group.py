"""Two codes of one group in a line, and G54 with P, on FANUC controls."""

from __future__ import annotations

import pytest

from tests.support.gcode.gcode_cases import error_of, points, warnings

LAST_OF_GROUP = {
    "distance": ("G0 X5.\nG91 G90 X3.", [(5.0, 0.0, 0.0), (3.0, 0.0, 0.0)]),
    "distance, reversed": ("G0 X5.\nG90 G91 X3.", [(5.0, 0.0, 0.0), (8.0, 0.0, 0.0)]),
    "motion": ("G1 F60. X1.\nG1 G0 X2.\nX3.", [(1.0, 0.0, 0.0), (2.0, 0.0, 0.0), (3.0, 0.0, 0.0)]),
    "system": ("G10 L2 P2 X100.\nG0 G54 G55 X1.", [(101.0, 0.0, 0.0)]),
    "units": ("G21 G20 G0 X1.", [(25.4, 0.0, 0.0)]),
    "the way home is absolute": (
        "G0 Z5.\nG91 G28 Z2. G90",
        [(0.0, 0.0, 5.0), (0.0, 0.0, 2.0), (0.0, 0.0, 0.0)],
    ),
    "three": ("G17 G18 G17\nG0 X1.", [(1.0, 0.0, 0.0)]),
}


@pytest.mark.parametrize("name", LAST_OF_GROUP)
def test_the_last_code_of_a_group_counts_on_fanuc(name: str) -> None:
    """FANUC Series 30i, "Preparatory function": the last G-code of a group is valid."""
    program, expected = LAST_OF_GROUP[name]
    assert points(program, "fanuc") == expected
    assert {each.code for each in warnings(program, "fanuc")} == {"code-replaced"}
    for dialect in ("haas", "auto", "linuxcnc", "grbl", "mach3"):
        assert error_of(program, dialect=dialect).code == "modal-conflict"


def test_each_different_line_is_reported_once() -> None:
    program = "G0 X5.\n" + "G91 G90 X3.\n" * 3 + "\n".join(f"G90 G91 X{i}." for i in range(1, 50))
    found = warnings(program, "fanuc")
    assert [each.line for each in found] == [2, *range(5, 54)]
    assert found[0].message == "G91 has no effect: G90 in the same line replaces it"
    assert points(program, "fanuc")[-1][0] == 3.0 + sum(range(1, 50))


def test_codes_of_no_group_and_m_codes_still_exclude_each_other_on_fanuc() -> None:
    for line in ("G4 P1 G53 X1.", "M3 M5", "M8 M9", "G81 G82 X1. Z-1. R1. P1 F60."):
        assert error_of(line, dialect="fanuc").code == "modal-conflict"


def test_g54_with_p_is_a_further_coordinate_system_on_fanuc() -> None:
    """FANUC Series 16i and 30i, "Additional workpiece coordinate system": G54.1 P or G54 P."""
    program = "G10 L20 P2 X100. Y50.\nG90 G54 P2 G0 X1. Y2.\nG54 X0"
    assert points(program, "fanuc") == [(101.0, 52.0, 0.0), (0.0, 52.0, 0.0)]
    assert points(program.replace("G54 P2", "G54.1 P2"), "fanuc") == points(program, "fanuc")
    assert error_of("G54 P49", dialect="fanuc").code == "value-out-of-range"
    for dialect in ("haas", "auto", "linuxcnc"):
        assert error_of("G54 P2 G0 X1.", dialect=dialect).code == "word-unused"


@pytest.mark.parametrize(
    "program", ["G82 X1. Z-1. R1. P1 F60.\nG54 P1 X2.", "G54 P1 G82 X1. Z-1. R1. F60."]
)
def test_p_beside_g54_is_never_guessed(program: str) -> None:
    assert error_of(program, dialect="fanuc").code == "word-wanted-twice"


@pytest.mark.parametrize(("given", "reached"), [("#8=0\n", 3.0), ("#8=90\n", 1.0), ("", 3.0)])
def test_a_computed_code_beside_others(given: str, reached: float) -> None:
    """Its group is known when the line is executed. A vacant one counts as not written."""
    program = f"O1\nG21\n{given}G0 X2.\nG91 G#8 X1.\nM30"
    assert points(program, "fanuc")[-1][0] == reached
