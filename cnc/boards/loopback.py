"""The loopback board: counts steps, keeps positions, and checks pulses as a real board would.

One variant has simulated limit switches, another plays in real time.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.boards.port import Clock, SystemClock
from cnc.boards.protocols import BoardTraits, Capabilities, MotionState, PulseSink, board_error
from cnc.kinematics.planar import CoreXY, CoreXZ
from cnc.machine.models import Homing, Machine, switch_end
from cnc.model.blocks import Block, Dwell, SwitchMove
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
        if not isinstance(axes, int):
            message = f"Loopback takes the number of axes, not {axes!r}: Loopback(3)"
            raise TypeError(f"{message}, or Loopback.from_machine(load_machine())")
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
        places = switch_places(machine)
        return SwitchedLoopback(machine, places) if places else cls.from_machine(machine.of_joints)

    @classmethod
    def for_operator(cls, machine: Machine, start: Sequence[float]) -> Loopback:
        """Open a board in real time, which stands at ``start`` (axes,), mm."""
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


# The loopback board with simulated limit switches, which rehearses homing and squaring.
#
# On CoreXY and CoreXZ a switch follows its axis, which both motors move; elsewhere it follows its
# motor.

SwitchPlaces = Mapping[tuple[int, int], tuple[int, float]]
"""Direction and place of the switch of each motor (column, motor), in steps of that motor from its
place when the board is opened; on CoreXY and CoreXZ of each axis (column, 0), in mm.
"""
ROUNDING = 1e-9
"""mm."""


class SwitchedLoopback(Loopback):
    """A loopback board in which each motor of an axis has a limit switch.

    Args:
        machine: The machine.
        places: The switches. Without it the leading axes that have a travel have theirs, and the
            machine stands at zero or at the nearest point of the travel.
    """

    def __init__(self, machine: Machine, places: SwitchPlaces | None = None) -> None:
        joints = machine.of_joints
        super().__init__(
            len(joints.axes),
            1e9 / machine.board.max_step_rate,
            motors=[len(axis.motors) for axis in joints.axes.values()],
        )
        self.places = dict(switch_places(machine) if places is None else places)
        self._moved_by = _moved_by(machine)
        self._scale = joints.steps_per_mm
        self._known: tuple[bool, ...] = (False,) * self.axes
        self._armed: SwitchMove | None = None
        self._cut = False

    @property
    def capabilities(self) -> Capabilities:
        """Those of the loopback board, with limit switches."""
        return replace(super().capabilities, limit_switches=True)

    @property
    def known_steps(self) -> tuple[int | None, ...]:
        """Grid point of each axis; None before it is homed."""
        steps = self.position_steps.tolist()
        return tuple(s if k else None for s, k in zip(steps, self._known, strict=True))

    @property
    def motor_switches(self) -> tuple[tuple[bool, ...], ...]:
        """Whether each switch of each axis that has one is closed, in the order of the motors."""
        return tuple(
            tuple(self._closed(column, motor) for motor in self._motors(column))
            for column in sorted({column for column, _ in self.places})
        )

    def prepare_next_start(self, *, watched: Sequence[bool], known: Sequence[bool]) -> None:
        """Take over which positions are known; no switch ends another axis' motion."""
        self._known = tuple(known)

    def execute(self, block: Block, time_ns: int) -> tuple[float, ...] | None:
        """Record the block; a move to a switch ends where the switch changes."""
        expected = super().execute(block, time_ns)
        if not isinstance(block, SwitchMove):
            return expected
        self._armed, self._cut = block, False
        return None

    def send(self, chunk: PulseChunk) -> None:
        """Check and count grid moves, up to the change of the switch that is armed."""
        if self._cut:
            return
        rows = len(chunk.step) if self._armed is None else self._rows_to_change(self._armed, chunk)
        self._cut = rows < 0
        rows = abs(rows)
        super().send(PulseChunk(chunk.time_ns[:rows], chunk.step[:rows], chunk.line[:rows]))

    def probe_result(self) -> tuple[float, ...] | None:
        """Return whether the last move to a switch reached it, and the position, mm."""
        if self._armed is None:
            return None
        reached, self._armed, self._cut = self._cut, None, False
        return (float(reached), *(self.position_steps / self._scale).tolist())

    def _motors(self, column: int) -> list[int]:
        """Return the motors that have a switch in a column."""
        return sorted(motor for moved, motor in self.places if moved == column)

    def _closed(self, column: int, motor: int, ahead: float = 0.0) -> bool:
        """Return whether a switch is closed; ``ahead`` is a further travel of its axis."""
        towards, at = self.places[column, motor]
        shares = self._moved_by[column].items()
        here = sum(share * self.motor_steps[joint][motor] for joint, share in shares)
        return bool((here + ahead - at) * towards >= -ROUNDING)

    def _rows_to_change(self, block: SwitchMove, chunk: PulseChunk) -> int:
        """Return the number of rows to the change of a switch, negative; all rows without one."""
        column, count = block.switch, len(chunk.step)
        motors = self._motors(column) if block.motor is None else (block.motor,)
        travel = sum(share * chunk.step[:, k] for k, share in self._moved_by[column].items())
        ways = np.cumsum(travel).tolist()
        first = count + 1
        for motor in motors:
            if self._alone in (None, (column, motor)):
                changed = (
                    row
                    for row, way in enumerate(ways, 1)
                    if self._closed(column, motor, way) == block.towards
                )
                first = min(first, next(changed, count + 1))
        return -first if first <= count else count


def switch_places(machine: Machine) -> SwitchPlaces:
    """Return the switches of the leading axes that have a travel, as homing settings place them."""
    places: dict[tuple[int, int], tuple[int, float]] = {}
    belts = machine.kinematics.axes if isinstance(machine.kinematics, CoreXY | CoreXZ) else ()
    axes = machine.axes if belts else machine.of_joints.axes
    for column, (letter, axis) in enumerate(axes.items()):
        if axis.travel is None:
            break
        settings = axis.homing or Homing()
        towards = switch_end(letter, settings)
        rest = axis.travel[1 if towards > 0 else 0]
        rest = rest if settings.position is None else settings.position
        stands = min(max(0.0, axis.travel[0]), axis.travel[1])
        for motor, motor_table in enumerate(axis.motors):
            at = rest + towards * settings.pull_off + motor_table.offset - stands
            in_steps = letter not in belts
            places[column, motor] = towards, round(at * axis.steps_per_mm) if in_steps else at
    return places


def _moved_by(machine: Machine) -> list[dict[int, float]]:
    """Return by which joints each axis with a switch moves: its travel for a step of each joint.

    That is one step of its own joint. Belts move it by mm: x = (a + b) / 2, y = (a - b) / 2.
    """
    kinematics, joints = machine.kinematics, machine.of_joints
    names = [str(name) for name in joints.axes]
    if not isinstance(kinematics, CoreXY | CoreXZ):
        return [{column: 1} for column in range(len(names))]
    a, b = (names.index(joint) for joint in kinematics.joints)
    half_a, half_b = 0.5 / joints.steps_per_mm[a], 0.5 / joints.steps_per_mm[b]
    first, second = kinematics.axes
    belts = {first: {a: half_a, b: half_b}, second: {a: half_a, b: -half_b}}
    return [belts[name] if name in belts else {names.index(name): 1} for name in machine.axes]


# The loopback board in real time: it takes pulses no faster than a machine would play them.
#
# The console uses it where the machine file names the loopback board, so that an operator can jog,
# hold and override without a machine.

HORIZON = 0.04
"""Motion that the board accepts ahead of its clock, s."""
PACED_STOP_LATENCY = HORIZON + 0.02
"""Latency of a stop, s: the horizon and two slices."""
SLICE = 0.01
"""Length of a slice, s."""
ABORT_POLL = 0.05
"""Longest wait until an abort takes effect, s."""


class PacedLoopback(Loopback):
    """A loopback board with a clock, which keeps its position between programs.

    Args:
        machine: The machine, whose axes are the joints.
        start: Position when it is switched on (axes,), mm.
        clock: The clock.
    """

    def __init__(
        self, machine: Machine, start: Sequence[float], clock: Clock | None = None
    ) -> None:
        super().__init__(len(machine.axes), 1e9 / machine.board.max_step_rate)
        self._steps_per_mm = machine.steps_per_mm
        self._position = np.rint(np.asarray(start) * self._steps_per_mm).astype(np.int64)
        self._clock = clock or SystemClock()
        self._zero = self._clock.now()
        self._aborted = threading.Event()
        self._end_ns = 0
        self._sent: deque[tuple[int, int, NDArray[np.int64]]] = deque()
        self._played: tuple[int, NDArray[np.int64]] = (0, self._position.copy())

    @property
    def capabilities(self) -> Capabilities:
        """Those of the loopback board, with slices for an operator."""
        return replace(super().capabilities, slice_s=SLICE, stop_latency_s=PACED_STOP_LATENCY)

    @property
    def known_steps(self) -> tuple[int | None, ...]:
        """Grid point of each axis (axes,)."""
        return tuple(self._position.tolist())

    @property
    def motion_state(self) -> MotionState:
        """State of the motion by the clock."""
        now_ns = (self._clock.now() - self._zero) * 1e9
        sent = self._sent
        while sent and sent[0][0] <= now_ns:
            _, line, point = sent.popleft()
            self._played = line, point
        line, point = self._played
        ahead = max(0.0, (self._end_ns - now_ns) * 1e-9) if self.state == "running" else 0.0
        return MotionState(line, tuple((point / self._steps_per_mm).tolist()), ahead)

    def start(self, origin_steps: NDArray[np.int64]) -> None:
        """Begin at a grid point; the clock begins at 0."""
        super().start(origin_steps)
        self._aborted.clear()
        self._zero, self._end_ns = self._clock.now(), 0
        self._sent.clear()
        self._played = 0, self._position.copy()

    def send(self, chunk: PulseChunk) -> None:
        """Accept grid moves; returns when the clock is near their end."""
        if len(chunk.time_ns):
            self._begin(int(chunk.time_ns[0]))
        super().send(chunk)
        if len(chunk.time_ns):
            self._end_ns = int(chunk.time_ns[-1])
            self._sent.append((self._end_ns, int(chunk.line[-1]), self._position.copy()))
            self._wait(self._end_ns * 1e-9 - HORIZON)

    def execute(self, block: Block, time_ns: int) -> tuple[float, ...] | None:
        """Carry out a block at its time by the clock."""
        self._begin(time_ns)
        answer = super().execute(block, time_ns)
        seconds = block.seconds if isinstance(block, Dwell) else 0.0
        self._end_ns = max(self._end_ns, time_ns + math.ceil(seconds * 1e9))
        self._wait(self._end_ns * 1e-9 - HORIZON)
        return answer

    def finish(self) -> None:
        """Return when the clock has reached the end."""
        self._wait(self._end_ns * 1e-9)
        super().finish()
        self._sent.clear()
        self._played = self._line, self._position.copy()

    def stop(self) -> None:
        """Return when the clock has reached the end of the motion; refuse later calls."""
        self._wait(self._end_ns * 1e-9)
        super().stop()

    def abort(self) -> None:
        """Stop at once."""
        self._aborted.set()
        super().abort()

    def _begin(self, time_ns: int) -> None:
        """Move the clock back where the motion waited: for the operator, or for the computer."""
        late = self._clock.now() - self._zero - time_ns * 1e-9
        if late > 0.0:
            self._zero += late

    def _wait(self, until: float) -> None:
        while not self._aborted.is_set():
            left = until - (self._clock.now() - self._zero)
            if left <= 0.0:
                return
            self._clock.sleep(min(left, ABORT_POLL))
