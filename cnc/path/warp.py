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
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

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
from cnc.model.diagnostics import Diagnostic, GcodeError
from cnc.model.motion_commands import command_array, places_of
from cnc.path.arc import arc_chords
from cnc.path.block_pieces import Frame
from cnc.path.fit_curves import SAGITTA, nurbs_chords
from cnc.path.records import axis_classes
from cnc.path.surface import Surface
from cnc.path.surface_pieces import Cutter, Moves

Floats = NDArray[np.float64]
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
        known = np.append(starts, inside[:-1])
        excess = np.zeros(count)
        if known[0]:
            excess[0] = self._raise - float(self._height(begin[:1])[0])
            if abs(excess[0]) <= SAME:
                excess[0] = 0.0
        both = known & inside
        if both.all() and not self._free(block, begin, excess).any():
            origin = np.arange(count)
            return Moves(begin, end, origin, both, excess, np.zeros(count))
        return self._split(block, begin, both)

    def _free(self, block: Polyline, begin: Floats, excess: Floats) -> NDArray[np.bool_]:
        """Return the moves after which Z may not be that of the surface, or that begin so."""
        z = block.points[:, self._z]
        found: NDArray[np.bool_] = excess != 0.0
        if z.max() + self._surface.highest > self._top:
            end_z = z + self._height(block.points)
            found |= np.isnan(block.feeds) & (end_z > np.maximum(self._top, z))
        return found

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
