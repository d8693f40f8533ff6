"""Windows: parts of a piece over which polynomials stand for the curve.

A window is a part [ua, ub] of a piece, x = (u - ua) / (ub - ua). Over it the position of each axis
in BLU, and the arc length, are polynomials of degree 7: the Hermite interpolants through the values
and first three derivatives at both ends. They are compared with the curve itself at two points
inside, and the window is shortened until they agree but for rounding. On a cubic the polynomials of
the axes are exact. On an arc a window spans about 180 steps, whatever the radius. So a crossing
costs a few products instead of an evaluation of the curve.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.arclength import curve_arclen
from cnc.path.kernels.curve import (
    METRIC,
    METRICS,
    SPAN,
    TABLE,
    Floats,
    curve_eval,
    curve_range,
    is_plain_quintic,
)
from cnc.pulses.kernels.grid_moves import SLACK, SLACK_PER_BLU, Piece
from cnc.pulses.kernels.polynomial import POLYNOMIAL, interpolate, value

EXACT = 1e-11
"""mm: largest error of the polynomial of the arc length."""
CHECKS = (0.375, 0.75)
"""Places in a window at which the polynomials are compared with the curve. In the middle the error
may vanish by symmetry.
"""
SHORTEST = 2.0**-20
"""Part of a piece that is not divided any more."""
EPSILON = 2.0**-52
"""Relative rounding error of the parameter."""
ROUNDING = 1e3
"""A polynomial whose error is up to so many times the allowed one is accepted where a narrower
window is hardly better: the error is rounding.
"""
FEW = 8.0
"""BLU. Beside a cusp the arc length is no polynomial of u at any scale. There the table gives it,
over so much of the path.
"""


class Window(NamedTuple):
    """The polynomials of a window, and the curve at its ends.

    Attributes:
        poly: (n + 1, POLYNOMIAL): one row for each axis, the last for the arc length.
        start: (4, n): position and derivatives at the start, mm.
        end: (4, n): the same at the end.
        lengths: (2, 4): arc length (mm from the start of the piece) and its first three derivatives
            by u, at the start and at the end.
        inside: (4, n): work space.
    """

    poly: Floats
    start: Floats
    end: Floats
    lengths: Floats
    inside: Floats


@njit
def new_window(n: int) -> Window:
    """Return an empty window for n axes."""
    return Window(
        np.empty((n + 1, POLYNOMIAL)),
        np.empty((4, n)),
        np.empty((4, n)),
        np.empty((2, 4)),
        np.empty((4, n)),
    )


@njit
def begin_window(piece: Piece, u: float, window: Window) -> None:
    """Set the start of the next window to the parameter u."""
    kind, data, at, _ = piece
    u0, _ = curve_range(kind, data, at)
    curve_eval(kind, data, at, u, window.start)
    window.lengths[0, 0] = curve_arclen(kind, data, at, u0, u)


@njit
def following(window: Window) -> Window:
    """Return the window whose start is the end of ``window``, in the same memory."""
    window.lengths[0, 0] = window.lengths[1, 0]
    return Window(window.poly, window.end, window.start, window.lengths, window.inside)


@njit
def length_rates(data: Floats, at: int, r: Floats, out: Floats) -> None:
    """Write the first three derivatives by u of the arc length into out[1:].

    r (4, n) holds position and derivatives. Where the length does not grow only out[1] is written,
    as 0.
    """
    d11 = 0.0
    d12 = 0.0
    d22_13 = 0.0
    for k in range(int(data[at + METRICS])):
        i = int(data[at + METRIC + k])
        d11 += r[1, i] * r[1, i]
        d12 += r[1, i] * r[2, i]
        d22_13 += r[2, i] * r[2, i] + r[1, i] * r[3, i]
    sigma = math.sqrt(d11)
    out[1] = sigma
    if sigma > 0.0:
        out[2] = d12 / sigma
        out[3] = (d22_13 - out[2] * out[2]) / sigma


@njit
def _fit_axes(piece: Piece, ua: float, ub: float, scale: Floats, window: Window) -> float:
    """Fit the axes' polynomials in the window [ua, ub], of which start and end are set.

    Returns:
        Their largest error, in parts of the allowed one.
    """
    kind, data, at, _ = piece
    poly, start, end, _, inside = window
    n = len(scale)
    h = ub - ua
    h2 = 0.5 * h * h
    h3 = h * h * h / 6.0
    for i in range(n):
        k = scale[i]
        interpolate(
            poly, i,
            start[0, i] * k, start[1, i] * k * h, start[2, i] * k * h2, start[3, i] * k * h3,
            end[0, i] * k, end[1, i] * k * h, end[2, i] * k * h2, end[3, i] * k * h3,
        )  # fmt: skip
    farthest = steepest = 0.0
    for i in range(n):
        farthest = max(farthest, abs(start[0, i] * scale[i]), abs(end[0, i] * scale[i]))
        steepest = max(steepest, abs(start[1, i] * scale[i]), abs(end[1, i] * scale[i]))
    # One axis of an arc is as rough as the other is far from 0, and near a pole a rotary axis is as
    # rough as the parameter. Narrower windows would not be better.
    allowed = 0.25 * SLACK + SLACK_PER_BLU * farthest + EPSILON * max(abs(ua), abs(ub)) * steepest
    off = 0.0
    for k in range(2):
        x = CHECKS[k]
        curve_eval(kind, data, at, ua + x * h, inside)
        for i in range(n):
            off = max(off, abs(value(poly[i], x) - inside[0, i] * scale[i]) / allowed)
    return off


@njit
def _fit_length(piece: Piece, ua: float, ub: float, window: Window) -> float:
    """Fit the polynomial of the arc length in the window [ua, ub], of which start and end are set.

    Returns:
        Its largest error, in parts of the allowed one.
    """
    kind, data, at, _ = piece
    poly, start, end, lengths, _ = window
    n = len(poly) - 1
    u0, _ = curve_range(kind, data, at)
    h = ub - ua
    h2 = 0.5 * h * h
    h3 = h * h * h / 6.0
    if data[at + TABLE] == 0.0:
        lengths[1, 0] = ub - u0
        interpolate(poly, n, lengths[0, 0], h, 0.0, 0.0, lengths[1, 0], h, 0.0, 0.0)
        return 0.0
    lengths[1, 0] = curve_arclen(kind, data, at, u0, ub)
    length_rates(data, at, start, lengths[0])
    length_rates(data, at, end, lengths[1])
    if not (lengths[0, 1] > 0.0 and lengths[1, 1] > 0.0):
        return math.inf
    interpolate(
        poly, n, lengths[0, 0], lengths[0, 1] * h, lengths[0, 2] * h2, lengths[0, 3] * h3,
        lengths[1, 0], lengths[1, 1] * h, lengths[1, 2] * h2, lengths[1, 3] * h3,
    )  # fmt: skip
    off = 0.0
    for k in range(2):
        x = CHECKS[k]
        length = curve_arclen(kind, data, at, u0, ua + x * h)
        off = max(off, abs(value(poly[n], x) - length) / EXACT)
    return off


@njit
def next_window(
    piece: Piece, ua: float, limit: float, width: float, scale: Floats, window: Window
) -> tuple[float, float, bool]:
    """Fit the next window, from ua on.

    Args:
        piece: the piece.
        ua: start of the window, where ``window.start`` and ``window.lengths[0, 0]`` are set.
        limit: largest end of the window.
        width: width to be tried first.
        scale: (n,): steps per mm.
        window: the window; its polynomials and its end are written.

    Returns:
        The end ub, the width to be tried for the window after it, and whether the arc lengths in
        the window must come from the table of the piece.
    """
    kind, data, at, _ = piece
    lengths = window.lengths
    u0, u1 = curve_range(kind, data, at)
    shortest = SHORTEST * (u1 - u0)
    exact = kind == SPAN and is_plain_quintic(data, at)
    steepest = 0.0
    for i in range(len(scale)):
        steepest = max(steepest, scale[i])
    wider_off = math.inf
    ub = ua
    by_table = False
    too_wide = True
    while too_wide:
        ub = ua + width if limit - (ua + width) > 0.1 * width else limit
        curve_eval(kind, data, at, ub, window.end)
        length_off = _fit_length(piece, ua, ub, window)
        by_table = length_off > 1.0
        divides = ub - ua > shortest
        too_wide = by_table and (lengths[1, 0] - lengths[0, 0]) * steepest > FEW and divides
        # The axes' polynomials of a quintic are exact: they are needed in the last window only.
        axes_off = 0.0 if too_wide and exact else _fit_axes(piece, ua, ub, scale, window)
        # The error grows with the eighth power of the width.
        width = (ub - ua) * min(
            max(0.9 * math.sqrt(math.sqrt(math.sqrt(1.0 / max(axes_off, length_off, 1e-9)))), 0.1),
            4.0,
        )
        by_rounding = 0.5 * wider_off < axes_off < ROUNDING
        too_wide = too_wide or (axes_off > 1.0 and not by_rounding and divides)
        if too_wide:
            width = min(width, 0.7 * (ub - ua))
            wider_off = axes_off
        else:
            # A window accepted with a larger error would not be better if it were narrower.
            width = max(width, ub - ua if axes_off > 1.0 else shortest)
    return ub, width, by_table


@njit
def place_rows(
    piece: Piece,
    ua: float,
    ub: float,
    by_table: bool,
    window: Window,
    first: int,
    rows: int,
    s: Floats,
) -> None:
    """Turn s[first:rows], places x in the window [ua, ub], into path coordinates (mm)."""
    kind, data, at, s0 = piece
    u0, _ = curve_range(kind, data, at)
    c = window.poly[len(window.poly) - 1]
    for row in range(first, rows):
        if by_table:
            s[row] = s0 + curve_arclen(kind, data, at, u0, ua + s[row] * (ub - ua))
        else:
            s[row] = s0 + value(c, s[row])
