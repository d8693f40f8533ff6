"""Programs of lathes for LinuxCNC: diameters, feed per revolution, surface speed, offsets, threads.

Each line is written anew: codes such as G90, G92 and G98 mean something else on FANUC's lathes. A T
word of turret and offset becomes ``T1 M6`` and ``G43 H1``, so the tool table of LinuxCNC counts.
Source: LinuxCNC 2.9, "G-codes", G7, G33, G43, G95, G96.
"""

from __future__ import annotations

from dataclasses import dataclass

from cnc.gcode.core.axis_words import surface_rpm
from cnc.gcode.dialects import Dialect
from cnc.gcode.reader.statements import Statement
from cnc.model.blocks import Spindle
from cnc.model.units import MM_PER_INCH

TARGET = "linuxcnc"
"""The control for which programs of lathes are written."""


@dataclass
class TurningState:
    """State of the control that only lathes need.

    Attributes:
        diameter: Whether X is a diameter; None before the first move.
        offset: Number of the tool whose offset is in effect; 0 for none.
        wanted: That of the program.
        spindle: The last block of the spindle that turns.
        pitch: mm a turn of the thread that is cut; 0 outside of threads.
        is_cut: Whether a move of the thread has been written.
    """

    diameter: bool | None = None
    offset: int = 0
    wanted: int = 0
    spindle: Spindle | None = None
    pitch: float = 0.0
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

    def take_tool(self, statement: Statement, source: Dialect, tool: int | None) -> None:
        """Take the number of the offset from the words T (FANUC) or D (SINUMERIK) of a line."""
        for word in statement.words:
            if word.letter == "T" and source.turning.lathe and word.whole is not None:
                self.wanted = word.whole % 100
            elif word.letter == "H" and source.flavour == "ngc" and word.whole is not None:
                self.wanted = word.whole
            elif word.letter == "D" and source.flavour == "siemens" and word.whole is not None:
                self.wanted = (tool or 0) if word.whole else 0


def spindle_words(block: Spindle, scale: float) -> str:
    """Return the codes of a spindle that turns.

    Args:
        block: The block.
        scale: mm of a program unit.
    """
    turns = "M3" if block.state == "cw" else "M4"
    if not block.surface_speed:
        return f"G97 S{block.rpm:.3f}".rstrip("0").rstrip(".") + f" {turns}"
    metres = 1000.0 if scale == 1.0 else 12.0 * MM_PER_INCH
    speed = f"S{block.surface_speed * 60.0 / metres:.4f}".rstrip("0").rstrip(".")
    most = f" D{block.rpm:.3f}".rstrip("0").rstrip(".") if block.rpm else ""
    return f"G96{most} {speed} {turns}"
