"""The second pass: the path is planned, made into pulses or lines, and sent to a board or only
looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cnc.boards.protocols import (
    ChecksFeasibility,
    FeasibilityCheck,
    KnownInAdvance,
    LineSink,
    PulseSink,
)
from cnc.boards.registry import board_factory
from cnc.checks.travel import ROUNDING, TravelCheck
from cnc.executor.lines import Step, steps, stream
from cnc.executor.run import Progress, execute
from cnc.grbl_lines.countdown import Countdown
from cnc.grbl_lines.grbl_timing import BoardTime
from cnc.grbl_lines.smooth import smooth_path
from cnc.machine.models import Machine
from cnc.model.blocks import Block, Held
from cnc.model.diagnostics import BoardError, MotionLimitError, UsageError
from cnc.model.operator_control import Control
from cnc.model.streams import GcodeLine, PulseChunk, SampleChunk
from cnc.outputs.pulses import pulse_writer
from cnc.outputs.trace import TraceWriter, trace_writer
from cnc.path.chunk import PathChunk
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.planner.run_clock import RunClock
from cnc.planner.window import LONG, SLICE
from cnc.pulses.reference_pulse import Algorithm, ReferencePulse
from cnc.pulses.sampled import Sampled
from cnc.report.result import Report
from cnc.session.board_offsets import clock, to_remember, translator, waits
from cnc.session.observer import Lookout, Pauses
from cnc.session.outputs import OpenOutputs, Outputs
from cnc.session.program_reader import Reading
from cnc.session.stopwatch import Stopwatch, TimedPulses
from cnc.view.writer import picture_writer

Items = Iterable[PlanChunk | Block]

KEPT_BYTES = 192_000_000
"""Memory for lines that are made before the first is sent: about two million lines. A longer
program is translated once more while it runs.
"""


class SecondPass:
    """Fills the report: duration, largest values, steps, and where the board stands in the end.

    sampled: sample the motion, too. pauses: what becomes of M0 and M6 on a board. operated: whether
    somebody can wish for anything. asks: whether what the board answers decides how the program
    goes on. on_plan: is shown the plan. ``board_time``: how long a board that plans for itself
    takes, as computed before it begins.
    """

    def __init__(
        self,
        reading: Reading,
        report: Report,
        lookout: Lookout,
        outputs: Outputs,
        files: OpenOutputs,
        *,
        algorithm: Algorithm | None,
        sampled: bool,
        pauses: Pauses,
        operated: bool,
        asks: bool,
        on_plan: Callable[[PlanChunk], None] | None,
    ) -> None:
        self.watch_reading, self.watch_planning, self.watch_interpolating = (
            Stopwatch(),
            Stopwatch(),
            Stopwatch(),
        )
        self._reading, self._report, self._lookout, self._outputs, self._files = (
            reading,
            report,
            lookout,
            outputs,
            files,
        )
        self._machine, self._control = reading.machine, lookout.control
        self._algorithm, self._sampled, self._pauses, self._operated = (
            algorithm,
            sampled,
            pauses,
            operated,
        )
        self._asks, self._on_plan = asks, on_plan
        self.board_time: BoardTime | None = None
        self._step_deviation = 0.0
        self._begin: Callable[[], None] | None = None
        self._schedule: tuple[NDArray[np.int64], NDArray[np.float64], float] | None = None

    def carry_out(
        self,
        board: PulseSink | LineSink | None,
        kept: Iterable[PathChunk | Block] | None,
        begin: Callable[[], None] | None = None,
    ) -> None:
        """Move, or only look. kept: the path, None to read it again. begin: called when all is
        known and nothing has moved.
        """
        self._begin = begin
        if isinstance(board, LineSink):
            self._stream(board)
            return
        report, machine = self._report, self._machine
        steps_per_mm = machine.steps_per_mm
        fastest = (
            machine.board.max_step_rate
            if board is None
            else min(machine.board.max_step_rate, board.capabilities.max_step_rate)
        )
        interpolator = ReferencePulse(
            steps_per_mm, self._reading.start, 1e9 / fastest, algorithm=self._algorithm
        )
        on_pulses = None
        if self._outputs.pulses is not None:
            on_pulses = self._files.opened(
                pulse_writer(self._outputs.pulses, machine, interpolator.origin_steps)
            ).write
        if isinstance(board, ChecksFeasibility):
            self._rehearse(board.feasibility_check(), fastest, kept)
        path = kept if kept is not None else self._read_again(smooth=False)
        slice_s = LONG if board is None else board.capabilities.slice_s or SLICE
        ahead = LookAhead(machine, self._control, slice_s=slice_s)
        planned = self._planned(ahead, path)
        pulses = TimedPulses(interpolator, self.watch_interpolating)
        try:
            if board is None:
                self._look(planned, pulses, on_pulses, _expected_feasibility(machine))
            else:
                if self._pauses == "wait" and self._operated and board.capabilities.slice_s:
                    planned = _held(planned, self._control.hold)
                self._send(planned, pulses, on_pulses, board, ahead)
        finally:
            self._note_audit(ahead)
            report.pulse_error_blu = interpolator.error_blu

    def _planned(self, ahead: LookAhead, path: Iterable[PathChunk | Block]) -> Items:
        """The plan of a path, as it is shown to whoever wants to see it."""
        planned = self._timed(self.watch_planning.inside(ahead.plan(path)))
        return self._traced(planned) if self._sampled else planned

    def _note_audit(self, ahead: LookAhead) -> None:
        audit, largest = ahead.audit, self._report.largest
        largest.feed, largest.accel, largest.jerk = audit.feed, audit.accel, audit.jerk
        largest.normal_accel, largest.chord_error = audit.normal_accel, audit.chord_error
        largest.step_deviation = self._step_deviation if self._sampled else audit.step_deviation
        each = zip(
            self._machine.axes,
            audit.axis_velocity.tolist(),
            audit.axis_acceleration.tolist(),
            audit.axis_jerk.tolist(),
            strict=True,
        )
        largest.axes = {
            axis: {"velocity": v, "acceleration": a, "jerk": j} for axis, v, a, j in each
        }
        self._report.violations.update(audit.violations)

    def _read_again(self, *, smooth: bool) -> Iterator[PathChunk | Block]:
        """The path once more, ``smooth`` for lines: by what probes and inputs answer it may go
        where the first pass did not.
        """
        reading, machine = self._reading, self._machine
        blocks, tolerance = self.watch_reading.inside(reading.blocks()), machine.path.tolerance
        survey = TravelCheck(machine, tolerance if smooth else ROUNDING)
        path = (
            smooth_path(blocks, axes=machine.axis_names, start=reading.start, tolerance=tolerance)
            if smooth
            else reading.route(blocks)
        )
        for item in path:
            if isinstance(item, PathChunk):
                for fault in survey.add(item):
                    raise fault
            else:
                survey.between(item)
            yield item

    def _timed(self, planned: Items) -> Iterator[PlanChunk | Block]:
        """Follow the machine's clock, and draw what goes by."""
        report, drawn = self._report, None
        if self._outputs.picture is not None:
            drawn = self._files.opened(
                picture_writer(
                    self._outputs.picture, report, self._reading.path, self._reading.start
                )
            )
        clock = RunClock()
        for item in planned:
            clock.add(item)
            report.duration_s = clock.seconds
            if isinstance(item, PlanChunk) and self._on_plan is not None:
                self._on_plan(item)
            if drawn is not None:
                drawn.add(item)
            yield item

    def _traced(self, planned: Items) -> Iterator[PlanChunk | Block]:
        """Sample every stretch of the plan as it goes by, and write the trace."""
        sampler = Sampled(self._machine.path.period, self._reading.start)
        trace = (
            None
            if self._outputs.trace is None
            else self._files.opened(trace_writer(self._outputs.trace, self._machine))
        )
        for item in planned:
            if isinstance(item, PlanChunk):
                self._note_samples(sampler.samples(item), trace)
            yield item
        self._note_samples(sampler.finish(self._report.duration_s), trace)

    def _note_samples(self, chunks: Iterable[SampleChunk], trace: TraceWriter | None) -> None:
        for chunk in self.watch_interpolating.inside(chunks):
            if len(chunk.step_deviation):
                self._step_deviation = max(
                    self._step_deviation, float(np.abs(chunk.step_deviation).max())
                )
            if trace is not None:
                trace.write(chunk)

    def _rehearse(
        self,
        feasibility: FeasibilityCheck,
        fastest: float,
        kept: Iterable[PathChunk | Block] | None,
    ) -> None:
        """The whole motion before any of it: whether the board can play it, and how long it takes.
        MotionLimitError.
        """
        machine, lookout, start = self._machine, self._lookout, self._reading.start
        path = kept if kept is not None else self._read_again(smooth=False)
        pulses = TimedPulses(
            ReferencePulse(
                machine.steps_per_mm,
                start,
                1e9 / fastest,
                algorithm=self._algorithm,
            ),
            self.watch_interpolating,
        )
        rows, at, made, clock = [0], [0.0], 0, RunClock()
        ahead = LookAhead(machine, Control(self._control.feed_override), slice_s=LONG)
        for item in self.watch_planning.inside(ahead.plan(path)):
            lookout.checking(self._report.lines)
            clock.add(item)
            if isinstance(item, PlanChunk):
                for chunk in pulses.pulses(item):
                    _bear(feasibility, chunk, item)
                    made += len(chunk.step)
                rows.append(made)
                at.append(clock.seconds)
        self._schedule = np.array(rows), np.array(at), clock.seconds

    def _left(self, progress: Progress) -> Progress:
        """With what is left of the rehearsed motion, if all goes on as now."""
        if self._schedule is None:
            return progress
        rows, at, until = self._schedule
        left = (
            (until - float(np.interp(progress.rows, rows, at)))
            * 100.0
            / self._control.feed_override
        )
        return replace(progress, left=max(left, 0.0) + (progress.ahead or 0.0))

    def _look(
        self,
        planned: Items,
        pulses: TimedPulses,
        on_pulses: Callable[[PulseChunk], None] | None,
        feasibility: FeasibilityCheck | None,
    ) -> None:
        """Without a board: make the pulses, count and write them."""
        report = self._report
        steps = np.zeros(len(self._machine.axes), np.int64)

        def seen(chunks: Iterable[PulseChunk], planned: PlanChunk | None = None) -> None:
            nonlocal steps
            for chunk in chunks:
                if feasibility is not None and planned is not None:
                    _bear(feasibility, chunk, planned)
                steps += [np.count_nonzero(column) for column in chunk.step.T]
                report.pulse_rows += len(chunk.step)
                if on_pulses is not None:
                    on_pulses(chunk)

        for item in planned:
            self._lookout.running(item)
            if isinstance(item, Held):
                self._control.wait()
            if isinstance(item, PlanChunk):
                seen(pulses.pulses(item), item)
        seen(pulses.settle())
        report.steps = dict(zip(self._machine.axes, steps.tolist(), strict=True))

    def _send(
        self,
        planned: Items,
        pulses: TimedPulses,
        on_pulses: Callable[[PulseChunk], None] | None,
        board: PulseSink,
        ahead: LookAhead,
    ) -> None:
        """With a board: the executor sends, and comes to rest on the path when the operator
        wishes.
        """
        report = self._report

        def tell(progress: Progress) -> None:
            self._lookout.tell(self._left(progress))

        if self._begin is not None:
            self._begin()
        # The board is about to move: from here on a wish to stop is the executor's to carry out.
        tell(Progress(0.0, 0, 0))
        try:
            outcome = execute(
                planned,
                board,
                pulses,
                on_pulses=on_pulses,
                on_progress=tell,
                control=self._control,
                ramp_down=ahead.ramp_down,
            )
        except BoardError:
            self._stands_at(board.position_steps)
            raise
        report.steps = dict(zip(self._machine.axes, outcome.steps.tolist(), strict=True))
        report.pulse_rows = outcome.rows
        report.stopped_at_line = outcome.stopped_at_line
        if not outcome.finished:
            report.duration_s = outcome.duration
            self._stands_at(outcome.position_steps)

    def _stands_at(self, grid: NDArray[np.int64]) -> None:
        """The program did not come to its end: where the board says it is."""
        axes = self._machine.axes.items()
        self._report.end_position = {
            letter: steps / axis.steps_per_mm
            for (letter, axis), steps in zip(axes, grid.tolist(), strict=True)
        }

    def _stream(self, board: LineSink) -> None:
        """With a board that plans for itself: lines, and the operator's wishes as the board knows
        them.

        All lines are made before the first is sent, so that nothing moves if one of them can't be:
        kept, unless answers are still missing or they are too many.
        """
        report, machine, control, tell = (
            self._report,
            self._machine,
            self._control,
            self._lookout.tell,
        )
        self.board_time = clock(board, machine)
        kept = self._made(self._steps(board, shown=not self._asks), self.board_time)
        countdown = Countdown(self.board_time)

        def afterwards() -> Iterable[GcodeLine]:
            state = self._reading.state
            return () if state is None else to_remember(board, machine, state[0].values)

        def on_progress(progress: Progress) -> None:
            done = progress.rows - (progress.buffered or 0)
            # The board follows the operator's feed override; those of traverses are its own.
            feed, rapid = control.feed_override, board.rapid_override
            rests = progress.held or not progress.rows
            left = countdown.left(
                board.now(), done, held=rests, feed_override=feed, rapid_override=rapid
            )
            tell(replace(progress, left=left))

        if self._begin is not None:
            self._begin()
        on_progress(Progress(0.0, 0, 0))
        try:
            program = self._steps(board, shown=self._asks) if kept is None else kept
            outcome = stream(
                program, board, control=control, on_progress=on_progress, afterwards=afterwards
            )
        except BoardError:
            report.end_position = dict(zip(machine.axes, board.position, strict=False))
            raise
        report.stopped_at_line = outcome.stopped_at_line
        if outcome.stopped_at_line is not None:
            report.duration_s = outcome.duration
            report.end_position = dict(zip(machine.axes, outcome.position, strict=False))

    def _steps(self, board: LineSink, *, shown: bool) -> Iterator[Step]:
        """The program as lines; ``shown``: its plan is the one that the report and the pictures are
        made from.
        """
        ahead = LookAhead(self._machine, judged=False)
        path = self._read_again(smooth=True)
        planned = (
            self._planned(ahead, path) if shown else self.watch_planning.inside(ahead.plan(path))
        )
        if self._pauses == "skip":
            planned = (item for item in planned if isinstance(item, PlanChunk) or not waits(item))
        try:
            yield from steps(planned, translator(board, self._machine))
        finally:
            if shown:
                self._note_audit(ahead)

    def _made(self, program: Iterable[Step], board_time: BoardTime) -> list[Step] | None:
        """All steps, their time added up; None if they can't be kept."""
        kept: list[Step] | None = None if self._asks else []
        room = KEPT_BYTES
        for step in program:
            for line in step.lines:
                board_time.add(line)
            room -= step.lines.size
            if room < 0:
                kept = None
            if kept is not None:
                kept.append(step)
        board_time.end()
        return kept


def _bear(feasibility: FeasibilityCheck, chunk: PulseChunk, planned: PlanChunk) -> None:
    """Grid moves of a stretch. MotionLimitError at their line."""
    try:
        feasibility.add(chunk)
    except MotionLimitError as error:
        raise error.at(file=planned.path.file) from error


def _expected_feasibility(machine: Machine) -> FeasibilityCheck | None:
    """Of the board that the machine file names, where its driver knows it without one."""
    try:
        factory = board_factory(machine.board.kind)
    except UsageError:
        return None
    return (
        factory.expected_feasibility_check(machine) if isinstance(factory, KnownInAdvance) else None
    )


def _held(planned: Items, hold: Callable[[], None]) -> Iterator[PlanChunk | Block]:
    """The same, held where the program wants the operator."""
    for item in planned:
        yield item
        if isinstance(item, Block) and (why := waits(item)):
            hold()
            yield Held(item.file, item.line, why)
