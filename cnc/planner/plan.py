"""A plan: phases of constant jerk over the arc length of a stretch of path; its parts; its clock.

It is the one timing model: estimates, samples and pulses are computed from it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import Block, Dwell
from cnc.model.motion_commands import joined
from cnc.path.chunk import PathChunk
from cnc.path.kernels.arclength import curve_inv_arclen
from cnc.path.kernels.curve import LENGTH, LINE, START, Pieces, curve_eval
from cnc.planner.kernels.arrays import PlanArrays
from cnc.planner.kernels.corner_places import state_at
from cnc.planner.kernels.legs import REST, record_end, write_line

Floats = NDArray[np.float64]

BISECTIONS = 60
"""Halvings of a phase until its time is exact to rounding."""


@dataclass(frozen=True, slots=True)
class PlanChunk:
    """Motion over ``path`` from local arc length ``phase_s[0]`` to ``phase_s[-1]``.

    Within phase k, with dt = t - phase_t[k], s = phase_s[k] + dt (v + dt (a / 2 + dt j / 6)).

    Attributes:
        path: the n pieces that the motion touches; a chunk may begin and end inside a piece.
        piece_s: (n + 1,): local arc length at the ends of the pieces, 0 at the start of the first.
        t0: time since the start of the program at which the motion begins, s.
        s0: path length before local arc length 0, mm.
        phase_t: (m + 1,): times from t0, starting with 0.
        phase_s: (m + 1,): arc length at these times, mm.
        phase_v: (m + 1,): speed there, mm/s.
        phase_a: (m + 1,): tangential acceleration there, mm/s^2.
        phase_j: (m,): jerk inside each phase, mm/s^3.
    """

    path: PathChunk
    piece_s: NDArray[np.float64]
    t0: float
    s0: float
    phase_t: NDArray[np.float64]
    phase_s: NDArray[np.float64]
    phase_v: NDArray[np.float64]
    phase_a: NDArray[np.float64]
    phase_j: NDArray[np.float64]

    @property
    def duration(self) -> float:
        """Time from the first to the last end of a phase, s."""
        return float(self.phase_t[-1])

    def times_at(self, places: Floats) -> Floats:
        """Return the times from t0 (n,), s, at which the motion reaches arc lengths (n,), mm.

        Those outside the motion give its nearest end.
        """
        k = np.clip(
            np.searchsorted(self.phase_s, places, side="right") - 1, 0, len(self.phase_j) - 1
        )
        v, a, j = self.phase_v[k], self.phase_a[k], self.phase_j[k]
        ahead = places - self.phase_s[k]
        low, high = np.zeros(len(places)), self.phase_t[k + 1] - self.phase_t[k]
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            short = middle * (v + middle * (0.5 * a + middle * j / 6.0)) < ahead
            low, high = np.where(short, middle, low), np.where(short, high, middle)
        times: Floats = self.phase_t[k] + low
        return times

    def line_times(self) -> list[tuple[int, float]]:
        """Return the source lines of the path in order, each with the time that it takes, s.

        A line may go on in the next part of the plan, with further time.
        """
        at = np.clip(self.piece_s, self.phase_s[0], self.phase_s[-1])
        taken, lines = np.diff(self.times_at(at)), self.path.line
        begins = np.flatnonzero(np.diff(lines, prepend=lines[0] - 1))
        sums = np.add.reduceat(taken, begins)
        return list(zip(lines[begins].tolist(), sums.tolist(), strict=True))

    def positions(self, times: Floats) -> Floats:
        """Return the positions (n, axes), mm or degrees, at times (n,) from t0, s.

        The columns are those of the path: the axes, or tool tip and joints.
        """
        path, out = self.path, np.empty((len(times), 4, len(self.path.axes)))
        phases = np.clip(
            np.searchsorted(self.phase_t, times, side="right") - 1, 0, len(self.phase_j) - 1
        )
        for number, (time, k) in enumerate(zip(times.tolist(), phases.tolist(), strict=True)):
            s = min(max(state_at(time, k, self.arrays)[0], 0.0), float(self.piece_s[-1]))
            piece = int(np.searchsorted(self.piece_s[1:-1], s, side="right"))
            kind, at = int(path.kind[piece]), int(path.at[piece])
            u = curve_inv_arclen(kind, path.data, at, s - float(self.piece_s[piece]))
            curve_eval(kind, path.data, at, u, out[number])
        return out[:, 0]

    @property
    def arrays(self) -> PlanArrays:
        """The phases as kernels take them."""
        return PlanArrays(
            self.piece_s, self.phase_t, self.phase_s, self.phase_v, self.phase_a, self.phase_j
        )


# Parts of plans, and plans that follow each other as one.
#
# A plan may begin and end anywhere, also inside a piece of its path.


SAME = 1e-9
"""s; there is no rest between plans if their times differ by no more. Times are sums of floats."""

SHORTEST = 1e-6
"""mm; no line is parted so near to its ends: rounding would turn its direction."""


def cut_at_time(plan: PlanChunk, time: float) -> tuple[int, PlanChunk]:
    """Return the number of phases before a time, and the plan with an end of a phase there."""
    t = plan.phase_t
    k = int(np.searchsorted(t, time - SAME))
    if k >= len(t) or abs(float(t[k]) - time) <= SAME:
        return min(k, len(t) - 1), plan
    s, v, a = state_at(time, k - 1, plan.arrays)
    return k, replace(
        plan,
        phase_t=np.insert(t, k, time),
        phase_s=np.insert(plan.phase_s, k, s),
        phase_v=np.insert(plan.phase_v, k, v),
        phase_a=np.insert(plan.phase_a, k, a),
        phase_j=np.insert(plan.phase_j, k, plan.phase_j[k - 1]),
    )


def first_piece(plan: PlanChunk, phase: int) -> int:
    """Return the piece on which a phase begins; the number of pieces for the end of the plan."""
    at = plan.phase_s[phase] + REST
    return max(int(np.searchsorted(plan.piece_s, at, side="right")) - 1, 0)


def part(plan: PlanChunk, first: int, end: int) -> PlanChunk:
    """Return the phases first .. end - 1 of a plan, over the pieces that they touch."""
    if end - first == len(plan.phase_j):
        return plan
    span = slice(first, end + 1)
    phases = replace(
        plan,
        t0=plan.t0 + float(plan.phase_t[first]),
        phase_t=plan.phase_t[span] - plan.phase_t[first],
        phase_s=plan.phase_s[span],
        phase_v=plan.phase_v[span],
        phase_a=plan.phase_a[span],
        phase_j=plan.phase_j[first:end],
    )
    return over_own_pieces(phases)


def over_own_pieces(plan: PlanChunk) -> PlanChunk:
    """Return a plan over the pieces alone that its phases touch."""
    piece_s = plan.piece_s
    # A motion may begin at the end of the path but for rounding.
    begin = min(first_piece(plan, 0), len(plan.path) - 1)
    after = max(int(np.searchsorted(piece_s, plan.phase_s[-1] - REST, side="left")), begin + 1)
    zero = float(piece_s[begin])
    return replace(
        plan,
        path=plan.path.part(begin, after),
        piece_s=piece_s[begin : after + 1] - zero,
        s0=plan.s0 + zero,
        phase_s=plan.phase_s - zero,
    )


def with_own_end(plan: PlanChunk) -> PlanChunk:
    """Return a part of a plan that ends with the speed of its own last phase.

    Where a timed piece follows, the coordinate of the plan has another speed there. A rest stays
    exactly one.
    """
    if plan.phase_v[-1] == 0.0:
        return plan
    last = len(plan.phase_j) - 1
    _, v, a = state_at(float(plan.phase_t[-1]), last, plan.arrays)
    return replace(
        plan, phase_v=np.append(plan.phase_v[:-1], v), phase_a=np.append(plan.phase_a[:-1], a)
    )


def joined_plans(before: PlanChunk, after: PlanChunk) -> PlanChunk:
    """Return two plans that follow each other as one.

    A phase or a piece that continues from one to the other becomes one. Where the operator has
    changed the feed within a line, it stays two. Within a curve the higher feed counts for all of
    it: no motion past a corner is made there.
    """
    a, b = before.path, after.path
    s = after.s0 - before.s0
    t = after.t0 - before.t0
    same = (
        before.phase_j[-1] == after.phase_j[0]
        and abs(before.phase_a[-1] - after.phase_a[0]) <= REST
        and after.phase_v[0] > 0.0
    )
    piece_s = after.piece_s + s
    if after.phase_s[0] > REST:
        a, b, begin = _joint_piece(before, after, s)
        piece_s[0] = begin
    path = joined_paths(a, b)
    phases = slice(0, len(before.phase_j) - 1 if same else len(before.phase_j))
    rest = slice(1 if same else 0, None)
    return PlanChunk(
        path=path,
        piece_s=np.concatenate((before.piece_s[: len(a)], piece_s)),
        t0=before.t0,
        s0=before.s0,
        phase_t=np.concatenate((before.phase_t[:-1], after.phase_t[rest] + t)),
        phase_s=np.concatenate((before.phase_s[:-1], after.phase_s[rest] + s)),
        phase_v=np.concatenate((before.phase_v[:-1], after.phase_v[rest])),
        phase_a=np.concatenate((before.phase_a[:-1], after.phase_a[rest])),
        phase_j=np.concatenate((before.phase_j[phases], after.phase_j)),
    )


def _joint_piece(
    before: PlanChunk, after: PlanChunk, shift: float
) -> tuple[PathChunk, PathChunk, float]:
    """Return the paths of two plans that meet inside of a piece, and where the second one begins.

    ``shift`` leads from the arc lengths of ``after`` to those of ``before``.
    """
    a, b = before.path, after.path
    begin, end = before.piece_s[-2:].tolist()
    place = float(after.phase_s[0]) + shift
    line = a.kind[-1] == b.kind[0] == LINE
    changes = not np.array_equal(a.feed[-1:], b.feed[:1], equal_nan=True)
    if line and changes and min(place - begin, end - place) > SHORTEST:
        first = _line_part(a, len(a) - 1, 0.0, end - place)
        corner = first.data[first.at[-1] + START + len(a.axes) :][: len(a.axes)]
        last = _line_part(b, 0, float(after.phase_s[0]), 0.0, corner)
        first.stop_after[-1], first.tolerance[-1] = False, 0.0
        if last.commands is not None:
            # They have taken effect at the start of the line.
            last.commands[0] = None
        return first, last, place
    from_start = begin - shift
    if line and from_start > REST:
        # The line was parted before.
        corner = a.data[a.at[-1] + START :][: len(a.axes)]
        b = _line_part(b, 0, from_start, 0.0, corner)
    else:
        begin = shift
    b = replace(b, feed=np.append(max(a.feed[-1], b.feed[0]), b.feed[1:]))
    return a.part(0, len(a) - 1), b, begin


def _line_part(
    path: PathChunk, k: int, from_start: float, from_end: float, start: Floats | None = None
) -> PathChunk:
    """Return a copy of a path in which a line is shortened.

    Args:
        path: the path.
        k: the line.
        from_start: length taken off its start, mm.
        from_end: length taken off its end, mm.
        start: its new start, to the last bit.
    """
    data, at = _records(path)
    like, count = int(at[k]), START + 2 * len(path.axes)
    data, at = np.append(data, np.empty(count)), at.copy()
    at[k] = len(data) - count
    write_line(data, int(at[k]), like, from_start, from_end)
    if start is not None:
        data[at[k] + START :][: len(path.axes)] = start
    length = path.length.copy()
    length[k] = data[at[k] + LENGTH]
    return replace(
        path,
        at=at,
        data=data,
        length=length,
        stop_after=path.stop_after.copy(),
        tolerance=path.tolerance.copy(),
        commands=None if path.commands is None else path.commands.copy(),
    )


def joined_paths(a: PathChunk, b: PathChunk) -> PathChunk:
    """Return two paths that follow each other as one, with the file of the second."""
    data, at = _records(a)
    more, at_more = _records(b)
    return PathChunk(
        a.axes,
        b.file,
        np.concatenate((a.kind, b.kind)),
        np.concatenate((at, at_more + len(data))),
        np.concatenate((data, more)),
        np.concatenate((a.length, b.length)),
        np.concatenate((a.feed, b.feed)),
        np.concatenate((a.line, b.line)),
        np.concatenate((a.stop_after, b.stop_after)),
        np.concatenate((a.tolerance, b.tolerance)),
        joined(((a.commands, len(a)), (b.commands, len(b)))),
        b.timed,
    )


def _records(path: PathChunk) -> tuple[Floats, NDArray[np.int64]]:
    """Return the records of these pieces alone, and the index of each."""
    pieces = Pieces(path.kind, path.at, path.data)
    if not len(path):
        return path.data[:0], path.at
    lowest = int(path.at.min())
    end = max(record_end(pieces, k) for k in {len(path) - 1, int(np.argmax(path.at))})
    return path.data[lowest:end], path.at - lowest


def empty_plan(pieces: int, phases: int) -> PlanArrays:
    """Return space for a plan over so many pieces, with so many phases."""
    return PlanArrays(
        np.empty(pieces + 1),
        np.empty(phases + 1),
        np.empty(phases + 1),
        np.empty(phases + 1),
        np.empty(phases + 1),
        np.empty(phases),
    )


# The clock of a run: machine time since its first motion, dwells included.


class RunClock:
    """Machine time after the items of a plan that were added so far.

    A plan chunk sets the clock to its end, because each chunk carries its own start time. A dwell
    adds its duration. Holds and other blocks take no machine time.

    Attributes:
        seconds: The machine time, s.
    """

    __slots__ = ("seconds",)

    def __init__(self) -> None:
        self.seconds = 0.0

    def add(self, item: PlanChunk | Block) -> None:
        """Advance the clock to the end of the next item of the plan."""
        if isinstance(item, PlanChunk):
            self.seconds = item.t0 + item.duration
        elif isinstance(item, Dwell):
            self.seconds += item.seconds
