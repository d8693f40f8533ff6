"""Offsets of a lathe's turret that a program sets (G10)."""

from __future__ import annotations

import pytest

from cnc.gcode import dialects
from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from cnc.gcode.dialects import Dialect
from cnc.model.blocks import Polyline
from cnc.model.diagnostics import Diagnostic
from tests.support.gcode.gcode_cases import error_of, run


def lathe(name: str) -> Dialect:
    return dialects.load(name, lathe="A")


def last(source: str, name: str, *entries: ToolEntry) -> tuple[float, float]:
    """The last position of a program, x (radius) and z."""
    blocks = run(source, dialect=lathe(name), axes=("x", "z"), tools=ToolTable(entries))
    ends = [row for block in blocks if isinstance(block, Polyline) for row in block.points.tolist()]
    x, z = ends[-1]
    return x, z


def refused(source: str, name: str) -> Diagnostic:
    return error_of(source, dialect=lathe(name), axes=("x", "z"))


MOVE = "\nT0101\nG0 X10. Z20."


@pytest.mark.parametrize(
    ("name", "line", "x", "z"),
    [
        ("fanuc", "G10 P10001 X4. Z-3.", 2.0, -3.0),
        ("fanuc", "G10 P1 X4. Z-3.", 2.0 + 7.0, -3.0 + 9.0),  # wear, added to the geometry
        ("fanuc", "G10 P10001 U1. W2.", 0.5 + 7.0, 2.0 + 9.0),
        ("fanuc", "G10 P1 Z1.\nG10 P1 W0.5", 7.0, 1.5 + 9.0),
        ("fanuc", "G10 P10001 Z1.", 7.0, 1.0),
        ("haas", "G10 L10 P1 X4. Z-3.", 2.0, -3.0),
        ("haas", "G10 L11 P1 X4. Z-3.", 9.0, 6.0),
        ("fanuc", "G20\nG10 P10001 X2. Z1.\nG21", 25.4, 25.4),
    ],
)
def test_an_offset_acts_with_the_next_tool_word(name: str, line: str, x: float, z: float) -> None:
    """X of the table is a radius, X of the program a diameter."""
    known = ToolEntry(1, offsets={"X": 7.0, "Z": 9.0})
    assert last(line + MOVE, name, known) == pytest.approx((5.0 + x, 20.0 + z))


def test_the_nose_of_an_offset() -> None:
    """Radius and orientation serve the compensation of later moves, as those of the table do."""
    program = "G97 S500 M3\nT0101\nG0 X20. Z10.\nG42 G1 X10. Z5. F0.2\nZ-5.\nX20.\nG40 G0 X30."
    table = ToolEntry(1, diameter=0.8, orientation=3)
    known = last(program, "fanuc", table)
    assert last(f"G10 P10001 Z0 R0.4 Q3\n{program}", "fanuc") == known
    assert last(f"G10 P10001 Z0 R0.3 Q3\nG10 P1 R0.1\n{program}", "fanuc") == known


@pytest.mark.parametrize(
    ("name", "line", "code"),
    [
        ("fanuc", "G10 P0 X1.", "value-out-of-range"),
        ("fanuc", "G10 P100 X1.", "value-out-of-range"),
        ("fanuc", "G10 P10100 X1.", "value-out-of-range"),
        ("fanuc", "G10 X1.", "tool-number-missing"),
        ("fanuc", "G10 P1", "axis-words-missing"),
        ("fanuc", "G10 L10 P1 X1.", "code-not-supported"),
        ("fanuc", "G10 P1 Q10", "value-out-of-range"),
        ("haas", "G10 P1 X1.", "offset-kind-missing"),
        ("haas", "G10 L12 P1 X1.", "code-not-supported"),
    ],
)
def test_faults(name: str, line: str, code: str) -> None:
    assert refused(f"G97 S500 M3\n{line}", name).code == code
