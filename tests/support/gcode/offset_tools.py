"""Tools of the tests of offset codes."""

from __future__ import annotations

from cnc.gcode.core.tool_table import ToolEntry, ToolTable


def table() -> ToolTable:
    """Return a table with a long tool, a longer one with a length only, and an empty entry."""
    return ToolTable(
        [
            ToolEntry(1, 1, {"X": 0.5, "Z": 40.0, "U": 9.0}, 6.0),
            ToolEntry(2, 2, {"Z": 100.0}),
            ToolEntry(3, 3),
        ]
    )
