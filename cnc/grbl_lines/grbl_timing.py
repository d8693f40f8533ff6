r"""The time that a GRBL board takes for a program: a model of its planner.

The model uses the lines that the board is sent and the board's own settings. GRBL makes blocks of
constant acceleration of every straight move and of each chord of an arc, and looks ahead over as
many as it holds (15 on an Uno). At a junction of two blocks it moves as fast as along a circle that
touches both and is ``$11`` away from the corner (Jeon, "Improving Grbl: Cornering Algorithm", 2011;
gnea/grbl wiki, "Grbl v1.1 Configuration", $11):

    v |   ,----.               v_j^2 = a $11 sin(theta/2) / (1 - sin(theta/2)),
      |  /      \   ,--.              theta: the angle between the two, pi if straight
      | /        `-'    \      backward: v_k^2 <= v_(k+1)^2 + 2 a d, rest after the last block
      |/                 \     forward:  v_(k+1)^2 <= v_k^2 + 2 a d
      +-------------------+ t  between:  up to the feed, with the acceleration a of the axes

Both passes are sums and minima of whole arrays. The backward pass takes as many steps as blocks are
known ahead. The forward pass, with S the sum of 2 a d so far, is v_k^2 = S_k + min over j <= k of
(bound_j - S_j).

Short lines may arrive too slowly for this: :class:`LineArrival` adds the time that is lost then.

All other lines wait until the motion has come to rest (GRBL synchronises for M codes, dwells,
probes and EEPROM writes). The operator changes overrides: times are kept for a few of them and
interpolated between, because a time is about a + b / override.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from cnc.grbl_lines.board_limits import BoardLimits
from cnc.grbl_lines.kernels.arrival import RING, STATE, Link, Moves, times_of
from cnc.grbl_lines.number_format import PLANE_COLUMNS, Point
from cnc.grbl_lines.writer import BITS_PER_BYTE, BYTE_TIME, LINE_TIME
from cnc.model.line_effects import ARCS, MOTIONS, LineEffect, LineKind, effects_of
from cnc.model.streams import GcodeLine

Floats = NDArray[np.float64]

# The largest speeds and accelerations of the motion of a GRBL board.


@dataclass(slots=True)
class Largest:
    """Largest values of the motion at 100 %.

    Attributes:
        speed: Along the path, mm/s.
        acceleration: Along the path, mm/s^2.
        velocities: Of each axis (n,), mm/s.
        accelerations: Of each axis (n,), mm/s^2, along the path.
    """

    velocities: list[float]
    accelerations: list[float]
    speed: float = 0.0
    acceleration: float = 0.0

    @classmethod
    def of_axes(cls, axes: int) -> Largest:
        """Return zeros."""
        return cls([0.0] * axes, [0.0] * axes)

    def add(self, units: Floats, speeds: Floats, accelerations: Floats) -> None:
        """Add moves: directions (k, n), highest speeds (k,), accelerations (k,), 0 without one."""
        self.speed = max(self.speed, float(speeds.max()))
        self.acceleration = max(self.acceleration, float(accelerations.max()))
        sizes = np.abs(units)
        for mine, new in (
            (self.velocities, (sizes * speeds[:, None]).max(axis=0)),
            (self.accelerations, (sizes * accelerations[:, None]).max(axis=0)),
        ):
            mine[:] = np.maximum(mine, new).tolist()


# The times at which the lines of a program arrive at a GRBL board, and their moves end.
#
# A board that gets short lines too slowly brakes for lack of moves, and may come to rest. See
# :mod:`cnc.grbl_lines.kernels.arrival` for the model.

LINE_END = 1
"""Bytes of the end of a line."""
BUFFER = 124
"""Bytes that may be on their way. GRBL's receive buffer holds 128, one of which stays free, and the
sender keeps three for a question.
"""
ANSWER_BYTES = 4
"""Bytes of an answer."""
USB_DELAY = 1e-3
"""Time of an answer in the USB port, s: a frame."""
GATHERING, LONGEST_GATHERING = 0.25, 8e-3
"""Average time in which the sender lets answers gather: part of the time of a full buffer on the
wire, and its limit, s.
"""
CHECK_BYTES = 3.0 / 20.0
"""Bytes for each line that the sender adds: ``$G`` and the line end for 20 lines."""


class LineArrival:
    """Follows the lines of one program.

    Attributes:
        sizes: Bytes of the lines since the last call of :meth:`times`; the caller appends to it.

    Args:
        limits: The board.
        cases: Number of pairs of overrides.
    """

    def __init__(self, limits: BoardLimits, cases: int) -> None:
        self.sizes: list[int] = []
        self._lines = 0
        self._states = np.zeros(cases, STATE)
        planner = min(limits.blocks + 1, RING - 1)
        if limits.baud:
            byte_time = BITS_PER_BYTE / limits.baud
            gathering = min(GATHERING * BUFFER * byte_time, LONGEST_GATHERING)
            answer = ANSWER_BYTES * byte_time + USB_DELAY + gathering
            self._link = Link(byte_time, CHECK_BYTES, BYTE_TIME, LINE_TIME, answer, BUFFER, planner)
        else:
            self._link = Link(0.0, 0.0, 0.0, 0.0, 0.0, BUFFER, planner)

    def times(self, moves: Moves, lines: NDArray[np.int64], done: int, total: Floats) -> Floats:
        """Return the time from the end of the move before to that of each of the first moves.

        Args:
            moves: The moves, with those that the board looks ahead; their lines are not used.
            lines: Numbers of the lines of the moves in the program (n,), from 0.
            done: Number of the first moves.
            total: Time of the program before them in each case (c,), s.

        Returns:
            Times (done, c), s.
        """
        self._states["end"] = total
        times = np.empty((done, len(self._states)))
        sizes = np.array(self.sizes, np.int64)
        moves = moves._replace(line=lines - self._lines)
        times_of(self._states, moves, sizes, done, self._link, times)
        self._lines += len(sizes)
        self.sizes.clear()
        return times

    def rest(self, total: Floats) -> None:
        """Note that the board rests until a time in each case (c,), s, and reads on then."""
        self._states["board"] = np.maximum(self._states["board"], total)
        self._states["speed"] = 0.0


BATCH = 8192
"""Blocks that are computed at once."""
WORTH_ARRAYS = 16
"""Straight moves in a row from which on they are added as arrays."""
MOST_MARKS = 4096
"""Lines of the program for which the time is kept."""
FEEDS = (0.1, 0.5, 1.0, 2.0)
RAPIDS = (0.25, 0.5, 1.0)
"""Overrides for which times are kept: GRBL allows 10 to 200 %, and 25, 50 and 100 %."""
NORMAL = FEEDS.index(1.0)
"""Column of the times without an override."""
NO_OVERRIDE = 100.0
"""In per cent."""
STRAIGHT = 0.999999
"""Cosine above which two directions are the same or opposite."""
NO_LIMIT = 1e12
"""Square of the speed at a junction without a change of direction."""
SHORT_LINE_TIME = 2.4e-3
"""s. GRBL on an AVR takes that long to read and plan a short line."""
FULL_TURN = 5e-7
"""rad. GRBL takes an arc that turns by less for a full circle."""


class BoardTime:
    """Adds up the time of lines in their order.

    Attributes:
        limits: The limits of the board.
        largest: Largest values of the motion so far.

    Args:
        limits: The limits of the board.
        start: Position of each axis, mm (coordinates of the lines); None for zero.
    """

    def __init__(self, limits: BoardLimits, start: Point | None = None) -> None:
        self.largest = Largest.of_axes(len(limits.rates))
        self.limits = limits
        start = start or (0.0,) * len(limits.rates)
        self._at = start
        # The board stands on a whole step.
        self._origin = np.array(start)
        self._steps = np.array(limits.steps or (0.0,) * len(start))
        self._lines = 0
        self._points: list[Point] = [start]
        self._feeds: list[float] = []
        self._owners: list[int] = []
        self._cases = [(feed, 1.0) for feed in FEEDS] + [(1.0, rapid) for rapid in RAPIDS[:-1]]
        self._entry = np.zeros(len(self._cases))
        self._before: Floats | None = None
        self._nominal_before = np.zeros(len(self._cases))
        self._arrival = LineArrival(limits, len(self._cases))
        self._total = np.zeros(len(self._cases))
        self._marks: list[tuple[int, Floats]] = [(0, np.zeros(len(self._cases)))]
        self._stride = 1

    @property
    def seconds(self) -> float:
        """Time of all lines at 100 %, until the board rests; valid after :meth:`end`."""
        return float(self._total[NORMAL])

    def end(self) -> None:
        """Finish: there are no more lines."""
        self._flush(rests=True)

    def remaining(
        self, lines: int, feed_override: float = 100.0, rapid_override: float = 100.0
    ) -> float:
        """Return the time that is left, s; valid after :meth:`end`.

        Args:
            lines: Lines that have been carried out.
            feed_override: In per cent.
            rapid_override: In per cent.
        """
        k = max(bisect_right(self._marks, lines, key=itemgetter(0)) - 1, 0)
        number, done = self._marks[k]
        following, then = self._marks[min(k + 1, len(self._marks) - 1)]
        part = min(max((lines - number) / max(following - number, 1), 0.0), 1.0)
        if lines >= self._lines:
            done = then = self._total
        if feed_override == rapid_override == NO_OVERRIDE:
            begin, end, total = done[NORMAL], then[NORMAL], self._total[NORMAL]
            return max(float(total - begin - (end - begin) * part), 0.0)
        left = np.maximum(self._total - done - (then - done) * part, 0.0)
        normal = float(left[NORMAL])
        slower = 1.0 / np.array(FEEDS)[::-1]
        by_feed = float(
            np.interp(100.0 / max(feed_override, 1.0), slower, left[: len(FEEDS)][::-1])
        )
        rapids = np.append(left[len(FEEDS) :], normal)
        by_rapid = float(
            np.interp(100.0 / max(rapid_override, 1.0), 1.0 / np.array(RAPIDS)[::-1], rapids[::-1])
        )
        return max(by_feed + by_rapid - normal, 0.0)

    def add(self, line: GcodeLine) -> None:
        """Add the next line. A line whose effect is not known brings the board to rest."""
        self._add(line.effect, len(line.text) + LINE_END)

    def _add(self, effect: LineEffect | None, size: int) -> None:
        """Add a line of ``size`` bytes."""
        self._lines += 1
        self._arrival.sizes.append(size)
        if effect is None or effect.kind in (LineKind.REST, LineKind.DWELL, LineKind.PROBE):
            self._flush(rests=True)
        if effect is None:
            return
        if effect.kind is LineKind.REST:
            # The board reads the next move only when it rests. The wire's model counts that itself.
            self._wait(0.0 if self.limits.baud else SHORT_LINE_TIME)
        elif effect.kind is LineKind.DWELL:
            self._wait(effect.seconds)
        elif effect.kind in MOTIONS:
            self._add_move(effect)
        if effect.kind is LineKind.PROBE:
            self._flush(rests=True)
        elif len(self._feeds) >= BATCH + self.limits.blocks:
            self._flush(rests=False)

    def _wait(self, seconds: float) -> None:
        """Add a line for which the board rests for a time, s."""
        self._total = self._total + seconds
        self._keep([(self._lines, self._total)])
        self._arrival.rest(self._total)

    def add_rows(self, rows: NDArray[np.void], sizes: NDArray[np.int64]) -> None:
        """Add lines in the form of :func:`~cnc.model.line_effects.row_type`.

        Args:
            rows: The lines.
            sizes: Bytes of each line with its end.
        """
        kinds = rows["kind"]
        stops = np.flatnonzero((kinds != LineKind.RAPID) & (kinds != LineKind.FEED)).tolist()
        first = 0
        for place in [*stops, len(rows)]:
            if place - first >= WORTH_ARRAYS:
                for begin in range(first, place, BATCH):
                    part = slice(begin, min(begin + BATCH, place))
                    self._add_straights(rows[part], sizes[part].tolist())
                first = place
            few = slice(first, place + 1)
            for (_, effect), size in zip(effects_of(rows[few]), sizes[few].tolist(), strict=True):
                self._add(effect, size)
            first = place + 1

    def _add_straights(self, rows: NDArray[np.void], sizes: list[int]) -> None:
        """Add straight moves, and the bytes of their lines."""
        self._arrival.sizes += sizes
        ends = np.concatenate(([self._at], rows["target"]))
        # An axis that a line does not name stays where the line before has left it.
        named = np.where(np.isnan(ends), 0, np.arange(len(ends))[:, None])
        ends = np.take_along_axis(ends, np.maximum.accumulate(named), axis=0)
        self._points += map(tuple, ends[1:].tolist())
        self._feeds += np.where(rows["kind"] == LineKind.RAPID, math.nan, rows["feed"]).tolist()
        self._owners += range(self._lines + 1, self._lines + len(rows) + 1)
        self._lines += len(rows)
        self._at = self._points[-1]
        if len(self._feeds) >= BATCH + self.limits.blocks:
            self._flush(rests=False)

    def _add_move(self, effect: LineEffect) -> None:
        end = tuple(
            here if math.isnan(target) else target
            for target, here in zip(effect.target, self._at, strict=True)
        )
        points = self._chords(effect, end) if effect.kind in ARCS else [end]
        feed = math.nan if effect.kind is LineKind.RAPID else effect.feed
        self._points += points
        self._feeds += [feed] * len(points)
        self._owners += [self._lines] * len(points)
        self._at = end

    def _chords(self, effect: LineEffect, end: Point) -> list[Point]:
        """Return the ends of the chords that the board makes of an arc."""
        i, j, across = PLANE_COLUMNS[effect.plane]
        begin = self._at
        x, y = -effect.center[0], -effect.center[1]
        cx, cy = begin[i] - x, begin[j] - y
        radius = math.hypot(x, y)
        fx, fy = end[i] - cx, end[j] - cy
        sweep = math.atan2(x * fy - y * fx, x * fx + y * fy)
        if effect.kind is LineKind.COUNTERCLOCKWISE and sweep <= FULL_TURN:
            sweep += 2.0 * math.pi
        if effect.kind is LineKind.CLOCKWISE and sweep >= -FULL_TURN:
            sweep -= 2.0 * math.pi
        error = self.limits.arc_tolerance
        half = math.sqrt(error * (2.0 * radius - error)) if error < 2.0 * radius else math.inf
        count = max(1, math.floor(0.5 * abs(sweep) * radius / half))
        part = np.arange(1, count) / count
        cos, sin = np.cos(part * sweep), np.sin(part * sweep)
        rows = np.empty((count, len(end)))
        rows[:] = begin
        rows[:-1, i] = cx + cos * x - sin * y
        rows[:-1, j] = cy + sin * x + cos * y
        rows[:-1, across] = begin[across] + (end[across] - begin[across]) * part
        rows[-1] = end
        return [tuple(row) for row in rows.tolist()]

    def _flush(self, *, rests: bool) -> None:
        """Add up the blocks so far.

        All of them if the board rests after the last; otherwise those that are followed by enough
        others.
        """
        points = np.array(self._points)
        steps = np.diff(self._whole_steps(points), axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        real = lengths > 1e-9
        steps, lengths = steps[real], lengths[real]
        feeds, owners = np.array(self._feeds)[real], np.array(self._owners, np.int64)[real]
        count = len(lengths)
        done = count if rests else max(count - self.limits.blocks, 0)
        if done:
            units = steps / lengths[:, None]
            joined = units if self._before is None else np.concatenate((self._before[None], units))
            junction = self._junctions(joined)
            if self._before is None:
                junction = np.concatenate(([0.0], junction))
            moves = self._planned(units, lengths, feeds, junction, done)
            self._mark(owners[:done], self._arrival.times(moves, owners - 1, done, self._total))
        if rests:
            self._points, self._feeds, self._owners = [tuple(points[-1].tolist())], [], []
            self._before = None
            self._entry[:] = 0.0
            self._arrival.rest(self._total)
        elif done:
            # keep the points from the end of the last block that is done
            behind = int(np.flatnonzero(real)[done - 1]) + 1
            self._points, self._feeds, self._owners = (
                self._points[behind:],
                self._feeds[behind:],
                self._owners[behind:],
            )
            self._before = units[done - 1]

    def _whole_steps(self, points: Floats) -> Floats:
        """Return the nearest points that whole steps reach."""
        scale = np.where(self._steps > 0.0, self._steps, 1.0)
        on_grid = np.rint((points - self._origin) * scale) / scale + self._origin
        return np.where(self._steps > 0.0, on_grid, points)

    def _planned(
        self, units: Floats, lengths: Floats, feeds: Floats, junction: Floats, done: int
    ) -> Moves:
        """Return the blocks with their highest speeds at each pair of overrides.

        Args:
            units: Direction of each block (n, axes).
            lengths: Lengths (n,), mm.
            feeds: Feeds (n,), mm/s; NaN for a traverse.
            junction: Squares of the highest speeds at the begin of each (n,).
            done: Number of blocks that the board plans for good; the others are known ahead.
        """
        limits = self.limits
        directions = np.maximum(np.abs(units), 1e-12)
        fastest = (np.array(limits.rates) / directions).min(axis=1)
        acceleration = (np.array(limits.accelerations) / directions).min(axis=1)
        gain = 2.0 * acceleration * lengths
        begun = np.concatenate(([0.0], np.cumsum(gain)))
        nominals, speeds = [], []
        for case, (feed, rapid) in enumerate(self._cases):
            nominal = np.where(np.isnan(feeds), fastest * rapid, np.minimum(feeds * feed, fastest))
            nominal = np.maximum(nominal, 1e-3)
            before = np.concatenate(
                ([nominal[0] if self._before is None else self._nominal_before[case]], nominal[:-1])
            )
            most = np.minimum(junction, np.minimum(nominal, before) ** 2)
            # speed from which the board can stop within the known blocks
            bound = np.zeros(len(lengths) + 1)
            for _ in range(min(limits.blocks, len(lengths))):
                bound[:-1] = np.minimum(most, bound[1:] + gain)
            if self._before is not None:
                bound[0] = min(bound[0], self._entry[case])
            squares = np.maximum(np.minimum.accumulate(bound - begun) + begun, 0.0)
            if done < len(lengths):
                self._entry[case] = squares[done]
            self._nominal_before[case] = nominal[done - 1]
            nominals.append(nominal)
            speeds.append(np.sqrt(squares))
            if self._cases[case] == (1.0, 1.0):
                self._note_largest(units[:done], lengths, acceleration, nominal, speeds[-1])
        ends = np.array(speeds).T
        return Moves(
            lengths, acceleration, np.array(nominals).T.copy(), ends[:-1].copy(), ends[1:].copy(),
            np.empty(0, np.int64),
        )  # fmt: skip

    def _note_largest(
        self, units: Floats, lengths: Floats, acceleration: Floats, nominal: Floats, speeds: Floats
    ) -> None:
        """Note the largest values of the first blocks; arguments as of :meth:`_planned`."""
        done = len(units)
        v0, v1, a = speeds[:done], speeds[1 : done + 1], acceleration[:done]
        peak = np.minimum(nominal[:done], np.sqrt(0.5 * (v0 * v0 + v1 * v1) + a * lengths[:done]))
        peak = np.maximum(peak, np.maximum(v0, v1))
        self.largest.add(units, peak, np.where(peak > np.minimum(v0, v1), a, 0.0))

    def _junctions(self, units: Floats) -> Floats:
        """Return the square of the speed at each junction of two directions."""
        before, after = units[:-1], units[1:]
        cos = -np.einsum("ij,ij->i", before, after)
        turn = after - before
        size = np.linalg.norm(turn, axis=1)
        aims = np.maximum(np.abs(turn / np.maximum(size, 1e-12)[:, None]), 1e-12)
        acceleration = (np.array(self.limits.accelerations) / aims).min(axis=1)
        half = np.sqrt(np.maximum(0.5 * (1.0 - cos), 0.0))
        squares = (
            acceleration * self.limits.junction_deviation * half / np.maximum(1.0 - half, 1e-12)
        )
        return np.where(cos > STRAIGHT, 0.0, np.where(cos < -STRAIGHT, NO_LIMIT, squares))

    def _mark(self, owners: NDArray[np.int64], times: Floats) -> None:
        """Keep the time at the end of lines; fewer of them as the program grows."""
        sums = self._total + np.cumsum(times, axis=0)
        ends = np.flatnonzero(np.append(np.diff(owners) > 0, True))
        self._keep(zip(owners[ends].tolist(), sums[ends], strict=True))
        self._total = sums[-1]

    def _keep(self, marks: Iterable[tuple[int, Floats]]) -> None:
        for line, total in marks:
            last, before = self._marks[-1]
            if self._stride == 1 and line > last + 1:
                # the lines between take no time
                self._marks.append((line - 1, before))
            if line >= last + self._stride:
                self._marks.append((line, total.copy()))
        while len(self._marks) > MOST_MARKS:
            self._stride *= 2
            self._marks = self._marks[::2]


# The time that is left of a program while a GRBL board carries it out.

UNREPORTED_LINES = 2
"""Lines that the board may have carried out since its last report."""


class Countdown:
    """Counts down the time of a program.

    The board reports the line that it is on, but not how far along it is, and the report is as old
    as the interval between two. So the clock runs on between two bounds: the time left after the
    next lines, and the time left before the present line. It stands while the motion is held.
    """

    def __init__(self, time: BoardTime) -> None:
        """``time``: of all the lines of the program."""
        self._time = time
        self._overrides = (100.0, 100.0)
        self._left = time.remaining(0)
        self._at: float | None = None

    def left(
        self,
        now: float,
        done: int,
        *,
        held: bool,
        feed_override: float = 100.0,
        rapid_override: float = 100.0,
    ) -> float:
        """Return the time that is left, s.

        Args:
            now: Present time, s.
            done: Lines that the board has carried out.
            held: Whether the motion is held.
            feed_override: In per cent.
            rapid_override: In per cent.
        """
        overrides = feed_override, rapid_override
        most = self._time.remaining(done, *overrides)
        if overrides != self._overrides:
            before = self._time.remaining(done, *self._overrides)
            self._left *= most / before if before > 0.0 else 1.0
            self._overrides = overrides
        if self._at is not None and not held:
            self._left -= now - self._at
        self._at = now
        least = self._time.remaining(done + UNREPORTED_LINES, *overrides)
        self._left = min(max(self._left, least), most)
        return self._left
