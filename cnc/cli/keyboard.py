"""The operator's keys during a run: hold and resume, feed override, stop.

Keys are read if standard input is a terminal. Without a terminal there are no keys, which is not an
error. :class:`cnc.model.operator_control.Control` carries out the requests on every board.

The standard library is used directly, because the key readers on the package index block until a
key is pressed. At the end of a run they would leave the terminal in a changed mode.
"""

from __future__ import annotations

import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from queue import SimpleQueue

from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.model.operator_control import (
    MAX_FEED_OVERRIDE,
    MAX_SPINDLE_OVERRIDE,
    MIN_SPINDLE_OVERRIDE,
    RAPID_OVERRIDES,
    Control,
)

log = logging.getLogger(__name__)

OVERRIDE_STEP = 10.0
"""Change of the feed override for each key, per cent of the programmed feeds."""
MIN_OVERRIDE = 10.0
"""Lowest feed override by keys, per cent: the lowest of GRBL."""
POLL = 0.05
"""Longest wait for a key before the reader checks for the end of the run, s."""
HELP = (
    "space holds and resumes, + and - change the feed, r the traverses, [ and ] the spindle speed, "
    "q stops"
)


class Keyboard:
    """Reads keys while its context lasts.

    Attributes:
        available: Whether there is a terminal.
    """

    def __init__(self, control: Control) -> None:
        self.available = False
        self._control = control
        self._answers: SimpleQueue[str] | None = None
        self._context = ExitStack()

    def confirm(self, steps: Sequence[str], *, yes: bool) -> bool:
        """Print the steps to the start line, and ask whether to begin.

        Args:
            steps: The steps in words.
            yes: Whether to begin without a question.

        Raises:
            UsageError: ``needs-yes`` without a terminal.
        """
        print(*steps, sep="\n  ", file=sys.stderr, flush=True)
        if yes:
            return True
        if not self.available:
            message = "there is no terminal to ask whether to begin like this"
            hint = "run it in a terminal, or with --yes"
            raise UsageError(Diagnostic("needs-yes", message, hint=hint))
        print("press y to go on, any other key to end: ", end="", file=sys.stderr, flush=True)
        self._answers = SimpleQueue()
        answer = self._answers.get()
        self._answers = None
        print(answer if answer.isprintable() else "", file=sys.stderr, flush=True)
        return answer in ("y", "Y")

    def press(self, key: str) -> None:
        """Carry out the request of a key, or take it as the answer to a question."""
        control = self._control
        log.debug("key %r", key)
        if self._answers is not None:
            self._answers.put(key)
        elif key == " ":
            if control.held:
                control.resume()
            else:
                control.hold()
        elif key == "+":
            control.override(min(control.feed_override + OVERRIDE_STEP, MAX_FEED_OVERRIDE))
        elif key == "-":
            lowest = min(MIN_OVERRIDE, control.feed_override)
            control.override(max(control.feed_override - OVERRIDE_STEP, lowest))
        elif key in ("r", "R"):
            place = RAPID_OVERRIDES.index(control.rapid_override)
            control.override_rapids(RAPID_OVERRIDES[place - 1])
        elif key in ("[", "]"):
            changed = control.spindle_override + (OVERRIDE_STEP if key == "]" else -OVERRIDE_STEP)
            control.override_spindle(min(max(changed, MIN_SPINDLE_OVERRIDE), MAX_SPINDLE_OVERRIDE))
        elif key in ("q", "Q"):
            control.stop()

    def __enter__(self) -> Keyboard:
        read_keys = self._context.enter_context(_terminal())
        if read_keys is not None:
            self.available = True
            ended = threading.Event()
            thread = threading.Thread(target=self._listen, args=(read_keys, ended), daemon=True)
            thread.start()
            self._context.callback(thread.join)
            self._context.callback(ended.set)
        return self

    def __exit__(self, *_: object) -> None:
        self._context.close()

    def _listen(self, read_keys: Callable[[], str], ended: threading.Event) -> None:
        try:
            while not ended.is_set():
                for key in read_keys():
                    self.press(key)
        except OSError:
            log.info("the terminal is gone")


@contextmanager
def _terminal() -> Iterator[Callable[[], str] | None]:
    """Provide a function that returns the keys pressed within POLL; None without a terminal."""
    if not _is_terminal():
        yield None
    elif sys.platform == "win32":
        yield _read_console
    else:
        import termios
        import tty

        file = sys.stdin.fileno()
        before = termios.tcgetattr(file)
        # Each key is read at once and not printed; Ctrl-C still raises a signal.
        tty.setcbreak(file)
        try:
            yield partial(_read_file, file)
        finally:
            # A terminal that is gone needs no reset.
            with suppress(termios.error):
                termios.tcsetattr(file, termios.TCSADRAIN, before)


def _is_terminal() -> bool:
    try:
        return sys.stdin.isatty()
    except (AttributeError, ValueError):
        # There is no standard input, or it is closed.
        return False


def _read_file(file: int) -> str:
    """Return the keys of a POSIX terminal. Raises OSError if it is gone."""
    import select

    # A process in the background that read the terminal would be stopped.
    if not _in_foreground(file):
        time.sleep(POLL)
        return ""
    if not select.select([file], [], [], POLL)[0]:
        return ""
    keys = os.read(file, 64)
    if not keys:
        raise OSError("end of file")
    return keys.decode("latin-1")


def _in_foreground(file: int) -> bool:
    try:
        return os.tcgetpgrp(file) == os.getpgrp()
    except OSError:
        # It is not the terminal of this session, so nothing stops its readers.
        return True


def _read_console() -> str:
    """Return the keys of a Windows console."""
    if sys.platform == "win32":
        import msvcrt

        if msvcrt.kbhit():
            return msvcrt.getwch()
    time.sleep(POLL)
    return ""
