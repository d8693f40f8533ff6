"""The run pass on a board that plans for itself: lines, their times, and the operator's requests.

All lines are made before the first is sent, so that nothing moves if one of them cannot be made.
They are kept in memory. They are made again while they are sent, if there are too many or if
answers decide how the program continues.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from cnc.boards.protocols import LineSink, board_error
from cnc.grbl_lines.board_limits import BoardLimits
from cnc.grbl_lines.grbl_timing import BoardTime, Countdown
from cnc.grbl_lines.number_format import BOARD_LETTERS, board_axes
from cnc.grbl_lines.path_samples import MARGIN
from cnc.grbl_lines.translator import ARC_TOLERANCE, JUNCTION_DEVIATION, Translator
from cnc.grbl_lines.writer import LoweredFeeds
from cnc.machine.models import Machine
from cnc.model.blocks import (
    Abort,
    Block,
    BoardCommand,
    End,
    Probe,
    Spindle,
    Stop,
    Tool,
    pause_reason,
)
from cnc.model.diagnostics import BoardError, Diagnostic
from cnc.model.line_effects import MOTIONS, LineKind
from cnc.model.motion_commands import places_of
from cnc.model.operator_control import Control
from cnc.model.streams import GcodeLine, PackedLines
from cnc.model.units import per_minute
from cnc.path.chunk import PathChunk
from cnc.planner.lookahead import LookAhead
from cnc.report.result import Extremes
from cnc.session.context import SessionContext
from cnc.session.pipeline import PlannedMotion
from cnc.session.position_check import offset_lines
from cnc.session.required_capabilities import pause_text
from cnc.session.run_pulses import Progress, abort

# Execution of a path on a line board, as lines that are sent as fast as the board accepts them.
#
#     path ──► translator ──► steps (lines, then a block at which the board rests) ──► board
#
# Steps can be made during the run, where the board's answers decide how the program continues, or
# before any motion: a list of them is small.
#
# The board itself carries out the requests of the operator
# (:meth:`cnc.boards.protocols.LineSink.connect_operator`), so the lines do not contain them. Hold,
# resume and override act on the current motion.

POSITION_ROUNDING = 0.003
"""Rounding error of a reported position, beside one step, mm: three decimals, even in inches."""

END = End("", 0)


@dataclass(frozen=True, slots=True)
class Step:
    """The lines of one item of a path.

    Attributes:
        file: The program.
        lines: Lines for the board.
        block: Block after the lines at which the board rests, or None.
        position: End point of the lines so far for each axis of the machine, mm; None if not known.
    """

    file: str
    lines: PackedLines
    block: Block | None
    position: Mapping[str, float] | None


def steps(
    path: Iterable[PathChunk | Block],
    translator: Translator,
    on_lines: Callable[[PackedLines], None] | None = None,
) -> Iterator[Step]:
    """Yield the steps of a path, each as soon as its lines are final.

    The answer of a probe must be set before the next step is requested.

    Args:
        path: Chunks of the path, and the blocks between them.
        translator: Makes lines of them.
        on_lines: Called with the lines of each step.
    """
    file = ""

    def step(lines: Sequence[GcodeLine], block: Block | None) -> Step:
        packed = PackedLines.of(lines)
        if on_lines is not None:
            on_lines(packed)
        return Step(file, packed, block, translator.position)

    for item in path:
        file = item.file
        lines = list(translator.lines(item))
        if isinstance(item, BoardCommand):
            # A locked board accepts only $H and $X, so they precede the modes of the first line.
            lines.sort(key=lambda line: not line.text.startswith("$"))
        block = item if isinstance(item, Abort | BoardCommand | Probe | Stop | Tool) else None
        if lines or block is not None:
            yield step(lines, block)
    yield step(list(translator.end()), None)


@dataclass(frozen=True, slots=True)
class LineOutcome:
    """Result of a run on a line board.

    Attributes:
        position: Position of each axis that the board reports, mm.
        lines: Number of lines sent.
        stopped_at_line: None after a complete run. After a stop, the source line of the last
            motion, else the last line that the board has accepted.
        began: Time of the first line with an effect other than modes, by the clock of the board, s;
            None without one.
        ended: Time of the first report that showed the machine at rest behind the lines of the
            program, by that clock, s.
    """

    position: tuple[float, ...]
    lines: int
    stopped_at_line: int | None = None
    began: float | None = None
    ended: float = 0.0


class _Stream:
    """State of a run, and the sending of its steps."""

    def __init__(
        self,
        board: LineSink,
        control: Control,
        on_progress: Callable[[Progress], None] | None,
        pause_text: Callable[[Block], str] | None,
    ) -> None:
        self.board = board
        self.control = control
        self.on_progress = on_progress
        self.pause_text = pause_text
        self.pause: Block | None = None
        self.text: tuple[Block | None, str] = (None, "")
        self.ended: float | None = None
        self.file = ""
        self.wanted: Mapping[str, float] | None = None

    def report(self) -> None:
        """Pass on a report of the board."""
        if self.on_progress is not None:
            board = self.board
            line, reason = board.confirmed_line, board.hold_reason
            if self.pause is not None and self.control.held and not self.differing():
                # The board has not answered M0 yet.
                line, reason = self.pause.line, reason or self.text_of(self.pause)
            now = Progress(
                0.0,
                line,
                board.lines_sent.number,
                self.control.held,
                board.position,
                board.buffered,
                hold_reason=reason,
                file=self.file,
                at=board.moving_line,
                at_rest=self.control.held and board.holds,
                machine=board.report,
            )
            self.on_progress(now)

    def text_of(self, pause: Block) -> str:
        """Return what a pause asks of the operator."""
        if self.text[0] is not pause:
            self.text = pause, "" if self.pause_text is None else self.pause_text(pause)
        return self.text[1]

    def step(self, step: Step) -> None:
        """Send a step, and carry out its block."""
        self.file, block = step.file, step.block
        self.send(step.lines)
        self.wanted = step.position
        if block is None or self.control.stopped:
            return
        # The board continues after a pause only when the operator resumes.
        self.pause = block if isinstance(block, Stop | Tool) else None
        answer = self.board.execute(block, 0)
        self.pause = None
        if isinstance(block, Probe):
            block.answer.values = answer
        elif isinstance(block, BoardCommand) and block.homes:
            block.answer.values = self.board.position
        elif isinstance(block, BoardCommand):
            self.compare()

    def send(self, lines: PackedLines) -> None:
        """Send lines until the operator stops the run."""
        if not self.control.stopped:
            self.board.send_lines(lines)

    def compare(self) -> None:
        """Compare the position of the board, which is at rest, with that of the lines.

        Raises:
            BoardError: ``position-differs``.
        """
        if self.control.stopped or self.board.check_only:
            return
        for letter, planned, reported in self.differing():
            message = (
                f"the board is at {letter}{reported:.3f}, "
                f"but the program ends at {letter}{planned:.3f}"
            )
            hint = (
                "bytes were lost, or the board lost its position: "
                "check the part, and home the machine"
            )
            raise board_error(
                "position-differs", message, line=self.board.confirmed_line, hint=hint
            )

    def differing(self) -> list[tuple[str, float, float]]:
        """Return letter, planned and reported position of the axes that are not where they end."""
        return [
            (letter.upper(), planned, reported)
            for (letter, planned), reported, step in zip(
                (self.wanted or {}).items(),
                self.board.position,
                self.board.resolution,
                strict=False,
            )
            if abs(planned - reported) > step + POSITION_ROUNDING
        ]

    def outcome(self, *, stopped: bool) -> LineOutcome:
        board = self.board
        line = board.moving_line or board.confirmed_line
        number, began, rested_at = board.lines_sent
        ended = rested_at if self.ended is None else self.ended
        return LineOutcome(board.position, number, line if stopped else None, began, ended)


def stream(
    program: Iterable[Step],
    board: LineSink,
    *,
    control: Control | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    afterwards: Callable[[], Iterable[GcodeLine]] | None = None,
    pause_text: Callable[[Block], str] | None = None,
) -> LineOutcome:
    """Run a program on a line board.

    After a stop request, the board comes to rest, discards its lines, and is left stopped. After
    any exception, the board is aborted.

    Args:
        program: Steps of the program.
        board: The board.
        control: Requests of the operator.
        on_progress: Called after each report of the board.
        afterwards: Gives lines to send after the program, when the position has been checked.
        pause_text: Gives the text for the operator at a pause of the program.

    Returns:
        The result of the run.

    Raises:
        BoardError: The board or its connection failed, or ``position-differs``. The source line is
            that of the fault, else the last one that the board has accepted.
    """
    control = control or Control()
    run = _Stream(board, control, on_progress, pause_text)
    try:
        board.connect_operator(control, run.report)
        board.start(np.zeros(board.capabilities.axes, np.int64))
        for step in program:
            run.step(step)
            if control.stopped:
                break
        if not control.stopped:
            board.execute(END, 0)
            run.ended = board.lines_sent.rested_at
            run.compare()
            if afterwards is not None and not board.check_only:
                run.send(PackedLines.of(list(afterwards())))
            board.finish()
            run.report()
        # A stop request may have come during the last motion.
        if control.stopped:
            board.stop()
        return run.outcome(stopped=control.stopped)
    except BoardError as error:
        abort(board)
        finding = error.diagnostic
        raise error.at(
            file=finding.file or run.file, line=finding.line or board.confirmed_line
        ) from error
    except BaseException:
        abort(board)
        raise


# The line of the program that the machine carries out: its text, programmed feed and tool.

KEPT_LINES = 1024
"""Lines sent that are kept: more than the buffers of a board hold."""
FEEDS = MOTIONS - {LineKind.RAPID}
"""Motions with a programmed feed."""


class PresentLine:
    """Describes the present line.

    Args:
        program: The file of the program.
        name: Its name in progress reports.
    """

    def __init__(self, program: Path, name: str) -> None:
        self._program, self._name = program, name
        self._rest: Iterator[str] = iter(())
        self._number, self._text = 0, ""
        self._steps: deque[PackedLines] = deque()
        self._before = 0
        self._tool: int | None = None

    def steps(self, steps: Iterable[Step]) -> Iterator[Step]:
        """Yield steps; note the lines of each, and the tool when it has been carried out."""
        for step in steps:
            self._begin(step.lines)
            yield step
            if isinstance(step.block, Tool) and step.block.change:
                self._tool = step.block.number

    def described(
        self, progress: Progress, *, time: float, left: float, axes: tuple[str, ...]
    ) -> Progress:
        """Return the progress with text, feed and tool of its line, and with its times and axes."""
        line = progress.at or progress.line
        feed = self._feed_of(line, progress.rows - self._before)
        return replace(
            progress,
            time=time,
            left=left,
            axes=axes,
            text=self._text_of(line) if progress.file in ("", self._name) else "",
            feed=None if feed is None else per_minute(feed),
            tool=self._tool,
        )

    def _begin(self, lines: PackedLines) -> None:
        """Note the lines of a step that begins; forget steps that are over."""
        earlier = sum(map(len, self._steps))
        while self._steps and earlier - len(self._steps[0]) > KEPT_LINES:
            earlier -= len(self._steps.popleft())
        self._before += len(self._steps[-1]) if self._steps else 0
        self._steps.append(lines)

    def _feed_of(self, line: int, sent: int | None) -> float | None:
        """Return the feed of the motion that was last sent for a line, mm/s; None without one.

        Args:
            line: The source line.
            sent: Number of lines of the present step that were sent.
        """
        for lines in reversed(self._steps):
            rows = lines.rows[:sent][-KEPT_LINES:]
            for row in np.flatnonzero(rows["line"] == line)[::-1]:
                if rows["kind"][row] in FEEDS:
                    return float(rows["feed"][row])
            # All lines of the steps before were sent.
            sent = None
        return None

    def _text_of(self, line: int) -> str:
        """Return the text of a line. Lines mostly follow each other, so the file is read on."""
        if line < self._number:
            self._rest, self._number, self._text = iter(()), 0, ""
        if line > self._number:
            if self._number == 0:
                self._rest = _lines_of(self._program)
            text = next(islice(self._rest, line - self._number - 1, None), "")
            self._number, self._text = line, text.strip()
        return self._text


def _lines_of(program: Path) -> Iterator[str]:
    with program.open(encoding="utf-8", errors="replace") as file:
        yield from file


# Lines for a board that plans for itself: their translator, and their times on the board.


def line_translator(board: LineSink, machine: Machine) -> Translator:
    """Return the translator that makes lines for this board.

    Raises:
        BoardError: ``board-axes`` if the board does not report its offsets.
    """
    offsets = dict(zip(machine.axes, board.work_offset, strict=True))
    if not offsets:
        raise board_error(
            "board-axes", "the board reports no offsets", hint="is it GRBL 1.1 or grblHAL?"
        )
    work_offset = [offsets.get(letter, 0.0) for letter in board_axes(machine.axes)]
    settings = board.settings
    return Translator(
        machine,
        work_offset=work_offset,
        arc_tolerance=settings.get(12) or ARC_TOLERANCE,
        junction_deviation=settings.get(11, JUNCTION_DEVIATION),
        codes=board.codes,
        margin=MARGIN if settings.get(20) else 0.0,
    )


def board_timing(board: LineSink, machine: Machine) -> BoardTime:
    """Return the timing of lines on this board, from its present position."""
    offsets = dict(zip(machine.axes, board.work_offset, strict=False))
    places = dict(zip(machine.axes, board.position, strict=False))
    start = tuple(
        places.get(letter, 0.0) - offsets.get(letter, 0.0) for letter in board_axes(machine.axes)
    )
    limits = BoardLimits.of_board(machine, board.settings, board.planner_blocks)
    return BoardTime(limits, start)


HIGHEST_SPEED = 30
"""Number of the GRBL setting of the highest spindle speed."""
KEPT_BYTES = 192_000_000
"""Limit on the lines that are kept before the first is sent: about two million of them."""


class LinePass:
    """Sends a program as lines and fills the report.

    Args:
        context: The session.
        motion: Reads the path, and plans it for the outputs.
        board: The board.
        warn: Reports findings.
        depends_on_answers: Whether a probe or an input decides how the program continues.

    Attributes:
        timing: The duration of the lines on the board, computed before the first is sent.
    """

    def __init__(
        self,
        context: SessionContext,
        motion: PlannedMotion,
        board: LineSink,
        warn: Callable[[Iterable[Diagnostic]], None],
        *,
        depends_on_answers: bool,
    ) -> None:
        self.timing = board_timing(board, context.reader.machine)
        self._context, self._motion, self._board = context, motion, board
        self._warn, self._depends_on_answers = warn, depends_on_answers
        self._lowered = LoweredFeeds()
        self._tool: Tool | None = None
        self._speed = Spindle("", 0, "off", 0.0)
        self._skipped: list[Block] = []

    def run(self, before_motion: Callable[[], None]) -> None:
        """Send all lines. ``before_motion`` is called when the lines are known."""
        context, board = self._context, self._board
        report, machine, control = context.report, context.reader.machine, context.observer.control
        self._write_plan()
        kept = self._collected()
        report.largest, report.limits = self._largest(), self._limits()
        self._warn(self._lowered.findings())
        self._warn(self._unused_tool_change())
        self._warn(self._lowered_speed())
        self._warn(self._unused_modes())
        self._warn(self._skipped_pauses())
        countdown = Countdown(self.timing)
        present = PresentLine(context.reader.path, report.program)

        def changed_offsets() -> Iterable[GcodeLine]:
            state = context.reader.state
            return () if state is None else offset_lines(board, machine, state[0].values)

        def on_progress(progress: Progress) -> None:
            done = progress.rows - (progress.buffered or 0)
            left = countdown.left(
                board.now(),
                done,
                held=progress.held or not progress.rows,
                feed_override=control.feed_override,
                rapid_override=board.rapid_override,
            )
            time = self.timing.seconds - left
            context.observer.sent(
                present.described(progress, time=time, left=left, axes=machine.axis_names)
            )

        before_motion()
        on_progress(Progress(0.0, 0, 0))
        try:
            outcome = stream(
                present.steps(self._counted(self._steps() if kept is None else kept)),
                board,
                control=control,
                on_progress=on_progress,
                afterwards=changed_offsets,
                pause_text=lambda block: pause_text(block, context.reader),
            )
        except BoardError:
            report.end_position = dict(zip(machine.axes, board.position, strict=False))
            raise
        report.stopped_at_line = outcome.stopped_at_line
        if outcome.stopped_at_line is not None:
            report.duration_s = self.timing.seconds - self.timing.remaining(outcome.lines)
        if not board.check_only:
            began = outcome.began
            report.played_s = 0.0 if began is None else max(outcome.ended - began, 0.0)
            report.end_position = dict(zip(machine.axes, outcome.position, strict=False))

    def _steps(self, on_lines: Callable[[PackedLines], None] | None = None) -> Iterator[Step]:
        """Yield the program as lines."""
        path = self._motion.path(for_lines=True)
        if self._context.options.pauses == "skip":
            path = self._without_pauses(path)
        translator = line_translator(self._board, self._context.reader.machine)
        self._lowered = translator.lowered
        yield from steps(map(self._noted, path), translator, on_lines)

    def _counted(self, program: Iterable[Step]) -> Iterator[Step]:
        """Yield the steps of a program; count its pauses."""
        for step in program:
            if step.block is not None and pause_reason(step.block):
                self._context.observer.pause_at(step.block)
            yield step

    def _without_pauses(self, path: Iterable[PathChunk | Block]) -> Iterator[PathChunk | Block]:
        """Yield a path without its pauses, which are kept."""
        self._skipped = []
        for item in path:
            if isinstance(item, PathChunk) or not pause_reason(item):
                yield item
            else:
                self._skipped.append(item)

    def _skipped_pauses(self) -> Iterator[Diagnostic]:
        """Yield a warning at the first pause that the run leaves out."""
        if self._skipped and not self._board.check_only:
            first, more = self._skipped[0], len(self._skipped) - 1
            others = f", nor at {more} later pause{'s' if more > 1 else ''}" if more else ""
            message = f"the run does not wait here{others}: {pause_reason(first)}"
            hint = "run it in a terminal, where the space bar continues after each pause"
            yield Diagnostic(
                "pause-skipped", message, first.file, first.line, hint=hint, severity="warning"
            )

    def _noted(self, item: PathChunk | Block) -> PathChunk | Block:
        """Return an item of the path; its first tool change, and its highest speed, are kept."""
        if self._tool is None and isinstance(item, Tool) and item.change:
            self._tool = item
        if isinstance(item, PathChunk):
            commands = item.commands
            blocks = [block for k in places_of(commands) for block in commands[k]]  # type: ignore[index]
        else:
            blocks = [item]
        for block in blocks:
            if isinstance(block, Spindle) and block.rpm > self._speed.rpm:
                self._speed = block
        return item

    def _lowered_speed(self) -> Iterator[Diagnostic]:
        """Yield a warning if the board lowers a spindle speed to its own highest one."""
        speed, most = self._speed, self._board.settings.get(HIGHEST_SPEED, math.inf)
        if speed.rpm > most > 0.0:
            message = (
                f"S{speed.rpm:g} is above the highest speed of the board, which takes S{most:g}"
            )
            hint = f"program S{most:g} at most, or correct ${HIGHEST_SPEED} of the board"
            yield Diagnostic(
                "speed-above-board", message, speed.file, speed.line, hint=hint, severity="warning"
            )

    def _unused_tool_change(self) -> Iterator[Diagnostic]:
        """Yield a warning if the board has a tool change of its own, which is not used."""
        text, tool = self._board.unused_tool_change, self._tool
        if text and tool is not None:
            message = f"the board gets no M6: {text}; cncrun waits for you instead"
            hint = (
                "measure the tools before, and enter their lengths in the tool table (cncrun "
                "tools); with $341=0 the board itself waits"
            )
            yield Diagnostic(
                "tool-change-mode", message, tool.file, tool.line, hint=hint, severity="warning"
            )

    def _unused_modes(self) -> Iterator[Diagnostic]:
        """Yield a warning if the machine file has modes, which the board knows nothing of."""
        machine = self._context.reader.machine
        if machine.vibration:
            message = "the board plans its own motion, so [vibration] has no effect"
            hint = "use a board that plays pulses, or lower the acceleration of the board ($120)"
            yield Diagnostic(
                "vibration-on-board", message, machine.file, hint=hint, severity="warning"
            )

    def _write_plan(self) -> None:
        """Write the outputs that describe our plan: the trace and the picture."""
        context = self._context
        if not context.needs_plan:
            return
        planner = LookAhead(context.reader.machine, judged=False)
        for _ in self._motion.recorded_plan(planner, self._motion.path(for_lines=True)):
            pass

    def _largest(self) -> Extremes:
        """Return the largest values of the motion as the board plans it."""
        largest = self.timing.largest
        return Extremes(
            feed=largest.speed,
            accel=largest.acceleration,
            axes={
                letter: {"velocity": velocity, "acceleration": acceleration, "jerk": None}
                for letter, velocity, acceleration in zip(
                    BOARD_LETTERS.lower(), largest.velocities, largest.accelerations, strict=False
                )
                if letter in self._context.reader.machine.axes
            },
        )

    def _limits(self) -> Extremes:
        """Return the limits in the report, those of the axes as the board keeps them."""
        limits, own = self._context.report.limits, self.timing.limits
        axes = dict(limits.axes)
        for letter, velocity, acceleration in zip(
            BOARD_LETTERS.lower(), own.rates, own.accelerations, strict=False
        ):
            if letter in axes:
                candidates = {"velocity": velocity, "acceleration": acceleration}
                axes[letter] = axes[letter] | {
                    name: value for name, value in candidates.items() if value < math.inf
                }
        return replace(limits, axes=axes)

    def _collected(self) -> list[Step] | None:
        """Return all steps, None if they cannot be kept; add up their duration."""
        kept: list[Step] | None = None if self._depends_on_answers else []
        capacity, timing = KEPT_BYTES, self.timing

        for step in self._steps(lambda lines: timing.add_rows(lines.rows, lines.sizes)):
            capacity -= step.lines.size
            if capacity < 0:
                kept = None
            if kept is not None:
                kept.append(step)
        timing.end()
        return kept
