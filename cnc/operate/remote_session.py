"""An operator session in a process of its own, as its users see it.

The state, the offsets, the open question and the machine are the last that the process sent, so no
reader ever delays the machine. Only calls of :meth:`RemoteSession.ask` reach the process.
"""

from __future__ import annotations

import itertools
import logging
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from multiprocessing.context import SpawnProcess
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Concatenate, ParamSpec, TypeVar

from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError, Diagnostic
from cnc.operate import session_process
from cnc.operate.events import (
    Alarm,
    Dialog,
    DialogClosed,
    Event,
    EventStream,
    Finding,
    Listener,
    OffsetsChanged,
    State,
)
from cnc.operate.operator_session import MOST_HISTORY, OperatorSession
from cnc.operate.session_access import Offsets, answered
from cnc.operate.session_process import (
    Answer,
    Begin,
    Ended,
    Entered,
    Happened,
    Limited,
    Logged,
    Request,
)

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
                self.offsets, self.limited_machine = {}, self.machine
        elif isinstance(event, Dialog):
            self.dialog = event
        elif isinstance(event, DialogClosed):
            self.dialog = None
        elif isinstance(event, OffsetsChanged):
            self.offsets = event.offsets
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
            target=session_process.run, args=(far, begin), daemon=True, name="machine"
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

    def _take(self, message: session_process.Message) -> None:
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
