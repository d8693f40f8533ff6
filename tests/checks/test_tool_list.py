"""Skeletons of tool tables from programs."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.checks.tool_list import ToolList
from cnc.cli.commands import exit_code
from cnc.gcode.core.tool_table import ToolTable

FUSION = """%
O1001
(T1  D=6. CR=0. - ZMIN=-5. - flat end mill)
(T12 D=3.175 CR=0. - ZMIN=-1. - drill)
G21
T1 M6
G43 H1 Z15.
G41 D21 X1.
T12 M6
G43 H12 Z15.
"""


def test_tools_have_numbers_diameters_and_comments() -> None:
    lines = list(ToolList.of(FUSION.splitlines()).skeleton("part.nc"))
    assert lines[2:] == [
        "; T1 P1 D6 ;D=6. CR=0. - ZMIN=-5. - flat end mill, used with D21",
        "; T12 P12 D3.175 ;D=3.175 CR=0. - ZMIN=-1. - drill",
    ]


@pytest.mark.parametrize(
    ("comment", "units", "diameter"),
    [
        ("(T3 D=0.5 CR=0. - end mill)", "G20", 12.7),
        ("( T3 |  6 MM FLAT ENDMILL | H3 )", "G21", 6.0),
        ("(TOOL 3: DIA: 8.)", "G21", 8.0),
        ("(T3 - 10MM BALL)", "G20", 10.0),
        ("(T3 something)", "G21", None),
    ],
)
def test_diameters_in_mm(comment: str, units: str, diameter: float | None) -> None:
    found = ToolList.of([comment, units, "T3 M6"])
    assert found.diameter(found.tools[3]) == diameter


def test_a_skeleton_is_no_table_until_the_tools_are_measured(tmp_path: Path) -> None:
    program, table = tmp_path / "part.nc", tmp_path / "tools.tbl"
    program.write_text(FUSION)
    assert exit_code(["tools", str(program), "-o", str(table)]) == 0
    assert len(ToolTable.load(table)) == 0
    table.write_text(table.read_text().replace("; T1 P1", "T1 P1 Z40.5"))
    (tool,) = ToolTable.load(table)
    assert (tool.number, tool.offsets, tool.diameter) == (1, {"Z": 40.5}, 6.0)


def test_a_tool_with_its_own_offset_of_a_fagor_control() -> None:
    lines = ["T1.1", "M6", "T09.09 (FACE MILL)", "M6", "T2.12", "G41.1 D3.3"]
    assert sorted(ToolList.of(lines).tools) == [1, 9]


def test_a_program_without_tools(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    program = tmp_path / "part.nc"
    program.write_text("G0 X1\n")
    assert exit_code(["tools", str(program)]) == 2
    assert "no-tools" in capsys.readouterr().err
