"""Pieces of a path as kernels take them: one record of numbers for each curve."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Pieces(NamedTuple):
    """The curves of a path in order. Their records are laid out in :mod:`cnc.kernels.path.curve`.

    Attributes:
        kind: (n,) int64: LINE, ARC or SPAN.
        at: (n,) int64: the index in ``data`` at which the record of each piece begins.
        data: float64: the records, one behind the other.
    """

    kind: NDArray[np.int64]
    at: NDArray[np.int64]
    data: NDArray[np.float64]
