"""The sampled NURBS interpolator of Hui, Wei and Gao (TELKOMNIKA 11(5), 2013) on a bare curve, from
rest to rest.

Production motion is planned (:mod:`cnc.planner`) and sampled from the plan
(:mod:`cnc.pulses.sampled`); this is what the paper does instead, to be held beside it.
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
from cnc.pulses.arrays import plain

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Samples:
    """One row a period, the first at rest at the start.

    u, position (m, n) mm, and of the period that led there the step by speed, the chord made, its
    error, mm, and its relative deviation from what was asked for. went_back: how often the
    look-ahead did.
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
        """mm/s, as asked for in the period that led to each row."""
        return self.step / self.period


def interpolate(curve: PathChunk, limits: PathLimits, *, look_ahead: bool = True) -> Samples:
    """Samples of one curve by the paper's sections 3.2 (adaptive feed step) and, with
    ``look_ahead``, 4.2.

    curve: pieces over which the parameter runs on, as those of a NURBS; ValueError if it does not.
    Limits that are None do not limit. MotionLimitError ``plan-failed`` if the look-ahead comes to
    no end.
    """
    kind, at, data = (
        plain(curve.kind, np.int64),
        plain(curve.at, np.int64),
        plain(curve.data, np.float64),
    )
    if np.any(data[at[1:] + U0] != data[at[:-1] + U1]):
        raise ValueError("the parameter does not run on from piece to piece")
    values = np.empty(kernel.LIMITS)
    values[kernel.FEED], values[kernel.PERIOD] = limits.max_feed, limits.period
    values[kernel.NORMAL] = _or_none(limits.max_normal_acceleration)
    values[kernel.TANGENTIAL] = _or_none(limits.max_tangential_acceleration)
    values[kernel.JERK] = min(_or_none(limits.max_jerk), 1e6 * limits.max_feed / limits.period**2)
    values[kernel.CHORD_ERROR], values[kernel.DEVIATION] = (
        limits.chord_error,
        limits.step_deviation or 1e-12,
    )
    n = len(curve.axes)
    work = np.empty((3, 4, n))
    room = 4096
    while True:
        u, step, chord, error, deviation, queue = np.empty((6, room))
        where = np.empty((room, n))
        outcome, count, backs = kernel.interpolate(
            kind, at, data, values, look_ahead, u, where, step, chord, error, deviation, queue, *work
        )  # fmt: skip
        if outcome == kernel.STUCK:
            raise MotionLimitError(
                Diagnostic(
                    "plan-failed",
                    "the look-ahead goes back again and again",
                    hint="use the planner",
                )
            )
        if outcome == kernel.DONE:
            break
        room *= 8
    rows = slice(count)
    return Samples(
        limits.period,
        u[rows],
        where[rows],
        step[rows],
        chord[rows],
        error[rows],
        deviation[rows],
        backs,
    )


def _or_none(limit: float | None) -> float:
    return math.inf if limit is None else limit
