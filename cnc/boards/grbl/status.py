"""GRBL's status report, the answer to ``?``. Source: "Grbl v1.1 Interface", real-time status
reports.

    <Idle|WPos:1.000,2.000,0.000|Bf:15,128|FS:0,0|WCO:5.000,0.000,0.000>

State and position are always there; every other field may be missing and they come in any order.
WCO and Ov come now and then, and stand until they come again. Positions are in inches where
``$13=1``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

MM_PER_INCH = 25.4

MOVING = frozenset(("Run", "Jog", "Home"))
"""States of a machine in motion (in a dwell it is Idle)."""
STILL_MOVING = frozenset((("Hold", 1), ("Door", 2), ("Door", 3)))
"""On the way to rest, or back: a reset now would lose the position."""
_NUMBERS = re.compile(r"-?[0-9]+\.[0-9]+(?:,-?[0-9]+\.[0-9]+)*")


@dataclass(frozen=True, slots=True)
class Status:
    """Where the board is and what it does, mm and per cent.

    state: Idle, Run, Hold, Jog, Alarm, Door, Check, Home, Sleep (grblHAL: also Tool). phase: the
    number behind it, -1 for none. position: machine position, None as long as it can't be told.
    offset: WCO, machine minus work position. overrides: feed, rapid, spindle. free: planner blocks
    and bytes of the receive buffer that are free, None where the board does not tell. feed: mm/min.
    pins: letters of the inputs that are active.
    """

    state: str
    phase: int = -1
    position: tuple[float, ...] | None = None
    offset: tuple[float, ...] | None = None
    overrides: tuple[int, int, int] | None = None
    free: tuple[int, int] | None = None
    feed: float | None = None
    pins: str = ""

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves: a hold that is complete, and any state that is not motion."""
        return self.state not in MOVING and (self.state, self.phase) not in STILL_MOVING


class StatusReader:
    """Reads reports, and remembers what they do not repeat.

    unit: mm to what the board reports in. axes: how many numbers a position has, 0 as long as that
    is not known.
    """

    def __init__(self) -> None:
        self.unit = 1.0
        self.axes = 0
        self._offset: list[float] | None = None
        self._overrides: tuple[int, int, int] | None = None

    def forget(self) -> None:
        """After a reset: what was remembered may be other now."""
        self._offset = None
        self._overrides = None

    def read(self, text: str) -> Status | None:
        """A report without its brackets; None if it is garbled."""
        head, *parts = text.split("|")
        state, _, phase = head.partition(":")
        if not state.isalpha():
            return None
        try:
            fields = {name: values for name, _, values in (part.partition(":") for part in parts)}
            if "WCO" in fields:
                self._offset = self._numbers(fields["WCO"])
            if "Ov" in fields:
                feed, rapid, spindle = (int(value) for value in fields["Ov"].split(","))
                self._overrides = feed, rapid, spindle
            speed = fields.get("FS", fields.get("F"))
            blocks, bytes_ = (
                (int(value) for value in fields["Bf"].split(",")) if "Bf" in fields else (-1, -1)
            )
            return Status(
                state,
                int(phase) if phase else -1,
                self._position(fields),
                None if self._offset is None else self._lengths(self._offset),
                self._overrides,
                (blocks, bytes_) if "Bf" in fields else None,
                float(speed.split(",")[0]) * self.unit if speed else None,
                fields.get("Pn", ""),
            )
        except ValueError:
            return None

    def _position(self, fields: dict[str, str]) -> tuple[float, ...] | None:
        if "MPos" in fields:
            return self._lengths(self._numbers(fields["MPos"]))
        if "WPos" in fields and self._offset is not None:
            return self._lengths(
                [a + b for a, b in zip(self._numbers(fields["WPos"]), self._offset, strict=True)]
            )
        return None

    def _lengths(self, numbers: Sequence[float]) -> tuple[float, ...]:
        return tuple(number * self.unit for number in numbers)

    def _numbers(self, values: str) -> list[float]:
        """As the board tells them: what is remembered may come before the unit is known. ValueError
        if they are not all there.
        """
        if not _NUMBERS.fullmatch(values):
            raise ValueError(values)
        numbers = [float(value) for value in values.split(",")]
        if self.axes and len(numbers) != self.axes:
            raise ValueError(values)
        return numbers
