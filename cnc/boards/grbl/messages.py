"""The messages of a GRBL board and the events of its protocol: bytes in, messages out.

Source: "Grbl v1.1 Interface", response and push messages::

ok  error:20                            a reply, one to each line sent        Reply
error:Line too long                     the same of FluidNC                   Reply
ALARM:2                                 the board has stopped by itself       Alarm
Grbl 1.1h ['$' for help]                the board has just started            Welcome
Grbl 3.7 [FluidNC v3.7 (wifi) '$' for help]
<Run|MPos:1.000,2.000,0.000|FS:500,0>   the answer to ``?``                   Report
$110=500.000                            a setting                             Setting
[MSG:Pgm End]  [PRB:1.0,2.0,3.0:1]      all other information                 Feedback
>G54G20:ok                              a start-up line of the board          Other
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Literal, NamedTuple

from cnc.boards.protocols import Condition

ANSWER = b"ok\r\n"
ANSWERS = 1024 * ANSWER
"""More answers than come in one reading."""
LONGEST = 1024
"""Bytes without a line end after which they are dropped as noise."""


class Firmware(Enum):
    """The firmwares, by name. They share the protocol, but not all numbers of errors and alarms."""

    GRBL = "GRBL"
    HAL = "grblHAL"
    FLUID = "FluidNC"


UNNUMBERED = -1
"""Number of an error that FluidNC reports as text (``verbose_errors``)."""


@dataclass(frozen=True, slots=True)
class Reply:
    """The answer to a line.

    Attributes:
        error: 0 for ``ok``; UNNUMBERED where the board sends a text.
        text: That text.
    """

    error: int = 0
    text: str = ""


@dataclass(frozen=True, slots=True)
class Alarm:
    """The board has stopped by itself."""

    code: int


@dataclass(frozen=True, slots=True)
class Welcome:
    """The board has started.

    Attributes:
        version: Such as ``1.1h``.
        firmware: The firmware that greets.
    """

    version: str
    firmware: Firmware


@dataclass(frozen=True, slots=True)
class Report:
    """A status report as text: ``Run|MPos:..|FS:..``."""

    text: str


@dataclass(frozen=True, slots=True)
class Setting:
    """A line of the answer to ``$$``."""

    number: int
    value: str


@dataclass(frozen=True, slots=True)
class Feedback:
    """A line in brackets: ``kind`` (MSG, GC, PRB, VER, ..), and ``text`` after the colon."""

    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class Other:
    """Any other line: the echo of a start-up line, another device, or noise."""

    text: str


Message = Reply | Alarm | Welcome | Report | Setting | Feedback | Other

OK = Reply()

_WELCOME = re.compile(r"(Grbl|GrblHAL) ([0-9]+\.[0-9]+\w*) \[.*help\]$")
_SETTING = re.compile(r"\$([0-9]+)=(.*)")
_NUMBERED = re.compile(r"(error|ALARM):([0-9]{1,3})")
_ERROR_TEXT = re.compile(r"error: ?([A-Za-z$][ -~]*)")


def message(line: str) -> Message:
    """Return the message of a line without its end."""
    if line == "ok":
        return OK
    first = line[:1]
    if first == "<" and line[-1] == ">":
        return Report(line[1:-1])
    if first == "[" and line[-1] == "]":
        kind, _, text = line[1:-1].partition(":")
        return Feedback(kind, text)
    if first == "$" and (match := _SETTING.fullmatch(line)):
        return Setting(int(match[1]), match[2])
    if match := _NUMBERED.fullmatch(line):
        return Reply(int(match[2])) if match[1] == "error" else Alarm(int(match[2]))
    if match := _ERROR_TEXT.fullmatch(line):
        return Reply(UNNUMBERED, match[1])
    # A boot loader may leave bytes on the line before it.
    if match := _WELCOME.search(line):
        hal, fluid = match[1] == "GrblHAL", "[FluidNC " in line
        firmware = Firmware.HAL if hal else Firmware.FLUID if fluid else Firmware.GRBL
        return Welcome(match[2], firmware)
    return Other(line)


class Messages:
    """Assembles messages from bytes as they arrive.

    Attributes:
        partial: The bytes of a message that has not ended yet.
    """

    def __init__(self) -> None:
        self.partial = b""

    def receive(self, data: bytes) -> list[Message]:
        """Return the messages that ``data`` completes, without empty lines."""
        data = self.partial + data
        # At the full rate of the wire nearly all bytes are such answers.
        if data == ANSWERS[: len(data)]:
            count, rest = divmod(len(data), len(ANSWER))
            self.partial = data[len(data) - rest :]
            return [OK] * count
        *lines, last = data.split(b"\n")
        self.partial = last if len(last) <= LONGEST else b""
        stripped = [raw.strip(b"\r\0 ") for raw in lines]
        return [
            OK if line == b"ok" else message(line.decode("latin-1")) for line in stripped if line
        ]


# The status report of GRBL, which is its answer to ``?``.
#
# Source: "Grbl v1.1 Interface", real-time status reports.
#
#     <Idle|WPos:1.000,2.000,0.000|Bf:15,128|FS:0,0|WCO:5.000,0.000,0.000>
#
# State and position are always present. All other fields are optional and come in any order. WCO
# and Ov come at intervals and hold until they come again. Lengths are in inches where ``$13=1``.


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


# Kinds of lines that need a special place in the stream to a GRBL board.
#
# Source: "Grbl v1.1 Interface", EEPROM issues, and its list of commands.

Kind = Literal["plain", "writer", "system", "pause", "dwell", "spindle", "probe", "mark"]

MOST_CHARACTERS = 79
"""Characters of a line without its end: GRBL 1.1 keeps 80 with the final zero."""

ALONE = ("writer", "system")
"""Kinds of lines beside which no other line may be unanswered."""
HOMING_TIME = 300.0
RESTORING_TIME = 5.0
"""Longest time to home the machine, and to write the whole EEPROM, s."""

_REMARK = re.compile(r"\([^)]*\)|;.*|\s+")
_WRITER = re.compile(r"G10(?![0-9.])|G(?:28|30)\.1(?![0-9])")
_PAUSE = re.compile(r"M0*[016](?![0-9.])")
_SPINDLE = re.compile(r"M0*[345789](?![0-9.])")
_PROBE = re.compile(r"G38\.[2-5]")
_DWELL = re.compile(r"G0*4(?![0-9.])")
_SECONDS = re.compile(r"P([0-9.]+)")


def bare(text: str) -> str:
    """Return a line without blanks and remarks, in upper case, as the board reads it."""
    return _REMARK.sub("", text).upper()


def kind_of(text: str) -> Kind:
    """Return the kind of a line.

    A *writer* writes to EEPROM, when the board loses bytes. A *system* command mostly needs a board
    at rest. No other line may be unanswered at the same time as one of these. During a *dwell*, a
    *spindle* or coolant command and a *probe* nothing is answered for a time, during a *pause*
    until the operator resumes. (A *mark* is the protocol's own.)
    """
    line = bare(text)
    if line.startswith("$"):
        return "plain" if line.startswith("$J=") else "writer" if "=" in line else "system"
    if ("G10" in line or ".1" in line) and _WRITER.search(line):
        return "writer"
    if "M" in line:
        if _PAUSE.search(line):
            return "pause"
        if _SPINDLE.search(line):
            return "spindle"
    if "G38" in line and _PROBE.search(line):
        return "probe"
    if "P" in line and _DWELL.search(line):
        return "dwell"
    return "plain"


def seconds_of(text: str) -> float:
    """Return the longest time of a line without reported motion, s.

    A dwell takes its time. Homing takes up to HOMING_TIME, during which GRBL reports nothing.
    """
    line = bare(text)
    if line.startswith("$"):
        return (
            HOMING_TIME
            if line.startswith("$H")
            else RESTORING_TIME
            if line.startswith("$RST")
            else 0.0
        )
    match = _SECONDS.search(line) if _DWELL.search(line) else None
    try:
        return float(match[1]) if match else 0.0
    except ValueError:
        return 0.0


# Events of the protocol of a GRBL board.


class SentLine(NamedTuple):
    """An unanswered line.

    Attributes:
        text: The line.
        line: Its source line.
        kind: Its kind.
        seconds: Longest time that it takes without motion.
    """

    text: str
    line: int
    kind: Kind
    seconds: float = 0.0


@dataclass(slots=True)
class Confirmed:
    """The board accepted ``count`` lines: answers that came together are one event."""

    count: int = 1


@dataclass(frozen=True, slots=True)
class Rejected:
    """The board refused a line."""

    sent: SentLine
    reply: Reply


@dataclass(frozen=True, slots=True)
class Alarmed:
    """The board raised an alarm; ``sent`` is the oldest unanswered line, or None."""

    code: int
    sent: SentLine | None


@dataclass(frozen=True, slots=True)
class Started:
    """The board started; ``expected``: after a reset, or at the beginning."""

    welcome: Welcome
    expected: bool


@dataclass(frozen=True, slots=True)
class Lost:
    """Lines or answers were lost after source line ``after`` and not later than ``until``."""

    after: int
    until: int


@dataclass(frozen=True, slots=True)
class UnexpectedReply:
    """An answer without an unanswered line."""

    code: int


@dataclass(frozen=True, slots=True)
class Reported:
    """The answer to ``?``; ``waiting``: lines that were unanswered when the board gave it."""

    status: Status
    waiting: int = 0


Event = (
    Confirmed
    | Rejected
    | Alarmed
    | Started
    | Lost
    | UnexpectedReply
    | Reported
    | Feedback
    | Setting
    | Other
)
