"""Dense samples of a path for a board that plans, and the lines and arcs fitted through them.

A sample begins an interval, which has a highest speed, a feed and a source line.

                     cut            cut
    ...o..o..o..o..o..O-------------O~~~
            curve         arc

Lines must meet exactly at a cut: at corners, at rests, between traverse and feed, where the
programmed feed changes, at commands that go with the motion, and at both ends of a programmed arc,
which is one interval whatever its length. All other points may be passed within the tolerance.

Curves are sampled so densely that chords between the points deviate by a small part of the
tolerance. The speed of an interval is that of :class:`SpeedLimits`, or the feed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.grbl_lines.board_limits import PLANNER_MOVES
from cnc.grbl_lines.kernels.arc_fit import STRAIGHT, FitLimits, arc_stays_inside, fit_fewest
from cnc.grbl_lines.number_format import (
    BOARD_LETTERS,
    LETTERS,
    PLANE_COLUMNS,
    Move,
    PlaneArc,
    board_axes,
    board_letters,
)
from cnc.machine.models import Machine
from cnc.model.diagnostics import Diagnostic, GcodeError
from cnc.model.motion_commands import Commands, command_array, joined, places_of
from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import ARC, LINE, SPAN, SPAN_BODY, START, U0, U1, curve_eval

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]

# A margin at the ends of the travel, so that rounding never trips a soft limit of the board.
#
# GRBL compares every target with its travel to the last bit of a 32-bit float (gcode_guide.md and
# settings.md, ``$20``; ALARM:2). It reports its offsets with three decimals only, so a target may
# lie half a micrometre from where the line was meant to lead. An arc that is fitted to a path may
# bulge by the tolerance.
#
#     travel ..............................    points in the margin are moved inside, at most
#     margin  _ _ _ _ _ _ _ _ _ _ _ _ _ _ _    by the width of the margin; no arc turns back
#               path  ____________________       beyond its middle

MARGIN = 8e-4
"""mm: half a thousandth of rounding in the offset, and the rounding of words and 32-bit floats."""
BULGE = 1e-4
"""mm by which an arc may come nearer to the end of the travel than the margin."""
MIN_ARC_CLEARANCE = 3e-4
"""mm from the end of the travel to an arc, where there is no margin."""


@dataclass(frozen=True, slots=True)
class TravelMargin:
    """The travel of a machine and the limits of lines and arcs in it.

    Attributes:
        bottom: Lowest position of each axis of the board (n,), mm; minus infinity without travel.
        top: Highest position (n,), mm.
        low: Lowest position at which an arc may turn back (n,), mm.
        high: Highest position at which an arc may turn back (n,), mm.
        margin: Distance of lines from the ends of the travel, mm.
    """

    bottom: Floats
    top: Floats
    low: Floats
    high: Floats
    margin: float

    @classmethod
    def of(cls, machine: Machine, margin: float) -> TravelMargin:
        """Return the travel of a machine with a margin in mm."""
        letters = board_axes(machine.axes)
        axes = [machine.axes.get(letter) for letter in letters]
        spans = [
            (-np.inf, np.inf) if axis is None or axis.travel is None else axis.travel
            for axis in axes
        ]
        bottom, top = np.array(spans).T
        away = max(margin - BULGE, MIN_ARC_CLEARANCE)
        return cls(bottom, top, bottom + away, top - away, margin)

    def inside(self, points: Floats) -> Floats:
        """Return points (k, n) with those in the margin moved out of it.

        Points beyond the travel stay, because no place is right for them.
        """
        if not self.margin:
            return points
        low, high = self.bottom + self.margin, self.top - self.margin
        points = np.where((points < low) & (points >= self.bottom - self.margin), low, points)
        return np.where((points > high) & (points <= self.top + self.margin), high, points)

    def holds_arc(
        self, plane: tuple[int, int], center: tuple[float, float], start: Floats, sweep: float
    ) -> bool:
        """Return whether an arc stays inside where it turns back along an axis.

        Args:
            plane: Columns of the two axes of its plane.
            center: Centre along these axes, mm.
            start: Start point (n,), mm.
            sweep: Angle in rad, positive for counter-clockwise.
        """
        i, j = plane
        x, y = float(start[i]) - center[0], float(start[j]) - center[1]
        return bool(arc_stays_inside(plane, center, (x, y), sweep, self.low, self.high))


# The highest speeds along a path for a board that makes its own ramps.
#
# Such a board keeps the limits of each axis and slows down at corners. It does not know the curve
# that its lines and arcs replace. At a point of a curve with the unit tangent t, and the
# derivatives q'' and q''' of the position by arc length, the speed is at most
#
#     v_i / |t_i|    sqrt(a_i / |q_i''|)    sqrt(a_n / |q''|)    cbrt(j_i / |q_i'''|)
#
# for each axis i: at a constant speed v the axis has the speed q_i' v, the acceleration q_i'' v^2
# and the jerk q_i''' v^3. The derivatives are differences between the samples of the curve.

NOTHING = 1e-12
"""In place of 0 where a limit is divided by it."""


class SpeedLimits(NamedTuple):
    """Limits of a machine; infinite where there is none.

    Attributes:
        feed: Highest feed, mm/s.
        rates: Highest speed of each axis of the board (n,), mm/s.
        accelerations: Of each axis (n,), mm/s^2.
        jerks: Of each axis (n,), mm/s^3.
        normal: Highest acceleration across the path, mm/s^2.
    """

    feed: float
    rates: Floats
    accelerations: Floats
    jerks: Floats
    normal: float

    @classmethod
    def of(cls, machine: Machine) -> SpeedLimits:
        """Return the limits of a machine file."""
        axes = [machine.axes.get(letter) for letter in board_axes(machine.axes)]

        def of_axes(name: str) -> Floats:
            return np.array([getattr(axis, name, None) or math.inf for axis in axes])

        return cls(
            machine.path.max_feed or math.inf,
            of_axes("max_velocity"),
            of_axes("max_acceleration"),
            of_axes("max_jerk"),
            machine.path.max_normal_acceleration or math.inf,
        )

    def straight(self, steps: Floats) -> Floats:
        """Return the highest speed along each of the steps (k, n), (k,) in mm/s."""
        lengths = np.linalg.norm(steps, axis=1)
        parts = np.abs(steps) / np.maximum(lengths, NOTHING)[:, None]
        speeds: Floats = (self.rates / np.maximum(parts, NOTHING)).min(axis=1)
        return speeds

    def curve(self, points: Floats) -> Floats:
        """Return the highest speed in each interval between the samples of a curve.

        Args:
            points: Samples from the start of the curve to its end (k + 1, n), mm, k >= 2.

        Returns:
            The larger one of the limits at both ends of each interval (k,), mm/s.
        """
        steps = np.diff(points, axis=0)
        lengths = np.maximum(np.linalg.norm(steps, axis=1), NOTHING)
        directions = steps / lengths[:, None]
        between = 0.5 * (lengths[1:] + lengths[:-1])
        bends = np.diff(directions, axis=0) / between[:, None]
        bends = np.concatenate((bends[:1], bends, bends[-1:]))
        sizes = np.abs(bends)
        by_axis = (self.accelerations / np.maximum(sizes, NOTHING)).min(axis=1)
        across = np.linalg.norm(bends[:, : len(LETTERS)], axis=1)
        by_path = self.normal / np.maximum(across, NOTHING)
        at_samples = np.sqrt(np.minimum(by_axis, by_path))
        changes = np.abs(np.diff(bends, axis=0)) / lengths[:, None]
        by_jerk = np.cbrt((self.jerks / np.maximum(changes, NOTHING)).min(axis=1))
        by_bend = np.maximum(at_samples[1:], at_samples[:-1])
        speeds: Floats = np.minimum(np.minimum(by_bend, by_jerk), self.straight(steps))
        return speeds

    def arc(self, arc: PlaneArc, radius: float, climb: float) -> tuple[float, float]:
        """Return the highest speed along an arc or helix, mm/s, and its length, mm.

        Args:
            arc: The arc.
            radius: mm.
            climb: Length along the axis across its plane, mm.
        """
        i, j, across = PLANE_COLUMNS[arc.plane]
        level = max(radius * abs(arc.sweep), NOTHING)
        acceleration = min(self.normal, float(min(self.accelerations[i], self.accelerations[j])))
        jerk = float(min(self.jerks[i], self.jerks[j]))
        speed = min(
            math.sqrt(acceleration * radius),
            math.cbrt(jerk * radius * radius),
            float(min(self.rates[i], self.rates[j])),
        )
        length = math.hypot(level, climb)
        if climb:
            speed = min(speed, float(self.rates[across]) * level / abs(climb))
        return speed * length / level, length


def corner_speeds(points: Floats, accelerations: Floats, deviation: float) -> Floats:
    """Return the speed at which the board passes each inner point (k - 1,), mm/s.

    Args:
        points: Ends of straight moves (k + 1, n), mm.
        accelerations: Of each axis (n,), mm/s^2.
        deviation: The board's $11, mm; see :mod:`cnc.grbl_lines.grbl_timing`.
    """
    steps = np.diff(points, axis=0)
    units = steps / np.maximum(np.linalg.norm(steps, axis=1), NOTHING)[:, None]
    turns = np.diff(units, axis=0)
    sizes = np.linalg.norm(turns, axis=1)
    # The size of the difference of two unit vectors is 2 cos(theta / 2), theta between the legs.
    half = np.sqrt(np.maximum(1.0 - 0.25 * sizes * sizes, 0.0))
    aims = np.abs(turns) / np.maximum(sizes, NOTHING)[:, None]
    acceleration = (accelerations / np.maximum(aims, NOTHING)).min(axis=1)
    squares: Floats = acceleration * deviation * half / np.maximum(1.0 - half, NOTHING)
    return np.sqrt(squares)


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
        piece = np.repeat(np.arange(len(path)), counts)
        rest = np.zeros(len(piece) + 1, np.bool_)
        rest[np.cumsum(counts)] = path.stop_after
        feed = path.feed[piece]
        most = np.fmin(np.where(np.isnan(feed), np.inf, self._limits.feed), feed)
        joined_points = np.concatenate(points)
        rotates, ratio = self._rotation(path, piece, joined_points)
        feed = feed * ratio
        return PathSamples(
            points=self._travel.inside(joined_points),
            rest=rest,
            speed=np.minimum(np.concatenate(speeds), most * ratio),
            feed=feed,
            line=path.line[piece],
            straight=kinds[piece] == LINE,
            rotates=rotates,
            arc=np.repeat(np.array(arc), counts),
            arcs=tuple(arcs),
            commands=self._commands(path, counts),
        )

    def _rotation(
        self, path: PathChunk, piece: NDArray[np.int64], points: Floats
    ) -> tuple[Flags, Floats]:
        """Return where a rotary axis moves, and how much longer the move is in all axes.

        The feed of the path is along x, y, z (degrees for a move of rotary axes alone). A board
        takes it along all axes together.

        Args:
            path: The pieces.
            piece: Piece of each interval (k,).
            points: Ends of the intervals (k + 1, n).
        """
        if points.shape[1] == len(LETTERS):
            return np.zeros(len(piece), np.bool_), np.ones(len(piece))
        steps = np.diff(points, axis=0)
        rotates = (steps[:, len(LETTERS) :] != 0.0).any(axis=1)
        whole = np.linalg.norm(steps, axis=1)
        linear = np.linalg.norm(steps[:, : len(LETTERS)], axis=1)
        along = np.where(path.kind[piece] == LINE, path.length[piece], linear)
        measured = rotates & (along > 0.0)
        ratio = np.where(measured, whole / np.where(measured, along, 1.0), 1.0)
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


# The fewest lines and arcs along a stretch of path (:mod:`cnc.grbl_lines.kernels.arc_fit`).

SAME_LINE = math.cos(math.radians(0.05))
"""Cosine above which two straight moves count as one line."""
AS_FAST = 0.98
"""Part of the speed along straight moves that an arc must have to replace them."""


class Fit(NamedTuple):
    """Limits of the moves that replace a path.

    Attributes:
        tolerance: Largest distance of a move from the path, mm.
        chord: Largest distance of the board's own chords from an arc, mm ($12).
        junction: The board's $11, mm.
        line_time: Time in which the board reads a short line, s.
        travel: The limits within which arcs must stay.
        speeds: Limits of the speed.
    """

    tolerance: float
    chord: float
    junction: float
    line_time: float
    travel: TravelMargin
    speeds: SpeedLimits


def fit_moves(samples: PathSamples, fit: Fit) -> Iterator[Move]:
    """Fit moves from the start of the samples to their end.

    The program's own straight moves stay as they are where the board reads them fast enough. The
    board is as fast then as with any other sender, and passes their corners as it is set up to.

    Args:
        samples: Points of the path.
        fit: Limits of the moves.

    Yields:
        The moves in their order.
    """
    k = len(samples)
    end, plane, arc = np.empty(k, np.int64), np.empty(k, np.int64), np.empty((k, 3))
    may_turn = (samples.arc == NO_ARC) & ~np.isnan(samples.feed) & ~samples.rotates
    speeds = _own_speeds(samples, fit)
    own = samples.rotates | (samples.straight & ~_starving(samples, speeds, fit.line_time))
    cuts = samples.cuts()
    cuts[:-1] |= own
    cuts[1:] |= own
    first_three = slice(len(LETTERS))
    low, high = fit.travel.low[first_three], fit.travel.high[first_three]
    limits = FitLimits(fit.tolerance, fit.chord, low, high)
    points = np.ascontiguousarray(samples.points[:, first_three])
    count = fit_fewest(points, cuts, may_turn, limits, end, plane, arc)
    end, plane, arc = _without_slow_arcs(
        samples, fit, speeds, (end[:count], plane[:count], arc[:count])
    )
    first = np.concatenate(([0], end[:-1]))
    straight = (plane == STRAIGHT) & (samples.arc[end - 1] == NO_ARC)
    columns = (
        map(tuple, samples.points[end].tolist()),
        first.tolist(),
        _speeds(samples, first, end, straight).tolist(),
        samples.feed[end - 1].tolist(),
        samples.line[end - 1].tolist(),
        samples.rest[end].tolist(),
        samples.arc[end - 1].tolist(),
        plane.tolist(),
        arc.tolist(),
    )
    commands = samples.commands
    for place, begin, speed, feed, line, rests, programmed, kind, (cx, cy, sweep) in zip(
        *columns, strict=True
    ):
        if programmed != NO_ARC:
            used: PlaneArc | None = samples.arcs[programmed]
        else:
            used = None if kind == STRAIGHT else PlaneArc(kind, (cx, cy), sweep, fitted=True)
        carried = () if commands is None else commands[begin] or ()
        yield Move(place, used, begin, speed, feed, line, rests, carried)


def _own_speeds(samples: PathSamples, fit: Fit) -> Floats:
    """Return the speed of the board along the intervals as straight moves (k,), mm/s."""
    corners = corner_speeds(samples.points, fit.speeds.accelerations, fit.junction)
    ends = np.concatenate(([np.inf], corners, [np.inf]))
    speeds = samples.speed
    mean: Floats = 0.5 * (np.minimum(speeds, ends[:-1]) + np.minimum(speeds, ends[1:]))
    return mean


def _starving(samples: PathSamples, speeds: Floats, line_time: float) -> Flags:
    """Return the intervals (k,) around which moves end faster than the board reads lines."""
    lengths = np.linalg.norm(np.diff(samples.points, axis=0), axis=1)
    sums = np.concatenate(([0.0], np.cumsum(lengths / np.maximum(speeds, NOTHING))))
    places = np.arange(len(lengths))
    first = np.maximum(places - PLANNER_MOVES // 2, 0)
    last = np.minimum(places + PLANNER_MOVES // 2 + 1, len(lengths))
    starving: Flags = sums[last] - sums[first] < line_time * (last - first)
    return starving


def _without_slow_arcs(
    samples: PathSamples, fit: Fit, speeds: Floats, moves: tuple[Ints, Ints, Floats]
) -> tuple[Ints, Ints, Floats]:
    """Return the moves with the program's own straight moves where an arc would be slower.

    Args:
        samples: Points of the path.
        fit: Limits of the moves.
        speeds: Of the straight moves on the board (k,), mm/s.
        moves: Last point, plane and arc of each move.
    """
    end, plane, arc = moves
    first = np.concatenate(([0], end[:-1]))
    turned = np.flatnonzero((plane != STRAIGHT) & samples.straight[first])
    lengths = np.linalg.norm(np.diff(samples.points, axis=0), axis=1)
    seconds = np.maximum(lengths / np.maximum(speeds, NOTHING), fit.line_time)
    slow = []
    for k in turned.tolist():
        inside = slice(int(first[k]), int(end[k]))
        i, j, across = PLANE_COLUMNS[int(plane[k])]
        start, stop = samples.points[inside.start], samples.points[inside.stop]
        used = PlaneArc(int(plane[k]), (float(arc[k, 0]), float(arc[k, 1])), float(arc[k, 2]))
        radius = math.dist((float(start[i]), float(start[j])), used.center)
        most, length = fit.speeds.arc(used, radius, float(stop[across] - start[across]))
        if length / most > float(seconds[inside].sum()) / AS_FAST:
            slow.append(k)
    if not slow:
        return end, plane, arc
    parts = np.ones(len(end), np.int64)
    parts[slow] = (end - first)[slow]
    owner = np.repeat(np.arange(len(end)), parts)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts) + 1
    split = parts[owner] > 1
    ends = np.where(split, first[owner] + step, end[owner])
    planes = np.where(split, STRAIGHT, plane[owner])
    return ends, planes, arc[owner]


def _speeds(samples: PathSamples, first: Ints, end: Ints, straight: Flags) -> Floats:
    """Return the highest planned speed along each move, mm/s.

    Straight moves that continue each other are like one: the board makes its own ramps on them.
    """
    speeds: Floats = np.maximum.reduceat(samples.speed, first)
    steps = samples.points[end] - samples.points[first]
    lengths = np.linalg.norm(steps, axis=1)
    feeds = np.nan_to_num(samples.feed[end - 1], nan=-1.0)
    continued = (
        straight[1:]
        & straight[:-1]
        & ~samples.rest[first[1:]]
        & (feeds[1:] == feeds[:-1])
        & (np.einsum("ij,ij->i", steps[1:], steps[:-1]) >= SAME_LINE * lengths[1:] * lengths[:-1])
    )
    starts = np.flatnonzero(np.concatenate(([True], ~continued)))
    highest = np.maximum.reduceat(speeds, starts)
    return np.repeat(highest, np.diff(np.append(starts, len(speeds))))
