"""The first pass: the program is read to its end and its path compared with the machine's travel;
nothing moves.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from cnc.checks.hints import Hints
from cnc.checks.travel import TravelCheck
from cnc.model.blocks import ArcFeed, Block, NurbsFeed, Polyline, Probe, WaitInput
from cnc.outputs.blocks import BlockWriter
from cnc.path.chunk import PathChunk
from cnc.report.result import Report
from cnc.session.observer import Lookout
from cnc.session.program_reader import Reading
from cnc.session.required_capabilities import Abilities
from cnc.session.stopwatch import Stopwatch

MOST_FAULTS = 20
"""Soft-limit faults that are kept; the rest are counted."""
KEPT_NUMBERS = 8_000_000
"""Numbers of path data (64 MB) that are kept between the passes: a finishing program of a million
lines. A longer one is read twice.
"""


class FirstPass:
    """Fills the report: lines, blocks, faults, length, box, end.

    hints: the findings that end nothing, None if nobody wants them. asks: whether what a board
    answers decides how the program goes on.
    """

    def __init__(
        self, reading: Reading, report: Report, lookout: Lookout, abilities: Abilities
    ) -> None:
        self.watch_reading, self.watch_path = Stopwatch(), Stopwatch()
        self.hints = Hints(reading.machine, reading.start) if report.board is None else None
        self.asks = False
        self._reading, self._report, self._lookout, self._abilities = (
            reading,
            report,
            lookout,
            abilities,
        )

    def carry_out(self, shown: BlockWriter | None, *, keep: bool) -> list[PathChunk | Block] | None:
        """Read, and write the blocks to ``shown``.

        The path if it is to be kept, is not too long, and the next reading can't differ; None where
        it has to be read again.
        """
        reading, report, hints = self._reading, self._report, self.hints
        survey, room = TravelCheck(reading.machine), KEPT_NUMBERS if keep else -1
        kept: list[PathChunk | Block] | None = []
        blocks = self.watch_reading.inside(reading.blocks(self._lookout.warn, self._at_line))
        if shown is not None:
            blocks = shown.passed(blocks)
        if hints is not None:
            blocks = hints.passed(blocks)
        for item in self.watch_path.inside(reading.route(self._counted(blocks))):
            if isinstance(item, PathChunk):
                room -= len(item.data) + 8 * len(item)
                if hints is not None:
                    hints.add_path(item)
                for fault in survey.add(item):
                    if len(report.faults) < MOST_FAULTS:
                        report.faults.append(fault)
                    else:
                        report.hidden_faults += 1
            else:
                self._abilities.check(item)
                survey.between(item)
                self.asks = self.asks or isinstance(item, Probe | WaitInput)
                # What asks has to be read again.
                room = -1 if self.asks else room - 16
            if room < 0:
                kept = None
            if kept is not None:
                kept.append(item)
        report.path_length_mm = survey.length
        report.bounding_box = survey.box()
        return kept

    def _at_line(self, executed: int) -> None:
        self._report.lines = executed
        self._lookout.checking(executed)

    def _counted(self, blocks: Iterable[Block]) -> Iterator[Block]:
        """Count blocks, each straight move as one, and note where the motion ends."""
        report, lookout, end = self._report, self._lookout, self._reading.start
        for block in blocks:
            report.blocks += 1
            if block.file == report.program:
                lookout.last_line = max(
                    lookout.last_line,
                    int(block.lines[-1]) if isinstance(block, Polyline) else block.line,
                )
            if isinstance(block, Polyline):
                report.blocks += len(block.points) - 1
                end = block.points[-1]
            elif isinstance(block, ArcFeed | Probe):
                end = block.end
            elif isinstance(block, NurbsFeed):
                end = block.control_points[-1]
            yield block
        report.end_position = dict(zip(self._reading.machine.axes, end.tolist(), strict=True))
