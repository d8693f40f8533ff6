"""Whether a GRBL board that answers nothing is busy or dead, and how much to have waiting for it.
No I/O: it is told what happens.

What tells one from the other is the status, asked for five times a second:

    unanswered lines and   | status                    | meaning
    -----------------------+---------------------------+----------------------------------------------
    nothing answered       | Run, the position changes | a long move: the planner is full
    nothing answered       | Idle, a dwell is due      | the dwell, for as long as it takes
    nothing answered       | Hold, Door                | somebody holds the machine: until it goes on
    nothing answered       | Idle for 2 s              | a line or an answer was lost
    nothing answered       | Run for 30 s, no motion   | stuck
"""

from __future__ import annotations

from cnc.boards.grbl import faults
from cnc.boards.grbl.protocol import SentLine
from cnc.boards.grbl.status import Status
from cnc.model.diagnostics import BoardError

QUIET = 2.0
"""Seconds of an idle board with unanswered lines after which one is lost."""
SPIN_UP = 20.0
"""The same while the spindle starts: grblHAL may wait for its speed."""
STUCK = 30.0
"""Seconds in which a board that says Run has to move by what it can report."""
MARK_PAUSE = 0.5
"""Seconds without an answer after which a mark asks whether there is one to come."""
MARK_PATIENCE = 1.5
"""Seconds for the answer to a mark that nothing stands before: the board reads it at once, however
full its planner is.
"""
AHEAD = 0.5
"""Seconds for which lines wait in the receive buffer, beside what the planner holds: more would
only be late in the case of a fault.
"""
FEWEST_WAITING = 1
PACE_SHARE = 0.3
"""What the last line counts for in the pace at which lines are taken."""
QUIET_STATES = ("Idle", "Check", "Alarm")


class LivenessMonitor:
    """Signs of life. Times are seconds of one clock.

    max_waiting: how many lines may wait unanswered: as many as were taken lately in AHEAD s. A
    board whose planner is full takes them one a move, so long moves leave few lines in its receive
    buffer, and short ones as many as fit.
    """

    def __init__(self) -> None:
        self.max_waiting = FEWEST_WAITING
        self._pace = 0.0
        self._answered_at = self._marked_at = 0.0
        self._quiet_since = 0.0
        self._moved_at = 0.0
        self._reported_at = 0.0
        self._state = ""
        self._position: tuple[float, ...] | None = None

    def begin(self, now: float) -> None:
        """The first line after a while goes out."""
        self._answered_at = self._quiet_since = self._moved_at = now

    def answered(self, now: float) -> None:
        """A line was taken."""
        self._pace += PACE_SHARE * (min(now - self._answered_at, AHEAD) - self._pace)
        self.max_waiting = max(FEWEST_WAITING, int(AHEAD / max(self._pace, 1e-6)))
        self._answered_at = self._quiet_since = self._moved_at = now

    def reported(self, status: Status, now: float) -> None:
        """The board told its state."""
        self._state, self._reported_at = status.state, now
        if status.state not in QUIET_STATES:
            self._quiet_since = now
        if status.state not in (*QUIET_STATES, "Run"):
            # Held, a board reads nothing.
            self._marked_at = now
        if status.state != "Run" or status.position != self._position:
            self._moved_at = now
        self._position = status.position

    def marked(self, now: float) -> None:
        """A mark was sent."""
        self._marked_at = now

    def doubtful(self, now: float) -> bool:
        """Whether a mark should ask for an answer: one is due, and has not come for a while. To a
        busy board it does no harm.
        """
        return now - self._answered_at > MARK_PAUSE

    def verdict(self, oldest: SentLine | None, line: int, now: float) -> BoardError | None:
        """What is wrong, as far as the oldest unanswered line tells; ``line``: the source line that
        was answered last.
        """
        seconds = 0.0
        if oldest is not None:
            line, seconds = oldest.line, oldest.seconds
            if oldest.mark and now - max(self._marked_at, self._answered_at) > MARK_PATIENCE:
                return faults.question_lost(line)
            # While it homes GRBL reports nothing: if it reports, it does not.
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
