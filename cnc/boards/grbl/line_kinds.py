"""Kinds of lines that need a special place in the stream to a GRBL board.

Source: "Grbl v1.1 Interface", EEPROM issues, and its list of commands.
"""

from __future__ import annotations

import re
from typing import Literal

Kind = Literal["plain", "writer", "system", "pause", "dwell", "spindle", "probe", "mark"]

MOST_CHARACTERS = 79
"""Characters of a line without its end: GRBL 1.1 keeps 80 with the final zero."""

ALONE = ("writer", "system")
"""Kinds of lines beside which no other line may be unanswered."""
HOMING_TIME = 300.0
RESTORING_TIME = 5.0
"""Longest time to home the machine, and to write the whole EEPROM, s."""

_REMARK = re.compile(r"\([^)]*\)|;.*|\s+")
_WRITER = re.compile(r"G10(?![0-9.])|G(?:28|30)\.1(?![0-9])")
_PAUSE = re.compile(r"M0*[016](?![0-9.])")
_SPINDLE = re.compile(r"M0*[345789](?![0-9.])")
_PROBE = re.compile(r"G38\.[2-5]")
_DWELL = re.compile(r"G0*4(?![0-9.])")
_SECONDS = re.compile(r"P([0-9.]+)")


def bare(text: str) -> str:
    """Return a line without blanks and remarks, in upper case, as the board reads it."""
    return _REMARK.sub("", text).upper()


def kind_of(text: str) -> Kind:
    """Return the kind of a line.

    A *writer* writes to EEPROM, when the board loses bytes. A *system* command mostly needs a board
    at rest. No other line may be unanswered at the same time as one of these. During a *dwell*, a
    *spindle* or coolant command and a *probe* nothing is answered for a time, during a *pause*
    until the operator resumes. (A *mark* is the protocol's own.)
    """
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
    """Return the longest time of a line without reported motion, s.

    A dwell takes its time. Homing takes up to HOMING_TIME, during which GRBL reports nothing.
    """
    line = bare(text)
    if line.startswith("$"):
        return (
            HOMING_TIME
            if line.startswith("$H")
            else RESTORING_TIME
            if line.startswith("$RST")
            else 0.0
        )
    found = _SECONDS.search(line) if _DWELL.search(line) else None
    try:
        return float(found[1]) if found else 0.0
    except ValueError:
        return 0.0
