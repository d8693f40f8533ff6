r"""Corners under a tolerance, before and behind the window; the kernels of the same name tell how.

Before it the way round each corner is chosen and blends are put into the path (:class:`Rounding`).
Behind it, on finished plans, the ramps at a stop on a corner overlap (:class:`Overlaps`). A plan
may end anywhere: what the next one could still change is held back, the last phase before a stop
and the first behind it.

        v |``\            ,--
          |   \         ,'
          |    `.     ,'             emitted | held ...
          |______`-.,'______ t
                   |
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.curve import LINE
from cnc.kernels.planner.corners import round_corners
from cnc.kernels.planner.legs import REST, record_end
from cnc.kernels.planner.overlap import ROOM_OF_CORNER, overlap_room, overlap_stops
from cnc.kernels.planner.overshoot import PHASES, overshoot
from cnc.model.blocks import Block, Message
from cnc.path.chunk import PathChunk
from cnc.planner.limits import Limits
from cnc.planner.plan import PlanChunk

Floats = NDArray[np.float64]

ACCURACY = 1e-12
"""mm: of the arc length of blends and its inverse."""

BLENDS_ROOM = 1 << 16
"""Numbers of room for blends to begin with."""

SAME = 1e-9
"""s: plans follow each other without a rest where the clock says no more than this (clocks are sums
of floats).
"""


class Rounding:
    """Takes a stream of path and hands it on with blends in its corners.

    Tolerances that it leaves mark the corners where ramps shall overlap.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._taken = 0.0

    def rounded(self, stream: Iterable[PathChunk | Block]) -> Iterator[PathChunk | Block]:
        """One chunk behind the stream, as long as the motion goes on: a blend may reach into the
        next.
        """
        held: PathChunk | None = None
        for item in stream:
            if not isinstance(item, PathChunk):
                if held is not None and not isinstance(item, Message):
                    yield self._with_blends(held, None)
                    held = None
                yield item
                continue
            if held is not None:
                yield self._with_blends(held, item)
            held = item
            if item.stop_after[-1]:
                yield self._with_blends(item, None)
                held = None
        if held is not None:
            yield self._with_blends(held, None)

    def _with_blends(self, path: PathChunk, following: PathChunk | None) -> PathChunk:
        """The chunk with its corners decided; ``following`` is what the motion goes on with."""
        taken, self._taken = self._taken, 0.0
        if not taken and not path.tolerance.any():
            return path
        limits, own = self._limits, len(path)
        kind, at, data, length, feed, bound = (
            path.kind,
            path.at,
            path.data,
            path.length,
            path.feed,
            limits.feeds(path),
        )
        if following is not None:
            first = slice(0, 1)
            start = int(following.at[0])
            record = following.data[
                start : record_end(int(following.kind[0]), following.data, start)
            ]
            kind = np.append(kind, following.kind[first])
            at = np.append(at, len(data))
            data = np.append(data, record)
            length = np.append(length, following.length[first])
            feed = np.append(feed, following.feed[first])
            bound = np.append(bound, limits.feeds(following)[first])
        most = 2 * own
        room = len(data) + BLENDS_ROOM
        while True:
            out_kind, out_at = np.empty((2, most), np.int64)
            out_length, out_feed, out_tolerance = np.empty((3, most))
            out_line, out_stop, out_data = (
                np.empty(most, np.int32),
                np.empty(most, np.bool_),
                np.empty(room),
            )
            count, numbers, self._taken = round_corners(
                own, kind, at, data, length, bound, feed, path.line, path.stop_after, path.tolerance, taken,
                limits.rules, limits.axis_velocity, limits.axis_acceleration, limits.axis_jerk, ACCURACY,
                out_kind, out_at, out_data, out_length, out_feed, out_line, out_stop, out_tolerance,
            )  # fmt: skip
            if count >= 0:
                break
            room *= 2
        return PathChunk(
            path.axes, path.file, out_kind[:count], out_at[:count], out_data[:numbers].copy(),
            out_length[:count], out_feed[:count], out_line[:count], out_stop[:count], out_tolerance[:count],
        )  # fmt: skip


class Overlaps:
    """Takes plans in the order in which they run and hands them on with the corners cut; all that
    comes after happens earlier.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._held: PlanChunk | None = None
        self._earlier = 0.0
        self._shorter = 0.0

    def passed(self, plans: Iterable[PlanChunk]) -> Iterator[PlanChunk]:
        """Hand on what nothing can change any more."""
        for plan in plans:
            held = self._held
            if held is not None and (
                plan.t0 > held.t0 + held.duration + SAME or plan.path.file != held.path.file
            ):
                yield from self.flush()
                held = None
            if held is None and not plan.path.tolerance.any():
                yield self._moved(plan)
                continue
            self._held = None
            whole = plan if held is None else _joined(held, plan)
            kept = _undecided(whole)
            if kept < len(whole.phase_j):
                self._held = _part(whole, kept, len(whole.phase_j))
            if kept > 0:
                yield self._overlapped(_part(whole, 0, kept))

    def flush(self) -> Iterator[PlanChunk]:
        """Hand on what was held: the motion rests where it ends, or nobody knows how it goes on."""
        held, self._held = self._held, None
        if held is not None:
            yield self._overlapped(held)

    def _moved(self, plan: PlanChunk) -> PlanChunk:
        """The plan at its own time."""
        return (
            replace(plan, t0=plan.t0 - self._earlier, s0=plan.s0 - self._shorter)
            if self._earlier
            else plan
        )

    def _overlapped(self, plan: PlanChunk) -> PlanChunk:
        """The plan with its stops on corners cut short."""
        path, limits = plan.path, self._limits
        most, room = (1 + ROOM_OF_CORNER) * len(path), len(plan.phase_j) + PHASES * len(path) + 1
        kind, at = np.empty((2, most), np.int64)
        data = np.empty(len(path.data) + (len(path) + 1) * overlap_room(len(path.axes)))
        length, feed, tolerance, piece_s = np.empty((4, most + 1))
        line, stop = np.empty(most, np.int32), np.empty(most, np.bool_)
        t, s, v, a, j = np.empty((5, room + (1 + ROOM_OF_CORNER) * len(path)))
        past = np.zeros(len(path))
        t0, s0, v0, a0, j0 = plan.phase_t, plan.phase_s, plan.phase_v, plan.phase_a, plan.phase_j
        t1, s1, v1, a1, j1 = np.empty((5, room))
        reshaped = overshoot(
            path.kind, path.at, path.data, path.length, limits.feeds(path), path.stop_after, path.tolerance, plan.piece_s,
            t0, s0, v0, a0, j0, limits.rules, limits.axis_velocity, limits.axis_acceleration, limits.axis_jerk, past, t1, s1, v1, a1, j1,
        )  # fmt: skip
        if reshaped:
            here = slice(reshaped + 1)
            t0, s0, v0, a0, j0 = t1[here], s1[here], v1[here], a1[here], j1[:reshaped]
        while True:
            count, spans, numbers = overlap_stops(
                path.kind, path.at, path.data, path.length, path.feed, path.line, path.stop_after, path.tolerance, plan.piece_s,
                t0, s0, v0, a0, j0, past, limits.rules, limits.axis_jerk,
                kind, at, data, length, feed, line, stop, tolerance, piece_s, t, s, v, a, j,
            )  # fmt: skip
            if count >= 0:
                break
            # Neighbours have made an overshoot impossible: rare, and then none is made.
            t0, s0, v0, a0, j0 = (
                plan.phase_t,
                plan.phase_s,
                plan.phase_v,
                plan.phase_a,
                plan.phase_j,
            )
            past[:] = 0.0
        cut = self._moved(plan)
        if count:
            cut = PlanChunk(
                path=PathChunk(
                    path.axes, path.file, kind[:count], at[:count], data[:numbers].copy(),
                    length[:count], feed[:count], line[:count], stop[:count], tolerance[:count],
                ),
                piece_s=piece_s[: count + 1],
                t0=cut.t0,
                s0=cut.s0,
                phase_t=t[: spans + 1],
                phase_s=s[: spans + 1],
                phase_v=v[: spans + 1],
                phase_a=a[: spans + 1],
                phase_j=j[:spans],
            )  # fmt: skip
            self._earlier += plan.duration - cut.duration
            self._shorter += float(plan.phase_s[-1] - cut.phase_s[-1])
        return cut


def _undecided(plan: PlanChunk) -> int:
    """The phase from which on the plan may still change: the last one on its way to rest on a
    corner, and what follows such a rest.
    """
    last = len(plan.phase_j) - 1
    path = plan.path
    if path.kind[-1] != LINE:
        return last + 1
    v, a, j = plan.phase_v, plan.phase_a, plan.phase_j
    if (
        last > 0
        and v[last] == 0.0
        and a[last] == 0.0
        and j[last - 1] > 0.0
        and len(path) > 1
        and path.tolerance[-2] > 0.0
    ):
        return last - 1
    if not path.tolerance[-1] > 0.0 or j[last] <= 0.0 or a[last] >= 0.0:
        return last + 1
    to_rest = -a[-1] / j[last]
    comes_to_rest = to_rest >= -REST and abs(v[-1] - 0.5 * j[last] * to_rest**2) <= REST * max(
        float(v[last]), 1.0
    )
    return last if comes_to_rest else last + 1


def _part(plan: PlanChunk, first: int, end: int) -> PlanChunk:
    """Phases first .. end - 1 of a plan, over the pieces that they touch."""
    if end - first == len(plan.phase_j):
        return plan
    piece_s, path = plan.piece_s, plan.path
    begin = max(int(np.searchsorted(piece_s, plan.phase_s[first] + REST, side="right")) - 1, 0)
    after = max(int(np.searchsorted(piece_s, plan.phase_s[end] - REST, side="left")), begin + 1)
    zero = float(piece_s[begin])
    here, span = slice(begin, after), slice(first, end + 1)
    return PlanChunk(
        path=PathChunk(
            path.axes, path.file, path.kind[here], path.at[here], path.data,
            path.length[here], path.feed[here], path.line[here], path.stop_after[here], path.tolerance[here],
        ),
        piece_s=piece_s[begin : after + 1] - zero,
        t0=plan.t0 + float(plan.phase_t[first]),
        s0=plan.s0 + zero,
        phase_t=plan.phase_t[span] - plan.phase_t[first],
        phase_s=plan.phase_s[span] - zero,
        phase_v=plan.phase_v[span],
        phase_a=plan.phase_a[span],
        phase_j=plan.phase_j[first:end],
    )  # fmt: skip


def _joined(before: PlanChunk, after: PlanChunk) -> PlanChunk:
    """Two plans that follow each other as one; a phase or a piece that goes on from one to the
    other is one.
    """
    a, b = before.path, after.path
    pieces = slice(0, len(a) - 1 if after.phase_s[0] > REST else len(a))
    data, at = _records(a)
    more, at_more = _records(b)
    s = after.s0 - before.s0
    t = after.t0 - before.t0
    same = (
        before.phase_j[-1] == after.phase_j[0]
        and abs(before.phase_a[-1] - after.phase_a[0]) <= REST
        and after.phase_v[0] > 0.0
    )
    phases = slice(0, len(before.phase_j) - 1 if same else len(before.phase_j))
    rest = slice(1 if same else 0, None)
    return PlanChunk(
        path=PathChunk(
            a.axes, b.file,
            np.concatenate((a.kind[pieces], b.kind)),
            np.concatenate((at[pieces], at_more + len(data))),
            np.concatenate((data, more)),
            np.concatenate((a.length[pieces], b.length)),
            np.concatenate((a.feed[pieces], b.feed)),
            np.concatenate((a.line[pieces], b.line)),
            np.concatenate((a.stop_after[pieces], b.stop_after)),
            np.concatenate((a.tolerance[pieces], b.tolerance)),
        ),
        piece_s=np.concatenate((before.piece_s[pieces], after.piece_s + s)),
        t0=before.t0,
        s0=before.s0,
        phase_t=np.concatenate((before.phase_t[:-1], after.phase_t[rest] + t)),
        phase_s=np.concatenate((before.phase_s[:-1], after.phase_s[rest] + s)),
        phase_v=np.concatenate((before.phase_v[:-1], after.phase_v[rest])),
        phase_a=np.concatenate((before.phase_a[:-1], after.phase_a[rest])),
        phase_j=np.concatenate((before.phase_j[phases], after.phase_j)),
    )  # fmt: skip


def _records(path: PathChunk) -> tuple[Floats, NDArray[np.int64]]:
    """The records of these pieces alone, and where in them each begins."""
    lowest = int(path.at.min())
    end = max(
        record_end(int(path.kind[k]), path.data, int(path.at[k]))
        for k in {len(path) - 1, int(np.argmax(path.at))}
    )
    return path.data[lowest:end], path.at - lowest
