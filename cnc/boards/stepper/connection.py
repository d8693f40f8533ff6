"""A stepper board at the other end of a port: what goes to and fro, whether it is one, and whether
it can drive the machine.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator

from cnc.boards.port import Clock, Port
from cnc.boards.port_log import LoggedPort
from cnc.boards.protocols import board_error
from cnc.boards.stepper.protocol import VERSION, Alarm, Kind, State, Status, StepperLink, Welcome
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError, Diagnostic

log = logging.getLogger(__name__)

BAUD = 1_000_000
"""The firmware's speed unless the machine file names another."""
MIN_BAUD = 250_000
"""Lowest speed that the firmware is built for, bits/s."""
ASK_S = 0.025
"""So often the board is asked how it does."""
BREATH_S = 0.002
"""Longest wait for bytes before something may have to be sent again."""
HELLO_S = 4.0
"""A board that was reset by the opening of its port is up within this: its bootloader waits for 2 s
at most.
"""
ANSWER_S = 0.8
"""A board that says nothing for this long is not there any more."""
AWAY_S = 0.2
"""After so long without a look at the port the board's silence is our own."""
MOST_RAMP_S, SHAPE = 0.08, 1.5
"""Emergency ramps: the longest, and the steepest slope of their S over its mean."""
MOST_AXES = 4
TURN_ROUND_TICKS = 8
"""What the board needs between the end of a pulse's rest and the next pulse, at most."""
LIMITS, PROBE, EMERGENCY_STOP = 0x07, 0x10, 0x20
"""Bits of the inputs."""
UNO = Welcome(VERSION, axes=3, tick_ns=500, room=1020, least_ticks=36)
"""What the firmware of this version tells on an ATmega328P."""
INPUTS = {
    "limits": LIMITS,
    "probe": PROBE,
    "emergency-stop": EMERGENCY_STOP,
    "hold": 0x40,
    "resume": 0x80,
}

ALARMS = {
    Alarm.UNDERRUN: ("board-underrun", "moves did not come in time; the board came to rest on the path", "is this computer busy?"),
    Alarm.SILENCE: ("board-silence", "the board did not hear from this computer; it came to rest on the path", "check the cable"),
    Alarm.EMERGENCY_STOP: ("board-emergency-stop", "the e-stop is pressed", "release it when all is well, then home the machine"),
    Alarm.LIMIT: ("board-limit", "a limit switch was hit", "move away from it by hand with the drivers off, then home the machine"),
    Alarm.STOPPED_BY_HOST: ("board-stopped", "the board was told to stop", "open it anew"),
    Alarm.BAD_STREAM: ("board-stream", "the board got moves that it can't read", "update firmware and cncrun to the same version"),
}  # fmt: skip


class BoardSilent(BoardError):
    """The board does not answer any more."""


class Connection:
    """A port, and the protocol's state."""

    def __init__(self, port: Port, clock: Clock, name: str) -> None:
        self.port = LoggedPort(port, name, log, text=False)
        self.clock = clock
        self.name = name
        self.link = StepperLink()
        self.status: Status | None = None
        self._asked_at = self._heard_at = clock.now()

    def pump(self, seconds: float) -> list[Status]:
        """Send what is to be sent, take in what has come, waiting at most so long for it. PortLost,
        BoardSilent.
        """
        now, link = self.clock.now(), self.link
        if now - self._asked_at > AWAY_S:
            self._heard_at = now
        if now - self._asked_at >= ASK_S:
            self._asked_at = now
            link.ask()
        out = link.outgoing(now)
        if out:
            self.port.write(out)
        data = self.port.read(seconds)
        now = self.clock.now()
        said = [event for event in link.receive(data, now) if isinstance(event, Status)]
        for status in said:
            log.debug("%s: %s", self.name, status)
        if said:
            self.status = said[-1]
        self._heard_at = max(self._heard_at, link.heard_at or 0.0)
        if now - self._heard_at > ANSWER_S:
            hint = "check cable and supply; a board that has power has come to rest by itself. Home the machine before the next run"
            raise BoardSilent(
                board_error(
                    "board-silent", f"the board on {self.name} does not answer any more", hint=hint
                ).diagnostic
            )
        return said

    def ask(self, pump: Callable[[float], object]) -> Status:
        """A fresh status; ``pump`` is called until it is there."""
        self.status = None
        self.link.ask()
        while self.status is None:
            pump(BREATH_S)
        return self.status

    def request(self, kind: Kind, payload: bytes, pump: Callable[[float], object]) -> None:
        """Have something done. BoardError ``board-refused`` if the board does not do it."""
        self.link.request(kind, payload, self.clock.now())
        began = self.clock.now()
        while self.link.requesting:
            pump(BREATH_S)
            if self.clock.now() - began > ANSWER_S:
                self.link.give_up()
                what = kind.name.lower().replace("_", " ")
                hint = "is the e-stop pressed? Switch the board off and on"
                raise board_error(
                    "board-refused",
                    f"the board on {self.name} does not do what it is told: {what}",
                    hint=hint,
                )

    def greet(self, patience: float = HELLO_S) -> Welcome:
        """The board's answer to hello, within so many s. Opening its port may have reset it: it is
        asked until it is up.
        """
        link, clock = self.link, self.clock
        began = clock.now()
        link.hello(began)
        while link.welcome is None:
            out = link.outgoing(clock.now())
            if out:
                self.port.write(out)
            link.receive(self.port.read(BREATH_S * 5), clock.now())
            if clock.now() - began > patience:
                raise _no_stepper(self.name, link.murmur)
        self._heard_at = clock.now()
        log.info("%s: %s", self.name, link.welcome)
        return link.welcome


def pulse_ticks(welcome: Welcome, machine: Machine) -> tuple[int, int]:
    """How long a step pin is high, and how long it is low after that and a direction is there
    before, at least.
    """
    times = machine.board.step_pulse, machine.board.direction_setup
    pulse, setup = (math.ceil(seconds * 1e9 / welcome.tick_ns - 1e-6) for seconds in times)
    return pulse, max(pulse, setup)


def least_ns(welcome: Welcome, machine: Machine) -> int:
    """Smallest time between two steps of an axis."""
    return (
        max(welcome.least_ticks, sum(pulse_ticks(welcome, machine)) + TURN_ROUND_TICKS)
        * welcome.tick_ns
    )


def opened(connection: Connection, machine: Machine) -> tuple[Welcome, Status]:
    """Find out what answers, whether it can do what the machine needs, and get it ready. BoardError
    says what is in the way.
    """
    welcome, name = connection.greet(), connection.name
    if welcome.version != VERSION:
        hint = f"make flash PORT={name} puts the right firmware on it"
        message = f"the firmware of the board on {name} speaks version {welcome.version} of the protocol, this program {VERSION}"
        raise board_error("board-version", message, hint=hint)
    if welcome.axes != len(machine.axes):
        hint = f"use a machine file with {welcome.axes} axes, or make flash AXES={len(machine.axes)} PORT={name}"
        message = f"the machine has {len(machine.axes)} axes, the board on {name} {welcome.axes}"
        raise board_error("board-axes", message, hint=hint)
    for fault in unfit(machine, least_ns(welcome, machine)):
        raise BoardError(fault)
    began = connection.clock.now()
    while connection.link.state in (State.RUNNING, State.RAMPING):
        if connection.clock.now() - began > 1.0:
            raise board_error(
                "board-busy",
                f"the board on {name} still moves",
                hint="is another program driving it?",
            )
        connection.pump(BREATH_S)
    return welcome, configured(connection, machine, welcome, LIMITS, connection.pump)


def unfit(machine: Machine, least: int) -> Iterator[Diagnostic]:
    """What no board whose steps are so many ns apart can do for this machine, whatever its program.

    The board's motors are X, Y, Z and a fourth one in the order of its pins: an axis elsewhere in
    the file would turn another's.
    """
    letters = tuple(machine.axes)
    if len(letters) > MOST_AXES or letters[:3] != ("x", "y", "z")[: len(letters)]:
        names = " ".join(letter.upper() for letter in letters)
        hint = "write the tables [axes.x], [axes.y], [axes.z] in this order, then that of the fourth axis"
        yield Diagnostic(
            "board-axes",
            f"the machine file has the axes {names}, the board X Y Z and a fourth, in this order",
            hint=hint,
        )
    fastest = 1e9 / least
    for letter, axis in machine.axes.items():
        if axis.step_rate > fastest:
            velocity = math.floor(fastest / axis.steps_per_mm * 1e3) / 1e3
            hint = f"lower axes.{letter}.max_velocity to {velocity:g} mm/s, or use fewer microsteps"
            message = f"{letter.upper()} may step {axis.step_rate:.0f} times a second, the board {fastest:.0f} times"
            yield Diagnostic("board-step-rate", message, hint=hint)


def configured(
    connection: Connection,
    machine: Machine,
    welcome: Welcome,
    limits: int,
    pump: Callable[[float], object],
) -> Status:
    """The board at rest, told how the machine is built: before it knows its switches it can't tell
    how they are.

    limits: bits of the switches that end its motion. BoardError ``board-emergency-stop``.
    """
    stops = [
        axis.max_velocity / axis.max_acceleration
        for axis in machine.axes.values()
        if axis.max_acceleration
    ]
    ramp_ms = round(1e3 * min(SHAPE * max(stops, default=MOST_RAMP_S), MOST_RAMP_S))
    inverted = sum(INPUTS[name] for name in set(machine.board.normally_closed))
    limits &= LIMITS & (1 << len(machine.axes)) - 1
    numbers = (
        *pulse_ticks(welcome, machine),
        max(ramp_ms, 4),
        limits,
        inverted,
        int(machine.board.invert_enable),
    )
    connection.request(Kind.CONFIGURE, bytes(numbers), pump)
    status = connection.ask(pump)
    if status.inputs & EMERGENCY_STOP:
        code, what, hint = ALARMS[Alarm.EMERGENCY_STOP]
        raise board_error(code, what, hint=hint)
    return status


def cleared(
    connection: Connection,
    machine: Machine,
    status: Status,
    limits: int,
    pump: Callable[[float], object],
) -> None:
    """End an alarm, for the next motion. BoardError ``board-limit`` where one of these switches is
    pressed.
    """
    pressed = [
        letter.upper()
        for k, letter in enumerate(machine.axes)
        if status.inputs & limits & LIMITS & 1 << k
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


def _no_stepper(name: str, murmur: bytes) -> BoardError:
    """What answers instead."""
    words = murmur.decode("ascii", "replace")
    if "Grbl" in words or "grblHAL" in words:
        hint = "use --board grbl, or make flash to put the stepper firmware on it"
        return board_error(
            "board-not-stepper",
            f"the board on {name} runs GRBL, not the stepper firmware",
            hint=hint,
        )
    if murmur:
        hint = f"check port and board.baud ({BAUD} unless the firmware was built otherwise); make flash puts the firmware on an Uno"
        return board_error(
            "board-not-stepper", f"what answers on {name} is no stepper board", hint=hint
        )
    hint = "check the port and the board's supply; make flash puts the firmware on an Uno"
    return board_error("board-silent", f"nothing answers on {name}", hint=hint)
