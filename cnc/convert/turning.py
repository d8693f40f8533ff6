"""Programs of lathes for other controls: diameters, feeds, spindle speeds, tool words, threads.

Each line is written anew: codes such as G90, G92 and G98 mean something else on FANUC's lathes than
on other machines. A table has the codes of each control. FANUC and Haas get G-code system A.
Sources: LinuxCNC 2.9, "G-codes", G7, G33, G43, G95, G96; FANUC, "Operator's Manual for Lathe
System", G-code list, "Thread cutting", "Spindle speed function", "Tool function"; Haas, "Lathe
Operator's Manual"; Siemens, "SINUMERIK 840D sl/828D Programming Manual, Fundamentals", "Constant
cutting rate", "Thread cutting with constant lead", "Tool change with T command".
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from cnc.gcode.core.axis_words import surface_rpm
from cnc.model.blocks import Spindle
from cnc.model.choices import TargetName
from cnc.model.units import MM_PER_INCH, decimal_text

SYSTEM: Literal["A"] = "A"
"""G-code system in which programs for FANUC's and Haas' lathes are written."""
_TWO_DIGITS = 99
"""Highest number of a tool and of an offset in a T word of four digits."""


@dataclass(frozen=True)
class LatheCodes:
    """Codes of a lathe's control.

    Attributes:
        radii: Code that makes X a radius; empty where X is always a diameter.
        diameters: Code that makes X a diameter.
        absolute: Code of positions; empty where nothing else is possible.
        feeds: Codes of the feed per minute and per revolution.
        speed_limit: Word of the highest speed under G96: D beside it, or LIMS; else a code that
            has it as S in a line before.
        thread: Code of a move that follows the spindle.
        lead: Letter of the lead along the move ("K"), of that along the axis that moves farther
            ("F"), or letters of the leads along X and along Z ("IK").
        start_angle: Word of the start angle with its unit in degrees; empty where there is none.
        tool_change: Whether M6 changes the tool; it stops the spindle.
        offsets: Where the number of an offset stands: "G43", "T" behind that of the tool, or "D",
            where each tool has its own offset.
        assumed: Remark about the settings of the control.
    """

    radii: str
    diameters: str
    absolute: str
    feeds: tuple[str, str]
    speed_limit: str
    thread: str
    lead: Literal["K", "F", "IK"]
    start_angle: tuple[str, float]
    tool_change: bool
    offsets: Literal["G43", "T", "D"]
    assumed: str = ""

    def tool(self, number: int, offset: int) -> str:
        """Return the words that turn the turret; empty where the control has no such words."""
        if self.offsets == "T":
            is_short = max(number, offset) <= _TWO_DIGITS
            return f"T{number:02d}{offset:02d}" if is_short else ""
        if self.offsets == "D":
            return f"T{number} D{int(offset > 0)}" if offset in (0, number) else ""
        return f"T{number} M6"

    def tool_offset(self, tool: int, offset: int) -> str:
        """Return the words of an offset; empty where the control has no such words."""
        if self.offsets == "G43":
            return f"G43 H{offset}" if offset else "G49"
        words = self.tool(tool, offset)
        return words.split()[-1] if words else ""

    def spindle(self, block: Spindle, limit: float, scale: float) -> Iterator[str]:
        """Yield the lines that start a spindle.

        Args:
            block: The block.
            limit: Limit of the speed that is in effect, rpm; 0 for none.
            scale: mm of a program unit.
        """
        turns = "M3" if block.state == "cw" else "M4"
        most = decimal_text(block.rpm, 3)
        if not block.surface_speed:
            # SINUMERIK's limit holds here, too.
            raised = f" LIMS={most}" if self.speed_limit == "LIMS" and 0 < limit < block.rpm else ""
            yield f"G97 S{most} {turns}{raised}"
            return
        metres = 1000.0 if scale == 1.0 else 12.0 * MM_PER_INCH
        speed = f"S{decimal_text(block.surface_speed * 60.0 / metres, 4)}"
        if not block.rpm:
            yield f"G96 {speed} {turns}"
        elif self.speed_limit == "D":
            yield f"G96 D{most} {speed} {turns}"
        elif self.speed_limit == "LIMS":
            yield f"G96 {speed} LIMS={most} {turns}"
        else:
            if limit != block.rpm:
                yield f"{self.speed_limit} S{most}"
            yield f"G96 {speed} {turns}"

    def limit_after(self, block: Spindle, limit: float) -> float:
        """Return the limit that holds behind these lines, rpm."""
        if self.speed_limit == "D":
            return 0.0
        return block.rpm if block.surface_speed else max(limit, block.rpm) if limit else 0.0

    def lead_word(self, pitch: float, way: tuple[float, float], digits: int) -> str:
        """Return the word of the lead of a thread.

        Args:
            pitch: Program units a turn along the move.
            way: Ways along X (a radius) and Z.
            digits: Decimals.
        """
        along = "K"
        if self.lead != "K":
            x, z = map(abs, way)
            pitch *= max(x, z) / math.hypot(x, z)
            along = "F" if self.lead == "F" else "K" if z >= x else "I"
        text = f"{pitch:.{digits}f}".rstrip("0")
        return along + text

    def angle_word(self, angle: float) -> str:
        """Return the word of the start angle of a thread, degrees."""
        word, unit = self.start_angle
        if not angle:
            return ""
        return word + decimal_text(angle / unit, 3)


_LINUXCNC = LatheCodes(
    radii="G8",
    diameters="G7",
    absolute="G90",
    feeds=("G94", "G95"),
    speed_limit="D",
    thread="G33",
    lead="K",
    start_angle=("", 0.0),
    tool_change=True,
    offsets="G43",
)
_FANUC = LatheCodes(
    radii="",
    diameters="",
    absolute="",
    feeds=("G98", "G99"),
    speed_limit="G50",
    thread="G32",
    lead="F",
    start_angle=("Q", 0.001),
    tool_change=False,
    offsets="T",
    assumed="the control has G-code system A, and X is a diameter",
)
_SIEMENS = LatheCodes(
    radii="DIAMOF",
    diameters="DIAMON",
    absolute="G90",
    feeds=("G94", "G95"),
    speed_limit="LIMS",
    thread="G33",
    lead="IK",
    start_angle=("SF=", 1.0),
    tool_change=False,
    offsets="D",
)
TARGETS: dict[TargetName, LatheCodes] = {
    "linuxcnc": _LINUXCNC,
    "fanuc": _FANUC,
    "haas": _FANUC,
    "siemens": _SIEMENS,
}
"""Codes of the controls for which programs of lathes are written."""


@dataclass
class TurningState:
    """State of the control that only lathes need.

    Attributes:
        diameter: Whether X is a diameter; None before the first move.
        tool: Number of the tool in use.
        offset: Number of the tool whose offset is in effect; 0 for none.
        spindle: The last block of the spindle that turns.
        limit: Limit of its speed that stays in effect, rpm; 0 for none.
        pitch: mm a turn of the thread that is cut; 0 outside of threads.
        angle: Angle of the spindle at which the next move of it begins, degrees.
        is_cut: Whether a move of the thread has been written.
    """

    diameter: bool | None = None
    tool: int = 0
    offset: int = 0
    spindle: Spindle | None = None
    limit: float = 0.0
    pitch: float = 0.0
    angle: float = 0.0
    is_cut: bool = False

    def feed_per_turn(self, feed: float, radius: float) -> float | None:
        """Return a feed in mm a turn.

        Args:
            feed: mm/s.
            radius: Largest radius of the move, mm.

        Returns:
            None if the spindle stands, or its speed is not known.
        """
        spindle = self.spindle
        if spindle is None:
            return None
        rpm = spindle.rpm
        if spindle.surface_speed:
            if radius == 0.0 and not rpm:
                return None
            rpm = surface_rpm(spindle.surface_speed, rpm, radius)
        return feed * 60.0 / rpm if rpm > 0.0 else None
