"""Runs of plain lines, executed by compiled code (:mod:`cnc.kernels.gcode.line`).

A program of a million lines makes no Python object for a line, only for its blocks. The result is
the same as that of the interpreter.
"""

from __future__ import annotations

import re

from cnc.gcode.program.interpreter import Interpreter
from cnc.gcode.program.line_machine import MOST_ROWS, LineMachine
from cnc.gcode.reader.lines import KLARTEXT
from cnc.gcode.syntax.source_text import Window
from cnc.kernels.gcode.line import execute_lines

SHORTEST = 6
"""Lines. A shorter run is no faster in compiled code."""
ROWS_OF_LINE = 5
"""Rows for which there is space for each line of a run: a hole has as many."""

WITHOUT_POINT = re.compile(rb"[XYZABCUVWIJKR][+-]?0*[1-9][0-9]*(?![0-9.])", re.IGNORECASE)
"""A distance that is not 0, without a decimal point. A comment may match too, which does no
harm.
"""


class PlainLines:
    """Executes runs of plain lines in place of an interpreter."""

    def __init__(self, interpreter: Interpreter, machine: LineMachine) -> None:
        self._interpreter = interpreter
        self._machine = machine
        self._searched: tuple[Window | None, range, int] = (None, range(0), 0)

    def leaves(self, window: Window, index: int) -> bool:
        """Return whether compiled code does not know a word of a line, in whatever mode."""
        return self._machine.leaves(*window.line_words(index))

    def run(self, window: Window, index: int) -> int:
        """Execute consecutive plain lines.

        Stops before a line that needs the interpreter. Does nothing while a mode is in effect that
        the compiled code does not support.

        Args:
            window: The text.
            index: The first line.

        Returns:
            The number of lines executed.
        """
        interpreter = self._interpreter
        if not self._machine.ready():
            return 0
        end = index + int(window.simple[index])
        if window.language == KLARTEXT:
            # The block behind the last move may be its corner, and may need its direction.
            end -= 1
        if interpreter.points_wanted:
            end = self._without_point(window, index, end)
        job = self._machine.begin(min(MOST_ROWS, ROWS_OF_LINE * (end - index)))
        first, words = window.sorted.lines.first, window.sorted.words
        setup, state, position, rows, _ = job
        count = int(
            execute_lines(
                first, words, index, end, window.first + index, setup, state, position, rows
            )
        )
        if first[index + count] > first[index]:
            interpreter.begun = True
            last = int(first[index : index + count].searchsorted(first[index + count])) - 1
            interpreter.here.line = window.first + index + last
        if count:
            self._machine.finish(job)
        return count

    def _without_point(self, window: Window, index: int, end: int) -> int:
        """Return the first line with a distance without a decimal point; ``end`` for none.

        The last search is kept: if many runs are short, each would search the rest of the window.
        """
        where, lines, found = self._searched
        if where is not window or index not in lines or end > lines.stop or found < index:
            found = window.find(WITHOUT_POINT, index, end)
            self._searched = window, range(index, end), found
        return min(found, end)
