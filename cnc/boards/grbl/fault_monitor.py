"""Faults of a GRBL board from its answers and reports, and from its silence. No I/O.

answer or report               | found by         | found within
-------------------------------+------------------+--------------------------------------
error, ALARM, welcome, extra ok| this module      | at once
ok, one by one                 | marks (protocol) | half a second and a move
none, or status reports only   | `Liveness`       | 2 s
position                       | position_tracker | the motion ahead (1.5 s), two reports

A report is judged at its place among the answers. All times are times of listening (see
:attr:`~cnc.boards.grbl.link.GrblLink.listened`): a computer that pauses finds reports and answers
that are old, and misses none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from cnc.boards.grbl import faults
from cnc.boards.grbl.faults import stops_motors
from cnc.boards.grbl.messages import (
    Alarmed,
    Event,
    Firmware,
    Lost,
    Rejected,
    Reported,
    SentLine,
    Started,
    Status,
    UnexpectedReply,
)
from cnc.boards.grbl.position_tracker import TOLERANCE, AxisLimits, PositionTracker
from cnc.boards.grbl.protocol import GrblProtocol, LineGroup, State
from cnc.boards.grbl.settings import ACCELERATIONS, ARC_TOLERANCE, RATES, STEPS, BoardInfo
from cnc.model.diagnostics import BoardError
from cnc.model.units import per_second

# Whether a GRBL board that answers nothing is busy or dead. No I/O.
#
# The status, asked for five times a second, shows the difference:
#
# unanswered lines and   | status                    | meaning
# -----------------------+---------------------------+----------------------------------------------
# no answer              | Run, the position changes | a long move: the planner is full
# no answer              | Idle, a dwell is due      | the dwell, for its time
# no answer              | Hold, Door                | the machine is held until it is resumed
# no answer              | Idle for 2 s              | a line or an answer was lost
# no answer              | Run for 30 s, no motion   | the board is stuck

QUIET = 2.0
"""Seconds of an idle board with unanswered lines after which a line counts as lost."""
SPIN_UP = 20.0
"""Additional seconds while the spindle starts: grblHAL may wait for its speed."""
STUCK = 30.0
"""Seconds within which a board in state Run must move by a reportable amount."""
MARK_PAUSE = 0.5
"""Seconds without an answer after which a mark asks for one."""
MARK_PATIENCE = 1.5
"""Seconds for the answer to a mark that is the oldest line: the board reads it at once, however
full its planner is.
"""
LIVENESS_AHEAD = 0.5
"""Seconds of lines that wait in the receive buffer, beside those in the planner. More would only
delay the detection of a fault.
"""
FEWEST_WAITING = 1
INTERVAL_WEIGHT = 0.3
"""Weight of the last answer in the average time between answers."""
LASTING_WEIGHT = 0.03
"""The same for the average over a longer time."""
STALL = 2.0
"""A longer time without an answer counts as this multiple of that average. A board whose planner
is full answers nothing during a long move, then reads the next lines as fast as before.
"""
FASTEST = 1e-3
"""Shortest time between answers that is expected, s."""
QUIET_STATES = ("Idle", "Check", "Alarm")


class LivenessMonitor:
    """Watches answers and reports. Times are seconds of one clock.

    Attributes:
        max_waiting: Lines that may be unanswered: as many as were answered lately in AHEAD s. A
            board with a full planner answers one line for each move. So long moves leave few lines
            in its receive buffer, and short moves as many as fit.
        answered_at: Time of the last answer, s.
        interval: Average time between two answers, s: lately, or over a longer time if that is
            less. A long move does not raise it by much.
    """

    def __init__(self) -> None:
        self.max_waiting = FEWEST_WAITING
        self.interval = self._interval = self._lasting = 0.0
        self._gap, self._read, self._before = 0.0, 0, (0.0, 0.0)
        self.answered_at = self._marked_at = 0.0
        self._quiet_since = 0.0
        self._moved_at = 0.0
        self._reported_at = 0.0
        self._state = ""
        self._position: tuple[float, ...] | None = None

    def begin(self, now: float) -> None:
        """Note that a line is sent after a time without lines."""
        self._gap, self._read = 0.0, 0
        self.answered_at = self._quiet_since = self._moved_at = now

    def answered(self, now: float, count: int = 1) -> None:
        """Note ``count`` answers; those that were read together have the same time."""
        if now > self.answered_at or not self._read:
            self._before = self._interval, self._lasting
            self._gap, self._read = min(now - self.answered_at, LIVENESS_AHEAD), 0
        self._read += count
        interval, (short, long) = self._gap / self._read, self._before
        self._interval = interval + (short - interval) * (1.0 - INTERVAL_WEIGHT) ** self._read
        interval = min(interval, STALL * max(long, FASTEST))
        self._lasting = interval + (long - interval) * (1.0 - LASTING_WEIGHT) ** self._read
        self.interval = min(self._interval, self._lasting)
        self.max_waiting = max(FEWEST_WAITING, int(LIVENESS_AHEAD / max(self._interval, 1e-6)))
        self.answered_at = self._quiet_since = self._moved_at = now

    def reported(self, status: Status, now: float) -> None:
        """Note a status report."""
        self._state, self._reported_at = status.state, now
        if status.state not in QUIET_STATES:
            self._quiet_since = now
        if status.state not in (*QUIET_STATES, "Run"):
            # A held board reads no lines.
            self._marked_at = now
        if status.state != "Run" or status.position != self._position:
            self._moved_at = now
        self._position = status.position

    def marked(self, now: float) -> None:
        """Note that a mark was sent."""
        self._marked_at = now

    def answer_due(self, now: float) -> bool:
        """Return whether a mark should ask for an answer; a busy board is not harmed by it."""
        return now - self.answered_at > MARK_PAUSE

    def fault(self, oldest: SentLine | None, line: int, now: float) -> BoardError | None:
        """Return the fault that missing answers show; None without one.

        Args:
            oldest: The oldest unanswered line.
            line: Source line that was answered last.
            now: Present time.
        """
        seconds = 0.0
        if oldest is not None:
            line, seconds = oldest.line, oldest.seconds
            if (
                oldest.kind == "mark"
                and now - max(self._marked_at, self.answered_at) > MARK_PATIENCE
            ):
                return faults.question_lost(line)
            # GRBL reports nothing while it homes: a report means that it does not home.
            patience = (
                QUIET
                + (seconds if oldest.kind == "dwell" else 0.0)
                + (SPIN_UP if oldest.kind == "spindle" else 0.0)
            )
            if self._reported_at - self._quiet_since > patience:
                return faults.unanswered(line)
        if self._state == "Run" and now - self._moved_at > STUCK + seconds:
            return faults.stuck(STUCK, line)
        return None


MOST_BLOCKS = 128
"""Moves that the planner of a board may hold if it does not report their number."""
AHEAD = 1.5
SPARE_AHEAD = 0.5
"""Seconds of motion that are sent ahead: AHEAD, or SPARE_AHEAD more than the board needs to brake,
whichever is more.
"""
AT_REST = 0.3
"""Seconds of Idle, with every line answered, after which the motion is over: a report may be older
than the last answer.
"""
TRACKED_STATES = ("Run", "Hold", "Idle")
FULL_OVERRIDE = 100


class FaultMonitor:
    """Watches one run.

    Attributes:
        liveness: Finds missing answers.
        tracker: Follows the reported positions along the moves that were sent.
        moves: Whether lines move the machine.
        doubtful: Whether the last report was off the moves, so that another is wanted soon.
    """

    def __init__(self, protocol: GrblProtocol) -> None:
        self.liveness = LivenessMonitor()
        self.tracker = PositionTracker(0, ())
        self.doubtful = False
        self._protocol = protocol
        self._ahead = AHEAD
        self.moves = False
        self._firmware = Firmware.GRBL
        self._without_alarm = False
        self._busy_at = 0.0

    def begin(
        self,
        info: BoardInfo,
        position: Sequence[float],
        offset: Sequence[float],
        now: float,
        *,
        moves: bool,
    ) -> None:
        """Begin a run.

        Args:
            info: Firmware and settings of the board.
            position: Machine position, mm.
            offset: Work offset that the board adds to the numbers of a line, mm.
            now: Present time of listening, s.
            moves: Whether lines move the machine.
        """
        columns = range(len(position))
        steps = max(
            (1.0 / each for column in columns if (each := info.axis(STEPS, column))), default=0.0
        )
        limits = AxisLimits(
            [
                per_second(rate) if (rate := info.axis(RATES, column)) else math.inf
                for column in columns
            ],
            [info.axis(ACCELERATIONS, column) or math.inf for column in columns],
        )
        tolerance = TOLERANCE + (info.number(ARC_TOLERANCE) or 0.0) + 2.0 * steps
        self.tracker = PositionTracker(info.blocks or MOST_BLOCKS, offset, tolerance, limits)
        self.tracker.begin(position)
        self.liveness.begin(now)
        self._ahead = max(AHEAD, SPARE_AHEAD + info.braking_s())
        self.moves = moves
        self._firmware = info.kind
        self._without_alarm = self.doubtful = False
        self._busy_at = now

    def prepare(self, group: LineGroup) -> None:
        """Note lines that will be sent next."""
        if self.moves:
            self.tracker.prepare(group.rows)

    def near(self, most: int, status: Status | None) -> int:
        """Return how many of the next lines the board may have: some motion ahead is enough.

        Args:
            most: Number of lines for which there is space.
            status: The last report.
        """
        if status is None:
            return most
        feed, rapid, _ = status.overrides or (FULL_OVERRIDE, FULL_OVERRIDE, FULL_OVERRIDE)
        return self.tracker.within(self._ahead, most, max(feed, 1), max(rapid, 1))

    def fault_in(self, event: Event, now: float) -> BoardError | None:
        """Return the fault that an event other than Confirmed shows; None without one."""
        line = self._protocol.confirmed_line
        match event:
            case Reported(status, waiting):
                self.liveness.reported(status, now)
                return self._fault_in_status(status, waiting, now)
            case Rejected(sent, reply):
                return faults.refused(reply, sent.text, sent.line or line, self._firmware)
            case Alarmed(code, sent):
                if sent is None or stops_motors(code, self._firmware):
                    return faults.alarmed(code, self.tracker.line or line, self._firmware)
                probing = sent.kind == "probe"
                return faults.alarmed(code, sent.line or line, self._firmware, probing=probing)
            case Started():
                return faults.restarted(line)
            case Lost(after, until):
                return faults.lost(after, until)
            case UnexpectedReply():
                return faults.lost(line, line)
        return None

    def missing_answer(self, now: float) -> BoardError | None:
        """Return the fault that a missing answer shows; None without one."""
        protocol = self._protocol
        if protocol.state is not State.READY:
            return faults.lost(protocol.confirmed_line, protocol.confirmed_line)
        return self.liveness.fault(protocol.oldest, protocol.confirmed_line, now)

    def _fault_in_status(self, status: Status, waiting: int, now: float) -> BoardError | None:
        line = self._protocol.confirmed_line
        if status.state != "Alarm":
            self._without_alarm = True
        elif self._without_alarm:
            if status.phase > 0:
                return faults.alarmed(status.phase, line, self._firmware)
            return faults.alarmed_unheard(line)
        if status.position is None or status.state not in TRACKED_STATES or not self.moves:
            return None
        off = self.tracker.off(status.position, waiting)
        if status.state != "Idle" or waiting:
            self._busy_at = now
        elif not off and now - max(self._busy_at, self.liveness.answered_at) > AT_REST:
            off = self.tracker.arrived(status.position)
        if off and self.doubtful:
            return faults.off_path(status.position, off, self.tracker.line or line)
        # A single report may be wrong: an AVR reads its position while it steps.
        self.doubtful = bool(off)
        return None
