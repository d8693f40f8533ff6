"""Who looks on while a program is under way: told how far it is and what was found, and able to
stop it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from cnc.checks.selection import Selection
from cnc.executor.run import Progress
from cnc.model.blocks import Block
from cnc.model.diagnostics import Diagnostic
from cnc.model.operator_control import Control
from cnc.planner.plan import PlanChunk
from cnc.report.result import Report
from cnc.session.checkpoint import Recorder

Stage = Literal["checking", "running"]
Pauses = Literal["wait", "refuse", "skip"]
"""What becomes of M0 and M6: the operator is waited for, or the program is refused, or goes on."""

MOST_WARNINGS = 100
"""Warnings and notes of one code that are told and kept; the rest are counted, so that many of one
hide none of another.
"""


@dataclass(frozen=True, slots=True)
class Watch:
    """Who is told what while it happens.

    on_progress(stage, done, total): lines of the program; total is None in the first pass.
    on_warning: findings that end nothing. on_compiling: before the first run ever, which takes
    longer. on_sent: how far the board is. on_beginning: what will be done to begin in the middle of
    a program; False ends the run before anything has moved.
    """

    on_progress: Callable[[Stage, int, int | None], None] | None = None
    on_warning: Callable[[Diagnostic], None] | None = None
    on_compiling: Callable[[], None] | None = None
    on_sent: Callable[[Progress], None] | None = None
    on_beginning: Callable[[Sequence[str]], bool] | None = None


class Stopped(Exception):
    """The operator wants to stop, and nothing has moved yet."""


class Lookout:
    """Stands between a job and those who watch it.

    last_line: the last line of the program that does anything, once it is known. recorder: what
    keeps how far a run has come.
    """

    def __init__(
        self, watch: Watch, control: Control, selection: Selection, report: Report
    ) -> None:
        self.watch = watch
        self.control = control
        self.last_line = 0
        self.recorder: Recorder | None = None
        self._selection = selection
        self._report = report
        self._warned: set[tuple[str, str, int, int]] = set()

    def checking(self, executed: int) -> None:
        """So many lines are read. Raises Stopped."""
        self._look_up("checking", executed, None)

    def running(self, item: PlanChunk | Block) -> None:
        """The second pass has come to an item. Raises Stopped."""
        self._look_up(
            "running",
            int(item.path.line[-1]) if isinstance(item, PlanChunk) else item.line,
            self.last_line,
        )

    def _look_up(self, stage: Stage, line: int, total: int | None) -> None:
        if self.control.stopped:
            raise Stopped
        if self.watch.on_progress is not None:
            self.watch.on_progress(stage, line, total)

    def tell(self, progress: Progress) -> None:
        """How far the board is."""
        if self.recorder is not None:
            self.recorder.note(progress)
        if self.watch.on_progress is not None:
            self.watch.on_progress("running", progress.line, self.last_line)
        if self.watch.on_sent is not None:
            self.watch.on_sent(progress)

    def warn(self, diagnostic: Diagnostic) -> None:
        """Tell and keep a warning once for its place, however often a loop comes by."""
        report, place = (
            self._report,
            (diagnostic.code, diagnostic.file, diagnostic.line, diagnostic.column),
        )
        if place in self._warned or not self._selection.wants(diagnostic):
            return
        if sum(each.code == diagnostic.code for each in report.warnings) >= MOST_WARNINGS:
            report.hidden_warnings += 1
            return
        self._warned.add(place)
        report.warnings.append(diagnostic)
        if self.watch.on_warning is not None:
            self.watch.on_warning(diagnostic)
