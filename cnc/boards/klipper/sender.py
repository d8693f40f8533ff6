"""Sending of grid moves to the queues of a Klipper board, within a horizon and the queue's slots.

      board plays       sent            reserve            from the planner
    ──────●──────────────────────┤·················┤ ◄── ── ── ── ── ──
          └────── horizon ───────┘  half a ramp

The board stops dead when its queues run dry. So the last part of what the planner has given is kept
as a reserve. When no more comes in time, the reserve is stretched to a ramp to rest on the path
(:mod:`cnc.boards.klipper.ramp`). Each entry has a clock, so the board keeps the time. The motors of
an axis get the same runs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.boards.klipper.connection import POLL_S, Connection
from cnc.boards.klipper.guards import Guard, TooLate
from cnc.boards.klipper.layout import Layout, MotorObject
from cnc.boards.klipper.line_tracker import LineTracker
from cnc.boards.klipper.motion_limits import DENSE_DRY_S, RUN, MotionLimits, Pace
from cnc.boards.klipper.ramp import stretched
from cnc.boards.klipper.slots import Slots
from cnc.boards.klipper.steps import StepEncoder
from cnc.boards.klipper.waiting_moves import Moves, WaitingMoves
from cnc.kernels.klipper.step_runs import Runs
from cnc.model.streams import PulseChunk

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
                each
                for each in self._layout.motors
                if each.column == column
                and (alone is None or alone[0] != column or alone[1] == each.number)
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
        found: list[tuple[int, int, int, Runs]] = []
        for column in range(self._axes):
            rows = np.flatnonzero(step[:, column])
            if not len(rows):
                continue
            due = clocks[rows]
            self._renew(column, int(due[0]))
            runs = self._encoders[column].encode(due, step[rows, column])
            found += [(begin, column, k, runs) for k, begin in enumerate(runs.begin.tolist())]
        found.sort(key=lambda each: each[:3])
        link = self._connection.link
        self.tracker.add(clocks, points, line)
        self.tracker.acknowledge(link.acknowledged)
        for begin, column, k, runs in found:
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
