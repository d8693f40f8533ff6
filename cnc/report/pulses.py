"""Step pulses as .npz arrays or as a value change dump (.vcd)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Machine
from cnc.model.blocks import TipControl
from cnc.model.streams import PulseChunk
from cnc.planner.joints import Joints
from cnc.report.targets import PULSE_SUFFIXES, NpzTarget, TextTarget, Writer, suffix_of

VCD_PULSE_NS = 1000
"""Width of a pulse in a .vcd file in ns, where the step rate of the board permits it."""


class NpzPulses(Writer[NpzTarget]):
    """Grid moves as arrays: ``time_ns``, ``step``, ``line``.

    The scalars are ``axes``, ``steps_per_mm`` and ``origin_steps``. Where the joints are not the
    axes, ``position`` holds the joints after each grid move, and ``tip`` the tool tip at these
    joints, in mm and degrees. ``tip_axes`` names its columns.
    """

    def __init__(self, name: str, joints: Joints, origin_steps: NDArray[np.int64]) -> None:
        super().__init__(NpzTarget(name))
        target, machine = self._target, joints.machine
        self._joints, self._scale = joints, machine.steps_per_mm
        self._grid = np.array(origin_steps, np.int64)
        self._tips = joints.tips_from(self._grid / self._scale)
        target.append("time_ns", np.empty(0, np.int64))
        target.append("step", np.empty((0, len(machine.axes)), np.int8))
        target.append("line", np.empty(0, np.int32))
        target.scalar("axes", list(machine.axis_names))
        target.scalar("steps_per_mm", machine.steps_per_mm)
        target.scalar("origin_steps", np.asarray(origin_steps, dtype=np.int64))
        if joints.tip_columns:
            target.append("position", np.empty((0, len(machine.axes))))
            target.append("tip", np.empty((0, joints.tip_columns)))
            target.scalar("tip_axes", list(joints.tip_axes))

    def write(self, chunk: PulseChunk) -> None:
        """Append the rows of ``chunk``."""
        for column in ("time_ns", "step", "line"):
            self._target.append(column, getattr(chunk, column))
        if self._joints.tip_columns and len(chunk.step):
            grid = self._grid + np.cumsum(chunk.step, axis=0, dtype=np.int64)
            self._grid = grid[-1]
            position = grid / self._scale
            self._target.append("position", position)
            self._target.append("tip", self._tips(position))

    def control_tip(self, block: TipControl) -> None:
        """Take the tool for the tips of the rows behind."""
        self._joints = self._joints.with_tool(block.offset)
        self._tips = self._joints.tips_from(self._grid / self._scale)


class VcdPulses(Writer[TextTarget]):
    """Grid moves as a value change dump (IEEE 1364).

    Each axis has a step wire and a direction wire; the source line is an integer. A pulse is high
    for 1 us, but at most for half the shortest step period of the board. The direction wire is high
    for positive steps and changes together with the rising edge of the step.
    """

    def __init__(self, name: str, machine: Machine) -> None:
        super().__init__(TextTarget(name))
        self._axes = machine.axis_names
        self._width_ns = max(1, min(VCD_PULSE_NS, int(0.5e9 / machine.board.max_step_rate)))
        self._direction = [-1] * len(self._axes)
        self._line = -1
        self._time_ns = 0
        self._falling_edges: list[tuple[int, str]] = []
        self._write_header()

    def write(self, chunk: PulseChunk) -> None:
        """Append the rows of ``chunk``."""
        out: list[str] = []
        for time, steps, line in zip(
            chunk.time_ns.tolist(), chunk.step.tolist(), chunk.line.tolist(), strict=True
        ):
            self._end_pulses(time, out)
            self._set_time(time, out)
            if line != self._line:
                out.append(f"b{line:b} l\n")
                self._line = line
            for index, step in enumerate(steps):
                if step:
                    if step != self._direction[index]:
                        out.append(f"{int(step > 0)}d{index}\n")
                        self._direction[index] = step
                    out.append(f"1s{index}\n")
                    self._falling_edges.append((time + self._width_ns, f"0s{index}\n"))
        self._target.write("".join(out))

    def control_tip(self, block: TipControl) -> None:
        """Do nothing: the wires are those of the joints."""

    def close(self) -> None:
        """End the last pulses and put the file in place."""
        out: list[str] = []
        if self._falling_edges:
            self._end_pulses(self._falling_edges[-1][0], out)
        self._target.write("".join(out))
        super().close()

    def _write_header(self) -> None:
        wires = "".join(
            f"$var wire 1 s{index} {axis}_step $end\n$var wire 1 d{index} {axis}_dir $end\n"
            for index, axis in enumerate(self._axes)
        )
        values = "".join(f"0s{index}\n0d{index}\n" for index in range(len(self._axes)))
        self._target.write(
            f"$timescale 1 ns $end\n$scope module machine $end\n{wires}"
            "$var integer 32 l line $end\n$upscope $end\n$enddefinitions $end\n"
            f"#0\n$dumpvars\n{values}b0 l\n$end\n"
        )

    def _end_pulses(self, until: int, out: list[str]) -> None:
        """Append the falling edges up to ``until`` ns.

        All pulses have the same width, so that they end in the order in which they began.
        """
        count = 0
        for time, change in self._falling_edges:
            if time > until:
                break
            self._set_time(time, out)
            out.append(change)
            count += 1
        del self._falling_edges[:count]

    def _set_time(self, time: int, out: list[str]) -> None:
        if time != self._time_ns:
            out.append(f"#{time}\n")
            self._time_ns = time


PulseWriter = NpzPulses | VcdPulses
"""A writer of grid moves."""


def pulse_writer(name: str, joints: Joints, origin_steps: NDArray[np.int64]) -> PulseWriter:
    """Return a writer for the format that the suffix selects: .npz or .vcd (``-`` is vcd).

    Args:
        name: the file, or ``-`` for standard output.
        joints: of the machine, with their names and steps per mm.
        origin_steps: (joints,) position in steps at which the first pulse starts.

    Raises:
        UsageError: ``output-format`` for another suffix; ``can-not-write``.
    """
    if suffix_of("pulses", name, PULSE_SUFFIXES) == ".vcd":
        return VcdPulses(name, joints.machine)
    return NpzPulses(name, joints, origin_steps)
