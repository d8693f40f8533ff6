"""The operator's requests as GRBL's real-time commands. No I/O: it is shown what the board reports,
and says what to write.

A byte may get lost (while the board writes to its EEPROM it hears nothing), so what was wished for
is compared with what is reported, and said again. Where the machine itself holds (a program stop,
the safety door, a button), that becomes the operator's hold: he says when it goes on, here or
there.
"""

from __future__ import annotations

from cnc.boards.grbl.protocol import RealTime
from cnc.boards.grbl.status import Status
from cnc.model.operator_control import Control

WISH = 0.5
"""Seconds that a real-time command may take to show in the status."""
MIN_OVERRIDE = 10
"""Per cent; GRBL's feed overrides go from 10 to 200."""
TEN = 10


class OperatorRequests:
    """Follows a control."""

    def __init__(self, control: Control) -> None:
        self.control = control
        self._held = self._held_there = False
        self._wished_at = -WISH
        self._stepped_at = -WISH
        self._stepped_from = -1

    @property
    def override(self) -> int:
        """Per cent that the board should have."""
        return max(round(self.control.feed_override), MIN_OVERRIDE)

    def commands(self, status: Status, status_at: float, now: float) -> bytes:
        """What to write: nothing, most of the time. ``status_at``: when the status was reported."""
        return self._hold(status, status_at, now) + self._step(status, now)

    def _hold(self, status: Status, status_at: float, now: float) -> bytes:
        control = self.control
        if control.held != self._held:
            self._held, self._held_there, self._wished_at = control.held, False, now
            return RealTime.HOLD.value if self._held else RealTime.RESUME.value
        if now - self._wished_at <= WISH or status_at <= self._wished_at:
            return b""
        if status.state in ("Hold", "Door") and not self._held:
            self._held = self._held_there = True
            control.hold()
        elif status.state in ("Run", "Jog") and self._held:
            self._wished_at = now
            if not self._held_there:
                return RealTime.HOLD.value
            # He has said at the machine that it goes on.
            self._held = self._held_there = False
            control.resume()
        return b""

    def _step(self, status: Status, now: float) -> bytes:
        """One step towards the feed override that is wished for; each has to show before the next,
        or GRBL may take two for one.
        """
        if status.overrides is None or (
            status.overrides[0] == self._stepped_from and now - self._stepped_at < WISH
        ):
            return b""
        missing = self.override - status.overrides[0]
        if not missing:
            return b""
        self._stepped_from, self._stepped_at = status.overrides[0], now
        ten, one = (
            (RealTime.FEED_UP_10, RealTime.FEED_UP_1)
            if missing > 0
            else (RealTime.FEED_DOWN_10, RealTime.FEED_DOWN_1)
        )
        return (ten if abs(missing) >= TEN else one).value
