"""The protocol of a GRBL board, without I/O: bytes in, events out.

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
from collections import deque
from collections.abc import Mapping
from enum import Enum

from cnc.boards.grbl.codes import STARTUP_ALARMS
from cnc.boards.grbl.events import (
    Alarmed,
    Confirmed,
    Event,
    Lost,
    Rejected,
    Reported,
    SentLine,
    Started,
    UnexpectedReply,
    new_sent_line,
)
from cnc.boards.grbl.line_kinds import Kind, bare, kind_of, seconds_of
from cnc.boards.grbl.messages import (
    OK,
    Alarm,
    Feedback,
    Firmware,
    Message,
    Messages,
    Other,
    Reply,
    Report,
    Welcome,
)
from cnc.boards.grbl.status import StatusReader

RX_BYTES = 128
"""Receive buffer of GRBL 1.1 on an AVR; every board has that much."""
ANSWER = b"ok\r\n"
MARK = "$G"
MARK_BYTES = len(MARK) + 1


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
        firmware: The firmware: by its welcome, or by its answers if it is grblHAL that greets as
            GRBL.
        used: Bytes of the unanswered lines.
        unmarked: Number of lines since the last mark.
    """

    def __init__(self) -> None:
        self.state = State.UNKNOWN
        self.rx_bytes = RX_BYTES
        self.status_reader = StatusReader()
        self.confirmed_line = 0
        self._messages = Messages()
        self.used = self.unmarked = 0
        self._unanswered: deque[SentLine] = deque()
        self._marked = self._mark_seen = False
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
        return len(self._unanswered)

    @property
    def oldest(self) -> SentLine | None:
        """The line that is answered next."""
        return self._unanswered[0] if self._unanswered else None

    @property
    def marked(self) -> bool:
        """Whether a mark is unanswered."""
        return self._marked

    @property
    def partial(self) -> bytes:
        """The bytes of a message that has not ended yet."""
        return self._messages.partial

    def fits(self, text: str, kind: Kind | None = None) -> bool:
        """Return whether a line may be sent now.

        Space for a mark is kept free, and one byte of a ring buffer is never filled.

        Args:
            text: The line.
            kind: Its kind, where it is known.
        """
        if self.state is not State.READY:
            return False
        unanswered = self._unanswered
        if not unanswered:
            return True
        # A writer or a system command is unanswered alone, so it is the oldest line.
        if unanswered[0].kind in ("writer", "system") and not unanswered[0].mark:
            return False
        if (kind or kind_of(text)) in ("writer", "system"):
            return False
        return self.used + len(text) + 1 + MARK_BYTES < self.rx_bytes

    def send(self, text: str, line: int, kind: Kind | None = None) -> bytes:
        """Return the bytes of a line that :meth:`fits`."""
        data = self.offer(text, line, kind or kind_of(text))
        if not data:
            raise RuntimeError(f"The line {text!r} does not fit in state {self.state.name}.")
        return data

    def offer(self, text: str, line: int, kind: Kind) -> bytes:
        """Return the bytes of a line, empty if it does not fit now."""
        if not self.fits(text, kind):
            return b""
        if "F" in text or "S" in text or "M" in text:
            self._note_modes(text)
        seconds = seconds_of(text) if kind in ("dwell", "system", "writer") else 0.0
        return self._enter(new_sent_line((text, line, len(text) + 1, kind, seconds, False, None)))

    def mark_fits(self) -> bool:
        """Return whether a mark may be sent: one at a time, without writers or system lines."""
        if (
            self.state is not State.READY
            or self._marked
            or (self._unanswered and self._unanswered[-1].kind in ("writer", "system"))
        ):
            return False
        return self.used + MARK_BYTES < self.rx_bytes

    def mark(self) -> bytes:
        """Return the bytes of a mark that fits."""
        if not self.mark_fits():
            raise RuntimeError(f"A mark does not fit in state {self.state.name}.")
        self._marked, self._mark_seen = True, False
        line = self._unanswered[-1].line if self._unanswered else self.confirmed_line
        return self._enter(
            SentLine(
                MARK, line, MARK_BYTES, "system", mark=True, expected=dict(self._expected_modes)
            )
        )

    def reset(self) -> bytes:
        """Return the soft reset; both sides drop the lines that are not carried out."""
        self.state = State.RESETTING
        self._unanswered.clear()
        self.used = self.unmarked = 0
        self._marked = False
        self._expected_modes.clear()
        self.status_reader.forget()
        return RealTime.RESET.value

    def receive(self, data: bytes) -> list[Event]:
        """Return the events in bytes from the board."""
        count = self._accepted(data)
        if count:
            return [self._confirmed(count)]
        events = [self._event(message) for message in self._messages.receive(data)]
        return [event for event in events if event is not None]

    def _enter(self, sent: SentLine) -> bytes:
        self._unanswered.append(sent)
        self.used += sent.size
        self.unmarked = 0 if sent.mark else self.unmarked + 1
        return sent.text.encode("ascii") + b"\n"

    def _accepted(self, data: bytes) -> int:
        """Return the number of lines that bytes accept; 0 if they may hold anything else.

        At the full rate of the wire nearly all bytes are such answers. Those to the lines before a
        mark are, too.
        """
        count = len(data) // len(ANSWER)
        most = len(self._unanswered)
        if self._marked:
            most -= self.unmarked + 1
        plain = self.state is State.READY and not self._messages.partial
        return count if plain and count <= most and data == ANSWER * count else 0

    def _confirmed(self, count: int) -> Confirmed:
        """Return the event of ``count`` accepted lines, none of which is a mark."""
        self._starting = False
        for _ in range(count):
            sent = self._unanswered.popleft()
            self.used -= sent.size
            self.confirmed_line = sent.line or self.confirmed_line
        return Confirmed(sent, count)

    def _event(self, message: Message) -> Event | None:
        if message is OK or isinstance(message, Reply):
            return self._answered(message) if self.state is State.READY else None
        if isinstance(message, Report):
            status = self.status_reader.read(message.text)
            return Other(f"<{message.text}>") if status is None else Reported(status)
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
        if isinstance(message, Feedback) and message.kind == "GC" and self._marked:
            return self._mark_answered(message.text)
        return message

    def _answered(self, reply: Reply) -> Event | None:
        """Return the event of a reply to the oldest line."""
        self._starting = False
        if not self._unanswered:
            self.state = State.FAILED
            return UnexpectedReply(reply.error)
        sent = self._unanswered.popleft()
        self.used -= sent.size
        self._marked = self._marked and not sent.mark
        if reply.error:
            self.state = State.FAILED
            return Rejected(sent, reply)
        if sent.mark:
            if not self._mark_seen:
                return self._lost(sent.line)
            self._verified_line = sent.line
            return None
        self.confirmed_line = sent.line or self.confirmed_line
        return Confirmed(sent)

    def _mark_answered(self, modes: str) -> Event | None:
        """Return the event of an answer to a mark.

        All lines before it must have been answered, with the feed and speed that were sent.
        Otherwise bytes were lost. grblHAL and FluidNC may also report changed modes unasked, at
        any time; there a lost line shows when the mark is confirmed without an answer.
        """
        oldest = self._unanswered[0]
        if oldest.mark:
            self._mark_seen = True
            reported = dict(_MODE.findall(modes))
            return (
                None
                if self._as_expected(oldest.expected or {}, reported)
                else self._lost(oldest.line)
            )
        if self.firmware is not Firmware.GRBL:
            return None
        return self._lost(next(sent.line for sent in self._unanswered if sent.mark))

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
