"""The line of the program that the machine carries out: its text, programmed feed and tool."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from cnc.executor.lines import Step
from cnc.executor.run import Progress
from cnc.model.blocks import Tool
from cnc.model.line_effects import MOTIONS, LineKind
from cnc.model.packed_lines import PackedLines
from cnc.model.units import per_minute

KEPT_LINES = 1024
"""Lines sent that are kept: more than the buffers of a board hold."""
FEEDS = MOTIONS - {LineKind.RAPID}
"""Motions with a programmed feed."""


class PresentLine:
    """Describes the present line.

    Args:
        program: The file of the program.
        name: Its name in progress reports.
    """

    def __init__(self, program: Path, name: str) -> None:
        self._program, self._name = program, name
        self._rest: Iterator[str] = iter(())
        self._number, self._text = 0, ""
        self._steps: deque[PackedLines] = deque()
        self._before = 0
        self._tool: int | None = None

    def steps(self, steps: Iterable[Step]) -> Iterator[Step]:
        """Yield steps; note the lines of each, and the tool when it has been carried out."""
        for step in steps:
            self._begin(step.lines)
            yield step
            if isinstance(step.block, Tool) and step.block.change:
                self._tool = step.block.number

    def described(
        self, progress: Progress, *, time: float, left: float, axes: tuple[str, ...]
    ) -> Progress:
        """Return the progress with text, feed and tool of its line, and with its times and axes."""
        line = progress.at or progress.line
        feed = self._feed_of(line, progress.rows - self._before)
        return replace(
            progress,
            time=time,
            left=left,
            axes=axes,
            text=self._text_of(line) if progress.file in ("", self._name) else "",
            feed=None if feed is None else per_minute(feed),
            tool=self._tool,
        )

    def _begin(self, lines: PackedLines) -> None:
        """Note the lines of a step that begins; forget steps that are over."""
        earlier = sum(map(len, self._steps))
        while self._steps and earlier - len(self._steps[0]) > KEPT_LINES:
            earlier -= len(self._steps.popleft())
        self._before += len(self._steps[-1]) if self._steps else 0
        self._steps.append(lines)

    def _feed_of(self, line: int, sent: int | None) -> float | None:
        """Return the feed of the motion that was last sent for a line, mm/s; None without one.

        Args:
            line: The source line.
            sent: Number of lines of the present step that were sent.
        """
        for lines in reversed(self._steps):
            rows = lines.rows[:sent][-KEPT_LINES:]
            for found in np.flatnonzero(rows["line"] == line)[::-1]:
                if rows["kind"][found] in FEEDS:
                    return float(rows["feed"][found])
            # All lines of the steps before were sent.
            sent = None
        return None

    def _text_of(self, line: int) -> str:
        """Return the text of a line. Lines mostly follow each other, so the file is read on."""
        if line < self._number:
            self._rest, self._number, self._text = iter(()), 0, ""
        if line > self._number:
            if self._number == 0:
                self._rest = _lines_of(self._program)
            text = next(islice(self._rest, line - self._number - 1, None), "")
            self._number, self._text = line, text.strip()
        return self._text


def _lines_of(program: Path) -> Iterator[str]:
    with program.open(encoding="utf-8", errors="replace") as file:
        yield from file
