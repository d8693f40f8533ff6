"""The trace: what the machine does at each sample, as .npz or .csv."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Machine
from cnc.model.streams import SampleChunk
from cnc.report.targets import TRACE_SUFFIXES, NpzTarget, TextTarget, Writer, suffix_of


class NpzTrace(Writer[NpzTarget]):
    """Samples as arrays: ``t``, ``position``, ``s``, ``feed``, ``accel``, ``jerk``, ``line``.

    The scalars are ``period`` (s) and ``axes``. Where the joints are not the axes, ``position`` and
    ``axes`` are those of the joints, and ``tool`` and ``tool_axes`` those of the tool tip.
    """

    def __init__(self, name: str, machine: Machine) -> None:
        super().__init__(NpzTarget(name))
        target = self._target
        for column in ("t", "s", "feed", "accel", "jerk"):
            target.append(column, np.empty(0))
        self._tip = machine.tip_columns
        target.append("position", np.empty((0, len(machine.joint_tables))))
        if self._tip:
            target.append("tool", np.empty((0, self._tip)))
            target.scalar("tool_axes", list(machine.axis_names))
        target.append("line", np.empty(0, np.int32))
        target.scalar("period", machine.path.period)
        target.scalar("axes", list(machine.joint_tables))

    def write(self, chunk: SampleChunk) -> None:
        """Append the rows of ``chunk``."""
        self._target.append("t", sample_times(chunk))
        for column in ("s", "feed", "accel", "jerk", "line"):
            self._target.append(column, getattr(chunk, column))
        self._target.append("position", chunk.position[:, self._tip :])
        if self._tip:
            self._target.append("tool", chunk.position[:, : self._tip])


class CsvTrace(Writer[TextTarget]):
    """Samples as text: t, one column an axis, s, feed, accel, jerk, line.

    Where the joints are not the axes, the columns of the joints come first, those of the tool tip
    last, as ``tool_x``.

    Every number has as many digits as it needs to be read back exactly.
    """

    def __init__(self, name: str, machine: Machine) -> None:
        super().__init__(TextTarget(name))
        self._tip = machine.tip_columns
        names = ["t", *machine.joint_tables, "s", "feed", "accel", "jerk", "line"]
        names += [f"tool_{axis}" for axis in machine.axis_names[: self._tip]]
        self._target.write(",".join(names) + "\n")

    def write(self, chunk: SampleChunk) -> None:
        """Append the rows of ``chunk``."""
        columns = [
            sample_times(chunk),
            *chunk.position[:, self._tip :].T,
            chunk.s,
            chunk.feed,
            chunk.accel,
            chunk.jerk,
            chunk.line,
            *chunk.position[:, : self._tip].T,
        ]
        rows = zip(*(column.tolist() for column in columns), strict=True)
        self._target.write("".join(",".join(map(repr, row)) + "\n" for row in rows))


TraceWriter = NpzTrace | CsvTrace
"""A writer of samples."""


def trace_writer(name: str, machine: Machine) -> TraceWriter:
    """Return a writer for the format that the suffix selects: .npz or .csv (``-`` is csv).

    Raises:
        UsageError: ``output-format`` for another suffix; ``can-not-write``.
    """
    if suffix_of("trace", name, TRACE_SUFFIXES) == ".csv":
        return CsvTrace(name, machine)
    return NpzTrace(name, machine)


def sample_times(chunk: SampleChunk) -> NDArray[np.float64]:
    """Return the time of each row (n,), in seconds since the start of the program."""
    return np.arange(chunk.first, chunk.first + len(chunk.s), dtype=np.float64) * chunk.period
