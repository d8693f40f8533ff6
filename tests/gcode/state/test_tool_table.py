"""Tool table: the file, its errors, and the parameters of the tool in the spindle."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from cnc.gcode.reader.parameters import Parameters
from cnc.model.diagnostics import MachineFileError

TABLE = """\
; the mill's tools
T1 P1 D6. Z+40.25   ;end mill 6 mm
  p9 t99999 z.5;no blank before, any case

T3  Q2 J-155.5 I95 W9 V8 U7 C6 B5 A4 Z3 Y2 X1 D0.8 P0
T 4 D 10
"""


def load(tmp_path: Path, text: str) -> ToolTable:
    path = tmp_path / "tool.tbl"
    path.write_text(text, encoding="utf-8")
    return ToolTable.load(path)


def test_every_word_in_any_order(tmp_path: Path) -> None:
    table = load(tmp_path, TABLE)
    assert len(table) == 4
    assert table.tool(1) == ToolEntry(1, 1, {"Z": 40.25}, 6.0, comment="end mill 6 mm")
    assert table.tool(99999) == ToolEntry(99999, 9, {"Z": 0.5}, comment="no blank before, any case")
    offsets = dict(zip("XYZABCUVW", range(1, 10), strict=True))
    assert table.tool(3) == ToolEntry(3, 0, offsets, 0.8, 95.0, -155.5, 2)
    assert table.tool(4) == ToolEntry(4, diameter=10.0)
    assert table.tool(2) is None
    assert not table.changed


@pytest.mark.parametrize(
    ("line", "code", "column"),
    [
        ("T1 P1 D6 Z40 end mill", "tool-table-malformed", 14),
        ("T1 P1 E6", "tool-table-malformed", 7),
        ("T1 P1 $", "tool-table-malformed", 7),
        ("T1 P1 D", "number-missing", 7),
        ("T1.5 P1", "value-out-of-range", 1),
        ("T-1", "value-out-of-range", 1),
        ("T100000", "value-out-of-range", 1),
        ("T1 Q10", "value-out-of-range", 4),
        ("T1 P1.5", "value-out-of-range", 4),
        ("T1 Z" + "9" * 400, "value-out-of-range", 4),
        ("P1 D6", "tool-number-missing", 1),
        ("T1 D6 D7", "word-repeated", 7),
        ("  T2 ;again", "tool-repeated", 3),
        ("TOOLNO POCKET LENGTH", "number-missing", 1),
    ],
)
def test_a_wrong_line_is_reported(tmp_path: Path, line: str, code: str, column: int) -> None:
    with pytest.raises(MachineFileError) as caught:
        load(tmp_path, f"; tools\nT2 P2 D3\n{line}\n")
    found = caught.value.diagnostic
    assert (found.code, found.line, found.column, found.text) == (code, 3, column, line)
    assert found.file.endswith("tool.tbl")
    assert caught.value.exit_code == 2


def test_a_missing_table(tmp_path: Path) -> None:
    with pytest.raises(MachineFileError) as caught:
        ToolTable.load(tmp_path / "none.tbl")
    assert caught.value.diagnostic.code == "tool-table-unreadable"


def test_wear_adds_to_radius_and_length() -> None:
    entry = ToolEntry(
        1, offsets={"X": 1.0, "Z": 40.0}, diameter=6.0, wear={"Z": -0.25}, radius_wear=0.125
    )
    assert (entry.radius, entry.offset("Z"), entry.offset("X"), entry.offset("Y")) == (
        3.125,
        39.75,
        1.0,
        0.0,
    )


def test_a_changed_tool_is_read_back() -> None:
    table = ToolTable([ToolEntry(1, diameter=6.0)])
    table.put(ToolEntry(1, diameter=5.0))
    assert table.tool(1) == ToolEntry(1, diameter=5.0)
    assert table.changed


def test_reload_keeps_changed_tools(tmp_path: Path) -> None:
    table = load(tmp_path, TABLE)
    table.put(ToolEntry(4))
    load(tmp_path, "T1 D7\nT4 D8")
    table.reload()
    assert list(table) == [ToolEntry(1, diameter=7.0), ToolEntry(4)]
    bare = ToolTable([ToolEntry(2)])
    bare.reload()
    assert len(bare) == 1


def test_save_changes_only_the_lines_of_changed_tools(tmp_path: Path) -> None:
    table, path = load(tmp_path, TABLE), tmp_path / "tool.tbl"
    first = table.tool(1)
    assert first is not None
    table.put(replace(first, offsets={"Z": 1e-7, "X": -0.1}, wear={"Z": 5.0}))
    table.put(ToolEntry(12, orientation=3, front_angle=1e22))
    table.save(path)
    lines = path.read_text().splitlines()
    assert lines == [
        "; the mill's tools",
        "T1 P1 Z0.0000001 X-0.1 D6.0 ;end mill 6 mm",
        *TABLE.splitlines()[2:],
        "T12 P0 I10000000000000000000000 Q3",
    ]
    again = ToolTable.load(path).tool(1)
    assert again is not None
    assert again.offsets == {"Z": 1e-7, "X": -0.1}


@given(
    st.dictionaries(st.sampled_from("XYZABCUVW"), st.floats(allow_nan=False, allow_infinity=False)),
    st.floats(-1e9, 1e9),
)
def test_a_saved_tool_is_read_back_exactly(
    tmp_path_factory: pytest.TempPathFactory, offsets: dict[str, float], diameter: float
) -> None:
    path = tmp_path_factory.mktemp("tools") / "tool.tbl"
    table = ToolTable()
    table.put(ToolEntry(1, 2, offsets, diameter))
    table.save(path)
    found = ToolTable.load(path).tool(1)
    assert found == ToolEntry(
        1, 2, {letter: value for letter, value in offsets.items() if value}, diameter
    )


def test_parameters_show_the_loaded_tool(tmp_path: Path) -> None:
    table, parameters, spindle = load(tmp_path, TABLE), Parameters(), [0]
    table.bind(parameters, lambda: spindle[0])
    assert [parameters.number(number, 1) for number in range(5400, 5414)] == [0.0] * 14
    spindle[0] = 3
    assert [parameters.number(number, 1) for number in range(5400, 5414)] == [
        3,
        1,
        2,
        3,
        4,
        5,
        6,
        7,
        8,
        9,
        0.8,
        95,
        -155.5,
        2,
    ]
    assert parameters.name("_current_tool", 1) == 3.0
    spindle[0] = 7  # a tool that the table has not
    assert [parameters.number(number, 1) for number in (5400, 5403, 5410)] == [7.0, 0.0, 0.0]
