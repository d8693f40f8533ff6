"""The spline of a window of a chain: knots, control points, and the proof of the tolerance.

    corners, straight stretches, first knots       kernels/path/fit_chain, fit_stretches
      ──► least squares; spans that miss a vertex are cut at one               fit_squares
      ──► the smoothest spline inside the tube about the chain       fit_tube, fit_program
      ──► proof; the spline near a span that fails is made anew                  fit_proof

A span that is refused for the first time, and is little off, gets more places where its distance
is limited. Others are cut, at a vertex if there is one inside, else in the middle. A knot inside a
move makes the spline less smooth there. A span too short to be cut is left to the polyline. There,
and at corners, the spline is broken.
"""

from __future__ import annotations

import numpy as np

from cnc.kernels.path.fit_chain import LEAST, Chain, Flags, Knots
from cnc.kernels.path.fit_proof import far_off, prove
from cnc.kernels.path.fit_spline import ORDER, Spline, new_spline, transfer
from cnc.kernels.path.fit_squares import (
    NEAR,
    cut_spans,
    least_squares,
    near_spans,
    with_cuts,
    with_knots,
)
from cnc.kernels.path.fit_tube import improve
from cnc.path.records import Floats

ALLOWED = 0.999
"""Part of the tolerance that is proved."""
MOVES_AT_END = 4
"""Most moves of a span at an end whose derivatives are given,"""
SPANS_AT_END = 6
"""and the number of such spans."""
CUT = 1.05
"""In tolerances. A span that is refused is cut if it is farther off; else places are added."""
ROUNDS = 16
"""Rounds after which spans that still fail are left to the polyline."""
NONE = np.empty((0, ORDER, ORDER))
"""No extractions."""


def fitted(chain: Chain, knots: Knots, states: Floats, tolerance: float) -> Spline:
    """Return the spline of a window, all of it within the tolerance.

    Args:
        chain: the chain.
        knots: its first knots.
        states: (2, 5, n): position and derivatives 1 to 4 by t at start and end, or NaN.
        tolerance: mm.
    """
    feet = chain.along.copy()
    speck = np.diff(knots["t"]) <= 0.0
    knots["polyline"][:-1] |= speck
    knots["ends"][:-1] |= speck
    spline = new_spline(chain, knots, states, np.empty(0), np.empty(0, np.int64), NONE)
    spline = with_knots(chain, spline, ~spline.fixed, states, tolerance)
    free = ~spline.fixed
    turn = 0
    while True:
        improve(chain, spline, free, tolerance)
        changed = _touched(spline, free) | _determined(spline)
        wrong = prove(chain, spline, feet, changed, ALLOWED * tolerance)
        if not wrong.any():
            return spline
        turn += 1
        short = wrong & (np.diff(spline.knots["t"]) < 2.0 * LEAST * tolerance)
        left = wrong if turn > ROUNDS else short
        # A span without a free control point would not change.
        again = ~spline.knots["refused"][:-1] & _touched(spline, ~spline.fixed)
        cut = wrong & ~again | far_off(chain, spline, wrong, CUT * tolerance)
        spline.knots["refused"][:-1] |= wrong
        if left.any():
            spline, free = _broken(chain, spline, left, wrong, states, tolerance)
        elif cut.any():
            spline, free = cut_spans(chain, spline, cut, wrong, states)
            least_squares(chain, spline, ~free)
        else:
            free = near_spans(spline, np.flatnonzero(wrong), NEAR)


def with_short_ends(chain: Chain, knots: Knots, ends: Flags) -> Knots:
    """Return knots with short spans at the ends where derivatives are given (2,).

    These determine five control points, so as many spans must be there beside others.
    """
    while ends.any():
        moves = np.diff(knots["vertex"])
        wide = (moves > MOVES_AT_END) & ~knots["straight"][:-1]
        near = np.zeros(len(moves), np.bool_)
        near[:SPANS_AT_END] = ends[0]
        near[-SPANS_AT_END:] |= ends[1]
        wide &= near
        if not wide.any():
            break
        knots = with_cuts(chain, knots, wide)
    return knots


def _touched(spline: Spline, free: Flags) -> Flags:
    """Return the spans that have a free control point."""
    free_before = np.concatenate(([0], np.cumsum(free)))
    touched: Flags = free_before[spline.first + ORDER] > free_before[spline.first]
    return touched


def _determined(spline: Spline) -> Flags:
    """Return the curved spans whose control points are all given, by what is beside them.

    What is beside them changes when spans are left to the polyline.
    """
    knots = spline.knots[:-1]
    curved: Flags = ~_touched(spline, ~spline.fixed) & ~knots["straight"] & ~knots["polyline"]
    return curved


def _broken(
    chain: Chain, spline: Spline, left: Flags, wrong: Flags, states: Floats, tolerance: float
) -> tuple[Spline, Flags]:
    """Leave spans to the polyline, and lay the parts with spans that are wrong anew.

    Returns:
        The spline, and the control points of these parts.
    """
    knots = spline.knots.copy()
    part = np.cumsum(knots["ends"][:-1]) - 1
    anew = np.isin(part, part[wrong])
    knots["polyline"][:-1] |= left
    knots["ends"][:-1] |= left
    knots["ends"][1:] |= left
    following = new_spline(chain, knots, states, spline.t, spline.first, spline.extract)
    transfer(spline, following)
    free = near_spans(following, np.flatnonzero(anew), 0)
    following = with_knots(chain, following, free, states, tolerance)
    before = np.searchsorted(knots["t"], following.knots["t"][:-1], "right") - 1
    # A last span of no length begins at the last knot.
    before = np.minimum(before, len(anew) - 1)
    return following, near_spans(following, np.flatnonzero(anew[before]), 0)
