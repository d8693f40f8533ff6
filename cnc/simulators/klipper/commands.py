"""Commands of the simulated board (Klipper documentation, MCU commands)."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from cnc.boards.klipper.protocol import Message
from cnc.simulators.klipper.devices import DriverModel, UartModel

if TYPE_CHECKING:
    from cnc.simulators.klipper.klipper_simulator import KlipperSimulator


# Motors of the simulator: their queues, and the edges of their step pins.

HALF = 2**31
"""Timers compare clocks by the sign of their 32-bit difference."""
NEVER = 2**63 - 1


@dataclass(frozen=True, slots=True)
class Move:
    """An entry of the queue; ``forward`` is the level of the direction pin."""

    interval: int
    count: int
    add: int
    forward: int


class Motor:
    """A motor and its queue. Times are ticks of the board, 64 bits.

    Attributes:
        oid: Its object.
        step_pin: Number of its step pin.
        direction_pin: Number of its direction pin.
        pulse: Ticks from an edge of the step pin to the opposite one.
        position: Steps with the direction pin high minus those with it low.
        last: Clock of the last step, or of the last reset.
        needs_reset: Steps are dropped until ``reset_step_clock``.
        due: Clock of the next step, NEVER if none is due.
        fastest: Least ticks between two steps of all moves so far.
        past: Why the motor cannot go on; "" if it can.
    """

    def __init__(self, oid: int, step_pin: int, direction_pin: int, pulse: int) -> None:
        self.oid = oid
        self.step_pin = step_pin
        self.direction_pin = direction_pin
        self.pulse = pulse
        self.position = 0
        self.last = 0
        self.needs_reset = False
        self.past = ""
        self.due = NEVER
        self.fastest = HALF
        self._next_forward = 0
        self._queue: deque[Move] = deque()
        self._times: NDArray[np.int64] | None = None
        self._at = 0
        self._forward = 0

    @property
    def active(self) -> bool:
        """Whether steps are due."""
        return self._times is not None

    @property
    def queued(self) -> int:
        """Number of moves in the queue."""
        return len(self._queue)

    @property
    def next_due(self) -> int | None:
        """Clock of the next step, None if none is due."""
        return None if self._times is None else self.due

    @property
    def interval(self) -> int | None:
        """Ticks from the last step to the next one, None if none is due."""
        if self._times is None:
            return None
        before = int(self._times[self._at - 1]) if self._at else self.last
        return self.due - before

    def set_direction(self, forward: int) -> None:
        """Set the direction of the next moves."""
        self._next_forward = forward

    def reset(self, clock: int) -> None:
        """Set the clock from which the next interval counts."""
        self.last = clock
        self.needs_reset = False

    def add(self, interval: int, count: int, add: int, clock: int) -> str:
        """Append a move at a clock; return the reason of a shutdown, else ""."""
        move = Move(interval, count, add, self._next_forward)
        self.fastest = min(self.fastest, interval, interval + add * (count - 1))
        if self._times is not None:
            self._queue.append(move)
            return ""
        # The firmware adds 32-bit numbers and compares with the present clock.
        ahead = (self.last + interval - clock) % WRAP
        if ahead >= HALF:
            return "Timer too close"
        self.last = clock + ahead - interval
        self._load(move)
        return ""

    def play(self, until: int) -> tuple[NDArray[np.int64], int]:
        """Make all steps due up to a clock.

        Returns:
            Clock of each step (n,), positive for steps forward, and number of moves loaded.
        """
        made: list[NDArray[np.int64]] = []
        loaded = 0
        while self._times is not None:
            end = int(np.searchsorted(self._times, until, side="right"))
            part = self._times[self._at : end]
            if len(part):
                made.append(part if self._forward else -part)
                self.position += len(part) if self._forward else -len(part)
            self._at = end
            if end < len(self._times):
                self.due = int(self._times[end])
                break
            self.last = int(self._times[-1])
            self._times = None
            self.due = NEVER
            if self._queue:
                move = self._queue.popleft()
                loaded += 1
                if move.interval >= HALF:
                    self.past = "Rescheduled timer in the past"
                self._load(move)
        return (np.concatenate(made) if made else np.empty(0, np.int64)), loaded

    def stop(self) -> int:
        """Drop all moves until the next reset; return the number of moves that were queued."""
        freed = len(self._queue)
        if self._times is not None and self._at:
            self.last = int(self._times[self._at - 1])
        self._queue.clear()
        self._times = None
        self.due = NEVER
        self.needs_reset = True
        self._next_forward = 0
        return freed

    def _load(self, move: Move) -> None:
        k = np.arange(move.count, dtype=np.int64)
        self._times = self.last + (k + 1) * move.interval + move.add * (k * (k + 1) // 2)
        # Intervals rise or fall steadily, so the least is the second or the last.
        last = move.count - 1
        if last and move.interval + min(move.add, move.add * last) < 0:
            self.past = "Rescheduled timer in the past"
        self._at = 0
        self.due = int(self._times[0])
        self._forward = move.forward


# Switches and trigger synchronisation of the simulator: what stops motors at once.


@dataclass(slots=True)
class Trigger:
    """A trsync object.

    Attributes:
        oid: Its object.
        can_trigger: Whether it is armed.
        reason: Reason of the last trigger, 0 for none.
        expire_reason: Reason of a timeout.
        report_ticks: Ticks between two reports, 0 for none.
        motors: Motors that it stops.
        epoch: Counts the arming, so that old timers have no effect.
    """

    oid: int
    can_trigger: bool = False
    reason: int = 0
    expire_reason: int = 0
    report_ticks: int = 0
    motors: list[Motor] = field(default_factory=list)
    epoch: int = 0
    timeout_epoch: int = 0


@dataclass(slots=True)
class Switch:
    """An endstop object.

    Attributes:
        oid: Its object.
        pin: Number of its pin.
        pull_up: Whether the open pin is high.
        armed: Whether it is sampled.
        next_clock: Clock of the next sample.
        trigger: Trigger that it fires.
        trigger_reason: Reason that it gives.
        sample_ticks, sample_count, rest_ticks: Ticks between samples that confirm, their number,
            and ticks between samples at rest.
        wanted: Level that fires.
        left: Samples that still have to confirm.
        epoch: Counts the arming.
    """

    oid: int
    pin: int
    pull_up: bool
    armed: bool = False
    next_clock: int = 0
    trigger: Trigger | None = None
    trigger_reason: int = 0
    sample_ticks: int = 0
    sample_count: int = 0
    rest_ticks: int = 0
    wanted: int = 0
    left: int = 0
    epoch: int = 0

    def arm(self, clock: int, times: Sequence[int], wanted: int) -> None:
        """Begin to sample at a clock; ``times`` are sample_ticks, sample_count, rest_ticks."""
        self.sample_ticks, self.sample_count, self.rest_ticks = times
        self.next_clock, self.wanted, self.left = clock, wanted, self.sample_count
        self.armed = True
        self.epoch += 1

    def sample(self, level: int) -> bool:
        """Take a sample; return whether the switch fires."""
        if level != self.wanted:
            self.left = self.sample_count
            self.next_clock += self.rest_ticks
            return False
        self.left -= 1
        if self.left > 0:
            self.next_clock += self.sample_ticks
            return False
        self.armed = False
        return True

    def sample_at(self, clock: int) -> int:
        """Return the clock of the first sample at a clock or after it, at rest."""
        if self.next_clock >= clock or self.rest_ticks <= 0:
            return self.next_clock
        behind = clock - self.next_clock
        return self.next_clock + -(-behind // self.rest_ticks) * self.rest_ticks

    def skip_to(self, clock: int) -> None:
        """Skip the samples before a clock, while the level does not change."""
        self.next_clock = self.sample_at(clock)


Level = Callable[[], int]
"""A source of a level that depends on the motion."""


@dataclass(slots=True)
class EndLevel:
    """Level of a switch at an end of a motor's travel.

    Attributes:
        positions: Count of steps of each motor by its step pin.
        step_pin: The motor's step pin.
        end: Direction in which the motor presses it, 1 or -1, and its place in steps of this count.
        active: Level of the pressed switch.
    """

    positions: Mapping[int, int]
    step_pin: int
    end: tuple[int, float]
    active: int

    def __call__(self) -> int:
        """Return the present level."""
        return self.active if self._beyond >= 0 else 1 - self.active

    @property
    def steps(self) -> int:
        """Least number of steps until the level changes."""
        beyond = self._beyond
        return math.floor(beyond) + 1 if beyond >= 0 else math.ceil(-beyond)

    @property
    def _beyond(self) -> float:
        towards, place = self.end
        return (self.positions.get(self.step_pin, 0) - place) * towards


# Outputs of the simulator: scheduled levels, and the longest time without an update.


@dataclass(slots=True)
class Output:
    """A digital or PWM output.

    Attributes:
        oid: Its object.
        pin: Number of its pin.
        value: Present value: 0 or 1, ticks of a software PWM, or of PWM_MAX.
        default: Value in a shutdown.
        max_duration: Longest time at another value without an update, ticks; 0 for no limit.
        pwm: Whether it is a hardware PWM.
        waiting: Scheduled values, with their clocks.
        epoch: Counts the updates.
    """

    oid: int
    pin: int
    value: int
    default: int
    max_duration: int
    pwm: bool = False
    cycle_ticks: int = 0
    waiting: deque[tuple[int, int]] = field(default_factory=deque)
    deadline: int | None = None
    epoch: int = 0

    @property
    def missed(self) -> str:
        """Reason of the shutdown after a missing update."""
        kind = "hard pwm" if self.pwm else "digital out"
        return f"Missed scheduling of next {kind} event"

    @property
    def exceeded(self) -> str:
        """Reason of the shutdown after an update that is scheduled too late."""
        kind = "pwm" if self.pwm else "digital out"
        return f"Scheduled {kind} event will exceed max_duration"

    def is_late(self, clock: int) -> bool:
        """Return whether an update at a clock is later than ``max_duration`` allows."""
        if not self.max_duration:
            return False
        if self.waiting:
            before, value = self.waiting[-1]
            return value != self.default and clock > before + self.max_duration
        return self.deadline is not None and clock > self.deadline

    def set(self, value: int, clock: int) -> None:
        """Set a value at a clock."""
        self.value = value
        limited = self.max_duration and value != self.default
        self.deadline = clock + self.max_duration if limited else None
        self.epoch += 1


WRAP = 2**32
IN_SHUTDOWN = frozenset(
    (
        "identify",
        "get_config",
        "get_clock",
        "get_uptime",
        "emergency_stop",
        "clear_shutdown",
        "config_reset",
        "reset",
        "debug_ping",
    )
)
"""Commands that are carried out in a shutdown, too."""
Object = TypeVar("Object")


class Shutdown(Exception):
    """A command that shuts the board down, with its reason."""


class Commands:
    """Carries out the commands for a board."""

    def __init__(self, board: KlipperSimulator) -> None:
        self._board = board

    def carry_out(self, message: Message) -> bool:
        """Carry out a command; return whether the board goes on with those of the same block."""
        board = self._board
        if board.reason and message.name not in IN_SHUTDOWN:
            number = board.firmware.dictionary.number("static_string_id", board.reason) or 0
            board.respond("is_shutdown", static_string_id=number)
            return True
        action: Callable[[Message], None] = getattr(self, f"_{message.name}")
        try:
            action(message)
        except Shutdown as shutdown:
            board.shut_down(str(shutdown))
            return False
        return True

    def _identify(self, message: Message) -> None:
        offset = message["offset"]
        data = self._board.firmware.identify[offset : offset + message["count"]]
        self._board.respond("identify_response", offset=offset, data=data)

    def _get_config(self, message: Message) -> None:
        board = self._board
        board.respond(
            "config",
            is_config=int(board.finalized),
            crc=board.crc,
            is_shutdown=int(bool(board.reason)),
            move_count=board.firmware.slots if board.finalized else 0,
        )

    def _allocate_oids(self, message: Message) -> None:
        if self._board.oid_count:
            raise Shutdown("oids already allocated")
        self._board.oid_count = message["count"]

    def _finalize_config(self, message: Message) -> None:
        if self._board.finalized:
            raise Shutdown("Already finalized")
        self._board.finalized, self._board.crc = True, message["crc"]

    def _config_reset(self, message: Message) -> None:
        if not self._board.reason:
            raise Shutdown("config_reset only available when shutdown")
        board = self._board
        board.objects.clear()
        for each in (board.motors, board.outputs, board.switches, board.triggers):
            each.clear()
        board.oid_count = board.crc = 0
        board.finalized = False
        board.reason = ""

    def _reset(self, message: Message) -> None:
        self._board.reset()

    def _get_clock(self, message: Message) -> None:
        self._board.respond("clock", clock=self._board.clock % WRAP)

    def _get_uptime(self, message: Message) -> None:
        clock = self._board.clock
        self._board.respond("uptime", high=clock // WRAP % WRAP, clock=clock % WRAP)

    def _emergency_stop(self, message: Message) -> None:
        raise Shutdown("Command request")

    def _clear_shutdown(self, message: Message) -> None:
        self._board.reason = ""

    def _debug_ping(self, message: Message) -> None:
        self._board.respond("pong", data=message.data("data"))

    # Motors.

    def _config_stepper(self, message: Message) -> None:
        motor = Motor(
            message["oid"],
            self._output_pin(message["step_pin"]),
            self._output_pin(message["dir_pin"]),
            message["step_pulse_ticks"],
        )
        self._create(motor.oid, motor)
        self._board.motors.append(motor)
        self._board.positions[motor.step_pin] = 0

    def _queue_step(self, message: Message) -> None:
        board, motor = self._board, self._object(message["oid"], Motor)
        if not message["count"]:
            raise Shutdown("Invalid count parameter")
        if motor.needs_reset:
            return
        if reason := board.add_move(motor, message["interval"], message["count"], message["add"]):
            raise Shutdown(reason)

    def _set_next_step_dir(self, message: Message) -> None:
        self._object(message["oid"], Motor).set_direction(int(message["dir"] != 0))

    def _reset_step_clock(self, message: Message) -> None:
        motor = self._object(message["oid"], Motor)
        if motor.active:
            raise Shutdown("Can't reset time when stepper active")
        motor.reset(self._board.near(message["clock"]))
        self._board.look_again()

    def _stepper_get_position(self, message: Message) -> None:
        motor = self._object(message["oid"], Motor)
        self._board.respond("stepper_position", oid=motor.oid, pos=motor.position)

    def _stepper_stop_on_trigger(self, message: Message) -> None:
        motor = self._object(message["oid"], Motor)
        trigger = self._object(message["trsync_oid"], Trigger)
        if any(motor in each.motors for each in self._board.triggers):
            raise Shutdown("Can't add signal that is already active")
        trigger.motors.append(motor)

    # Triggers and switches.

    def _config_trsync(self, message: Message) -> None:
        trigger = Trigger(message["oid"])
        self._create(trigger.oid, trigger)
        self._board.triggers.append(trigger)

    def _trsync_start(self, message: Message) -> None:
        trigger = self._object(message["oid"], Trigger)
        trigger.motors.clear()
        trigger.can_trigger, trigger.reason = True, 0
        trigger.expire_reason = message["expire_reason"]
        trigger.report_ticks = message["report_ticks"]
        trigger.epoch += 1
        trigger.timeout_epoch += 1
        if trigger.report_ticks:
            clock = self._board.near(message["report_clock"])
            if clock < self._board.clock:
                raise Shutdown("Timer too close")
            self._report_at(trigger, clock, trigger.epoch)

    def _report_at(self, trigger: Trigger, clock: int, epoch: int) -> None:
        """Report at a clock and from then on, after a trigger too, until the watch is ended."""

        def report() -> None:
            if trigger.epoch == epoch:
                self._report(trigger, self._board.clock)
                self._report_at(trigger, clock + trigger.report_ticks, epoch)

        self._board.at(clock, report)

    def _report(self, trigger: Trigger, clock: int) -> None:
        self._board.respond(
            "trsync_state",
            oid=trigger.oid,
            can_trigger=int(trigger.can_trigger),
            trigger_reason=trigger.reason,
            clock=clock % WRAP,
        )

    def _trsync_set_timeout(self, message: Message) -> None:
        trigger = self._object(message["oid"], Trigger)
        if not trigger.can_trigger:
            return
        trigger.timeout_epoch += 1
        epoch = trigger.timeout_epoch
        clock = self._board.near(message["clock"])
        if clock < self._board.clock:
            raise Shutdown("Timer too close")

        def expire() -> None:
            if trigger.timeout_epoch == epoch:
                self._fire(trigger, trigger.expire_reason)

        self._board.at(clock, expire)

    def _trsync_trigger(self, message: Message) -> None:
        trigger = self._object(message["oid"], Trigger)
        self._stop(trigger, message["reason"])
        trigger.epoch += 1
        trigger.timeout_epoch += 1
        self._report(trigger, 0)

    def _fire(self, trigger: Trigger, reason: int) -> None:
        """Stop the motors for a reason that the board has seen itself, and report it."""
        if trigger.can_trigger:
            self._stop(trigger, reason)
            self._report(trigger, self._board.clock)

    def _stop(self, trigger: Trigger, reason: int) -> None:
        if not trigger.can_trigger:
            return
        board = self._board
        board.settle(board.clock)
        trigger.can_trigger, trigger.reason = False, reason
        for motor in trigger.motors:
            board.slots_used -= motor.stop()
        trigger.motors.clear()

    def _config_endstop(self, message: Message) -> None:
        switch = Switch(message["oid"], self._input_pin(message["pin"]), bool(message["pull_up"]))
        self._create(switch.oid, switch)
        self._board.switches.append(switch)

    def _endstop_home(self, message: Message) -> None:
        switch = self._object(message["oid"], Switch)
        if not message["sample_count"]:
            switch.armed = False
            switch.epoch += 1
            return
        switch.trigger = self._object(message["trsync_oid"], Trigger)
        switch.trigger_reason = message["trigger_reason"]
        clock = self._board.near(message["clock"])
        if clock < self._board.clock:
            raise Shutdown("Timer too close")
        times = message["sample_ticks"], message["sample_count"], message["rest_ticks"]
        switch.arm(clock, times, message["pin_value"])
        self.watch(switch)

    def watch(self, switch: Switch) -> None:
        """Plan the next sample of an armed switch, if its level can fire."""
        board = self._board
        level = board.levels.get(switch.pin, 1)
        if not callable(level) and level != switch.wanted:
            switch.left = switch.sample_count
            return
        switch.epoch += 1
        epoch, planned = switch.epoch, board.next_sample(switch)

        def sample() -> None:
            if switch.epoch != epoch or not switch.armed:
                return
            switch.skip_to(planned)
            if switch.sample(board.level(switch.pin)):
                if switch.trigger is not None:
                    self._fire(switch.trigger, switch.trigger_reason)
            else:
                self.watch(switch)

        board.at(planned, sample)

    def _endstop_query_state(self, message: Message) -> None:
        switch = self._object(message["oid"], Switch)
        self._board.respond(
            "endstop_state",
            oid=switch.oid,
            homing=int(switch.armed),
            next_clock=switch.next_clock % WRAP,
            pin_value=self._board.level(switch.pin),
        )

    # Outputs.

    def _config_digital_out(self, message: Message) -> None:
        self._create_output(message, pwm=False)

    def _config_pwm_out(self, message: Message) -> None:
        self._create_output(message, pwm=True)

    def _create_output(self, message: Message, *, pwm: bool) -> None:
        value = message["value"]
        output = Output(
            message["oid"],
            self._output_pin(message["pin"]),
            1 - value,
            message["default_value"],
            message["max_duration"],
            pwm,
        )
        self._create(output.oid, output)
        self._board.outputs.append(output)
        self._board.set_output(output, value)
        output.deadline = None

    def _set_digital_out_pwm_cycle(self, message: Message) -> None:
        self._object(message["oid"], Output).cycle_ticks = message["cycle_ticks"]

    def _set_digital_out(self, message: Message) -> None:
        pin = self._output_pin(message["pin"])
        self._board.history.append((self._board.clock, pin, message["value"]))

    def _update_digital_out(self, message: Message) -> None:
        self._board.set_output(self._object(message["oid"], Output), message["value"])

    def _queue_digital_out(self, message: Message) -> None:
        output, on = self._object(message["oid"], Output), message["on_ticks"]
        self._queue(output, message["clock"], on if output.cycle_ticks else int(on > 0))

    def _queue_pwm_out(self, message: Message) -> None:
        self._queue(self._object(message["oid"], Output), message["clock"], message["value"])

    def _queue(self, output: Output, clock32: int, value: int) -> None:
        board = self._board
        clock = board.near(clock32)
        if clock < board.clock:
            raise Shutdown("Timer too close")
        if output.is_late(clock):
            raise Shutdown(output.exceeded)
        if board.slots_used >= board.firmware.slots:
            raise Shutdown("Move queue overflow")
        board.slots_used += 1
        output.waiting.append((clock, value))

        def change() -> None:
            if not output.waiting or output.waiting[0] != (clock, value):
                return
            output.waiting.popleft()
            board.slots_used -= 1
            board.set_output(output, value)
            self._limit(output)

        board.at(clock, change)

    def _limit(self, output: Output) -> None:
        """Shut the board down where no update follows in time."""
        if output.deadline is None:
            return
        epoch, board = output.epoch, self._board

        def missed() -> None:
            if output.epoch == epoch and not board.reason:
                board.shut_down(output.missed)

        board.at(output.deadline, missed)

    # Motor drivers.

    def _config_tmcuart(self, message: Message) -> None:
        wire = self._board.uarts.setdefault(message["rx_pin"], UartModel())
        self._create(message["oid"], wire)

    def _tmcuart_send(self, message: Message) -> None:
        wire = self._object(message["oid"], UartModel)
        read = wire.send(message.data("write"), message["read"])
        self._board.respond("tmcuart_response", oid=message["oid"], read=read)

    def _config_spi(self, message: Message) -> None:
        device = self._board.spi.setdefault(message["pin"], DriverModel(powered=False))
        self._create(message["oid"], device)

    def _spi_set_bus(self, message: Message) -> None:
        self._object(message["oid"], DriverModel)

    def _spi_transfer(self, message: Message) -> None:
        answer = self._object(message["oid"], DriverModel).transfer(message.data("data"))
        self._board.respond("spi_transfer_response", oid=message["oid"], response=answer)

    def _spi_send(self, message: Message) -> None:
        self._object(message["oid"], DriverModel).transfer(message.data("data"))

    # Objects.

    def _create(self, oid: int, thing: object) -> None:
        board = self._board
        if oid >= board.oid_count or oid in board.objects or board.finalized:
            raise Shutdown("Can't assign oid")
        board.objects[oid] = thing

    def _object(self, oid: int, kind: type[Object]) -> Object:
        found = self._board.objects.get(oid)
        if not isinstance(found, kind):
            raise Shutdown("Invalid oid type")
        return found

    def _output_pin(self, pin: int) -> int:
        if pin not in self._board.firmware.dictionary.enumerations["pin"].values():
            raise Shutdown("Not an output pin")
        return pin

    def _input_pin(self, pin: int) -> int:
        if pin not in self._board.firmware.dictionary.enumerations["pin"].values():
            raise Shutdown("Not a valid input pin")
        return pin
