"""The file board: writes pulses to an archive with ``time_ns``, ``step``, ``line`` and commands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cnc.boards.loopback import Loopback
from cnc.boards.protocols import BoardTraits, Capabilities, PulseSink
from cnc.machine.models import Machine
from cnc.model.blocks import Block
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.model.npz import NpzWriter
from cnc.model.streams import PulseChunk


class FileBoard(PulseSink):
    """Writes pulses to a file (.npz) and checks them as the loopback board does.

    Commands between moves become the arrays ``command_ns`` int64 (k,), ``command_line`` int32 (k,)
    and ``command`` (k,), the kind of block. The file appears on ``finish``, or on ``stop`` with
    everything sent so far. An abort leaves no file.

    Args:
        path: The file.
        axes: Letters of the axes.
        steps_per_mm: Steps/mm of each axis.
        min_pulse_ns: Least time between two pulses of one axis, ns.

    Raises:
        UsageError: ``can-not-write``, on the start, if the folder is not writable.
    """

    traits = BoardTraits(simulated=True)

    def __init__(
        self, path: Path, axes: Sequence[str], steps_per_mm: ArrayLike, min_pulse_ns: float = 0.0
    ) -> None:
        self.path = path
        self.axes = tuple(axes)
        self.steps_per_mm = np.asarray(steps_per_mm, dtype=np.float64)
        self._checks = Loopback(len(self.axes), min_pulse_ns)
        self._writer: NpzWriter | None = None

    @classmethod
    def from_machine(cls, machine: Machine, target: Path | None = None) -> FileBoard:
        """Open the file ``target``, else the file that ``board.port`` names.

        Raises:
            UsageError: ``no-target``, if neither is given.
        """
        if target is None and machine.board.port:
            target = Path(machine.board.port)
        if target is None:
            raise UsageError(
                Diagnostic(
                    "no-target",
                    "the file board needs a file to write",
                    hint="name one with --port FILE.npz",
                )
            )
        return cls(
            target, machine.axis_names, machine.steps_per_mm, 1e9 / machine.board.max_step_rate
        )

    @classmethod
    def for_operator(cls, machine: Machine, start: Sequence[float]) -> FileBoard:
        """Raise UsageError ``no-operation``."""
        hint = "a file is written by cncrun --board file --port FILE.npz"
        raise UsageError(Diagnostic("no-operation", "a file cannot be operated", hint=hint))

    @property
    def capabilities(self) -> Capabilities:
        """Those of the loopback board, without sensors and without a record of its runs."""
        return replace(self._checks.capabilities, senses=False, resumable=False)

    @property
    def confirmed_line(self) -> int:
        """Source line of the last row or command written."""
        return self._checks.confirmed_line

    @property
    def position_steps(self) -> NDArray[np.int64]:
        """Grid point (axes,)."""
        return self._checks.position_steps

    def start(self, origin_steps: NDArray[np.int64]) -> None:
        """Begin a new file."""
        self._checks.start(origin_steps)
        if self._writer is not None:
            self._writer.discard()
        try:
            self._writer = NpzWriter(self.path)
        except OSError as error:
            message = f"{self.path} is not writable: {error.strerror}"
            raise UsageError(
                Diagnostic("can-not-write", message, hint="name a file in a folder that exists")
            ) from error
        self._writer.scalar("axes", list(self.axes))
        self._writer.scalar("steps_per_mm", self.steps_per_mm)
        self._writer.scalar("origin_steps", np.array(origin_steps, dtype=np.int64))
        axes = len(self.axes)
        self._write(
            PulseChunk(np.empty(0, np.int64), np.empty((0, axes), np.int8), np.empty(0, np.int32))
        )

    def send(self, chunk: PulseChunk) -> None:
        """Check and write grid moves."""
        self._checks.send(chunk)
        self._write(chunk)

    def execute(self, block: Block, time_ns: int) -> None:
        """Record the block and its time."""
        self._checks.execute(block, time_ns)

    def finish(self) -> None:
        """Complete the file."""
        self._checks.finish()
        self._complete()

    def stop(self) -> None:
        """Complete the file with everything sent so far."""
        self._checks.stop()
        self._complete()

    def abort(self) -> None:
        """Discard everything sent."""
        self._checks.abort()
        if self._writer is not None:
            self._writer.discard()
            self._writer = None

    def close(self) -> None:
        """Discard a file that was neither finished nor stopped."""
        self.abort()

    def _write(self, chunk: PulseChunk) -> None:
        if self._writer is not None:
            self._writer.append("time_ns", chunk.time_ns)
            self._writer.append("step", chunk.step)
            self._writer.append("line", chunk.line)

    def _complete(self) -> None:
        if self._writer is None:
            return
        commands = self._checks.commands
        self._writer.scalar("command_ns", np.array([time for time, _ in commands], dtype=np.int64))
        self._writer.scalar(
            "command_line", np.array([block.line for _, block in commands], dtype=np.int32)
        )
        self._writer.scalar(
            "command",
            np.array([type(block).__name__.lower() for _, block in commands], dtype=np.str_),
        )
        self._writer.close()
        self._writer = None
