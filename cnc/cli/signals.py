"""Signals during a command: Ctrl-C, termination, a closed terminal, and Ctrl-Z.

signal           | before motion      | during motion
-----------------+--------------------+-------------------------------------------------------------
SIGINT, SIGTERM  | the end            | stop; a second one ends the program at once
SIGHUP           | the end            | stop, however often it comes
SIGTSTP (Ctrl-Z) | suspends at once   | hold; suspends when the motion is at rest

A machine must not go on while nobody can reach it: a suspended program watches nothing, and neither
does an operator whose terminal has been closed.
"""

from __future__ import annotations

import errno
import io
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from cnc.model.operator_control import Control, StoppedAtOnce

if sys.platform != "win32":
    import termios

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer


HANGUP: signal.Signals | None = getattr(signal, "SIGHUP", getattr(signal, "SIGBREAK", None))
"""The terminal was closed; on Windows, the console."""
SUSPEND: signal.Signals | None = getattr(signal, "SIGTSTP", None)


class OperatorSignals:
    """Turns signals into requests of the operator while its context lasts.

    Args:
        control: Takes the requests.

    Attributes:
        moved: Whether the machine may have moved in this command.
        moving: Whether the machine may move.
        hung_up: Whether the terminal is gone.
    """

    moved = False

    def __init__(self, control: Control) -> None:
        self.moving = False
        self.hung_up = False
        self._control = control
        self._suspends = self._at_once = False
        self._before: dict[signal.Signals, Any] = {}
        self._terminals: list[int] = []

    def __enter__(self) -> OperatorSignals:
        self._terminals = _terminal_outputs()
        if threading.current_thread() is threading.main_thread():
            handlers: dict[signal.Signals | None, Callable[..., None]] = {
                signal.SIGINT: self._stop,
                signal.SIGTERM: self._stop,
                HANGUP: self._hang_up,
                SUSPEND: self._suspend,
            }
            for number, handler in handlers.items():
                # nohup ignores SIGHUP, and a shell without job control ignores SIGTSTP.
                ignored = number in (HANGUP, SUSPEND) and (
                    number is None or signal.getsignal(number) is signal.SIG_IGN
                )
                if number is not None and not ignored:
                    self._before[number] = signal.signal(number, handler)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        OperatorSignals.moved |= self.moving
        self.at_rest()

    def at_rest(self) -> None:
        """Suspend the program now, if that was requested: the motion is at rest."""
        if self._suspends:
            self._suspends = False
            _suspend_now()

    def _stop(self, *_: object) -> None:
        if not self.moving:
            raise KeyboardInterrupt("stopped by the operator; nothing has moved")
        if self._control.stopped and not self.hung_up:
            # Only the first of these leaves the board the time to come to rest.
            kind = KeyboardInterrupt if self._at_once else StoppedAtOnce
            self._at_once = True
            raise kind("stopped by the operator at once; the position is lost, so home the machine")
        self._control.stop()

    def _hang_up(self, *_: object) -> None:
        self.hung_up = True
        # Writing to a closed terminal is an error.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for file in self._terminals:
            os.dup2(nowhere, file)
        os.close(nowhere)
        if not self.moving:
            raise KeyboardInterrupt("the terminal was closed; nothing has moved")
        self._control.stop()

    def _suspend(self, *_: object) -> None:
        if self.moving and not self._control.stopped:
            self._suspends = True
            self._control.hold()
        else:
            _suspend_now()


def typed_line(control: Control) -> str:
    """Return the next line of standard input; "" at its end.

    The machine rests while the operator types. So a signal ends the command here: the request to
    stop of :class:`OperatorSignals` would wait for the line.

    Raises:
        KeyboardInterrupt: For a signal, also one that came just before.
    """

    def stop(*_: object) -> None:
        raise KeyboardInterrupt("stopped by the operator; the machine is at rest")

    before: dict[signal.Signals, Any] = {}
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        if control.stopped:
            stop()
        return sys.stdin.readline()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def report_hang_up() -> None:
    """Tell this process that its terminal is gone.

    The system does so only for the controlling terminal of a session.
    """
    if sys.platform != "win32":
        os.kill(os.getpid(), signal.SIGHUP)


def _terminal_outputs() -> list[int]:
    """Return the output files that are terminals."""
    files = []
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):
            if stream.isatty():
                files.append(stream.fileno())
    return files


def _suspend_now() -> None:
    """Stop this process until it is continued."""
    if sys.platform != "win32":
        with _kept_terminal():
            os.kill(os.getpid(), signal.SIGSTOP)


@contextmanager
def _kept_terminal() -> Iterator[None]:
    """Keep the modes of the terminal, which the shell changes meanwhile."""
    if sys.platform == "win32":
        yield
        return
    try:
        file = sys.stdin.fileno()
        modes = termios.tcgetattr(file)
    except (OSError, ValueError, AttributeError, termios.error):
        yield
        return
    yield
    # In the background, a change of the modes would stop the process again.
    with suppress(OSError, termios.error):
        if os.tcgetpgrp(file) == os.getpgrp():
            termios.tcsetattr(file, termios.TCSANOW, modes)


# Standard input, output and error of a command: closed ones, and an error output that is full.

NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a write to a full disk, as to a file to which an output is redirected."""


class _ErrorOutput(io.FileIO):
    """Standard error. Messages that a full disk does not take are lost: they must not end a run."""

    def write(self, data: ReadableBuffer, /) -> int:
        """Write some bytes."""
        try:
            return super().write(data)
        except OSError as error:
            if error.errno not in NO_SPACE:
                raise
            return memoryview(data).nbytes


def prepare_streams() -> None:
    """Make standard input, output and error usable, whether they are open, closed or full.

    The number of a closed one would go to the next file, such as the port of a board, which would
    then receive the messages. A closed output takes and drops everything; reading a closed input is
    an error.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None and not _is_open(number):
            os.set_inheritable(os.open(os.devnull, os.O_WRONLY), True)
            file = io.FileIO(number, "w" if number else "r", closefd=False)
            buffer = io.BufferedWriter(file) if number else io.BufferedReader(file)
            setattr(sys, name, io.TextIOWrapper(buffer, encoding="utf-8"))
    # A file name may contain bytes that are not text; printing it must not fail.
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    if isinstance(sys.stderr, io.TextIOWrapper):
        sys.stderr = io.TextIOWrapper(
            io.BufferedWriter(_ErrorOutput(2, "w", closefd=False)),
            encoding=sys.stderr.encoding,
            errors="backslashreplace",
            line_buffering=True,
        )


def _is_open(number: int) -> bool:
    try:
        os.fstat(number)
    except OSError:
        return False
    return True
