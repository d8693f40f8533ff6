"""Data that the passes of a session share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cnc.planner.plan import PlanChunk
from cnc.report.result import Report
from cnc.session.observer import Observer
from cnc.session.options import RunOptions
from cnc.session.outputs import OpenOutputs
from cnc.session.program_reader import ProgramReader


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
    """

    reader: ProgramReader
    report: Report
    observer: Observer
    options: RunOptions
    files: OpenOutputs
    has_operator: bool
    on_plan: Callable[[PlanChunk], None] | None

    @property
    def needs_plan(self) -> bool:
        """Whether an output describes our own plan."""
        options = self.options
        return options.sampled or options.outputs.picture is not None or self.on_plan is not None
