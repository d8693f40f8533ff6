"""The path of a program for a board with a planner of its own.

Such a board rounds corners by itself (GRBL by its junction deviation $11). So the path is exact,
also under G64: the tolerance is left to the lines and arcs that replace it. Exact stop (G61.1)
stays: the motion rests at the end of each move.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import Block, PathMode
from cnc.path.build import build
from cnc.path.chunk import PathChunk


def exact_path(
    blocks: Iterable[Block],
    *,
    axes: tuple[str, ...],
    start: NDArray[np.float64],
    accuracy: float = 1e-12,
) -> Iterator[PathChunk | Block]:
    """Yield the path of ``blocks`` without blends, see :func:`cnc.path.build.build`.

    Args:
        blocks: The program.
        axes: Letters of the machine's axes.
        start: Start position (axes,), mm.
        accuracy: Accuracy of the path, mm.
    """
    return build(_without_blends(blocks), axes=axes, start=start, accuracy=accuracy)


def _without_blends(blocks: Iterable[Block]) -> Iterator[Block]:
    for block in blocks:
        if isinstance(block, PathMode) and block.control == "blend":
            yield replace(block, control="exact-path", tolerance=0.0)
        else:
            yield block
