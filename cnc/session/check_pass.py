"""The check pass: the whole program is read, and its path compared with the travel of the axes.

The simulation of the cut reads the program once more.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from cnc.checks.hints import Hints
from cnc.checks.travel import TravelCheck
from cnc.model.blocks import (
    ArcFeed,
    Block,
    BoardCommand,
    NurbsFeed,
    Polyline,
    Probe,
    TipControl,
    WaitInput,
)
from cnc.model.diagnostics import CncError
from cnc.model.motion_commands import places_of
from cnc.path.build import without_blends
from cnc.path.chunk import PathChunk
from cnc.report.blocks import BlockWriter
from cnc.session.context import SessionContext, Stopwatch
from cnc.session.kernel_needs import KernelNeeds
from cnc.session.pipeline import program_path
from cnc.session.required_capabilities import CapabilityCheck

MOST_FAULTS = 20
"""Limit on reported soft-limit faults. Further ones are counted."""
KEPT_NUMBERS = 8_000_000
"""Limit on the numbers of path data (64 MB) that are kept between the passes.

It holds a finishing program of a million lines. A longer program is read twice.
"""


class CheckPass:
    """Fills the report: lines, blocks, faults, path length, bounding box, end position.

    Attributes:
        reading_time: Time spent in the reader, s.
        path_time: Time spent in the reader and in path building, s.
        hints: Collects warnings and notes; None during a run on a board.
        depends_on_answers: Whether a probe or an input decides how the program continues.
    """

    def __init__(
        self, context: SessionContext, capabilities: CapabilityCheck, needs: KernelNeeds
    ) -> None:
        reader, report = context.reader, context.report
        self.reading_time, self.path_time = Stopwatch(), Stopwatch()
        self.hints = Hints(reader.machine, reader.start) if report.board is None else None
        self.depends_on_answers = False
        self._reader, self._report, self._observer = reader, report, context.observer
        self._capabilities, self._kernels = capabilities, needs

    def run(
        self, target: BlockWriter | None, *, for_lines: bool, rounds: bool
    ) -> list[PathChunk | Block] | None:
        """Check the whole program.

        Args:
            target: Where the blocks are written, or None.
            for_lines: Whether the board plans for itself: the path has no blends and is not kept.
            rounds: Whether the path has the splines of G64. They take longer than the reading.

        Returns:
            The path. None if it is not to be kept, is too long, or may differ at the next reading.
        """
        reader, report, hints = self._reader, self._report, self.hints
        survey, capacity = TravelCheck(reader.machine), -1 if for_lines else KEPT_NUMBERS
        kept: list[PathChunk | Block] | None = []
        blocks = self.reading_time.inside(reader.blocks(self._observer.warn, self._at_line))
        if target is not None:
            blocks = target.passed(blocks)
        if hints is not None:
            blocks = hints.passed(blocks)
        if not rounds:
            blocks = without_blends(blocks)
        counted = self._counted(blocks)
        path = program_path(reader, counted, for_lines=for_lines)
        for item in self.path_time.inside(path):
            if isinstance(item, PathChunk):
                self._kernels.see_path(item)
                capacity -= len(item.data) + 8 * len(item)
                self._check_commands(item)
                self._add_faults(survey.add(item))
            else:
                self._capabilities.check(item)
                if skipped := self._capabilities.skipped(item):
                    self._observer.warn(skipped)
                survey.between(item)
                if isinstance(item, Probe | WaitInput) or (
                    isinstance(item, BoardCommand) and item.homes
                ):
                    self.depends_on_answers = True
                # The next reading may differ if it depends on answers.
                capacity = -1 if self.depends_on_answers else capacity - 16
            if capacity < 0:
                kept = None
                if reader.due_times is not None:
                    reader.due_times.clear()  # the next reading records them again
            if kept is not None:
                kept.append(item)
        report.path_length_mm = survey.length
        report.bounding_box = survey.box()
        return kept

    def _check_commands(self, path: PathChunk) -> None:
        """Check the commands that go with the motion."""
        for place in places_of(path.commands):
            assert path.commands is not None
            for block in path.commands[place]:
                self._capabilities.check(block)

    def _add_faults(self, faults: Iterable[CncError]) -> None:
        report = self._report
        for fault in faults:
            if len(report.faults) < MOST_FAULTS:
                report.faults.append(fault)
            else:
                report.hidden_faults += 1

    def _at_line(self, lines_done: int) -> None:
        self._report.lines = lines_done
        self._observer.checking(lines_done)

    def _counted(self, blocks: Iterable[Block]) -> Iterator[Block]:
        """Yield the blocks; count them, each straight move as one, and note the end position."""
        report, observer, end = self._report, self._observer, self._reader.start
        for block in blocks:
            report.blocks += 1
            if block.file == report.program:
                line = int(block.lines[-1]) if isinstance(block, Polyline) else block.line
                observer.last_line = max(observer.last_line, line)
            if isinstance(block, Polyline):
                report.blocks += len(block.points) - 1
                if block.commands is not None:
                    report.blocks += sum(map(len, filter(None, block.commands)))
                end = block.points[-1]
            elif isinstance(block, ArcFeed | Probe):
                end = block.end
            elif isinstance(block, TipControl):
                end = block.position
            elif isinstance(block, NurbsFeed):
                end = block.control_points[-1]
            self._kernels.see_block(block)
            yield block
        report.end_position = dict(zip(self._reader.machine.axes, end.tolist(), strict=True))


# The simulation of the cut in a check: the program is read once more, and cuts the stock.
