"""Reading of a program, any number of times: text to canonical blocks, with the saved state."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cnc.gcode import dialects
from cnc.gcode.dialects.assumed_reading import AssumedReading, assumed_reading
from cnc.gcode.dialects.recognition import (
    Recognition,
    lathe_dialect,
    recognise,
    refuse,
    refuse_lathe,
)
from cnc.gcode.program.call_stack import Limits
from cnc.gcode.program.program import ProgramOptions, interpret
from cnc.gcode.state.reading_policy import STRICT, ReadingPolicy
from cnc.gcode.state.tool_table import ToolTable
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.source_text import Text
from cnc.machine.models import Machine
from cnc.model.blocks import Block, BoardCommand
from cnc.model.choices import DialectName
from cnc.model.diagnostics import Diagnostic
from cnc.model.shown_text import printable
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.path.due_times import DueTimes
from cnc.planner.joints import Joints, ToolTipOf
from cnc.planner.motion_time import motion_time
from cnc.session.call_lines import line_of_call, unanswered_line
from cnc.session.resume import RestartPoint
from cnc.session.saved_state import SavedState, subroutine_folders
from cnc.session.source import WITHOUT_FILE

if TYPE_CHECKING:
    from cnc.session.height_map import ProgramWarp

log = logging.getLogger(__name__)

Floats = NDArray[np.float64]
InterpreterState = tuple[Parameters, ToolTable]


def start_position(machine: Machine) -> Floats:
    """Return the assumed position before a program, (axes,) mm.

    It is that of the machine file, else machine zero, or the nearest point of the travel. Where the
    joints do not reach it, it is the zero of the joints, or the nearest point of their travel.

    Raises:
        MachineFileError: ``start-out-of-reach`` if no joints lead to the place of the machine file.
    """
    start = _start_of(machine)
    if not machine.kinematics.joints:
        return start
    joints = Joints(machine)
    if machine.start.keys() & set(machine.kinematics.joints):
        return joints.tip_of_start(_start_of(joints.machine))
    if machine.start.keys() & set(machine.kinematics.axes) or joints.reach(start):
        return start
    return joints.tip(_start_of(joints.machine))


def _start_of(machine: Machine) -> Floats:
    """Return the start of the axes (axes,): given, else zero or the nearest point of the travel."""
    return np.array(
        [
            machine.start.get(
                letter,
                0.0 if axis.travel is None else min(max(0.0, axis.travel[0]), axis.travel[1]),
            )
            for letter, axis in machine.axes.items()
        ]
    )


@dataclass(slots=True)
class ProgramReader:
    """A program and all data that determine its meaning.

    Attributes:
        name: Name of the program in messages.
        path: File with the text.
        machine: The machine.
        dialect: How to read the program; ``auto`` recognises its controller.
        start: Position of the machine before the program (axes,), mm.
        saved: Parameters and tools before the program.
        on_line: Called with the number of lines executed so far, in each reading.
        policy: Choices of the user.
        block_delete: Switches of block delete that are on.
        warp: Warps the blocks to a height map; None without one.
        restart: Where to begin; None for the first line.
        recognition: The language that was recognised; None before the first reading.
        evidence: The evidence of the first lines; None before it was searched.
        homed: Position after a homing command of the program (axes,), mm; None if it is not known.
        ceiling: Highest position of Z that keeps clear of its limit switch, mm; None without one.
        state: Parameters and tools as the latest reading leaves them.
        first_lines: What the first lines leave open; None before the first reading.
        due_times: Receives the times of the blocks under G93 in each path; None for no record.
    """

    name: str
    path: Path
    machine: Machine
    dialect: DialectName
    start: Floats
    saved: SavedState
    on_line: Callable[[int], None]
    policy: ReadingPolicy = STRICT
    block_delete: frozenset[int] = frozenset()
    warp: ProgramWarp | None = None
    restart: RestartPoint | None = None
    recognition: Recognition | None = None
    evidence: Recognition | None = None
    homed: tuple[float, ...] | None = None
    ceiling: float | None = None
    state: InterpreterState | None = None
    first_lines: AssumedReading | None = None
    due_times: DueTimes | None = None

    def blocks(
        self,
        warn: Callable[[Diagnostic], None] | None = None,
        on_line: Callable[[int], None] | None = None,
    ) -> Iterator[Block]:
        """Yield the canonical blocks from the start line on.

        Args:
            warn: Called with each warning and note.
            on_line: Called in place of the attribute of this name.
        """
        rules = self.rules()
        self.state = self._saved_state(rules)
        text = Text.of_file(self.path, self.name)
        self.first_lines = assumed_reading(
            list(text.first_lines()), rules, self.name, self.recognition
        )
        if warn is not None and self.first_lines.doubt is not None:
            warn(self.first_lines.doubt)
        blocks = self._interpreted(
            rules,
            text,
            self.state,
            warn,
            on_line,
            mark_calls=self.restart is not None,
        )
        if self.restart is not None:
            blocks = self.restart.passed(blocks, self.start)
        if self.warp is None:
            return blocks
        return self.warp.blocks(blocks, self.machine, self.start, self.ceiling)

    def simulated_blocks(self) -> Iterator[Block]:
        """Yield the canonical blocks of the whole program with its tool offsets.

        They are not warped: a simulated stock is flat, and a warped part is cut like a flat one.
        The state that a reading leaves (:attr:`state`) is not touched.
        """
        rules = self.rules()
        text, state = Text.of_file(self.path, self.name), self._saved_state(rules)
        return self._interpreted(rules, text, state, mark_tool_offsets=True)

    def rules(self) -> dialects.Dialect:
        """Return the dialect of the program; under ``auto`` the one that is recognised.

        Raises:
            GcodeError: The program is in a language that is not read, or for another machine.
        """
        is_lathe = self.machine.kind == "lathe"
        system = self.machine.program.g_code_system if is_lathe else None
        if self.dialect != "auto":
            if self.dialect in (*dialects.LATHES, "siemens") and not is_lathe:
                refuse_lathe(self._evidence(), self.machine.kind, self.name)
            return dialects.load(self.dialect, lathe=system)
        if self.recognition is None:
            self.recognition = self._evidence()
            log.info("%s is read as %s", printable(self.name), self.recognition.described())
        refuse(self.recognition, self.machine.kind, self.name)
        if is_lathe:
            name = lathe_dialect(self.recognition, self.name)
            self.recognition = self.recognition._replace(dialect=name)
        return dialects.load(self.recognition.dialect, lenient=True, lathe=system)

    def _evidence(self) -> Recognition:
        """Search the first lines for evidence of a controller and of a lathe, once."""
        if self.evidence is None:
            lines = Text.of_file(self.path, self.name).first_lines()
            self.evidence = recognise(lines, self.dialect, self.name)
        return self.evidence

    @property
    def dialect_in_use(self) -> DialectName:
        """The dialect that was recognised, or the one that was asked for."""
        return self.dialect if self.recognition is None else self.recognition.dialect

    @property
    def assumed(self) -> str:
        """What the reading of the program assumes from its start on; empty for nothing."""
        assumed = []
        if self.machine.kind == "lathe":
            assumed.append(self._assumed_on_lathe())
        if self.first_lines is not None:
            assumed += self.first_lines.described()
        if self.policy.default_feed is not None:
            assumed.append(f"a feed of {self.policy.default_feed:g} mm/min before the first F")
        return "; ".join(assumed)

    def _assumed_on_lathe(self) -> str:
        """Return how a program is read on a lathe at its start."""
        name = self.dialect_in_use
        stated = self.machine.diameters
        diameters = dialects.load(name, lathe="A").diameters if stated is None else stated
        read = f"X in {'diameters' if diameters else 'radii'}"
        if name in dialects.LATHES:
            system = self.machine.program.g_code_system
            return (
                f"lathe, G-code system {system}; {read}; at the start G18 and feed per "
                "revolution; offsets of T words act with the next move; threads without a chamfer"
            )
        plane = " and G18" if name == "siemens" else ""
        return f"lathe: at the start {read}{plane}"

    def blocks_in_dialect(self, dialect: str, text: Text) -> Iterator[Block]:
        """Yield the canonical blocks of a text in another dialect, without a change of state."""
        rules = self.rules() if dialect == "auto" else dialects.load(dialect)
        return self._interpreted(rules, text, self._saved_state(rules))

    def path_of(self, blocks: Iterable[Block]) -> Iterator[PathChunk | Block]:
        """Yield the path of blocks, and the blocks that do not move.

        Behind the columns of the axes are those of the joints, where the joints are not the axes.
        """
        if self.due_times is not None:
            self.due_times.clear()
        joints = Joints(self.machine)
        path = build(
            blocks,
            axes=self.machine.axis_names,
            start=self.start,
            tolerance=self.machine.path.tolerance,
            due_times=self.due_times,
            short_legs=joints.short_legs,
            duration=motion_time(self.machine),
        )
        return joints.path(path, self.start)

    def begin_at(self, line: int | None) -> None:
        """Begin at a source line, or at the first for None.

        Raises:
            UsageError, GcodeError: If the program cannot begin there.
        """
        if line is None:
            return
        z = self.machine.axes.get("z")
        top = None if z is None or z.travel is None else z.travel[1]
        if self.ceiling is not None:
            top = self.ceiling if top is None else min(top, self.ceiling)
        laser = self.machine.kind == "laser"
        restart = RestartPoint(line, self.name, self.machine.axis_names, top, laser=laser)
        restart.check(self._marked_blocks, self.start)
        self.restart = restart

    def line_to_continue_at(self, line: int) -> int:
        """Return the line of the main program at which a run that reached ``line`` can continue.

        It is the call of the subprogram that the line lies in, or the line itself. Where a probe or
        an input before it decides how the program continues, it is the line of that: the next run
        does not know the answer.
        """
        line = line_of_call(self._marked_blocks(self.start), self.name, line) or line
        return unanswered_line(self._marked_blocks(self.start), self.name, line) or line

    def _marked_blocks(self, start: Floats) -> Iterator[Block]:
        """Yield the blocks from a start position, with marks at subprogram calls."""
        text = Text.of_file(self.path, self.name)
        rules = self.rules()
        state = self._saved_state(rules)
        return self._interpreted(rules, text, state, start=start, mark_calls=True)

    def _saved_state(self, rules: dialects.Dialect) -> InterpreterState:
        macro = rules.flavour == "macro-b"
        return self.saved.parameters(macro=macro), self.saved.tools()

    def _interpreted(
        self,
        rules: dialects.Dialect,
        text: Text,
        state: InterpreterState,
        warn: Callable[[Diagnostic], None] | None = None,
        on_line: Callable[[int], None] | None = None,
        start: Floats | None = None,
        *,
        mark_calls: bool = False,
        mark_tool_offsets: bool = False,
    ) -> Iterator[Block]:
        program = self.machine.program
        file = None if self.name in WITHOUT_FILE else Path(self.name)
        blocks = interpret(
            text,
            axes=self.machine.axis_names,
            dialect=rules,
            start=self.start if start is None else start,
            warn=warn,
            parameters=state[0],
            tools=state[1],
            options=ProgramOptions(
                folders=subroutine_folders(file, self.machine),
                limits=Limits(program.max_repeated_lines, program.max_call_depth),
                on_line=on_line or self.on_line,
                mark_calls=mark_calls,
                policy=self.policy,
                block_delete=self.block_delete,
                laser=self.machine.kind == "laser",
                lathe=self.machine.kind == "lathe",
                diameters=self.machine.diameters,
                mark_tool_offsets=mark_tool_offsets,
                wraps={
                    letter: axis.wrap
                    for letter, axis in self.machine.axes.items()
                    if axis.wrap is not None
                },
                tool_tip=ToolTipOf.machine(self.machine),
            ),
        )
        return blocks if self.homed is None else self._with_homed_position(blocks)

    def _with_homed_position(self, blocks: Iterator[Block]) -> Iterator[Block]:
        """Yield the blocks; a command that homes has its answer, until the board gives another."""
        for block in blocks:
            if isinstance(block, BoardCommand) and block.homes:
                block.answer.values = self.homed
            yield block
