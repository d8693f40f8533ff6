"""The operator's keys while a program runs: space holds and goes on, + and - change the feed, q
stops.

They work where standard input is a terminal of a system that lets single keys be read; elsewhere
there are none, which is no error. What a key asks for is carried out by
:class:`cnc.model.operator_control.Control`, on every board alike.
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import threading
from collections.abc import Sequence
from queue import SimpleQueue
from typing import Any

from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.model.operator_control import MAX_FEED_OVERRIDE, Control

STEP = 10.0
"""Per cent of the programmed feeds for one key."""
LEAST = 10.0
"""Per cent; GRBL goes no lower."""
HELP = "space holds and goes on, + and - change the feed, q stops"


class Keys:
    """Reads keys as long as the context lasts. ``available``: whether there are any."""

    def __init__(self, control: Control) -> None:
        self.available = False
        self._control = control
        self._before: list[Any] = []
        self._file = -1
        self._wake: tuple[int, int] | None = None
        self._thread: threading.Thread | None = None
        self._answers: SimpleQueue[str] | None = None

    def agreed(self, story: Sequence[str], *, yes: bool) -> bool:
        """Tell what will be done and ask whether it shall; ``yes``: do not ask. UsageError
        ``needs-yes`` where nobody can be asked.
        """
        print(*story, sep="\n  ", file=sys.stderr, flush=True)
        if yes:
            return True
        if not self.available:
            hint = "run it in a terminal, or with --yes"
            raise UsageError(
                Diagnostic(
                    "needs-yes", "there is no terminal to ask whether to begin like this", hint=hint
                )
            )
        print("press y to go on, any other key to end: ", end="", file=sys.stderr, flush=True)
        self._answers = SimpleQueue()
        answer = self._answers.get()
        self._answers = None
        print(answer if answer.isprintable() else "", file=sys.stderr, flush=True)
        return answer in ("y", "Y")

    def press(self, key: str) -> None:
        """What a key asks for; others ask for nothing. If there is a question, it is the answer."""
        control = self._control
        if self._answers is not None:
            self._answers.put(key)
            return
        if key == " ":
            if control.held:
                control.resume()
            else:
                control.hold()
        elif key == "+":
            control.override(min(control.feed_override + STEP, MAX_FEED_OVERRIDE))
        elif key == "-":
            control.override(max(control.feed_override - STEP, min(LEAST, control.feed_override)))
        elif key in ("q", "Q"):
            control.stop()

    def __enter__(self) -> Keys:
        with contextlib.suppress(ImportError, OSError, ValueError, AttributeError):
            self._listen()
        return self

    def __exit__(self, *_: object) -> None:
        if self._wake is None or self._thread is None:
            return
        import termios

        os.write(self._wake[1], b"x")
        self._thread.join()
        for end in self._wake:
            os.close(end)
        self._wake = None
        with contextlib.suppress(termios.error):
            termios.tcsetattr(self._file, termios.TCSADRAIN, self._before)

    def _listen(self) -> None:
        """OSError, ValueError where standard input is no terminal; ImportError where the system has
        none of this kind.
        """
        import termios
        import tty

        if not sys.stdin.isatty():
            return
        self._file = sys.stdin.fileno()
        try:
            self._before = termios.tcgetattr(self._file)
            # Keys come one by one and unseen; Ctrl-C stays what it is.
            tty.setcbreak(self._file)
        except termios.error:
            return
        self._wake = os.pipe()
        self._thread = threading.Thread(
            target=self._read, args=(self._file, self._wake[0]), daemon=True
        )
        self._thread.start()
        self.available = True

    def _read(self, file: int, wake: int) -> None:
        while True:
            ready, _, _ = select.select([file, wake], [], [])
            if wake in ready:
                return
            try:
                keys = os.read(file, 64)
            except OSError:
                return
            if not keys:
                return
            for key in keys.decode("latin-1"):
                self.press(key)
