"""A program as lines for a GRBL board: to a file (``--lines``), and the time that they take.

    blocks ──► exact path ──► Translator ──► lines ──► file
                                               `─────► BoardTime

The board plans the motion. A command that it does not support ends the translation with a
GcodeError at its line, before anything has moved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cnc.grbl_lines.board_limits import BoardLimits
from cnc.grbl_lines.grbl_timing import BoardTime
from cnc.grbl_lines.number_format import board_axes
from cnc.grbl_lines.writer import LoweredFeeds
from cnc.machine.models import Machine
from cnc.model.blocks import AXIS_LETTERS, AxisLetter, Block
from cnc.model.parameter_numbers import G54_ORIGIN
from cnc.model.streams import GcodeLine
from cnc.path.build import exact_path


@dataclass(slots=True)
class LineProgram:
    """A program that is translated for any machine of a kind.

    Attributes:
        machine: The machine file.
        start: Position of the machine before the program (axes,), mm.
        parameters: Parameters with which the program is read; lines are relative to their G54.
        extent: Lowest and highest coordinate of each axis in the program, mm.
        lowered: Feeds that the lines lower, once they have been made.
    """

    machine: Machine
    start: NDArray[np.float64]
    parameters: Mapping[int, float]
    extent: Mapping[str, tuple[float, float]]
    lowered: LoweredFeeds = field(default_factory=LoweredFeeds)

    def lines(self, blocks: Iterable[Block]) -> Iterator[GcodeLine]:
        """Yield the lines of a whole program."""
        machine = self.machine
        moving = "".join(
            letter
            for letter in self._letters
            if letter in self.extent and self.extent[letter][0] < self.extent[letter][1]
        )
        from cnc.grbl_lines.translator import Translator  # a check does not need it

        translator = Translator(machine, work_offset=self.work_offset, moving=moving)
        self.lowered = translator.lowered
        for item in exact_path(blocks, axes=machine.axis_names, start=self.start):
            yield from translator.lines(item)
        yield from translator.end()

    @property
    def work_offset(self) -> list[float]:
        """Origin of G54 for each axis of the board, mm."""
        return [
            self.parameters.get(G54_ORIGIN + AXIS_LETTERS.index(letter), 0.0)
            for letter in self._letters
        ]

    @property
    def _letters(self) -> tuple[AxisLetter, ...]:
        return board_axes(self.machine.axes)

    def write(self, blocks: Iterable[Block], write: Callable[[str], None] | None) -> BoardTime:
        """Write the lines and return their time.

        Args:
            blocks: The program.
            write: Takes text; None to compute the time only.
        """
        places = dict(zip(self.machine.axis_names, self.start.tolist(), strict=True))
        start = tuple(
            places.get(letter, 0.0) - offset
            for letter, offset in zip(self._letters, self.work_offset, strict=True)
        )
        clock = BoardTime(BoardLimits.of_machine(self.machine), start)
        for line in self.lines(blocks):
            clock.add(line)
            if write is not None:
                write(line.text + "\n")
        clock.end()
        return clock
