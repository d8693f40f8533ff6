"""Reader, path and plan of a program, joined, and the results that the report takes from the plan.

reader ──► blocks ──► path of the tip ──► faster of spline and corners ──► joints ──► plan
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.checks.travel import BlockTimes, TravelCheck
from cnc.machine.models import Machine
from cnc.model.blocks import Block
from cnc.model.diagnostics import Diagnostic, MotionLimitError
from cnc.model.streams import SampleChunk
from cnc.path.build import DueTimes, build, exact_path
from cnc.path.chunk import PathChunk
from cnc.planner.corner_choice import with_faster_paths
from cnc.planner.joints import Joints
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk, RunClock
from cnc.pulses.sampled import Sampled
from cnc.report.trace import TraceWriter, trace_writer
from cnc.session.context import SessionContext, Stopwatch
from cnc.session.program_reader import ProgramReader

PlanItems = Iterable[PlanChunk | Block]
PathItems = Iterable[PathChunk | Block]

MOST_SECONDS = 1e9
"""Longest machine time of a program, s: 31 years. Pulses have times in ns, in 64 bits."""


def path_of(
    blocks: Iterable[Block],
    machine: Machine,
    start: NDArray[np.float64],
    *,
    due_times: DueTimes | None = None,
    certain: bool = True,
) -> Iterator[PathChunk | Block]:
    """Yield the path of blocks for a planner, and the blocks that do not move.

    Behind the columns of the axes are those of the joints, where the joints are not the axes. Where
    these are not a linear function of the axes, the time of a motion depends on the pose, and the
    path has splines. It has them where the motion is shaped, too: corners would be stops.

    Args:
        blocks: The blocks.
        machine: The machine.
        start: The tip before the path (axes,), mm.
        due_times: Receives the times of the blocks under G93; None for no record.
        certain: Where the tip leaves a joint free, as at the pole of a table, it stands at 0.

    Raises:
        GcodeError: As :func:`cnc.path.build.build`.
        MotionLimitError: As :meth:`cnc.planner.joints.Joints.path`.
    """
    joints = Joints(machine)
    path = build(
        blocks,
        axes=machine.axis_names,
        start=start,
        tolerance=machine.path.tolerance,
        due_times=due_times,
        short_legs=joints.short_legs,
        offers_corners=joints.linear and not machine.vibration,
    )
    return joints.path(with_faster_paths(path, machine), start, certain=certain)


def program_path(
    reader: ProgramReader, blocks: Iterable[Block], *, for_lines: bool
) -> Iterator[PathChunk | Block]:
    """Yield the path of the blocks of a program, and the blocks that do not move.

    Args:
        reader: The reader of the program.
        blocks: Its blocks.
        for_lines: Whether the path has no blends, for a board that plans for itself.
    """
    if for_lines:
        return exact_path(blocks, axes=reader.machine.axis_names, start=reader.start)
    if reader.due_times is not None:
        reader.due_times.clear()
    return path_of(blocks, reader.machine, reader.start, due_times=reader.due_times)


def _too_long(item: PlanChunk | Block) -> MotionLimitError:
    """Return the fault of a program whose machine time is not a plausible one."""
    if isinstance(item, PlanChunk):
        file, line = item.path.file, int(item.path.line[-1])
    else:
        file, line = item.file, item.line
    message = "up to this line the program takes more than 31 years"
    hint = "correct F or the dwells, or the limits of the machine file"
    return MotionLimitError(Diagnostic("run-too-long", message, file, line, hint=hint))


class PlannedMotion:
    """Plans the path and fills the report: duration and largest values.

    Attributes:
        reading_time: Time spent in the reader, s.
        planning_time: Time spent in the reader and the planner, s.
        interpolating_time: Time spent in the interpolators, s.
    """

    def __init__(self, context: SessionContext) -> None:
        self.reading_time, self.planning_time = Stopwatch(), Stopwatch()
        self.interpolating_time = Stopwatch()
        self._context, self._machine = context, context.reader.machine

    def path(self, *, for_lines: bool) -> Iterator[PathChunk | Block]:
        """Read the path again and compare it with the travel.

        A program that depends on answers of probes and inputs may take another path than in the
        check pass.

        Args:
            for_lines: Whether the path has no blends, for a board that plans for itself.

        Raises:
            MotionLimitError: If the path leaves the travel.
        """
        reader, machine = self._context.reader, self._machine
        blocks = self.reading_time.inside(reader.blocks())
        survey = TravelCheck(machine)
        for item in program_path(reader, blocks, for_lines=for_lines):
            if isinstance(item, PathChunk):
                for fault in survey.add(item):
                    raise fault
            else:
                survey.between(item)
            yield item

    def plan(self, planner: LookAhead, path: PathItems) -> PlanItems:
        """Plan a path without a record in the report."""
        return self.planning_time.inside(planner.plan(path))

    def recorded_plan(self, planner: LookAhead, path: PathItems) -> PlanItems:
        """Plan a path; record its duration, picture and samples."""
        planned = self._recorded(self.plan(planner, path))
        return self._sampled(planned) if self._context.options.sampled else planned

    def record_audit(self, planner: LookAhead) -> None:
        """Copy the largest values and the violations from the planner's audit to the report."""
        audit, report = planner.audit, self._context.report
        largest = report.largest
        largest.feed, largest.accel, largest.jerk = audit.feed, audit.accel, audit.jerk
        largest.normal_accel, largest.chord_error = audit.normal_accel, audit.chord_error
        largest.step_deviation = audit.step_deviation
        joints, tip = self._machine.joint_tables, planner.limits.tip_columns
        values = zip(
            joints,
            audit.axis_velocity[tip:].tolist(),
            audit.axis_acceleration[tip:].tolist(),
            audit.axis_jerk[tip:].tolist(),
            strict=True,
        )
        largest.axes = {
            axis: {"velocity": v, "acceleration": a, "jerk": j} for axis, v, a, j in values
        }
        report.violations.update(audit.violations)

    def _recorded(self, planned: PlanItems) -> Iterator[PlanChunk | Block]:
        """Yield the plan; keep the duration up to date and add each item to the picture."""
        context = self._context
        report, reader, picture = context.report, context.reader, None
        if context.options.outputs.picture is not None:
            from cnc.view.writer import picture_writer  # most programs have no picture

            picture = context.files.opened(
                picture_writer(context.options.outputs.picture, report, reader.path, reader.start)
            )
        clock = RunClock()
        due = reader.due_times
        times = None if due is None else BlockTimes(due, self._machine.path.period)
        for item in planned:
            clock.add(item)
            if times is not None:
                self._warn(times.add(item))
            report.duration_s = clock.seconds
            if clock.seconds > MOST_SECONDS:
                raise _too_long(item)
            if isinstance(item, PlanChunk) and context.on_plan is not None:
                context.on_plan(item)
            if picture is not None:
                picture.add(item)
            yield item
        if times is not None:
            self._warn(times.end())

    def _warn(self, findings: Iterable[Diagnostic]) -> None:
        for finding in findings:
            self._context.observer.warn(finding)

    def _sampled(self, planned: PlanItems) -> Iterator[PlanChunk | Block]:
        """Yield the plan; sample each chunk and write the trace."""
        context = self._context
        start = Joints(self._machine).columns(context.reader.start)
        sampler = Sampled(self._machine.path.period, start)
        target = context.options.outputs.trace
        trace = None
        if target is not None:
            trace = context.files.opened(trace_writer(target, self._machine))
        for item in planned:
            if isinstance(item, PlanChunk):
                self._record_samples(sampler.samples(item), trace)
            yield item
        self._record_samples(sampler.finish(context.report.duration_s), trace)

    def _record_samples(self, chunks: Iterable[SampleChunk], trace: TraceWriter | None) -> None:
        for chunk in self.interpolating_time.inside(chunks):
            if trace is not None:
                trace.write(chunk)
