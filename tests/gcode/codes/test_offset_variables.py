"""Macro variables of tool offsets and coordinate systems, by the tables of the manuals."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from cnc.gcode.reader.parameters import Parameters, read_parameters, write_parameters
from tests.support.gcode.gcode_cases import error_of, points, run, warnings

# Offset 5: length 50, its wear 0.25, radius 3, its wear -0.125 (mm).
MEMORY = ToolEntry(
    5, offsets={"Z": 50.0}, wear={"Z": 0.25}, diameter=6.0, radius_wear=-0.125
)  # fmt: skip


def memory() -> ToolTable:
    return ToolTable([MEMORY])


@pytest.mark.parametrize(
    ("dialect", "number", "value"),
    [
        # FANUC Series 30i, tool compensation values of memory C, V15 of parameter 6000 is 0.
        ("fanuc", 11005, 50.0), ("fanuc", 2205, 50.0), ("fanuc", 10005, 0.25),
        ("fanuc", 2005, 0.25), ("fanuc", 13005, 3.0), ("fanuc", 12005, -0.125),
        # Haas, macro variables: tool length and wear, tool diameter and wear.
        ("haas", 2005, 50.0), ("haas", 2205, 0.25), ("haas", 2405, 6.0), ("haas", 2605, -0.25),
    ],
)  # fmt: skip
def test_variables_show_the_offset_memory(dialect: str, number: int, value: float) -> None:
    assert points(f"G0 X#{number}", dialect, tools=memory()) == [(value, 0, 0)]
    inches = points(f"G20\nG0 X#{number}", dialect, tools=memory())
    assert inches[0][0] == pytest.approx(value), "a variable has the units of the program"


@pytest.mark.parametrize(
    ("dialect", "numbers"),
    [("fanuc", (11005, 10005, 13005, 12005)), ("haas", (2005, 2205, 2405, 2605))],
)
def test_variables_set_the_offset_memory(dialect: str, numbers: tuple[int, ...]) -> None:
    """The length is 10 + 1. The radius is 2 + 0.5: Haas' numbers are diameters."""
    tools = ToolTable()
    double = 2 if dialect == "haas" else 1
    values = (10, 1, 2 * double, 0.5 * double)
    lines = [f"#{number}={float(value)}" for number, value in zip(numbers, values, strict=True)]
    reached = points("\n".join([*lines, "G0 G43 H5 Z1."]), dialect, tools=tools)
    assert reached == [(0, 0, 12)]
    entry = tools.tool(5)
    assert entry is not None
    assert entry.radius == 2.5


def test_a_loop_sees_the_variable_that_it_sets() -> None:
    program = "WHILE [#11001 LT 30.] DO1\n#11001=#11001+10.\nEND1\nG0 X#11001"
    assert points(f"#11001=0\n{program}", "fanuc", tools=ToolTable()) == [(30, 0, 0)]


def test_the_wear_of_memory_c_is_reported_once() -> None:
    """Memory A has the whole length in #2001, so a program may mean that."""
    found = warnings("#1=#2005\n#2=#10005", "fanuc", tools=memory())
    assert [(each.code, each.line) for each in found] == [("offset-variable-wear", 1)]
    assert "#11005" in found[0].hint
    assert not warnings("#1=#2005", "haas", tools=memory())
    assert not warnings("#1=#11005", "fanuc", tools=memory())


def test_without_a_table_a_length_is_missing() -> None:
    assert error_of("#1=#11005", dialect="fanuc").code == "tool-table-missing"


@pytest.mark.parametrize("number", [2000, 2201 + 200, 2501 + 6, 10000, 14001 + 48 * 20])
def test_other_numbers_are_no_variables(number: int) -> None:
    assert error_of(f"#1=#{number}", dialect="fanuc").code == "parameter-number"


def test_origins_by_axis() -> None:
    """#2500, #2600 and #2700 are the external offset; G54 to G59 follow."""
    program = "#2500=100.\n#2601=20.\n#2706=3.\nG54 G0 X1. Y1. Z1.\nG59 X1. Y1. Z1."
    assert points(program, "fanuc") == [(101, 21, 1), (101, 1, 4)]
    assert points("G10 L2 P2 Y8.\nG0 X#2602", "fanuc") == [(8, 0, 0)]


@pytest.mark.parametrize(("dialect", "code"), [("fanuc", "G54.1"), ("haas", "G154")])
def test_origins_of_more_systems_have_two_numbers(dialect: str, code: str) -> None:
    """#14001 is X of P1, #14022 is Y of P2."""
    program = f"#14001=5.\n#14022=6.\n{code} P1 G0 X1.\n{code} P2 Y1."
    assert points(program, dialect) == [(6, 0, 0), (6, 7, 0)]


def test_haas_has_two_numbers_for_a_common_variable(tmp_path: Path) -> None:
    program = "#10500=4.\n#101=2.\n#10300=8.\nG0 X#500 Y#10101 Z#10300"
    known = Parameters(macro=True)
    assert points(program, "haas", parameters=known) == [(4, 2, 8)]
    file = tmp_path / "parameters"
    write_parameters(file, known.stored())
    assert {500: 4.0, 10300: 8.0}.items() <= read_parameters(file).items()


def test_a_diameter_of_haas_is_reported() -> None:
    """Setting 40 of the control says whether it is a diameter or a radius."""
    found = warnings("G10 L12 P1 R6.", "haas", tools=ToolTable())
    assert [each.code for each in found] == ["offset-diameter"]
    assert not warnings("G10 L12 P1 R3.", "fanuc", tools=ToolTable())
    run("G10 L13 P1 R0.1", dialect="haas", tools=ToolTable())
