"""The simulated board: commands, time, events, blocks and shutdowns.

Source of the commands: Klipper documentation, "MCU commands".

Time advances only by :meth:`KlipperSimulator.advance`. Between two events the motors step by
themselves, so their steps are computed in blocks of arrays.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cnc.boards.klipper.firmware import FIRMWARES, Firmware
from cnc.boards.klipper.protocol import SEQUENCE, BlockReader, Message, RemoteError, block_bytes
from cnc.simulators.klipper.devices import Cable, DriverModel, Reader, SpiDevice, UartModel
from cnc.simulators.klipper.objects import (
    WRAP,
    EndLevel,
    Level,
    Motor,
    Output,
    Switch,
    Trigger,
)

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
        self._object(message["oid"], SpiDevice)

    def _spi_transfer(self, message: Message) -> None:
        answer = self._object(message["oid"], SpiDevice).transfer(message.data("data"))
        self._board.respond("spi_transfer_response", oid=message["oid"], response=answer)

    def _spi_send(self, message: Message) -> None:
        self._object(message["oid"], SpiDevice).transfer(message.data("data"))

    # The accelerometer.

    def _config_adxl345(self, message: Message) -> None:
        device = self._object(message["spi_oid"], SpiDevice)
        self._create(message["oid"], self._board.reader_of(message["oid"], device))

    def _query_adxl345(self, message: Message) -> None:
        self._object(message["oid"], Reader).query(message["rest_ticks"])

    def _query_adxl345_status(self, message: Message) -> None:
        self._object(message["oid"], Reader).status()

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


BOOT_S = 0.6
"""Time from a reset until the firmware hears: a boot loader, or the start of the USB device."""
LATE_S = 1e-3
"""Delay of a step after which the firmware shuts down."""
Event = tuple[int, int, Callable[[], None]]


class KlipperSimulator:
    """A board.

    Args:
        firmware: Profile of the microcontroller.
        drift: Relative error of its clock.
        start_clock: Its clock at power-up, ticks.
        seed: Seed of the faults of its cable.

    Attributes:
        now: Time since power-up by the host's clock, s.
        cable: The cable.
        levels: Level of each input pin by its number, or a function that gives it.
        uarts, spi: Motor drivers at UART pins; these and an accelerometer at chip selects.
        reader_of: Gives the reader of an accelerometer by its object and its device.
        due_of: Clocks at which these steps were due by the queues: the processor makes one step
            after the other.
        edges_of: Clocks of the steps of each motor by its step pin, as :meth:`edges` joins them.
        history: Changes of outputs: clock, pin, value.
        reason: Reason of the shutdown, "" while there is none.
        resets: Number of resets so far.
        boots_until: Time at which a restart is over, s.
    """

    def __init__(
        self,
        firmware: Firmware = FIRMWARES["rp2040"],
        *,
        drift: float = 0.0,
        start_clock: int = 0,
        seed: int = 0,
    ) -> None:
        self.firmware = firmware
        self.frequency = firmware.frequency * (1.0 + drift)
        self.now = 0.0
        self.cable = Cable(firmware.baud, seed)
        self.levels: dict[int, int | Level] = {}
        self.history: list[tuple[int, int, int]] = []
        self.uarts: dict[int, UartModel] = {}
        self.spi: dict[int, SpiDevice] = {}
        self.reader_of: Callable[[int, SpiDevice], Reader] = lambda *_: Reader()
        self.due_of: dict[int, list[NDArray[np.int64]]] = {}
        self.edges_of: dict[int, list[NDArray[np.int64]]] = {}
        self.positions: dict[int, int] = {}
        self.blocks_refused = 0
        self.resets = 0
        self.boots_until = 0.0
        self.powered = True
        self._start_clock = start_clock
        self._events: list[Event] = []
        self._order = 0
        self._commands = Commands(self)
        self._restart()

    def _restart(self) -> None:
        self.objects: dict[int, Motor | Output | Switch | Trigger | object] = {}
        self.motors: list[Motor] = []
        self.outputs: list[Output] = []
        self.switches: list[Switch] = []
        self.triggers: list[Trigger] = []
        self.reason = ""
        self.oid_count = 0
        self.crc = 0
        self.finalized = False
        self.slots_used = 0
        self.sequence = 0
        self._reader = BlockReader()
        self._told_damage = False
        self._unread = self._tasks_free = 0
        self._cpu_free = 0
        self._unsteps = np.empty(0, np.int64)

    def reset(self) -> None:
        """Restart the firmware: everything configured is forgotten, and a USB device vanishes."""
        self.settle(self.clock)
        for output in self.outputs:
            self.set_output(output, 0)
        self._restart()
        self._events.clear()
        self.resets += 1
        self.boots_until = self.now + BOOT_S
        self._at_time(self.boots_until, lambda: self.respond("starting"))

    @property
    def has_usb(self) -> bool:
        """Whether it is a USB device itself."""
        return not self.firmware.baud

    @property
    def clock(self) -> int:
        """The present clock, ticks since power-up plus the start clock."""
        return self._start_clock + int(self.now * self.frequency)

    def time_of(self, clock: int) -> float:
        """Return the time of a clock, s."""
        return (clock - self._start_clock) / self.frequency

    def near(self, clock32: int) -> int:
        """Return the clock next to the present one with these lower 32 bits."""
        now = self.clock
        return now + (clock32 - now + WRAP // 2) % WRAP - WRAP // 2

    def write(self, data: bytes) -> None:
        """Send bytes from the host."""
        for arrival, part in self.cable.down(data, self.now):
            self._at_time(arrival, lambda part=part: self._arrive(part))  # type: ignore[misc]

    def read(self) -> bytes:
        """Return the bytes that the host can read now."""
        return self.cable.received(self.now)

    def advance(self, until: float, *, answer: bool = False) -> None:
        """Advance to a time, s; with ``answer`` only to the next bytes for the host."""
        while True:
            target = until
            if answer and self.cable.arrival is not None:
                target = min(target, max(self.cable.arrival, self.now))
            if not self._events:
                break
            clock = self._events[0][0]
            time = self.time_of(clock)
            if time > target:
                break
            _, _, action = heapq.heappop(self._events)
            self.now = max(self.now, time)
            action()
        self.now = max(self.now, target)
        self.settle(self.clock)

    def at(self, clock: int, action: Callable[[], None]) -> None:
        """Carry out an action at a clock."""
        self._order += 1
        heapq.heappush(self._events, (clock, self._order, action))

    def _at_time(self, time: float, action: Callable[[], None]) -> None:
        self.at(self._start_clock + math.ceil(time * self.frequency), action)

    def settle(self, clock: int) -> None:
        """Make all steps that are due up to a clock."""
        parts: list[NDArray[np.int64]] = []
        motors: list[Motor] = []
        for motor in self.motors:
            if motor.due <= clock:
                made, loaded = motor.play(clock)
                self.slots_used -= loaded
                if len(made):
                    parts.append(made)
                    motors.append(motor)
                    self.positions[motor.step_pin] = motor.position
        if parts:
            self._record(parts, motors, clock)
        for motor in self.motors:
            if motor.past:
                reason, motor.past = motor.past, ""
                self.shut_down(reason)

    def _record(self, parts: list[NDArray[np.int64]], motors: list[Motor], clock: int) -> None:
        """Record steps: the processor makes one edge after the other."""
        due = np.abs(np.concatenate(parts))
        ends = [
            np.abs(part) + motor.pulse
            for part, motor in zip(parts, motors, strict=True)
            if self.firmware.events(motor.pulse) > 1
        ]
        later = np.concatenate((self._unsteps, *ends))
        self._unsteps = later[later > clock]
        events = np.concatenate((due, later[later <= clock]))
        order = np.argsort(events, kind="stable")
        cost = round(self.firmware.event_time(motors[0].pulse, self._samples()))
        k = np.arange(len(events), dtype=np.int64) * cost
        made = np.maximum(np.maximum.accumulate(events[order] - k), self._cpu_free) + k
        self._cpu_free = int(made[-1]) + cost
        actual = np.empty_like(made)
        actual[order] = made
        late = int((actual[: len(due)] - due).max())
        begin = 0
        for part, motor in zip(parts, motors, strict=True):
            end = begin + len(part)
            sign = np.where(part < 0, -1, 1)
            self.due_of.setdefault(motor.step_pin, []).append(np.abs(part))
            self.edges_of.setdefault(motor.step_pin, []).append(actual[begin:end] * sign)
            begin = end
        if late > LATE_S * self.firmware.frequency:
            self.shut_down("Rescheduled timer in the past")

    def edges(self, pin: str) -> tuple[NDArray[np.int64], NDArray[np.int8]]:
        """Return clock (n,) and direction (n,) of each step of the motor at a step pin."""
        parts = self.edges_of.get(self.pin(pin), [])
        signed = np.concatenate(parts) if parts else np.empty(0, np.int64)
        return np.abs(signed), np.sign(signed).astype(np.int8)

    def pin(self, name: str) -> int:
        """Return the number of a pin."""
        number = self.firmware.dictionary.number("pin", name)
        if number is None:
            raise ValueError(f"There is no pin {name}.")
        return number

    def level(self, pin: int) -> int:
        """Return the level of an input; an open pin is high."""
        level = self.levels.get(pin, 1)
        if callable(level):
            self.settle(self.clock)
            return level()
        return level

    def set_pin(self, name: str, level: int | Level) -> None:
        """Set the level of an input, or a function that gives it."""
        pin = self.pin(name)
        self.levels[pin] = level
        self.look_again(pin)

    def look_again(self, pin: int | None = None) -> None:
        """Plan the next samples of the switches at a pin, or of all, anew."""
        for switch in self.switches:
            if switch.armed and pin in (None, switch.pin):
                switch.skip_to(self.clock)
                self._commands.watch(switch)

    def add_move(self, motor: Motor, interval: int, count: int, add: int) -> str:
        """Append a move to the queue of a motor; return the reason of a shutdown, else ""."""
        if self.slots_used >= self.firmware.slots:
            return "Move queue overflow"
        was_active, fastest = motor.active, motor.fastest
        if reason := motor.add(interval, count, add, self.clock):
            return reason
        self.slots_used += was_active
        if motor.fastest < fastest:
            self.look_again()
        return ""

    def next_sample(self, switch: Switch) -> int:
        """Return the clock of the next sample of a switch that may see another level.

        So a switch that is far away costs no time, although the firmware takes all samples.
        """
        level = self.levels.get(switch.pin, 1)
        if not isinstance(level, EndLevel) or self.level(switch.pin) == switch.wanted:
            return switch.next_clock
        motor = next((each for each in self.motors if each.step_pin == level.step_pin), None)
        if motor is None:
            return switch.next_clock
        return switch.sample_at(self.clock + (level.steps - 1) * motor.fastest)

    def value(self, name: str) -> int:
        """Return the present value of an output pin."""
        pin = self.pin(name)
        return next((value for _, known, value in reversed(self.history) if known == pin), 0)

    def respond(self, name: str, **values: int | bytes) -> None:
        """Send a response."""
        contents = self.firmware.dictionary.encode_response(name, **values)
        self._send(contents)

    def _send(self, contents: bytes) -> None:
        self.cable.up(block_bytes(self.sequence, contents), self.now)

    def _arrive(self, data: bytes) -> None:
        """Take received bytes when steps and samples leave time; what finds no room is lost."""
        ticks = self.firmware.byte_ticks
        if not ticks:
            self._receive(data)
            return
        self.settle(self.clock)
        data = data[: self.firmware.window - self._unread]
        self._unread += len(data)
        begin = max(self.clock, self._tasks_free)
        self._tasks_free = begin + round(len(data) * ticks / self._message_share())

        def take() -> None:
            self._receive(data)
            self._unread -= len(data)

        self.at(self._tasks_free, take)

    def _message_share(self) -> float:
        """Return the share of the processor's time that is left for messages now."""
        samples, steps = self._samples(), 0.0
        for motor in self.motors:
            if interval := motor.interval:
                event = self.firmware.event_time(motor.pulse, samples)
                steps += self.firmware.events(motor.pulse) * event / interval
        return self.firmware.message_share(steps, samples)

    def _samples(self) -> float:
        """Return the samples of switches in a tick."""
        armed = [switch for switch in self.switches if switch.armed and switch.rest_ticks > 0]
        return sum(1.0 / switch.rest_ticks for switch in armed)

    def _receive(self, data: bytes) -> None:
        """Take received bytes; answer those out of order, and the first damaged ones, with a nak.

        After this nak, the firmware is silent until it receives a block without damage.
        """
        if not self.powered or self.now < self.boots_until:
            return
        damaged = self._reader.damaged
        for block in self._reader.receive(data):
            self._told_damage = False
            if block.sequence != self.sequence:
                self.blocks_refused += 1
                self._send(b"")
                continue
            self.sequence = self.sequence + 1 & SEQUENCE
            self.settle(self.clock)
            self._carry_out(block.contents)
            self._send(b"")
        if self._reader.damaged > damaged:
            self.blocks_refused += 1
            if not self._told_damage:
                self._send(b"")
            self._told_damage = True

    def _carry_out(self, contents: bytes) -> None:
        try:
            for message in self.firmware.dictionary.decode_commands(contents):
                if not self._commands.carry_out(message):
                    # The firmware leaves a block in which it shuts down.
                    return
        except RemoteError:
            self.shut_down("Command parser error")

    def shut_down(self, reason: str) -> None:
        """Stop all motors, and set all outputs to their defaults."""
        if self.reason:
            return
        self.settle(self.clock)
        if self.reason:
            return
        self.reason = reason
        for motor in self.motors:
            motor.stop()
        self.slots_used = 0
        for output in self.outputs:
            output.waiting.clear()
            self.set_output(output, output.default)
        for switch in self.switches:
            switch.armed = False
            switch.epoch += 1
        for trigger in self.triggers:
            trigger.can_trigger = False
            trigger.epoch += 1
            trigger.timeout_epoch += 1
            trigger.motors.clear()
        number = self.firmware.dictionary.number("static_string_id", reason) or 0
        self.respond("shutdown", clock=self.clock % WRAP, static_string_id=number)

    def set_output(self, output: Output, value: int) -> None:
        """Set an output now."""
        if value != output.value:
            self.history.append((self.clock, output.pin, value))
        output.set(value, self.clock)
