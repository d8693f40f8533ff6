r"""The path of a program for a board that plans for itself.

Such a board takes corners by itself (GRBL by its junction deviation $11), and what it is sent may
deviate by the tolerance anyway. So

    runs of short moves     are made a smooth curve within SMOOTHING of the tolerance, whatever the program says of G61 or G64: a
                            plan that follows the chords of a CAM program exactly would have to slow down at each of them
    longer moves, corners   stay as they are, and are not rounded
    exact stop (G61.1)      stays: the motion rests at the end of each move

The rest of the tolerance is the Translator's.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import Block, PathMode, Polyline
from cnc.path.build import build
from cnc.path.chunk import PathChunk

Floats = NDArray[np.float64]

SMOOTHING = 0.15
"""Part of the tolerance that smoothing takes. With less the planned motion is markedly slower, with
more there are more lines.
"""
LONG = 5.0
"""mm. Moves from here on are no part of a curve: at 2000 mm/min and 250 mm/s^2 a machine stops and
starts again in as much.
"""
FEWEST = 3
"""Short moves that make a run."""


def smooth_path(
    blocks: Iterable[Block],
    *,
    axes: tuple[str, ...],
    start: Floats,
    tolerance: float,
    accuracy: float = 1e-12,
) -> Iterator[PathChunk | Block]:
    """The path of ``blocks`` from ``start`` (axes,), of which lines may be off by ``tolerance`` mm;
    see :func:`cnc.path.build.build`.
    """
    for item in build(
        _smoothing(blocks, start, SMOOTHING * tolerance), axes=axes, start=start, accuracy=accuracy
    ):
        if isinstance(item, PathChunk):
            # corners are the board's
            item = replace(item, tolerance=np.zeros_like(item.tolerance))
        yield item


def _smoothing(blocks: Iterable[Block], start: Floats, tolerance: float) -> Iterator[Block]:
    """The blocks, with runs of short moves put under G64."""
    exact_stop = False
    position = start
    for block in blocks:
        if isinstance(block, PathMode):
            exact_stop = block.control == "exact-stop"
            yield block if exact_stop else replace(block, control="exact-path", tolerance=0.0)
        elif isinstance(block, Polyline) and not exact_stop:
            yield from _runs(block, position, tolerance)
            position = block.points[-1]
        else:
            yield block
            position = getattr(block, "end", position)
            if hasattr(block, "control_points"):
                position = block.control_points[-1]


def _runs(block: Polyline, position: Floats, tolerance: float) -> Iterator[Block]:
    """The moves, the runs of short ones between a G64 and a G61."""
    steps = np.diff(block.points, axis=0, prepend=position[None])
    short = (np.linalg.norm(steps, axis=1) < LONG) & ~np.isnan(block.feeds)
    borders = [0, *(np.flatnonzero(np.diff(short)) + 1).tolist(), len(short)]
    for first, last in pairwise(borders):
        run = slice(first, last)
        line = int(block.lines[first])
        part = replace(
            block,
            line=line,
            points=block.points[run],
            feeds=block.feeds[run],
            lines=block.lines[run],
        )
        if short[first] and last - first >= FEWEST:
            yield PathMode(block.file, line, "blend", tolerance)
            yield part
            yield PathMode(block.file, line, "exact-path")
        else:
            yield part
