"""The operator's requests as real-time commands of GRBL. No I/O.

A byte may get lost (the board loses bytes while it writes to its EEPROM). So each request is
compared with the status reports, and repeated. Where the machine itself holds (a program stop, a
tool change, the safety door, a button), this becomes a hold of the operator, who resumes at the
machine or here.

A board that brakes ignores a resume. So it is sent when a report shows that the machine rests.
"""

from __future__ import annotations

from typing import NamedTuple

from cnc.boards.grbl.protocol import RealTime
from cnc.boards.grbl.status import WAITING, Status
from cnc.model.operator_control import Control

PATIENCE = 0.5
"""Seconds within which a real-time command must show in the status."""
MIN_OVERRIDE = 10
"""Per cent; GRBL's feed overrides go from 10 to 200."""
LARGE_STEP = 10
FEED, RAPID, SPINDLE = range(3)
"""Columns of the overrides in a status report."""
RAPIDS = {25: RealTime.RAPID_25, 50: RealTime.RAPID_50, 100: RealTime.RAPID_100}
STEPS = {
    FEED: (
        RealTime.FEED_UP_10,
        RealTime.FEED_UP_1,
        RealTime.FEED_DOWN_10,
        RealTime.FEED_DOWN_1,
    ),
    SPINDLE: (
        RealTime.SPINDLE_UP_10,
        RealTime.SPINDLE_UP_1,
        RealTime.SPINDLE_DOWN_10,
        RealTime.SPINDLE_DOWN_1,
    ),
}


class Stepped(NamedTuple):
    """The last step of an override: its time in s, and the reported value before it, per cent."""

    time: float
    present: int


class OperatorRequests:
    """Follows the requests of one operator control."""

    def __init__(self, control: Control) -> None:
        self.control = control
        self._held = self._held_by_machine = False
        self._requested_at = -PATIENCE
        self._seen: tuple[object, ...] = ()
        self._steps = {column: Stepped(-PATIENCE, -1) for column in (FEED, RAPID, SPINDLE)}

    @property
    def override(self) -> int:
        """The requested feed override, per cent."""
        return max(round(self.control.feed_override), MIN_OVERRIDE)

    def commands(self, status: Status, status_at: float, now: float) -> bytes:
        """Return the bytes to write now; mostly none.

        There are some only after a new report or a new request.

        Args:
            status: The last status report.
            status_at: Time of that report, s.
            now: Present time, s.
        """
        control = self.control
        seen = (status_at, control.requested)
        if seen == self._seen:
            return b""
        self._seen = seen
        return (
            self._hold(status, status_at, now)
            + self._step(status, now, FEED, self.override)
            + self._step(status, now, RAPID, self.control.rapid_override)
            + self._step(status, now, SPINDLE, round(self.control.spindle_override))
        )

    def _hold(self, status: Status, status_at: float, now: float) -> bytes:
        control = self.control
        if control.held != self._held:
            if self._held and self._braking(status, status_at):
                return b""
            self._held, self._held_by_machine, self._requested_at = control.held, False, now
            return RealTime.HOLD.value if self._held else RealTime.RESUME.value
        if now - self._requested_at <= PATIENCE or status_at <= self._requested_at:
            return b""
        if status.state in WAITING and not self._held:
            self._held = self._held_by_machine = True
            control.hold()
        elif status.state in ("Run", "Jog") and self._held:
            self._requested_at = now
            if not self._held_by_machine:
                return RealTime.HOLD.value
            # The operator has resumed at the machine.
            self._held = self._held_by_machine = False
            control.resume()
        return b""

    def _braking(self, status: Status, status_at: float) -> bool:
        """Return whether a hold is not complete, by a report that may be older than the hold."""
        if status.state not in WAITING:
            return status_at - self._requested_at <= PATIENCE
        return status_at <= self._requested_at or not status.at_rest

    def reached(self, status: Status) -> bool:
        """Return whether the board has all requested overrides."""
        return status.overrides == (
            self.override,
            self.control.rapid_override,
            round(self.control.spindle_override),
        )

    def _step(self, status: Status, now: float, column: int, wanted: int) -> bytes:
        """Return one step towards a requested override.

        Each step has to show in a report before the next, or GRBL may take two for one.
        """
        last = self._steps[column]
        if status.overrides is None:
            return b""
        present = status.overrides[column]
        if present == wanted or (present == last.present and now - last.time < PATIENCE):
            return b""
        self._steps[column] = Stepped(now, present)
        if column == RAPID:
            return RAPIDS[wanted].value
        up_large, up_small, down_large, down_small = STEPS[column]
        missing = wanted - present
        large, small = (up_large, up_small) if missing > 0 else (down_large, down_small)
        return (large if abs(missing) >= LARGE_STEP else small).value
