"""Events of the protocol of a GRBL board."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

from cnc.boards.grbl.line_kinds import Kind
from cnc.boards.grbl.messages import Feedback, Other, Reply, Setting, Welcome
from cnc.boards.grbl.status import Status


class SentLine(NamedTuple):
    """An unanswered line.

    Attributes:
        text: The line.
        line: Its source line.
        size: Bytes with the line end.
        kind: Its kind.
        seconds: Longest time that it takes without motion.
        mark: Whether it is a mark.
        expected: Feed and speed at the mark, by the lines before it.
    """

    text: str
    line: int
    size: int
    kind: Kind
    seconds: float = 0.0
    mark: bool = False
    expected: Mapping[str, float] | None = None


new_sent_line: Callable[
    [tuple[str, int, int, Kind, float, bool, Mapping[str, float] | None]], SentLine
] = partial(tuple.__new__, SentLine)
"""Make a sent line of all its fields. A call of the type would take a function of Python."""


@dataclass(slots=True)
class Confirmed:
    """The board accepted lines.

    Attributes:
        sent: The last of them.
        count: Their number: answers that came together are one event.
    """

    sent: SentLine
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
