"""Pieces of a path that follow each other, before they are gathered into chunks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.path.records import Floats, Ints


@dataclass(frozen=True, slots=True)
class Pieces:
    """Pieces that follow each other, one entry each.

    Attributes:
        kind: LINE, ARC or SPAN.
        at: index of the record in ``data``.
        data: the records.
        length: mm.
        feed: mm/s, NaN for a traverse.
        line: source line.
        tolerance: of the joint behind the piece, mm.
        before: largest tolerance of the joint before the first piece, mm.
    """

    kind: Ints
    at: Ints
    data: Floats
    length: Floats
    feed: Floats
    line: NDArray[np.int32]
    tolerance: Floats
    before: float = math.inf
