"""Marks of executed lines among the blocks, for a reader that writes the program anew.

Behind the blocks of each line stands its mark: the text of the line and the state behind it. One
mark stands for many plain lines where the reader takes them as they are.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from typing import NamedTuple

from cnc.gcode.core.call_stack import Flow, Listing
from cnc.gcode.core.coordinates import Coordinates
from cnc.gcode.core.modal_groups import ModalState
from cnc.gcode.reader.source_text import Window
from cnc.gcode.reader.statements import Statement
from cnc.model.blocks import Block, canonical
from cnc.model.diagnostics import GcodeError

Bulk = Callable[[Window, int, int], int]
"""Returns how many lines of a window one mark may stand for, from an index up to another one."""


class Offsets(NamedTuple):
    """Parts of the sum that leads from program to machine coordinates; each (axes,) mm or degrees.

    Attributes:
        system: Index of the coordinate system, 0 for G54.
        origin: Its origin.
        external: FANUC's offset of all systems.
        tool: Length of the tool.
        number: Number of the tool whose length it is; 0 for none, -1 for values without a number.
        shift: The shift of G92.
        local: The local offset of G52 and of programmable frames.
        turned: Whether scaling, mirroring or rotation make it more than a sum.
    """

    system: int
    origin: tuple[float, ...]
    external: tuple[float, ...]
    tool: tuple[float, ...]
    number: int
    shift: tuple[float, ...]
    local: tuple[float, ...]
    turned: bool

    @classmethod
    def of(cls, coordinates: Coordinates, number: int) -> Offsets:
        """Return the offsets in effect."""
        origin, external, shift, local = coordinates.parts()
        return cls(
            coordinates.system,
            tuple(origin),
            tuple(external),
            tuple(coordinates.tool_offset),
            number,
            tuple(shift),
            tuple(local),
            coordinates.turned,
        )


@canonical
class ExecutedLines(Block):
    """Lines that were executed; their blocks stand before this mark.

    Only readers that ask for these blocks get them.

    Attributes:
        last: The last line.
        text: The line; of several lines the bytes with their ends, decoded.
        statement: Its statement; None for several lines.
        modal: The modal state behind it.
        offsets: The offsets behind it.
        is_open: Whether later words decide about its motion: under cutter compensation, in a
            spline of many lines, at a chamfer. Its blocks may come with a later line.
        is_plain: Whether moves are a sum of words and offsets.
        ended: Whether the program has ended.
    """

    last: int
    text: bytes
    statement: Statement | None
    modal: ModalState
    offsets: Offsets
    is_open: bool
    is_plain: bool
    ended: bool


class LineTrace:
    """Puts the marks among the blocks of a program.

    Args:
        bulk: Says which lines one mark may stand for.
    """

    def __init__(self, bulk: Bulk) -> None:
        self.bulk = bulk

    def begin(self, flow: Flow) -> None:
        """Add the mark of the state before the first line; its line is 0."""
        self._mark(flow, 0, 0, b"", None)

    def record(self, flow: Flow, begin: tuple[Listing, int, int], executed: int) -> None:
        """Add the mark of the lines that a step has executed.

        Args:
            flow: The flow behind them.
            begin: Their text, the first of them, and the number of lines executed before.
            executed: The number of lines executed so far.
        """
        listing, line, before = begin
        flow.interpreter.out.flush()
        window = listing.window(line)
        if window is None:
            return
        index = line - window.first
        begins, ends = window.places
        if executed > before + 1:
            last = line + executed - before - 1
            end = last - window.first
            stop = int(begins[end + 1]) if end + 1 < window.count else len(window.data)
            self._mark(flow, line, last, window.data[int(begins[index]) : stop], None)
        else:
            text = window.data[int(begins[index]) : int(ends[index])]
            self._mark(flow, line, line, text, self._statement(listing, window, index))

    @staticmethod
    def _mark(flow: Flow, line: int, last: int, text: bytes, statement: Statement | None) -> None:
        interpreter = flow.interpreter
        motion = interpreter.motion
        mark = ExecutedLines(
            interpreter.here.file,
            line,
            last,
            text,
            statement,
            copy(interpreter.modal),
            Offsets.of(interpreter.coordinates, interpreter.tool_codes.offset_number),
            motion.compensation.active
            or motion.collector is not None
            or motion.corners.corner is not None,
            interpreter.plain,
            interpreter.ended,
        )
        interpreter.out.ready.append((mark,))

    @staticmethod
    def _statement(listing: Listing, window: Window, index: int) -> Statement | None:
        try:
            return listing.statement(window, index)
        except GcodeError:
            # A line that the flow does not read, such as the profile of a cycle.
            return None
