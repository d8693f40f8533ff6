"""Errors of offset codes, by dialect."""

from __future__ import annotations

import pytest

from tests.support.gcode.gcode_cases import assert_error_at
from tests.support.gcode.offset_tools import table

ERRORS = {
    # the place of the error is marked; the table has tools 1 to 3
    "tool not in the table": ("tool-unknown", "G43 ¦H9"),
    "loaded tool not in the table": ("tool-unknown", "T9 M6\n¦G43"),
    "added tool not in the table": ("tool-unknown", "G43.2 ¦H9"),
    "half a tool": ("value-out-of-range", "G43 ¦H1.5"),
    "negative tool": ("value-out-of-range", "G43 ¦H-1"),
    "G43.1 without axes": ("axis-words-missing", "¦G43.1"),
    "G43.2 without anything": ("axis-words-missing", "¦G43.2"),
    "G43.1 and a move": ("axis-words-wanted-twice", "¦G0 G43.1 Z1"),
    "G43.2 and a move": ("axis-words-wanted-twice", "¦G0 G43.2 Z1"),
    "G43.2 with H and axes": ("axis-words-wanted-twice", "G0\nG43.2 H2 ¦Z1"),
    "G43.1 and G53": ("axis-words-wanted-twice", "G53 ¦G43.1 Z1"),
    "G43.1 and G92": ("axis-words-wanted-twice", "¦G43.1 G92 Z1"),
    "H without G43": ("word-unused", "G0 X1 ¦H1"),
    "two lengths": ("modal-conflict", "G43 H1 ¦G49"),
    "L1 of a tool not in the table": ("tool-unknown", "G10 L1 ¦P9 Z1"),
    "L1 without P": ("tool-number-missing", "¦G10 L1 Z1"),
    "L1 P0": ("value-out-of-range", "G10 L1 ¦P0 Z1"),
    "L1 without data": ("axis-words-missing", "¦G10 L1 P1"),
    "L10 without data": ("axis-words-missing", "¦G10 L10 P1"),
    "L1 with a bad orientation": ("value-out-of-range", "G10 L1 P1 ¦Q10"),
    "L1 with a foreign word": ("word-unused", "G10 L1 P1 Z1 ¦D3"),
    "L1 of a missing axis": ("axis-missing", "G10 L1 P1 ¦U1"),
    "L0 with a tool loaded": ("tool-loaded", "T1 M6\n¦G10 L0"),
    "L12 is no tool table's": ("code-not-supported", "G10 ¦L12 P1 R1"),
    "L3": ("code-not-supported", "G10 ¦L3 P1"),
    "R of L20": ("word-unused", "G10 L20 P1 X1 ¦R3"),
    "H of L2": ("word-unused", "G10 L2 P1 X1 ¦H3"),
    "a tenth system": ("value-out-of-range", "G10 L20 ¦P10 X1"),
    "G52 without axes": ("axis-words-missing", "¦G52"),
    "G52 and a move": ("axis-words-wanted-twice", "G52 ¦G0 X1"),
    "G52 of a missing axis": ("axis-missing", "G52 X1 ¦A5"),
    "G28 of a missing axis": ("axis-missing", "G28 X1 ¦A5"),
    "G28 and an arc": ("axis-words-wanted-twice", "G28 ¦G2 X1 I1 F60"),
    "G28 and G92": ("modal-conflict", "G28 ¦G92 X1"),
    "G28.1 with an axis": ("axis-words-unused", "G0\nG28.1 ¦X1"),
    "G92.2 with an axis": ("axis-words-unused", "G0\nG92.2 ¦X1"),
    "G30 has no P": ("word-unused", "G30 ¦P2"),
    "5420 is read-only": ("parameter-read-only", "¦#5420=1"),
    "5400 is read-only": ("parameter-read-only", "¦#5400=1"),
    "named ones, too": ("parameter-read-only", "¦#<_x>=1"),
    "compensation in another plane under R": ("arc-rotated", "G10 L2 P1 R30\nG18 ¦G41.1 D1"),
}


@pytest.mark.parametrize("name", ERRORS)
def test_errors(name: str) -> None:
    assert_error_at(*ERRORS[name], tools=table())


@pytest.mark.parametrize(
    ("dialect", "code", "marked"),
    [
        ("linuxcnc", "machine-coordinates-incremental", "G91 ¦G53 G0 X1"),
        ("linuxcnc", "axis-words-wanted-twice", "¦G0 G28 X1"),
        ("fanuc", "machine-coordinates-incremental", "G91 ¦G53 G0 X1"),
        ("fanuc", "axis-words-missing", "¦G28"),
        ("fanuc", "axis-words-missing", "¦G30 P2"),
        ("fanuc", "reference-position-missing", "G30 ¦P3 X0"),
        ("fanuc", "value-out-of-range", "G30 ¦P1 X0"),
        ("fanuc", "offset-system-missing", "¦G54.1"),
        ("fanuc", "value-out-of-range", "G54.1 ¦P49"),
        ("fanuc", "value-out-of-range", "G54.1 ¦P0"),
        ("fanuc", "value-out-of-range", "G10 L20 ¦P0 X1"),
        ("linuxcnc", "code-not-in-dialect", "¦G54.1 P1"),
        ("fanuc", "tool-offset-missing", "G0 ¦G43 Z1"),
        ("fanuc", "tool-table-missing", "G43 ¦H9"),
        ("fanuc", "tool-unknown", "G10 L10 P1 R5\nG43 ¦H9"),
        ("fanuc", "tool-offset-missing", "¦G10 L12 P1"),
        ("fanuc", "code-not-supported", "G10 ¦L1 P1 Z1"),
        ("fanuc", "word-not-in-dialect", "G10 L2 P1 ¦R5"),
        ("grbl", "word-not-in-dialect", "G10 L2 P1 X1 ¦R5"),
        ("grbl", "code-not-supported", "G10 ¦L1 P1 Z1"),
        ("grbl", "axis-not-in-dialect", "G43.1 ¦X1"),
        ("grbl", "axis-words-missing", "¦G10 L2 P1"),
    ],
)
def test_errors_of_dialects(dialect: str, code: str, marked: str) -> None:
    assert_error_at(code, marked, dialect=dialect)
