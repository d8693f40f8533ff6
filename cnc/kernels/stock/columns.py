"""Cells of one column under a tool that moves along a straight line."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.stock.cutter import BALL, CONE, FLAT, ROUNDS, Cutter, first_bounds, height, lead

Floats = NDArray[np.float64]


class Move(NamedTuple):
    """A straight move that does not rise.

    Attributes:
        along: its length L in X and Y, mm.
        dx: x of its direction in X and Y.
        dy: y of its direction.
        slope: its slope m downwards, at least 0.
        low: height of the tip at its start, mm; of a vertical move at its lower end.
    """

    along: float
    dx: float
    dy: float
    slope: float
    low: float


@njit
def cut_column(column: Floats, y: float, cell: float, x: float, move: Move, cutter: Cutter) -> None:
    """Lower the cells of a column under the tool; these loops are the formulas of ``cutter``.

    They are written out, without calls, so that the compiler takes several cells at once.

    Args:
        column: heights of the cells under the tool, mm.
        y: y of the first of them, from the start of the move, mm.
        cell: distance of the cells, mm.
        x: x of the column, from the start of the move, mm.
        move: the move.
        cutter: the tool.
    """
    along, dx, dy, slope, low = move.along, move.dx, move.dy, move.slope, move.low
    square, flat, rise = cutter.radius * cutter.radius, cutter.flat, cutter.rise
    if cutter.shape == FLAT and slope == 0.0:
        for k in range(len(column)):
            column[k] = min(column[k], low)
    elif cutter.shape == FLAT:
        for k in range(len(column)):
            b = y + k * cell
            u, v = x * dx + b * dy, b * dx - x * dy
            t = min(max(u + math.sqrt(max(0.0, square - v * v)), 0.0), along)
            column[k] = min(column[k], low - slope * t)
    elif cutter.shape == BALL:
        share = slope / math.sqrt(1.0 + slope * slope)
        for k in range(len(column)):
            b = y + k * cell
            u, v = x * dx + b * dy, b * dx - x * dy
            rim = square - v * v
            t = min(max(u + share * math.sqrt(max(0.0, rim)), 0.0), along)
            z = low + cutter.radius - slope * t - math.sqrt(max(0.0, rim - (u - t) * (u - t)))
            column[k] = min(column[k], z)
    elif cutter.shape == CONE:
        steep = rise * rise - slope * slope
        share = slope / math.sqrt(steep) if steep > 0.0 else 1e9
        for k in range(len(column)):
            b = y + k * cell
            u, v = x * dx + b * dy, b * dx - x * dy
            rim = math.sqrt(max(0.0, square - v * v))
            s = 0.0
            if slope > 0.0:
                s = min(rim, max(math.sqrt(max(0.0, flat * flat - v * v)), share * abs(v)))
            t = min(max(u + s, 0.0), along)
            r = math.sqrt(v * v + (u - t) * (u - t))
            column[k] = min(column[k], low - slope * t + rise * max(0.0, r - flat))
    else:
        steep, share, spread = slope * slope, 0.0, 0.0
        if slope > 0.0:
            share, spread = first_bounds(cutter, slope)
        for k in range(len(column)):
            b = y + k * cell
            u, v = x * dx + b * dy, b * dx - x * dy
            s = 0.0
            if slope > 0.0:
                beside = v * v
                contact = math.sqrt(beside + share * share * max(0.0, square - beside))
                sine = max(0.0, (abs(v) - flat) / rise) + spread
                sine = max(0.0, min((contact - flat) / rise, sine, 1.0))
                for _ in range(ROUNDS):
                    r = flat + rise * sine
                    value = ((1.0 + steep) * r * r - beside) * sine * sine - steep * r * r
                    rate = (1.0 + steep) * sine * r * (r + rise * sine) - beside * sine
                    rate -= steep * rise * r
                    sine = max(0.0, sine - max(0.0, 0.5 * value / max(rate, 1e-300)))
                r = flat + rise * sine
                s = math.sqrt(max(0.0, r * r - beside))
            t = min(max(u + s, 0.0), along)
            beyond = max(0.0, math.sqrt(v * v + (u - t) * (u - t)) - flat)
            corner = rise - math.sqrt(max(0.0, rise * rise - beyond * beyond))
            column[k] = min(column[k], low - slope * t + corner)


@njit
def depth_in_column(
    column: Floats, y: float, cell: float, x: float, move: Move, cutter: Cutter
) -> tuple[float, int]:
    """Return how deep (mm) the tool enters a column, and the cell; arguments as of the cut."""
    deepest, place = 0.0, 0
    for k in range(len(column)):
        b = y + k * cell
        u, v = x * move.dx + b * move.dy, b * move.dx - x * move.dy
        t = min(max(u + lead(cutter, move.slope, v), 0.0), move.along)
        r = min(math.sqrt(v * v + (u - t) * (u - t)), cutter.radius)
        depth = column[k] - (move.low - move.slope * t + height(cutter, r))
        if depth > deepest:
            deepest, place = depth, k
    return deepest, place
