"""Data that the passes of a session share: outputs, callbacks and their observer, stopwatches."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from cnc.checks.selection import ASSUMPTIONS, Selection
from cnc.model.blocks import Block
from cnc.model.diagnostics import Diagnostic, GcodeError
from cnc.model.operator_control import Control
from cnc.model.streams import PulseChunk
from cnc.planner.plan import PlanChunk
from cnc.report.result import Report
from cnc.report.targets import STL_SUFFIXES, Output, check_picture, check_suffixes, suffix_of
from cnc.session.checkpoint import CheckpointWriter
from cnc.session.options import Outputs, RunOptions
from cnc.session.program_reader import ProgramReader
from cnc.session.resume import PausePlace
from cnc.session.run_pulses import Progress, PulseInterpolator

if TYPE_CHECKING:
    from cnc.stock.simulation import Material


# Output files of a session: each is complete, or it is not there.

OutputKind = TypeVar("OutputKind", bound=Output)


def check_outputs(outputs: Outputs) -> None:
    """Raise UsageError ``output-format`` for an unknown suffix."""
    check_suffixes(outputs.trace, outputs.pulses, outputs.lines)
    if outputs.stl is not None:
        suffix_of("stl", outputs.stl, STL_SUFFIXES)
    if outputs.picture is not None:
        check_picture(outputs.picture)


class OpenOutputs:
    """The output files that are being written."""

    def __init__(self) -> None:
        self._open: list[Output] = []

    def opened(self, output: OutputKind) -> OutputKind:
        """Register an output, so that it is closed with the others, and return it."""
        self._open.append(output)
        return output

    def close(self) -> None:
        """Complete all files."""
        for output in self._open:
            output.close()

    def discard(self) -> None:
        """Remove the files that are not complete."""
        for output in self._open:
            output.discard()


# Callbacks that follow a session, and the observer that calls them.

log = logging.getLogger(__name__)

Stage = Literal["checking", "running"]

MOST_WARNINGS = 100
"""Limit on reported warnings and notes of one code, so that one code cannot hide the others.

Further ones are counted.
"""


@dataclass(frozen=True, slots=True)
class Callbacks:
    """Functions that a session calls as it proceeds. Each may be None.

    Attributes:
        on_progress: Called with the stage, the lines done, and the lines in total (None during the
            check pass).
        on_warning: Called with each warning and note.
        on_compiling: Called before the kernels are compiled, on the first run on a computer.
        on_kernel: Called before each kernel is compiled: the number that are compiled, the number
            in total, and the name of this one.
        on_sent: Called with the progress of the board.
        on_cut: Called in a check with the material that the simulated cut leaves.
        on_approach: Called with the places (axes,) of the moves to ``from_line``, mm, before
            ``on_beginning``.
        on_beginning: Called with the steps that lead to ``from_line``. If it returns False, the run
            ends before anything moves.
    """

    on_progress: Callable[[Stage, int, int | None], None] | None = None
    on_warning: Callable[[Diagnostic], None] | None = None
    on_compiling: Callable[[], None] | None = None
    on_kernel: Callable[[int, int, str], None] | None = None
    on_sent: Callable[[Progress], None] | None = None
    on_cut: Callable[[Material], None] | None = None
    on_approach: Callable[[Sequence[NDArray[np.float64]]], None] | None = None
    on_beginning: Callable[[Sequence[str]], bool] | None = None


class StoppedBeforeMotion(Exception):
    """The operator stopped the session before anything moved."""


class Observer:
    """Reports progress and findings to the callbacks, and checks for a stop request.

    Attributes:
        callbacks: The functions to call.
        control: The operator's requests.
        last_line: The last source line with an effect, once the check pass has found it.
        checkpoint: The writer of the checkpoint file during a run on a machine.
        pauses: Number of pauses of the program that the run has reached.
        paused_at: Line of the last of them, 0 before the first.
    """

    def __init__(
        self, callbacks: Callbacks, control: Control, selection: Selection, report: Report
    ) -> None:
        self.callbacks = callbacks
        self.control = control
        self.last_line = 0
        self.checkpoint: CheckpointWriter | None = None
        self.pauses = self.paused_at = 0
        self._selection = selection
        self._report = report
        self._requests = (control.held, control.feed_override, control.stopped)
        self._held = False
        self._reported: set[tuple[str, str, int, int]] = set()
        self._reports: Counter[str] = Counter()
        """Reported warnings and notes of each code."""
        self._assumptions: dict[str, str] = {}

    def checking(self, lines_done: int) -> None:
        """Report progress of the check pass. Raises StoppedBeforeMotion."""
        self._stop_or_report("checking", lines_done, None)

    def running(self, item: PlanChunk | Block) -> None:
        """Report that the run pass has reached an item. Raises StoppedBeforeMotion."""
        line = int(item.path.line[-1]) if isinstance(item, PlanChunk) else item.line
        self._stop_or_report("running", line, self.last_line)

    def _stop_or_report(self, stage: Stage, line: int, total: int | None) -> None:
        self.log_requests()
        if self.control.stopped:
            raise StoppedBeforeMotion
        if self.callbacks.on_progress is not None:
            self.callbacks.on_progress(stage, line, total)

    def sent(self, progress: Progress) -> None:
        """Report the progress of the board."""
        self.log_requests()
        if progress.held != self._held:
            self._held = progress.held
            if progress.held:
                reason = progress.hold_reason or "hold request"
                log.info("line %d: the motion is held: %s", progress.line, reason)
            else:
                log.info("line %d: the motion continues", progress.line)
        if self.checkpoint is not None:
            self.checkpoint.note(progress)
        if self.callbacks.on_progress is not None:
            self.callbacks.on_progress("running", progress.line, self.last_line)
        if self.callbacks.on_sent is not None:
            self.callbacks.on_sent(progress)

    def pause_at(self, block: Block) -> None:
        """Note that the run comes to a pause for the operator."""
        self.pauses, self.paused_at = self.pauses + 1, block.line

    def log_requests(self) -> None:
        """Log the operator's requests since the last call.

        The requests are not logged where they are made, because that may be a signal handler.
        """
        control = self.control
        held, override, stopped = self._requests
        self._requests = (control.held, control.feed_override, control.stopped)
        if control.held != held:
            log.info("operator: %s", "hold" if control.held else "resume")
        if control.feed_override != override:
            log.info("operator: feed override %g %%", control.feed_override)
        if control.stopped and not stopped:
            log.info("operator: stop")

    def assumed(self, from_start: str) -> str:
        """Return what the reading assumes: from its start on, then the first of each finding."""
        return "; ".join((*([from_start] if from_start else []), *self._assumptions.values()))

    def warn(self, finding: Diagnostic) -> None:
        """Report a warning or note, once for each place in the program."""
        report = self._report
        if finding.code in ASSUMPTIONS:
            self._assumptions.setdefault(finding.code, f"line {finding.line}: {finding.message}")
        place = (finding.code, finding.file, finding.line, finding.column)
        if place in self._reported or not self._selection.wants(finding):
            return
        if self._reports[finding.code] >= MOST_WARNINGS:
            report.hidden_warnings += 1
            return
        self._reported.add(place)
        self._reports[finding.code] += 1
        if finding.code in self._selection.errors:
            report.faults.append(GcodeError(replace(finding, severity="error")))
            return
        log.info("%s: %s", finding.severity, finding.render())
        report.warnings.append(finding)
        if self.callbacks.on_warning is not None:
            self.callbacks.on_warning(finding)


@dataclass(frozen=True, slots=True)
class SessionContext:
    """One session: its input, its options, and where its results go.

    Attributes:
        reader: Reads the program.
        report: Filled by the passes.
        observer: Calls the callbacks and checks for a stop request.
        options: Options of the check or run.
        files: The output files that are open.
        has_operator: Whether somebody can make requests.
        on_plan: Called with each chunk of the plan that the report describes.
        after: The pause after which the run goes on; None for a run from the start or a line.
    """

    reader: ProgramReader
    report: Report
    observer: Observer
    options: RunOptions
    files: OpenOutputs
    has_operator: bool
    on_plan: Callable[[PlanChunk], None] | None
    after: PausePlace | None = None

    @property
    def first_line(self) -> int | None:
        """The line that the run begins at or after; None for the start of the program."""
        return self.options.from_line if self.after is None else self.after.line

    @property
    def needs_plan(self) -> bool:
        """Whether an output describes our own plan."""
        options = self.options
        return options.sampled or options.outputs.picture is not None or self.on_plan is not None


# Computing time of the stages of a session.
#
# Each stage draws its input through the stage before it. So a stopwatch around an iterator includes
# the stages that feed it.

Item = TypeVar("Item")


class Stopwatch:
    """Adds up the time spent inside iterators, s."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def inside(self, source: Iterable[Item]) -> Iterator[Item]:
        """Yield the items of ``source`` and time it."""
        iterator = iter(source)
        while True:
            began = perf_counter()
            try:
                item = next(iterator)
            except StopIteration:
                return
            finally:
                self.seconds += perf_counter() - began
            yield item


class TimedInterpolator:
    """An interpolator with a stopwatch, with the methods that the executor calls."""

    def __init__(self, interpolator: PulseInterpolator, stopwatch: Stopwatch) -> None:
        self._interpolator = interpolator
        self._stopwatch = stopwatch

    @property
    def origin_steps(self) -> NDArray[np.int64]:
        """Grid point at which the program begins (axes,)."""
        return self._interpolator.origin_steps

    @property
    def position_steps(self) -> NDArray[np.int64]:
        """Grid point after the pulses made so far (axes,)."""
        return self._interpolator.position_steps

    @property
    def steps_made(self) -> NDArray[np.int64]:
        """Number of steps of each axis (axes,) in the pulses made so far."""
        return self._interpolator.steps_made

    def pulses(self, chunk: PlanChunk) -> Iterator[PulseChunk]:
        """Yield the grid moves of a chunk of the plan."""
        return self._stopwatch.inside(self._interpolator.pulses(chunk))

    def settle(self) -> Iterator[PulseChunk]:
        """Yield the last grid move at the end of the path."""
        return self._interpolator.settle()

    def stand_at(self, grid: NDArray[np.int64]) -> None:
        """Continue from a grid point (axes,) that was not planned, such as a probe contact."""
        self._interpolator.stand_at(grid)
