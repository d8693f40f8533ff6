r"""The path of a program for a board with a planner of its own.

Such a board rounds corners by itself (GRBL by its junction deviation $11), and its lines may
deviate by the tolerance. Therefore:

- Runs of short moves become a smooth curve within SMOOTHING of the tolerance, under G61 and under
  G64. A plan that follows the chords of a CAM program exactly would slow down at each of them.
- Longer moves and corners stay as they are, and are not rounded.
- Exact stop (G61.1) stays: the motion rests at the end of each move.

The rest of the tolerance is used by the Translator.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import Block, PathMode, Polyline
from cnc.model.motion_commands import goes_with_motion, places_of
from cnc.path.build import build
from cnc.path.chunk import PathChunk

Floats = NDArray[np.float64]

SMOOTHING = 0.15
"""Part of the tolerance that smoothing uses. With less, the planned motion is markedly slower; with
more, there are more lines.
"""
LONG_MOVE = 5.0
"""mm. Longer moves are no part of a curve: at 2000 mm/min and 250 mm/s^2 a machine stops and starts
again within this length.
"""
FEWEST_MOVES = 3
"""Short moves that make a run."""


def smooth_path(
    blocks: Iterable[Block],
    *,
    axes: tuple[str, ...],
    start: Floats,
    tolerance: float,
    accuracy: float = 1e-12,
) -> Iterator[PathChunk | Block]:
    """Yield the path of ``blocks``, see :func:`cnc.path.build.build`.

    Args:
        blocks: The program.
        axes: Letters of the machine's axes.
        start: Start position (axes,), mm.
        tolerance: Largest distance of the lines from the program, mm.
        accuracy: Accuracy of the path, mm.
    """
    for item in build(
        _smoothing(blocks, start, SMOOTHING * tolerance), axes=axes, start=start, accuracy=accuracy
    ):
        if isinstance(item, PathChunk):
            # The board rounds corners by itself.
            item = replace(item, tolerance=np.zeros_like(item.tolerance))
        yield item


def _smoothing(blocks: Iterable[Block], start: Floats, tolerance: float) -> Iterator[Block]:
    """Yield the blocks, with runs of short moves under G64."""
    exact_stop = False
    position = start
    for block in blocks:
        if goes_with_motion(block):
            yield block
        elif isinstance(block, PathMode):
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
    """Yield the moves, with a G64 before and a G61 after each run of short ones."""
    steps = np.diff(block.points, axis=0, prepend=position[None])
    short = (np.linalg.norm(steps, axis=1) < LONG_MOVE) & ~np.isnan(block.feeds)
    # A command that goes with the motion would end the curve.
    short[places_of(block.commands)] = False
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
            commands=None if block.commands is None else block.commands[run],
        )
        if short[first] and last - first >= FEWEST_MOVES:
            yield PathMode(block.file, line, "blend", tolerance)
            yield part
            yield PathMode(block.file, line, "exact-path")
        else:
            yield part
