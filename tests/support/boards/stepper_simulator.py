"""The stepper board's firmware in simavr, in virtual time: a Port and a Clock for the driver, pins
and edges for tests. Nothing here waits: a read of the driver advances the time by at most its
timeout.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.support.paths import ROOT

FREQUENCY = 16_000_000
TO_INSTALL = "sudo apt-get install gcc-avr avr-libc simavr libsimavr-dev gcc make"
STEP_PINS = (2, 3, 4, 12)
DIRECTION_PINS = (5, 6, 7, 13)
ONE_MOVE = 8
"""Cycles within which edges are those of one grid move: the fourth axis has another port."""
USB_LATENCY_S = 0.0005
"""Time from the first byte to the delivery of all bytes that came until then: half of the least
that USB serial adapters take.
"""
EDGE = np.dtype(
    [("cycle", np.uint64), ("pin", np.uint8), ("level", np.uint8), ("reserved", np.uint8, 6)]
)
MOST_EDGES = 1 << 16


def missing() -> str:
    """Return the missing programs and headers of the simulator; empty if there are none."""
    tools = [tool for tool in ("avr-gcc", "avr-size", "make", "cc") if shutil.which(tool) is None]
    headers = [] if Path("/usr/include/simavr/sim_avr.h").exists() else ["simavr/sim_avr.h"]
    return ", ".join(tools + headers)


@cache
def built(axes: int = 3, baud: int = 1_000_000) -> Path:
    """Build firmware and simulator, and return their folder.

    Without the compilers the test is skipped; in CI it fails.
    """
    lacking = missing()
    if lacking:
        message = f"{lacking} missing: {TO_INSTALL}"
        if os.environ.get("CI") == "true":
            pytest.fail(message)
        pytest.skip(message)
    folder = ROOT / "build" / f"firmware-{axes}-{baud}"
    # Several test processes may get here at once.
    folder.mkdir(parents=True, exist_ok=True)
    command = [
        "make",
        "-C",
        str(ROOT / "firmware"),
        f"BUILD={folder}",
        f"AXES={axes}",
        f"BAUD={baud}",
        "simulator",
    ]
    subprocess.run(["flock", str(folder), *command], check=True, capture_output=True, text=True)
    return folder


class Simulator:
    """The board. Times are in seconds since power-up, edges in cycles of 16 MHz."""

    def __init__(self, axes: int = 3, baud: int = 1_000_000) -> None:
        self.axes = axes
        folder = built(axes, baud)
        library = ctypes.CDLL(str(folder / "libsimulator.so"))
        library.simulator_new.restype = ctypes.c_void_p
        library.simulator_cycle.restype = ctypes.c_uint64
        library.simulator_run.argtypes = (ctypes.c_void_p, ctypes.c_uint64, ctypes.c_int)
        self._library = library
        self._board = ctypes.c_void_p(
            library.simulator_new(str(folder / "stepper.elf").encode(), baud)
        )
        assert self._board
        self._edges, self._count = np.empty(0, EDGE), 0
        self._buffer = np.empty(MOST_EDGES, EDGE)
        self._target = self._buffer.ctypes.data_as(ctypes.c_void_p)
        self._bytes = ctypes.create_string_buffer(65536)

    def close(self) -> None:
        if self._board:
            self._library.simulator_free(self._board)
            self._board = ctypes.c_void_p()

    @property
    def cycle(self) -> int:
        return int(self._library.simulator_cycle(self._board))

    @property
    def now(self) -> float:
        return self.cycle / FREQUENCY

    def run(self, seconds: float, *, or_byte: bool = False) -> None:
        until = self.cycle + round(seconds * FREQUENCY)
        assert self._library.simulator_run(self._board, until, or_byte) == 0, (
            "the board has crashed"
        )

    def send(self, data: bytes) -> None:
        self._library.simulator_send(self._board, data, len(data))

    def received(self) -> bytes:
        buffer = self._bytes
        count = self._library.simulator_received(self._board, buffer, len(buffer))
        return ctypes.string_at(buffer, count)

    @property
    def on_its_way(self) -> int:
        """Bytes sent that the board has not received yet."""
        return int(self._library.simulator_on_its_way(self._board))

    def set_pin(self, pin: int, level: int) -> None:
        self._library.simulator_set_pin(self._board, pin, level)

    def level(self, pin: int) -> int:
        return int(self._library.simulator_level(self._board, pin) & 0xFF)

    def reset(self) -> None:
        self._library.simulator_reset(self._board)

    @property
    def worst_fill(self) -> int:
        return int(self._library.simulator_worst_fill(self._board))

    @property
    def lost(self) -> int:
        """Bytes lost because the receiver was full."""
        return int(self._library.simulator_lost(self._board))

    @property
    def stack_left(self) -> int:
        return int(self._library.simulator_stack_left(self._board))

    def edges(self) -> NDArray[np.void]:
        """Return all edges of the output pins so far: cycle, pin, level."""
        while count := self._library.simulator_edges(self._board, self._target, MOST_EDGES):
            end = self._count + count
            if end > len(self._edges):
                self._edges = np.concatenate((self._edges, np.empty(2 * end, EDGE)))
            self._edges[self._count : end] = self._buffer[:count]
            self._count = end
        return self._edges[: self._count]

    def moves(self) -> tuple[NDArray[np.int64], NDArray[np.int8]]:
        """Return the grid moves of the pins: cycles (n,) of the rising edges and steps (n, axes).

        Edges of one move share a row.
        """
        edges, axes = self.edges(), self.axes
        level = np.zeros(20, np.int8)
        directions = np.zeros((len(edges), axes), np.int8)
        for axis in range(axes):
            changed = np.flatnonzero(edges["pin"] == DIRECTION_PINS[axis])
            where = np.searchsorted(changed, np.arange(len(edges)), side="right") - 1
            directions[:, axis] = np.where(
                where >= 0,
                edges["level"][changed[np.maximum(where, 0)]] if len(changed) else 0,
                level[0],
            )
        rising = np.flatnonzero(np.isin(edges["pin"], STEP_PINS[:axes]) & (edges["level"] == 1))
        risen = edges["cycle"][rising].astype(np.int64)
        first = np.diff(risen, prepend=-ONE_MOVE - 1) > ONE_MOVE
        cycles, row = risen[first], np.cumsum(first) - 1
        step = np.zeros((len(cycles), axes), np.int8)
        axis_of = np.searchsorted(STEP_PINS, edges["pin"][rising])
        step[row, axis_of] = 1 - 2 * directions[rising, axis_of]
        return cycles, step


class SimulatorPort:
    """The board's serial line for a driver, and the clock of the board."""

    def __init__(self, board: Simulator) -> None:
        self.board = board
        self.closed = False

    def read(self, timeout: float) -> bytes:
        data = self.board.received()
        if not data and timeout > 0:
            self.board.run(timeout, or_byte=True)
            data = self.board.received()
            if data:
                self.board.run(min(timeout, USB_LATENCY_S))
                data += self.board.received()
        return data

    def write(self, data: bytes) -> None:
        self.board.send(data)

    def close(self) -> None:
        self.closed = True

    def now(self) -> float:
        return self.board.now

    def sleep(self, seconds: float) -> None:
        self.board.run(seconds)
