"""An operator session in a process of its own, as its users see it.

The state, the offsets, the open question and the machine are the last that the process sent, so no
reader ever delays the machine. Only calls of :meth:`RemoteSession.ask` reach the process.
"""

from __future__ import annotations

import itertools
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Concatenate, NamedTuple, ParamSpec, TypeVar

from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError, CncError, Diagnostic
from cnc.operate.events import (
    Alarm,
    ConsoleLine,
    Dialog,
    DialogClosed,
    Event,
    EventStream,
    Finding,
    Listener,
    OffsetsChanged,
    State,
)
from cnc.operate.operator_session import MOST_HISTORY, Offsets, OperatorSession, answered

# The process of an operator session: it owns the board, and nothing else delays it.
#
#     server ── Request ──► pipe ──► main thread ──► OperatorSession ──► board
#            ◄── batches of messages ◄── sender ◄── queue ◄── answers, events, log
#
# A server that ends, however it ends, closes the pipe. The machine then comes to rest on the path,
# as after a stop, and the process ends.

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


P = ParamSpec("P")
T = TypeVar("T")
_ROOT = logging.getLogger("cnc")


class RemoteSession:
    """Operates one machine by a process of its own.

    A process that ends is replaced at the next request; the board is not connected then.

    Args:
        machine: The machine.
        macros: Folder of the macros; None for no macros.
        subroutines: Further folders of subroutines.

    Attributes:
        machine: The machine.
        state: The last state.
        dialog: The open question to the operator.
        offsets: Offsets by name and axis, mm; empty without a board.
        limited_machine: The machine with the travel of the board, and the kind of the board.
        history: Lines entered, the oldest first.
    """

    def __init__(
        self, machine: Machine, *, macros: Path | None = None, subroutines: Sequence[Path] = ()
    ) -> None:
        self.machine = OperatorSession.with_folders(machine, macros, subroutines)
        self._begin = Begin(machine, macros, tuple(subroutines), _ROOT.getEffectiveLevel())
        self._events = EventStream()
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._closing = False
        self.history: list[str] = []
        self._forget()
        self._process: _Process | None = self._new_process()

    def _forget(self) -> None:
        self.state = State()
        self.dialog: Event | None = None
        self.offsets: Offsets = {}
        self.rotations: dict[str, float] = {}
        self.limited_machine = self.machine

    @property
    def process_id(self) -> int | None:
        """Number of the process, None without one."""
        process = self._process
        return None if process is None else process.id

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Call ``listener`` with each event; the result ends this."""
        return self._events.listen(listener)

    def ask(
        self,
        method: Callable[Concatenate[OperatorSession, P], T],
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> Future[T]:
        """Call a method of the session.

        Returns:
            What the method returns or raises; BoardError ``session-lost`` if the process ends.
        """
        with self._lock:
            if self._closing:
                return answered(_refuse)
            process = self._process = self._process or self._new_process()
        return process.ask(Request(next(self._numbers), method, args, kwargs))

    def close(self) -> None:
        """Come to rest, release the board, and end the process."""
        with self._lock:
            self._closing = True
            process, self._process = self._process, None
        if process is not None:
            process.close()

    def _new_process(self) -> _Process:
        return _Process(self._begin, self._take, self._end)

    def _take(self, message: Happened | Limited | Entered) -> None:
        if isinstance(message, Limited):
            self.limited_machine = message.machine
            return
        if isinstance(message, Entered):
            self.history = [*self.history, message.line][-MOST_HISTORY:]
            return
        event = message.event
        if isinstance(event, State):
            self.state = event
            if not event.board:
                self.offsets, self.rotations, self.limited_machine = {}, {}, self.machine
        elif isinstance(event, Dialog):
            self.dialog = event
        elif isinstance(event, DialogClosed):
            self.dialog = None
        elif isinstance(event, OffsetsChanged):
            self.offsets, self.rotations = event.offsets, event.rotations
        self._events.emit(event)

    def _end(self, process: _Process) -> None:
        """Report that the process has ended, unless it was asked to."""
        with self._lock:
            if self._closing or self._process is not process:
                return
            self._process = None
        dialog = self.dialog
        self._forget()
        if isinstance(dialog, Dialog):
            self._events.emit(DialogClosed(id=dialog.id))
        self._events.emit(self.state)
        self._events.emit(Alarm(finding=Finding.of(_lost().diagnostic)))


SessionAccess = OperatorSession | RemoteSession
"""A session in this process, or in one of its own.

Its users take the state, the machine and the history, all of which cost the session nothing, and
call its methods by ``ask``.
"""


class _Process:
    """One process, its pipe, and the two threads that use the pipe.

    Args:
        begin: What the session begins with.
        take: Called with what happens.
        end: Called when the process has ended.
    """

    def __init__(
        self,
        begin: Begin,
        take: Callable[[Happened | Limited | Entered], None],
        end: Callable[[_Process], None],
    ) -> None:
        self._take_message, self._on_end = take, end
        self._answers: dict[int, Future[Any]] = {}
        self._activities: dict[int, Future[Any]] = {}
        self._lock = threading.Lock()
        self._ended = False
        self._requests: SimpleQueue[Request | None] = SimpleQueue()
        context = get_context("spawn")
        self._connection, far = context.Pipe()
        # A server that ends in an orderly way, but without close(), ends the process too.
        self._process: SpawnProcess = context.Process(
            target=run, args=(far, begin), daemon=True, name="machine"
        )
        with _interrupts_blocked():
            self._process.start()
        far.close()
        self._reader = threading.Thread(target=self._read, daemon=True, name="session events")
        self._sender = threading.Thread(target=self._send, daemon=True, name="session requests")
        self._reader.start()
        self._sender.start()

    @property
    def id(self) -> int | None:
        """Number of the process."""
        return self._process.pid

    def ask(self, request: Request) -> Future[Any]:
        """Send a request; return its answer."""
        future: Future[Any] = Future()
        future.set_running_or_notify_cancel()
        with self._lock:
            if self._ended:
                future.set_exception(_lost())
                return future
            self._answers[request.number] = future
        self._requests.put(request)
        return future

    def close(self) -> None:
        """End the process when the machine is at rest."""
        self._requests.put(None)
        self._process.join()
        self._reader.join()

    def _send(self) -> None:
        with suppress(OSError):
            while True:
                request = self._requests.get()
                self._connection.send(request)
                if request is None:
                    return

    def _read(self) -> None:
        with suppress(EOFError, OSError):
            while True:
                for message in self._connection.recv():
                    self._take(message)
        self._fail()
        self._on_end(self)
        self._requests.put(None)
        self._process.join()
        self._connection.close()

    def _take(self, message: Message) -> None:
        match message:
            case Answer(number, _, _, True):
                activity: Future[Any] = Future()
                activity.set_running_or_notify_cancel()
                self._activities[number] = activity
                self._answers.pop(number).set_result(activity)
            case Answer(number, value, error):
                _finish(self._answers.pop(number), value, error)
            case Ended(number, value, error):
                _finish(self._activities.pop(number), value, error)
            case Logged(record):
                logging.getLogger(record.name).handle(record)
            case _:
                self._take_message(message)

    def _fail(self) -> None:
        """Let all that waits fail."""
        with self._lock:
            self._ended = True
            waiting = [*self._answers.values(), *self._activities.values()]
            self._answers, self._activities = {}, {}
        for future in waiting:
            future.set_exception(_lost())


def _finish(future: Future[Any], value: Any, error: Exception | None) -> None:
    if error is None:
        future.set_result(value)
    else:
        future.set_exception(error)


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Let a process begin that does not end by a Ctrl-C before it can ignore it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _refuse() -> None:
    raise _lost()


def _lost() -> BoardError:
    message = "the process that operates the machine has ended"
    hint = "the board stops by itself; connect it again, and home it"
    return BoardError(Diagnostic("session-lost", message, hint=hint))
