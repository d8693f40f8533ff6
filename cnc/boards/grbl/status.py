"""The status report of GRBL, which is its answer to ``?``.

Source: "Grbl v1.1 Interface", real-time status reports.

    <Idle|WPos:1.000,2.000,0.000|Bf:15,128|FS:0,0|WCO:5.000,0.000,0.000>

State and position are always present. All other fields are optional and come in any order. WCO and
Ov come at intervals and hold until they come again. Lengths are in inches where ``$13=1``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from cnc.boards.protocols import Condition

MM_PER_INCH = 25.4

MOVING = frozenset(("Run", "Jog", "Home"))
"""States of a machine in motion (in a dwell it is Idle)."""
WAITING = frozenset(("Hold", "Door", "Tool"))
"""States in which the machine waits for the operator to resume."""
STILL_MOVING = frozenset((("Hold", 1), ("Door", 2), ("Door", 3)))
"""States of braking or resuming, in which a reset would lose the position."""
DOOR_SHUT = 0
"""Phase of state Door: the door is closed, and the board waits for a resume."""
CONDITIONS: dict[str, Condition] = {
    "Idle": "idle",
    "Run": "running",
    "Hold": "held",
    "Jog": "jogging",
    "Home": "homing",
    "Alarm": "alarm",
    "Door": "door",
    "Check": "check",
    "Sleep": "sleep",
    "Tool": "held",
}
INPUTS = {"P": "probe", "D": "door", "H": "hold", "R": "reset", "S": "start"}
"""Names of the inputs by their letters, beside the limit switches."""
SAME_POSITION = 0.002
"""mm: rounding of a reported position or offset, with three decimals, of inches even."""
_NUMBERS = re.compile(r"-?[0-9]+\.[0-9]+(?:,-?[0-9]+\.[0-9]+)*")


@dataclass(frozen=True, slots=True)
class Status:
    """A status report.

    Attributes:
        state: Idle, Run, Hold, Jog, Alarm, Door, Check, Home, Sleep (grblHAL: also Tool).
        phase: The number after the state; -1 for none.
        position: Machine position, mm; None as long as it is not known.
        offset: WCO, machine minus work position, mm.
        overrides: Of feed, rapid and spindle, per cent.
        free: Free planner blocks and bytes of the receive buffer; None where not reported.
        feed: mm/min.
        speed: Spindle speed, rev/min.
        pins: Letters of the active inputs.
    """

    state: str
    phase: int = -1
    position: tuple[float, ...] | None = None
    offset: tuple[float, ...] | None = None
    overrides: tuple[int, int, int] | None = None
    free: tuple[int, int] | None = None
    feed: float | None = None
    speed: float | None = None
    pins: str = ""

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves: a completed hold, or a state without motion."""
        return self.state not in MOVING and (self.state, self.phase) not in STILL_MOVING

    @property
    def locked(self) -> bool:
        """Whether an alarm locks the board."""
        return self.state == "Alarm"

    @property
    def emergency(self) -> bool:
        """Whether the emergency stop of grblHAL is pressed."""
        return self.locked and "E" in self.pins

    @property
    def door(self) -> str:
        """How to go on after the safety door was opened; "" in other states."""
        if self.state != "Door":
            return ""
        if self.phase == DOOR_SHUT and "D" not in self.pins:
            return "the safety door was opened; it is closed now: resume"
        return "the safety door is open: close it, then resume"


class StatusReader:
    """Reads reports, and keeps the fields that they do not repeat.

    Attributes:
        unit: Unit of the reported lengths and feeds in mm.
        rotary: Numbers of the axes that are reported in degrees.
        axes: Numbers in a position; 0 as long as it is not known.
    """

    def __init__(self) -> None:
        self.unit = 1.0
        self.rotary: frozenset[int] = frozenset()
        self.axes = 0
        self._offset: list[float] | None = None
        self._overrides: tuple[int, int, int] | None = None

    def forget(self) -> None:
        """Forget the kept fields after a reset: they may have changed."""
        self._offset = None
        self._overrides = None

    def read(self, text: str) -> Status | None:
        """Return the status in a report without brackets; None if it is damaged."""
        head, *parts = text.split("|")
        state, _, phase = head.partition(":")
        if not state.isalpha():
            return None
        try:
            fields = {name: values for name, _, values in (part.partition(":") for part in parts)}
            if "WCO" in fields:
                self._offset = self._numbers(fields["WCO"])
            if "Ov" in fields:
                first, second, third = (int(value) for value in fields["Ov"].split(","))
                self._overrides = first, second, third
            # grblHAL adds the measured speed where the spindle reports it.
            feed, speed, *_ = [*fields.get("FS", fields.get("F", "")).split(","), ""]
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
                float(feed) * self.unit if feed else None,
                float(speed) if speed else None,
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
        return in_mm(numbers, self.unit, self.rotary)

    def _numbers(self, values: str) -> list[float]:
        """Return the numbers in the unit of the board, which may not be known yet.

        Raises:
            ValueError: Numbers are missing or damaged.
        """
        if not _NUMBERS.fullmatch(values):
            raise ValueError(values)
        numbers = [float(value) for value in values.split(",")]
        if self.axes and len(numbers) != self.axes:
            raise ValueError(values)
        return numbers


def in_mm(numbers: Sequence[float], unit: float, rotary: frozenset[int]) -> tuple[float, ...]:
    """Return a reported position in mm, and in degrees for rotary axes.

    Args:
        numbers: The numbers of the report, one an axis.
        unit: Unit of lengths in the report, mm.
        rotary: Numbers of the rotary axes; the board reports these in degrees in any case.
    """
    return tuple(
        number if column in rotary else number * unit for column, number in enumerate(numbers)
    )
