"""The operator's keys during a run: hold and resume, feed override, stop.

Keys are read if standard input is a terminal. Without a terminal there are no keys, which is not an
error. :class:`cnc.model.operator_control.Control` carries out the requests on every board.

prompt_toolkit reads and decodes the keys on every system: the bytes of an arrow key are one key
there, which makes no request. Its raw mode is not used, because Ctrl-C has to stay a signal.
"""

from __future__ import annotations

import logging
import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from queue import SimpleQueue
from typing import TYPE_CHECKING

from cnc.model.diagnostics import Diagnostic, UsageError, printable
from cnc.model.operator_control import (
    MAX_FEED_OVERRIDE,
    MAX_SPINDLE_OVERRIDE,
    MIN_SPINDLE_OVERRIDE,
    RAPID_OVERRIDES,
    Control,
)

if sys.platform != "win32":
    import termios
    import tty

if TYPE_CHECKING:
    from prompt_toolkit.input import Input

log = logging.getLogger(__name__)

OVERRIDE_STEP = 10.0
"""Change of the feed override for each key, per cent of the programmed feeds."""
MIN_OVERRIDE = 10.0
"""Lowest feed override by keys, per cent: the lowest of GRBL."""
POLL = 0.02
"""Time between two readings of the keys, s."""
HELP = (
    "space holds and resumes, + and - change the feed, r the traverses, [ and ] the spindle speed, "
    "q stops"
)
NO_TERMINAL = "no terminal gives keys: resume at the machine, or stop with Ctrl-C (SIGINT)"
"""The same text where there is no terminal."""


class Keyboard:
    """Reads keys while its context lasts.

    Attributes:
        available: Whether there is a terminal.
    """

    def __init__(self, control: Control, on_gone: Callable[[], None] = lambda: None) -> None:
        """``on_gone`` is called, in a thread, when the terminal is gone."""
        self.available = False
        self._on_gone = on_gone
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
        print(*map(printable, steps), sep="\n  ", file=sys.stderr, flush=True)
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
        """Carry out the request of a key, or take it as the answer to a question.

        A request that the board does not know is told.
        """
        log.debug("key %r", key)
        if self._answers is not None:
            self._answers.put(key)
            return
        try:
            self._request(key)
        except UsageError as refused:
            print(refused.diagnostic.message, file=sys.stderr, flush=True)

    def _request(self, key: str) -> None:
        control = self._control
        if key == " ":
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
        if self._context.enter_context(_terminal()):
            self.available = True
            ended = threading.Event()
            thread = threading.Thread(target=self._listen, args=(ended,), daemon=True)
            thread.start()
            self._context.callback(thread.join)
            self._context.callback(ended.set)
        return self

    def __exit__(self, *_: object) -> None:
        self._context.close()

    def _listen(self, ended: threading.Event) -> None:
        # Imported here, in the thread: the start of the program does not wait for it.
        from prompt_toolkit.input import create_input

        terminal = create_input(sys.stdin)
        while not ended.wait(POLL):
            if _is_gone(terminal):
                log.info("the terminal is gone")
                self._on_gone()
                break
            # A process in the background that read the terminal would be stopped.
            if _in_foreground(terminal):
                # The bytes of a key may come in two readings: the poll after that ends it.
                for pressed in terminal.read_keys() or terminal.flush_keys():
                    if len(pressed.key) == 1:
                        self.press(pressed.key)


@contextmanager
def _terminal() -> Iterator[bool]:
    """Tell whether standard input is a terminal, and let it send each key at once."""
    if not _is_terminal():
        yield False
    elif sys.platform == "win32":
        yield True
    else:
        file = sys.stdin.fileno()
        before = termios.tcgetattr(file)
        # Each key is read at once and not printed; Ctrl-C still raises a signal.
        tty.setcbreak(file)
        try:
            yield True
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


def _is_gone(terminal: Input) -> bool:
    """Tell whether the terminal was closed; a console of Windows lives as long as its program."""
    if sys.platform == "win32":
        return False
    try:
        termios.tcgetattr(terminal.fileno())
    except termios.error:
        return True
    return terminal.closed


def _in_foreground(terminal: Input) -> bool:
    if sys.platform == "win32":
        return True
    try:
        return os.tcgetpgrp(terminal.fileno()) == os.getpgrp()
    except OSError:
        # It is not the terminal of this session, so nothing stops its readers.
        return True
