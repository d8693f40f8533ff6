"""Canonical blocks on their way out: straight moves gather into runs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.state.source_location import SourceLocation
from cnc.model.blocks import Block, Polyline, Probe, WaitInput

MAX_MOVES = 4096
"""Moves of a Polyline at most: long enough for arrays to pay, short enough for the first pulse not
to wait.
"""

TakeAnswer = Callable[[tuple[float, ...]], None]
"""Takes in an answer of the board."""


class BlockBuffer:
    """Collects the blocks of a program in order. ``ready`` holds those that can be handed on; the
    caller empties it.

    ``asked`` are blocks whose answers have not been taken in yet; they are there when the next line
    is read. ``hold`` is who decides when blocks that are no moves follow the moves before them,
    where that is not at once. ``guessed``: an answer was taken as expected, because nobody was
    there to give it.
    """

    def __init__(self, here: SourceLocation, axes: int) -> None:
        self.ready: list[Block] = []
        self.unanswered: list[tuple[Probe | WaitInput, TakeAnswer]] = []
        self.defer: Callable[[Block], None] | None = None
        self.assumed = False
        self._here = here
        self._axes = axes
        self._points: list[float] = []
        self._feeds: list[float] = []
        self._lines: list[int] = []

    def move(self, end: list[float], feed: float, line: int) -> None:
        """A straight move; NaN feed for a traverse."""
        self._points += end
        self._feeds.append(feed)
        self._lines.append(line)
        if len(self._feeds) >= MAX_MOVES:
            self.flush()

    def moves(
        self, points: NDArray[np.float64], feeds: NDArray[np.float64], lines: NDArray[np.int32]
    ) -> None:
        """Straight moves as arrays: points (n, axes), feeds (n,), lines (n,), which are kept. The
        same as one after the other.
        """
        begin, count = 0, len(feeds)
        if self._feeds:
            begin = min(count, MAX_MOVES - len(self._feeds))
            self._points += points[:begin].ravel().tolist()
            self._feeds += feeds[:begin].tolist()
            self._lines += lines[:begin].tolist()
            if len(self._feeds) < MAX_MOVES:
                return
            self.flush()
        while count - begin >= MAX_MOVES:
            end = begin + MAX_MOVES
            self.ready.append(
                Polyline(
                    self._here.file,
                    int(lines[begin]),
                    points[begin:end],
                    feeds[begin:end],
                    lines[begin:end],
                )
            )
            begin = end
        self._points, self._feeds, self._lines = (
            points[begin:].ravel().tolist(),
            feeds[begin:].tolist(),
            lines[begin:].tolist(),
        )

    def add(self, block: Block) -> None:
        """Any other block."""
        if self.defer is None:
            self.put(block)
        else:
            self.defer(block)

    def place(self, end: list[float], feed: float, line: int, file: str) -> None:
        """A straight move that may stand in another file than the line being executed."""
        if file == self._here.file:
            self.move(end, feed, line)
            return
        self.flush()
        self.ready.append(
            Polyline(
                file, line, np.array([end]), np.array([feed]), np.array([line], dtype=np.int32)
            )
        )

    def put(self, block: Block) -> None:
        """Any other block, right behind the moves."""
        self.flush()
        self.ready.append(block)

    def ask(self, block: Probe | WaitInput, take: TakeAnswer) -> None:
        """A block that the board answers; ``take`` is given the answer before the next line is
        executed.
        """
        self.add(block)
        self.unanswered.append((block, take))

    def take_answers(self) -> None:
        """Hand out the answers to what was asked; where nobody was there to answer, what is
        expected.
        """
        for block, take in self.unanswered:
            values = block.answer.values
            self.assumed = self.assumed or values is None
            take(block.expected if values is None else values)
        self.unanswered.clear()

    def flush(self) -> None:
        """Close the run of straight moves."""
        if not self._feeds:
            return
        self.ready.append(
            Polyline(
                self._here.file,
                self._lines[0],
                np.array(self._points, dtype=np.float64).reshape(-1, self._axes),
                np.array(self._feeds, dtype=np.float64),
                np.array(self._lines, dtype=np.int32),
            )
        )
        self._points, self._feeds, self._lines = [], [], []
