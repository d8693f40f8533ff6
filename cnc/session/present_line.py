"""The line of the program that the machine carries out: its text, programmed feed and tool."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

from cnc.executor.lines import Step
from cnc.executor.run import Progress
from cnc.model.blocks import Tool
from cnc.model.line_effects import MOTIONS, LineKind
from cnc.model.streams import GcodeLine
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

    Attributes:
        sent: Notes a line that is sent. It is called for each, so it is no function of Python.
    """

    def __init__(self, program: Path, name: str) -> None:
        self._program, self._name = program, name
        self._rest: Iterator[str] = iter(())
        self._number, self._text = 0, ""
        self._sent: deque[GcodeLine] = deque(maxlen=KEPT_LINES)
        self._tool: int | None = None
        self.sent = self._sent.append

    def steps(self, steps: Iterable[Step]) -> Iterator[Step]:
        """Yield steps, and note the tool of each that has been carried out."""
        for step in steps:
            yield step
            if isinstance(step.block, Tool) and step.block.change:
                self._tool = step.block.number

    def described(
        self, progress: Progress, *, time: float, left: float, axes: tuple[str, ...]
    ) -> Progress:
        """Return the progress with text, feed and tool of its line, and with its times and axes."""
        line = progress.at or progress.line
        effects = (sent.effect for sent in reversed(self._sent) if sent.line == line)
        feed = next((effect.feed for effect in effects if effect and effect.kind in FEEDS), None)
        return replace(
            progress,
            time=time,
            left=left,
            axes=axes,
            text=self._text_of(line) if progress.file in ("", self._name) else "",
            feed=None if feed is None else per_minute(feed),
            tool=self._tool,
        )

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
