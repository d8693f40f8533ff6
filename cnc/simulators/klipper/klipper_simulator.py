"""The simulated board: time, events, blocks and shutdowns.

Time advances only by :meth:`KlipperSimulator.advance`. Between two events the motors step by
themselves, so their steps are computed in blocks of arrays.
"""

from __future__ import annotations

import heapq
import math
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.boards.klipper.firmware import FIRMWARES, Firmware
from cnc.boards.klipper.protocol import SEQUENCE, BlockReader, RemoteError, block_bytes
from cnc.simulators.klipper.commands import (
    Commands,
    EndLevel,
    Level,
    Motor,
    Output,
    Switch,
    Trigger,
)
from cnc.simulators.klipper.devices import DriverModel, UartModel

# The cable: bytes take time, and may be damaged, lost or doubled.

BITS_A_BYTE = 10
USB_BYTES_PER_S = 800_000.0
"""Throughput of a full-speed USB serial device."""
USB_LATENCY_S = 0.001
"""Frame of a full-speed USB bus."""


@dataclass(slots=True)
class Noise:
    """Chance of each fault for a byte, in both directions, after a time."""

    damaged: float = 0.0
    dropped: float = 0.0
    doubled: float = 0.0
    after: float = 0.0


class Cable:
    """Both directions of the cable. Times are in s.

    Args:
        baud: Speed of a serial line, bits/s; 0 for USB.
        seed: Seed of the faults.

    Attributes:
        noise: Faults.
        plugged: Whether bytes pass at all.
    """

    def __init__(self, baud: int, seed: int = 0) -> None:
        self.byte_s = BITS_A_BYTE / baud if baud else 1.0 / USB_BYTES_PER_S
        self.latency_s = 0.0 if baud else USB_LATENCY_S
        self.noise = Noise()
        self.plugged = True
        self._random = random.Random(seed)
        self._free_down = self._free_up = 0.0
        self._up: deque[tuple[float, bytes]] = deque()

    def down(self, data: bytes, now: float) -> list[tuple[float, bytes]]:
        """Send bytes to the board; return parts of them with the times of their arrival."""
        if not self.plugged or not data:
            return []
        begin = max(now, self._free_down)
        self._free_down = begin + len(data) * self.byte_s
        parts: list[tuple[float, bytes]] = []
        at = 0
        while at < len(data):
            # A block ends with a sync byte, so nothing happens between two of them.
            sync = data.find(b"\x7e", at)
            end = len(data) if sync < 0 else sync + 1
            arrival = begin + end * self.byte_s + self.latency_s
            parts.append((arrival, self._spoilt(data[at:end], now)))
            at = end
        return parts

    def up(self, data: bytes, now: float) -> None:
        """Send bytes to the host."""
        if self.plugged:
            begin = max(now, self._free_up)
            self._free_up = begin + len(data) * self.byte_s
            self._up.append((self._free_up + self.latency_s, self._spoilt(data, now)))

    @property
    def arrival(self) -> float | None:
        """When the host can read the next bytes; None if there are none."""
        return self._up[0][0] if self._up else None

    def received(self, now: float) -> bytes:
        """Return the bytes that the host can read now."""
        parts = []
        while self._up and self._up[0][0] <= now:
            parts.append(self._up.popleft()[1])
        return b"".join(parts)

    def unplug(self) -> None:
        """Pull the cable."""
        self.plugged = False
        self._up.clear()

    def _spoilt(self, data: bytes, now: float) -> bytes:
        noise = self.noise
        if now < noise.after or not (noise.damaged or noise.dropped or noise.doubled):
            return data
        out = bytearray()
        for byte in data:
            draw = self._random.random()
            if draw < noise.damaged:
                out.append(byte ^ self._random.randint(1, 255))
            elif draw < noise.damaged + noise.dropped:
                continue
            elif draw < noise.damaged + noise.dropped + noise.doubled:
                out += bytes((byte, byte))
            else:
                out.append(byte)
        return bytes(out)


WRAP = 2**32
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
        uarts, spi: Motor drivers at UART pins and at chip selects.
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
        self.spi: dict[int, DriverModel] = {}
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
