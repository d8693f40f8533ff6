"""Moves along Z under G91 with a new tool length. Source: FANUC, "Tool length compensation"."""

from __future__ import annotations

import pytest

from cnc.model.blocks import Polyline
from tests.support.gcode.gcode_cases import error_of, points, run
from tests.support.gcode.offset_tools import table


@pytest.mark.parametrize("dialect", ["fanuc", "haas"])
def test_an_increment_of_z_moves_by_a_new_tool_length_too(dialect: str) -> None:
    """FANUC: the offset is added to the end point, whether it is absolute or an increment."""
    memory = "G10 L10 P1 R-4\nG91 G0 X120\n"
    reached = points(memory + "G43 Z-32 H1\nZ-21\nG49 Z53", dialect)
    assert [z for *_, z in reached] == [0.0, -36.0, -57.0, 0.0]
    homed = points("G10 L10 P1 R-4\nG90 G43 G0 Z0 H1\nG49\nG91 G28 Z0", dialect)
    assert [z for *_, z in homed] == [-4.0, -4.0, 0.0]
    again = points("G10 L10 P1 R-4\nG43 H1\nG90 G0 Z-4\nG91 Z1", dialect)
    assert [z for *_, z in again] == [-8.0, -7.0]
    if dialect == "haas":
        home = points("G10 L10 P1 R-4\nG90 G43 H1 G0 Z5\nG49\nG28\nG91 Z1", dialect)
        assert [z for *_, z in home] == [1.0, 0.0, 1.0]
    for move in ("G0 Z-5", "G0 X1\nZ-5", "G2 X2 I1 Z1 F9", "G81 X1 Z-5 R-1 F9"):
        found = error_of(f"G10 L10 P1 R-4\nG43 H1\nG91 {move}", dialect=dialect)
        assert found.code == "tool-length-incremental", move


def test_an_increment_of_z_leaves_out_the_tool_length_of_linuxcnc() -> None:
    program = "G91 G0 Z5\nG43 Z-37 H1\nM2"
    assert [
        row for block in run(program, dialect="linuxcnc", tools=table())
        if isinstance(block, Polyline) for row in block.points.tolist()
    ][-1][2] == -32.0  # fmt: skip
    found = error_of(program, dialect="auto", tools=table())
    assert (found.code, found.line) == ("tool-length-incremental", 2)
    assert error_of("G43 H1\nG91 G81 X1 Z-5 R-1 F9", dialect="auto", tools=table()).code == (
        "tool-length-incremental"
    )
