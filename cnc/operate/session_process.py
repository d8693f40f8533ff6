"""The process of an operator session: it owns the board, and nothing else delays it.

    server ── Request ──► pipe ──► main thread ──► OperatorSession ──► board
           ◄── batches of messages ◄── sender ◄── queue ◄── answers, events, log

A server that ends, however it ends, closes the pipe. The machine then comes to rest on the path, as
after a stop, and the process ends.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

from cnc.machine.models import Machine
from cnc.model.diagnostics import CncError
from cnc.operate.events import ConsoleLine, Event, OffsetsChanged
from cnc.operate.operator_session import OperatorSession
from cnc.operate.session_access import answered

PRIORITY = -10
"""Priority (nice) of the process, where the system allows it."""
SWITCH_S = 0.0005
"""Time after which a thread gives way to another, s: the board does not wait for requests."""
GATHER = 0.02
"""Longest time for which lines of the console wait for others, s."""


@dataclass(frozen=True, slots=True)
class Begin:
    """What a session begins with.

    Attributes:
        machine: The machine.
        macros: Folder of the macros; None for no macros.
        subroutines: Further folders of subroutines.
        log_level: Lowest level of the log that is wanted.
    """

    machine: Machine
    macros: Path | None
    subroutines: tuple[Path, ...]
    log_level: int


class Request(NamedTuple):
    """A call of a method of the session."""

    number: int
    method: Callable[..., Any]
    args: tuple[Any, ...]
    kwargs: dict[str, Any]


class Answer(NamedTuple):
    """What a method returned, or raised; ``begun``: an activity, whose end follows."""

    number: int
    value: Any = None
    error: Exception | None = None
    begun: bool = False


class Ended(NamedTuple):
    """What an activity returned, or raised."""

    number: int
    value: Any = None
    error: Exception | None = None


class Happened(NamedTuple):
    """An event of the session."""

    event: Event


class Limited(NamedTuple):
    """The machine with the limits of the board that is connected."""

    machine: Machine


class Entered(NamedTuple):
    """A line of the history."""

    line: str


class Logged(NamedTuple):
    """A record of the log."""

    record: logging.LogRecord


Message = Answer | Ended | Happened | Limited | Entered | Logged


class Terminated(BaseException):
    """The process was asked to end (SIGTERM)."""


class _Outbox(logging.Handler):
    """Sends messages in batches, from any thread, without a wait.

    Args:
        connection: The pipe.
    """

    def __init__(self, connection: Connection) -> None:
        super().__init__()
        self._connection = connection
        self._queue: SimpleQueue[Message | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._send, daemon=True, name="events")
        self._thread.start()

    def put(self, message: Message) -> None:
        """Send a message."""
        self._queue.put(message)

    def emit(self, record: logging.LogRecord) -> None:
        """Send a record of the log, whose text is made here."""
        record.msg, record.args = record.getMessage(), None
        if record.exc_info:
            record.exc_text = logging.Formatter().formatException(record.exc_info)
            record.exc_info = None
        self._queue.put(Logged(record))

    def end(self) -> None:
        """Send what waits."""
        self._queue.put(None)
        self._thread.join()

    def _send(self) -> None:
        batch: list[Message] = []
        ends = False
        while not ends:
            try:
                message = self._queue.get(timeout=GATHER if batch else None)
            except Empty:
                pass
            else:
                ends = message is None
                if message is not None:
                    batch.append(message)
                    if _may_wait(message) and len(batch) < 100:
                        continue
            # A server that is gone reads nothing.
            with suppress(OSError):
                self._connection.send(batch)
            batch = []


def _may_wait(message: Message) -> bool:
    return isinstance(message, Logged) or (
        isinstance(message, Happened) and isinstance(message.event, ConsoleLine)
    )


def run(connection: Connection, begin: Begin) -> None:
    """Operate a machine until the other end of the pipe closes, or sends None."""
    _take_signals()
    sys.setswitchinterval(SWITCH_S)
    _raise_priority()
    outbox = _Outbox(connection)
    root = logging.getLogger("cnc")
    root.setLevel(begin.log_level)
    root.addHandler(outbox)
    session = OperatorSession(begin.machine, macros=begin.macros, subroutines=begin.subroutines)

    def listen(event: Event) -> None:
        if isinstance(event, OffsetsChanged):
            outbox.put(Limited(session.limited_machine))
        outbox.put(Happened(event))

    session.listen(listen)
    try:
        _take(connection, session, outbox)
    except (EOFError, OSError, Terminated):
        pass
    finally:
        session.close()
        outbox.end()


def _take(connection: Connection, session: OperatorSession, outbox: _Outbox) -> None:
    """Carry out requests until None comes."""
    while (request := connection.recv()) is not None:
        number, method, args, kwargs = request
        before = session.history
        done = answered(lambda: method(session, *args, **kwargs))  # noqa: B023 - called at once
        error = done.exception()
        value = None if error else done.result()
        if session.history is not before:
            outbox.put(Entered(session.history[-1]))
        if isinstance(value, Future):
            outbox.put(Answer(number, begun=True))
            value.add_done_callback(partial(_end, outbox, number))
        else:
            outbox.put(Answer(number, value, _sendable(error)))


def _end(outbox: _Outbox, number: int, done: Future[Any]) -> None:
    error = done.exception()
    outbox.put(Ended(number, None if error else done.result(), _sendable(error)))


def _sendable(error: BaseException | None) -> Exception | None:
    if error is None or isinstance(error, CncError):
        return error
    return RuntimeError(f"{type(error).__name__}: {error}")


def _raise_priority() -> None:
    """Let other processes wait for this one, as far as the system allows it."""
    with suppress(OSError, AttributeError):
        # Linux shares processors between terminals first (sched(7), autogroup): the process has a
        # share of its own. The terminal's signals do not reach it any more.
        os.setsid()
    with suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, 0, PRIORITY)
    with suppress(OSError):
        Path("/proc/self/autogroup").write_text(str(PRIORITY))


def _take_signals() -> None:
    """Leave Ctrl-C and a closed terminal to the server."""
    for name in ("SIGINT", "SIGHUP", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _terminate)
    if hasattr(signal, "pthread_sigmask"):
        # The server has blocked it until here.
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])


def _terminate(*_: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise Terminated
