"""The welcome of a GRBL board that is connected.

Opening a port for the first time resets most boards, and a boot loader then takes up to two seconds
before the firmware greets. A board that was not reset answers ``?``, and gets a soft reset once it
is at rest. The first answers do not count: they may be for the process that had the port before. A
board that sends nothing gets a line end, which firmware of another kind answers. Then it is reset,
then gets DTR.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, NoReturn

from cnc.boards.errors import board_error
from cnc.boards.grbl import faults
from cnc.boards.grbl.events import Reported, Started
from cnc.boards.grbl.messages import Other, Welcome
from cnc.boards.grbl.protocol import State
from cnc.boards.grbl.status import Status

if TYPE_CHECKING:
    from cnc.boards.grbl.link import GrblLink

WELCOME_TIMEOUT = 6.0
"""Seconds for the welcome of a board that has just been connected: boot loaders take up to 2."""
LINE_END_AFTER = 2.05
"""Seconds without a byte after which the questions become a line, which Marlin refuses aloud."""
RESET_AFTER = 2.25
"""Seconds without a byte after which the board is reset: in a critical alarm GRBL hears nothing
else.
"""
RAISE_DTR_AFTER = 2.5
"""Seconds without a byte after which DTR is raised: some boards send only then. A board that this
resets still greets in time. Where DTR is up, nothing else can be tried.
"""
STALE_FOR = 0.3
"""Seconds in which a report does not count. The system, and the USB chip of the board, may hold
reports from before the port was opened.
"""
BUSY_AFTER = 0.8
"""Seconds after which a board that still moves is refused."""
FOREIGN = 2.0
"""Seconds from the first line or noise of another device until it counts as one: a boot loader may
send bytes before the welcome.
"""
FOREIGN_TEXT = 1.4
"""The same for a line of text, which few boot loaders send."""
FOREIGN_ANSWER = 0.3
"""The same after the line end: no boot loader runs any more."""
_OLD_REPORT = re.compile(r"<\w+,MPos:")
"""The begin of a status report of GRBL 0.9 and older."""


def wait_for_welcome(link: GrblLink) -> Welcome:
    """Return the welcome of a board at rest.

    Raises:
        BoardError: ``board-not-grbl``, ``board-too-old``, ``board-busy``, ``board-alarm``,
            ``no-answer``.
    """
    received: list[str] = []
    began, foreign_since = link.listened, math.inf
    ended = forced = reset = raised = False
    unready: Status | None = None
    if link.protocol.state is not State.UNKNOWN:
        link.write(link.protocol.reset())
        reset = True
    while (now := link.listened) - began < WELCOME_TIMEOUT:
        if unready is not None and now - began > BUSY_AFTER:
            _refuse(unready, link.name)
        if not ended and not received and now - began > LINE_END_AFTER:
            ended = True
            link.write(b"\n")
        if not forced and not received and now - began > RESET_AFTER:
            forced = reset = True
            link.write(link.protocol.reset())
        if not raised and not received and now - began > RAISE_DTR_AFTER:
            if not link.raise_lines():
                break
            raised, reset = True, False
        patience = FOREIGN_ANSWER if ended else FOREIGN_TEXT if _is_text(received) else FOREIGN
        if now - foreign_since > patience and not _boots_slowly(received):
            break
        for event in link.listen(0.1):
            if isinstance(event, Started):
                link.greeted_unasked |= not reset
                return event.welcome
            if isinstance(event, Reported) and (
                link.protocol.state is State.UNKNOWN or (raised and not reset)
            ):
                unready = None if _is_ready(event.status) else event.status
                if unready is None and link.listened - began > STALE_FOR:
                    link.write(link.protocol.reset())
                    reset = True
            elif isinstance(event, Other):
                received.append(_text_of(event, link.name))
        if received or link.protocol.messages.partial:
            foreign_since = min(foreign_since, link.listened)
    rest = link.protocol.messages.partial.decode("latin-1")
    raise faults.not_grbl(link.name, [*received, rest] if rest else received)


def _text_of(event: Other, name: str) -> str:
    """Return the text of a message of another kind; BoardError for the report of an old GRBL."""
    if old := _OLD_REPORT.match(event.text):
        raise faults.too_old(name, "0.9", old[0])
    return event.text


def _is_ready(status: Status) -> bool:
    """Return whether a board may be reset, and takes it."""
    return status.at_rest and not status.emergency


def _refuse(status: Status, name: str) -> NoReturn:
    """Raise BoardError for a board that is not ready."""
    if not status.at_rest:
        hint = "wait until it has come to rest, or stop it with its reset button"
        message = f"the board at {name} is moving already ({status.state})"
        raise board_error("board-busy", message, hint=hint)
    raise faults.emergency(name)


def _is_text(received: Sequence[str]) -> bool:
    """Return whether all lines can be read; there is one at least."""
    return bool(received) and all(text.isascii() and text.isprintable() for text in received)


def _boots_slowly(received: Sequence[str]) -> bool:
    """Return whether the lines are those of an ESP32 that boots; networks take it some seconds."""
    return any(text.startswith(("ets ", "rst:", "ESP-ROM:")) for text in received)
