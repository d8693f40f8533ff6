r"""How long a GRBL board takes for a program: a model of its planner, from the lines that it is
sent and its own settings.

GRBL makes blocks of constant acceleration of every straight move and of each chord of an arc, and
looks ahead over as many as it holds (15 on an Uno). Where two blocks meet it passes as fast as
along a circle that touches both and is ``$11`` away from the corner (Jeon, "Improving Grbl:
Cornering Algorithm", 2011; gnea/grbl wiki, "Grbl v1.1 Configuration", $11):

       v |   ,----.                      v_j^2 = a $11 sin(theta/2) / (1 - sin(theta/2)),   theta: the angle between the two, pi if straight
         |  /      \   ,--.
         | /        `-'    \             backward: v_k^2 <= v_(k+1)^2 + 2 a d, and rest behind the last block that is known
         |/                 \            forward:  v_(k+1)^2 <= v_k^2 + 2 a d
         +-------------------+---- t     between:  up to the feed, with the acceleration a that the axes allow in that direction

Both passes are sums and minima of whole arrays: backward in as many steps as blocks are known
ahead; forward, with S the sum of 2 a d so far, v_k^2 = S_k + min over j <= k of (bound_j - S_j).

Everything else waits until the motion has come to rest (GRBL synchronises for M codes, dwells,
probes and what is written to EEPROM). Operators turn overrides: times are kept for a few of them,
and those between follow, because a time is about a + b / override.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.grbl_lines.number_format import LETTERS, PLANE_COLUMNS
from cnc.machine.models import Machine
from cnc.model.streams import GcodeLine
from cnc.model.units import per_second

Floats = NDArray[np.float64]

BLOCKS_AHEAD = 15
BATCH = 8192
"""Blocks that are computed at once."""
MOST_MARKS = 4096
"""Places of the program at which the time is kept."""
FEEDS = (0.1, 0.5, 1.0, 2.0)
RAPIDS = (0.25, 0.5, 1.0)
"""Overrides for which times are kept: GRBL allows 10 to 200 %, and 25, 50 and 100 %."""
STRAIGHT = 0.999999
"""Cosine from which on two directions are the same (or opposite)."""
EASILY = 1e12
LINES_ABOUT = 2
"""Lines that the board may have gone on since it was known to have carried one out."""


@dataclass(frozen=True, slots=True)
class BoardLimits:
    """What the board keeps to.

    Of x, y, z: rates mm/s ($110 to $112), accelerations mm/s^2 ($120 to $122). junction_deviation
    mm ($11), arc_tolerance mm ($12), blocks that it holds.
    """

    rates: tuple[float, float, float]
    accelerations: tuple[float, float, float]
    junction_deviation: float = 0.01
    arc_tolerance: float = 0.002
    blocks: int = BLOCKS_AHEAD

    @classmethod
    def of_machine(cls, machine: Machine) -> BoardLimits:
        """As the machine file has them; what it doesn't know has GRBL's defaults."""
        along = machine.path.max_tangential_acceleration or math.inf
        axes = [machine.axes.get(letter) for letter in ("x", "y", "z")]
        rates = [math.inf if axis is None else axis.max_velocity for axis in axes]
        pulls = [math.inf if axis is None else axis.max_acceleration or along for axis in axes]
        return cls((rates[0], rates[1], rates[2]), (pulls[0], pulls[1], pulls[2]))

    @classmethod
    def of_board(cls, machine: Machine, settings: Mapping[int, float]) -> BoardLimits:
        """As the board tells them by ``$$`` (number and value of each); what it doesn't tell is the
        machine file's.
        """
        own = cls.of_machine(machine)
        x, y, z = (
            per_second(settings[110 + k]) if settings.get(110 + k) else own.rates[k]
            for k in range(3)
        )
        a, b, c = (settings.get(120 + k) or own.accelerations[k] for k in range(3))
        return cls(
            (x, y, z),
            (a, b, c),
            settings.get(11, own.junction_deviation),
            settings.get(12) or own.arc_tolerance,
        )


class BoardTime:
    """Adds up the time of lines, as they are sent one after the other. ``start``: where the board
    stands, x y z in mm as in the lines.
    """

    def __init__(
        self, limits: BoardLimits, start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> None:
        self._limits = limits
        self._at = list(start)
        self._motion, self._plane, self._feed = "G0", 0, 0.0
        self._lines = 0
        self._points: list[tuple[float, float, float]] = [start]
        self._feeds: list[float] = []
        self._owners: list[int] = []
        self._cases = [(feed, 1.0) for feed in FEEDS] + [(1.0, rapid) for rapid in RAPIDS[:-1]]
        self._entry = np.zeros(len(self._cases))
        self._before: Floats | None = None
        self._nominal_before = np.zeros(len(self._cases))
        self._total = np.zeros(len(self._cases))
        self._marks: list[tuple[int, Floats]] = [(0, np.zeros(len(self._cases)))]
        self._stride = 1

    @property
    def seconds(self) -> float:
        """Of all the lines at 100 %, until the board has come to rest behind the last; ask after
        :meth:`end`.
        """
        return float(self._total[FEEDS.index(1.0)])

    def end(self) -> None:
        """There are no more lines."""
        self._flush(rests=True)

    def remaining(
        self, lines: int, feed_override: float = 100.0, rapid_override: float = 100.0
    ) -> float:
        """Seconds that are left when so many of the lines have been carried out, at overrides in
        per cent; ask after :meth:`end`.
        """
        k = max(bisect_right(self._marks, lines, key=lambda mark: mark[0]) - 1, 0)
        number, done = self._marks[k]
        if k + 1 < len(self._marks):
            following, then = self._marks[k + 1]
            done = done + (then - done) * min(
                max((lines - number) / (following - number), 0.0), 1.0
            )
        left = np.maximum(self._total - (done if lines < self._lines else self._total), 0.0)
        usual = float(left[FEEDS.index(1.0)])
        slower = 1.0 / np.array(FEEDS)[::-1]
        by_feed = float(
            np.interp(100.0 / max(feed_override, 1.0), slower, left[: len(FEEDS)][::-1])
        )
        rapids = np.append(left[len(FEEDS) :], usual)
        by_rapid = float(
            np.interp(100.0 / max(rapid_override, 1.0), 1.0 / np.array(RAPIDS)[::-1], rapids[::-1])
        )
        return max(by_feed + by_rapid - usual, 0.0)

    def add(self, line: GcodeLine) -> None:
        """The next line."""
        self._lines += 1
        words = line.text.partition("(")[0].split()
        given: dict[str, float] = {}
        waits = dwells = False
        for word in words:
            letter = word[0]
            if letter in "GM$":
                if word in ("G0", "G1", "G2", "G3") or word.startswith("G38."):
                    self._motion = word
                elif word in ("G17", "G18", "G19"):
                    self._plane = int(word[1:]) - 17
                elif word not in ("G21", "G90", "G94", "G54"):
                    waits, dwells = True, word == "G4"
            else:
                given[letter] = float(word[1:])
        if dwells or waits or self._motion.startswith("G38."):
            self._flush(rests=True)
        if dwells:
            self._total = self._total + given.get("P", 0.0)
            self._kept([(self._lines, self._total)])
        elif not waits:
            self._feed = per_second(given["F"]) if "F" in given else self._feed
            if any(letter in given for letter in "XYZIJK"):
                self._move(given)
        if self._motion.startswith("G38."):
            self._flush(rests=True)
            self._motion = "G38."
        elif len(self._feeds) >= BATCH + self._limits.blocks:
            self._flush(rests=False)

    def _move(self, given: Mapping[str, float]) -> None:
        end = [given.get(letter, here) for letter, here in zip(LETTERS, self._at, strict=True)]
        if self._motion in ("G2", "G3"):
            points = self._chords(given, end)
        else:
            points = [(end[0], end[1], end[2])]
        self._points += points
        self._feeds += [math.nan if self._motion == "G0" else self._feed] * len(points)
        self._owners += [self._lines] * len(points)
        self._at = end

    def _chords(
        self, given: Mapping[str, float], end: list[float]
    ) -> list[tuple[float, float, float]]:
        """The points that the board makes of an arc."""
        i, j, across = PLANE_COLUMNS[self._plane]
        begin = self._at
        x, y = -given.get("IJK"[i], 0.0), -given.get("IJK"[j], 0.0)
        cx, cy = begin[i] - x, begin[j] - y
        radius = math.hypot(x, y)
        fx, fy = end[i] - cx, end[j] - cy
        sweep = math.atan2(x * fy - y * fx, x * fx + y * fy)
        if self._motion == "G3" and sweep <= 5e-7:
            sweep += 2.0 * math.pi
        if self._motion == "G2" and sweep >= -5e-7:
            sweep -= 2.0 * math.pi
        error = self._limits.arc_tolerance
        half = math.sqrt(error * (2.0 * radius - error)) if error < 2.0 * radius else math.inf
        count = max(1, math.floor(0.5 * abs(sweep) * radius / half))
        part = np.arange(1, count) / count
        cos, sin = np.cos(part * sweep), np.sin(part * sweep)
        rows = np.empty((count, 3))
        rows[:-1, i] = cx + cos * x - sin * y
        rows[:-1, j] = cy + sin * x + cos * y
        rows[:-1, across] = begin[across] + (end[across] - begin[across]) * part
        rows[-1] = end
        return [(a, b, c) for a, b, c in rows.tolist()]

    def _flush(self, *, rests: bool) -> None:
        """Add up the blocks so far: all of them if the board rests behind them, else those behind
        which it knows enough others.
        """
        points = np.array(self._points)
        steps = np.diff(points, axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        real = lengths > 1e-9
        steps, lengths = steps[real], lengths[real]
        feeds, owners = np.array(self._feeds)[real], np.array(self._owners, np.int64)[real]
        count = len(lengths)
        done = count if rests else max(count - self._limits.blocks, 0)
        if done:
            units = steps / lengths[:, None]
            joined = units if self._before is None else np.concatenate((self._before[None], units))
            junction = self._junctions(joined)
            if self._before is None:
                junction = np.concatenate(([0.0], junction))
            times = np.stack(
                [
                    self._times(k, units, lengths, feeds, junction, done)
                    for k in range(len(self._cases))
                ],
                axis=1,
            )
            self._mark(owners[:done], times)
        if rests:
            self._points, self._feeds, self._owners = [points[-1].tolist()], [], []
            self._before = None
            self._entry[:] = 0.0
        elif done:
            # positions of what stays: all points from the end of the last that is done
            behind = int(np.flatnonzero(real)[done - 1]) + 1
            self._points, self._feeds, self._owners = (
                self._points[behind:],
                self._feeds[behind:],
                self._owners[behind:],
            )
            self._before = units[done - 1]

    def _times(
        self, case: int, units: Floats, lengths: Floats, feeds: Floats, junction: Floats, done: int
    ) -> Floats:
        """Seconds of each of the first ``done`` blocks, at one pair of overrides."""
        feed, rapid = self._cases[case]
        limits = self._limits
        directions = np.maximum(np.abs(units), 1e-12)
        fastest = (np.array(limits.rates) / directions).min(axis=1)
        pull = (np.array(limits.accelerations) / directions).min(axis=1)
        nominal = np.where(np.isnan(feeds), fastest * rapid, np.minimum(feeds * feed, fastest))
        nominal = np.maximum(nominal, 1e-3)
        before = np.concatenate(
            ([nominal[0] if self._before is None else self._nominal_before[case]], nominal[:-1])
        )
        most = np.minimum(junction, np.minimum(nominal, before) ** 2)
        gain = 2.0 * pull * lengths
        # what of the speed can be lost until the end of what is known
        bound = np.zeros(len(lengths) + 1)
        for _ in range(min(limits.blocks, len(lengths))):
            bound[:-1] = np.minimum(most, bound[1:] + gain)
        begun = np.concatenate(([0.0], np.cumsum(gain)))
        if self._before is not None:
            bound[0] = min(bound[0], self._entry[case])
        squares = np.minimum.accumulate(bound - begun) + begun
        squares = np.maximum(squares, 0.0)
        v0, v1 = np.sqrt(squares[:-1][:done]), np.sqrt(squares[1:][:done])
        if done < len(lengths):
            self._entry[case] = squares[done]
        self._nominal_before[case] = nominal[done - 1]
        a, d = pull[:done], lengths[:done]
        peak = np.minimum(nominal[:done], np.sqrt(0.5 * (v0 * v0 + v1 * v1) + a * d))
        peak = np.maximum(peak, np.maximum(v0, v1))
        ramps = (2.0 * peak * peak - v0 * v0 - v1 * v1) / (2.0 * a)
        times: Floats = (2.0 * peak - v0 - v1) / a + np.maximum(d - ramps, 0.0) / peak
        return times

    def _junctions(self, units: Floats) -> Floats:
        """Square of the speed at which each direction may follow the one before it."""
        before, after = units[:-1], units[1:]
        cos = -np.einsum("ij,ij->i", before, after)
        turn = after - before
        size = np.linalg.norm(turn, axis=1)
        aims = np.maximum(np.abs(turn / np.maximum(size, 1e-12)[:, None]), 1e-12)
        pull = (np.array(self._limits.accelerations) / aims).min(axis=1)
        half = np.sqrt(np.maximum(0.5 * (1.0 - cos), 0.0))
        squares = pull * self._limits.junction_deviation * half / np.maximum(1.0 - half, 1e-12)
        return np.where(cos > STRAIGHT, 0.0, np.where(cos < -STRAIGHT, EASILY, squares))

    def _mark(self, owners: NDArray[np.int64], times: Floats) -> None:
        """Keep the time at the end of lines, ever fewer of them as the program grows."""
        sums = self._total + np.cumsum(times, axis=0)
        ends = np.flatnonzero(np.append(np.diff(owners) > 0, True))
        self._kept((int(owners[k]), sums[k]) for k in ends.tolist())
        self._total = sums[-1]

    def _kept(self, marks: Iterable[tuple[int, Floats]]) -> None:
        for line, total in marks:
            last, before = self._marks[-1]
            if self._stride == 1 and line > last + 1:
                # lines between that take no time
                self._marks.append((line - 1, before))
            if line >= last + self._stride:
                self._marks.append((line, total.copy()))
        while len(self._marks) > MOST_MARKS:
            self._stride *= 2
            self._marks = self._marks[::2]


class Countdown:
    """What is left of a program that a board is carrying out.

    Which line the board is on is known, but not how far along it is, and the report is as old as
    the time between two: the clock goes on between what is left behind that line and the next, and
    what was left before it, unless the motion is held.
    """

    def __init__(self, time: BoardTime) -> None:
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
        """Seconds that are left at ``now`` (s), when the board has carried out so many lines;
        overrides in per cent.
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
        self._left = min(
            max(self._left, self._time.remaining(done + LINES_ABOUT, *overrides)), most
        )
        return self._left
