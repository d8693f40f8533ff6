"""The loopback board: counts steps, keeps positions, and checks pulses as a real board would."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.boards.errors import board_error
from cnc.boards.protocols import BoardTraits, Capabilities, PulseSink
from cnc.machine.models import Machine
from cnc.model.blocks import Block
from cnc.model.diagnostics import BoardError
from cnc.model.streams import PulseChunk

ROUNDING_NS = 1
"""Two pulse times that are rounded to 1 ns may be closer than the exact ones by this much."""
STOP_LATENCY = 0.14
"""Latency of a stop, s: a driver that inherits from this one sends to a board with a buffer."""


class Loopback(PulseSink):
    """A board that plays pulses into counters.

    Faults, each a BoardError at the source line of the row:

    - ``board-format``: wrong type or shape.
    - ``board-step``: a step other than -1, 0, +1, or a row without a step.
    - ``board-order``: decreasing times.
    - ``board-step-rate``: pulses of one axis too close together.
    - ``board-fault``: the fault of ``fail_after``.
    - ``board-not-started``, ``board-stopped``: a call before the start, after a stop or a fault.

    Args:
        axes: Number of columns of a chunk.
        min_pulse_ns: Least time between two pulses of one axis, ns.
        fail_after: Rows after which the board reports a fault, for tests.
        motors: Number of motors of each axis, by default one.

    Attributes:
        motor_steps: Steps forward less steps backward of each motor of each axis since the board
            was opened.
    """

    traits = BoardTraits(has_port=False, simulated=True)

    def __init__(
        self,
        axes: int,
        min_pulse_ns: float = 0.0,
        fail_after: int | None = None,
        motors: Sequence[int] = (),
    ) -> None:
        self.axes = axes
        self.min_pulse_ns = min_pulse_ns
        self.fail_after = fail_after
        self.state = "idle"
        self.commands: list[tuple[int, Block]] = []
        self.rows = 0
        self.motor_steps = [[0] * count for count in (motors or [1] * axes)]
        self._next_alone: tuple[int, int] | None = None
        self._alone: tuple[int, int] | None = None
        self._position = np.zeros(axes, dtype=np.int64)
        self._forward = np.zeros(axes, dtype=np.int64)
        self._backward = np.zeros(axes, dtype=np.int64)
        self._line = 0
        self._last_ns = 0
        self._last_pulse_ns: list[int | None] = [None] * axes

    @classmethod
    def from_machine(cls, machine: Machine, target: Path | None = None) -> Loopback:
        """Open a board with the axes and the step rate of the machine."""
        motors = [len(axis.motors) for axis in machine.axes.values()]
        return cls(len(machine.axes), 1e9 / machine.board.max_step_rate, motors=motors)

    @classmethod
    def with_switches(cls, machine: Machine) -> Loopback:
        """Open a board with simulated limit switches, if the axes of the machine have travels."""
        from cnc.boards.loopback_switches import SwitchedLoopback, switch_places

        places = switch_places(machine)
        return SwitchedLoopback(machine, places) if places else cls.from_machine(machine.of_joints)

    @classmethod
    def for_operator(cls, machine: Machine, start: Sequence[float]) -> Loopback:
        """Open a board in real time, which stands at ``start`` (axes,), mm."""
        from cnc.boards.paced_loopback import PacedLoopback

        return PacedLoopback(machine, start)

    @property
    def capabilities(self) -> Capabilities:
        """Pulses at whole nanoseconds, with the expected answer to each probe and input."""
        rate = 1e9 / self.min_pulse_ns if self.min_pulse_ns else np.inf
        return Capabilities(
            axes=self.axes,
            max_step_rate=rate,
            tick_ns=1.0,
            senses=True,
            stop_latency_s=STOP_LATENCY,
        )

    @property
    def confirmed_line(self) -> int:
        """Source line of the last row or command accepted."""
        return self._line

    @property
    def position_steps(self) -> NDArray[np.int64]:
        """Grid point (axes,)."""
        return self._position.copy()

    @property
    def steps(self) -> NDArray[np.int64]:
        """Number of steps of each axis in both directions together (axes,)."""
        return self._forward + self._backward

    @property
    def steps_by_direction(self) -> NDArray[np.int64]:
        """Number of steps (2, axes): forward, backward."""
        return np.stack((self._forward, self._backward))

    def move_alone(self, column: int, motor: int) -> None:
        """Let only one motor of an axis move between the next start and its end."""
        self._next_alone = column, motor

    def start(self, origin_steps: NDArray[np.int64]) -> None:
        """Begin at a grid point, time 0, with every counter at 0."""
        self._refuse_if_stopped()
        if len(origin_steps) != self.axes:
            raise self._fault(
                "board-format",
                f"the board has {self.axes} axes, the program has {len(origin_steps)}",
                0,
            )
        self._position = np.array(origin_steps, dtype=np.int64)
        self._forward[:] = 0
        self._backward[:] = 0
        self._last_ns = 0
        self._last_pulse_ns = [None] * self.axes
        self.rows = 0
        self.commands.clear()
        self._alone, self._next_alone = self._next_alone, None
        self.state = "running"

    def send(self, chunk: PulseChunk) -> None:
        """Check and count grid moves; the rows before the first wrong one are played."""
        self._refuse_unless_running()
        bad, code, message = self._check(chunk)
        left = len(chunk.step) if self.fail_after is None else self.fail_after - self.rows
        if left < bad:
            bad, code, message = left, "board-fault", f"set to fail after {self.fail_after} rows"
        self._play(chunk, bad)
        if bad < len(chunk.step):
            raise self._fault(code, message, int(chunk.line[bad]))

    def execute(self, block: Block, time_ns: int) -> tuple[float, ...] | None:
        """Record the block and its time; the answer is the expected one."""
        self._refuse_unless_running()
        if time_ns < self._last_ns:
            raise self._fault(
                "board-order", f"a command at {time_ns} ns after {self._last_ns} ns", block.line
            )
        self._last_ns = time_ns
        self._line = block.line
        self.commands.append((time_ns, block))
        expected: tuple[float, ...] | None = getattr(block, "expected", None)
        return expected

    def finish(self) -> None:
        """Return at once, because everything has been played already."""
        self._refuse_unless_running()
        self.state = "idle"

    def stop(self) -> None:
        """Refuse later calls."""
        self.state = "stopped"

    def abort(self) -> None:
        """Refuse later calls."""
        self.state = "stopped"

    def close(self) -> None:
        """Refuse later calls."""
        self.state = "stopped"

    def revive(self) -> None:
        """Accept a next program after a stop; the position stays."""
        self.state = "idle"

    def stand_at(self, position_steps: NDArray[np.int64]) -> None:
        """Set the grid point (axes,), such as that of a probe contact."""
        self._position = np.array(position_steps, dtype=np.int64)

    def _refuse_if_stopped(self) -> None:
        if self.state == "stopped":
            raise board_error("board-stopped", "the board has been stopped", hint="open it anew")

    def _refuse_unless_running(self) -> None:
        self._refuse_if_stopped()
        if self.state != "running":
            raise board_error("board-not-started", "no program has been started on the board")

    def _fault(self, code: str, message: str, line: int) -> BoardError:
        self.state = "stopped"
        return board_error(code, message, line=line)

    def _check(self, chunk: PulseChunk) -> tuple[int, str, str]:
        """Return the index of the first wrong row, and the code and message of its fault.

        The index is the number of rows if all are right.
        """
        time, step, line = chunk.time_ns, chunk.step, chunk.line
        n = len(time)
        types_right = time.dtype == np.int64 and step.dtype == np.int8 and line.dtype == np.int32
        if not types_right or step.shape != (n, self.axes) or line.shape != (n,):
            raise self._fault(
                "board-format",
                f"pulses of type {time.dtype}, {step.dtype}, {line.dtype} and shape {step.shape}",
                0,
            )
        first, code, message = n, "", ""

        def note(wrong: NDArray[np.bool_] | np.bool_, its_code: str, its_message: str) -> None:
            nonlocal first, code, message
            rows = np.flatnonzero(wrong)
            if len(rows) and rows[0] < first:
                first, code, message = int(rows[0]), its_code, its_message

        # By columns, because numpy is slow along short rows.
        columns = [np.ascontiguousarray(step[:, axis]) for axis in range(self.axes)]
        note(np.bitwise_or.reduce(columns) == 0, "board-step", "a row in which no axis steps")
        for column in columns:
            note((column < -1) | (column > 1), "board-step", "a step other than -1, 0 or +1")
        note(
            np.diff(time, prepend=self._last_ns) < 0,
            "board-order",
            "a pulse before the last one sent",
        )
        least = self.min_pulse_ns - ROUNDING_NS
        for axis in range(self.axes):
            rows = np.flatnonzero(columns[axis])
            before = self._last_pulse_ns[axis]
            times = time[rows]
            gaps = np.diff(times) if before is None else np.diff(times, prepend=before)
            close = np.flatnonzero(gaps < least)
            if len(close):
                row = int(rows[close[0] + (1 if before is None else 0)])
                if row < first:
                    gap = int(gaps[close[0]])
                    first, code = row, "board-step-rate"
                    message = (
                        f"pulses of axis {axis} are {gap} ns apart, "
                        f"the board needs {self.min_pulse_ns:.0f} ns"
                    )
        return first, code, message

    def _play(self, chunk: PulseChunk, rows: int) -> None:
        """Count the first ``rows`` rows."""
        if rows <= 0:
            return
        step = chunk.step[:rows]
        self._last_ns = int(chunk.time_ns[rows - 1])
        self._line = int(chunk.line[rows - 1])
        self.rows += rows
        for axis in range(self.axes):
            column = step[:, axis]
            moved = np.flatnonzero(column)
            if len(moved):
                forward = int(np.count_nonzero(column > 0))
                self._forward[axis] += forward
                self._backward[axis] += len(moved) - forward
                change = 2 * forward - len(moved)
                self._position[axis] += change
                for motor in range(len(self.motor_steps[axis])):
                    if self._alone in (None, (axis, motor)):
                        self.motor_steps[axis][motor] += change
                self._last_pulse_ns[axis] = int(chunk.time_ns[moved[-1]])
