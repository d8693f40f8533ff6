"""Set-up of a stepper board: whether it suits a machine, its configuration, the end of an alarm."""

from __future__ import annotations

import math
from collections.abc import Iterator

from cnc.boards.errors import board_error
from cnc.boards.stepper.connection import (
    ALARMS,
    BAUD,
    EMERGENCY_STOP,
    INPUTS,
    LIMIT_AT_A2,
    MAX_RAMP_S,
    POLL_S,
    RESUME,
    S_CURVE_PEAK,
    TURN_ROUND_TICKS,
    Connection,
    Pump,
)
from cnc.boards.stepper.motor_outputs import FOURTH, MAX_OUTPUTS, MotorOutputs
from cnc.boards.stepper.protocol import VERSION, Alarm, Kind, State, Status, Welcome
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError, Diagnostic


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
