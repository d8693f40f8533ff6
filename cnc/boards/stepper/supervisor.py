"""Supervision of an open stepper board: status reports, buttons, alarms, faults, position."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cnc.boards.loopback import Loopback
from cnc.boards.port import Clock, Port
from cnc.boards.protocols import MotionState, board_error
from cnc.boards.pulse_board import MachinePosition, PulseSupervisor
from cnc.boards.stepper.connection import (
    ALARMS,
    ANSWER_TIMEOUT_S,
    BAUD,
    EMERGENCY_STOP,
    INPUTS,
    LIMIT_AT_A2,
    MAX_RAMP_S,
    POLL_S,
    RESUME,
    S_CURVE_PEAK,
    TURN_ROUND_TICKS,
    AlarmText,
    Connection,
    Pump,
)
from cnc.boards.stepper.outputs import FOURTH, MAX_OUTPUTS, MotorOutputs
from cnc.boards.stepper.protocol import VERSION, Alarm, Kind, State, Status, Welcome
from cnc.boards.stepper.sender import Sender
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError, Diagnostic

# Position of a machine on the stepper board: counts of the board, grid points, coordinates.

LOST = 1 << 30
"""Count at which an axis with an unknown position starts, so that the board remembers this."""


class BoardPosition(MachinePosition):
    """Conversion between the counts of the board and the grid points of a machine.

    Attributes:
        outputs: The motors at the outputs of the board.
    """

    def __init__(self, machine: Machine) -> None:
        super().__init__(machine)
        self.outputs = MotorOutputs(machine)
        self._can_home = machine.can_home

    def restore(self, status: Status) -> NDArray[np.int64]:
        """Take over the position that a board remembers when it is opened.

        Returns:
            Grid point (axes,), 0 for each axis whose position is not known.
        """
        counts = self._counts(status)
        first = counts[: len(self.known)]
        # Motors that a switch stopped at once may have lost steps. A machine that can home must
        # then home again.
        doubtful = self._can_home and status.alarm in (Alarm.LIMIT, Alarm.EMERGENCY_STOP)
        self.known = (np.abs(first) < LOST // 2) & (status.position_known and not doubtful)
        # Motors of an axis that differ were stopped while homing squared them.
        np.logical_and.at(self.known, self.outputs.column, counts == first[self.outputs.column])
        return np.where(self.known, first, 0)

    def of(self, status: Status) -> NDArray[np.int64]:
        """Return the grid point (axes,) of a status; of several motors that move the first."""
        counts = self._counts(status) - self._lost()
        point = np.zeros(len(self.known), np.int64)
        for output in reversed(np.flatnonzero(self.outputs.moving).tolist()):
            point[self.outputs.column[output]] = counts[output]
        return point

    def differing(self, status: Status) -> Sequence[str]:
        """Return the letters of the axes whose moving motors do not agree."""
        counts, point = self._counts(status) - self._lost(), self.of(status)
        wrong = self.outputs.moving & (counts != point[self.outputs.column])
        return [self.letters[column] for column in np.unique(self.outputs.column[wrong])]

    def payload(self, steps: NDArray[np.int64]) -> bytes:
        """Return the payload of SET_POSITION for a grid point (axes,)."""
        outputs = self.outputs
        counts = ((steps[outputs.column] + self._lost()) * outputs.direction).tolist()
        return struct.pack("<4i", *[*counts, 0, 0, 0, 0][:4])

    def _counts(self, status: Status) -> NDArray[np.int64]:
        """Return the counts of the outputs (outputs,) in the directions of their axes."""
        outputs = self.outputs
        return np.array(status.position[: outputs.count], np.int64) * outputs.direction

    def _lost(self) -> NDArray[np.int64]:
        """Return where the counts of the outputs (outputs,) start: LOST for a lost position."""
        outputs = self.outputs
        lost: NDArray[np.int64] = np.where(self.known[outputs.column], 0, LOST).astype(np.int64)
        return lost * outputs.direction

    def letters_of(self, bits: int) -> Sequence[str]:
        """Return the letters of the axes of the limit inputs in a mask."""
        columns = {int(c) for k, c in enumerate(self.outputs.column) if bits >> k & 1}
        return [self.letters[column] for column in sorted(columns)]


# Set-up of a stepper board: whether it suits a machine, its configuration, the end of an alarm.


def pulse_ticks(welcome: Welcome, machine: Machine) -> tuple[int, int]:
    """Return the length of a step pulse, and the least time from its end or a direction to a step.

    Both are in ticks of the board.
    """
    times = machine.board.step_pulse, machine.board.direction_setup
    pulse, setup = (math.ceil(seconds * 1e9 / welcome.tick_ns - 1e-6) for seconds in times)
    return pulse, max(pulse, setup)


def min_spacing_ns(welcome: Welcome, machine: Machine) -> int:
    """Return the least time between two steps of an axis, ns."""
    return (
        max(welcome.least_ticks, sum(pulse_ticks(welcome, machine)) + TURN_ROUND_TICKS)
        * welcome.tick_ns
    )


def baud_of(machine: Machine) -> int:
    """Return the speed of the machine file, else that of the firmware, bits/s."""
    return machine.board.baud if "baud" in machine.board.model_fields_set else BAUD


def open_board(connection: Connection, machine: Machine) -> tuple[Welcome, Status]:
    """Identify the board, check that it suits the machine, and configure it.

    Raises:
        BoardError: The board does not answer, does not suit the machine, or still moves.
    """
    welcome, name = connection.greet(), connection.name
    if welcome.version != VERSION:
        hint = f"make flash PORT={name} installs the right firmware"
        message = (
            f"the firmware of the board on {name} has version {welcome.version} of the protocol, "
            f"this program has {VERSION}"
        )
        raise board_error("board-version", message, hint=hint)
    outputs = MotorOutputs(machine)
    if welcome.axes != outputs.count:
        what = "motors" if outputs.is_gantry else "axes"
        hint = (
            f"use a machine file with {welcome.axes} {what}, "
            f"or make flash AXES={outputs.count} PORT={name}"
        )
        message = f"the machine has {outputs.count} {what}, the board on {name} has {welcome.axes}"
        raise board_error("board-axes", message, hint=hint)
    if outputs.has_fourth_limit and not welcome.fourth_limit:
        hint = f"make flash AXES={outputs.count} PORT={name} installs the present firmware"
        message = f"the firmware of the board on {name} has no limit switch for a fourth motor"
        raise board_error("board-version", message, hint=hint)
    for fault in incompatibilities(machine, min_spacing_ns(welcome, machine)):
        raise BoardError(fault)
    began = connection.clock.now()
    while connection.link.state in (State.RUNNING, State.RAMPING):
        if connection.clock.now() - began > 1.0:
            raise board_error(
                "board-busy",
                f"the board on {name} still moves",
                hint="check that no other program drives it",
            )
        connection.pump(POLL_S)
    limits = outputs.limits
    return welcome, configure(connection, machine, welcome, limits, connection.pump)


def incompatibilities(machine: Machine, spacing_ns: int) -> Iterator[Diagnostic]:
    """Yield the faults of a machine file that make every program impossible on the board.

    The motors of the board are X, Y, Z and a fourth one, in the order of its pins. An axis at
    another position in the file would turn the wrong motor. Joints turn the motors in their order.

    Args:
        machine: The machine.
        spacing_ns: Least time between two steps of an axis, ns.
    """
    letters, outputs = tuple(machine.axes), MotorOutputs(machine)
    expected = letters if machine.has_joints_as_axes else ("x", "y", "z")
    if outputs.is_gantry and outputs.count > MAX_OUTPUTS:
        yield Diagnostic(
            "board-axes",
            f"the machine file has {outputs.count} motors, the board {MAX_OUTPUTS}",
            hint="lower the number of motors of an axis (axes.y.motors)",
        )
    if len(letters) > MAX_OUTPUTS or letters[:3] != expected[:3][: len(letters)]:
        names = " ".join(letter.upper() for letter in letters)
        hint = (
            "write the tables [axes.x], [axes.y], [axes.z] in this order, "
            "then the table of the fourth axis"
        )
        yield Diagnostic(
            "board-axes",
            f"the machine file has the axes {names}, the board X Y Z and a fourth, in this order",
            hint=hint,
        )
    fastest = 1e9 / spacing_ns
    for letter, axis in machine.axes.items():
        if axis.step_rate > fastest:
            velocity = math.floor(fastest / axis.steps_per_mm * 1e3) / 1e3
            hint = f"lower axes.{letter}.max_velocity to {velocity:g} mm/s, or use fewer microsteps"
            message = (
                f"{letter.upper()} may make {axis.step_rate:.0f} steps/s, "
                f"but the board makes at most {fastest:.0f}"
            )
            yield Diagnostic("board-step-rate", message, hint=hint)


def configure(
    connection: Connection, machine: Machine, welcome: Welcome, limits: int, pump: Pump
) -> Status:
    """Configure the board for a machine, and return its status.

    The levels of its inputs are known only after that.

    Args:
        connection: The connection.
        machine: The machine.
        welcome: The board's description of itself.
        limits: Bits of the switches that end the motion.
        pump: Called until the board has answered.

    Raises:
        BoardError: ``board-emergency-stop``.
    """
    stops = [
        axis.max_velocity / axis.max_acceleration
        for axis in machine.axes.values()
        if axis.max_acceleration
    ]
    ramp_ms = round(1e3 * min(S_CURVE_PEAK * max(stops, default=MAX_RAMP_S), MAX_RAMP_S))
    outputs = MotorOutputs(machine)
    inverted = sum(INPUTS[name] for name in set(machine.board.normally_closed))
    drivers = int(machine.board.invert_enable)
    if outputs.has_fourth_limit:
        drivers |= LIMIT_AT_A2
        inverted &= ~RESUME
        if "limits" in machine.board.normally_closed:
            inverted |= FOURTH
    numbers = (
        *pulse_ticks(welcome, machine),
        max(ramp_ms, 4),
        limits & outputs.limits,
        inverted,
        drivers,
    )
    connection.request(Kind.CONFIGURE, bytes(numbers), pump)
    status = connection.ask(pump)
    if status.inputs & EMERGENCY_STOP:
        alarm = ALARMS[Alarm.EMERGENCY_STOP]
        raise board_error(alarm.code, alarm.message, hint=alarm.hint)
    return status


def clear_alarm(
    connection: Connection, machine: Machine, status: Status, limits: int, pump: Pump
) -> None:
    """End an alarm before the next motion.

    Args:
        connection: The connection.
        machine: The machine.
        status: Status of the board.
        limits: Bits of the switches that must be open.
        pump: Called until the board has answered.

    Raises:
        BoardError: ``board-limit``, if one of these switches is pressed.
    """
    outputs = MotorOutputs(machine)
    pressed = [
        letter.upper()
        for column, letter in enumerate(machine.axes)
        if any(status.inputs & limits & outputs.limits & 1 << k for k in outputs.of_axis(column))
    ]
    if pressed:
        hint = (
            "cncrun home moves axes off their switches; else by hand, with the drivers off "
            "(a switch that opens when it is pressed: board.normally_closed)"
        )
        raise board_error(
            "board-limit", f"the limit switch of {' and '.join(pressed)} is pressed", hint=hint
        )
    if connection.link.state != State.IDLE:
        connection.request(Kind.CLEAR, b"", pump)


UNKNOWN_ALARM = AlarmText("board-alarm", "the board has stopped", "open it again")


class Supervisor(PulseSupervisor):
    """An open board, whose every status report is checked.

    Attributes:
        connection: The connection.
        welcome: The board's description of itself.
        status: Last status received.
        position: Conversion of positions.
        least_ns: Least time between two steps of an axis, ns.
        sender: The stream to the board.
        limits: Bits of the switches that end the motion.
    """

    def __init__(self, port: Port, machine: Machine, name: str, clock: Clock) -> None:
        self.connection = Connection(port, clock, name)
        self.position = BoardPosition(machine)
        self.welcome, self.status = open_board(self.connection, machine)
        self.least_ns = min_spacing_ns(self.welcome, machine)
        super().__init__(Loopback(len(machine.axes), self.least_ns))
        outputs = self.position.outputs
        self.sender = Sender(self.connection, outputs.count, self.pump, self.status.taken)
        self.sender.position = self.position.restore(self.status)
        self.limits = outputs.limits
        self._pressed = self.status.holds, self.status.resumes

    @property
    def confirmed_line(self) -> int:
        """Source line that the board is known to have received."""
        return self.connection.link.confirmed_note

    @property
    def grid_point(self) -> NDArray[np.int64]:
        """Grid point at the end of what was sent (axes,), or where the board stopped."""
        return self.sender.position

    @property
    def known_steps(self) -> tuple[int | None, ...]:
        """Grid point of each axis, None where it is not known."""
        return self.position.known_steps(self.sender.position)

    @property
    def motion_state(self) -> MotionState:
        """State according to the last status, some hundredths of a second old."""
        mm = self.position.mm(self.position.of(self.status))
        return MotionState(self.sender.tracker.line, mm, self.sender.ahead_s)

    def close_port(self) -> None:
        """Close the port."""
        self.connection.port.close()

    def pump(self, seconds: float) -> None:
        """Send waiting frames, receive bytes and check the statuses.

        Args:
            seconds: Longest wait for bytes.

        Raises:
            BoardError: Any fault of the board or the connection.
        """
        try:
            statuses = self.connection.pump(seconds)
        except BoardError as error:
            raise self._lost(self._at_line(error)) from error
        for status in statuses:
            self._check(status)

    def _check(self, status: Status) -> None:
        self.sender.update(status)
        self._forward_buttons(status)
        if self.active and not status.position_known:
            hint = "check its supply and its reset line; home the machine before the next run"
            message = f"the board on {self.connection.name} was reset; its position is lost"
            raise self._lost(board_error("board-reset", message, hint=hint))
        self.status = status
        if self.probing and status.state == State.TOUCHED and not self.sender.cut:
            self.sender.cut = True
            self.connection.link.drop()
        if self.active and status.state == State.ALARM:
            raise self._alarm(status)

    def _forward_buttons(self, status: Status) -> None:
        """Turn presses of the buttons into requests. Both buttons together are a hold."""
        (holds, resumes), self._pressed = self._pressed, (status.holds, status.resumes)
        if self.control is not None:
            if status.holds != holds:
                self.control.hold()
            elif status.resumes != resumes:
                self.control.resume()

    def ask(self) -> Status:
        """Return a new status."""
        return self.connection.ask(self.pump)

    def request(self, kind: Kind, payload: bytes) -> None:
        """Send a request and wait until it is carried out."""
        self.connection.request(kind, payload, self.pump)

    def halt(self) -> None:
        """Bring the board to rest on its path, and take over its position."""
        link, clock = self.connection.link, self.connection.clock
        with suppress(BoardError):
            link.drop()
            self.request(Kind.STOP, b"\1")
            began = clock.now()
            while link.state == State.RAMPING and clock.now() - began < ANSWER_TIMEOUT_S:
                self.pump(POLL_S)
            self.take_position(self.ask())
        self.sender.running = False

    def rest(self, time_ns: int) -> None:
        """Wait until the board has played the whole stream, and compare the positions.

        Args:
            time_ns: End of the stream, ns.

        Raises:
            BoardError: ``board-stream``, ``board-position``, or another fault.
        """
        status = self.sender.rest(time_ns)
        if status is None:
            return
        if not self.sender.is_complete(status):
            message = "the board did not play everything that was sent"
            hint = ALARMS[Alarm.BAD_STREAM].hint
            raise self.fail(board_error("board-stream", message, hint=hint))
        sent = self.sender.position
        point = self.take_position(status)
        if differing := self.position.differing(status):
            message = f"the motors of {' and '.join(differing)} do not agree"
            hint = "home the machine; please report this with the program"
            raise self.fail(board_error("board-position", message, hint=hint))
        if not np.array_equal(point, sent):
            message = f"the board is at {self.position.text(point)}, not at the end of its moves"
            hint = "home the machine; please report this with the program"
            raise self.fail(board_error("board-position", message, hint=hint))

    def take_position(self, status: Status) -> NDArray[np.int64]:
        """Take over the position that the board reports; return its grid point (axes,)."""
        point = self.position.of(status)
        self.stopped_short = not np.array_equal(point, self.checks.position_steps)
        self.sender.position = point
        return point

    def fail(self, error: BoardError) -> BoardError:
        """End the use of the board by a fault, and return the fault."""
        self.sender.running = False
        return super().fail(error)

    def _at_line(self, error: BoardError) -> BoardError:
        """Return a fault with the last line that the board is known to have received."""
        finding = error.diagnostic
        if finding.line:
            return error
        return type(error)(replace(finding, line=self.connection.link.confirmed_note))

    def _lost(self, error: BoardError) -> BoardError:
        """End the use of the board; its last report is the best estimate of the position."""
        if self.active:
            self.take_position(self.status)
        self.position.forget()
        return self.fail(error)

    def _alarm(self, status: Status) -> BoardError:
        """End the use of the board by an alarm, with its cause and position."""
        self.take_position(status)
        alarm = ALARMS.get(status.alarm, UNKNOWN_ALARM)
        cause = alarm.message
        if status.alarm == Alarm.LIMIT:
            hit = self.position.letters_of(status.inputs & self.limits)
            cause = f"the limit switch of {' and '.join(hit)} was hit" if hit else cause
        sender = self.sender
        message = f"{cause}; the machine is at {self.position.text(sender.position)}"
        line = sender.tracker.line_at(sender.position) or self.connection.link.confirmed_note
        return self.fail(board_error(alarm.code, message, line=line, hint=alarm.hint))
