"""The connection to a stepper board: exchange of bytes, requests, its opening, and its report."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterator
from typing import NamedTuple

from cnc.boards.port import Clock, LoggedPort, Port
from cnc.boards.protocols import board_error
from cnc.boards.stepper.protocol import VERSION, Alarm, Kind, Status, StepperLink, Welcome
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
HELLO_S = 2.6
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
        reports = [event for event in link.receive(data, now) if isinstance(event, Status)]
        for status in reports:
            log.debug("%s: %s", self.name, status)
        if reports:
            self.status = reports[-1]
        self._heard_at = max(self._heard_at, link.heard_at or 0.0)
        if now - self._heard_at > ANSWER_TIMEOUT_S:
            raise self._silent()
        return reports

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


# The report on a stepper board at a port. The board does not know the limits of the machine.


def stepper_report(port: str, board: Welcome, baud: int) -> Iterator[str]:
    """Yield the lines of the report, all comments of TOML.

    Args:
        port: Name of the serial port.
        board: The board's description of itself.
        baud: Speed of the port, bits/s.
    """
    if board.version != VERSION:
        yield (
            f"# stepper board, version {board.version} of the protocol; "
            f"this program uses {VERSION}: make flash PORT={port}"
        )
        return
    letters, spacing_us = " ".join("XYZA"[: board.axes]), board.least_ticks * board.tick_ns / 1000
    position = "its position is known" if board.position_known else "its position is not known"
    state = board.state.name.lower()
    yield f"# stepper board, version {board.version} of the protocol  {state}"
    yield (
        f"# {board.axes} axes ({letters}), ticks of {board.tick_ns} ns, "
        f"grid moves at least {spacing_us:g} us apart"
    )
    yield f"# buffer of {board.room} bytes for segments; {position}"
    keys = f'kind = "stepper", port = {json.dumps(port)}, baud = {baud}'
    yield f"# for its machine file: [board] {keys}"
