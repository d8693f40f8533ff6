"""The run pass that makes pulses: on a board that plays them, or without a board."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cnc.boards.protocols import FeasibilityCheck, PulseSink
from cnc.machine.models import Machine
from cnc.model.blocks import Block, Held, TipControl
from cnc.model.choices import Algorithm
from cnc.model.diagnostics import BoardError, Diagnostic, MotionLimitError
from cnc.model.operator_control import Control
from cnc.model.streams import PulseChunk
from cnc.planner.joints import Joints
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk, RunClock
from cnc.planner.window import LONG, SLICE
from cnc.pulses.reference_pulse import ReferencePulse
from cnc.report.pulses import PulseWriter, pulse_writer
from cnc.session.context import SessionContext, TimedInterpolator
from cnc.session.nut_sides import ending_pushed_up
from cnc.session.pipeline import PathItems, PlanItems, PlannedMotion
from cnc.session.required_capabilities import expected_capabilities, known_driver, pause_text
from cnc.session.run_pulses import Outcome, Progress, execute

OnPulses = Callable[[PulseChunk], None]
SEPARATE: Algorithm = "crossings"
"""Algorithm for boards with a queue for each axis: each axis steps by itself."""


@dataclass(frozen=True, slots=True)
class Schedule:
    """Machine time of the grid moves of a program, as rehearsed.

    Attributes:
        rows: Number of grid moves at the end of each chunk of the plan (n,), from 0.
        times: Machine time there (n,), s.
        duration: Machine time of the whole program, s.
    """

    rows: NDArray[np.int64]
    times: NDArray[np.float64]
    duration: float

    def left(self, progress: Progress, feed_override: float) -> float:
        """Return the time until the end of the program at a feed override in per cent, s."""
        done = float(np.interp(progress.rows, self.rows, self.times))
        return max((self.duration - done) * 100.0 / feed_override, 0.0) + (progress.ahead or 0.0)


class PulsePass:
    """Makes the pulses of a program, sends them to a board if there is one, and fills the report.

    Args:
        context: The session.
        motion: Plans the path.
        board: The board, or None.
    """

    def __init__(
        self, context: SessionContext, motion: PlannedMotion, board: PulseSink | None
    ) -> None:
        self._context, self._motion, self._board = context, motion, board
        self._machine, self._control = context.reader.machine, context.observer.control
        self._joints = Joints(self._machine)
        self._scale = self._joints.machine.steps_per_mm
        self._tips: Callable[[NDArray[np.float64]], NDArray[np.float64]] = self._joints.tips
        self._fastest = self._machine.board.max_step_rate
        can = expected_capabilities(self._machine) if board is None else board.capabilities
        if board is not None:
            self._fastest = min(self._fastest, board.capabilities.max_step_rate)
        self._algorithm: Algorithm | None = context.options.algorithm
        self._separate = can is not None and can.separate_axes
        if self._separate:
            if self._algorithm not in (None, SEPARATE):
                context.observer.warn(_other_algorithm(self._algorithm))
            self._algorithm = SEPARATE
        self._schedule: Schedule | None = None
        self._planner: LookAhead | None = None

    def run(self, kept: PathItems | None, before_motion: Callable[[], None]) -> None:
        """Make all pulses.

        Args:
            kept: The path; None to read it again.
            before_motion: Called when everything is checked and nothing has moved.
        """
        context, motion, board = self._context, self._motion, self._board
        interpolator = self._interpolator()
        self._tips = self._joints.tips_from(self._joints.at(context.reader.start))
        writer: PulseWriter | None = None
        on_pulses: OnPulses | None = None
        target = context.options.outputs.pulses
        if target is not None:
            writer = pulse_writer(target, self._joints, interpolator.origin_steps)
            on_pulses = context.files.opened(writer).write
        feasibility = None if board is None else board.feasibility_check()
        if feasibility is not None:
            self._schedule = self._rehearse(feasibility, kept)
        path = kept if kept is not None else motion.path(for_lines=False)
        slice_s = LONG if board is None else board.capabilities.slice_s or SLICE
        planner = LookAhead(self._machine, self._control, slice_s=slice_s)
        planned = _without_tip_control(motion.recorded_plan(planner, path), writer)
        pulses = TimedInterpolator(
            ending_pushed_up(interpolator, self._joints), motion.interpolating_time
        )
        try:
            if board is None:
                self._compute(planned, pulses, on_pulses)
            else:
                if self._waits_for_operator(board):
                    planned = self._with_holds(planned)
                before_motion()
                self._end(self._send(planned, pulses, on_pulses, board, planner))
        finally:
            motion.record_audit(planner)
            context.report.pulse_error_blu = interpolator.error_blu

    def _waits_for_operator(self, board: PulseSink) -> bool:
        context = self._context
        return (
            context.options.pauses == "wait"
            and context.has_operator
            and bool(board.capabilities.slice_s)
        )

    def _with_holds(self, planned: PlanItems) -> Iterator[PlanChunk | Block]:
        """Yield the plan, with a hold after each block that waits for the operator."""
        for item in planned:
            yield item
            if isinstance(item, Block) and (reason := pause_text(item, self._context.reader)):
                self._context.observer.pause_at(item)
                self._control.hold()
                yield Held(item.file, item.line, reason)

    def _interpolator(self) -> ReferencePulse:
        context = self._context
        return ReferencePulse(
            self._joints.machine.steps_per_mm,
            self._joints.at(context.reader.start),
            1e9 / self._fastest,
            algorithm=self._algorithm,
            separate_axes=self._separate,
            tip_columns=self._joints.tip_columns,
        )

    def _rehearse(self, feasibility: FeasibilityCheck, kept: PathItems | None) -> Schedule:
        """Compute the whole motion before any of it, for a board that cannot play every program.

        Raises:
            MotionLimitError: If the board cannot play the motion.
        """
        context, motion = self._context, self._motion
        path = kept if kept is not None else motion.path(for_lines=False)
        pulses = TimedInterpolator(self._interpolator(), motion.interpolating_time)
        rows, times, made, clock = [0], [0.0], 0, RunClock()
        planner = LookAhead(self._machine, Control(self._control.feed_override), slice_s=LONG)
        for item in motion.plan(planner, path):
            context.observer.checking(context.report.lines)
            clock.add(item)
            if isinstance(item, PlanChunk):
                for chunk in pulses.pulses(item):
                    _add_to(feasibility, chunk, item)
                    made += len(chunk.step)
                rows.append(made)
                times.append(clock.seconds)
        return Schedule(np.array(rows), np.array(times), clock.seconds)

    def _compute(
        self, planned: PlanItems, pulses: TimedInterpolator, on_pulses: OnPulses | None
    ) -> None:
        """Make, count and write the pulses without a board."""
        report, observer = self._context.report, self._context.observer
        feasibility = _expected_feasibility(self._joints.machine)

        def count(chunks: Iterable[PulseChunk], planned: PlanChunk | None = None) -> None:
            for chunk in chunks:
                if feasibility is not None and planned is not None:
                    _add_to(feasibility, chunk, planned)
                report.pulse_rows += len(chunk.step)
                if on_pulses is not None:
                    on_pulses(chunk)

        for item in planned:
            observer.running(item)
            if isinstance(item, Held):
                self._control.wait()
            if isinstance(item, PlanChunk):
                count(pulses.pulses(item), item)
        count(pulses.settle())
        steps = pulses.steps_made.tolist()
        report.steps = dict(zip(self._joints.machine.axes, steps, strict=True))

    def _send(
        self,
        planned: PlanItems,
        pulses: TimedInterpolator,
        on_pulses: OnPulses | None,
        board: PulseSink,
        planner: LookAhead,
    ) -> Outcome:
        """Send the pulses; the executor brings the motion to rest after a stop request."""
        # The executor carries out stop requests from here on.
        self._planner = planner
        self._sent(Progress(0.0, 0, 0))
        try:
            return execute(
                planned,
                board,
                pulses,
                on_pulses=on_pulses,
                on_progress=self._sent,
                control=self._control,
                ramp_down=planner.ramp_down,
                laser=self._machine.kind == "laser",
            )
        except BoardError:
            self._record_position(self._tips(board.position_steps[None] / self._scale)[0])
            raise

    def _end(self, outcome: Outcome) -> None:
        """Record the outcome of a run."""
        report = self._context.report
        report.steps = dict(zip(self._joints.machine.axes, outcome.steps.tolist(), strict=True))
        report.pulse_rows = outcome.rows
        report.stopped_at_line = outcome.stopped_at_line
        if not outcome.finished:
            report.duration_s = outcome.duration
            self._record_position(self._joints.tip(outcome.position_steps / self._scale))

    def _sent(self, progress: Progress) -> None:
        if self._schedule is not None:
            left = self._schedule.left(progress, self._control.feed_override)
            progress = replace(progress, left=left)
        if self._planner is not None and (pending := self._planner.pending) > 0.0:
            progress = replace(progress, pending=pending + (progress.ahead or 0.0))
        progress = replace(progress.of_tip(self._tips), axes=self._machine.axis_names)
        self._context.observer.sent(progress)

    def _record_position(self, tip: NDArray[np.float64]) -> None:
        """Record the position (axes,) after a program that did not reach its end."""
        places = zip(self._machine.axes, tip.tolist(), strict=True)
        self._context.report.end_position = dict(places)


def _without_tip_control(
    planned: PlanItems, writer: PulseWriter | None
) -> Iterator[PlanChunk | Block]:
    """Yield the plan without tool-tip control, which only the writer of the pulses needs."""
    for item in planned:
        if isinstance(item, TipControl):
            if writer is not None:
                writer.control_tip(item)
        else:
            yield item


def _add_to(feasibility: FeasibilityCheck, chunk: PulseChunk, planned: PlanChunk) -> None:
    """Add grid moves of a chunk of the plan. Raises MotionLimitError at their line."""
    try:
        feasibility.add(chunk)
    except MotionLimitError as error:
        raise error.at(file=planned.path.file) from error


def _other_algorithm(asked: str) -> Diagnostic:
    message = f"the board has a queue for each axis: {SEPARATE} is used instead of {asked}"
    hint = f"leave --algorithm out, or name {SEPARATE}"
    return Diagnostic("algorithm-not-used", message, hint=hint, severity="note")


def _expected_feasibility(machine: Machine) -> FeasibilityCheck | None:
    """Return the check of the board in the machine file, if its driver has one without a board."""
    driver = known_driver(machine.board.kind)
    if driver is None or driver.takes == "lines":
        return None
    return driver.expected_feasibility_check(machine)
