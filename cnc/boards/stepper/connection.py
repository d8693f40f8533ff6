"""The connection to a stepper board: exchange of bytes, requests, and the opening of a board."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

from cnc.boards.port import Clock, Port
from cnc.boards.port_log import LoggedPort
from cnc.boards.protocols import board_error
from cnc.boards.stepper.motor_outputs import FOURTH, MAX_OUTPUTS, MotorOutputs
from cnc.boards.stepper.protocol import VERSION, Alarm, Kind, State, Status, StepperLink, Welcome
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError, Diagnostic

log = logging.getLogger(__name__)

BAUD = 1_000_000
"""Speed of the firmware unless the machine file has another one, bits/s."""
MIN_BAUD = 250_000
"""Lowest speed that the firmware is built for, bits/s."""
STATUS_PERIOD_S = 0.025
"""Time between two requests for the status."""
POLL_S = 0.002
"""Longest wait for bytes before frames may have to be sent again."""
HELLO_S = 4.0
"""Timeout of a board that the opening of its port has reset: its bootloader waits up to 2 s."""
ANSWER_TIMEOUT_S = 0.8
"""Time without an answer after which the board counts as lost."""
ABSENCE_S = 0.2
"""Time without a call of :meth:`Connection.pump` after which the silence is our own."""
MAX_RAMP_S = 0.08
"""Longest emergency ramp."""
S_CURVE_PEAK = 1.5
"""Ratio of the steepest to the mean slope of the S-curve of an emergency ramp."""
TURN_ROUND_TICKS = 8
"""Longest time that the board needs between the rest after a pulse and the next pulse."""
PROBE, EMERGENCY_STOP, RESUME = 0x10, 0x20, 0x80
"""Bits of the inputs."""
INPUTS = {
    "limits": 0x07,
    "probe": PROBE,
    "emergency-stop": EMERGENCY_STOP,
    "hold": 0x40,
    "resume": RESUME,
}
LIMIT_AT_A2 = 0x02
"""Bit of a configuration: A2 is the limit input of the fourth output, not the resume button."""
UNO = Welcome(VERSION, axes=3, tick_ns=500, room=1020, least_ticks=36)
"""The welcome of the firmware of this version on an ATmega328P."""

Pump = Callable[[float], object]
"""A function that sends and receives, and waits at most so many seconds for bytes."""


class AlarmText(NamedTuple):
    """Code, message and hint of an alarm of the board."""

    code: str
    message: str
    hint: str


ALARMS = {
    Alarm.UNDERRUN: AlarmText(
        "board-underrun",
        "moves came too late; the board came to rest on the path",
        "reduce the load of this computer",
    ),
    Alarm.SILENCE: AlarmText(
        "board-silence",
        "the board received nothing from this computer; it came to rest on the path",
        "check the cable",
    ),
    Alarm.EMERGENCY_STOP: AlarmText(
        "board-emergency-stop",
        "the e-stop is pressed",
        "release it when it is safe, then home the machine",
    ),
    Alarm.LIMIT: AlarmText(
        "board-limit",
        "a limit switch was hit",
        "move away from it by hand with the drivers off, then home the machine",
    ),
    Alarm.STOPPED_BY_HOST: AlarmText(
        "board-stopped", "the board was stopped by this computer", "open it again"
    ),
    Alarm.BAD_STREAM: AlarmText(
        "board-stream",
        "the board received moves that it cannot read",
        "update firmware and cncrun to the same version",
    ),
}


class BoardSilent(BoardError):
    """The board does not answer any more."""


class Connection:
    """A port, and the state of the protocol.

    Attributes:
        port: The port.
        clock: Its clock.
        name: Its name, for messages.
        link: State of the protocol.
        status: Last status of the board, None while a new one is awaited.
    """

    def __init__(self, port: Port, clock: Clock, name: str) -> None:
        self.port = LoggedPort(port, name, log, text=False)
        self.clock = clock
        self.name = name
        self.link = StepperLink()
        self.status: Status | None = None
        self._asked_at = self._heard_at = clock.now()

    def pump(self, seconds: float) -> list[Status]:
        """Send waiting frames and receive bytes.

        Args:
            seconds: Longest wait for bytes.

        Returns:
            Statuses received.

        Raises:
            PortLost: The connection is lost.
            BoardSilent: The board does not answer any more.
        """
        now, link = self.clock.now(), self.link
        if now - self._asked_at > ABSENCE_S:
            self._heard_at = now
        if now - self._asked_at >= STATUS_PERIOD_S:
            self._asked_at = now
            link.ask()
        out = link.outgoing(now)
        if out:
            self.port.write(out)
        data = self.port.read(seconds)
        now = self.clock.now()
        found = [event for event in link.receive(data, now) if isinstance(event, Status)]
        for status in found:
            log.debug("%s: %s", self.name, status)
        if found:
            self.status = found[-1]
        self._heard_at = max(self._heard_at, link.heard_at or 0.0)
        if now - self._heard_at > ANSWER_TIMEOUT_S:
            raise self._silent()
        return found

    def ask(self, pump: Pump) -> Status:
        """Return a new status; ``pump`` is called until it is there."""
        self.status = None
        self.link.ask()
        while self.status is None:
            pump(POLL_S)
        return self.status

    def request(self, kind: Kind, payload: bytes, pump: Pump) -> None:
        """Send a request and wait until it is carried out.

        Args:
            kind: The request.
            payload: Its arguments.
            pump: Called until the board has answered.

        Raises:
            BoardError: ``board-refused``, if the board does not carry it out.
        """
        self.link.request(kind, payload, self.clock.now())
        began = self.clock.now()
        while self.link.requesting:
            pump(POLL_S)
            if self.clock.now() - began > ANSWER_TIMEOUT_S:
                self.link.give_up()
                name = kind.name.lower().replace("_", " ")
                raise board_error(
                    "board-refused",
                    f"the board on {self.name} does not carry out the request: {name}",
                    hint="check that the e-stop is not pressed, then switch the board off and on",
                )

    def greet(self, timeout: float = HELLO_S) -> Welcome:
        """Return the board's answer to a hello.

        Args:
            timeout: Longest wait, s. The opening of the port may have reset the board.

        Raises:
            BoardError: ``board-silent`` or ``board-not-stepper``.
        """
        link, clock = self.link, self.clock
        began = clock.now()
        link.hello(began)
        while link.welcome is None:
            out = link.outgoing(clock.now())
            if out:
                self.port.write(out)
            link.receive(self.port.read(POLL_S * 5), clock.now())
            if clock.now() - began > timeout:
                raise _no_stepper(self.name, link.foreign_bytes)
        self._heard_at = clock.now()
        log.info("%s: %s", self.name, link.welcome)
        return link.welcome

    def _silent(self) -> BoardSilent:
        hint = (
            "check cable and supply. A board with power has come to rest by itself. "
            "Home the machine before the next run"
        )
        message = f"the board on {self.name} does not answer any more"
        return BoardSilent(Diagnostic("board-silent", message, hint=hint))


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


def _no_stepper(name: str, received: bytes) -> BoardError:
    """Return the fault of a port without a stepper board, by the bytes received."""
    text = received.decode("ascii", "replace")
    if "Grbl" in text or "grblHAL" in text:
        hint = "use --board grbl, or make flash to install the stepper firmware"
        message = f"the board on {name} runs GRBL, not the stepper firmware"
        return board_error("board-not-stepper", message, hint=hint)
    if received:
        hint = (
            f"check port and board.baud ({BAUD} unless the firmware was built otherwise); "
            "make flash installs the firmware on an Uno"
        )
        message = f"the device on {name} is not a stepper board"
        return board_error("board-not-stepper", message, hint=hint)
    hint = "check the port and the board's supply; make flash installs the firmware on an Uno"
    return board_error("board-silent", f"no device answers on {name}", hint=hint)
