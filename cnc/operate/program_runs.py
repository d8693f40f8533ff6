"""Programs of an operator session: their run by a session, and its events."""

from __future__ import annotations

import itertools
import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cnc.model.diagnostics import CncError, Diagnostic, UsageError
from cnc.operate.events import (
    Dialog,
    DialogClosed,
    EventStream,
    Finding,
    JobEnded,
    JobProgress,
    Notice,
    Outcome,
)
from cnc.report.result import Report
from cnc.session.context import Callbacks, Stage
from cnc.session.program_reader import MDI_NAME
from cnc.session.run_pulses import Progress

QUESTIONS = itertools.count(1)
PROGRESS_PERIOD = 0.1
"""Shortest time between two events of the progress, s."""

Approach = tuple[tuple[float, ...], ...]
"""Places (axes,) of the moves to the line to begin at, mm."""
DialogKind = Literal["tool", "stop", "restart", "door", "reading", "todo"]


@dataclass(slots=True)
class Question:
    """A question, and its answer.

    Attributes:
        dialog: The question.
        answered: Set when it is answered or closed.
        yes: Whether the operator agrees; not before the answer.
        value: The number of a reading.
    """

    dialog: Dialog
    answered: threading.Event
    yes: bool = False
    value: float = 0.0


class Dialogs:
    """The open question to the operator; there is at most one.

    Args:
        events: Receives the questions.
    """

    def __init__(self, events: EventStream) -> None:
        self._events = events
        self._open: Question | None = None
        self._lock = threading.Lock()

    @property
    def open(self) -> Dialog | None:
        """The open question."""
        question = self._open
        return None if question is None else question.dialog

    def show(self, kind: DialogKind, text: str) -> Dialog:
        """Ask; an older question is closed."""
        return self.begin(kind, text).dialog

    def begin(
        self,
        kind: DialogKind,
        text: str,
        doubts: Sequence[Diagnostic] = (),
        steps: Sequence[str] = (),
        approach: Approach = (),
    ) -> Question:
        """Ask as :meth:`show`; return the question, which is answered later."""
        self.close()
        dialog = Dialog(
            id=next(QUESTIONS),
            kind=kind,
            text=text,
            doubts=tuple(map(Finding.of, doubts)),
            steps=tuple(steps),
            approach=approach,
        )
        question = Question(dialog, threading.Event())
        with self._lock:
            self._open = question
        self._events.emit(dialog)
        return question

    def ask(
        self,
        kind: DialogKind,
        text: str,
        doubts: Sequence[Diagnostic] = (),
        steps: Sequence[str] = (),
        approach: Approach = (),
    ) -> bool:
        """Ask, and wait for the answer."""
        # An answer may come before the event has reached every listener.
        question = self.begin(kind, text, doubts, steps, approach)
        question.answered.wait()
        return question.yes

    def answer(self, number: int, yes: bool, value: float | None = None) -> Dialog | None:
        """Answer a question; return it, None if it is not open any more.

        Args:
            number: The question.
            yes: Whether the operator agrees.
            value: The number of a reading.

        Raises:
            UsageError: ``reading-missing`` for a reading without a number; it stays open.
        """
        with self._lock:
            question = self._open
            if question is None or question.dialog.id != number:
                return None
            if yes and question.dialog.kind == "reading":
                if value is None or not math.isfinite(value):
                    message = f"no number for: {question.dialog.text.splitlines()[-1]}"
                    raise UsageError(
                        Diagnostic("reading-missing", message, hint="give it in mm, such as 0.043")
                    )
                question.value = value
            question.yes = yes
        self.close()
        return question.dialog

    def close(self) -> None:
        """Close the open question, as not answered unless an answer is set."""
        with self._lock:
            question, self._open = self._open, None
        if question is not None:
            question.answered.set()
            self._events.emit(DialogClosed(id=question.dialog.id))


class RunWatch:
    """Makes the events of one run, and answers its questions.

    Args:
        program: Name of the program in the events.
        events: Receives the events.
        dialogs: Asks the operator.
        on_progress: Called with the progress of the board.
        on_pause: Called with the question of a pause, and with None at its end.
        skipped: Lines before the first line of the operator's text.
    """

    def __init__(
        self,
        program: str,
        events: EventStream,
        dialogs: Dialogs,
        on_progress: Callable[[Progress], None],
        on_pause: Callable[[Dialog | None], None],
        skipped: int = 0,
    ) -> None:
        self._on_pause = on_pause
        self._program, self._events, self._dialogs = program, events, dialogs
        self._on_progress = on_progress
        self._skipped = skipped
        self._shown: tuple[Stage, int, float] = ("checking", -1, 0.0)
        self._reason = ""
        self._approach: Approach = ()
        self._doubts: list[Diagnostic] = []

    def callbacks(self) -> Callbacks:
        """Return the functions that the session calls."""
        return Callbacks(
            on_progress=self._progress,
            on_warning=self._warning,
            on_sent=self._sent,
            on_approach=self._take_approach,
            on_beginning=self._confirm,
        )

    def _confirm(self, steps: Sequence[str]) -> bool:
        """Ask whether to go to the first line; the question names what is doubtful."""
        text = "; ".join((*(doubt.message for doubt in self._doubts), steps[0]))
        return self._dialogs.ask("restart", text, self._doubts, steps[1:], self._approach)

    def _take_approach(self, places: Sequence[NDArray[np.float64]]) -> None:
        self._approach = tuple(tuple(place.tolist()) for place in places)

    def _progress(self, stage: Stage, line: int, lines: int | None) -> None:
        before, shown, last = self._shown
        now = time.monotonic()
        if stage != before or (line != shown and now - last >= PROGRESS_PERIOD):
            self._shown = stage, line, now
            self._events.emit(
                JobProgress(program=self._program, stage=stage, line=line, lines=lines)
            )

    def _warning(self, finding: Diagnostic) -> None:
        if finding.severity == "warning" and not finding.file:
            self._doubts.append(finding)
        if _own(finding, self._skipped):
            self._events.emit(Notice(finding=Finding.of(_moved(finding, self._skipped))))

    def _sent(self, progress: Progress) -> None:
        self._on_progress(progress)
        reason = progress.hold_reason if progress.held else ""
        if reason == self._reason:
            return
        self._reason = reason
        if not reason:
            self._on_pause(None)
            self._dialogs.close()
            return
        kind: DialogKind = "door"
        if reason.startswith("put in tool"):
            kind = "tool"
        elif reason.startswith(("the program stops here", "change the pallet")):
            kind = "stop"
        dialog = self._dialogs.show(kind, reason)
        self._on_pause(None if kind == "door" else dialog)


def ended(report: Report, program: str, skipped: int = 0) -> JobEnded:
    """Return the end of a run.

    Args:
        report: Its report.
        program: Name of the program.
        skipped: Lines before the first line of the operator's text.
    """
    stopped = report.stopped_at_line is not None
    outcome: Outcome = "failed" if report.faults else "stopped" if stopped else "done"
    own = [finding for finding in report.warnings if _own(finding, skipped)]
    findings = [fault.diagnostic for fault in report.faults] + own
    return JobEnded(
        program=program,
        outcome=outcome,
        seconds=report.duration_s,
        stopped_at_line=report.stopped_at_line or None,
        resume_line=report.resume_line,
        findings=tuple(Finding.of(_moved(finding, skipped)) for finding in findings),
        exit_code=report.exit_code,
    )


def failed(error: CncError, program: str) -> JobEnded:
    """Return the end of a run that could not begin."""
    return JobEnded(
        program=program,
        outcome="failed",
        findings=(Finding.of(error.diagnostic),),
        exit_code=error.exit_code,
    )


def _own(finding: Diagnostic, skipped: int) -> bool:
    """Return whether a finding is not about the modes that stand before the operator's text."""
    return finding.file != MDI_NAME or finding.line > skipped


def _moved(finding: Diagnostic, skipped: int) -> Diagnostic:
    if finding.file != MDI_NAME or finding.line <= skipped:
        return finding
    return replace(finding, line=finding.line - skipped)
