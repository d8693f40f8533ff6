"""The messages of a GRBL board: bytes in, messages out.

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
from dataclasses import dataclass
from enum import Enum

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
    if first == "$" and (found := _SETTING.fullmatch(line)):
        return Setting(int(found[1]), found[2])
    if found := _NUMBERED.fullmatch(line):
        return Reply(int(found[2])) if found[1] == "error" else Alarm(int(found[2]))
    if found := _ERROR_TEXT.fullmatch(line):
        return Reply(UNNUMBERED, found[1])
    # A boot loader may leave bytes on the line before it.
    if found := _WELCOME.search(line):
        hal, fluid = found[1] == "GrblHAL", "[FluidNC " in line
        firmware = Firmware.HAL if hal else Firmware.FLUID if fluid else Firmware.GRBL
        return Welcome(found[2], firmware)
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
