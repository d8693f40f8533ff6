"""A simulated board at a pseudo-terminal, which a sender opens as a serial port (Unix only)."""

from __future__ import annotations

import os
import sys
import threading
from abc import ABC, abstractmethod
from typing import Self

if sys.platform != "win32":
    import tty

READ_SIZE = 4096


class Terminal(ABC):
    """A terminal with the name ``name``; ``with`` closes it.

    A thread advances the simulator with the clock of this computer. So a program that is stopped or
    killed leaves the board running, as a real one.
    """

    def __init__(self) -> None:
        self._ours, theirs = os.openpty()
        self._theirs: int | None = theirs
        tty.setraw(theirs)
        self.name = os.ttyname(theirs)
        os.set_blocking(self._ours, False)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="simulator", daemon=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the thread and the terminal."""
        self._ended.set()
        if self._thread is not threading.current_thread():
            self._thread.join()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the terminal has ended (an unplugging), and return whether it has."""
        return self._ended.wait(timeout)

    def serve(self, description: str) -> int:
        """Name the terminal, and wait for its end or Ctrl-C; return the exit code."""
        sys.stdout.write(f"{self.name}\n")
        sys.stdout.flush()
        sys.stderr.write(f"{description}; stop it with Ctrl-C\n")
        try:
            self.wait()
        except KeyboardInterrupt:
            return 130
        return 0

    def _run(self) -> None:
        try:
            self._serve()
        finally:
            os.close(self._ours)
            if self._theirs is not None:
                os.close(self._theirs)
            self._ended.set()

    @abstractmethod
    def _serve(self) -> None:
        """Pass bytes between the terminal and the simulator until the end."""
