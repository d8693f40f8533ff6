"""The run pass on a board that plans for itself: the plan as lines, and the operator's requests.

All lines are made before the first is sent, so that nothing moves if one of them cannot be made.
They are kept in memory. They are made again while they are sent, if there are too many or if
answers decide how the program continues.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from cnc.boards.protocols import LineSink
from cnc.executor.lines import Step, steps, stream
from cnc.executor.run import Progress
from cnc.grbl_lines.countdown import Countdown
from cnc.grbl_lines.grbl_timing import BoardTime
from cnc.grbl_lines.lowered_feeds import LoweredFeeds
from cnc.model.diagnostics import BoardError, Diagnostic
from cnc.model.streams import GcodeLine
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.session.board_offsets import board_timing, line_translator, offset_lines
from cnc.session.context import SessionContext
from cnc.session.pauses import pause_reason, pause_text
from cnc.session.planned_motion import PlannedMotion

KEPT_BYTES = 192_000_000
"""Limit on the lines that are kept before the first is sent: about two million of them."""


class LinePass:
    """Sends a program as lines and fills the report.

    Args:
        context: The session.
        motion: Plans the path.
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

    def run(self, before_motion: Callable[[], None]) -> None:
        """Send all lines. ``before_motion`` is called when the lines are known."""
        context, board = self._context, self._board
        report, machine, control = context.report, context.reader.machine, context.observer.control
        recorded = not self._depends_on_answers
        kept = self._collected(self._steps(recorded=recorded), self.timing)
        self._warn(self._lowered.findings())
        countdown = Countdown(self.timing)

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
            context.observer.sent(replace(progress, left=left))

        before_motion()
        began = board.now()
        on_progress(Progress(0.0, 0, 0))
        try:
            outcome = stream(
                self._steps(recorded=not recorded) if kept is None else kept,
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
            report.duration_s = outcome.duration
        if not board.check_only:
            report.played_s = board.now() - began
            report.end_position = dict(zip(machine.axes, outcome.position, strict=False))

    def _steps(self, *, recorded: bool) -> Iterator[Step]:
        """Yield the program as lines; ``recorded``: the report describes this plan."""
        motion, machine = self._motion, self._context.reader.machine
        planner = LookAhead(machine, judged=False)
        path = motion.path(smooth=True)
        planned = motion.recorded_plan(planner, path) if recorded else motion.plan(planner, path)
        if self._context.options.pauses == "skip":
            planned = (
                item for item in planned if isinstance(item, PlanChunk) or not pause_reason(item)
            )
        translator = line_translator(self._board, machine)
        self._lowered = translator.lowered
        try:
            yield from steps(planned, translator)
        finally:
            if recorded:
                motion.record_audit(planner)

    def _collected(self, program: Iterable[Step], timing: BoardTime) -> list[Step] | None:
        """Return all steps, None if they cannot be kept; add up their duration."""
        kept: list[Step] | None = None if self._depends_on_answers else []
        capacity = KEPT_BYTES
        for step in program:
            for line in step.lines:
                timing.add(line)
            capacity -= step.lines.size
            if capacity < 0:
                kept = None
            if kept is not None:
                kept.append(step)
        timing.end()
        return kept
