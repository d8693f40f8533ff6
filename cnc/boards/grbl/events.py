"""Events of the protocol of a GRBL board."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from cnc.boards.grbl.line_kinds import Kind
from cnc.boards.grbl.messages import Feedback, Other, Reply, Setting, Welcome
from cnc.boards.grbl.status import Status


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
