"""Cutting of straight moves above a surface into pieces within a tolerance.

A move is cut where it crosses a line of the grid, and between these places into equal parts. Their
number follows from the bend of the surface: a chord over a length h is off by h^2 / 8 times it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.path.surface import Surface

Floats = NDArray[np.float64]
APART = 1e-9
"""Least difference of two places on a move, as a part of its length."""


class Moves(NamedTuple):
    """Straight moves, each wholly on the grid or wholly off it.

    Attributes:
        begin: Programmed begin (n, axes), mm.
        end: Programmed end (n, axes), mm.
        origin: Number of the move of the block (n,).
        follows: Whether the move follows the surface (n,).
        excess: Raise at the begin beyond the surface; it ends with the move (n,), mm.
        last: Raise at the end of a move that does not follow the surface (n,), mm.
    """

    begin: Floats
    end: Floats
    origin: NDArray[np.intp]
    follows: NDArray[np.bool_]
    excess: Floats
    last: Floats


class Cutter:
    """Cuts moves into pieces.

    Args:
        surface: The surface.
        x: Column of X.
        y: Column of Y.
        tolerance: Largest distance of a piece from the warped move, mm.
    """

    def __init__(self, surface: Surface, x: int, y: int, tolerance: float) -> None:
        self._surface, self._x, self._y, self._tolerance = surface, x, y, tolerance

    def cut(self, moves: Moves) -> tuple[Floats, NDArray[np.intp], Floats]:
        """Return place (n,), move (n,) and raise (n,) of the ends of all pieces."""
        at, move = self._crossings(moves)
        first = np.r_[True, np.diff(move) != 0]
        before = np.where(first, 0.0, np.r_[0.0, at[:-1]])
        counts = np.where(moves.follows[move], self._counts(moves, move, before, at), 1)
        index = np.repeat(np.arange(len(at)), counts)
        step = np.arange(len(index)) - np.repeat(np.cumsum(counts) - counts, counts) + 1
        share = step / counts[index]
        places = before[index] + share * (at - before)[index]
        places[step == counts[index]] = at
        move = move[index]
        points = moves.begin[move] + places[:, None] * (moves.end - moves.begin)[move]
        raised = moves.last[move] * places
        follows = moves.follows[move]
        left = moves.excess[move] * (1.0 - places)
        raised[follows] = (
            self._surface.heights(points[follows, self._x], points[follows, self._y])
            + left[follows]
        )
        return places, move, raised

    def _crossings(self, moves: Moves) -> tuple[Floats, NDArray[np.intp]]:
        """Return the places (n,) and moves (n,) of the ends and of the crossings of grid lines."""
        count = len(moves.begin)
        numbers = np.arange(count)
        places, owners = [np.ones(count)], [numbers]
        for column, knots in ((self._x, self._surface.x), (self._y, self._surface.y)):
            a, b = moves.begin[:, column], moves.end[:, column]
            low = np.searchsorted(knots, np.minimum(a, b), "right")
            crossed = np.searchsorted(knots, np.maximum(a, b), "left") - low
            crossed = np.where(moves.follows, np.maximum(crossed, 0), 0)
            owner = np.repeat(numbers, crossed)
            nth = np.arange(len(owner)) - np.repeat(np.cumsum(crossed) - crossed, crossed)
            places.append((knots[low[owner] + nth] - a[owner]) / (b - a)[owner])
            owners.append(owner)
        at, move = np.concatenate(places), np.concatenate(owners)
        order = np.lexsort((at, move))
        at, move = at[order], move[order]
        before = np.r_[0.0, at[:-1]]
        before[np.r_[True, np.diff(move) != 0]] = 0.0
        # The end of a move stays; a crossing next to it, or next to another one, does not.
        keep = (at == 1.0) | ((at - before > APART) & (at < 1.0 - APART))
        ends = np.r_[np.diff(move) != 0, True]
        keep &= ends | (at < 1.0)
        return at[keep], move[keep]

    def _counts(
        self, moves: Moves, move: NDArray[np.intp], before: Floats, at: Floats
    ) -> NDArray[np.int64]:
        """Return the number of pieces of each span, by the bend of the surface along it."""
        way = (moves.end - moves.begin)[move] * (at - before)[:, None]
        middle = moves.begin[move] + 0.5 * (at + before)[:, None] * (moves.end - moves.begin)[move]
        cell = self._surface.cell_of(middle[:, self._x], middle[:, self._y])
        dx, dy = np.abs(way[:, self._x]), np.abs(way[:, self._y])
        bends = self._surface.bends
        bend = bends.xx[cell] * dx * dx + 2.0 * bends.xy[cell] * dx * dy + bends.yy[cell] * dy * dy
        return np.maximum(np.ceil(np.sqrt(bend / (8.0 * self._tolerance))), 1.0).astype(np.int64)
