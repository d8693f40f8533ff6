"""Warp of a program to a surface: blocks in, blocks with the height of the surface added to Z.

    blocks  ──►  arcs and NURBS as chords  ──►  pieces of each move, raised  ──►  blocks

A piece is so short that it is within ``tolerance`` of the warped move: a quarter is for the chords
of a curve, a quarter for the pieces, and a half for the blend of pieces where the program asks for
an exact path. Every cell of the grid that a move crosses has pieces of its own.

Outside the grid the surface is not known. A feed move there is an error. A traverse runs straight
from its end outside to the border of the grid, where it meets the warped path. A machine stands
unwarped before the program; the first traverse leads to the warped path.

The blocks are taken one at a time and a move a few thousand pieces at a time, so that memory does
not grow with the program.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from cnc.machine.height_map import HeightMap, load_height_map
from cnc.machine.models import Machine
from cnc.model.blocks import (
    ROTARY_LETTERS,
    ArcFeed,
    Block,
    BoardCommand,
    Dwell,
    NurbsFeed,
    PathMode,
    Polyline,
    Probe,
    SpindleSync,
    TipControl,
)
from cnc.model.diagnostics import Diagnostic, GcodeError, UsageError, printable
from cnc.model.motion_commands import command_array, places_of
from cnc.path.block_pieces import Frame
from cnc.path.fit_curves import SAGITTA, arc_chords, nurbs_chords
from cnc.path.records import axis_classes

Floats = NDArray[np.float64]

# A surface over a grid in X and Y, bilinear or a bicubic natural spline.
#
# Each cell of the grid is a bicubic polynomial in Bernstein form; a bilinear cell is one of degree
# 1, raised to degree 3. The second differences of its 16 coefficients bound its second derivatives,
# because a polynomial lies in the hull of its coefficients (Farin, Curves and Surfaces for CAGD,
# section 6.3). The natural spline solves the usual equations of its slopes (de Boor, A Practical
# Guide to Splines, chapter IV).


class Bends(NamedTuple):
    """Upper bounds of the second derivatives in each cell (rows, columns), 1/mm."""

    xx: Floats
    xy: Floats
    yy: Floats


def map_for(machine: Machine, file: str) -> HeightMap:
    """Return the height map of a file for a machine.

    Raises:
        UsageError: ``height-map-file``, ``height-map-machine``, ``height-map-gap``.
    """
    measured = load_height_map(Path(file))
    if machine.kind == "lathe" or not {"x", "y", "z"} <= set(machine.axes):
        message = f"a height map needs X, Y and Z of a mill; {machine.name} has others"
        hint = "leave --height-map out, or name another machine"
        raise UsageError(Diagnostic("height-map-machine", message, hint=hint))
    if measured.gaps:
        raise UsageError(measured.gap_finding(printable(file)))
    return measured


class Surface:
    """Heights over a rectangle.

    Args:
        x: Positions of the columns (m,), ascending, mm.
        y: Positions of the rows (n,), ascending, mm.
        heights: Heights (n, m), mm.
        smooth: Whether it is the bicubic natural spline; else it is bilinear.

    Attributes:
        bends: Bounds of the second derivatives in each cell.
        highest: Upper bound of the heights, mm.
    """

    def __init__(self, x: Floats, y: Floats, heights: Floats, *, smooth: bool) -> None:
        self.x, self.y = np.asarray(x, np.float64), np.asarray(y, np.float64)
        values = np.asarray(heights, np.float64)
        self._cells = _cells(self.x, self.y, values, smooth=smooth)
        self.bends = _bends(self.x, self.y, self._cells)
        self.highest = float(self._cells.max())

    @classmethod
    def of(cls, measured: HeightMap) -> Surface:
        """Return the surface of a height map without gaps."""
        heights = np.array(measured.heights, np.float64)
        smooth = measured.interpolation == "bicubic"
        return cls(np.array(measured.x), np.array(measured.y), heights, smooth=smooth)

    def inside(self, x: Floats, y: Floats) -> NDArray[np.bool_]:
        """Return whether points lie on the grid; rounding of 1e-6 mm is allowed."""
        is_inside: NDArray[np.bool_] = (
            (x >= self.x[0] - 1e-6)
            & (x <= self.x[-1] + 1e-6)
            & (y >= self.y[0] - 1e-6)
            & (y <= self.y[-1] + 1e-6)
        )
        return is_inside

    def cell_of(self, x: Floats, y: Floats) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return row and column of the cells of points."""
        column = np.clip(np.searchsorted(self.x, x, "right") - 1, 0, len(self.x) - 2)
        row = np.clip(np.searchsorted(self.y, y, "right") - 1, 0, len(self.y) - 2)
        return row, column

    def heights(self, x: Floats, y: Floats) -> Floats:
        """Return the heights at points on the grid, mm."""
        row, column = self.cell_of(x, y)
        u = _basis((x - self.x[column]) / (self.x[column + 1] - self.x[column]))
        v = _basis((y - self.y[row]) / (self.y[row + 1] - self.y[row]))
        heights: Floats = np.einsum("nb,nba,na->n", v, self._cells[row, column], u)
        return heights


def _basis(u: Floats) -> Floats:
    """Return the cubic Bernstein polynomials (n, 4) at u (n,), limited to 0 to 1."""
    u = np.clip(u, 0.0, 1.0)
    w = 1.0 - u
    return np.stack((w * w * w, 3.0 * w * w * u, 3.0 * w * u * u, u * u * u), axis=1)


def _cells(x: Floats, y: Floats, values: Floats, *, smooth: bool) -> Floats:
    """Return the coefficients of the cells (rows, columns, 4 in y, 4 in x)."""
    if not smooth:
        along = _raised(values)
        return np.swapaxes(_raised(np.swapaxes(along, 0, 2)), 0, 2).transpose(0, 1, 3, 2)
    along_x, along_y = _slopes(x), _slopes(y)
    in_x = _hermite(values, values @ along_x.T, np.diff(x))
    slope_y = along_y @ values
    slope_in_x = _hermite(slope_y, slope_y @ along_x.T, np.diff(x))
    wide = np.moveaxis(in_x, 0, -1), np.moveaxis(slope_in_x, 0, -1)
    both = _hermite(*wide, np.diff(y))
    return np.moveaxis(both, (2, 0, 3, 1), (0, 1, 2, 3))


def _raised(values: Floats) -> Floats:
    """Return straight lines between the last axis' values as cubics (..., n - 1, 4)."""
    part = np.arange(4.0) / 3.0
    lines: Floats = values[..., :-1, None] * (1.0 - part) + values[..., 1:, None] * part
    return lines


def _hermite(values: Floats, slopes: Floats, steps: Floats) -> Floats:
    """Return cubics (..., n - 1, 4) of the values and slopes along the last axis."""
    third = steps / 3.0
    first, last = values[..., :-1], values[..., 1:]
    cubics: Floats = np.stack(
        (first, first + slopes[..., :-1] * third, last - slopes[..., 1:] * third, last), axis=-1
    )
    return cubics


def _slopes(x: Floats) -> Floats:
    """Return the matrix (n, n) from the values of the natural spline to its slopes."""
    n, steps = len(x), np.diff(x)
    left, right = np.zeros((n, n)), np.zeros((n, n))
    for end, inner, first in ((0, 1, 0), (n - 1, n - 2, n - 2)):
        left[end, end], left[end, inner] = 2.0, 1.0
        right[end, first], right[end, first + 1] = -3.0 / steps[first], 3.0 / steps[first]
    for k in range(1, n - 1):
        before, behind = 1.0 / steps[k - 1], 1.0 / steps[k]
        left[k, k - 1 : k + 2] = before, 2.0 * (before + behind), behind
        a, b = 3.0 * before * before, 3.0 * behind * behind
        right[k, k - 1 : k + 2] = -a, a - b, b
    return np.asarray(np.linalg.solve(left, right), np.float64)


def _bends(x: Floats, y: Floats, cells: Floats) -> Bends:
    """Return the bounds of the second derivatives of cells."""
    wide, high = np.diff(x)[None, :], np.diff(y)[:, None]

    def largest(differences: Floats) -> Floats:
        most: Floats = np.abs(differences).max(axis=(2, 3))
        return most

    return Bends(
        6.0 * largest(np.diff(cells, 2, axis=3)) / wide**2,
        9.0 * largest(np.diff(np.diff(cells, axis=3), axis=2)) / (wide * high),
        6.0 * largest(np.diff(cells, 2, axis=2)) / high**2,
    )


# Cutting of straight moves above a surface into pieces within a tolerance.
#
# A move is cut where it crosses a line of the grid, and between these places into equal parts.
# Their number follows from the bend of the surface: a chord over a length h is off by h^2 / 8 times
# it.

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


MOVES_AT_ONCE = 1024
PIECES_AT_ONCE = 4096
SAME = 1e-6
"""Distance at which two heights are the same, mm."""


class Warp:
    """Adds the height of a surface to the Z of blocks.

    Args:
        surface: The surface, over machine X and Y.
        axes: Letters of the axes, in the order of the columns.
        tolerance: Largest distance of the pieces from the warped moves, mm.
        blend: Tolerance of G64 without P, mm.
        top: Highest machine coordinate of Z, mm. No traverse is raised above it.

    Attributes:
        pieces: Straight pieces of all moves of the latest reading.
    """

    def __init__(
        self,
        surface: Surface,
        axes: tuple[str, ...],
        tolerance: float,
        *,
        blend: float = 0.0,
        top: float = math.inf,
    ) -> None:
        self.pieces = 0
        self._surface, self._axes, self._top, self._blend = surface, axes, top, blend
        self._x, self._y, self._z = (axes.index(letter) for letter in "xyz")
        self._chord, self._join = tolerance / 4.0, tolerance / 2.0
        self._cutter = Cutter(surface, self._x, self._y, tolerance / 4.0)
        self._frame = Frame(axes, axis_classes(axes), 1e-12)
        self._others = [k for k in range(len(axes)) if k not in (self._x, self._y, self._z)]
        self._rotary = [k for k, letter in enumerate(axes) if letter in ROTARY_LETTERS]
        self._position: Floats = np.zeros(len(axes))
        self._raise = 0.0
        self._mode: PathMode | None = None

    def blocks(self, blocks: Iterable[Block], start: Floats) -> Iterator[Block]:
        """Yield the warped blocks.

        Args:
            blocks: The program.
            start: Position of the machine before it (axes,), mm.

        Raises:
            GcodeError: ``height-map-outside``, ``height-map-start``, ``height-map-code``.
        """
        self.pieces = 0
        self._position, self._raise, self._mode = np.array(start, np.float64), 0.0, None
        for block in blocks:
            if isinstance(block, Polyline):
                yield from self._polyline(block)
            elif isinstance(block, ArcFeed):
                yield from self._chords(
                    block, [arc_chords(block, self._position, self._axes, self._chord)]
                )
            elif isinstance(block, NurbsFeed):
                yield from self._nurbs(block)
            else:
                self._note(block)
                yield block
                if isinstance(block, BoardCommand) and block.answer.values:
                    self._position, self._raise = np.array(block.answer.values), 0.0

    def _note(self, block: Block) -> None:
        """Take over a block without motion, or refuse it."""
        if isinstance(block, PathMode):
            self._mode = block
        elif isinstance(block, Probe):
            self._refuse(block, "a probing move")
        elif isinstance(block, TipControl) and block.offset is not None:
            self._refuse(block, "tool-tip control")
        elif isinstance(block, SpindleSync) and block.pitch:
            self._refuse(block, "motion that follows the spindle")

    def _refuse(self, block: Block, what: str) -> NoReturn:
        message = f"{what} does not go with a height map"
        raise _error(block, block.line, "height-map-code", message, "run it without --height-map")

    # Curves

    def _nurbs(self, block: NurbsFeed) -> Iterator[Block]:
        runs = nurbs_chords(block, self._position, self._frame, self._chord / SAGITTA)
        if runs is None:
            self._refuse(block, "a NURBS that moves further axes")
        yield from self._chords(block, runs)

    def _chords(self, block: ArcFeed | NurbsFeed, runs: Iterable[Floats]) -> Iterator[Block]:
        """Yield the warped chords of a curve as one blend."""

        def moves() -> Iterator[Block]:
            for points in runs:
                count = len(points)
                chords = Polyline(
                    block.file,
                    block.line,
                    points,
                    np.full(count, block.feed),
                    np.full(count, block.line, np.int32),
                    timed=block.timed,
                )
                for pieces, _ in self._raised(chords):
                    yield from _sliced(pieces)

        yield from self._joined(block, moves())

    def _joined(self, block: Block, pieces: Iterable[Block]) -> Iterator[Block]:
        """Yield the pieces of one move, which are blended where the program's path is exact."""
        mode = self._mode or PathMode(block.file, block.line, "exact-path")
        if self._is_blended():
            yield from pieces
            return
        line = block.line
        yield PathMode(block.file, line, "blend", self._join)
        yield from pieces
        yield replace(mode, file=block.file, line=line)
        if mode.control == "exact-stop":
            # The motion rests before each block that does not move.
            yield Dwell(block.file, line, 0.0)

    def _is_blended(self) -> bool:
        """Whether the program itself lets corners be blended."""
        mode = self._mode
        return mode is not None and mode.control == "blend" and (mode.tolerance or self._blend) > 0

    # Straight moves

    def _polyline(self, block: Polyline) -> Iterator[Block]:
        """Yield straight moves; under an exact path the pieces of each are blended."""
        for pieces, origin in self._raised(block):
            if self._is_blended():
                yield from _sliced(pieces)
                continue
            whole = np.diff(origin, prepend=-1) != 0
            whole[:-1] &= whole[1:]
            bounds = np.flatnonzero((np.diff(origin) != 0) & ~(whole[:-1] & whole[1:])) + 1
            for low, high in pairwise([0, *bounds.tolist(), len(origin)]):
                part = _part(pieces, slice(low, high))
                if whole[low]:
                    yield part
                else:
                    yield from self._joined(part, _sliced(part))

    def _raised(self, block: Polyline) -> Iterator[tuple[Polyline, NDArray[np.intp]]]:
        """Yield the raised pieces of straight moves, and the number of the move of each."""
        for first in range(0, len(block.points), MOVES_AT_ONCE):
            part = _part(block, slice(first, first + MOVES_AT_ONCE))
            for few in self._by_size(part):
                yield self._pieces(few)

    def _by_size(self, block: Polyline) -> Iterator[Polyline]:
        """Yield the moves, a few at a time if they are long: each crosses many cells."""
        surface = self._surface
        if len(block.points) == 1:
            yield block
            return
        begin = np.vstack((self._position, block.points[:-1]))
        cell = min(float(np.diff(surface.x).min()), float(np.diff(surface.y).min()))
        most = len(surface.x) + len(surface.y)
        length = np.abs(block.points - begin)[:, [self._x, self._y]].sum(axis=1)
        crossed = np.cumsum(1.0 + np.minimum(length / cell, most))
        group = (crossed / PIECES_AT_ONCE).astype(np.int64)
        bounds = [0, *(np.flatnonzero(np.diff(group)) + 1).tolist(), len(block.points)]
        for low, high in pairwise(bounds):
            yield _part(block, slice(low, high))

    def _pieces(self, block: Polyline) -> tuple[Polyline, NDArray[np.intp]]:
        """Return the raised pieces of a few moves, and the number of the move of each."""
        self._check_axes(block)
        moves = self._classified(block)
        at, move, raised = self._cutter.cut(moves)
        points = moves.begin[move] + at[:, None] * (moves.end - moves.begin)[move]
        points[at == 1.0] = moves.end[move[at == 1.0]]
        origin = moves.origin[move]
        traverse = np.isnan(block.feeds[origin])
        z = points[:, self._z]
        limit = np.where(traverse, np.maximum(z, self._top), np.inf)
        points[:, self._z] = np.minimum(z + raised, limit)
        self._raise = float(points[-1, self._z] - block.points[-1, self._z])
        self._position = np.array(block.points[-1], np.float64)
        self.pieces += len(points)
        commands = None
        if block.commands is not None:
            firsts = np.searchsorted(origin, np.arange(len(block.points)))
            commands = command_array(
                len(points), {int(firsts[k]): block.commands[k] for k in places_of(block.commands)}
            )
        lines = block.lines[origin]
        raised_moves = Polyline(
            block.file, int(lines[0]), points, block.feeds[origin], lines, commands, block.timed
        )
        return raised_moves, origin

    def _check_axes(self, block: Polyline) -> None:
        """Refuse turns of a rotary axis: the surface would turn with it, or the tool tilt."""
        if not self._rotary:
            return
        turned = np.abs(block.points - np.vstack((self._position, block.points[:-1]))) > SAME
        wrong = turned[:, self._rotary].any(axis=1)
        if wrong.any():
            self._refuse(
                replace(block, line=int(block.lines[int(np.argmax(wrong))])),
                "the turn of a rotary axis",
            )

    def _classified(self, block: Polyline) -> Moves:
        """Return the moves, those that leave the grid in parts."""
        begin = np.vstack((self._position, block.points[:-1]))
        end = block.points
        count = len(end)
        inside = self._surface.inside(end[:, self._x], end[:, self._y])
        starts = self._surface.inside(begin[:1, self._x], begin[:1, self._y])
        from_grid = np.append(starts, inside[:-1])
        excess = np.zeros(count)
        if from_grid[0]:
            excess[0] = self._raise - float(self._height(begin[:1])[0])
            if abs(excess[0]) <= SAME:
                excess[0] = 0.0
        both = from_grid & inside
        if both.all() and not self._free(block, begin, excess).any():
            origin = np.arange(count)
            return Moves(begin, end, origin, both, excess, np.zeros(count))
        return self._split(block, begin, both)

    def _free(self, block: Polyline, begin: Floats, excess: Floats) -> NDArray[np.bool_]:
        """Return the moves after which Z may not be that of the surface, or that begin so."""
        z = block.points[:, self._z]
        is_free: NDArray[np.bool_] = excess != 0.0
        if z.max() + self._surface.highest > self._top:
            end_z = z + self._height(block.points)
            is_free |= np.isnan(block.feeds) & (end_z > np.maximum(self._top, z))
        return is_free

    def _height(self, points: Floats) -> Floats:
        return self._surface.heights(points[:, self._x], points[:, self._y])

    def _split(self, block: Polyline, begin: Floats, both: NDArray[np.bool_]) -> Moves:
        """Return moves of which some leave the grid, or begin off the warped path."""
        parts: list[tuple[Floats, Floats, int, bool, float, float]] = []
        raised = self._raise
        for k, (a, b) in enumerate(zip(begin, block.points, strict=True)):
            feeds = not math.isnan(block.feeds[k])
            if feeds and not both[k]:
                self._outside(block, k, begin[k])
            low, high = self._span(a, b)
            inner_a, inner_b = a + low * (b - a), a + high * (b - a)
            if low > high:
                parts.append((a, b, k, False, 0.0, 0.0))
                raised = 0.0
                continue
            if low > 0.0:
                parts.append((a, inner_a, k, False, 0.0, float(self._height(inner_a[None])[0])))
                raised = parts[-1][5]
            else:
                inner_a = a
            excess = raised - float(self._height(inner_a[None])[0])
            excess = 0.0 if abs(excess) <= SAME else excess
            if feeds and excess and np.hypot(*(b - a)[[self._x, self._y]]) > SAME:
                self._unwarped(block, k)
            inner_b = b if high >= 1.0 else inner_b
            parts.append((inner_a, inner_b, k, True, excess, 0.0))
            raised = float(self._height(inner_b[None])[0])
            if high < 1.0:
                parts.append((inner_b, b, k, False, 0.0, 0.0))
                raised = 0.0
            elif not feeds:
                raised = min(raised, max(self._top - b[self._z], 0.0))
        starts, ends, origin, follows, excesses, lasts = zip(*parts, strict=True)
        return Moves(
            np.array(starts),
            np.array(ends),
            np.array(origin, np.intp),
            np.array(follows, np.bool_),
            np.array(excesses),
            np.array(lasts),
        )

    def _span(self, a: Floats, b: Floats) -> tuple[float, float]:
        """Return the part of a move above the grid; the first is larger if there is none."""
        low, high = 0.0, 1.0
        surface = self._surface
        for column, knots in ((self._x, surface.x), (self._y, surface.y)):
            way, here = float(b[column] - a[column]), float(a[column])
            lowest, highest = float(knots[0]), float(knots[-1])
            if abs(way) < 1e-12:
                if not lowest - SAME <= here <= highest + SAME:
                    return 1.0, 0.0
                continue
            first, last = sorted(((lowest - here) / way, (highest - here) / way))
            low, high = max(low, first), min(high, last)
        # An end that rounding puts beside the grid is on it.
        ends = np.stack((a, b))
        on = surface.inside(ends[:, self._x], ends[:, self._y])
        return 0.0 if on[0] else low, 1.0 if on[1] else high

    def _outside(self, block: Polyline, k: int, begin: Floats) -> NoReturn:
        """Refuse a feed move outside the grid."""
        ends = np.stack((block.points[k], begin))
        out = ends[~self._surface.inside(ends[:, self._x], ends[:, self._y])][0]
        surface = self._surface
        place = f"X{out[self._x]:.3f} Y{out[self._y]:.3f}"
        grid = (
            f"X{surface.x[0]:.3f} to {surface.x[-1]:.3f}, Y{surface.y[0]:.3f} to "
            f"{surface.y[-1]:.3f}"
        )
        message = f"the move is at {place} outside the height map ({grid}), in machine coordinates"
        hint = "probe a larger grid, or correct the work offset"
        raise _error(block, int(block.lines[k]), "height-map-outside", message, hint)

    def _unwarped(self, block: Polyline, k: int) -> NoReturn:
        message = "this feed move begins where Z is not at the height of the surface"
        hint = "move there with G0, or straight down with G1"
        raise _error(block, int(block.lines[k]), "height-map-start", message, hint)


def _part(block: Polyline, part: slice) -> Polyline:
    """Return some moves of a polyline with their commands."""
    lines = block.lines[part]
    return replace(
        block,
        line=int(lines[0]),
        points=block.points[part],
        feeds=block.feeds[part],
        lines=lines,
        commands=None if block.commands is None else block.commands[part],
    )


def _sliced(block: Polyline) -> Iterator[Polyline]:
    """Yield the moves of a polyline in parts of limited size."""
    for first in range(0, len(block.points), PIECES_AT_ONCE):
        yield _part(block, slice(first, first + PIECES_AT_ONCE))


def _error(block: Block, line: int, code: str, message: str, hint: str) -> GcodeError:
    return GcodeError(Diagnostic(code, message, block.file, line, hint=hint))
