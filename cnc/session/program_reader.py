"""Reading a program, as often as need be: text to canonical blocks, with what the machine
remembers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.gcode import dialects
from cnc.gcode.program.call_stack import Limits
from cnc.gcode.program.program import ProgramOptions, interpret
from cnc.gcode.state.tool_table import ToolTable
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.source_text import Text
from cnc.machine.models import DialectName, Machine
from cnc.model.blocks import Block
from cnc.model.diagnostics import Diagnostic
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.session.resume import Beginning, line_of_call
from cnc.session.saved_state import Memory, folders
from cnc.session.source import STANDARD_INPUT_NAME

Floats = NDArray[np.float64]
State = tuple[Parameters, ToolTable]


def start_position(machine: Machine) -> Floats:
    """Where a program is taken to begin, (axes,) mm: machine zero, or the nearest point of the
    travel to it.
    """
    return np.array(
        [
            0.0 if axis.travel is None else min(max(0.0, axis.travel[0]), axis.travel[1])
            for axis in machine.axes.values()
        ]
    )


@dataclass(slots=True)
class Reading:
    """A program and all that its meaning depends on.

    name: as it is shown. path: where the text is. start (axes,): where the machine stands, mm.
    on_line: called with the number of lines carried out, by every reading. beginning: where to
    begin, None for the first line. state: what the latest reading has made of the parameters and
    tools.
    """

    name: str
    path: Path
    machine: Machine
    dialect: DialectName
    start: Floats
    memory: Memory
    on_line: Callable[[int], None]
    beginning: Beginning | None = None
    state: State | None = None

    def blocks(
        self,
        warn: Callable[[Diagnostic], None] | None = None,
        on_line: Callable[[int], None] | None = None,
    ) -> Iterator[Block]:
        """The canonical blocks; ``on_line`` in place of the usual one."""
        self.state = self._remembered(self.dialect)
        marked = self.beginning is not None
        blocks = self._interpreted(
            self.dialect,
            Text.of_file(self.path, self.name),
            self.state,
            warn,
            on_line,
            mark_calls=marked,
        )
        return blocks if self.beginning is None else self.beginning.passed(blocks, self.start)

    def under(self, dialect: str, text: Text) -> Iterator[Block]:
        """The canonical blocks of a text under another dialect, which nothing remembers."""
        return self._interpreted(dialect, text, self._remembered(dialect))

    def route(self, blocks: Iterable[Block]) -> Iterator[PathChunk | Block]:
        """The path of these blocks."""
        return build(
            blocks,
            axes=self.machine.axis_names,
            start=self.start,
            tolerance=self.machine.path.tolerance,
        )

    def begin_at(self, line: int | None) -> None:
        """Where to begin, if not at the first line. UsageError, GcodeError where that can't be."""
        if line is None:
            return
        z = self.machine.axes.get("z")
        top = None if z is None or z.travel is None else z.travel[1]
        beginning = Beginning(line, self.name, self.machine.axis_names, top)

        def read(start: Floats) -> Iterator[Block]:
            text = Text.of_file(self.path, self.name)
            return self._interpreted(
                self.dialect, text, self._remembered(self.dialect), start=start, mark_calls=True
            )

        beginning.check(read, self.start)
        self.beginning = beginning

    def place_to_begin(self, line: int) -> int:
        """The line of the main program for a line to go on at: where it calls the subprogram that
        this lies in, or the line itself.
        """
        text = Text.of_file(self.path, self.name)
        blocks = self._interpreted(
            self.dialect, text, self._remembered(self.dialect), mark_calls=True
        )
        return line_of_call(blocks, self.name, line) or line

    def _remembered(self, dialect: str) -> State:
        return self.memory.parameters(
            macro=dialects.load(dialect).flavour == "macro-b"
        ), self.memory.tools()

    def _interpreted(
        self,
        dialect: str,
        text: Text,
        state: State,
        warn: Callable[[Diagnostic], None] | None = None,
        on_line: Callable[[int], None] | None = None,
        start: Floats | None = None,
        *,
        mark_calls: bool = False,
    ) -> Iterator[Block]:
        program = self.machine.program
        place = None if self.name == STANDARD_INPUT_NAME else Path(self.name)
        return interpret(
            text,
            axes=self.machine.axis_names,
            dialect=dialect,
            start=self.start if start is None else start,
            warn=warn,
            parameters=state[0],
            tools=state[1],
            options=ProgramOptions(
                folders=folders(place, self.machine),
                limits=Limits(program.max_repeated_lines, program.max_call_depth),
                on_line=on_line or self.on_line,
                mark_calls=mark_calls,
            ),
        )
