"""Supervision of an open stepper board: status reports, buttons, alarms, faults, position."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cnc.boards.errors import board_error
from cnc.boards.loopback import Loopback
from cnc.boards.port import Clock, Port
from cnc.boards.protocols import MotionState
from cnc.boards.pulse_board.supervisor import PulseSupervisor
from cnc.boards.stepper.connection import (
    ALARMS,
    ANSWER_TIMEOUT_S,
    POLL_S,
    AlarmText,
    Connection,
)
from cnc.boards.stepper.position import BoardPosition
from cnc.boards.stepper.protocol import Alarm, Kind, State, Status
from cnc.boards.stepper.sender import Sender
from cnc.boards.stepper.setup import min_spacing_ns, open_board
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError

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
        known = error.diagnostic
        if known.line:
            return error
        return type(error)(replace(known, line=self.connection.link.confirmed_note))

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
