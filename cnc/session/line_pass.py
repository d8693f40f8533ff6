"""The run pass on a board that plans for itself: the path as lines, and the operator's requests.

All lines are made before the first is sent, so that nothing moves if one of them cannot be made.
They are kept in memory. They are made again while they are sent, if there are too many or if
answers decide how the program continues.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from cnc.boards.protocols import LineSink
from cnc.executor.lines import Step, steps, stream
from cnc.executor.run import Progress
from cnc.grbl_lines.countdown import Countdown
from cnc.grbl_lines.lowered_feeds import LoweredFeeds
from cnc.grbl_lines.number_format import BOARD_LETTERS
from cnc.model.blocks import Block, Tool
from cnc.model.diagnostics import BoardError, Diagnostic
from cnc.model.packed_lines import PackedLines
from cnc.model.streams import GcodeLine
from cnc.path.chunk import PathChunk
from cnc.planner.lookahead import LookAhead
from cnc.report.result import Extremes
from cnc.session.board_lines import board_timing, line_translator
from cnc.session.board_offsets import offset_lines
from cnc.session.context import SessionContext
from cnc.session.pauses import pause_reason, pause_text
from cnc.session.planned_motion import PlannedMotion
from cnc.session.present_line import PresentLine

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
                present.steps(self._steps() if kept is None else kept),
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
        """Return an item of the path; the first tool change is kept."""
        if self._tool is None and isinstance(item, Tool) and item.change:
            self._tool = item
        return item

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
        found = self.timing.largest
        return Extremes(
            feed=found.speed,
            accel=found.acceleration,
            axes={
                letter: {"velocity": velocity, "acceleration": acceleration, "jerk": None}
                for letter, velocity, acceleration in zip(
                    BOARD_LETTERS.lower(), found.velocities, found.accelerations, strict=False
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
                known = {"velocity": velocity, "acceleration": acceleration}
                axes[letter] = axes[letter] | {
                    name: value for name, value in known.items() if value < math.inf
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
