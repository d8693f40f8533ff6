r"""Dense samples of a path, with highest speed, feed and source line of each interval.

                     cut            cut
    ...o..o..o..o..o..O-------------O~~~
            curve         arc

Lines must meet exactly at a cut: at corners, at rests, between traverse and feed, where the
programmed feed changes, at commands that go with the motion, and at both ends of a programmed arc,
which is one interval whatever its length. All other points may be passed within the tolerance.

Curves are sampled so densely that chords between the points deviate by a small part of the
tolerance. The speed of an interval is that of :mod:`cnc.grbl_lines.speed_limits`, or the feed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cnc.grbl_lines.moves import PlaneArc
from cnc.grbl_lines.number_format import (
    BOARD_LETTERS,
    LETTERS,
    PLANE_COLUMNS,
    board_letters,
)
from cnc.grbl_lines.speed_limits import SpeedLimits
from cnc.grbl_lines.travel_margin import TravelMargin
from cnc.kernels.path.curve import ARC, LINE, SPAN, SPAN_BODY, START, U0, U1, curve_eval
from cnc.model.diagnostics import Diagnostic, GcodeError
from cnc.model.motion_commands import Commands, command_array, joined, places_of
from cnc.path.chunk import PathChunk

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

CORNER_COSINE = math.cos(math.radians(30.0))
"""A sharper turn is a corner, where lines meet exactly, as in :mod:`cnc.path.fit`."""
NO_ARC = -1
FEWEST_CHORDS, MOST_CHORDS = 4, 4096
"""Chords of a curve."""
PLANE_OF_COLUMNS = {columns[:2]: plane for plane, columns in enumerate(PLANE_COLUMNS)}


@dataclass(frozen=True, slots=True)
class PathSamples:
    """Points of a path and the intervals between them.

    Attributes:
        points: Position of each axis of the board at each point (k + 1, n), mm or degrees; 0 for
            an axis that the machine lacks.
        rest: Whether the motion comes to rest at each point (k + 1,).
        speed: Highest speed in each interval (k,), mm/s, at most its feed.
        feed: Programmed feed of each interval (k,), mm/s; NaN for a traverse. Both are by the
            length in all axes, as the board reads them.
        line: Source line of each interval (k,).
        straight: Whether an interval is a straight move of the program (k,).
        rotates: Whether an axis beside x, y, z moves (k,). Such an interval becomes one line.
        arc: Index in ``arcs`` of the programmed arc of each interval (k,), or NO_ARC.
        arcs: The programmed arcs.
        commands: Commands that take effect at the start of an interval (k,); None without any.
    """

    points: Floats
    rest: Flags
    speed: Floats
    feed: Floats
    line: NDArray[np.int32]
    straight: Flags
    rotates: Flags
    arc: NDArray[np.int64]
    arcs: tuple[PlaneArc, ...]
    commands: Commands | None = None

    def __len__(self) -> int:
        return len(self.speed)

    def from_interval(self, first: int) -> PathSamples:
        """Return the intervals from ``first`` on."""
        return replace(
            self,
            **{
                field.name: getattr(self, field.name)[first:]
                for field in fields(self)
                if field.name not in ("arcs", "commands")
            },
            commands=None if self.commands is None else self.commands[first:],
        )

    @staticmethod
    def joined(before: PathSamples, after: PathSamples) -> PathSamples:
        """Return two sets of samples as one; ``after`` begins where ``before`` ends."""
        rest = np.concatenate((before.rest, after.rest[1:]))
        rest[len(before)] |= after.rest[0]
        arc = np.where(after.arc == NO_ARC, NO_ARC, after.arc + len(before.arcs))
        return PathSamples(
            np.concatenate((before.points, after.points[1:])),
            rest,
            np.concatenate((before.speed, after.speed)),
            np.concatenate((before.feed, after.feed)),
            np.concatenate((before.line, after.line)),
            np.concatenate((before.straight, after.straight)),
            np.concatenate((before.rotates, after.rotates)),
            np.concatenate((before.arc, arc)),
            before.arcs + after.arcs,
            joined(((before.commands, len(before)), (after.commands, len(after)))),
        )

    def cuts(self) -> Flags:
        """Return the points (k + 1,) at which lines must meet exactly; both ends are among them."""
        cut = self.rest.copy()
        cut[0] = cut[-1] = True
        steps = np.diff(self.points, axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        turned = (
            np.einsum("ij,ij->i", steps[1:], steps[:-1])
            < CORNER_COSINE * lengths[1:] * lengths[:-1]
        )
        arcs = self.arc != NO_ARC
        feed = np.nan_to_num(self.feed, nan=-1.0)
        cut[1:-1] |= turned | arcs[1:] | arcs[:-1] | (feed[1:] != feed[:-1])
        cut[places_of(self.commands)] = True
        return cut


class PathSampler:
    """Samples the pieces of a path.

    Args:
        axes: Letters of the machine's axes.
        chord_error: Largest distance of chords between the samples from the path, mm.
        line_error: The same where a rotary axis moves, and the chords are sent as lines, mm.
        travel: Limits of the travel; an arc that leaves them is sampled as a curve.
        limits: Limits of the speed.
    """

    def __init__(
        self,
        axes: tuple[str, ...],
        chord_error: float,
        line_error: float,
        travel: TravelMargin,
        limits: SpeedLimits,
    ) -> None:
        letters = board_letters(axes).lower()
        self._columns = [axes.index(letter) if letter in axes else -1 for letter in letters]
        self._other_axes = [k for k, axis in enumerate(axes) if axis not in letters]
        self._chord_error = chord_error
        self._line_error = line_error
        self._travel = travel
        self._limits = limits

    def sample(self, path: PathChunk) -> PathSamples:
        """Return samples of all pieces: runs of lines at once, others one by one."""
        self._check_axes(path)
        kinds, n = path.kind, len(path.axes)
        borders = np.flatnonzero((kinds[1:] != kinds[:-1]) | (kinds[1:] != LINE)) + 1
        head = int(path.at[0]) + START
        points = [self._places(path.data[head : head + n][None])]
        speeds: list[Floats] = []
        counts: list[int] = []
        arcs: list[PlaneArc] = []
        arc: list[int] = []
        for begin, end in pairwise([0, *borders.tolist(), len(path)]):
            before = points[-1][-1:]
            programmed = None
            if kinds[begin] == LINE:
                ends = path.at[begin:end, None] + (START + n + np.arange(n))
                rows = self._places(path.data[ends])
                speeds.append(self._limits.straight(np.diff(rows, axis=0, prepend=before)))
                counts += [1] * (end - begin)
            elif (programmed := self._programmed_arc(path, begin)) is not None:
                rows = self._ends(path, begin)[1:]
                speeds.append(np.array([self._arc_speed(programmed, before[0], rows[0])]))
                counts.append(1)
            else:
                rows = self._curve(path, begin)
                speeds.append(self._limits.curve(np.concatenate((before, rows))))
                counts.append(len(rows))
            points.append(rows)
            arc += [NO_ARC if programmed is None else len(arcs)] * (end - begin)
            arcs += [] if programmed is None else [programmed]
        each = np.repeat(np.arange(len(path)), counts)
        rest = np.zeros(len(each) + 1, np.bool_)
        rest[np.cumsum(counts)] = path.stop_after
        feed = path.feed[each]
        most = np.fmin(np.where(np.isnan(feed), np.inf, self._limits.feed), feed)
        joined_points = np.concatenate(points)
        rotates, ratio = self._rotation(path, each, joined_points)
        feed = feed * ratio
        return PathSamples(
            points=self._travel.inside(joined_points),
            rest=rest,
            speed=np.minimum(np.concatenate(speeds), most * ratio),
            feed=feed,
            line=path.line[each],
            straight=kinds[each] == LINE,
            rotates=rotates,
            arc=np.repeat(np.array(arc), counts),
            arcs=tuple(arcs),
            commands=self._commands(path, counts),
        )

    def _rotation(
        self, path: PathChunk, each: NDArray[np.int64], points: Floats
    ) -> tuple[Flags, Floats]:
        """Return where a rotary axis moves, and how much longer the move is in all axes.

        The feed of the path is along x, y, z (degrees for a move of rotary axes alone). A board
        takes it along all axes together.

        Args:
            path: The pieces.
            each: Piece of each interval (k,).
            points: Ends of the intervals (k + 1, n).
        """
        if points.shape[1] == len(LETTERS):
            return np.zeros(len(each), np.bool_), np.ones(len(each))
        steps = np.diff(points, axis=0)
        rotates = (steps[:, len(LETTERS) :] != 0.0).any(axis=1)
        whole = np.linalg.norm(steps, axis=1)
        linear = np.linalg.norm(steps[:, : len(LETTERS)], axis=1)
        along = np.where(path.kind[each] == LINE, path.length[each], linear)
        known = rotates & (along > 0.0)
        ratio = np.where(known, whole / np.where(known, along, 1.0), 1.0)
        return rotates, ratio

    def _arc_speed(self, arc: PlaneArc, start: Floats, end: Floats) -> float:
        """Return the highest speed along an arc of the program, mm/s."""
        i, j, across = PLANE_COLUMNS[arc.plane]
        radius = math.dist((float(start[i]), float(start[j])), arc.center)
        return self._limits.arc(arc, radius, float(end[across] - start[across]))[0]

    def _commands(self, path: PathChunk, counts: list[int]) -> Commands | None:
        """Return the commands of the pieces, each at its first interval."""
        carried = path.commands
        if carried is None:
            return None
        starts = np.cumsum([0, *counts])
        return command_array(
            int(starts[-1]), {int(starts[k]): carried[k] for k in places_of(carried)}
        )

    def _ends(self, path: PathChunk, k: int) -> Floats:
        """Return both ends of a piece (2, n)."""
        n, at = len(path.axes), int(path.at[k]) + START
        return self._places(path.data[at : at + 2 * n].reshape(2, n))

    def _curve(self, path: PathChunk, k: int) -> Floats:
        """Return samples of a curve after its start (m, n)."""
        kind, at, data = int(path.kind[k]), int(path.at[k]), path.data
        n = len(path.axes)
        body = at + START + 2 * n
        u0, u1 = float(data[at + U0]), float(data[at + U1])
        count = FEWEST_CHORDS if kind == SPAN and data[body] == 3.0 else 2 * FEWEST_CHORDS
        while True:
            u = np.arange(1, count + 1) / count
            if kind == SPAN:
                rows = data[at + START : at + START + n] + span_points(data, body, n, u)
            else:
                rows, out = np.empty((count, n)), np.empty((4, n))
                for i in range(count):
                    curve_eval(kind, data, at, u0 + (u1 - u0) * float(u[i]), out)
                    rows[i] = out[0]
            rows[-1] = data[at + START + n : body]
            points = np.concatenate((self._ends(path, k)[:1], self._places(rows)))
            # a chord deviates by an eighth of the second difference
            bend = float(np.abs(np.diff(points, 2, axis=0)).max()) * math.sqrt(3.0) / 8.0
            rotates = bool((points[1:, len(LETTERS) :] != points[0, len(LETTERS) :]).any())
            error = self._line_error if rotates else self._chord_error
            if bend <= error or count >= MOST_CHORDS:
                break
            count = min(MOST_CHORDS, max(2 * count, math.ceil(count * math.sqrt(bend / error))))
        return points[1:]

    def _programmed_arc(self, path: PathChunk, k: int) -> PlaneArc | None:
        """Return the piece as an arc in a plane of x, y, z; None if it has no single radius."""
        if path.kind[k] != ARC:
            return None
        start = int(path.at[k]) + START
        i, j, radius, growth, sweep, _, ex, ey = path.data[start + 2 * len(path.axes) :][
            :8
        ].tolist()
        columns = self._columns.index(int(i)), self._columns.index(int(j))
        if abs(growth) > self._chord_error or columns not in PLANE_OF_COLUMNS:
            return None
        begin, end = self._ends(path, k)
        if (begin[len(LETTERS) :] != end[len(LETTERS) :]).any():
            return None
        center = path.data[start + int(i)] - radius * ex, path.data[start + int(j)] - radius * ey
        if not self._travel.holds_arc(columns, center, begin, sweep):
            return None
        return PlaneArc(PLANE_OF_COLUMNS[columns], center, sweep)

    def _places(self, rows: Floats) -> Floats:
        """Return positions of the board's axes from those of the machine's (k, axes)."""
        out = np.zeros((len(rows), len(self._columns)))
        for to, column in enumerate(self._columns):
            if column >= 0:
                out[:, to] = rows[:, column]
        return out

    def _check_axes(self, path: PathChunk) -> None:
        """Raise GcodeError `axis-not-on-board` where an axis moves that GRBL does not have."""
        n = len(path.axes)
        for column in self._other_axes:
            at = path.at + START + column
            moves = np.flatnonzero(path.data[at] != path.data[at + n])
            if len(moves):
                line = int(path.line[moves[0]])
                axis = path.axes[column].upper()
                names = ", ".join(BOARD_LETTERS)
                message = f"a GRBL board has the axes {names} at most; this line moves {axis}"
                raise GcodeError(
                    Diagnostic(
                        "axis-not-on-board",
                        message,
                        path.file,
                        line,
                        hint="remove the axis from the program, or use another board",
                    )
                )


def span_points(data: Floats, body: int, n: int, u: Floats) -> Floats:
    """Return positions on a span from its start point, by Bernstein polynomials.

    Args:
        data: The record of the piece.
        body: Index in ``data`` where the span begins.
        n: Number of axes.
        u: Parts of the span's parameter (k,), 0 to 1.

    Returns:
        Positions (k, n), mm.
    """
    p = int(data[body])
    rows = data[body + SPAN_BODY : body + SPAN_BODY + (n + 1) * (p + 1)].reshape(n + 1, p + 1)
    basis = np.stack([math.comb(p, j) * u**j * (1.0 - u) ** (p - j) for j in range(p + 1)])
    sums = rows @ basis
    points: Floats = (sums[1:] / sums[0]).T
    return points
