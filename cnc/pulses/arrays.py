"""A plan chunk as the named arrays that kernels take."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import Pieces
from cnc.planner.kernels.arrays import PlanArrays
from cnc.planner.plan import PlanChunk

Number = TypeVar("Number", bound=np.generic)


def plain(array: NDArray[Any], dtype: type[Number]) -> NDArray[Number]:
    """Return the array as kernels are compiled for: of this type, contiguous and writeable.

    It is the array itself if it is all that.
    """
    return np.require(array, dtype, ("C", "W"))


def pieces_of(path: PathChunk) -> Pieces:
    """Return the pieces of a path for kernels."""
    return Pieces(
        plain(path.kind, np.int64), plain(path.at, np.int64), plain(path.data, np.float64)
    )


def plan_arrays(chunk: PlanChunk) -> PlanArrays:
    """Return the phases of a plan, and the arc lengths of its pieces, for kernels."""
    return PlanArrays(
        plain(chunk.piece_s, np.float64),
        plain(chunk.phase_t, np.float64),
        plain(chunk.phase_s, np.float64),
        plain(chunk.phase_v, np.float64),
        plain(chunk.phase_a, np.float64),
        plain(chunk.phase_j, np.float64),
    )


def source_lines(path: PathChunk) -> NDArray[np.int32]:
    """Return the source line of each piece for kernels."""
    return plain(path.line, np.int32)
