"""A plan chunk as the arrays that the kernels take."""

from __future__ import annotations

from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from cnc.planner.plan import PlanChunk

Number = TypeVar("Number", bound=np.generic)
Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]
Arrays: TypeAlias = tuple[
    Ints, Ints, Floats, Floats, NDArray[np.int32], Floats, Floats, Floats, Floats, Floats
]


def plain(array: NDArray[Any], dtype: type[Number]) -> NDArray[Number]:
    """The array as kernels are compiled for: of that type, contiguous and writeable; itself if it
    is all that.
    """
    return np.require(array, dtype, ("C", "W"))


def kernel_arrays(chunk: PlanChunk) -> Arrays:
    """Pieces: kind, place and data of the records, ends, source lines. Phases: time, length, speed,
    acceleration, jerk.
    """
    path = chunk.path
    return (
        plain(path.kind, np.int64),
        plain(path.at, np.int64),
        plain(path.data, np.float64),
        plain(chunk.piece_s, np.float64),
        plain(path.line, np.int32),
        plain(chunk.phase_t, np.float64),
        plain(chunk.phase_s, np.float64),
        plain(chunk.phase_v, np.float64),
        plain(chunk.phase_a, np.float64),
        plain(chunk.phase_j, np.float64),
    )
