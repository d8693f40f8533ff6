r"""The path of the joints beside that of the tool tip.

    chunk: x y z  ->  parts  ->  series of tip and joints  ->  chunk: x y z | a b c

The columns of the joints ride along with those of the tip: length, feed and tolerance are measured
at the tip, and the limits of velocity, acceleration and jerk are those of the joints. Each piece is
cut into parts on which every column is a polynomial of degree 7 in the parameter u. It takes over
the position and three derivatives at both ends of the part, so the joints have no jump of
acceleration or jerk where parts meet. The remainder of this Hermite interpolation (Davis,
Interpolation and Approximation, 1963, theorem 3.5.1) on a part of length h is

    |q(u) - p(u)| <= max |q^(8)| / 8! * max |(u - u0)^4 (u - u1)^4| = M h^8 / 256

M bounds the eighth term of the Taylor series over the part: it is computed with intervals in place
of numbers. So ACCURACY is not measured at samples but proved. A straight line under a linear
kinematics stays a line.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.curve import LINE, METRICS, SPAN, START, U0, U1
from cnc.kernels.path.joint_records import (
    LARGEST_TABLE,
    ORDER,
    JointPieces,
    joint_record_size,
    write_joint_records,
)
from cnc.kinematics.interval import Interval
from cnc.kinematics.series import Series, Term
from cnc.model.blocks import Block, TipControl
from cnc.model.diagnostics import Diagnostic, MotionLimitError
from cnc.path.chunk import PathChunk
from cnc.planner.corners import CornerBlending
from cnc.planner.joint_map import JointMap
from cnc.planner.limits import Limits
from cnc.planner.tip_series import Parts, tip_series

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ACCURACY = 1e-6
"""Largest distance of a column from the exact motion, mm or degrees."""
LENGTH_ACCURACY = 1e-12
"""Largest error of the inverse arc length, mm."""
SHORTEST = 2.0**-20
"""Share of a piece below which a part is not cut again: the kinematics is singular there."""
MOST_PARTS = 8
"""Parts into which a part is cut at once."""
SEARCHED = 257
"""Places of a piece at which the reach is examined for an error message."""
TURN = 360.0
SAME_ANGLE = 1e-6
"""Angles that differ by less are the same, degrees."""


class JointPath:
    """Adds the columns of the joints to a path.

    Args:
        joints: the joints of the machine.
        tip: (axes,): the tip before the path, mm or degrees.
        start: (joints,): the joints before the path, mm or degrees.
        limits: of the tip, for the choice of blends at its corners.
        leaves: whether the joints are certain where the path begins in a singular pose.
    """

    def __init__(
        self, joints: JointMap, tip: Floats, start: Floats, limits: Limits, *, leaves: bool
    ) -> None:
        self._joints = joints
        self._tip: Floats | None = tip
        self._now = start
        self._leaves = leaves
        # A blend of the tip becomes a smooth path of joints. Where these are linear, blends are
        # made of their straight moves, which ramps may replace.
        self._blending = CornerBlending(limits, ramps=False, where=lambda: not self._joints.linear)

    def passed(self, stream: Iterable[PathChunk | Block]) -> Iterator[PathChunk | Block]:
        """Yield the stream; its chunks have the columns of the tip, then those of the joints.

        Raises:
            MotionLimitError: ``out-of-reach``, or ``singular-pose`` where a joint has no place, or
                no bounded speed, on the path.
        """
        for item in self._blending.blended(stream):
            if isinstance(item, PathChunk):
                yield self._with_joints(item)
                continue
            if isinstance(item, TipControl):
                self._joints = self._joints.with_tool(item.offset)
            yield item

    def _with_joints(self, path: PathChunk) -> PathChunk:
        leaving, joints = self._leaving(path)
        parts = self._parts(path, leaving)
        pieces = self._pieces(path, parts, leaving, joints)
        self._tip = None
        data, at, length = _records(pieces)
        piece = parts.piece
        ends = np.append(piece[1:] != piece[:-1], True)
        begins = np.insert(ends[:-1], 0, True)
        commands = None
        if path.commands is not None:
            commands = np.full(len(piece), None, object)
            commands[begins] = path.commands
        return replace(
            path,
            axes=(*path.axes, *self._joints.columns),
            kind=pieces.kind,
            at=at,
            data=data,
            length=length,
            feed=path.feed[piece],
            line=path.line[piece],
            stop_after=path.stop_after[piece] & ends,
            tolerance=np.where(ends, path.tolerance[piece], 0.0),
            commands=commands,
        )

    def _leaving(self, path: PathChunk) -> tuple[NDArray[np.bool_], Floats]:
        """Return the pieces that leave a singular pose in the direction in which it is regular.

        Only the first piece can, and only where its joints stand already.

        Returns:
            Whether each piece is such a piece (m,), and the joints at its start (m, joints).
        """
        columns = np.arange(START, START + len(path.axes))
        start = path.data[path.at[:, None] + columns]
        end = path.data[path.at[:, None] + columns + len(path.axes)]
        found, joints = self._joints.leaving(start, end)
        turned = (joints - self._now)[:, self._joints.turning]
        turned = np.abs((turned + 0.5 * TURN) % TURN - 0.5 * TURN).max(axis=1, initial=0.0)
        found &= (path.kind == LINE) & (turned < SAME_ANGLE)
        found[1:] = False
        found &= self._leaves and self._tip is not None
        return found, joints

    def _parts(self, path: PathChunk, leaving: NDArray[np.bool_]) -> Parts:
        """Return the parts of all pieces, in order, on which the polynomials are exact enough.

        Pieces that leave a singular pose are not cut.
        """
        u0, u1 = path.data[path.at + U0], path.data[path.at + U1]
        shortest = SHORTEST * (u1 - u0)
        open_parts = Parts(np.arange(len(path)), u0.copy(), u1.copy())
        done: list[Parts] = []
        whole = (path.kind == LINE) & self._joints.linear | leaving
        done.append(open_parts.of(whole))
        open_parts = open_parts.of(~whole)
        while len(open_parts.piece):
            error = self._remainder(path, open_parts)
            fits = error <= ACCURACY
            done.append(open_parts.of(fits))
            rest, error = open_parts.of(~fits), error[~fits]
            # Cutting a part that is out of reach everywhere would never end.
            reached = np.isfinite(self._joints.inverse(self._tips(path, rest.ends)))
            outside: NDArray[np.bool_] = ~np.all(reached, axis=1)
            if outside.any():
                self._refuse(path, rest.of(outside))
            narrow = rest.last - rest.first < shortest[rest.piece]
            if narrow.any():
                self._refuse(path, rest.of(narrow))
            with np.errstate(over="ignore", invalid="ignore"):
                wanted = np.ceil(1.1 * (error / ACCURACY) ** 0.125)
            wanted = np.where(np.isfinite(wanted), np.clip(wanted, 2, MOST_PARTS), 2)
            open_parts = _cut(rest, wanted.astype(np.int64))
        piece, first, last = (np.concatenate(column) for column in zip(*done, strict=True))
        order = np.lexsort((first, piece))
        return Parts(piece[order], first[order], last[order])

    def _remainder(self, path: PathChunk, parts: Parts) -> Floats:
        """Return a bound on the distance of the polynomials from the motion (m,), mm or degrees."""
        tip = tip_series(path, parts, ORDER, bounds=True)
        joints = self._joints.series(tip)
        worst = np.zeros(len(parts.piece))
        for series in (*tip, *joints):
            worst = np.maximum(worst, _size(series.terms[ORDER]))
        bound: Floats = worst * (0.5 * (parts.last - parts.first)) ** 8
        # An angle may turn by less than half a turn, or its turns could not be counted.
        for column in np.flatnonzero(self._joints.turning).tolist():
            swept = _size(joints[column].terms[1]) * (parts.last - parts.first)
            bound = np.where(swept < 0.5 * TURN, bound, np.inf)
        return np.where(np.isnan(bound), np.inf, bound)

    def _refuse(self, path: PathChunk, parts: Parts) -> None:
        """Raise the error of the first of some parts on which the joints have no bounded motion."""
        place = int(parts.piece[0])
        # The edge of the reach is singular, too: a path that goes beyond it is out of reach.
        u0, u1 = path.data[path.at[place] + U0], path.data[path.at[place] + U1]
        u = np.linspace(u0, u1, SEARCHED)
        beyond = self._tips(path, Parts(np.full(SEARCHED, place), u, u))
        outside = ~np.isfinite(self._joints.inverse(beyond)).all(axis=1)
        there = self._tips(path, parts.of(np.array([0])).starts)[0]
        if outside.any():
            there = beyond[int(np.argmax(outside))]
        begins = self._tip is not None and np.abs(there - self._tip).max() < ACCURACY
        if self._tip is not None and begins:
            there = self._tip
        each = zip(path.axes, there.tolist(), strict=True)
        named = " ".join(f"{axis.upper()}{value:.6g}" for axis, value in each)
        if not outside.any():
            code, message = "singular-pose", f"the joints turn without bound near {named}"
            hint = "keep the path clear of the pose in which the kinematics is singular"
            if begins:
                message = f"the program begins at {named}, where the kinematics is singular"
                hint = (
                    "write where the machine stands into [machine] start = { x = .., y = .. }, "
                    "or home it before the program"
                )
        else:
            code, message = "out-of-reach", f"the joints do not reach {named}"
            hint = "move the part or the work offset, or correct [kinematics] in the machine file"
        raise MotionLimitError(
            Diagnostic(code, message, path.file, int(path.line[place]), hint=hint)
        )

    def _tips(self, path: PathChunk, places: Parts) -> Floats:
        """Return the tip at places of a path (m, axes)."""
        series = tip_series(path, places, 0, bounds=False)
        return np.stack([np.asarray(each.terms[0]) for each in series], axis=-1)

    def _pieces(
        self, path: PathChunk, parts: Parts, leaving: NDArray[np.bool_], joints: Floats
    ) -> JointPieces:
        """Return the pieces of all parts.

        Args:
            path: the path.
            parts: its parts.
            leaving: whether each piece leaves a singular pose (pieces,).
            joints: the joints at the start of these pieces (pieces, joints).
        """
        at = path.at[parts.piece]
        straight = leaving[parts.piece]
        if self._joints.linear:
            straight = path.kind[parts.piece] == LINE
        left = self._columns(tip_series(path, parts.starts, 3, bounds=False))
        right = self._columns(tip_series(path, parts.ends, 3, bounds=False))
        self._take_exact_ends(path, parts, left, right)
        alone = np.flatnonzero(leaving[parts.piece])
        left[0][alone, len(path.axes) :] = joints[parts.piece[alone]]
        self._count_turns(left, right)
        # Neighbours meet to the last bit.
        start, end = left[0], right[0]
        end[:-1] = start[1:]
        form = _hermite(left, right, parts.last - parts.first)
        form[:, ORDER - 1] = end - start
        kind = np.where(straight, LINE, SPAN)
        return JointPieces(
            kind,
            parts.first,
            parts.last,
            path.data[at[:, None] + np.arange(METRICS, METRICS + 4)],
            start,
            end,
            form,
        )

    def _columns(self, tip: list[Series]) -> Floats:
        """Return the terms of tip and joints (4, m, columns)."""
        every = (*tip, *self._joints.series(tip))
        return np.stack([np.stack([np.asarray(t) for t in s.terms]) for s in every], axis=-1)

    def _take_exact_ends(self, path: PathChunk, parts: Parts, left: Floats, right: Floats) -> None:
        """Replace the positions at the ends of pieces by those of the records."""
        axes = len(path.axes)
        at = path.at[parts.piece]
        for places, u, ends, first in (
            (left, parts.first, path.data[at + U0], START),
            (right, parts.last, path.data[at + U1], START + axes),
        ):
            exact = np.flatnonzero(u == ends)
            tip = path.data[at[exact][:, None] + np.arange(first, first + axes)]
            places[0][exact, :axes] = tip
            places[0][exact, axes:] = self._joints.inverse(tip)

    def _count_turns(self, left: Floats, right: Floats) -> None:
        """Add whole turns to the angles, so that each part goes on where the last one ended."""
        axes = left.shape[2] - len(self._joints.columns)
        for column in np.flatnonzero(self._joints.turning).tolist():
            a, b = left[0][:, axes + column], right[0][:, axes + column]
            before = np.concatenate(([self._now[column]], b[:-1]))
            inside = np.rint((a - b) / TURN)
            between = np.rint((before - a) / TURN)
            turns = np.cumsum(between + np.concatenate(([0.0], inside[:-1])))
            a += TURN * turns
            b += TURN * (turns + inside)
        self._now = right[0][-1, axes:].copy()


def _size(term: Term) -> Floats | float:
    """Return the largest absolute value in intervals (m,)."""
    return np.maximum(-term.lo, term.hi) if isinstance(term, Interval) else abs(term)


def _cut(parts: Parts, counts: Ints) -> Parts:
    """Return the parts, each cut into its count of equal ones."""
    which = np.repeat(np.arange(len(counts)), counts)
    number = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    first, last = parts.first[which], parts.last[which]
    step = (last - first) / counts[which]
    final = number + 1 == counts[which]
    # The end of a part and the start of the next are computed alike.
    return Parts(
        parts.piece[which],
        first + number * step,
        np.where(final, last, first + (number + 1) * step),
    )


def _hermite(left: Floats, right: Floats, width: Floats) -> Floats:
    """Return the Bernstein coefficients, measured from the start, of Hermite polynomials.

    Args:
        left: (4, m, n): terms of the series at the start.
        right: (4, m, n): those at the end.
        width: (m,): range of the parameter.

    Returns:
        (m, 8, n): t^k has the coefficients C(i, k) / C(7, k).
    """
    form = np.zeros((left.shape[1], ORDER, left.shape[2]))
    choose = [[1.0], [1.0, 1.0], [1.0, 2.0, 1.0], [1.0, 3.0, 3.0, 1.0]]
    of_degree = (1.0, 7.0, 21.0, 35.0)
    across = right[0] - left[0]
    for i in range(4):
        for k in range(1, i + 1):
            share = (choose[i][k] / of_degree[k]) * width[:, None] ** k
            form[:, i] += share * left[k]
            form[:, ORDER - 1 - i] += share * (-1.0) ** k * right[k]
        form[:, ORDER - 1 - i] += across
    return form


def _records(pieces: JointPieces) -> tuple[Floats, Ints, Floats]:
    """Return the records of the pieces, the index of each, and their lengths (mm)."""
    count, n = pieces.start.shape
    at, length = np.empty(count, np.int64), np.empty(count)
    space = np.empty(LARGEST_TABLE + 4096 * joint_record_size(n))
    written: list[Floats] = []
    done = numbers = 0
    while done < count:
        after, used = write_joint_records(pieces, done, LENGTH_ACCURACY, space, at, length)
        at[done:after] += numbers
        written.append(space[:used].copy())
        numbers += used
        done = after
    return np.concatenate(written), at, length
