"""What a line asks of a GRBL board beyond its place in the stream. Source: "Grbl v1.1 Interface",
EEPROM issues, and its command list.
"""

from __future__ import annotations

import re
from typing import Literal

Kind = Literal["plain", "writer", "system", "pause", "dwell", "spindle", "probe"]

MOST_CHARACTERS = 79
"""Of a line, without its end: GRBL 1.1 keeps 80 with the zero behind them."""

HOMING = 300.0
RESTORING = 5.0
"""Seconds that it may take to home the machine, and to write the whole EEPROM."""

_MOVE = re.compile(r"(?:G0?[0-3](?![0-9.]) ?)?(?:[FIJKXYZ]-?[0-9]*\.?[0-9]* ?)*")
_REMARK = re.compile(r"\([^)]*\)|;.*|\s+")
_WRITER = re.compile(r"G10(?![0-9.])|G(?:28|30)\.1(?![0-9])")
_PAUSE = re.compile(r"M0*[016](?![0-9.])")
_SPINDLE = re.compile(r"M0*[345789](?![0-9.])")
_PROBE = re.compile(r"G38\.[2-5]")
_DWELL = re.compile(r"G0*4(?![0-9.])")
_SECONDS = re.compile(r"P([0-9.]+)")


def bare(text: str) -> str:
    """A line without blanks and remarks, in upper case: what the board makes of it."""
    return _REMARK.sub("", text).upper()


def kind_of(text: str) -> Kind:
    """What a line needs of the stream around it.

    No other line may be under way with a *writer* (the board is deaf while it writes to EEPROM) or
    a *system* command (most want a board at rest). A *dwell*, a *spindle* (coolant too) or a
    *probe* takes its time while nothing is answered, a *pause* until the operator goes on.
    """
    # Most lines are moves.
    if _MOVE.fullmatch(text):
        return "plain"
    line = bare(text)
    if line.startswith("$"):
        return "plain" if line.startswith("$J=") else "writer" if "=" in line else "system"
    if ("G10" in line or ".1" in line) and _WRITER.search(line):
        return "writer"
    if "M" in line:
        if _PAUSE.search(line):
            return "pause"
        if _SPINDLE.search(line):
            return "spindle"
    if "G38" in line and _PROBE.search(line):
        return "probe"
    if "P" in line and _DWELL.search(line):
        return "dwell"
    return "plain"


def seconds_of(text: str) -> float:
    """How long a line may take while nothing moves that is reported: a dwell its time, homing
    HOMING, in which GRBL says nothing at all.
    """
    line = bare(text)
    if line.startswith("$"):
        return HOMING if line.startswith("$H") else RESTORING if line.startswith("$RST") else 0.0
    found = _SECONDS.search(line) if _DWELL.search(line) else None
    try:
        return float(found[1]) if found else 0.0
    except ValueError:
        return 0.0
