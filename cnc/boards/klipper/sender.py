"""Sending of grid moves to the queues of a Klipper board: horizon, slots, steps, emergency ramp.

      board plays       sent            reserve            from the planner
    ──────●──────────────────────┤·················┤ ◄── ── ── ── ── ──
          └────── horizon ───────┘  half a ramp

The board stops dead when its queues run dry. So the last part of what the planner has given is
kept as a reserve. When no more comes in time, the reserve is stretched to a ramp to rest on the
path (:mod:`cnc.boards.klipper.sender`). Each entry has a clock, so the board keeps the time. The
motors of an axis get the same runs.
"""

from __future__ import annotations

import heapq
import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.boards.klipper.connection import POLL_S, Connection
from cnc.boards.klipper.guards import Guard, TooLate
from cnc.boards.klipper.kernels import step_runs as kernel
from cnc.boards.klipper.kernels.step_runs import Fit, Runs
from cnc.boards.klipper.layout import Layout, MotorObject
from cnc.machine.models import Machine
from cnc.model.streams import PulseChunk

# Source lines and grid points of the motion that was sent, until the board has played it.


@dataclass(slots=True)
class _Part:
    """Some moves.

    Attributes:
        clock: Clock of each move (n,).
        points: Grid point after each move (n, axes).
        lines: Source line of each move (n,).
    """

    clock: NDArray[np.int64]
    points: NDArray[np.int64]
    lines: NDArray[np.int32]


class LineTracker:
    """The motion that was sent.

    Attributes:
        line: Source line that the board has reached, or an earlier one.
    """

    def __init__(self) -> None:
        self.line = 0
        self._parts: deque[_Part] = deque()
        self._point: NDArray[np.int64] | None = None
        self._runs: deque[tuple[int, int, int, int]] = deque()
        self._received = np.empty(0, np.int64)
        self._received_line = 0
        self._begin = np.empty(0, np.int64)
        self._left = np.empty(0, np.bool_)
        self._back_at: int | None = None

    def add(
        self, clock: NDArray[np.int64], points: NDArray[np.int64], lines: NDArray[np.int32]
    ) -> None:
        """Add moves: their clocks (n,), grid points (n, axes) and source lines (n,)."""
        self._parts.append(_Part(clock, points, lines))
        if self._back_at is None:
            away = points != self._begin
            left = np.logical_or.accumulate(away, axis=0) | self._left
            self._left = left[-1]
            back = np.flatnonzero((left & ~away).any(axis=1))
            if len(back):
                self._back_at = int(clock[back[0]])

    def add_run(self, command: int, column: int, steps: int, line: int) -> None:
        """Add steps of an axis, which a command with this number has sent."""
        self._runs.append((command, column, steps, line))

    def acknowledge(self, command: int) -> None:
        """Note the number of the last command that the board has acknowledged."""
        while self._runs and self._runs[0][0] <= command:
            _, column, steps, self._received_line = self._runs.popleft()
            self._received[column] += steps

    def end_of_queue(self, acknowledged: int) -> NDArray[np.int64]:
        """Return the grid point after all steps that the board has; the line becomes that there."""
        self.acknowledge(acknowledged)
        self.line = self._received_line or self.line
        return self._received.copy()

    def played(self, clock: int) -> NDArray[np.int64] | None:
        """Drop what has been played at a clock; return the grid point there if it is known."""
        while self._parts and self._parts[0].clock[-1] <= clock:
            part = self._parts.popleft()
            self.line = int(part.lines[-1]) or self.line
            self._point = part.points[-1]
        if self._parts:
            row = int(np.searchsorted(self._parts[0].clock, clock, side="right")) - 1
            if row >= 0:
                self.line = int(self._parts[0].lines[row]) or self.line
                self._point = self._parts[0].points[row]
        return self._point

    def clear(self, point: NDArray[np.int64]) -> None:
        """Drop everything: the board stands at a grid point (axes,)."""
        self._parts.clear()
        self._runs.clear()
        self._point, self._received = point, point.copy()
        self._begin, self._left, self._back_at = point, np.zeros(len(point), np.bool_), None

    def unmoved(self, point: NDArray[np.int64], clock: int) -> bool:
        """Return whether a stopped board with these counts has made no step since it stood still.

        An axis that was there and back has the same count, but may have stopped at speed.

        Args:
            point: Grid point (axes,) by the counts of the board.
            clock: Clock after which no step was made.
        """
        came_back = self._back_at is not None and self._back_at <= clock
        return not came_back and np.array_equal(point, self._begin)

    def line_at(self, point: NDArray[np.int64]) -> int:
        """Return the source line of the last move to a grid point, 0 if it is not known."""
        for part in reversed(self._parts):
            rows = np.flatnonzero((part.points == point).all(axis=1))
            if len(rows):
                return int(part.lines[rows[-1]])
        return 0


# Entries of the move queue of a Klipper board.


class Slots:
    """Entries of the board's queue, by the clocks at which they are free again.

    Args:
        count: Number of entries.

    Attributes:
        slack: Ticks that an entry counts longer: the board may be late, and the present clock is
            an estimate.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self.slack = 0
        self._ends: list[int] = []

    def add(self, clock: int) -> None:
        """Add an entry that is free again at a clock."""
        heapq.heappush(self._ends, clock)

    def used(self, clock: int) -> int:
        """Return the number of entries in use at a clock."""
        while self._ends and self._ends[0] <= clock - self.slack:
            heapq.heappop(self._ends)
        return len(self._ends)

    def clear(self) -> None:
        """Forget all entries: the board has dropped them."""
        self._ends.clear()


# Moves that the planner has given and that were not sent yet.


class Moves(NamedTuple):
    """Grid moves in the order of their times.

    Attributes:
        time_ns: Time of each move (n,), ns.
        step: Step of each axis (n, axes), -1, 0 or 1.
        line: Source line of each move (n,).
        points: Grid point after each move (n, axes).
    """

    time_ns: NDArray[np.int64]
    step: NDArray[np.int8]
    line: NDArray[np.int32]
    points: NDArray[np.int64]

    def part(self, rows: slice) -> Moves:
        """Return some of the moves."""
        return Moves(self.time_ns[rows], self.step[rows], self.line[rows], self.points[rows])


class WaitingMoves:
    """A queue of moves."""

    def __init__(self) -> None:
        self._parts: list[Moves] = []

    def __bool__(self) -> bool:
        return bool(self._parts)

    @property
    def first_ns(self) -> int:
        """Time of the first move, ns."""
        return int(self._parts[0].time_ns[0])

    @property
    def last_ns(self) -> int:
        """Time of the last move, ns."""
        return int(self._parts[-1].time_ns[-1])

    def append(self, moves: Moves) -> None:
        """Add moves at the end."""
        self._parts.append(moves)

    def joined(self) -> Moves:
        """Return all moves."""
        if len(self._parts) > 1:
            joined = Moves(*(np.concatenate(parts) for parts in zip(*self._parts, strict=True)))
            self._parts[:] = [joined]
        return self._parts[0]

    def drop(self, rows: int) -> None:
        """Drop the first moves."""
        moves = self.joined()
        self._parts[:] = [moves.part(slice(rows, None))] if rows < len(moves.time_ns) else []

    def clear(self) -> None:
        """Drop all moves."""
        self._parts.clear()


# Steps of one motor as runs for its queue on the board (``queue_step``).

ROWS = 16384
"""Most steps in one call of the kernel."""


class StepEncoder:
    """Encodes the steps of one motor, part by part. Times are ticks of the board's clock, 64 bits.

    Args:
        tolerance: Largest deviation of a step from its time, ticks.
        last: Time from which the first interval counts, ticks.
        least: Least time between two steps, ticks. It protects the step after a part.

    Attributes:
        last: Time of the last step, ticks.
    """

    def __init__(self, tolerance: int, last: int = 0, least: int = 0) -> None:
        self.tolerance = tolerance
        self._least = least
        self.last = last
        self._runs = Runs(*(np.empty(ROWS, np.int64) for _ in range(6)))
        self._fit = Fit(
            np.empty(ROWS),
            np.empty(ROWS),
            1.0 / np.arange(1.0, ROWS + 1.0),
            np.zeros(2, np.int64),
        )

    def encode(self, due: NDArray[np.int64], sign: NDArray[np.int8]) -> Runs:
        """Return the runs of steps.

        Args:
            due: Time of each step (n,), ticks, increasing.
            sign: Direction of each step (n,), 1 or -1.

        Raises:
            ValueError: The times do not increase, or a step is 2**32 ticks after the last one.
        """
        parts: list[Runs] = []
        for at in range(0, len(due), ROWS):
            status, made, last = kernel.encode_steps(
                due[at : at + ROWS],
                sign[at : at + ROWS],
                self.tolerance,
                self._least,
                self.last,
                self._runs,
                self._fit,
            )
            if status != kernel.OK:
                reason = "do not increase" if status == kernel.NOT_RISING else "are too far apart"
                raise ValueError(f"The times of the steps {reason}.")
            self.last = last
            parts.append(Runs(*(column[:made].copy() for column in self._runs)))
        if len(parts) == 1:
            return parts[0]
        return (
            Runs(*(np.concatenate(column) for column in zip(*parts, strict=True)))
            if parts
            else (Runs(*(np.empty(0, np.int64) for _ in range(6))))
        )


# The emergency ramp: motion that is stretched in time, so that it comes to rest on its path.
#
# At the time t of a ramp of T seconds, the motion has the fraction ``1 - 3u^2 + 2u^3`` of its
# planned speed, with ``u = t / T``. It covers ``T / 2`` seconds of the plan.

STEEPEST = 1.5
"""Ratio of the steepest to the mean slope of the ramp."""
LEAST_S, MOST_S, UNKNOWN_S = 0.02, 0.5, 0.2
"""Bounds of a ramp, and its length for a machine without accelerations of the axes."""
POINTS = 513


def ramp_seconds(machine: Machine, feed: float = math.inf) -> float:
    """Return the length of a ramp from a speed within the accelerations of the axes, s.

    Args:
        machine: The machine.
        feed: The speed, mm/s; that of an axis is at most its highest.
    """
    stops = [
        min(axis.max_velocity, feed) / axis.max_acceleration
        for axis in machine.axes.values()
        if axis.max_acceleration
    ]
    return min(max(STEEPEST * max(stops, default=UNKNOWN_S / STEEPEST), LEAST_S), MOST_S)


def stretched(time_ns: NDArray[np.int64], from_ns: int, seconds: float) -> NDArray[np.int64]:
    """Return the times of moves in a ramp, for those that come before its end.

    Args:
        time_ns: Planned time of each move (n,), ns, not before ``from_ns``.
        from_ns: Begin of the ramp, ns.
        seconds: Length of the ramp, s.
    """
    u = np.linspace(0.0, 1.0, POINTS)
    covered = seconds * (u - u**3 + 0.5 * u**4)
    planned = (time_ns - from_ns) * 1e-9
    within = planned[planned < covered[-1]]
    # The table is inverted by interpolation, which keeps the order of the moves.
    late = np.interp(within, covered, seconds * u)
    times: NDArray[np.int64] = from_ns + np.round(late * 1e9).astype(np.int64)
    return times


# Tolerances of a motion on a Klipper board, and how far ahead it is sent.


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Tolerances of a motion.

    Attributes:
        tolerance_s: Largest deviation of a step from its time, s.
        spacing_s: Least time between two steps of an axis, s.
        ramp_s: Length of an emergency ramp, s.
    """

    tolerance_s: float
    spacing_s: float
    ramp_s: float


@dataclass(frozen=True, slots=True)
class Pace:
    """How far ahead of the board a motion is sent.

    Attributes:
        horizon_s: Longest motion sent ahead of the motion that the board plays, s.
        prefill_s: Motion beyond the reserve that is there before the motion starts, s.
        start_s: Time from the start of a motion to its first move, s.
        dry_s: Motion left on the board at which the reserve becomes a ramp, s.
    """

    horizon_s: float
    prefill_s: float
    start_s: float
    dry_s: float


RUN = Pace(horizon_s=0.25, prefill_s=0.1, start_s=0.2, dry_s=0.08)
JOG = Pace(horizon_s=0.1, prefill_s=0.04, start_s=0.06, dry_s=0.03)
"""A jog ends soon after its release, so little is sent ahead."""
DENSE_DRY_S = 0.025
"""The same as ``dry_s`` at most, while the motion left uses half of the queue or more: dense motion
fills the queue of a small board before ``dry_s`` is reached.
"""


PIECE_S = 0.02
"""Length of the pieces in which moves are compressed and sent."""
LATE_S = 0.01
"""A move must be sent so long before its time."""
SETTLE_S = 0.003
"""Time after the last step until the position is read."""
GAP_TICKS = 2**28
"""Ticks without a step after which a motor gets a new reference clock.

Timers compare clocks by the sign of a 32-bit difference.
"""
BOARD_LATE_S = 0.001
"""Longest delay of a step: the firmware shuts down when one is later."""
SPARE_SLOTS = 4
"""Slots of the queue that stay free, besides two for each output."""


class Sender:
    """The motion of one board. Times are ns of the program's clock, clocks are ticks of the board.

    Args:
        connection: The connection.
        layout: The objects of the board.
        axes: Number of axes.
        slots: Entries of the board's queue.
        guard: What the sender asks of its owner.
        limits: Tolerances of the motion.

    Attributes:
        position: Grid point at the end of what was sent (axes,).
        until_ns: End of the stream, ns.
        cut: A trigger has ended the motion, so that moves are dropped.
        running: The program's clock is bound to the board's clock.
        ramped: An emergency ramp has ended the motion.
        stopped_clock: Clock of a shutdown that has ended the motion, None if none has.
        tracker: Source lines of the motion.
        most_slots: Most entries in use so far.
        moves: Number of entries sent.
    """

    def __init__(
        self,
        connection: Connection,
        layout: Layout,
        axes: int,
        slots: int,
        guard: Guard,
        limits: MotionLimits,
    ) -> None:
        self.position = np.zeros(axes, np.int64)
        self.until_ns = 0
        self.cut = self.running = self.ramped = False
        self.stopped_clock: int | None = None
        self.tracker = LineTracker()
        self.slots = Slots(max(slots - SPARE_SLOTS - 2 * len(layout.outputs), 8))
        self.most_slots = self.moves = 0
        self._connection, self._guard, self._axes = connection, guard, axes
        self._frequency = connection.board_clock.frequency
        tolerance = int(limits.tolerance_s * self._frequency)
        least = int(limits.spacing_s * self._frequency)
        self._longest_ramp_s = limits.ramp_s
        self.set_pace(RUN)
        self._encoders = [StepEncoder(tolerance, least=least) for _ in range(axes)]
        self._layout = layout
        self._motors: list[list[MotorObject]] = []
        self.select(None)
        self._levels: dict[int, int] = {}
        self._waiting = WaitingMoves()
        self._base_ns = self._base_clock = 0
        self._sent_ns = 0
        self._end_clock = 0
        self._flushed = True
        self._begun = self._sending = False

    def set_pace(self, pace: Pace, ramp_s: float | None = None) -> None:
        """Choose how far ahead the next motion is sent; ``ramp_s``: length of its ramp to rest."""
        self._pace = pace
        self.ramp_s = self._longest_ramp_s if ramp_s is None else ramp_s
        self._reserve_ns = round(0.5e9 * self.ramp_s)

    def select(self, alone: tuple[int, int] | None) -> None:
        """Let one motor of an axis (column, motor) take part in the motion, or all."""
        self._motors = [
            [
                motor
                for motor in self._layout.motors
                if motor.column == column
                and (alone is None or alone[0] != column or alone[1] == motor.number)
            ]
            for column in range(self._axes)
        ]

    @property
    def is_empty(self) -> bool:
        """Whether no move waits."""
        return not self._waiting

    @property
    def now(self) -> int:
        """Present clock of the board."""
        return self._connection.board_clock.at(self._connection.clock.now())

    @property
    def last_clock(self) -> int:
        """Clock after which the board has made no step so far."""
        now = self.now
        return now if self.stopped_clock is None else min(now, self.stopped_clock)

    def clock_of(self, time_ns: int) -> int:
        """Return the clock of a time of the program."""
        return self._base_clock + round((time_ns - self._base_ns) * 1e-9 * self._frequency)

    @property
    def played_ns(self) -> int:
        """Time of the program that the board plays, ns."""
        return self._base_ns + round((self.now - self._base_clock) / self._frequency * 1e9)

    @property
    def ahead_s(self) -> float:
        """Motion that was sent and is not played yet, s."""
        if not self.running:
            return 0.0
        return max(self.clock_of(max(self._sent_ns, self.until_ns)) - self.now, 0) / self._frequency

    @property
    def end_of_queue(self) -> NDArray[np.int64]:
        """Grid point where a board rests that hears nothing any more: it plays what it has."""
        return self.tracker.end_of_queue(self._connection.link.acknowledged)

    def begin(self, position: NDArray[np.int64]) -> None:
        """Begin a program at a grid point (axes,), at time 0."""
        self.position = position
        self.until_ns = self._sent_ns = 0
        self.tracker.clear(position)
        self._drop()
        self.cut = self.ramped = False

    def stand_at(self, position: NDArray[np.int64]) -> None:
        """Continue from a grid point (axes,) where a trigger has ended the motion."""
        self.position = position
        self.cut = False
        self.tracker.clear(position)
        self._drop()

    def stop(self) -> None:
        """Forget everything that was sent: the board has dropped it."""
        self.running = False
        self.slots.clear()
        self._drop()

    def gather(self, chunk: PulseChunk, points: NDArray[np.int64]) -> None:
        """Add grid moves, and send what is beyond the reserve.

        Args:
            chunk: Grid moves.
            points: Grid point after each move (n, axes).
        """
        if self.cut or self.ramped or not len(chunk.time_ns):
            return
        first, last = int(chunk.time_ns[0]), int(chunk.time_ns[-1])
        if not self._waiting and self._flushed:
            self._sent_ns = max(self._sent_ns, min(first, self.until_ns) if self.running else first)
        self._flushed = False
        self._waiting.append(Moves(chunk.time_ns, chunk.step, chunk.line, points))
        if not self.running:
            begin = self._waiting.first_ns
            if last - begin < self._reserve_ns + self._pace.prefill_s * 1e9:
                return
            self.start(begin)
        self._release(last - self._reserve_ns)

    def flush(self) -> None:
        """Send everything: the motion ends at rest."""
        if self._waiting and not (self.cut or self.ramped):
            if not self.running:
                self.start(self._waiting.first_ns)
            self._flushed = True
            self._release(self._waiting.last_ns + 1)
        self._flushed = True
        self._begun = False

    def start(self, time_ns: int) -> None:
        """Bind the program's clock to the board's clock; motors stand still."""
        self._base_ns = self._sent_ns = time_ns
        self.until_ns = max(self.until_ns, time_ns)
        self._base_clock = self.now + round(self._pace.start_s * self._frequency)
        self._end_clock = self._base_clock
        late_s = self._connection.board_clock.half_trip_s + BOARD_LATE_S
        self.slots.slack = round(late_s * self._frequency)
        self.running = True
        self._begun = False
        self.stopped_clock = None
        self._levels.clear()
        # The first interval must not be empty.
        reference = self._base_clock - round(SETTLE_S * self._frequency)
        for encoder in self._encoders:
            encoder.last = reference
        self._guard.arm(reference)

    def rest(self, time_ns: int) -> None:
        """Send everything, and wait until the board has played it and a time has come.

        The program's clock stands still until the next start.
        """
        self.flush()
        if not self.running:
            return
        self.until_ns = max(self.until_ns, time_ns)
        self.wait_for_end()

    def wait_for_end(self) -> None:
        """Wait until the board has played everything that was sent."""
        end = max(self._end_clock, self.clock_of(self.until_ns))
        end += round(SETTLE_S * self._frequency)
        while self.running and not self.cut and self.now < end:
            self._guard.pump(min(max((end - self.now) / self._frequency, 1e-4), 5 * POLL_S))
        self._connection.flush(self._guard.pump)
        self.running = False
        self.slots.clear()

    def watch(self) -> bool:
        """Return whether no more motion comes in time, so that a ramp is needed."""
        idle = self._flushed or self._sending or self.cut or self.ramped
        if idle or not (self.running and self._begun):
            return False
        now = self.now
        left_s = (self.clock_of(self._sent_ns) - now) / self._frequency
        dense = 2 * self.slots.used(now) >= self.slots.count
        return left_s < (min(DENSE_DRY_S, self._pace.dry_s) if dense else self._pace.dry_s)

    def ramp(self) -> None:
        """Come to rest on the path within the reserve."""
        self.ramped = True
        if not self._waiting:
            return
        moves = self._waiting.joined()
        late = stretched(moves.time_ns, self._sent_ns, self.ramp_s)
        self._drop()
        if len(late):
            # The tolerance may round two stretched moves of an axis to one clock only at rest.
            self._put(moves.part(slice(len(late)))._replace(time_ns=late))
            self.until_ns = max(self.until_ns, int(late[-1]))
        self._flushed = True

    def _drop(self) -> None:
        self._waiting.clear()
        self._flushed = True

    def _release(self, until_ns: int) -> None:
        """Send the moves before a time, piece by piece."""
        # What waits is sent at once, so a short standstill of this computer needs no ramp.
        self._sending = True
        try:
            self._release_pieces(until_ns)
        finally:
            self._sending = False

    def _release_pieces(self, until_ns: int) -> None:
        piece = round(PIECE_S * 1e9)
        while (
            self._waiting
            and not (self.cut or self.ramped)
            and (self._sent_ns + piece <= until_ns or self._flushed)
        ):
            begin = self._waiting.first_ns
            if self._sent_ns + piece < begin:
                # Nothing moves for a while: only the horizon passes.
                self._sent_ns = min(begin, until_ns)
                self._wait_for_horizon(self._sent_ns)
                continue
            end_ns = min(self._sent_ns + piece, until_ns)
            moves = self._waiting.joined()
            rows = int(np.searchsorted(moves.time_ns, end_ns))
            if rows and not self._begun:
                self._renew_base(begin)
                end_ns = max(end_ns, self._sent_ns)
            self._wait_for_horizon(end_ns)
            if self.cut or self.ramped:
                return
            self._waiting.drop(rows)
            self._sent_ns = end_ns
            if rows:
                self._put(moves.part(slice(rows)))
        if self._flushed:
            self.until_ns = max(self.until_ns, self._sent_ns)

    def _renew_base(self, begin_ns: int) -> None:
        """Bind the clocks anew if a motion from rest comes too late for the present base."""
        self._begun = True
        if self.clock_of(begin_ns) - self.now < self._pace.dry_s * self._frequency:
            self._guard.rest(self.until_ns)
            self._begun = True
            if not self.cut:
                self.start(begin_ns)

    def _wait_for_horizon(self, time_ns: int) -> None:
        while self.running and not (self.cut or self.ramped):
            left = (self.clock_of(time_ns) - self.now) / self._frequency - self._pace.horizon_s
            if left <= 0.0:
                return
            self._guard.pump(min(max(left, 1e-4), 5 * POLL_S))

    def _put(self, moves: Moves) -> None:
        """Encode and send moves in the order of their clocks."""
        time_ns, step, line, points = moves
        ticks = np.rint((time_ns - self._base_ns) * (1e-9 * self._frequency))
        clocks = self._base_clock + ticks.astype(np.int64)
        queued: list[tuple[int, int, int, Runs]] = []
        for column in range(self._axes):
            rows = np.flatnonzero(step[:, column])
            if not len(rows):
                continue
            due = clocks[rows]
            self._renew(column, int(due[0]))
            runs = self._encoders[column].encode(due, step[rows, column])
            queued += [(begin, column, k, runs) for k, begin in enumerate(runs.begin.tolist())]
        queued.sort(key=lambda entry: entry[:3])
        link = self._connection.link
        self.tracker.add(clocks, points, line)
        self.tracker.acknowledge(link.acknowledged)
        for begin, column, k, runs in queued:
            self._queue(begin, column, k, runs)
            if self.cut:
                return
            steps = int(runs.sign[k]) * int(runs.length[k])
            self.tracker.add_run(link.appended, column, steps, int(line[0]))
        self.position = points[-1]
        self._guard.pump(0.0)

    def _renew(self, column: int, due: int) -> None:
        """Give the motors of an axis a new reference clock after a long pause."""
        encoder = self._encoders[column]
        if due - encoder.last < GAP_TICKS:
            return
        rested = encoder.last + round(SETTLE_S * self._frequency)
        while self.running and not self.cut and self.now < rested:
            self._guard.pump(POLL_S)
        encoder.last = due - round(SETTLE_S * self._frequency)
        for motor in self._motors[column]:
            clock = encoder.last % 2**32
            self._connection.send("reset_step_clock", oid=motor.oid, clock=clock)

    def _queue(self, begin: int, column: int, k: int, runs: Runs) -> None:
        """Send one run for each motor of an axis, when the queue has space."""
        motors = self._motors[column]
        while not self.cut and self.slots.used(self.now) + len(motors) > self.slots.count:
            self._guard.pump(POLL_S)
        if self.cut:
            return
        if begin - self.now < LATE_S * self._frequency:
            raise TooLate
        sign, end = int(runs.sign[k]), int(runs.end[k])
        for motor in motors:
            level = motor.forward if sign > 0 else 1 - motor.forward
            if self._levels.get(motor.oid) != level:
                self._levels[motor.oid] = level
                self._connection.send("set_next_step_dir", oid=motor.oid, dir=level)
            self._connection.send(
                "queue_step",
                oid=motor.oid,
                interval=int(runs.interval[k]),
                count=int(runs.length[k]),
                add=int(runs.add[k]),
            )
            self.slots.add(end)
            self.moves += 1
        self._end_clock = max(self._end_clock, end)
        self.most_slots = max(self.most_slots, self.slots.used(self.now))
