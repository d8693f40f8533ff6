"""The operator's requests as real-time commands of GRBL. No I/O.

A byte may get lost (the board loses bytes while it writes to its EEPROM). So each request is
compared with the status reports, and repeated. Where the machine itself holds (a program stop, the
safety door, a button), this becomes a hold of the operator, who resumes at the machine or here.
"""

from __future__ import annotations

from cnc.boards.grbl.protocol import RealTime
from cnc.boards.grbl.status import Status
from cnc.model.operator_control import Control

PATIENCE = 0.5
"""Seconds within which a real-time command must show in the status."""
MIN_OVERRIDE = 10
"""Per cent; GRBL's feed overrides go from 10 to 200."""
LARGE_STEP = 10


class OperatorRequests:
    """Follows the requests of one operator control."""

    def __init__(self, control: Control) -> None:
        self.control = control
        self._held = self._held_by_machine = False
        self._requested_at = -PATIENCE
        self._stepped_at = -PATIENCE
        self._stepped_from = -1

    @property
    def override(self) -> int:
        """The requested feed override, per cent."""
        return max(round(self.control.feed_override), MIN_OVERRIDE)

    def commands(self, status: Status, status_at: float, now: float) -> bytes:
        """Return the bytes to write now; mostly none.

        Args:
            status: The last status report.
            status_at: Time of that report, s.
            now: Present time, s.
        """
        return self._hold(status, status_at, now) + self._step(status, now)

    def _hold(self, status: Status, status_at: float, now: float) -> bytes:
        control = self.control
        if control.held != self._held:
            self._held, self._held_by_machine, self._requested_at = control.held, False, now
            return RealTime.HOLD.value if self._held else RealTime.RESUME.value
        if now - self._requested_at <= PATIENCE or status_at <= self._requested_at:
            return b""
        if status.state in ("Hold", "Door") and not self._held:
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

    def _step(self, status: Status, now: float) -> bytes:
        """Return one step towards the requested feed override.

        Each step has to show in a report before the next, or GRBL may take two for one.
        """
        if status.overrides is None or (
            status.overrides[0] == self._stepped_from and now - self._stepped_at < PATIENCE
        ):
            return b""
        missing = self.override - status.overrides[0]
        if not missing:
            return b""
        self._stepped_from, self._stepped_at = status.overrides[0], now
        large, small = (
            (RealTime.FEED_UP_10, RealTime.FEED_UP_1)
            if missing > 0
            else (RealTime.FEED_DOWN_10, RealTime.FEED_DOWN_1)
        )
        return (large if abs(missing) >= LARGE_STEP else small).value
