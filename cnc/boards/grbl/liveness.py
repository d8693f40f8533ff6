"""Whether a GRBL board that answers nothing is busy or dead. No I/O.

The status, asked for five times a second, shows the difference:

    unanswered lines and   | status                    | meaning
    -----------------------+---------------------------+----------------------------------------------
    no answer              | Run, the position changes | a long move: the planner is full
    no answer              | Idle, a dwell is due      | the dwell, for its time
    no answer              | Hold, Door                | the machine is held until it is resumed
    no answer              | Idle for 2 s              | a line or an answer was lost
    no answer              | Run for 30 s, no motion   | the board is stuck
"""

from __future__ import annotations

from cnc.boards.grbl import faults
from cnc.boards.grbl.events import SentLine
from cnc.boards.grbl.status import Status
from cnc.model.diagnostics import BoardError

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
AHEAD = 0.5
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
            self._gap, self._read = min(now - self.answered_at, AHEAD), 0
        self._read += count
        each, (short, long) = self._gap / self._read, self._before
        self._interval = each + (short - each) * (1.0 - INTERVAL_WEIGHT) ** self._read
        each = min(each, STALL * max(long, FASTEST))
        self._lasting = each + (long - each) * (1.0 - LASTING_WEIGHT) ** self._read
        self.interval = min(self._interval, self._lasting)
        self.max_waiting = max(FEWEST_WAITING, int(AHEAD / max(self._interval, 1e-6)))
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
