"""What is wrong with a GRBL board, by what it answers and reports. No I/O: it is told, and says
what the fault is.

what the board says                        | what watches it                          | found within
-------------------------------------------+------------------------------------------+--------------------------------------
error, ALARM, a welcome, an ok too many    | this room, as they come                  | at once
ok, one by one                             | marks (:mod:`cnc.boards.grbl.protocol`) | half a second and a move
nothing, or only what it does              | :mod:`cnc.boards.grbl.liveness`            | 2 s
where it is                                | :mod:`cnc.boards.grbl.position_tracker`             | the motion ahead (1.5 s), two reports
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from cnc.boards.grbl import faults
from cnc.boards.grbl.liveness import LivenessMonitor
from cnc.boards.grbl.position_tracker import TOLERANCE, PositionTracker
from cnc.boards.grbl.protocol import (
    Alarmed,
    Confirmed,
    Event,
    GrblProtocol,
    Lost,
    Rejected,
    Reported,
    Started,
    State,
    UnexpectedReply,
)
from cnc.boards.grbl.settings import ACCELERATIONS, ARC_TOLERANCE, RATES, STEPS, BoardInfo
from cnc.boards.grbl.status import Status
from cnc.boards.grbl.tracked_moves import AxisLimits
from cnc.model.diagnostics import BoardError
from cnc.model.streams import GcodeLine

MOST_BLOCKS = 128
"""Moves that the planner of a board may hold which does not tell."""
AHEAD = 1.5
LOOK_AHEAD = 0.5
"""Seconds of motion that the board is given ahead: AHEAD, but LOOK_AHEAD more than it needs to
brake, so that it need not.
"""
AT_REST = 0.3
"""Seconds of Idle, with every line answered, after which the motion is over: a report may be older
than the last answer.
"""
FOLLOWED = ("Run", "Hold", "Idle")
NORMAL = 100


class FaultMonitor:
    """Watches one run.

    vital: signs of life. way: the moves that the board has been sent. doubtful: whether a report
    was off the way, so that another is wanted soon.
    """

    def __init__(self, protocol: GrblProtocol) -> None:
        self.vital = LivenessMonitor()
        self.way = PositionTracker(0, ())
        self.doubtful = False
        self._protocol = protocol
        self._ahead = AHEAD
        self._moves = False
        self._hal = False
        self._sound = False
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
        """A run begins here, mm; ``offset``: what the board adds to the numbers of a line.
        ``moves``: whether lines move anything.
        """
        columns = range(len(position))
        steps = max(
            (1.0 / each for column in columns if (each := info.axis(STEPS, column))), default=0.0
        )
        limits = AxisLimits(
            [rate / 60.0 if (rate := info.axis(RATES, column)) else math.inf for column in columns],
            [info.axis(ACCELERATIONS, column) or math.inf for column in columns],
        )
        tolerance = TOLERANCE + (info.number(ARC_TOLERANCE) or 0.0) + 2.0 * steps
        self.way = PositionTracker(info.blocks or MOST_BLOCKS, offset, tolerance, limits)
        self.way.begin(position)
        self.vital.begin(now)
        self._ahead = max(AHEAD, LOOK_AHEAD + info.braking_s())
        self._moves = moves
        self._hal = info.hal
        self._sound = self.doubtful = False
        self._busy_at = now

    def sending(self, line: GcodeLine, now: float) -> None:
        """A line goes out."""
        if not self._protocol.waiting:
            self.vital.begin(now)
        if self._moves:
            self.way.send(line)

    def far_ahead(self, status: Status) -> bool:
        """Whether the board has motion enough ahead of it for now."""
        if not self.way.lines:
            return False
        feed, rapid, _ = status.overrides or (NORMAL, NORMAL, NORMAL)
        return self.way.seconds_at(max(feed, 1), max(rapid, 1)) > self._ahead

    def told(self, event: Event, now: float) -> BoardError | None:
        """What the board said; what is wrong with that."""
        line = self._protocol.confirmed_line
        if isinstance(event, Confirmed):
            self._busy_at = now
            self.vital.answered(now)
        elif isinstance(event, Reported):
            self.vital.reported(event.status, now)
            return self._reported(event.status, now)
        elif isinstance(event, Rejected):
            return faults.refused(
                event.code, event.sent.text, event.sent.line or line, hal=self._hal
            )
        elif isinstance(event, Alarmed):
            sent = event.sent
            probing = sent is not None and sent.kind == "probe"
            return faults.alarmed(
                event.code,
                sent.line if sent is not None and sent.line else line,
                hal=self._hal,
                probing=probing,
            )
        elif isinstance(event, Started):
            return faults.restarted(line)
        elif isinstance(event, Lost):
            return faults.lost(event.after, event.until)
        elif isinstance(event, UnexpectedReply):
            return faults.lost(line, line)
        return None

    def verdict(self, now: float) -> BoardError | None:
        """What is wrong with what the board does not say."""
        protocol = self._protocol
        if protocol.state is not State.READY:
            return faults.lost(protocol.confirmed_line, protocol.confirmed_line)
        return self.vital.verdict(protocol.oldest, protocol.confirmed_line, now)

    def _reported(self, status: Status, now: float) -> BoardError | None:
        if status.state != "Alarm":
            self._sound = True
        elif self._sound:
            if status.phase > 0:
                return faults.alarmed(status.phase, self._protocol.confirmed_line, hal=self._hal)
            return faults.alarmed_unheard(self._protocol.confirmed_line)
        if status.position is None or status.state not in FOLLOWED or not self._moves:
            return None
        waiting = self._protocol.waiting
        off = self.way.off(status.position, waiting)
        if status.state != "Idle" or waiting:
            self._busy_at = now
        elif not off and now - self._busy_at > AT_REST:
            off = self.way.arrived(status.position)
        if off and self.doubtful:
            return faults.off_path(
                status.position, off, self.way.line or self._protocol.confirmed_line
            )
        # One report may be wrong: an AVR reads its position while it steps.
        self.doubtful = bool(off)
        return None
