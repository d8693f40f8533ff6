"""Choices of the user that change how every program is read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from cnc.gcode.state.tool_tip import ToolTip
from cnc.machine.program_codes import CodeAction
from cnc.model.choices import MissingPrograms, ToolLengths, UnknownCodes, WrapRule


@dataclass(frozen=True, slots=True)
class ReadingPolicy:
    """Choices of the user for reading.

    Attributes:
        tool_lengths: Without a tool table: refuse lengths and radii of tools, or take them as 0.
        unknown_codes: Refuse M-codes without a known meaning, or skip them with a warning.
        missing_programs: Refuse calls of missing programs, or skip them with a warning.
        codes: Effects of a builder's M-codes by number.
        default_feed: Feed before the first F word, mm/min; None for none.
        optional_stop: M1 stops like M0.
        lathe: The machine is a lathe.
        diameters: X is a diameter at the start on a lathe; None for the rule of the dialect.
        laser: S is the power of a laser, which changes in motion.
        wraps: Rule of each rotary axis that repeats after 360 degrees, by its letter.
        tool_tip: Positions of a machine with tool-tip control; None for another machine.
    """

    tool_lengths: ToolLengths = "table"
    unknown_codes: UnknownCodes = "error"
    missing_programs: MissingPrograms = "error"
    codes: Mapping[int, CodeAction] = field(default_factory=dict)
    default_feed: float | None = None
    optional_stop: bool = False
    lathe: bool = False
    diameters: bool | None = None
    laser: bool = False
    wraps: Mapping[str, WrapRule] = field(default_factory=dict)
    tool_tip: ToolTip | None = None


STRICT = ReadingPolicy()
