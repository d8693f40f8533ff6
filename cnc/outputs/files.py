"""The public files: blocks, trace, pulses, summary. Each writer takes what comes and keeps nothing:
memory does not grow with the program.

Names, units and meanings are documented in the README and held by ``tests/report``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Machine
from cnc.model import blocks as canon
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.model.streams import PulseChunk, SampleChunk
from cnc.model.units import per_minute
from cnc.outputs.targets import STANDARD_OUTPUT, NpzTarget, TextTarget
from cnc.report.result import Report

VCD_PULSE_NS = 1000
"""Width of a pulse in a .vcd file in ns, where the board's step rate leaves room for it."""


class Output(Protocol):
    """A file being written: in place on ``close``, as it was on ``discard``."""

    def close(self) -> None:
        """Finish the file and put it in place."""

    def discard(self) -> None:
        """Leave what was there before."""


class TraceWriter(Output, Protocol):
    """Takes samples."""

    def write(self, chunk: SampleChunk) -> None:
        """Add rows."""


class PulseWriter(Output, Protocol):
    """Takes grid moves."""

    def write(self, chunk: PulseChunk) -> None:
        """Add rows."""


def trace_writer(name: str, machine: Machine) -> TraceWriter:
    """A trace in the format that the suffix names: .npz or .csv (``-``: csv). UsageError
    ``output-format`` for another.
    """
    if name == STANDARD_OUTPUT or Path(name).suffix.lower() == ".csv":
        return CsvTrace(name, machine.axis_names)
    if Path(name).suffix.lower() == ".npz":
        return NpzTrace(name, machine)
    raise _unknown_format("trace", name, ".npz or .csv")


def pulse_writer(name: str, machine: Machine, origin_steps: NDArray[np.int64]) -> PulseWriter:
    """Pulses in the format that the suffix names: .npz or .vcd (``-``: vcd). UsageError
    ``output-format`` for another.
    """
    if name == STANDARD_OUTPUT or Path(name).suffix.lower() == ".vcd":
        return VcdPulses(name, machine)
    if Path(name).suffix.lower() == ".npz":
        return NpzPulses(name, machine, origin_steps)
    raise _unknown_format("pulses", name, ".npz or .vcd")


def check_formats(trace: str | None, pulses: str | None, lines: str | None = None) -> None:
    """Refuse a suffix that no writer knows, before any work is done."""
    if trace not in (None, STANDARD_OUTPUT) and Path(trace).suffix.lower() not in (".npz", ".csv"):
        raise _unknown_format("trace", trace, ".npz or .csv")
    if pulses not in (None, STANDARD_OUTPUT) and Path(pulses).suffix.lower() not in (
        ".npz",
        ".vcd",
    ):
        raise _unknown_format("pulses", pulses, ".npz or .vcd")
    if lines not in (None, STANDARD_OUTPUT) and Path(lines).suffix.lower() not in (".nc", ".gcode"):
        raise _unknown_format("lines", lines, ".nc or .gcode")


def _unknown_format(what: str, name: str, known: str) -> UsageError:
    return UsageError(
        Diagnostic(
            "output-format",
            f"--{what} {name}: the suffix tells the format",
            hint=f"name a file that ends in {known}",
        )
    )


class JsonLines:
    """Canonical blocks, one JSON object a line. Those of a subroutine in another file than
    ``program`` name their ``file``.
    """

    def __init__(self, name: str, axes: Sequence[str], program: str) -> None:
        self.axes = tuple(axes)
        self._program = program
        self._target = TextTarget(name)

    def write(self, block: canon.Block) -> None:
        """Add a block; a run of moves becomes one object a move."""
        place = {} if block.file == self._program else {"file": block.file}
        self._target.write(
            "".join(
                json.dumps(each | place, allow_nan=False) + "\n"
                for each in block_objects(block, self.axes)
            )
        )

    def passed(self, blocks: Iterable[canon.Block]) -> Iterator[canon.Block]:
        """The same blocks, each written as it goes by."""
        for block in blocks:
            self.write(block)
            yield block

    def close(self) -> None:
        """Put the file in place."""
        self._target.close()

    def discard(self) -> None:
        """Leave what was there before."""
        self._target.discard()


def block_objects(block: canon.Block, axes: Sequence[str]) -> Iterator[dict[str, Any]]:
    """A canonical block as objects of the public schema."""
    if isinstance(block, canon.Polyline):
        for line, end, feed in zip(
            block.lines.tolist(), block.points.tolist(), block.feeds.tolist(), strict=True
        ):
            traverse = math.isnan(feed)
            yield {
                "line": line,
                "kind": "traverse" if traverse else "line",
                "end": dict(zip(axes, end, strict=True)),
                "feed": None if traverse else per_minute(feed),
            }
        return
    kind, fields = _FIELDS[type(block)]
    yield {
        "line": block.line,
        "kind": kind(block) if callable(kind) else kind,
        **fields(block, axes),
    }


def _arc(block: canon.ArcFeed, axes: Sequence[str]) -> dict[str, Any]:
    return {
        "plane": block.plane,
        "center": dict(zip(canon.PLANE_AXES[block.plane], block.center, strict=True)),
        "end": dict(zip(axes, block.end.tolist(), strict=True)),
        "radius": block.radius,
        "turns": block.turns,
        "feed": per_minute(block.feed),
    }


def _nurbs(block: canon.NurbsFeed, axes: Sequence[str]) -> dict[str, Any]:
    return {
        "degree": block.degree,
        "knots": block.knots.tolist(),
        "control_points": block.control_points.tolist(),
        "weights": block.weights.tolist(),
        "axes": list(axes),
        "feed": per_minute(block.feed),
    }


def _spindle(block: canon.Spindle, _: Sequence[str]) -> dict[str, Any]:
    constant = {"surface_speed": per_minute(block.surface_speed)} if block.surface_speed else {}
    return {"state": block.state, "rpm": block.rpm, **constant}


def _overrides(block: canon.Overrides, _: Sequence[str]) -> dict[str, Any]:
    return {
        "feed": block.feed,
        "spindle": block.spindle,
        "adaptive_feed": block.adaptive_feed,
        "feed_stop": block.feed_stop,
    }


def _wait(block: canon.WaitInput, _: Sequence[str]) -> dict[str, Any]:
    return {
        "number": block.number,
        "input": "analog" if block.analog else "digital",
        "mode": block.mode,
        "timeout": block.timeout,
    }


def _probe(block: canon.Probe, axes: Sequence[str]) -> dict[str, Any]:
    end = dict(zip(axes, block.end.tolist(), strict=True))
    return {
        "end": end,
        "feed": per_minute(block.feed),
        "towards": block.towards,
        "must": block.must,
    }


_FIELDS: dict[
    type[canon.Block],
    tuple[str | Callable[[Any], str], Callable[[Any, Sequence[str]], dict[str, Any]]],
] = {
    canon.ArcFeed: ("arc", _arc),
    canon.NurbsFeed: ("nurbs", _nurbs),
    canon.PathMode: (
        "path-mode",
        lambda block, _: {"control": block.control, "tolerance": block.tolerance},
    ),
    canon.Dwell: ("dwell", lambda block, _: {"seconds": block.seconds}),
    canon.Spindle: ("spindle", _spindle),
    canon.Orient: (
        "orient",
        lambda block, _: {
            "angle": block.angle,
            "direction": block.direction,
            "timeout": block.timeout,
        },
    ),
    canon.SpindleSync: ("spindle-sync", lambda block, _: {"pitch": block.pitch}),
    canon.Coolant: ("coolant", lambda block, _: {"mist": block.mist, "flood": block.flood}),
    canon.Tool: (
        lambda block: "tool" if block.change else "tool-in-spindle",
        lambda block, _: {"number": block.number},
    ),
    canon.Stop: (
        lambda block: (
            "optional-stop" if block.optional else "pallet-stop" if block.pallet else "stop"
        ),
        lambda block, _: {},
    ),
    canon.End: ("end", lambda block, _: {}),
    canon.Abort: ("abort", lambda block, _: {}),
    canon.Message: ("message", lambda block, _: {"text": block.text}),
    canon.Overrides: ("overrides", _overrides),
    canon.DigitalOutput: (
        "digital-output",
        lambda block, _: {"number": block.number, "on": block.on, "with_motion": block.with_motion},
    ),
    canon.AnalogOutput: (
        "analog-output",
        lambda block, _: {
            "number": block.number,
            "value": block.value,
            "with_motion": block.with_motion,
        },
    ),
    canon.WaitInput: ("wait-input", _wait),
    canon.Probe: ("probe", _probe),
    canon.BoardCommand: ("board-command", lambda block, _: {"text": block.text}),
}


class NpzTrace:
    """Samples as arrays: ``t``, ``position``, ``s``, ``feed``, ``accel``, ``jerk``, ``line``;
    scalars ``period``, ``axes``.
    """

    def __init__(self, name: str, machine: Machine) -> None:
        self._target = NpzTarget(name)
        writer = self._target
        for column in ("t", "s", "feed", "accel", "jerk"):
            writer.append(column, np.empty(0))
        writer.append("position", np.empty((0, len(machine.axes))))
        writer.append("line", np.empty(0, np.int32))
        writer.scalar("period", machine.path.period)
        writer.scalar("axes", list(machine.axis_names))

    def write(self, chunk: SampleChunk) -> None:
        """Add rows."""
        writer = self._target
        writer.append("t", sample_times(chunk))
        for column in ("s", "feed", "accel", "jerk", "position", "line"):
            writer.append(column, getattr(chunk, column))

    def close(self) -> None:
        """Put the file in place."""
        self._target.close()

    def discard(self) -> None:
        """Leave what was there before."""
        self._target.discard()


class CsvTrace:
    """Samples as text: t, one column an axis, s, feed, accel, jerk, line; every float with as many
    digits as it has.
    """

    def __init__(self, name: str, axes: Sequence[str]) -> None:
        self._target = TextTarget(name)
        self._target.write(",".join(("t", *axes, "s", "feed", "accel", "jerk", "line")) + "\n")

    def write(self, chunk: SampleChunk) -> None:
        """Add rows."""
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

    def close(self) -> None:
        """Put the file in place."""
        self._target.close()

    def discard(self) -> None:
        """Leave what was there before."""
        self._target.discard()


def sample_times(chunk: SampleChunk) -> NDArray[np.float64]:
    """Seconds since the program's start of each row."""
    return np.arange(chunk.first, chunk.first + len(chunk.s), dtype=np.float64) * chunk.period


class NpzPulses:
    """Grid moves as arrays: ``time_ns``, ``step``, ``line``; scalars ``axes``, ``steps_per_mm``,
    ``origin_steps``.
    """

    def __init__(self, name: str, machine: Machine, origin_steps: NDArray[np.int64]) -> None:
        self._target = NpzTarget(name)
        writer = self._target
        writer.append("time_ns", np.empty(0, np.int64))
        writer.append("step", np.empty((0, len(machine.axes)), np.int8))
        writer.append("line", np.empty(0, np.int32))
        writer.scalar("axes", list(machine.axis_names))
        writer.scalar("steps_per_mm", machine.steps_per_mm)
        writer.scalar("origin_steps", np.asarray(origin_steps, dtype=np.int64))

    def write(self, chunk: PulseChunk) -> None:
        """Add rows."""
        for column in ("time_ns", "step", "line"):
            self._target.append(column, getattr(chunk, column))

    def close(self) -> None:
        """Put the file in place."""
        self._target.close()

    def discard(self) -> None:
        """Leave what was there before."""
        self._target.discard()


class VcdPulses:
    """Grid moves as a value change dump (IEEE 1364): for each axis a step and a direction wire, and
    the source line as a number.

    A pulse is 1 us high, less where the board's step rate would not let it fall before the axis's
    next. The direction wire is high for positive steps and changes with the pulse that it belongs
    to.
    """

    def __init__(self, name: str, machine: Machine) -> None:
        self._axes = machine.axis_names
        self._width = max(1, min(VCD_PULSE_NS, int(0.5e9 / machine.board.max_step_rate)))
        self._direction = [-1] * len(self._axes)
        self._line = -1
        self._now = -1
        self._falls: list[tuple[int, str]] = []
        self._target = TextTarget(name)
        self._target.write("$timescale 1 ns $end\n$scope module machine $end\n")
        for index, axis in enumerate(self._axes):
            self._target.write(
                f"$var wire 1 s{index} {axis}_step $end\n$var wire 1 d{index} {axis}_dir $end\n"
            )
        self._target.write(
            "$var integer 32 l line $end\n$upscope $end\n$enddefinitions $end\n#0\n$dumpvars\n"
        )
        for index in range(len(self._axes)):
            self._target.write(f"0s{index}\n0d{index}\n")
        self._target.write("b0 l\n$end\n")
        self._now = 0

    def write(self, chunk: PulseChunk) -> None:
        """Add rows."""
        out: list[str] = []
        for time, steps, line in zip(
            chunk.time_ns.tolist(), chunk.step.tolist(), chunk.line.tolist(), strict=True
        ):
            self._fall(time, out)
            self._at(time, out)
            if line != self._line:
                out.append(f"b{line:b} l\n")
                self._line = line
            for index, step in enumerate(steps):
                if step:
                    if step != self._direction[index]:
                        out.append(f"{int(step > 0)}d{index}\n")
                        self._direction[index] = step
                    out.append(f"1s{index}\n")
                    self._falls.append((time + self._width, f"0s{index}\n"))
        self._target.write("".join(out))

    def close(self) -> None:
        """Put the file in place."""
        out: list[str] = []
        if self._falls:
            self._fall(self._falls[-1][0], out)
        self._target.write("".join(out))
        self._target.close()

    def discard(self) -> None:
        """Leave what was there before."""
        self._target.discard()

    def _fall(self, until: int, out: list[str]) -> None:
        """End the pulses that are over at ``until``; all are equally long, so they end in the order
        in which they began.
        """
        over = 0
        for time, change in self._falls:
            if time > until:
                break
            self._at(time, out)
            out.append(change)
            over += 1
        del self._falls[:over]

    def _at(self, time: int, out: list[str]) -> None:
        if time != self._now:
            out.append(f"#{time}\n")
            self._now = time


def write_json(name: str, summary: Report | Sequence[Report]) -> None:
    """The summary of a program, or a list of them."""
    write_object(
        name,
        summary.as_json()
        if isinstance(summary, Report)
        else [report.as_json() for report in summary],
    )


def write_object(name: str, shown: Any) -> None:
    """Numbers, texts, lists and tables as JSON."""
    target = TextTarget(name)
    try:
        target.write(json.dumps(shown, indent=2, allow_nan=False) + "\n")
        target.close()
    finally:
        target.discard()
