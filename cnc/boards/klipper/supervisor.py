"""Supervision of an open Klipper board: triggers, shutdowns, alarms, faults, positions."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.boards.klipper.accelerometer import Adxl345
from cnc.boards.klipper.connection import Connection, Reopen
from cnc.boards.klipper.guards import Guard, Guards, TooLate
from cnc.boards.klipper.layout import BY_HOST, EMERGENCY, EXPIRED, LIMIT, LayoutBuilder, section
from cnc.boards.klipper.outputs import AHEAD_S, Outputs
from cnc.boards.klipper.position import MotorPosition, PositionKeeper, shutdown_reason
from cnc.boards.klipper.protocol import Message
from cnc.boards.klipper.sender import MotionLimits, Sender, ramp_seconds
from cnc.boards.klipper.trinamic import CHECK, DriverWatch, motor_drivers
from cnc.boards.loopback import Loopback
from cnc.boards.port import Clock, Port
from cnc.boards.protocols import MotionState, board_error
from cnc.boards.pulse_board import OutputState, PulseSupervisor
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError

# What a board reports while it is being stopped, and the end of a shutdown.

ATTEMPTS = 4
"""Shutdowns after which the board is not asked any more: a late output may shut it down again."""


class ShutDownAgain(Exception):
    """A question came to a board that has shut down, which answers few questions."""


@dataclass(slots=True)
class Stop:
    """Reports during a stop: the motors may have stopped before their ramp ended.

    Attributes:
        shutdown: Number of the reason of a shutdown, 0 for none.
        trigger: Reason of a trigger that was not the host's, 0 for none.
        reading: Whether a shutdown raises ShutDownAgain.
        ramp: Whether the motors still follow their ramp to rest.
    """

    shutdown: int = 0
    trigger: int = 0
    reading: bool = False
    ramp: bool = False

    @property
    def dead(self) -> bool:
        """Whether something else than the host has stopped the motors."""
        return bool(self.shutdown or self.trigger)

    def take(self, message: Message, *, triggered: bool) -> None:
        """Take a message; ``triggered``: it tells of a trigger of this motion.

        Raises:
            ShutDownAgain: The board has shut down, and an answer is waited for.
        """
        if message.name in ("shutdown", "is_shutdown"):
            self.shutdown = message["static_string_id"]
            if self.reading:
                raise ShutDownAgain
        elif triggered and message["trigger_reason"] not in (0, BY_HOST):
            self.trigger = message["trigger_reason"]

    def ask(
        self,
        connection: Connection,
        outputs: Outputs,
        question: Callable[[], list[int]],
        pump: Callable[[float], list[Message]],
    ) -> list[int]:
        """Return the answer to a question, after the end of each shutdown.

        Raises:
            BoardError: The board does not answer.
        """
        for _ in range(ATTEMPTS):
            if connection.ask("get_config", "config", pump)["is_shutdown"]:
                connection.send("clear_shutdown")
                connection.flush(pump)
                outputs.forget()
            self.reading = True
            try:
                return question()
            except ShutDownAgain:
                continue
            finally:
                self.reading = False
        raise connection.silent()


# Alarms of a Klipper board: what has stopped the motors, and what to do.

RELEASE = "release it when it is safe, then home the machine"
DEAD_STOP = "the motors stopped without a ramp and may have lost steps: home the machine"
SLOW = "reduce the load of this computer"
KEPT = "the position is kept: find the cause, then start again"


class Alarm(NamedTuple):
    """Code, message and hint of an alarm."""

    code: str
    message: str
    hint: str


def alarm_of(reason: int, letter: Callable[[int], str]) -> Alarm:
    """Return the alarm for the reason of a trigger.

    Args:
        reason: The reason.
        letter: Gives the letter of an axis by its column.
    """
    if reason == EMERGENCY:
        return Alarm("board-emergency-stop", "the e-stop is pressed", RELEASE)
    if reason >= LIMIT:
        hint = "move away from it by hand with the drivers off, then home the machine"
        message = f"the limit switch of {letter(reason - LIMIT)} was hit"
        return Alarm("board-limit", message, hint)
    if reason == EXPIRED:
        return Alarm("board-silence", "the board heard nothing from this computer", DEAD_STOP)
    message = f"the board stopped the motors for an unknown reason, {reason}"
    return Alarm("board-alarm", message, DEAD_STOP)


def reset_error(name: str) -> BoardError:
    """Return the fault of a board on a port that was reset during a run."""
    message = f"the board on {name} was reset; its position is lost"
    hint = "check its supply and its reset line; home the machine before the next run"
    return board_error("board-reset", message, hint=hint)


class Supervisor(PulseSupervisor):
    """An open board, whose every message is checked.

    Attributes:
        connection: The connection.
        layout: The objects of the board.
        warnings: Findings about the file of the position.
        slots: Entries of its move queue.
        accelerometer: The accelerometer; None without one.
        drivers: Watch on the motor drivers that the board configures.
        position: Conversion of positions.
        least_ns: Least time between two steps of an axis, ns.
        sender: The motion.
        guards: Switches and timeout.
        outputs: Spindle, coolant, enable.
    """

    def __init__(
        self,
        port: Port,
        machine: Machine,
        name: str,
        clock: Clock,
        identity: str = "",
        reopen: Reopen | None = None,
    ) -> None:
        table = section(machine)
        axes = len(machine.axes)
        self.least_ns = 1e9 / machine.board.max_step_rate
        super().__init__(Loopback(axes, self.least_ns))
        self._stopping = False
        self._spoilt_before = 0
        self._stop = Stop()
        self.connection = Connection(port, clock, name, reopen)
        self.connection.open()
        self.layout = LayoutBuilder(machine, self.connection.dictionary).build()
        self.position = MotorPosition(machine, self.layout.motors)
        self._keeper = PositionKeeper(identity, self.layout)
        self.warnings = self._keeper.warnings
        self.slots, same = self._keeper.configure(self.connection)
        positions = self.read_positions()
        if same:
            self._keeper.restore(self.position)
        self.store(moving=False)
        drivers = motor_drivers(self.connection, self.layout, machine)
        for driver in drivers:
            driver.configure(machine)
        self.drivers = DriverWatch(self.connection, drivers)
        self.accelerometer: Adxl345 | None = None
        if self.layout.accelerometer is not None and table.accelerometer is not None:
            objects = self.layout.accelerometer
            self.accelerometer = Adxl345(self.connection, objects, table.accelerometer, self.pump)
        self.guards = Guards(self.connection, self.layout, axes)
        limits = MotionLimits(
            table.tolerance_us * 1e-6, self.least_ns * 1e-9, ramp_seconds(machine)
        )
        guard = Guard(self.pump, self.guards.arm, self._rest_between)
        self.sender = Sender(self.connection, self.layout, axes, self.slots, guard, limits)
        self.outputs = Outputs(self.connection, self.layout, self.sender.slots.add)
        self.sender.position = self.position.of(positions)

    @property
    def confirmed_line(self) -> int:
        """Source line that the board has reached for certain."""
        return self.sender.tracker.line or self.checks.confirmed_line

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
        """State by the estimate of the board's clock."""
        sender = self.sender
        point = sender.tracker.played(self._alive_clock) if sender.running else None
        mm = self.position.mm(sender.position if point is None else point)
        return MotionState(sender.tracker.line, mm, sender.ahead_s)

    @property
    def _alive_clock(self) -> int:
        """Clock at which the board was last heard; a board that is reset plays nothing after it."""
        heard = self.connection.board_clock.at(self.connection.heard_at)
        return min(self.sender.last_clock, heard)

    @property
    def _spoilt(self) -> int:
        """Number of blocks that were damaged on the cable so far, in both directions."""
        return self.connection.link.damaged + self.connection.link.refused

    def begin(self) -> None:
        """Begin a motion."""
        self.stopped_short = False
        self.active = True
        self._spoilt_before = self._spoilt

    def close_port(self) -> None:
        """Close the port."""
        self.connection.port.close()

    def store(self, *, moving: bool) -> None:
        """Keep the position for the next program."""
        self._keeper.write(self.position, moving=moving)

    def pump(self, seconds: float) -> list[Message]:
        """Send what waits, receive bytes for at most some seconds, and raise all faults."""
        watching = self.active and not self._stopping
        if watching or self._stop.ramp:
            self.outputs.repeat()
            if self.sender.running:
                self.guards.renew()
        if watching and self.sender.running:
            self.outputs.release(self.sender.clock_of)
            self._driver_fault(self.drivers.ask())
        if watching and self.sender.watch():
            self._underrun()
        try:
            messages = self.connection.pump(seconds)
        except BoardError as error:
            raise self._lost(error, self.sender.end_of_queue) from error
        for message in messages:
            self._check(message)
        if watching and self.connection.board_clock.wrong:
            raise self._dead_stop(*self.connection.wrong_clock())
        return messages

    def _check(self, message: Message) -> None:
        if message.name == "shutdown":
            clock = self.connection.board_clock
            self.sender.stopped_clock = clock.extend(message["clock"], self.connection.clock.now())
        triggered = self.guards.is_trigger(message)
        if self._stopping:
            self._stop.take(message, triggered=triggered)
        match message.name:
            case "shutdown" | "is_shutdown" if not self._stopping:
                raise self._shut_down(message["static_string_id"])
            case "starting" if not self._stopping:
                point = self.sender.tracker.played(self._alive_clock)
                raise self._lost(reset_error(self.connection.name), point)
            case "tmcuart_response" | "spi_transfer_response":
                self._driver_fault(self.drivers.take(message))
            case "trsync_state" if triggered and self.sender.running:
                self._triggered(message["trigger_reason"])

    def _triggered(self, reason: int) -> None:
        """Act on a trigger, which has stopped all motors."""
        if self._cut_by(reason):
            self.connection.link.drop_waiting()
        elif self.active and not self._stopping and reason != BY_HOST:
            raise self._alarm(reason)

    def _cut_by(self, reason: int) -> bool:
        """Return whether a trigger is the contact of a probing or homing move, which ends it."""
        contact = self.probing and self.guards.is_armed(reason)
        self.sender.cut |= contact
        return contact

    def _driver_fault(self, text: str) -> None:
        """Stop the motors at once after a fault of a motor driver, whose motor is off."""
        if text and self.active and not self._stopping:
            raise self._dead_stop("motor-driver", text, CHECK, held=False)

    def select(self, alone: tuple[int, int] | None) -> None:
        """Let one motor of an axis (column, motor) take part in the next motion, or all."""
        self.position.select(alone)
        self.sender.select(alone)

    def read_positions(self) -> list[int]:
        """Return the position of each motor as the board counts it."""
        pump = self.pump if self.active or self._stopping else self.connection.pump
        ask = self.connection.ask
        return [
            ask("stepper_get_position", "stepper_position", pump, oid=motor.oid)["pos"]
            for motor in self.layout.motors
        ]

    def take_position(self) -> NDArray[np.int64]:
        """Take over the position that the board counts; return its grid point (axes,)."""
        positions = self.read_positions
        if self._stopping:
            positions = partial(self._stop.ask, self.connection, self.outputs, positions, self.pump)
        point = self.position.of(positions())
        self.stopped_short = not np.array_equal(point, self.checks.position_steps)
        self.sender.position = point
        return point

    def set_outputs(self, state: OutputState) -> None:
        """Set the outputs as soon as possible."""
        soon = round(AHEAD_S * self.connection.board_clock.frequency)
        self.outputs.set(state, self.sender.now + soon)

    def rest(self, time_ns: int) -> None:
        """Wait until the board has played the motion up to a time, ns; compare the positions."""
        sender = self.sender
        was_running = sender.running or not sender.is_empty
        try:
            sender.rest(time_ns)
        except TooLate:
            raise self.too_late() from None
        if sender.cut or not was_running:
            return
        self._disarm()
        if sender.cut:
            return
        sent = sender.position
        try:
            positions = self.read_positions()
        except BoardError as error:
            raise self._unanswered(error) from error
        point = self.position.of(positions)
        differing = self.position.differing(positions)
        if differing or not np.array_equal(point, sent):
            self.take_position()
            axes = f"the motors of {differing} do not agree; " if differing else ""
            message = f"{axes}the board is at {self.position.text(point)}, not at its target"
            hint = "home the machine; please report this with the program"
            self.position.forget()
            raise self.fail(board_error("board-position", message, hint=hint))
        sender.tracker.clear(point)

    def _rest_between(self, until_ns: int) -> None:
        """End a motion while the next one waits already."""
        self.sender.wait_for_end()
        if not self.sender.cut:
            self._disarm()

    def _disarm(self) -> None:
        """End the watch; a trigger that was not reported is a fault."""
        self.guards.disarm()
        self._begin_stop()
        try:
            reason = self.guards.end(self.pump)
        except BoardError as error:
            if self._stop.shutdown:
                raise self._shut_down(self._stop.shutdown) from None
            raise self._unanswered(error) from error
        finally:
            self._stopping = False
        # A computer that was late may see the contact only here.
        if reason != BY_HOST and not self._cut_by(reason):
            raise self._alarm(reason)

    def end_cut(self) -> NDArray[np.int64]:
        """End a motion that an armed input has ended; return the grid point (axes,) there."""
        self._disarm()
        point = self.take_position()
        self.sender.stop()
        return point

    def halt(self) -> None:
        """Come to rest on the path, and take over the position."""
        self._begin_stop()
        position_kept = False
        try:
            with suppress(BoardError):
                self.connection.flush(self.pump)
                dead = False
                if moving := self.sender.running:
                    try:
                        self._ramp()
                    except TooLate:
                        dead = True
                self.set_outputs(self.outputs.state.off())
                self.connection.flush(self.pump)
                self.take_position()
                position_kept = not (moving and (dead or self._stop.dead))
        finally:
            self._stopping = False
            if not position_kept:
                self.position.forget()
            self.sender.stop()
        self.store(moving=False)

    def _ramp(self) -> None:
        """Play the ramp to rest; the board stops at once without signs of this computer."""
        self._stop.ramp = True
        try:
            self.sender.ramp()
            self.sender.rest(self.sender.until_ns)
        finally:
            self._stop.ramp = False
            self.guards.disarm()
            self.guards.trigger()

    def _begin_stop(self) -> None:
        """Begin a stop, during which messages raise no fault."""
        self._stopping, self._stop = True, Stop()

    def _underrun(self) -> None:
        """Come to rest on the path, because no more motion comes."""
        self._begin_stop()
        try:
            self._ramp()
            self.set_outputs(self.outputs.state.off())
            self.connection.flush(self.pump)
            point = self.take_position()
        except TooLate:
            raise self.too_late() from None
        except BoardError as error:
            raise self._lost(error, self.sender.end_of_queue) from error
        finally:
            self._stopping = False
        if self._stop.dead:
            shutdown, trigger = self._stop.shutdown, self._stop.trigger
            raise self._shut_down(shutdown) if shutdown else self._alarm(trigger)
        message = (
            "moves came too late; the board came to rest on the path; "
            f"the machine is at {self.position.text(point)}"
        )
        line = self.sender.tracker.line_at(point) or self.sender.tracker.line
        hint = self._bad_cable() or SLOW
        raise self.fail(board_error("board-underrun", message, line=line, hint=hint))

    def _bad_cable(self) -> str:
        """Return what to do if messages were damaged during the motion, "" if none was."""
        spoilt = self._spoilt - self._spoilt_before
        if not spoilt:
            return ""
        return f"check the cable and its shield: {spoilt} messages of this motion were damaged"

    def too_late(self) -> BoardError:
        """Stop at once, because moves are due before they can be sent."""
        message = "moves came too late; the motors stopped without a ramp"
        hint = f"{self._bad_cable() or SLOW}; {DEAD_STOP}"
        return self._dead_stop("board-underrun", message, hint)

    def _alarm(self, reason: int) -> BoardError:
        """End the use of the board by a trigger, with its cause and position."""
        alarm = alarm_of(reason, self.position.letter)
        held = reason != EMERGENCY
        hint = self._with_cable(alarm.hint) if reason == EXPIRED else alarm.hint
        return self._dead_stop(alarm.code, alarm.message, hint, held=held)

    def _with_cable(self, hint: str) -> str:
        """Return a hint about a board that may have missed messages."""
        return "; ".join(filter(None, (self._bad_cable(), hint)))

    def _dead_stop(self, code: str, message: str, hint: str, *, held: bool = True) -> BoardError:
        """Stop the motors, and read the position, which is not to be trusted if they moved."""
        self._begin_stop()
        self.connection.link.drop_waiting()
        self.guards.disarm()
        self.guards.trigger()
        self.set_outputs(self.outputs.state.off())
        return self._stopped(code, message, hint, held=held)

    def _shut_down(self, number: int) -> BoardError:
        """End the use of the board after a shutdown; its counts are read after its end."""
        message = f"the board has shut down: {shutdown_reason(self.connection, number)}"
        self._begin_stop()
        self.connection.link.drop_waiting()
        return self._stopped("klipper-shutdown", message, self._with_cable(DEAD_STOP), held=True)

    def _stopped(self, code: str, message: str, hint: str, *, held: bool) -> BoardError:
        """Read the position of motors that were stopped dead, and end the use of the board.

        Args:
            code: Code of the fault.
            message: What has stopped them.
            hint: What to do, unless the position is kept.
            held: The motors kept their torque.
        """
        tracker, kept, line = self.sender.tracker, False, 0
        try:
            point = self.take_position()
        except BoardError:
            played = tracker.played(self.sender.last_clock)
            if played is not None:
                self.sender.position, self.stopped_short = played, True
                place = self.position.text(played)
                message += f"; by its time the machine is at {place}, which may be wrong"
        else:
            kept = held and tracker.unmoved(point, self.sender.last_clock)
            line = tracker.line_at(point)
            doubt = "and nothing has moved since its last rest" if kept else "which may be wrong"
            message += f"; the machine is at {self.position.text(point)}, {doubt}"
        finally:
            self._stopping = False
        if kept:
            hint = KEPT
        else:
            self.position.forget()
        return self.fail(board_error(code, message, line=line or tracker.line, hint=hint))

    def _lost(self, error: BoardError, point: NDArray[np.int64] | None) -> BoardError:
        """End the use of a board that cannot be asked any more, and that stops at about a point."""
        finding = error.diagnostic
        if self.active and point is not None:
            self.sender.position = point
            self.stopped_short = True
            place = self.position.text(point)
            message = f"{finding.message}; the machine is at about {place}, which may be wrong"
            finding = replace(finding, message=message)
        self.position.forget()
        return self.fail(
            type(error)(replace(finding, line=finding.line or self.sender.tracker.line))
        )

    def _unanswered(self, error: BoardError) -> BoardError:
        """Return the fault of a question after a motion; what :meth:`pump` raises is complete."""
        return self._lost(error, self.sender.end_of_queue) if self.active else error

    def fail(self, error: BoardError) -> BoardError:
        """End the use of the board by a fault, and return the fault."""
        self.sender.stop()
        super().fail(error)
        self.store(moving=False)
        return error
