"""The interpreter's main loop: a program from its first line to its end.

The program has no tree, only a current line number. Each line becomes a step once; the step is
executed as often as the flow of control reaches the line.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.gcode import dialects
from cnc.gcode.core import line_steps
from cnc.gcode.core.block_buffer import Warn
from cnc.gcode.core.call_stack import Flow, Limits, Listing, Page, Step
from cnc.gcode.core.interpreter import Interpreter
from cnc.gcode.core.line_steps import StepMaker, leader
from cnc.gcode.core.line_trace import LineTrace
from cnc.gcode.core.modal_groups import STRICT, ReadingPolicy
from cnc.gcode.core.subprograms import Library, defined_variables
from cnc.gcode.core.tool_table import ToolTable, ToolTip
from cnc.gcode.macro_b.subprograms import report_uncalled
from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.parser import Syntax
from cnc.gcode.reader.source_text import Text
from cnc.gcode.reader.statements import Statement
from cnc.gcode.reader.words import Word
from cnc.model.blocks import Block, ToolOffset
from cnc.model.choices import WrapRule
from cnc.model.diagnostics import GcodeError

# Programs that are certain never to end, because their whole state comes back.
#
# A program without an answer of the board does the same from the same state. So a state that comes
# back at the same line comes back for ever. The states are compared by Brent's method: one state is
# kept for twice as many samples each time.

FIRST_LINES = 8192
"""Repeated lines before the first state is kept: most loops end before."""

_State = tuple[object, ...]
_Group = Iterable[Block]


class RepeatedStates:
    """Compares the states of a program at its lines, from time to time."""

    def __init__(self, flow: Flow) -> None:
        self._flow = flow
        self._line = 0
        self._kept: _State = ()
        self._samples, self._most = 0, 1

    def comes_back(self, line: int) -> bool:
        """Return whether the state before a line is one that the program had there before."""
        flow = self._flow
        if flow.executed - flow.new < FIRST_LINES or flow.interpreter.out.asked:
            return False
        if line == self._line and self._kept == self._state():
            return True
        self._samples += 1
        if self._samples >= self._most:
            self._line, self._kept = line, self._state()
            self._samples, self._most = 0, 2 * self._most
        return False

    def _state(self) -> _State:
        """Everything that decides how the program goes on."""
        flow = self._flow
        interpreter = flow.interpreter
        calls = [
            (id(frame.listing), frame.scope, id(frame.caller), frame.return_line,
             frame.rounds, dict(frame.counts))
            for frame in (*flow.frames, flow.frame)
        ]  # fmt: skip
        position, coordinates = list(interpreter.motion.position), interpreter.coordinates
        low, high = [0.0] * len(position), [1.0] * len(position)
        return (
            id(flow.listing),
            calls,
            flow.value,
            [(section.first, section.repeats_left) for section in flow.sections],
            flow.parameters.state(),
            replace(interpreter.modal),
            position,
            # Offsets, rotations and scales in effect.
            [coordinates.to_program(place) for place in (position, low, high)],
            list(interpreter.tool_codes.table),
        )


REPORT_INTERVAL = 1024
"""Executed lines between two calls of ``on_line``."""


@dataclass(frozen=True, slots=True)
class ProgramOptions:
    """Options that rarely differ from their defaults.

    Attributes:
        block_delete: Switches of block delete that are on, 1 to 9, or True for all: lines that
            begin with ``/`` (1) or ``/2`` are skipped unread.
        policy: Choices of the user.
        folders: Folders of subroutines in files. The program's own folder is not added.
        limits: Limits that end endless programs.
        on_line: Called with the number of executed lines from time to time.
        mark_calls: Put the calls of the main program among the blocks
            (:class:`cnc.model.blocks.CallBoundary`).
        lathe: The machine is a lathe.
        diameters: X is a diameter at the start on a lathe; None for the rule of the dialect.
        laser: S is the power of a laser, which changes in motion.
        mark_tool_offsets: Put the tool offsets among the blocks
            (:class:`cnc.model.blocks.ToolOffset`).
        wraps: Rule of each rotary axis that repeats after 360 degrees, by its letter.
        tool_tip: Positions of a machine with tool-tip control; None for another machine.
        trace: Puts a mark behind the blocks of each line; None for no marks.
    """

    block_delete: frozenset[int] | bool = False
    policy: ReadingPolicy = STRICT
    folders: Sequence[Path] = ()
    limits: Limits = field(default_factory=Limits)
    on_line: Callable[[int], None] | None = None
    mark_calls: bool = False
    lathe: bool = False
    diameters: bool | None = None
    laser: bool = False
    mark_tool_offsets: bool = False
    wraps: Mapping[str, WrapRule] = field(default_factory=dict)
    tool_tip: ToolTip | None = None
    trace: LineTrace | None = None


DEFAULTS = ProgramOptions()


def interpret(
    text: Text,
    *,
    axes: tuple[str, ...] = ("x", "y", "z"),
    dialect: str | dialects.Dialect = "auto",
    start: NDArray[np.float64] | None = None,
    parameters: Parameters | None = None,
    tools: ToolTable | None = None,
    warn: Warn | None = None,
    options: ProgramOptions = DEFAULTS,
) -> Iterator[Block]:
    """Yield the canonical blocks of a program while its lines are read.

    Reading stops at M2, M30 or a second ``%``.

    Args:
        text: The program. Its name stands in blocks and errors.
        axes: The machine's axes, in the order of the columns of every position.
        dialect: The dialect, or its name.
        start: (axes,) machine position at the start, mm or degrees; zeros by default.
        parameters: Parameters at the start. The program changes them.
        tools: Tool table. The program may change it.
        warn: Called with a diagnostic for each legal but unusual line.
        options: Other options.

    Raises:
        GcodeError: The first fault, with file, line, column, text and hint. The blocks of earlier
            lines may have been yielded by then.
        UsageError: ``unknown-dialect``, ``unreadable-file``.
    """
    position = [0.0] * len(axes) if start is None else [float(value) for value in start]
    rules = dialects.load(dialect) if isinstance(dialect, str) else dialect
    if parameters is None:
        parameters = Parameters(macro=rules.flavour == "macro-b")
    interpreter = Interpreter(
        text.name,
        axes,
        rules,
        position,
        parameters,
        warn,
        tools,
        replace(
            options.policy,
            lathe=options.lathe,
            diameters=options.diameters,
            laser=options.laser,
            wraps=options.wraps,
            tool_tip=options.tool_tip,
        ),
    )
    siemens = rules.flavour == "siemens"
    syntax = rules.syntax(defined_variables(text, parameters) if siemens else ())
    listing = Listing(text, syntax, block_delete=options.block_delete)
    if options.mark_tool_offsets:
        _mark_tool_offsets(interpreter)
    library = Library(options.folders, syntax, block_delete=options.block_delete)
    flow = Flow(interpreter, listing, library, options.limits, mark_calls=options.mark_calls)
    trace = options.trace
    maker = StepMaker(flow, rules, options.policy.codes, None if trace is None else trace.bulk)
    first = _behind_leader(flow, text, syntax) if _may_have_leader(rules) else 1
    yield from chain.from_iterable(_run(flow, maker, first, _Watch(flow, options.on_line), trace))


def _may_have_leader(rules: dialects.Dialect) -> bool:
    """Whether a file may hold text or programs around the program that is executed."""
    return (rules.lenient and rules.flavour != "klartext") or rules.flavour == "macro-b"


def _behind_leader(flow: Flow, text: Text, syntax: Syntax) -> int:
    """Return the first line of the program, and report a leader before it."""
    count = leader(text, syntax)
    if count:
        message = "text before the program is not read: FANUC's and Haas' controls ignore it"
        flow.interpreter.here.line = 1
        at = Word("", 0.0, "", 1, 1)
        flow.interpreter.here.report_warning("percent-leader", message, at, "remove it")
    return count + 1


def _mark_tool_offsets(interpreter: Interpreter) -> None:
    """Put a mark among the blocks at each new tool offset."""

    def mark(offset: tuple[float, ...]) -> None:
        here = interpreter.here
        interpreter.out.add(ToolOffset(here.file, here.line, offset))

    interpreter.coordinates.on_tool_offset = mark


def _run(
    flow: Flow, maker: StepMaker, first: int, watch: _Watch, trace: LineTrace | None
) -> Iterator[_Group]:
    """Execute the program from a line on, and end it. Groups of blocks are yielded."""
    ready = flow.interpreter.out.ready
    try:
        yield from _execute_lines(flow, maker, first, watch, trace)
        if _may_have_leader(flow.interpreter.dialect):
            report_uncalled(flow)
    except GcodeError:
        if flow.interpreter.aborted:
            yield from ready
        raise
    flow.unwind()
    watch.report(flow.executed)
    yield from ready
    ready.clear()


def _execute_lines(
    flow: Flow, maker: StepMaker, line: int, watch: _Watch, trace: LineTrace | None
) -> Iterator[_Group]:
    """Execute line by line from ``line`` on until the program ends.

    All state that each line needs is in local variables, since loops execute millions of lines.
    """
    interpreter, listing = flow.interpreter, flow.listing
    execute, ready = interpreter.execute, interpreter.out.ready
    if trace is not None:
        trace.begin(flow)
    first, count = 1, 0
    page: Page | None = None
    steps: list[Step | Statement | None] = []
    executed, next_check = 0, watch.next_report
    try:
        while not interpreter.ended:
            index = line - first
            if index < 0 or index >= count:
                page = listing.page(line)
                if page is None:
                    after = maker.end_of_file(line)
                    if after is None:
                        break
                    line, listing, count = after, flow.listing, 0
                    continue
                first, count, steps = page.first, page.count, page.steps
                index = line - first
            step = steps[index]
            if step is None:
                assert page is not None
                step = maker.step(page, index)
            traced = listing, line, executed
            executed += 1
            if executed > next_check:
                next_check = watch.check(executed, line)
                if maker.compile_from_here(executed):
                    listing.forget_steps()
            if step.__class__ is Statement:
                execute(step, line)
                line += 1
            else:
                flow.executed = executed
                line = step.run(flow, line)  # type: ignore[union-attr]
                executed = flow.executed
                if flow.listing is not listing:
                    listing, count = flow.listing, 0
            if trace is not None:
                trace.record(flow, traced, executed)
            if ready:
                yield from ready
                ready.clear()
                interpreter.out.take_answers()
    except GcodeError as error:
        raise listing.placed(error, line) from None
    flow.executed = executed


class _Watch:
    """Reports the number of executed lines, and stops endless programs."""

    def __init__(self, flow: Flow, on_line: Callable[[int], None] | None) -> None:
        self._flow = flow
        self._on_line = on_line
        self._most_repeated = flow.limits.repeated_lines
        self._states = RepeatedStates(flow)
        # Compiled code may begin at the first check.
        self.next_report = min(REPORT_INTERVAL, line_steps.MANY_LINES, self._most_repeated)

    def check(self, executed: int, line: int) -> int:
        """Check the limit of repeated lines; return the number of lines at the next check.

        Raises:
            CncError: ``loop-endless``.
        """
        flow = self._flow
        flow.executed = executed
        if executed - flow.new > self._most_repeated:
            raise flow.endless(line, is_certain=False)
        if self._states.comes_back(line):
            raise flow.endless(line, is_certain=True)
        if executed > self.next_report:
            self.next_report = executed + REPORT_INTERVAL
            self.report(executed)
        return min(self.next_report, self._most_repeated + flow.new)

    def report(self, executed: int) -> None:
        """Tell the number of executed lines."""
        if self._on_line is not None:
            self._on_line(executed)
