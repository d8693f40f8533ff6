"""Comparison of two programs on one machine: distance of their toolpaths, and machine times."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Machine
from cnc.model.diagnostics import printable
from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import ARC, LENGTH, LINE, SPAN, START, TABLE, U0, U1, curve_eval
from cnc.path.records import Floats
from cnc.planner.plan import PlanChunk
from cnc.report.result import Report, clock, number, position
from cnc.session.context import Callbacks
from cnc.session.options import RunOptions
from cnc.session.program_reader import start_position
from cnc.session.session import Session

# Matching of two tracks: the points that both pass in the same order.
#
# The tracks are compared between matched points. Where nothing lies between them, they are the
# same.
#
# The beginnings and ends are matched as far as they agree. Of the points between, those are matched
# that each track passes exactly once, as many as occur in the same order in both (the longest
# increasing subsequence). Text comparison does the same with lines ("patience diff"). O(n log n).

SAME = 1e-6
"""mm. Points in the same cube of this size are equal."""


@dataclass(frozen=True, slots=True)
class Hunk:
    """Stretches of two tracks that differ. They begin at the same point.

    Attributes:
        a0: first point of the stretch of the first track.
        a1: its last point, included.
        b0: first point of the stretch of the second track.
        b1: its last point, included.
        closed: whether the stretches also end at the same point.
    """

    a0: int
    a1: int
    b0: int
    b1: int
    closed: bool


def hunks(a: Floats, b: Floats) -> list[Hunk]:
    """Return the stretches in which tracks a (n, axes) and b (m, axes) differ.

    Both tracks must begin at the same point.
    """
    _, both = np.unique(
        np.round(np.concatenate((a, b)) / SAME).astype(np.int64), axis=0, return_inverse=True
    )
    both = both.reshape(-1)
    ids_a, ids_b = both[: len(a)], both[len(a) :]
    shorter = min(len(a), len(b))
    begin = _agreeing(ids_a[:shorter], ids_b[:shorter])
    end = _agreeing(ids_a[::-1][: shorter - begin], ids_b[::-1][: shorter - begin])
    pairs = _in_order(ids_a[begin : len(a) - end], ids_b[begin : len(b) - end])
    i = np.concatenate(([max(begin - 1, 0)], pairs[:, 0] + begin, [len(a) - max(end, 1)]))
    j = np.concatenate(([max(begin - 1, 0)], pairs[:, 1] + begin, [len(b) - max(end, 1)]))
    differing: Ints = np.flatnonzero((np.diff(i) != 1) | (np.diff(j) != 1))
    last = len(i) - 2
    between = [
        Hunk(int(i[k]), int(i[k + 1]), int(j[k]), int(j[k + 1]), k < last or end > 0)
        for k in differing
    ]
    if not end and last not in differing:
        # One move each, to different positions.
        between.append(Hunk(int(i[last]), int(i[-1]), int(j[last]), int(j[-1]), False))
    return [hunk for hunk in between if hunk.a1 > hunk.a0 or hunk.b1 > hunk.b0]


def _agreeing(a: Ints, b: Ints) -> int:
    """Return the number of equal elements from the beginning."""
    different = a != b
    return int(np.argmax(different)) if different.any() else len(a)


def _in_order(a: Ints, b: Ints) -> Ints:
    """Return index pairs (k, 2) of elements that occur once in each, increasing in both."""
    once_a, once_b = _once(a), _once(b)
    common, of_a, of_b = np.intersect1d(
        a[once_a], b[once_b], assume_unique=True, return_indices=True
    )
    if not len(common):
        return np.empty((0, 2), np.int64)
    pairs = np.stack((once_a[of_a], once_b[of_b]), axis=1)
    pairs = pairs[np.argsort(pairs[:, 0])]
    tails: list[int] = []
    ends: list[int] = []
    before = np.full(len(pairs), -1)
    for index, place in enumerate(pairs[:, 1].tolist()):
        rank = bisect_left(tails, place)
        if rank == len(tails):
            tails.append(place)
            ends.append(index)
        else:
            tails[rank], ends[rank] = place, index
        before[index] = ends[rank - 1] if rank else -1
    chosen = []
    index = ends[-1]
    while index >= 0:
        chosen.append(index)
        index = int(before[index])
    return pairs[chosen[::-1]]


def _once(ids: Ints) -> Ints:
    """Return the indices of elements that occur once."""
    _, first, count = np.unique(ids, return_index=True, return_counts=True)
    return np.sort(first[count == 1])


# Points along a path at a given spacing, for users of its shape alone.


def points_along(
    chunk: PathChunk, spacing: float | Floats, pieces: Ints | None = None
) -> tuple[Floats, Ints]:
    """Return points (k, n) of a chunk, and the index (k,) of the piece on which each lies.

    Each piece gives points inside and its end. Its start is the end of the piece before.

    Args:
        chunk: the path.
        spacing: largest distance of points in mm of arc length, one or (m,); on arcs and spans it
            holds about.
        pieces: indices of the pieces; all of them without it.
    """
    chosen = np.arange(len(chunk)) if pieces is None else pieces
    n = len(chunk.axes)
    at = chunk.at[chosen]
    parts = np.maximum(np.ceil(chunk.data[at + LENGTH] / spacing), 1.0).astype(np.int64)
    owner = np.repeat(np.arange(len(chosen)), parts)
    first = np.cumsum(parts) - parts
    share = (np.arange(len(owner)) - first[owner] + 1) / parts[owner]
    columns = at[:, None] + START + np.arange(2 * n)
    ends = chunk.data[columns]
    points = ends[owner, :n] + share[:, None] * (ends[owner, n:] - ends[owner, :n])
    out = np.empty((4, n))
    for index in np.flatnonzero(chunk.kind[chosen] != LINE).tolist():
        kind, record = int(chunk.kind[chosen[index]]), int(at[index])
        u0, u1 = float(chunk.data[record + U0]), float(chunk.data[record + U1])
        for row in range(int(first[index]), int(first[index] + parts[index])):
            curve_eval(kind, chunk.data, record, u0 + float(share[row]) * (u1 - u0), out)
            points[row] = out[0]
    return points, chosen[owner]


# The toolpath of a planned motion as points, corner blends included.

CHORD = 1e-4
"""mm. Largest distance of a chord from its arc."""
SPAN_SPACING, MAX_SPAN_POINTS = 0.05, 2000
"""mm between points on a span of a spline, and the largest number of points on it."""
TIMED_PARTS = 8
"""Parts of a step of a motion past a corner: it may bend much on a short way."""


@dataclass(frozen=True, slots=True)
class Track:
    """A toolpath as a polygon.

    Attributes:
        points: (n, axes) vertices, mm.
        line: (n,) source line of the move to each vertex.
        file: (n,) index of its file.
        files: the files; empty for the program itself.
    """

    points: Floats
    line: Ints
    file: Ints
    files: tuple[str, ...]


class Recorder:
    """Collects the toolpath of plans in order; ``start`` (axes,) is its first point, mm."""

    def __init__(self, start: Floats) -> None:
        self._points = [start[None]]
        self._lines = [np.zeros(1, np.int64)]
        self._file = [np.zeros(1, np.int64)]
        self._files: list[str] = [""]
        self._done = 0.0

    def add(self, plan: PlanChunk) -> None:
        """Add the pieces that the motion has completed.

        A piece that a plan ends in comes again with the next plan.
        """
        path = plan.path
        ends = plan.s0 + plan.piece_s[1:]
        reached = plan.s0 + float(plan.phase_s[-1])
        pieces: Ints = np.flatnonzero((ends > self._done + ROUNDING) & (ends <= reached + ROUNDING))
        if not len(pieces):
            return
        self._done = float(ends[pieces[-1]])
        at, length = path.at[pieces], path.length[pieces]
        body = at + START + 2 * len(path.axes)
        arc = path.kind[pieces] == ARC
        spacing = np.where(
            path.kind[pieces] == LINE, np.inf, np.maximum(SPAN_SPACING, length / MAX_SPAN_POINTS)
        )
        timed = (path.kind[pieces] == SPAN) & (path.data[at + TABLE] == 0.0)
        spacing[timed] = np.minimum(spacing[timed], length[timed] / TIMED_PARTS)
        radius, sweep = path.data[body[arc] + 2], np.abs(path.data[body[arc] + 4])
        # sagitta = r (1 - cos(angle / 2)), about r angle^2 / 8
        spacing[arc] = length[arc] / np.ceil(sweep / np.sqrt(8.0 * CHORD / radius))
        points, owner = points_along(path, spacing, pieces)
        self._points.append(points)
        self._lines.append(path.line[owner].astype(np.int64))
        if path.file not in self._files:
            self._files.append(path.file)
        self._file.append(np.full(len(points), self._files.index(path.file)))

    def track(self) -> Track:
        """Return the whole toolpath."""
        return Track(
            np.concatenate(self._points),
            np.concatenate(self._lines),
            np.concatenate(self._file),
            tuple(self._files),
        )


# Distance of two tracks that are followed in step.
#
# Between two points that both pass the tracks are sampled coarsely
# and aligned by dynamic time warping: the pairing of samples with the least sum of distances that
# never goes backwards on either track. Then each point of one track is measured against the
# stretch of the other that its neighbours are paired with. So a contour in the opposite direction
# is not the same. Long stretches are cut at paired points and measured in parts.
#
#    a  ──o────o────o────o──     Each point of a stretch is within half of its length of an end, and
#         |    |   /    /        both tracks pass the ends. So the longest stretches are measured
#    b  ──o────o──o────o────     first, and those that cannot exceed the distance found are skipped.

MIN_SAMPLES, MAX_SAMPLES = 4, 64
"""Limits of the number of aligned samples, which is that of the points of a stretch."""
LARGE = 600
"""Largest number of points of a stretch that is measured as a whole."""
MAX_DEPTH = 12
"""Largest depth of cuts within cuts."""
EXTRA_POINTS = 256
"""Points at equal distances along a stretch that are measured besides its vertices."""
ROUNDING = 1e-9
"""Relative error of squared distances."""
AT_ONCE = 200_000
"""Distances that are computed at a time."""

Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Apart:
    """The largest distance of two tracks.

    Attributes:
        distance: the distance, mm.
        position: (axes,) the point of the first track, mm.
        first: index of the vertex at the end of the move there, on the first track.
        second: the same on the second track.
    """

    distance: float
    position: Floats
    first: int
    second: int


@dataclass(frozen=True, slots=True)
class _Stretch:
    """A stretch of a track.

    Attributes:
        points: (n, axes) vertices, mm.
        index: (n,) their indices in the whole track.
        s: (n,) path length from the first vertex, mm.
    """

    points: Floats
    index: Ints
    s: Floats

    @classmethod
    def of(cls, points: Floats, index: Ints) -> _Stretch:
        if len(points) == 1:
            # A stretch without length gets two vertices.
            points, index = np.repeat(points, 2, axis=0), np.repeat(index, 2)
        return cls(
            points,
            index,
            np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))),
        )

    @property
    def length(self) -> float:
        return float(self.s[-1])

    def at(self, s: Floats) -> Floats:
        """Return the points (k, axes) at path lengths s (k,) mm."""
        return np.stack([np.interp(s, self.s, column) for column in self.points.T], axis=1)

    def part(self, begin: float, end: float) -> _Stretch:
        inside = np.flatnonzero((self.s > begin) & (self.s < end))
        points = np.concatenate(
            (self.at(np.array([begin])), self.points[inside], self.at(np.array([end])))
        )
        last = int(np.searchsorted(self.s, end))
        first = int(np.searchsorted(self.s, begin, side="right"))
        ends = self.index[np.minimum([first, last], len(self.index) - 1)]
        return _Stretch.of(points, np.concatenate((ends[:1], self.index[inside], ends[1:])))


def farthest(a: Track, b: Track) -> Apart:
    """Return the largest distance of two tracks that begin at the same point."""
    best = Apart(0.0, a.points[0], 0, 0)
    stretches = []
    for hunk in hunks(a.points, b.points):
        one, other = _stretch(a, hunk.a0, hunk.a1), _stretch(b, hunk.b0, hunk.b1)
        bound = max(one.length, other.length) / (2.0 if hunk.closed else 1.0)
        stretches.append((bound, one, other))
    for bound, one, other in sorted(stretches, key=lambda item: -item[0]):
        if bound <= best.distance:
            break
        best = _measured(one, other, best, 0)
    return best


def _stretch(track: Track, first: int, last: int) -> _Stretch:
    index = np.arange(first, last + 1)
    return _Stretch.of(track.points[index], index)


def _measured(one: _Stretch, other: _Stretch, best: Apart, depth: int) -> Apart:
    """Return the larger one of ``best`` and the distance of two stretches."""
    sizes = len(one.points), len(other.points)
    if min(one.length, other.length) == 0.0:
        # One of them does not move.
        everything = np.array([[0.0, np.inf]])
        return _farther(best, one, other, everything, everything)
    count = min(max(*sizes, MIN_SAMPLES), MAX_SAMPLES)
    s, t = np.linspace(0.0, one.length, count + 1), np.linspace(0.0, other.length, count + 1)
    pairs = _aligned(one.at(s), other.at(t))
    if max(sizes) > LARGE and depth < MAX_DEPTH:
        begin = (0.0, 0.0)
        for i, j in [*pairs[count // 8 : -1 : count // 8], pairs[-1]]:
            end = (
                (one.length, other.length)
                if (i, j) == pairs[-1]
                else (float(s[i]), _nearest(other, one.at(s[i : i + 1])[0], t, j))
            )
            end = max(end[0], begin[0]), max(end[1], begin[1])
            best = _measured(
                one.part(begin[0], end[0]), other.part(begin[1], end[1]), best, depth + 1
            )
            begin = end
        return best
    return _farther(
        best, one, other, _windows(pairs, s, t), _windows([(j, i) for i, j in pairs], t, s)
    )


def _nearest(stretch: _Stretch, point: Floats, t: Floats, j: int) -> float:
    """Return the path length, within a sample of t[j], nearest to a point."""
    fine = np.linspace(t[max(j - 1, 0)], t[min(j + 1, len(t) - 1)], 65)
    return float(fine[np.argmin(np.linalg.norm(stretch.at(fine) - point, axis=1))])


def _aligned(a: Floats, b: Floats) -> list[tuple[int, int]]:
    """Return index pairs from (0, 0) to the last points, by dynamic time warping.

    The sum of the distances of the pairs is the least possible.
    """
    apart = np.linalg.norm(a[:, None] - b[None], axis=2).tolist()
    n, m = len(a), len(b)
    cost = [apart[0][0]]
    for j in range(1, m):
        cost.append(cost[-1] + apart[0][j])
    table = [cost]
    for i in range(1, n):
        row, above = apart[i], table[-1]
        cost = [above[0] + row[0]]
        for j in range(1, m):
            cost.append(row[j] + min(above[j - 1], above[j], cost[-1]))
        table.append(cost)
    pairs = [(n - 1, m - 1)]
    while pairs[-1] != (0, 0):
        i, j = pairs[-1]
        steps = [
            (table[p][q], (p, q))
            for p, q in ((i - 1, j - 1), (i - 1, j), (i, j - 1))
            if p >= 0 and q >= 0
        ]
        pairs.append(min(steps, key=lambda step: step[0])[1])
    return pairs[::-1]


def _windows(pairs: list[tuple[int, int]], s: Floats, t: Floats) -> Floats:
    """Return the search ranges on the other stretch for the parts of one stretch.

    Args:
        pairs: aligned samples.
        s: (n,) path lengths of the samples of the one stretch, mm.
        t: (m,) path lengths of the samples of the other stretch, mm.

    Returns:
        (n - 1, 2) least and greatest path length on the other stretch, mm.
    """
    low, high = np.full(len(s), len(t)), np.zeros(len(s), np.int64)
    for i, j in pairs:
        low[i], high[i] = min(low[i], j), max(high[i], j)
    last = len(t) - 1
    return np.stack((t[np.maximum(low[:-1] - 1, 0)], t[np.minimum(high[1:] + 1, last)]), axis=1)


def _farther(
    best: Apart, one: _Stretch, other: _Stretch, of_one: Floats, of_other: Floats
) -> Apart:
    """Return the larger one of ``best`` and the distances of each stretch from the other.

    Args:
        best: the largest distance so far.
        one: a stretch of the first track.
        other: a stretch of the second track.
        of_one: search ranges for the parts of ``one``.
        of_other: search ranges for the parts of ``other``.
    """
    distance, point, _, p, q = _directed(one, other, of_one)
    if distance > best.distance:
        best = Apart(distance, point, int(one.index[p]), int(other.index[q]))
    distance, _, point, q, p = _directed(other, one, of_other)
    if distance > best.distance:
        best = Apart(distance, point, int(one.index[p]), int(other.index[q]))
    return best


def _directed(
    stretch: _Stretch, other: _Stretch, windows: Floats
) -> tuple[float, Floats, Floats, int, int]:
    """Find the point of a stretch that is farthest from the other stretch.

    Returns:
        The distance, the point, the nearest point of the other stretch, and the vertices at the
        ends of the moves there, on the stretch and on the other.
    """
    s = np.sort(np.concatenate((stretch.s, np.linspace(0.0, stretch.length, EXTRA_POINTS))))
    points = stretch.at(s)
    part = np.minimum(
        (s * len(windows) / max(stretch.length, 1e-300)).astype(np.int64), len(windows) - 1
    )
    low, high = windows[part].T
    starts, steps = other.points[:-1], np.diff(other.points, axis=0)
    squares = np.maximum((steps * steps).sum(axis=1), 1e-300)
    worst = -1.0, 0, 0, starts[0]
    rows = max(1, AT_ONCE // len(starts))
    for first in range(0, len(points), rows):
        some = slice(first, first + rows)
        behind = points[some, None] - starts
        share = np.clip((behind * steps).sum(axis=2) / squares, 0.0, 1.0)
        away = ((behind - share[:, :, None] * steps) ** 2).sum(axis=2)
        away[(other.s[1:] < low[some, None]) | (other.s[:-1] > high[some, None])] = np.inf
        nearest = away.argmin(axis=1)
        least = away[np.arange(len(nearest)), nearest]
        # The first of the points at the same distance, apart from rounding.
        k = int(np.argmax(least >= least.max() * (1.0 - ROUNDING)))
        if least[k] > worst[0] * (1.0 + ROUNDING):
            q = int(nearest[k])
            worst = float(least[k]), first + k, q, starts[q] + share[k, q] * steps[q]
    square, k, q, foot = worst
    return float(np.sqrt(square)), points[k], foot, int(np.searchsorted(stretch.s, s[k])), q + 1


@dataclass(frozen=True, slots=True)
class Place:
    """A source line; line 0 stands for the start, before any motion."""

    file: str
    line: int


@dataclass(frozen=True, slots=True)
class Difference:
    """The result of a comparison.

    Attributes:
        reports: results of both programs; or of the first ones up to a program with faults, and
            then nothing else is known.
        distance: largest distance between the toolpaths, mm (a degree of a rotary axis counts as
            a millimetre).
        at: position on the first toolpath with that distance, mm by axis.
        places: source lines of the moves there, of the first program and of the second.
    """

    reports: tuple[Report, ...]
    distance: float = 0.0
    at: dict[str, float] | None = None
    places: tuple[Place, Place] | None = None

    @property
    def same_path(self) -> bool:
        """Whether the toolpaths are the same to a millionth of a millimetre."""
        return self.distance <= SAME

    def as_json(self) -> dict[str, Any]:
        """Return the result for other programs. Pairs are [first program, second program]."""
        first, second = self.reports
        return {
            "programs": [first.program, second.program],
            "distance_mm": self.distance,
            "at": self.at,
            "files": None if self.places is None else [place.file for place in self.places],
            "lines": None if self.places is None else [place.line for place in self.places],
            "duration_s": [first.duration_s, second.duration_s],
            "path_length_mm": [first.path_length_mm, second.path_length_mm],
        }

    def lines(self) -> Iterator[str]:
        """Yield the result as lines of text."""
        first, second = self.reports
        if self.same_path or self.places is None or self.at is None:
            yield "path    the same"
        else:
            where = " ".join(f"{axis.upper()}{position(value)}" for axis, value in self.at.items())
            one, other = (f"{printable(place.file)}:{place.line}" for place in self.places)
            yield f"path    at most {number(self.distance)} mm apart, at {where}: {one}, {other}"
        yield f"length  {number(first.path_length_mm)} -> {number(second.path_length_mm)} mm"
        change = 100.0 * (second.duration_s / first.duration_s - 1.0) if first.duration_s else 0.0
        yield f"time    {clock(first.duration_s)} -> {clock(second.duration_s)} ({change:+.1f} %)"


def compare(
    first: Path | str,
    second: Path | str,
    machines: tuple[Machine, Machine],
    options: tuple[RunOptions, RunOptions] = (RunOptions(), RunOptions()),
    callbacks: Callbacks | None = None,
) -> Difference:
    """Plan both programs and compare their motion.

    Args:
        first: the first program.
        second: the second program.
        machines: the machine of each, with the same axes and start; tool tables may differ.
        options: how to read each.
        callbacks: called during the planning; None for none.
    """
    machine = machines[0]
    first_report, first_track = _planned(first, machine, options[0], callbacks)
    if not first_report.ok:
        return Difference((first_report,))
    second_report, second_track = _planned(second, machines[1], options[1], callbacks)
    if not second_report.ok:
        return Difference((first_report, second_report))
    apart = farthest(first_track, second_track)
    return Difference(
        (first_report, second_report),
        apart.distance,
        dict(zip(machine.axes, apart.position.tolist(), strict=True)),
        (
            _place(first_track, apart.first, first_report),
            _place(second_track, apart.second, second_report),
        ),
    )


def _planned(
    program: Path | str, machine: Machine, options: RunOptions, callbacks: Callbacks | None
) -> tuple[Report, Track]:
    recorder = Recorder(start_position(machine))
    session = Session(program, machine, options, callbacks=callbacks, on_plan=recorder.add)
    return session.run(), recorder.track()


def _place(track: Track, index: int, report: Report) -> Place:
    return Place(track.files[int(track.file[index])] or report.program, int(track.line[index]))
