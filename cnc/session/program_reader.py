"""Reading of a program, any number of times: text to canonical blocks, with the saved state."""

from __future__ import annotations

import logging
import math
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cnc.gcode import dialects
from cnc.gcode.core.call_stack import Limits
from cnc.gcode.core.line_trace import LineTrace
from cnc.gcode.core.modal_groups import STRICT, ReadingPolicy
from cnc.gcode.core.program import DEFAULTS, ProgramOptions, interpret
from cnc.gcode.core.tool_table import ToolTable
from cnc.gcode.dialects.recognition import (
    AssumedReading,
    Recognition,
    assumed_reading,
    lathe_dialect,
    recognise,
    refuse,
    refuse_lathe,
)
from cnc.gcode.reader.parameters import Parameters, read_parameters, write_parameters
from cnc.gcode.reader.source_text import Text
from cnc.machine.models import Machine
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import AXIS_LETTERS, Block, BoardCommand
from cnc.model.choices import DialectName
from cnc.model.diagnostics import CncError, Diagnostic, GcodeError, UsageError, printable
from cnc.path.build import DueTimes
from cnc.planner.joints import Joints, ToolTipOf
from cnc.report.result import WarpedBy
from cnc.session.checkpoint import file_hash
from cnc.session.resume import (
    PausePlace,
    RestartPoint,
    at_pause,
    line_of_call,
    unanswered_line,
)

if TYPE_CHECKING:
    from cnc.path.warp import Warp

# The file that a program is read from, and the source lines that messages show.

STANDARD_INPUT = "-"
STANDARD_INPUT_NAME = "<stdin>"
"""Name of standard input in messages."""
MDI_NAME = "MDI"
"""Name of a line that the operator has entered, in messages."""
TEXT_NAME = "<text>"
"""Name of a text that is given in place of a file, in messages."""
WITHOUT_FILE = (STANDARD_INPUT_NAME, MDI_NAME, TEXT_NAME)
"""Names of programs that have no file: no checkpoint, and no folder of subroutines."""
COPIED_BYTES = 4_000_000
"""A longer file is copied before it is read, so that the checked program is the one that runs.

The text of a shorter file stays in memory between the passes.
"""


@dataclass(frozen=True, slots=True)
class InlineProgram:
    """A program together with its text, for a computer that does not have the file."""

    name: str
    text: bytes

    def __str__(self) -> str:
        return self.name


Source = Path | str | InlineProgram
"""A program's file, ``-`` for standard input, or the program itself."""


def display_name(program: Source) -> str:
    """Return the name of the program in messages."""
    return STANDARD_INPUT_NAME if str(program) == STANDARD_INPUT else str(program)


@contextmanager
def readable_file(program: Source) -> Iterator[Path]:
    """Provide a file that can be read twice and does not change between the passes.

    Standard input (``-``), pipes and long files are copied to the system's temporary folder.

    Raises:
        UsageError: ``no-such-file``, ``is-a-folder``, ``can-not-read``.
    """
    path = Path(str(program))
    with ExitStack() as stack:
        try:
            if isinstance(program, InlineProgram):
                path = _copy(BytesIO(program.text), stack)
            elif str(program) == STANDARD_INPUT:
                path = _copy(sys.stdin.buffer, stack)
            elif path.is_dir():
                hint = "name a program file; cncrun check accepts folders"
                raise UsageError(Diagnostic("is-a-folder", f"{program} is a folder", hint=hint))
            elif not path.is_file() or path.stat().st_size > COPIED_BYTES:
                path = _copy(stack.enter_context(path.open("rb")), stack)
        except FileNotFoundError as error:
            hint = "check the name and the folder"
            raise UsageError(
                Diagnostic("no-such-file", f"there is no file {program}", hint=hint)
            ) from error
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            raise UsageError(
                Diagnostic("can-not-read", f"{program} cannot be read: {reason}")
            ) from error
        yield path


def _copy(source: IO[bytes], stack: ExitStack) -> Path:
    """Copy to a temporary file that is removed when ``stack`` closes."""
    copy = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="cnc-"))) / "program.nc"
    with copy.open("wb") as target:
        shutil.copyfileobj(source, target)
    return copy


def with_source_lines(faults: Sequence[CncError], paths: Mapping[str, Path]) -> list[CncError]:
    """Add the source line, and the column of the word concerned, to faults that lack them.

    Args:
        faults: The faults, in order.
        paths: Files whose name in messages is not their path.

    Returns:
        The faults in the same order.
    """
    texts: dict[str, Text] = {}
    completed: list[CncError] = []
    for fault in faults:
        finding = fault.diagnostic
        path = paths.get(finding.file, Path(finding.file))
        if finding.line and not finding.text and path.is_file():
            text = texts.setdefault(finding.file, Text.of_file(path))
            window = text.window(finding.line)
            if window:
                fault = _with_source_line(fault, window.text(finding.line - window.first))
        completed.append(fault)
    return completed


def _with_source_line(fault: CncError, text: str) -> CncError:
    finding = fault.diagnostic
    code = re.sub(r"\([^()]*\)|;.*", lambda comment: " " * len(comment[0]), text)
    if finding.text or not code.strip():
        return fault
    axis = re.match(r"[A-Z](?= would reach )", finding.message)
    letter = axis[0] if axis else "F" if finding.code == "feed-unreachable" else ""
    word = (letter and re.search(rf"{letter}\s*[-+]?[\d.]+", code, re.IGNORECASE)) or re.search(
        r"\S(?:.*\S)?", code
    )
    column, length = finding.column, finding.length
    if word and not column:
        column, length = word.start() + 1, len(word[0])
    return type(fault)(replace(finding, text=text, column=column, length=length))


# State that a machine keeps between programs: the parameters and the tool table.


class SavedState:
    """Parameters and tools before a program, for each reading of it.

    A parameter file that does not exist yet is read as an empty one.

    Raises:
        MachineFileError, UsageError: If a file cannot be read.
    """

    def __init__(self, machine: Machine) -> None:
        program = machine.program
        self._parameter_file, self._tool_file = program.parameters, program.tool_table
        file = self._parameter_file
        self._values = read_parameters(file) if file is not None and file.exists() else {}
        self._tools = ToolTable() if self._tool_file is None else ToolTable.load(self._tool_file)

    def adopt(self, values: Mapping[int, float]) -> None:
        """Replace parameters by the values that a board keeps itself."""
        self._values = {**self._values, **values}

    @property
    def given(self) -> Mapping[int, float]:
        """Parameters that the file or the board has given, by number."""
        return self._values

    def parameters(self, *, macro: bool) -> Parameters:
        """Return the parameters for one reading; ``macro``: with the ranges of FANUC's macros."""
        return Parameters(self._values, macro=macro)

    def tools(self) -> ToolTable:
        """Return the tools for one reading."""
        return ToolTable(self._tools, file=self._tools.file)

    def save(self, parameters: Parameters, tools: ToolTable) -> None:
        """Write the state after a program that ran to its end. UsageError ``can-not-write``."""
        if self._parameter_file is not None:
            write_parameters(self._parameter_file, parameters.stored())
        if self._tool_file is not None and tools.changed:
            tools.save(self._tool_file)


def subroutine_folders(program: Path | None, machine: Machine) -> Sequence[Path]:
    """Return the folders in which subroutine files are searched for, in order.

    The folder of the program comes first (``program`` None: it has no folder), then those of the
    machine file.
    """
    own = [] if program is None else [program.absolute().parent]
    return [*own, *machine.program.subroutines]


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
    _origin: Floats | None = None
    """Position by which the program is read (axes,), mm; None for the start."""

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
            self._origin,
            marks=ProgramOptions(mark_calls=self.restart is not None),
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
        return self._interpreted(rules, text, state, marks=ProgramOptions(mark_tool_offsets=True))

    def traced_blocks(
        self, trace: LineTrace, warn: Callable[[Diagnostic], None] | None = None
    ) -> Iterator[Block]:
        """Yield the canonical blocks of the whole program with a mark behind each line."""
        rules = self.rules()
        self.state = self._saved_state(rules)
        text = Text.of_file(self.path, self.name)
        return self._interpreted(rules, text, self.state, warn, marks=ProgramOptions(trace=trace))

    def rules(self) -> dialects.Dialect:
        """Return the dialect of the program; under ``auto`` the one that is recognised.

        Raises:
            GcodeError: The program is in a language that is not read, or for another machine.
        """
        is_lathe = self.machine.kind == "lathe"
        system = self.machine.program.g_code_system if is_lathe else None
        counted = self.machine.program.least_increments
        if self.dialect != "auto":
            if (
                self.dialect == "siemens" or dialects.has_lathe_language(self.dialect)
            ) and not is_lathe:
                refuse_lathe(self._evidence(), self.machine.kind, self.name)
            return dialects.load(self.dialect, lathe=system, least_increments=counted)
        if self.recognition is None:
            self.recognition = self._evidence()
            log.info("%s is read as %s", printable(self.name), self.recognition.described())
        refuse(self.recognition, self.machine.kind, self.name)
        if is_lathe:
            name = lathe_dialect(self.recognition, self.name)
            self.recognition = self.recognition._replace(dialect=name)
        return dialects.load(
            self.recognition.dialect, lenient=True, lathe=system, least_increments=counted
        )

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
        diameters = dialects.load(name, lathe="A").turning.diameters if stated is None else stated
        read = f"X in {'diameters' if diameters else 'radii'}"
        if dialects.has_lathe_language(name):
            program = self.machine.program
            counted = "; lengths without a point in least increments"
            return (
                f"lathe, G-code system {program.g_code_system}; {read}; at the start G18 and feed "
                "per revolution; offsets of T words act with the next move; threads without a "
                f"chamfer{counted if program.least_increments else ''}"
            )
        plane = " and G18" if name == "siemens" else ""
        return f"lathe: at the start {read}{plane}"

    def blocks_in_dialect(self, dialect: str, text: Text) -> Iterator[Block]:
        """Yield the canonical blocks of a text in another dialect, without a change of state."""
        rules = self.rules() if dialect == "auto" else dialects.load(dialect)
        return self._interpreted(rules, text, self._saved_state(rules))

    def begin_at(self, line: int | None, after: PausePlace | None = None) -> None:
        """Begin at a source line, or at the first for None; or go on after a pause.

        Raises:
            UsageError, GcodeError: If the program cannot begin there.
        """
        if after is not None:
            self._go_on_after(after)
            return
        if line is None:
            return
        restart = self._restart_point(line, None)
        restart.check(self._marked_blocks, self.start)
        self.restart = restart

    def _go_on_after(self, pause: PausePlace) -> None:
        """Go on after a pause at which another run has ended.

        An axis that the program has not moved before the pause is where it stands, but Z is not
        lower than at the pause.

        Raises:
            GcodeError: ``from-line-unknown`` if the program has changed.
        """
        if file_hash(self.path) != pause.sha256:
            message, hint = "the program has changed since its pause", "stop it, and start it again"
            raise GcodeError(Diagnostic("from-line-unknown", message, self.name, hint=hint))
        if pause.height is None and (z := self._column_of_z) is not None:
            start = pause.start.copy()
            start[z] = max(start[z], self.start[z])
            pause = replace(pause, start=start)
        self.restart = self._restart_point(pause.line, pause)
        self._origin = pause.start

    def place_of_pause(self, number: int, line: int) -> PausePlace:
        """Return the place of the pause at which a run waits, so that another one goes on there.

        Args:
            number: Pauses that this run has reached.
            line: Line of the pause.

        Raises:
            GcodeError: ``from-line-unknown`` if no run can go on there.
        """
        if self.restart is not None:
            number += self.restart.pauses
        state, z = self._saved_state(self.rules()), self._column_of_z
        zeros = _zeros_in(state)
        start = self.start if self._origin is None else self._origin
        text, marks = Text.of_file(self.path, self.name), ProgramOptions(mark_calls=True)
        blocks = self._interpreted(self.rules(), text, state, start=start, marks=marks)
        skipped, block = at_pause(blocks, number, start, z)
        if block.line != line:
            message = f"the pause of line {line} is not the one that was reached"
            raise GcodeError(Diagnostic("from-line-unknown", message, self.name, line))
        height = None
        if z is not None and skipped.touched[z]:
            height, top = float(skipped.highest[z]), self._top_of_z
            height = height if top is None else min(height, top)
        changed = state[1].changed or _zeros_in(state) != zeros
        return PausePlace(number, block.file, line, start, height, changed, file_hash(self.path))

    def _restart_point(self, line: int, pause: PausePlace | None) -> RestartPoint:
        names, laser = self.machine.axis_names, self.machine.kind == "laser"
        return RestartPoint(line, self.name, names, self._top_of_z, laser=laser, pause=pause)

    @property
    def _column_of_z(self) -> int | None:
        names = self.machine.axis_names
        return names.index("z") if "z" in names else None

    @property
    def _top_of_z(self) -> float | None:
        """Highest machine position of Z, mm; None if it is not known."""
        z = self.machine.axes.get("z")
        top = None if z is None or z.travel is None else z.travel[1]
        if self.ceiling is None:
            return top
        return self.ceiling if top is None else min(top, self.ceiling)

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
        return self._interpreted(
            rules, text, state, start=start, marks=ProgramOptions(mark_calls=True)
        )

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
        marks: ProgramOptions = DEFAULTS,
    ) -> Iterator[Block]:
        """Interpret a text. The other options are those of the program; ``marks`` has the marks."""
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
            options=replace(
                marks,
                folders=subroutine_folders(file, self.machine),
                limits=Limits(program.max_repeated_lines, program.max_call_depth),
                on_line=on_line or self.on_line,
                policy=self.policy,
                block_delete=self.block_delete,
                laser=self.machine.kind == "laser",
                lathe=self.machine.kind == "lathe",
                diameters=self.machine.diameters,
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


def _zeros_in(state: InterpreterState) -> dict[int, float]:
    """Return the offsets of the coordinate systems by number."""
    last = numbers.G54_1_ORIGIN + numbers.SYSTEM_STEP * numbers.MOST_G54_1_SYSTEMS
    ranges = range(numbers.EXTERNAL_OFFSET, numbers.INPUT_VALUE), range(numbers.G54_1_ORIGIN, last)
    return {
        number: value
        for number, value in state[0].values.items()
        if number != numbers.CURRENT_SYSTEM and any(number in part for part in ranges)
    }


# The height map of a session: its file, the warp of each reading, and its use in the report.

MOVED = 0.003
"""Smallest distance of a work zero that was moved, mm: boards report three decimals."""


class ProgramWarp:
    """Warps each reading of a program to the surface of a height map.

    Args:
        file: The height map.
        machine: The machine.

    Raises:
        UsageError: ``height-map-file``, ``height-map-machine``, ``height-map-gap``.
    """

    def __init__(self, file: str, machine: Machine) -> None:
        from cnc.path import warp  # most programs have no map

        self._file, self._map = file, warp.map_for(machine, file)
        surface = warp.Surface.of(self._map)
        self._begin = partial(warp.Warp, surface, tolerance=self._map.tolerance)
        self._warp: Warp | None = None

    def blocks(
        self,
        blocks: Iterable[Block],
        machine: Machine,
        start: NDArray[np.float64],
        ceiling: float | None,
    ) -> Iterator[Block]:
        """Return the warped blocks of a reading.

        Args:
            blocks: The blocks of the program.
            machine: The machine, with the travel of the board.
            start: Position of the machine before the program (axes,), mm.
            ceiling: Highest position of Z that keeps clear of its limit switch, mm; None without.
        """
        travel = machine.axes["z"].travel
        tops = [*([] if travel is None else [travel[1]]), *([] if ceiling is None else [ceiling])]
        self._warp = self._begin(
            machine.axis_names,
            blend=machine.path.tolerance,
            top=min(tops, default=math.inf),
        )
        return self._warp.blocks(blocks, start)

    def moved_zero(self, parameters: Mapping[int, float]) -> list[Diagnostic]:
        """Return the warning ``height-map-zero`` if the work zero was moved after the probing.

        Args:
            parameters: Those before the program, by number; one that is missing is 0.
        """
        surface = self._map
        if surface.system not in numbers.SYSTEMS:
            return []
        origin = numbers.origin(numbers.SYSTEMS.index(surface.system))
        is_shifted = parameters.get(numbers.SHIFT_IN_EFFECT) == 1.0
        moved = []
        for column, letter in enumerate(AXIS_LETTERS[:3]):
            zero = parameters.get(origin + column, 0.0)
            if is_shifted:
                zero += parameters.get(numbers.SHIFT + column, 0.0)
            distance = zero - surface.work_zero.get(letter, zero)
            if abs(distance) > MOVED:
                moved.append(f"{letter.upper()} by {distance:.3f} mm")
        if not moved:
            return []
        message = f"the zero of {surface.system} was moved after the probing: {', '.join(moved)}"
        hint = (
            "the map stays at its place on the table, and its heights count from Z zero; "
            "probe again if the part was moved"
        )
        return [Diagnostic("height-map-zero", message, hint=hint, severity="warning")]

    def used(self) -> WarpedBy:
        """Return the use of the map by the latest reading."""
        surface = self._map
        low, high = surface.extremes
        return WarpedBy(
            file=self._file,
            columns=len(surface.x),
            rows=len(surface.y),
            lowest_mm=low,
            highest_mm=high,
            interpolation=surface.interpolation,
            tolerance_mm=surface.tolerance,
            pieces=0 if self._warp is None else self._warp.pieces,
        )
