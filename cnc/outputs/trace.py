"""The trace: what the machine does at each sample, as .npz or .csv."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Machine
from cnc.model.streams import SampleChunk
from cnc.outputs.targets import (
    TRACE_SUFFIXES,
    NpzTarget,
    Output,
    TextTarget,
    Writer,
    suffix_of,
)


class TraceWriter(Output, Protocol):
    """Writes samples."""

    def write(self, chunk: SampleChunk) -> None:
        """Append the rows of ``chunk``."""


def trace_writer(name: str, machine: Machine) -> TraceWriter:
    """Return a writer for the format that the suffix selects: .npz or .csv (``-`` is csv).

    Raises:
        UsageError: ``output-format`` for another suffix; ``can-not-write``.
    """
    if suffix_of("trace", name, TRACE_SUFFIXES) == ".csv":
        return CsvTrace(name, machine.axis_names)
    return NpzTrace(name, machine)


class NpzTrace(Writer[NpzTarget]):
    """Samples as arrays: ``t``, ``position``, ``s``, ``feed``, ``accel``, ``jerk``, ``line``.

    The scalars are ``period`` (s) and ``axes``.
    """

    def __init__(self, name: str, machine: Machine) -> None:
        super().__init__(NpzTarget(name))
        target = self._target
        for column in ("t", "s", "feed", "accel", "jerk"):
            target.append(column, np.empty(0))
        target.append("position", np.empty((0, len(machine.axes))))
        target.append("line", np.empty(0, np.int32))
        target.scalar("period", machine.path.period)
        target.scalar("axes", list(machine.axis_names))

    def write(self, chunk: SampleChunk) -> None:
        """Append the rows of ``chunk``."""
        self._target.append("t", sample_times(chunk))
        for column in ("s", "feed", "accel", "jerk", "position", "line"):
            self._target.append(column, getattr(chunk, column))


class CsvTrace(Writer[TextTarget]):
    """Samples as text: t, one column an axis, s, feed, accel, jerk, line.

    Every number has as many digits as it needs to be read back exactly.
    """

    def __init__(self, name: str, axes: Sequence[str]) -> None:
        super().__init__(TextTarget(name))
        self._target.write(",".join(("t", *axes, "s", "feed", "accel", "jerk", "line")) + "\n")

    def write(self, chunk: SampleChunk) -> None:
        """Append the rows of ``chunk``."""
        columns = [
            sample_times(chunk),
            *chunk.position.T,
            chunk.s,
            chunk.feed,
            chunk.accel,
            chunk.jerk,
            chunk.line,
        ]
        rows = zip(*(column.tolist() for column in columns), strict=True)
        self._target.write("".join(",".join(map(repr, row)) + "\n" for row in rows))


def sample_times(chunk: SampleChunk) -> NDArray[np.float64]:
    """Return the time of each row (n,), in seconds since the start of the program."""
    return np.arange(chunk.first, chunk.first + len(chunk.s), dtype=np.float64) * chunk.period
