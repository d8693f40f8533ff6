"""The Klipper simulator at a pseudo-terminal, in real time (Unix only).

A thread advances the simulator with the clock of this computer. So a program that is stopped or
killed leaves the board running, as a real one.
"""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time

from cnc.boards.klipper.simulator.klipper_simulator import KlipperSimulator

READ_SIZE = 4096
STEP_S = 0.0005
"""Longest time between two advances of the simulator."""


class PtyServer:
    """A terminal with the name ``name``; ``with`` closes it.

    Args:
        simulator: The board. Other threads may use it under ``lock``.
    """

    def __init__(self, simulator: KlipperSimulator) -> None:
        import tty

        self.simulator = simulator
        self.lock = threading.Lock()
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        self.name = os.ttyname(self._theirs)
        os.set_blocking(self._ours, False)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="klipper-simulator", daemon=True)
        self._thread.start()

    def __enter__(self) -> PtyServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the terminal."""
        if not self._ended.is_set():
            self._ended.set()
            self._thread.join()
            os.close(self._ours)
            with contextlib.suppress(OSError):
                os.close(self._theirs)

    def wait(self) -> None:
        """Wait until the terminal ends."""
        while not self._ended.wait(0.2):
            pass

    def _serve(self) -> None:
        simulator = self.simulator
        began = time.monotonic() - simulator.now
        while not self._ended.is_set():
            ready = select.select((self._ours,), (), (), STEP_S)[0]
            with self.lock:
                simulator.advance(max(simulator.now, time.monotonic() - began))
                if ready:
                    with contextlib.suppress(OSError):
                        simulator.write(os.read(self._ours, READ_SIZE))
                data = simulator.read()
            if data:
                # What a host does not read is lost, as at a serial port.
                with contextlib.suppress(OSError):
                    os.write(self._ours, data)
