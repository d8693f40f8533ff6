"""Blocks in one form, in which two programs can be compared: moves without length are left out.

    Polyline with commands ──► Straights, Spindle, Straights ...

The writer and the proof count curves in this form, so that they mean the same ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import ArcFeed, Block, NurbsFeed, Polyline, Probe, canonical
from cnc.model.motion_commands import places_of

NOTHING = 2e-5
"""mm. A shorter move is none: numbers of programs are no finer; an arc would become a circle."""

Floats = NDArray[np.float64]


@canonical
class Straights(Block):
    """Straight moves without commands, each longer than NOTHING.

    Attributes:
        points: Ends (n, axes), mm.
        feeds: Feeds (n,), mm/s; NaN for a traverse.
        lines: Source lines (n,).
    """

    points: Floats
    feeds: Floats
    lines: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.feeds)

    def part(self, first: int, last: int | None = None) -> Straights:
        """Return the moves from ``first`` to before ``last``."""
        lines = self.lines[first:last]
        return Straights(
            self.file, int(lines[0]), self.points[first:last], self.feeds[first:last], lines
        )


class Elements:
    """Gives the blocks of one program in this form.

    Args:
        start: Position before the program (axes,), mm.

    Attributes:
        position: Position behind the blocks so far (axes,), mm.
    """

    def __init__(self, start: Floats) -> None:
        self.position = start

    def of(self, blocks: Iterable[Block]) -> Iterator[Block]:
        """Yield Straights in place of polylines, and other blocks as they are but for tiny arcs."""
        for block in blocks:
            if isinstance(block, Polyline):
                yield from self._moves(block)
                continue
            if isinstance(block, ArcFeed) and self._is_nothing(block):
                continue
            if isinstance(block, ArcFeed | Probe):
                self.position = block.end
            elif isinstance(block, NurbsFeed):
                self.position = block.control_points[-1]
            yield block

    def _is_nothing(self, arc: ArcFeed) -> bool:
        """Whether an arc is shorter than any number in a program."""
        ends = bool((np.abs(arc.end - self.position) < NOTHING).all())
        return ends and abs(arc.turns) * math.tau * arc.radius < NOTHING

    def _moves(self, run: Polyline) -> Iterator[Block]:
        begin = 0
        for place in places_of(run.commands):
            yield from self._straights(run, begin, place)
            assert run.commands is not None
            yield from run.commands[place]
            begin = place
        yield from self._straights(run, begin, len(run.feeds))

    def _straights(self, run: Polyline, begin: int, end: int) -> Iterator[Block]:
        if begin == end:
            return
        points = run.points[begin:end]
        steps = np.diff(points, axis=0, prepend=self.position[None])
        moves = (np.abs(steps) > NOTHING).any(axis=1)
        if moves.all():
            chosen = Straights(
                run.file, int(run.lines[begin]), points, run.feeds[begin:end], run.lines[begin:end]
            )
        elif not moves.any():
            return
        else:
            lines = run.lines[begin:end][moves]
            chosen = Straights(
                run.file, int(lines[0]), points[moves], run.feeds[begin:end][moves], lines
            )
        self.position = chosen.points[-1]
        yield chosen


def as_blocks(elements: Iterable[Block]) -> Iterator[Block]:
    """Yield elements as blocks of the model again."""
    for element in elements:
        if isinstance(element, Straights):
            yield Polyline(element.file, element.line, element.points, element.feeds, element.lines)
        else:
            yield element


def size(element: Block) -> int:
    """Return the number of curves that an element has: moves, arcs and splines."""
    if isinstance(element, Straights):
        return len(element)
    return int(isinstance(element, ArcFeed | NurbsFeed))
