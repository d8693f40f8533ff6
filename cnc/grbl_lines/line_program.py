"""A program as lines for a board that plans for itself: to a file (``--lines``), and how long a
board takes for them.

    blocks ──► smooth path ──► plan ──► Translator ──► lines ──► file
                                                         `─────► BoardTime

The plan is one of its own: pulses follow the path exactly, lines may deviate by the tolerance, and
the board takes corners by itself. What a board has no words for ends the translation with a
GcodeError at its line, before anything has moved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.grbl_lines.grbl_timing import BoardLimits, BoardTime
from cnc.grbl_lines.number_format import LETTERS
from cnc.grbl_lines.smooth import smooth_path
from cnc.grbl_lines.translator import Translator
from cnc.machine.models import Machine
from cnc.model.blocks import AXIS_LETTERS, Block
from cnc.model.parameter_numbers import G54_ORIGIN
from cnc.model.streams import GcodeLine
from cnc.planner.lookahead import LookAhead


@dataclass(frozen=True, slots=True)
class LineProgram:
    """How a program is made lines for any machine of a kind.

    start (axes,): where the machine stands before, mm. parameters: with which the program is read;
    the lines are relative to their G54. simulator: lowest and highest coordinate that each axis comes to.
    """

    machine: Machine
    start: NDArray[np.float64]
    parameters: Mapping[int, float]
    simulator: Mapping[str, tuple[float, float]]

    def lines(self, blocks: Iterable[Block]) -> Iterator[GcodeLine]:
        """The lines of a whole program."""
        machine = self.machine
        moving = "".join(
            letter
            for letter in LETTERS.lower()
            if letter in self.simulator and self.simulator[letter][0] < self.simulator[letter][1]
        )
        translator = Translator(machine, work_offset=self.work_offset, moving=moving)
        path = smooth_path(
            blocks, axes=machine.axis_names, start=self.start, tolerance=translator.tolerance
        )
        for item in LookAhead(machine, judged=False).plan(path):
            yield from translator.lines(item)
        yield from translator.end()

    @property
    def work_offset(self) -> list[float]:
        """The origin of G54, x y z in mm."""
        return [
            self.parameters.get(G54_ORIGIN + AXIS_LETTERS.index(letter), 0.0)
            for letter in LETTERS.lower()
        ]

    def write(self, blocks: Iterable[Block], write: Callable[[str], None] | None) -> BoardTime:
        """Write the lines, if there is somewhere to write them; the time that they take a board."""
        places = dict(zip(self.machine.axis_names, self.start.tolist(), strict=True))
        x, y, z = (
            places.get(letter, 0.0) - offset
            for letter, offset in zip(LETTERS.lower(), self.work_offset, strict=True)
        )
        clock = BoardTime(BoardLimits.of_machine(self.machine), (x, y, z))
        for line in self.lines(blocks):
            clock.add(line)
            if write is not None:
                write(line.text + "\n")
        clock.end()
        return clock
