"""The conversation with a GRBL board, without any I/O: bytes in, events out. Sources: "Grbl v1.1
Interface"; grblHAL's, where it differs.

Character counting: the board keeps what it is sent in a receive buffer until it gets round to it,
and answers each line, in order, when it has taken it out. So the bytes of the lines that are not
answered yet are the most that the buffer can hold, and as long as they are fewer than its size
nothing is ever lost:

    sent, unanswered:   G1X1Y2F500 | G1X3 | $G | G1X5Y1 |     a line end is one byte: 11 + 5 + 3 + 7 bytes
                            ^ the next ok is for this one

A line lost on the way (or two that became one), or a lost answer, would put every later answer at
the wrong line. Nothing in an ``ok`` says which line it means, but the answer to ``$G`` says that it
is that: a *mark* is sent along now and then, and its ``[GC:..]`` has to come when the mark is the
oldest unanswered line. Marks cost 3 bytes.

A state says what a message means (``-``: nothing; an error goes on to be answered by a reset):

    state      | ok, error   | ALARM    | welcome              | reset()
    -----------+-------------+----------+----------------------+----------
    UNKNOWN    | -           | UNKNOWN  | READY                | RESETTING
    READY      | the oldest  | FAILED   | FAILED (it restarted)| RESETTING
    FAILED     | -           | FAILED   | FAILED               | RESETTING
    RESETTING  | -           | RESETTING| READY                | RESETTING

In RESETTING an ``ok`` is a late one: GRBL still answers the line that the reset broke off. After an
error GRBL goes on with what its buffer holds, and grblHAL repeats the error to each line until an
empty one: both end with the reset, so what they answer until then is nothing.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from cnc.boards.grbl.lines import Kind, bare, kind_of, seconds_of
from cnc.boards.grbl.messages import (
    OK,
    Alarm,
    Feedback,
    Message,
    Messages,
    Other,
    Reply,
    Report,
    Setting,
    Welcome,
)
from cnc.boards.grbl.status import Status, StatusReader

RX_BYTES = 128
"""Receive buffer of GRBL 1.1 on an AVR; every board has that much."""
MARK = "$G"
MARK_BYTES = len(MARK) + 1


ROUNDED = 1.0
"""mm/min, rev/min: the board tells feed and speed in whole numbers."""

_MODE = re.compile(r"([FS])([0-9]+\.?[0-9]*|\.[0-9]+)")
_END = re.compile(r"M0*2(?![0-9.])|M30(?![0-9.])")


class RealTime(bytes, Enum):
    """CommandLines that the board takes out of the stream as they arrive: they need no room and get no
    answer.
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
    """See the table above."""

    UNKNOWN = "unknown"
    READY = "ready"
    FAILED = "failed"
    RESETTING = "resetting"


@dataclass(slots=True)
class SentLine:
    """A line on its way.

    line: its source line. size: bytes, with the line end. seconds: what it may take while nothing
    moves. Of a mark: ``said`` are feed and speed as the lines before it set them, ``seen`` whether
    the board has told its own.
    """

    text: str
    line: int
    size: int
    kind: Kind
    seconds: float = 0.0
    mark: bool = False
    seen: bool = False
    said: Mapping[str, float] | None = None


@dataclass(frozen=True, slots=True)
class Confirmed:
    """A line was taken."""

    sent: SentLine


@dataclass(frozen=True, slots=True)
class Rejected:
    """A line was refused."""

    sent: SentLine
    code: int


@dataclass(frozen=True, slots=True)
class Alarmed:
    """The board raised an alarm; ``sent`` is the oldest unanswered line, None if all were
    answered.
    """

    code: int
    sent: SentLine | None


@dataclass(frozen=True, slots=True)
class Started:
    """The board started; ``expected``: because it was told to, or at the beginning."""

    welcome: Welcome
    expected: bool


@dataclass(frozen=True, slots=True)
class Lost:
    """Lines or answers got lost after source line ``after`` and not later than at ``until``."""

    after: int
    until: int


@dataclass(frozen=True, slots=True)
class UnexpectedReply:
    """An answer to nothing."""

    code: int


@dataclass(frozen=True, slots=True)
class Reported:
    """The answer to ``?``."""

    status: Status


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
    """One conversation. What :meth:`send`, :meth:`mark` and :meth:`reset` return has to be written
    at once, in that order.
    """

    def __init__(self) -> None:
        self.state = State.UNKNOWN
        self.rx_bytes = RX_BYTES
        self.status_reader = StatusReader()
        self.confirmed_line = 0
        self._messages = Messages()
        self._ledger: deque[SentLine] = deque()
        self._used = 0
        self._marks = 0
        self._since_mark = 0
        self._verified_line = 0
        self._said: dict[str, float] = {}

    @property
    def waiting(self) -> int:
        """Lines that are not answered yet."""
        return len(self._ledger)

    @property
    def used(self) -> int:
        """Bytes of the lines that are not answered yet."""
        return self._used

    @property
    def oldest(self) -> SentLine | None:
        """The line that the next answer is for."""
        return self._ledger[0] if self._ledger else None

    @property
    def marked(self) -> bool:
        """Whether a mark is under way."""
        return self._marks > 0

    @property
    def partial(self) -> bytes:
        """What has arrived of a message that has not ended."""
        return self._messages.partial

    def room(self, text: str, kind: Kind | None = None) -> bool:
        """Whether a line, of a ``kind`` if that is known, may be sent now.

        TravelMargin for a mark always stays; one place of a ring buffer is never filled.
        """
        if self.state is not State.READY:
            return False
        ledger = self._ledger
        if not ledger:
            return True
        # A writer or a system command is under way alone, so it is the oldest.
        if ledger[0].kind in ("writer", "system") and not ledger[0].mark:
            return False
        if (kind or kind_of(text)) in ("writer", "system"):
            return False
        return self._used + len(text) + 1 + MARK_BYTES < self.rx_bytes

    def send(self, text: str, line: int, kind: Kind | None = None) -> bytes:
        """The bytes of a line that there is :meth:`room` for."""
        kind = kind or kind_of(text)
        if not self.room(text, kind):
            raise RuntimeError(f"There is no room for {text!r} in state {self.state.name}.")
        if "F" in text or "S" in text or "M" in text:
            self._note_modes(text)
        return self._enter(
            SentLine(
                text,
                line,
                len(text) + 1,
                kind,
                seconds_of(text) if kind in ("dwell", "system", "writer") else 0.0,
            )
        )

    @property
    def unmarked(self) -> int:
        """Lines since the last mark."""
        return self._since_mark

    def mark_fits(self) -> bool:
        """Whether a mark may be sent: one at a time, and not beside a line that has to be alone."""
        if (
            self.state is not State.READY
            or self._marks
            or (self._ledger and self._ledger[-1].kind in ("writer", "system"))
        ):
            return False
        return self._used + MARK_BYTES < self.rx_bytes

    def mark(self) -> bytes:
        """The bytes of a mark that fits."""
        if not self.mark_fits():
            raise RuntimeError(f"There is no room for a mark in state {self.state.name}.")
        self._marks += 1
        self._since_mark = 0
        line = self._ledger[-1].line if self._ledger else self.confirmed_line
        return self._enter(
            SentLine(MARK, line, MARK_BYTES, "system", mark=True, said=dict(self._said))
        )

    def reset(self) -> bytes:
        """The soft reset: what was sent and not carried out is forgotten on both sides."""
        self.state = State.RESETTING
        self._ledger.clear()
        self._used = self._marks = self._since_mark = 0
        self._said.clear()
        self.status_reader.forget()
        return RealTime.RESET.value

    def receive(self, data: bytes) -> list[Event]:
        """What the board said."""
        events = [self._event(message) for message in self._messages.receive(data)]
        return [event for event in events if event is not None]

    def _enter(self, sent: SentLine) -> bytes:
        self._ledger.append(sent)
        self._used += sent.size
        self._since_mark += not sent.mark
        return sent.text.encode("ascii") + b"\n"

    def _event(self, message: Message) -> Event | None:
        if message is OK or isinstance(message, Reply):
            return self._answered(message.error) if self.state is State.READY else None
        if isinstance(message, Report):
            status = self.status_reader.read(message.text)
            return Other(f"<{message.text}>") if status is None else Reported(status)
        if isinstance(message, Alarm):
            self.state = AFTER_ALARM[self.state]
            return Alarmed(message.code, self.oldest)
        if isinstance(message, Welcome):
            expected = self.state is not State.READY
            self.state = AFTER_WELCOME[self.state]
            return Started(message, expected)
        if isinstance(message, Feedback) and message.kind == "GC" and self._marks:
            return self._mark_came(message.text)
        return message

    def _answered(self, code: int) -> Event | None:
        """A reply is the oldest line's."""
        if not self._ledger:
            self.state = State.FAILED
            return UnexpectedReply(code)
        sent = self._ledger.popleft()
        self._used -= sent.size
        self._marks -= sent.mark
        if code:
            self.state = State.FAILED
            return Rejected(sent, code)
        if sent.mark:
            if not sent.seen:
                return self._lost(sent.line)
            self._verified_line = sent.line
            return None
        self.confirmed_line = sent.line or self.confirmed_line
        return Confirmed(sent)

    def _mark_came(self, modes: str) -> Event | None:
        """The modes that a mark asks for: all before it has been answered, and feed and speed are
        what was sent, or something got lost.
        """
        oldest = self._ledger[0]
        if oldest.mark:
            oldest.seen = True
            told = dict(_MODE.findall(modes))
            return None if self._as_said(oldest.said or {}, told) else self._lost(oldest.line)
        return self._lost(next(sent.line for sent in self._ledger if sent.mark))

    def _as_said(self, said: Mapping[str, float], told: Mapping[str, str]) -> bool:
        """Whether the board has feed and speed as they were sent; it may tell the feed in
        inches.
        """
        unit = self.status_reader.unit
        for letter, value in said.items():
            scale = unit if letter == "F" else 1.0
            if letter in told and abs(float(told[letter]) * scale - value) > ROUNDED * scale:
                return False
        return True

    def _note_modes(self, text: str) -> None:
        """Feed and speed of a line; the end of a program sets back what it likes."""
        line = bare(text)
        if "M" in line and _END.search(line):
            self._said.clear()
        else:
            self._said.update((letter, float(value)) for letter, value in _MODE.findall(line))

    def _lost(self, until: int) -> Lost:
        self.state = State.FAILED
        return Lost(self._verified_line, until)
