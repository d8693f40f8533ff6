"""The sampled NURBS interpolator of Hui, Wei and Gao on a bare curve, from rest to rest.

The paper is in TELKOMNIKA 11(5), 2013.

Programs are planned (:mod:`cnc.planner`) and sampled from the plan (:mod:`cnc.pulses.sampled`).
This is the method of the paper, for comparison.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.papers import nurbs_lookahead as kernel
from cnc.kernels.path.curve import U0, U1
from cnc.machine.models import PathLimits
from cnc.model.diagnostics import Diagnostic, MotionLimitError
from cnc.path.chunk import PathChunk
from cnc.pulses.arrays import pieces_of

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Samples:
    """One row a period, the first at rest at the start.

    Attributes:
        period: s.
        u: (m,): parameter.
        position: (m, n), mm.
        step: (m,): step that the speed asked for in the period that led there, mm.
        chord: (m,): chord made in it, mm.
        chord_error: (m,): distance of the curve from that chord, mm.
        deviation: (m,): relative deviation of the chord from the step.
        went_back: how often the look-ahead went back.
    """

    period: float
    u: Floats
    position: Floats
    step: Floats
    chord: Floats
    chord_error: Floats
    deviation: Floats
    went_back: int

    @property
    def feed(self) -> Floats:
        """Feed asked for in the period that led to each row, mm/s."""
        return self.step / self.period


def interpolate(curve: PathChunk, limits: PathLimits, *, look_ahead: bool = True) -> Samples:
    """Sample one curve by sections 3.2 (adaptive feed step) and 4.2 (look-ahead) of the paper.

    Args:
        curve: pieces over which the parameter runs on, as those of a NURBS.
        limits: limits; those that are None do not limit.
        look_ahead: whether section 4.2 is carried out.

    Raises:
        ValueError: if the parameter does not run on.
        MotionLimitError: ``plan-failed`` if the look-ahead comes to no end.
    """
    pieces = pieces_of(curve)
    _, at, data = pieces
    if np.any(data[at[1:] + U0] != data[at[:-1] + U1]):
        raise ValueError("the parameter does not run on from piece to piece")
    values = kernel.Limits(
        feed=limits.max_feed,
        period=limits.period,
        normal=_or_infinite(limits.max_normal_acceleration),
        tangential=_or_infinite(limits.max_tangential_acceleration),
        jerk=min(_or_infinite(limits.max_jerk), 1e6 * limits.max_feed / limits.period**2),
        chord_error=limits.chord_error,
        deviation=limits.step_deviation or 1e-12,
    )
    n = len(curve.axes)
    work = np.empty((3, 4, n))
    rows = 4096
    while True:
        u, step, chord, error, deviation, queue = np.empty((6, rows))
        out = kernel.Samples(u, np.empty((rows, n)), step, chord, error, deviation)
        outcome, count, backs = kernel.interpolate(pieces, values, look_ahead, out, queue, *work)
        if outcome == kernel.STUCK:
            raise MotionLimitError(
                Diagnostic(
                    "plan-failed",
                    "the look-ahead of the paper does not come to an end on this curve",
                    hint="use the planner",
                )
            )
        if outcome == kernel.DONE:
            break
        rows *= 8
    return Samples(
        limits.period,
        out.u[:count],
        out.position[:count],
        out.step[:count],
        out.chord[:count],
        out.error[:count],
        out.deviation[:count],
        backs,
    )


def _or_infinite(limit: float | None) -> float:
    return math.inf if limit is None else limit
