"""The protocol of a GRBL board, without I/O: bytes in, events out; groups of unanswered lines.

Sources: "Grbl v1.1 Interface", and grblHAL's where it differs.

Character counting: the board keeps received bytes in a buffer, and answers each line, in order,
when it has taken it out. So the buffer holds at most the bytes of the unanswered lines. As long as
these are fewer than its size, no byte is lost:

    unanswered:   G1X1Y2F500 | G1X3 | $G | G1X5Y1 |     11 + 5 + 3 + 7 bytes with line ends
                      ^ the next ok is for this line

A lost line (or two lines that became one), or a lost answer, would assign every later answer to the
wrong line. An ``ok`` does not name its line, but the answer to ``$G`` can be recognised. So a
*mark* (``$G``) is sent at intervals, and its ``[GC:..]`` must come while the mark is the oldest
unanswered line. A mark costs 3 bytes.

The meaning of a message depends on the state (``-``: it is ignored; an error is answered by a
reset):

    state      | ok, error   | ALARM    | welcome              | reset()
    -----------+-------------+----------+----------------------+----------
    UNKNOWN    | -           | UNKNOWN  | READY                | RESETTING
    READY      | the oldest  | FAILED   | FAILED (it restarted)| RESETTING
    FAILED     | -           | FAILED   | FAILED               | RESETTING
    RESETTING  | -           | RESETTING| READY                | RESETTING

An alarm between the welcome and the first answer that only tells that the board has to be homed or
unlocked (grblHAL: ALARM:11) changes nothing: the board answers, and reports the state Alarm.

In RESETTING an ``ok`` is late: GRBL still answers the line that the reset ended. After an error
GRBL continues with the lines in its buffer, and grblHAL repeats the error for each line until an
empty one. The reset ends both, so answers before it are ignored.
"""

from __future__ import annotations

import re
import sys
from bisect import bisect_right
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from cnc.boards.grbl.faults import STARTUP_ALARMS
from cnc.boards.grbl.messages import (
    ALONE,
    MOST_CHARACTERS,
    OK,
    Alarm,
    Alarmed,
    Confirmed,
    Event,
    Feedback,
    Firmware,
    Kind,
    Lost,
    Message,
    Messages,
    Other,
    Rejected,
    Reply,
    Report,
    Reported,
    SentLine,
    Started,
    StatusReader,
    UnexpectedReply,
    Welcome,
    bare,
    kind_of,
    seconds_of,
)
from cnc.model.line_effects import MOTIONS, LineKind, row_type
from cnc.model.streams import PackedLines

# Groups of lines that are sent to a GRBL board one after the other.
#
# A line for each motion would cost a dozen calls for each of them. So motions that follow each
# other are one group: sending takes a slice of its text. Any other line is a group of its own.

MOST_LINES = 128
"""Lines of a group. More would take a noticeable time before the first of them is sent."""
TIMED = ("dwell", "system", "writer")
"""Kinds of lines whose text tells how long they take."""
FOLLOWING = sorted(MOTIONS - {LineKind.PROBE})
"""Effects of lines that follow each other in a group."""
NO_ROWS = np.empty(0, row_type(3))


@dataclass(frozen=True, slots=True, eq=False)
class LineGroup:
    """Lines of one kind. A group of several lines is ``plain``.

    Attributes:
        kind: Their kind.
        text: Their text, each with its line end.
        ends: Bytes before the first line, and up to the end of each (n + 1,).
        lines: Source line of each (n,).
        rows: Source line and effect of each (n,), see :func:`cnc.model.line_effects.row_type`;
            empty for a line that the driver itself sends at rest.
        seconds: Longest time without motion, s.
    """

    kind: Kind
    text: str
    ends: list[int]
    lines: list[int]
    rows: NDArray[np.void] = field(default_factory=lambda: NO_ROWS)
    seconds: float = 0.0

    def __len__(self) -> int:
        return len(self.lines)

    @property
    def acts(self) -> bool:
        """Whether the lines do more than change modes, and are no command of the board."""
        return self.kind != "system" and bool(self.rows["kind"][0] != LineKind.MODES)

    def part(self, first: int, end: int) -> str:
        """Return the text of some of the lines."""
        return self.text[self.ends[first] : self.ends[end]]


def single(
    text: str, line: int, kind: Kind | None = None, rows: NDArray[np.void] = NO_ROWS
) -> LineGroup:
    """Return a group of one line.

    Args:
        text: The line without its end.
        line: Its source line.
        kind: Its kind, where it is known.
        rows: Its effect.
    """
    kind = kind or kind_of(text)
    seconds = seconds_of(text) if kind in TIMED else 0.0
    return LineGroup(kind, text + "\n", [0, len(text) + 1], [line], rows, seconds)


def groups_of(lines: PackedLines) -> Iterator[LineGroup]:
    """Yield lines in groups. A line that is too long for the board is alone."""
    sizes, rows, text = lines.sizes, lines.rows, lines.text
    follows = np.isin(rows["kind"], FOLLOWING) & (sizes <= MOST_CHARACTERS + 1)
    breaks = np.append(np.flatnonzero(~follows), len(rows)).tolist()
    ends = np.cumsum(np.append(0, sizes))
    first = at = 0
    while first < len(rows):
        if breaks[at] == first:
            end, at = first + 1, at + 1
        else:
            end = min(breaks[at], first + MOST_LINES)
        some, part = rows[first:end], text[ends[first] : ends[end]]
        numbers = some["line"].tolist()
        kind = int(some["kind"][0])
        if kind in FOLLOWING:
            yield LineGroup(
                "plain", part, (ends[first : end + 1] - ends[first]).tolist(), numbers, some
            )
        else:
            kind_of_all: Kind | None = "probe" if kind == LineKind.PROBE else None
            yield single(part[:-1], numbers[0], kind_of_all, some)
        first = end


# The lines that a GRBL board has not answered yet, in the order in which they were sent.


@dataclass(slots=True)
class _Part:
    """Unanswered lines of one group: from number ``first`` up to, but not including, ``end``."""

    group: LineGroup
    first: int
    end: int
    expected: Mapping[str, float] | None = None
    """Of a mark: feed and speed by the lines before it."""

    @property
    def oldest(self) -> SentLine:
        group, first = self.group, self.first
        return SentLine(
            group.part(first, first + 1).rstrip("\n"),
            group.lines[first],
            group.kind,
            group.seconds,
        )


class UnansweredLines:
    """A queue of lines, which are kept as parts of their groups.

    Attributes:
        count: Number of lines.
        bytes: Their size.
        alone: Whether it is a line beside which no other may be unanswered.
    """

    def __init__(self) -> None:
        self._parts: deque[_Part] = deque()
        self.count = self.bytes = 0
        self.alone = False

    @property
    def oldest(self) -> SentLine | None:
        """The line that is answered next."""
        return self._parts[0].oldest if self._parts else None

    @property
    def oldest_group(self) -> LineGroup | None:
        """Its group."""
        return self._parts[0].group if self._parts else None

    @property
    def expected(self) -> Mapping[str, float] | None:
        """Feed and speed at the mark, if that is answered next; else None."""
        return self._parts[0].expected if self._parts else None

    @property
    def newest_line(self) -> int:
        """The source line of the line that was sent last; 0 without an unanswered line."""
        return self._parts[-1].group.lines[self._parts[-1].end - 1] if self._parts else 0

    @property
    def marked_line(self) -> int:
        """The source line of the oldest mark; 0 without a mark."""
        marks = (part.group.lines[0] for part in self._parts if part.expected is not None)
        return next(marks, 0)

    def append(
        self,
        group: LineGroup,
        first: int,
        end: int,
        expected: Mapping[str, float] | None = None,
    ) -> None:
        """Append lines of a group, from ``first`` up to ``end``; ``expected`` is for a mark."""
        self.count += end - first
        self.alone = group.kind in ALONE
        self.bytes += group.ends[end] - group.ends[first]
        last = self._parts[-1] if self._parts else None
        if last is not None and last.group is group:
            last.end = end
        else:
            self._parts.append(_Part(group, first, end, expected))

    def pop(self) -> SentLine:
        """Remove and return the oldest line."""
        sent = self._parts[0].oldest
        self.drop(1)
        return sent

    def drop(self, count: int) -> int:
        """Remove the oldest ``count`` lines; return the source line of the last, or 0."""
        self.count -= count
        line = 0
        while count:
            part = self._parts[0]
            first, end = part.first, min(part.first + count, part.end)
            ends = part.group.ends
            self.bytes -= ends[end] - ends[first]
            count -= end - first
            line = part.group.lines[end - 1] or line
            part.first = end
            if end == part.end:
                self._parts.popleft()
                self.alone = False
        return line

    def clear(self) -> None:
        """Forget all lines."""
        self._parts.clear()
        self.count = self.bytes = 0
        self.alone = False


RX_BYTES = 128
"""Receive buffer of GRBL 1.1 on an AVR; every board has that much."""
MARK = "$G\n"
MARK_BYTES = len(MARK)

ROUNDED = 1.0
"""mm/min, rev/min: the board reports feed and speed as whole numbers."""

_MODE = re.compile(r"([FS])([0-9]+\.?[0-9]*|\.[0-9]+)")
_END = re.compile(r"M0*2(?![0-9.])|M30(?![0-9.])")


class RealTime(bytes, Enum):
    """Commands that the board takes out of the stream at once.

    They use no buffer and get no answer.
    """

    STATUS = b"?"
    HOLD = b"!"
    RESUME = b"~"
    RESET = b"\x18"
    DOOR = b"\x84"
    JOG_CANCEL = b"\x85"
    FEED_100 = b"\x90"
    FEED_UP_10 = b"\x91"
    FEED_DOWN_10 = b"\x92"
    FEED_UP_1 = b"\x93"
    FEED_DOWN_1 = b"\x94"
    RAPID_100 = b"\x95"
    RAPID_50 = b"\x96"
    RAPID_25 = b"\x97"
    SPINDLE_100 = b"\x99"
    SPINDLE_UP_10 = b"\x9a"
    SPINDLE_DOWN_10 = b"\x9b"
    SPINDLE_UP_1 = b"\x9c"
    SPINDLE_DOWN_1 = b"\x9d"


class State(Enum):
    """See the table at the head of this module."""

    UNKNOWN = "unknown"
    READY = "ready"
    FAILED = "failed"
    RESETTING = "resetting"


AFTER_ALARM = {
    State.UNKNOWN: State.UNKNOWN,
    State.READY: State.FAILED,
    State.FAILED: State.FAILED,
    State.RESETTING: State.RESETTING,
}
AFTER_WELCOME = {
    State.UNKNOWN: State.READY,
    State.READY: State.FAILED,
    State.FAILED: State.FAILED,
    State.RESETTING: State.READY,
}


class GrblProtocol:
    """The protocol of one connection.

    The bytes that :meth:`send`, :meth:`mark` and :meth:`reset` return must be written at once, in
    that order.

    Attributes:
        messages: Assembles the messages of the board.
        unanswered: The lines that are not answered.
        firmware: The firmware: by its welcome, or by its answers if it is grblHAL that greets as
            GRBL.
        unmarked: Number of lines since the last mark.
        marked: Whether a mark is unanswered.
    """

    def __init__(self) -> None:
        self.state = State.UNKNOWN
        self.rx_bytes = RX_BYTES
        self.status_reader = StatusReader()
        self.confirmed_line = 0
        self.messages = Messages()
        self.unmarked = 0
        self.unanswered = UnansweredLines()
        self.marked = self._mark_seen = False
        self._verified_line = 0
        self._expected_modes: dict[str, float] = {}
        self.firmware = Firmware.GRBL
        self._starting = False

    def begin_program(self) -> None:
        """Count the lines of another program; the last one's are answered."""
        self.confirmed_line = self._verified_line = 0

    @property
    def waiting(self) -> int:
        """Number of unanswered lines."""
        return self.unanswered.count

    @property
    def used(self) -> int:
        """Bytes of the unanswered lines."""
        return self.unanswered.bytes

    @property
    def oldest(self) -> SentLine | None:
        """The line that is answered next."""
        return self.unanswered.oldest

    @property
    def writer(self) -> LineGroup | None:
        """The line that the board may be writing to its EEPROM now."""
        oldest = self.unanswered.oldest_group
        return oldest if oldest is not None and oldest.kind == "writer" else None

    def room(self, group: LineGroup, first: int = 0, most: int = sys.maxsize) -> int:
        """Return how many lines of a group may be sent now.

        Space for a mark is kept free, and one byte of a ring buffer is never filled. A line of any
        size may be sent where none is unanswered.

        Args:
            group: The group.
            first: Number of its first line that is to be sent.
            most: Limit on the unanswered lines.
        """
        unanswered, ends = self.unanswered, group.ends
        count = unanswered.count
        if self.state is not State.READY or unanswered.alone:
            return 0
        if count and (count >= most or group.kind in ALONE):
            return 0
        free = self.rx_bytes - 1 - MARK_BYTES - unanswered.bytes
        fit = bisect_right(ends, ends[first] + free, first + 1) - 1 - first
        return min(fit, most - count) if fit or count else 1

    def send(self, group: LineGroup, first: int = 0, end: int = 1) -> bytes:
        """Return the bytes of lines of a group for which there is :meth:`room`."""
        ends, unanswered = group.ends, self.unanswered
        used = unanswered.bytes + ends[end] - ends[first] + MARK_BYTES
        full = used >= self.rx_bytes or unanswered.alone or group.kind in ALONE
        if self.state is not State.READY or (full and unanswered.count):
            raise RuntimeError(f"{group.part(first, end)!r} does not fit in {self.state.name}.")
        text = group.text[ends[first] : ends[end]]
        if "F" in text or "S" in text or "M" in text:
            self._note_modes(text)
        unanswered.append(group, first, end)
        self.unmarked += end - first
        return text.encode("ascii")

    def mark_fits(self) -> bool:
        """Return whether a mark may be sent: one at a time, without writers or system lines."""
        if self.state is not State.READY or self.marked or self.unanswered.alone:
            return False
        return self.unanswered.bytes + MARK_BYTES < self.rx_bytes

    def mark(self) -> bytes:
        """Return the bytes of a mark that fits."""
        if not self.mark_fits():
            raise RuntimeError(f"A mark does not fit in state {self.state.name}.")
        self.marked, self._mark_seen = True, False
        line = self.unanswered.newest_line or self.confirmed_line
        mark = LineGroup("mark", MARK, [0, MARK_BYTES], [line])
        self.unanswered.append(mark, 0, 1, dict(self._expected_modes))
        self.unmarked = 0
        return MARK.encode("ascii")

    def reset(self) -> bytes:
        """Return the soft reset; both sides drop the lines that are not carried out."""
        self.state = State.RESETTING
        self.unanswered.clear()
        self.unmarked = 0
        self.marked = False
        self._expected_modes.clear()
        self.status_reader.forget()
        return RealTime.RESET.value

    def receive(self, data: bytes) -> list[Event]:
        """Return the events in bytes from the board."""
        events: list[Event] = []
        accepted = 0
        for message in self.messages.receive(data):
            if message is OK:
                accepted += 1
                continue
            if accepted:
                events += self._accepted(accepted)
                accepted = 0
            event = self._event(message)
            if event is not None:
                events.append(event)
        return events + self._accepted(accepted) if accepted else events

    def _accepted(self, count: int) -> list[Event]:
        """Return the events of ``count`` answers that follow each other, without an error."""
        events: list[Event] = []
        unanswered = self.unanswered
        while count and self.state is State.READY:
            # The answer to a mark is checked.
            plain = unanswered.count - (self.unmarked + 1 if self.marked else 0)
            if plain > 0:
                some = min(count, plain)
                self._starting = False
                self.confirmed_line = unanswered.drop(some) or self.confirmed_line
                events.append(Confirmed(some))
                count -= some
            else:
                event = self._answered(OK)
                count -= 1
                if event is not None:
                    events.append(event)
        return events

    def _event(self, message: Message) -> Event | None:
        if isinstance(message, Reply):
            return self._answered(message) if self.state is State.READY else None
        if isinstance(message, Report):
            status = self.status_reader.read(message.text)
            return Other(f"<{message.text}>") if status is None else Reported(status, self.waiting)
        if isinstance(message, Alarm):
            if self._starting and message.code in STARTUP_ALARMS[self.firmware]:
                return Feedback("ALARM", str(message.code))
            self.state = AFTER_ALARM[self.state]
            return Alarmed(message.code, self.oldest)
        if isinstance(message, Welcome):
            self._starting = True
            if message.firmware is not Firmware.GRBL:
                self.firmware = message.firmware
            expected = self.state is not State.READY
            self.state = AFTER_WELCOME[self.state]
            return Started(message, expected)
        if isinstance(message, Feedback) and message.kind == "GC" and self.marked:
            return self._mark_answered(message.text)
        return message

    def _answered(self, reply: Reply) -> Event | None:
        """Return the event of a reply to the oldest line."""
        self._starting = False
        if not self.unanswered.count:
            self.state = State.FAILED
            return UnexpectedReply(reply.error)
        sent = self.unanswered.pop()
        self.marked = self.marked and sent.kind != "mark"
        if reply.error:
            self.state = State.FAILED
            return Rejected(sent, reply)
        if sent.kind == "mark":
            if not self._mark_seen:
                return self._lost(sent.line)
            self._verified_line = sent.line
            return None
        self.confirmed_line = sent.line or self.confirmed_line
        return Confirmed()

    def _mark_answered(self, modes: str) -> Event | None:
        """Return the event of an answer to a mark.

        All lines before it must have been answered, with the feed and speed that were sent.
        Otherwise bytes were lost. grblHAL and FluidNC may also report changed modes unasked, at
        any time; there a lost line shows when the mark is confirmed without an answer.
        """
        expected = self.unanswered.expected
        if expected is not None:
            self._mark_seen = True
            if self._as_expected(expected, dict(_MODE.findall(modes))):
                return None
            return self._lost(self.unanswered.marked_line)
        if self.firmware is not Firmware.GRBL:
            return None
        return self._lost(self.unanswered.marked_line)

    def _as_expected(self, expected: Mapping[str, float], reported: Mapping[str, str]) -> bool:
        """Return whether feed and speed are as sent; the feed may be in inches, not on FluidNC."""
        unit = 1.0 if self.firmware is Firmware.FLUID else self.status_reader.unit
        for letter, value in expected.items():
            scale = unit if letter == "F" else 1.0
            if (
                letter in reported
                and abs(float(reported[letter]) * scale - value) > ROUNDED * scale
            ):
                return False
        return True

    def _note_modes(self, text: str) -> None:
        """Note feed and speed of a line; at the end of a program they are unknown."""
        line = bare(text)
        if "M" in line and _END.search(line):
            self._expected_modes.clear()
        elif not line.startswith("$"):
            # The F of a jog ($J=) is not modal.
            self._expected_modes.update(
                (letter, float(value)) for letter, value in _MODE.findall(line)
            )

    def _lost(self, until: int) -> Lost:
        self.state = State.FAILED
        return Lost(self._verified_line, until)


# The time that the serial wire takes for the bytes that were written.

BITS_PER_BYTE = 10
"""Start bit, eight data bits, stop bit."""
USUAL_BAUD = 115200
"""bit/s: the speed of GRBL 1.1."""


class WireTime:
    """Follows the bytes on the wire to the board.

    A computer takes bytes at once, and sends them at the speed of the wire.

    Args:
        baud: Speed of the wire, bit/s.

    Attributes:
        byte_time: Time of a byte, s.
        idle_from: Time from which on the wire is idle, s.
    """

    def __init__(self, baud: int = USUAL_BAUD) -> None:
        self.byte_time = BITS_PER_BYTE / baud
        self.idle_from = 0.0

    def written(self, count: int, now: float) -> None:
        """Note that ``count`` bytes were written at a time, s."""
        self.idle_from = max(self.idle_from, now) + count * self.byte_time
