"""Pieces of the spline of a window."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from cnc.kernels.path.fit_chain import Chain
from cnc.kernels.path.fit_pieces import Moves, Written, joint_tolerances, write_pieces
from cnc.kernels.path.fit_records import new_writer
from cnc.kernels.path.fit_spline import Spline
from cnc.path.fit_pieces import Pieces
from cnc.path.records import Floats

NUMBERS = 1 << 18
"""Numbers in an array of records to begin with."""


def spline_pieces(
    chain: Chain,
    spline: Spline,
    moves: Moves,
    last: int,
    here: Floats,
    accuracy: float,
    tolerance: float,
) -> Iterator[Pieces]:
    """Yield the pieces of the first spans of a spline.

    Args:
        chain: the chain.
        spline: its spline.
        moves: feed and line of the moves.
        last: number of spans.
        here: (n,): start of the first span, mm; moved along.
        accuracy: largest error of the inverse arc length, mm.
        tolerance: of the corners between spans, mm.
    """
    joints = joint_tolerances(chain, spline, tolerance)
    numbers = NUMBERS
    span = 0
    most = len(spline.knots) + len(chain.x)
    while span < last:
        writer = new_writer(np.empty(numbers), chain.metric, here, accuracy)
        out = Written(
            np.empty(most, np.int64),
            np.empty(most, np.int64),
            np.empty(most),
            np.empty(most),
            np.empty(most, np.int64),
            np.empty(most),
        )
        following, pieces, used = write_pieces(
            chain, spline, moves, joints, span, last, writer, out
        )
        if following == span:
            numbers *= 2
            continue
        before = joints[0] if span == 0 else math.inf
        span = following
        if pieces:
            some = slice(pieces)
            yield Pieces(
                out.kind[some],
                out.at[some],
                writer.data[:used].copy(),
                out.length[some],
                out.feed[some],
                out.line[some].astype(np.int32),
                out.joint[some].copy(),
                before,
            )
