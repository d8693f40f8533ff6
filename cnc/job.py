"""One program on its way through both passes: surveyed to its end, then planned, interpolated and, with a board, sent."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from time import monotonic, perf_counter
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from cnc.canon import ArcFeed, Block, BoardCommand, Dwell, Held, NurbsFeed, Polyline, Probe, SpindleSync, WaitInput
from cnc.control import Control
from cnc.drivers.base import LineSink, Located, PulseSink
from cnc.errors import BoardError, CncError, Diagnostic, GcodeError, UsageError
from cnc.executor.lines import stream
from cnc.executor.run import Progress, execute
from cnc.flatten.board_time import BoardTime, Countdown
from cnc.flatten.smooth import smooth_path
from cnc.gcode import dialects
from cnc.gcode.flow import Limits
from cnc.gcode.parameters import Parameters
from cnc.gcode.program import interpret
from cnc.gcode.text import Text
from cnc.gcode.tools import ToolTable
from cnc.interpolator.reference_pulse import Algorithm, ReferencePulse
from cnc.interpolator.sampled import Sampled
from cnc.lineprogram import LineProgram
from cnc.machine.models import DialectName, Machine
from cnc.memory import Memory, folders
from cnc.onboard import adopted, needs_operator, to_remember, translator, waits
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.planner.window import LONG, SLICE
from cnc.report.hints import Hints, step_rate
from cnc.report.outputs import JsonLines, Output, TraceWriter, check_formats, pulse_writer, trace_writer
from cnc.report.portable import dialects_of, portability
from cnc.report.result import Extremes, Report
from cnc.report.selection import Selection, unknown_codes
from cnc.report.survey import ROUNDING, Survey
from cnc.report.targets import TextTarget
from cnc.report.view.writer import check_picture, picture_writer
from cnc.resume import Beginning
from cnc.source import STANDARD_INPUT_NAME, Source, readable, shown_name, with_texts
from cnc.stopwatch import Stopwatch, TimedPulses
from cnc.stream import GcodeLine, PulseChunk, SampleChunk
from cnc.warm import ensure_compiled

Floats = NDArray[np.float64]
Stage = Literal["checking", "running"]
State = tuple[Parameters, ToolTable]
Pauses = Literal["wait", "refuse", "skip"]

LINE_BOARDS = ("grbl", "grbl-sim")
"""Kinds of board that take lines, and so commands of their own."""
MOST_FAULTS = 20
"""Soft-limit faults that are kept; the rest are counted."""
MOST_WARNINGS = 100
"""Warnings and notes of one code that are told and kept; the rest are counted, so that many of one hide none of another."""
KEPT_NUMBERS = 8_000_000
"""Numbers of path data (64 MB) that are kept between the passes: a finishing program of a million lines. A longer one is read twice."""


@dataclass(frozen=True, slots=True)
class Outputs:
    """Files to write, ``-`` for standard output, None for none. Formats: see :mod:`cnc.report.outputs`, :mod:`cnc.report.view.writer`."""

    blocks: str | None = None
    trace: str | None = None
    pulses: str | None = None
    lines: str | None = None
    picture: str | None = None


@dataclass(frozen=True, slots=True)
class Watch:
    """Who is told what while it happens.

    on_progress(stage, done, total): lines of the program; total is None in the first pass. on_warning: findings that end nothing.
    on_compiling: before the first run ever, which takes longer. on_sent: how far the board is. on_beginning: what will be done to begin in
    the middle of a program; False ends the run before anything has moved.
    """

    on_progress: Callable[[Stage, int, int | None], None] | None = None
    on_warning: Callable[[Diagnostic], None] | None = None
    on_compiling: Callable[[], None] | None = None
    on_sent: Callable[[Progress], None] | None = None
    on_beginning: Callable[[Sequence[str]], bool] | None = None


def start_position(machine: Machine) -> Floats:
    """Where a program is taken to begin, (axes,) mm: machine zero, or the nearest point of the travel to it."""
    return np.array([0.0 if axis.travel is None else min(max(0.0, axis.travel[0]), axis.travel[1]) for axis in machine.axes.values()])


class Stopped(Exception):
    """The operator wants to stop, and nothing has moved yet."""


class Job:
    """Fills ``report`` as it goes; see :func:`cnc.api.run` for the arguments. UsageError ``output-format`` for an unknown suffix."""

    def __init__(
        self,
        program: Source,
        machine: Machine,
        dialect: DialectName | None,
        sampled: bool,
        outputs: Outputs,
        watch: Watch,
        control: Control | None = None,
        algorithm: Algorithm | None = None,
        selection: Selection | None = None,
        portable: Sequence[str] = (),
        on_plan: Callable[[PlanChunk], None] | None = None,
        pauses: Pauses = "wait",
        from_line: int | None = None,
    ) -> None:
        check_formats(outputs.trace, outputs.pulses, outputs.lines)
        if outputs.picture is not None:
            check_picture(outputs.picture)
        self.program = program
        self.name = shown_name(program)
        self.path = Path(self.name)
        self.machine = machine
        self.dialect: DialectName = dialect or machine.program.dialect
        self.sampled = sampled or outputs.trace is not None
        self.outputs = outputs
        self.watch = watch
        self.control = control or Control()
        self.algorithm = algorithm
        self.selection = selection or Selection()
        self.portable = dialects_of(portable)
        self.on_plan = on_plan
        self.start = start_position(machine)
        self._pauses: Pauses = pauses
        self._operated = control is not None
        self._from_line = from_line
        self._beginning: Beginning | None = None
        self._place = None if self.name == STANDARD_INPUT_NAME else Path(self.name)
        self._memory = Memory(machine)
        self._state: State | None = None
        self._senses = self._probes = self._takes_lines = True
        self._last_line = 0
        self._warned: set[tuple[str, str, int, int]] = set()
        self.report = Report(self.name, machine, limits=Extremes.limits(machine))
        self._kept: list[PathChunk | Block] | None = []
        self._reading, self._reading_again, self._planning, self._interpolating = Stopwatch(), Stopwatch(), Stopwatch(), Stopwatch()
        self._board_settings: Mapping[int, float] = {}
        self._board_time: BoardTime | None = None
        self._open: list[Output] = []
        self._step_deviation = 0.0

    def carry_out(self, board: PulseSink | LineSink | None = None, board_name: str | None = None) -> Report:
        """Both passes, the second on ``board`` or on none; what goes wrong with program or board ends up in the report."""
        ensure_compiled(self.watch.on_compiling)
        report, began = self.report, perf_counter()
        report.board = board_name
        if board is not None:
            can = board.capabilities
            self._senses, self._probes, self._takes_lines = can.senses, can.probes, can.lines
            if isinstance(board, LineSink):
                self._adopt(board)
            elif isinstance(board, Located) and board.standing_steps is not None:
                self.start = board.standing_steps / np.array([axis.steps_per_mm for axis in self.machine.axes.values()])
        else:
            self._takes_lines = self.machine.board.kind in LINE_BOARDS
        try:
            with ExitStack() as stack:
                self.path = stack.enter_context(readable(self.program))
                stack.callback(self._discard)
                try:
                    self._find_beginning()
                    self._survey()
                    self._look_up("checking", report.lines)
                    self._confirm_beginning()
                    if report.ok:
                        lines_s = self._translate()
                        self._move(board)
                        if lines_s is not None and self._takes_lines:
                            report.duration_s = lines_s
                        if board is None:
                            self._hint(step_rate(report))
                    if report.ok and report.stopped_at_line is None:
                        self._close()
                        if board is not None and self._state is not None:
                            self._memory.keep(*self._state)
                except CncError as error:
                    report.faults.append(error)
                if self.portable and report.stopped_at_line is None:
                    report.faults += portability(self.path, self.name, self._read, self.dialect, self.portable, report.faults)
                report.faults = with_texts(report.faults, {self.name: self.path})
        except Stopped:
            report.stopped_at_line = 0
        except CncError as error:
            report.faults.append(error)
        timing = report.timing
        timing.parse_s = self._reading.seconds
        # The planner draws the program through the reader, so its watch ran meanwhile.
        timing.plan_s = max(0.0, self._planning.seconds - self._reading.seconds - self._reading_again.seconds)
        timing.interpolate_s = self._interpolating.seconds
        timing.total_s = perf_counter() - began
        return report

    def _adopt(self, board: LineSink) -> None:
        """The board's own travel, offsets and position: the program is read with them."""
        if self.outputs.pulses is not None:
            hint = "leave --pulses out, or check the program without the board"
            raise UsageError(Diagnostic("no-pulses", "a board that plans for itself is sent lines, not pulses", hint=hint))
        self.machine = board.fitted(self.machine)
        self.start = np.array(board.position)
        self._memory.adopt(adopted(board, self.machine))
        self._board_settings = board.settings
        # The lines come from a path of their own, which is not the one that is surveyed.
        self._kept = None

    def _find_beginning(self) -> None:
        """Where to begin, if not at the first line."""
        if self._from_line is None:
            return
        z = self.machine.axes.get("z")
        top = None if z is None or z.travel is None else z.travel[1]
        beginning = Beginning(self._from_line, self.name, self.machine.axis_names, top)

        def read(start: Floats) -> Iterator[Block]:
            state = self._remembered(self.dialect)
            return self._interpreted(self.dialect, Text.of_file(self.path, self.name), state, None, self._at_other_line, start)

        beginning.check(read, self.start)
        self._beginning = beginning

    def _confirm_beginning(self) -> None:
        """Tell how the machine will get there, and ask."""
        ask = self.watch.on_beginning
        if self._beginning is not None and ask is not None and self.report.ok and not ask(self._beginning.story):
            raise Stopped

    def blocks(self) -> Iterator[Block]:
        """The canonical blocks of the program, read as in the first pass."""
        return self._blocks(None, None)

    def _survey(self) -> None:
        """The first pass: read to the end; nothing moves."""
        report, survey, room = self.report, Survey(self.machine), KEPT_NUMBERS
        hints = Hints(self.machine, self.start)
        blocks = self._reading.inside(self._blocks(self._warn, self._at_line))
        if self.outputs.blocks is not None:
            blocks = self._opened(JsonLines(self.outputs.blocks, self.machine.axis_names, self.name)).passed(blocks)
        if report.board is None:
            blocks = hints.passed(blocks)
        for item in self._planning.inside(self._path(self._counted(blocks))):
            if isinstance(item, BoardCommand | Probe | WaitInput | SpindleSync):
                self._check_board(item)
            if self._pauses == "refuse" and self._takes_lines and report.board is not None and isinstance(item, Block) and waits(item):
                raise needs_operator(item)
            if isinstance(item, Probe | WaitInput):
                # What the board will answer decides how the program goes on: it has to be read again.
                room = -1
            room -= len(item.data) + 8 * len(item) if isinstance(item, PathChunk) else 16
            if room < 0:
                self._kept = None
            if self._kept is not None:
                self._kept.append(item)
            if isinstance(item, PathChunk):
                if report.board is None:
                    hints.see_path(item)
                for fault in survey.add(item):
                    if len(report.faults) < MOST_FAULTS:
                        report.faults.append(fault)
                    else:
                        report.hidden_faults += 1
            else:
                survey.between(item)
        report.path_length_mm = survey.length
        report.bounding_box = survey.box()
        if report.board is None:
            self._hint([*hints.findings(), *unknown_codes(self.path, self.name)])

    def _translate(self) -> float | None:
        """The program as lines, where they are asked for or the board takes them: the seconds that such a board takes for them."""
        if self.outputs.lines is None and not self._takes_lines:
            return None
        target = None if self.outputs.lines is None else self._opened(TextTarget(self.outputs.lines))
        parameters = self._memory.parameters(macro=False).values
        program = LineProgram(self.machine, self.start, parameters, self.report.bounding_box, self._board_settings)
        self._board_time = program.write(self.blocks(), None if target is None else target.write)
        return self._board_time.seconds

    def _hint(self, findings: Iterable[Diagnostic]) -> None:
        """Tell findings that were made without the source line at hand."""
        for found in with_texts([GcodeError(finding) for finding in findings], {self.name: self.path}):
            self._warn(found.diagnostic)

    def _move(self, board: PulseSink | LineSink | None) -> None:
        """The second pass: plan, interpolate, and send or only look."""
        report, machine = self.report, self.machine
        steps_per_mm = np.array([axis.steps_per_mm for axis in machine.axes.values()])
        fastest = machine.board.max_step_rate if board is None else min(machine.board.max_step_rate, board.capabilities.max_step_rate)
        interpolator = ReferencePulse(steps_per_mm, self.start, 1e9 / fastest, algorithm=self.algorithm)
        on_pulses = None
        if self.outputs.pulses is not None:
            on_pulses = self._opened(pulse_writer(self.outputs.pulses, machine, interpolator.origin_steps)).write
        path = self._kept if self._kept is not None else self._read_again(smooth=isinstance(board, LineSink))
        # Without a board nobody can wish for anything once it is under way, and a board that plans for itself is told by the executor.
        control = None if isinstance(board, LineSink) else self.control
        slice_s = (board.capabilities.slice_s or SLICE) if isinstance(board, PulseSink) else LONG
        ahead = LookAhead(machine, control, slice_s=slice_s)
        planned = self._timed(self._planning.inside(ahead.plan(path)))
        if self.sampled:
            planned = self._sampled(planned)
        pulses = TimedPulses(interpolator, self._interpolating)
        try:
            if board is None:
                self._look(planned, pulses, on_pulses)
            elif isinstance(board, PulseSink):
                if self._pauses == "wait" and self._operated and board.capabilities.slice_s:
                    planned = self._pausing(planned)
                self._send(planned, pulses, on_pulses, board, ahead)
            else:
                self._stream(planned, board)
        finally:
            audit = ahead.audit
            largest = report.largest
            largest.feed, largest.accel, largest.jerk = audit.feed, audit.accel, audit.jerk
            largest.normal_accel, largest.chord_error = audit.normal_accel, audit.chord_error
            largest.step_deviation = self._step_deviation if self.sampled else audit.step_deviation
            each = zip(machine.axes, audit.axis_velocity.tolist(), audit.axis_acceleration.tolist(), audit.axis_jerk.tolist(), strict=True)
            largest.axes = {axis: {"velocity": v, "acceleration": a, "jerk": j} for axis, v, a, j in each}
            report.violations.update(audit.violations)
            report.pulse_error_blu = interpolator.error_blu

    def _look(self, planned: Iterable[PlanChunk | Block], pulses: TimedPulses, on_pulses: Callable[[PulseChunk], None] | None) -> None:
        """Without a board: make the pulses, count and write them."""
        report = self.report
        steps = np.zeros(len(self.machine.axes), np.int64)

        def seen(chunks: Iterable[PulseChunk]) -> None:
            nonlocal steps
            for chunk in chunks:
                steps += [np.count_nonzero(column) for column in chunk.step.T]
                report.pulse_rows += len(chunk.step)
                if on_pulses is not None:
                    on_pulses(chunk)

        for item in planned:
            self._look_up("running", item)
            if isinstance(item, Held):
                self.control.wait()
            if isinstance(item, PlanChunk):
                seen(pulses.pulses(item))
        seen(pulses.settle())
        report.steps = dict(zip(self.machine.axes, steps.tolist(), strict=True))

    def _send(
        self,
        planned: Iterable[PlanChunk | Block],
        pulses: TimedPulses,
        on_pulses: Callable[[PulseChunk], None] | None,
        board: PulseSink,
        ahead: LookAhead,
    ) -> None:
        """With a board: the executor sends, and comes to rest on the path when the operator wishes."""
        report, machine = self.report, self.machine
        # The board is about to move: from here on a wish to stop is the executor's to carry out.
        self._tell(Progress(0.0, 0, 0))
        try:
            outcome = execute(
                planned, board, pulses, on_pulses=on_pulses, on_progress=self._tell, control=self.control, ramp_down=ahead.ramp_down
            )
        except BoardError:
            self._stands_at(board.position_steps)
            raise
        report.steps = dict(zip(machine.axes, outcome.steps.tolist(), strict=True))
        report.pulse_rows = outcome.rows
        report.stopped_at_line = outcome.stopped_at_line
        if not outcome.finished:
            report.duration_s = outcome.duration
            self._stands_at(outcome.position_steps)

    def _stream(self, planned: Iterable[PlanChunk | Block], board: LineSink) -> None:
        """With a board that plans for itself: lines, and the operator's wishes as the board knows them."""
        report, machine = self.report, self.machine

        def afterwards() -> Iterable[GcodeLine]:
            return () if self._state is None else to_remember(board, machine, self._state[0].values)

        countdown = None if self._board_time is None else Countdown(self._board_time)

        def on_progress(progress: Progress) -> None:
            if countdown is not None:
                taken = progress.rows - (progress.buffered or 0)
                left = countdown.left(monotonic(), taken, held=progress.held, feed_override=self.control.feed_override)
                progress = replace(progress, left=left)
            self._tell(progress)

        on_progress(Progress(0.0, 0, 0))
        try:
            lines = translator(board, machine)
            if self._pauses == "skip":
                planned = (item for item in planned if isinstance(item, PlanChunk) or not waits(item))
            outcome = stream(planned, board, lines, control=self.control, on_progress=on_progress, afterwards=afterwards)
        except BoardError:
            report.end_position = dict(zip(machine.axes, board.position, strict=False))
            raise
        report.stopped_at_line = outcome.stopped_at_line
        if outcome.stopped_at_line is not None:
            report.duration_s = outcome.duration
            report.end_position = dict(zip(machine.axes, outcome.position, strict=False))

    def _pausing(self, planned: Iterable[PlanChunk | Block]) -> Iterator[PlanChunk | Block]:
        """The same, held where the program wants the operator."""
        for item in planned:
            yield item
            if isinstance(item, Block) and waits(item):
                self.control.hold()
                yield Held(item.file, item.line)

    def _tell(self, progress: Progress) -> None:
        """How far the board is."""
        if self.watch.on_progress is not None:
            self.watch.on_progress("running", progress.line, self._last_line)
        if self.watch.on_sent is not None:
            self.watch.on_sent(progress)

    def _stands_at(self, grid: NDArray[np.int64]) -> None:
        """The program did not come to its end: where the board says it is."""
        axes = self.machine.axes.items()
        self.report.end_position = {letter: steps / axis.steps_per_mm for (letter, axis), steps in zip(axes, grid.tolist(), strict=True)}

    def _blocks(self, warn: Callable[[Diagnostic], None] | None, on_line: Callable[[int], None] | None) -> Iterator[Block]:
        self._state = self._remembered(self.dialect)
        blocks = self._interpreted(self.dialect, Text.of_file(self.path, self.name), self._state, warn, on_line)
        return blocks if self._beginning is None else self._beginning.passed(blocks, self.start)

    def _read(self, dialect: str, text: Text) -> Iterator[Block]:
        """The canonical blocks of a text under another dialect, which nothing remembers."""
        return self._interpreted(dialect, text, self._remembered(dialect), None, self._at_other_line)

    def _remembered(self, dialect: str) -> State:
        return self._memory.parameters(macro=dialects.load(dialect).flavour == "macro-b"), self._memory.tools()

    def _interpreted(
        self,
        dialect: str,
        text: Text,
        state: State,
        warn: Callable[[Diagnostic], None] | None,
        on_line: Callable[[int], None] | None,
        start: Floats | None = None,
    ) -> Iterator[Block]:
        program = self.machine.program
        return interpret(
            text,
            axes=self.machine.axis_names,
            dialect=dialect,
            start=self.start if start is None else start,
            warn=warn,
            parameters=state[0],
            tools=state[1],
            folders=folders(self._place, self.machine),
            limits=Limits(program.max_repeated_lines, program.max_call_depth),
            on_line=on_line,
        )

    def _check_board(self, block: BoardCommand | Probe | WaitInput | SpindleSync) -> None:
        """GcodeError for what this board can't do."""
        if isinstance(block, BoardCommand):
            if not self._takes_lines:
                message, hint = f"{block.text} is for a GRBL board", "take it out, or name a machine file whose board.kind is grbl"
                raise GcodeError(Diagnostic("board-command", message, block.file, block.line, hint=hint))
        elif not self._senses and not (self._probes and isinstance(block, Probe)):
            what = "the spindle's turning" if isinstance(block, SpindleSync) else "a probe" if isinstance(block, Probe) else "an input"
            message = f"the board {self.report.board!r} does not feel {what}"
            raise GcodeError(Diagnostic("board-senseless", message, block.file, block.line, hint="run it on a board that does"))

    def _path(self, blocks: Iterable[Block]) -> Iterator[PathChunk | Block]:
        return build(blocks, axes=self.machine.axis_names, start=self.start, tolerance=self.machine.path.tolerance)

    def _read_again(self, *, smooth: bool) -> Iterator[PathChunk | Block]:
        """The path once more, ``smooth`` for lines: by what probes and inputs answer it may go where the first pass did not."""
        blocks, machine = self._reading_again.inside(self.blocks()), self.machine
        tolerance = machine.path.tolerance
        survey = Survey(machine, tolerance if smooth else ROUNDING)
        path = smooth_path(blocks, axes=machine.axis_names, start=self.start, tolerance=tolerance) if smooth else self._path(blocks)
        for item in path:
            if isinstance(item, PathChunk):
                for fault in survey.add(item):
                    raise fault
            else:
                survey.between(item)
            yield item

    def _at_line(self, executed: int) -> None:
        """Count the lines, tell how far things are, and give up if the operator wants to."""
        self.report.lines = executed
        self._look_up("checking", executed)

    def _at_other_line(self, executed: int) -> None:
        """The same, of a reading under another dialect."""
        self._look_up("checking", executed)

    def _look_up(self, stage: Stage, item: int | PlanChunk | Block) -> None:
        if self.control.stopped:
            raise Stopped
        if self.watch.on_progress is not None:
            line = item if isinstance(item, int) else int(item.path.line[-1]) if isinstance(item, PlanChunk) else item.line
            self.watch.on_progress(stage, line, None if stage == "checking" else self._last_line)

    def _counted(self, blocks: Iterable[Block]) -> Iterator[Block]:
        """Count blocks, each straight move as one, and note where the motion ends."""
        report, end = self.report, self.start
        for block in blocks:
            report.blocks += 1
            if block.file == self.name:
                self._last_line = max(self._last_line, int(block.lines[-1]) if isinstance(block, Polyline) else block.line)
            if isinstance(block, Polyline):
                report.blocks += len(block.points) - 1
                end = block.points[-1]
            elif isinstance(block, ArcFeed):
                end = block.end
            elif isinstance(block, NurbsFeed):
                end = block.control_points[-1]
            elif isinstance(block, Probe):
                end = block.end
            yield block
        report.end_position = dict(zip(self.machine.axes, end.tolist(), strict=True))

    def _timed(self, planned: Iterable[PlanChunk | Block]) -> Iterator[PlanChunk | Block]:
        """Follow the machine's clock, and draw what goes by."""
        report, drawn = self.report, None
        if self.outputs.picture is not None:
            drawn = self._opened(picture_writer(self.outputs.picture, report, self.path, self.start))
        for item in planned:
            if isinstance(item, PlanChunk):
                report.duration_s = item.t0 + item.duration
                if self.on_plan is not None:
                    self.on_plan(item)
            elif isinstance(item, Dwell):
                report.duration_s += item.seconds
            if drawn is not None:
                drawn.add(item)
            yield item

    def _sampled(self, planned: Iterable[PlanChunk | Block]) -> Iterator[PlanChunk | Block]:
        """Sample every stretch of the plan as it goes by, and write the trace."""
        sampler = Sampled(self.machine.path.period, self.start)
        trace = self._opened(trace_writer(self.outputs.trace, self.machine)) if self.outputs.trace is not None else None
        for item in planned:
            if isinstance(item, PlanChunk):
                self._note_samples(sampler.samples(item), trace)
            yield item
        self._note_samples(sampler.finish(self.report.duration_s), trace)

    def _note_samples(self, chunks: Iterable[SampleChunk], trace: TraceWriter | None) -> None:
        for chunk in self._interpolating.inside(chunks):
            if len(chunk.step_deviation):
                self._step_deviation = max(self._step_deviation, float(np.abs(chunk.step_deviation).max()))
            if trace is not None:
                trace.write(chunk)

    def _warn(self, diagnostic: Diagnostic) -> None:
        """Tell and keep a warning once for its place, however often a loop comes by."""
        warnings, place = self.report.warnings, (diagnostic.code, diagnostic.file, diagnostic.line, diagnostic.column)
        if place in self._warned or not self.selection.wants(diagnostic):
            return
        told = sum(each.code == diagnostic.code for each in warnings)
        if told >= MOST_WARNINGS:
            self.report.hidden_warnings += 1
            return
        self._warned.add(place)
        warnings.append(diagnostic)
        if self.watch.on_warning is not None:
            self.watch.on_warning(diagnostic)

    def _opened(self, output: OutputKind) -> OutputKind:
        self._open.append(output)
        return output

    def _close(self) -> None:
        for output in self._open:
            output.close()

    def _discard(self) -> None:
        for output in self._open:
            output.discard()


OutputKind = TypeVar("OutputKind", bound=Output)
