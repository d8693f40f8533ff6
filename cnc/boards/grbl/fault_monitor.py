"""Faults of a GRBL board, found from its answers and reports. No I/O.

answer or report               | found by         | found within
-------------------------------+------------------+--------------------------------------
error, ALARM, welcome, extra ok| this module      | at once
ok, one by one                 | marks (protocol) | half a second and a move
none, or status reports only   | liveness         | 2 s
position                       | position_tracker | the motion ahead (1.5 s), two reports

A report is judged at its place among the answers. All times are times of listening (see
:attr:`~cnc.boards.grbl.link.GrblLink.listened`): a computer that pauses finds reports and answers
that are old, and misses none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from cnc.boards.grbl import faults
from cnc.boards.grbl.codes import stops_motors
from cnc.boards.grbl.events import (
    Alarmed,
    Event,
    Lost,
    Rejected,
    Reported,
    Started,
    UnexpectedReply,
)
from cnc.boards.grbl.line_groups import LineGroup
from cnc.boards.grbl.liveness import LivenessMonitor
from cnc.boards.grbl.messages import Firmware
from cnc.boards.grbl.position_tracker import TOLERANCE, PositionTracker
from cnc.boards.grbl.protocol import GrblProtocol, State
from cnc.boards.grbl.settings import ACCELERATIONS, ARC_TOLERANCE, RATES, STEPS, BoardInfo
from cnc.boards.grbl.status import Status
from cnc.boards.grbl.tracked_moves import AxisLimits
from cnc.model.diagnostics import BoardError
from cnc.model.units import per_second

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
