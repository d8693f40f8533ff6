"""State that the parts of the simulator share.

Memory, rings, planner, steppers, the state of the machine, and the record of its actions.
"""

from __future__ import annotations

import heapq
import math
import struct
from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace

from cnc.simulators.grbl.firmware_profile import (
    RATES,
    ROTARY,
    STEPS,
    TOOL_CHANGE_MODE,
    FirmwareProfile,
)
from cnc.simulators.grbl.line_check import Modes, ParserPosition, Refused
from cnc.simulators.grbl.planner import Move, Planner, Point, Steppers
from cnc.simulators.grbl.workpiece import Environment

# The EEPROM of the board: settings, offsets, start-up lines, build info; and the time of a write.
#
# A byte is written only where it differs, in 3.4 ms each
# (:data:`cnc.simulators.grbl.core.EEPROM_BYTE_TIME`). Numbers are single floats, and every
# record has one byte of checksum.

SYSTEMS = ("G54", "G55", "G56", "G57", "G58", "G59", "G28", "G30")
STARTUP_LINES = 2
LONGEST_TEXT = 79
"""Characters of a start-up line or of the build info."""
WHOLE = (0, 1, 2, 3, 4, 5, 6, 10, 13, 20, 21, 22, 23, 26, 32, TOOL_CHANGE_MODE, ROTARY)
"""Settings that are a byte, a mask or a switch."""
NO_DECIMALS = (*WHOLE, 30, 31)
SWITCHES = (4, 5, 6, 13, 20, 21, 22, 32)
LARGEST = 3.4e38
"""Approximately the largest single float."""


class Eeprom:
    """The memory. ``damaged``: names of records with a wrong checksum (error 7)."""

    def __init__(self, defaults: dict[int, float], axes: int = 3) -> None:
        self._axes = axes
        self._origin: Point = (0.0,) * axes
        self._defaults = dict(defaults)
        self.settings = dict(defaults)
        self.systems: dict[str, Point] = dict.fromkeys(SYSTEMS, self._origin)
        self.startup = [""] * STARTUP_LINES
        self.build_info = ""
        self.damaged: set[str] = set()

    def set(
        self, number: int, value: float, max_step_rate_hz: float | None, variable_spindle: bool
    ) -> int:
        """Store ``$number=value``, and return the bytes written. Errors 3, 4, 6, 10, 12, 17."""
        settings = dict(self.settings)
        if number not in settings:
            raise Refused(3)
        if value < 0.0:
            raise Refused(4)
        if number in SWITCHES:
            value = float(value != 0.0)
        elif number in WHOLE:
            value = float(int(value) % 65536 if number == 26 else int(value) % 256)
        if number == 0 and value < 3:
            raise Refused(6)
        if number == 20 and value and not settings[22]:
            raise Refused(10)
        if number == 32 and value and not variable_spindle:
            raise Refused(17)
        settings[number] = value
        rates = [settings[STEPS + axis] * settings[RATES + axis] for axis in range(self._axes)]
        fastest = max(rates) / 60.0
        if max_step_rate_hz is not None and number >= 100 and fastest > max_step_rate_hz:
            raise Refused(12)
        if number == 22 and not value:
            settings[20] = 0.0
        before, self.settings = self.settings, settings
        return _changed(_numbers(before), _numbers(settings))

    def store(self, name: str, value: Point) -> int:
        """Store a coordinate system or position, and return the bytes written."""
        before, self.systems[name] = self.systems[name], value
        return _changed(_point(before), _point(value))

    def store_startup(self, index: int, text: str) -> int:
        """Store a start-up line, and return the bytes written."""
        before, self.startup[index] = self.startup[index], text
        return _changed(_text(before), _text(text))

    def store_build_info(self, text: str) -> int:
        """Store the text of ``$I``, and return the bytes written."""
        before, self.build_info = self.build_info, text
        return _changed(_text(before), _text(text))

    def restore(self, part: str) -> int:
        """Restore ``$`` settings, ``#`` coordinates or ``*`` all; return the bytes written."""
        written = 0
        if part in "$*":
            before, self.settings = self.settings, dict(self._defaults)
            written += _changed(_numbers(before), _numbers(self.settings))
        if part in "#*":
            written += sum(self.store(name, self._origin) for name in SYSTEMS)
        if part == "*":
            written += sum(
                self.store_startup(index, "") for index in range(STARTUP_LINES)
            ) + self.store_build_info("")
        return written


def setting_text(number: int, value: float) -> str:
    """Return a setting as ``$$`` prints it."""
    return f"${number}={value:.0f}" if number in NO_DECIMALS else f"${number}={value:.3f}"


def _numbers(settings: dict[int, float]) -> bytes:
    return b"".join(
        struct.pack("<H", int(value)) if number in WHOLE else _single(value)
        for number, value in settings.items()
    )


def _point(point: Point) -> bytes:
    return b"".join(_single(value) for value in point)


def _single(value: float) -> bytes:
    """Return a single float; a larger number becomes the largest."""
    return struct.pack("<f", min(max(value, -LARGEST), LARGEST))


def _text(text: str) -> bytes:
    return text.encode("latin-1").ljust(LONGEST_TEXT + 1, b"\0")


def _changed(before: bytes, after: bytes) -> int:
    """Return the number of bytes that differ, with the checksum."""
    changed = sum(a != b for a, b in zip(before, after, strict=True))
    return changed + (sum(before) % 256 != sum(after) % 256)


# The two directions of the cable: bytes take time, rings have a capacity.
#
# A byte is 10 bit times on the wire (8N1): at 115200 baud 11 520 bytes/s. Towards the board:
#
#    write(t) --> | . . . . | --> the UART's two bytes --> real-time byte? --> carried out at once
#                  10 bits         (only these while the         |
#                  each            EEPROM is written)            +------> RX ring; if it is full,
#                                                                         the byte is lost unnoticed
#
# Towards the host, bytes leave the TX ring one after another; a program that prints into a full
# ring waits. The host's USB collects the bytes of a frame of 1 ms.

BITS_A_BYTE = 10
"""Start bit, eight data bits, stop bit."""
USB_FRAME = 0.001
"""Seconds between two polls of a full-speed USB device by the host (USB 2.0, 5.3)."""
UART_BYTES = 2
"""Bytes that the AVR's receiver keeps while interrupts are off.

ATmega328P data sheet, 20.7: a two-level FIFO.
"""
EEPROM_BYTE_TIME = 0.0034
"""Seconds to erase and write a byte of EEPROM (ATmega328P data sheet, table 8-2)."""


class Receiver:
    """Host to board: the bytes on the wire, then those in the ring.

    Counters for tests: ``received``, ``overflowed`` (lost to a full ring), ``blinded`` (lost during
    EEPROM writes), ``fullest``.
    """

    def __init__(self, baud: float, capacity: int) -> None:
        self.byte_time = BITS_A_BYTE / baud
        self.capacity = capacity
        self.ring: deque[int] = deque()
        self.received = 0
        self.overflowed = 0
        self.blinded = 0
        self.fullest = 0
        self._wire: deque[tuple[float, bytes]] = deque()
        self._next = 0
        self._line_free = -math.inf
        self._blind_from = -math.inf
        self._blind_until = -math.inf
        self._window = -1
        self._kept = 0

    @property
    def lost(self) -> int:
        """Number of bytes that were lost after the wire."""
        return self.overflowed + self.blinded

    @property
    def arrival(self) -> float:
        """When the next byte will be off the wire, s."""
        if not self._wire:
            return math.inf
        return self._wire[0][0] + (self._next + 1) * self.byte_time

    def write(self, data: bytes, now: float) -> None:
        """Send bytes from the host."""
        if data:
            start = max(now, self._line_free)
            self._line_free = start + len(data) * self.byte_time
            self._wire.append((start, data))

    def take(self) -> int:
        """Take the next byte off the wire."""
        _, data = self._wire[0]
        byte = data[self._next]
        self._next += 1
        if self._next == len(data):
            self._wire.popleft()
            self._next = 0
        self.received += 1
        return byte

    def unplug(self) -> None:
        """Drop the bytes on the wire."""
        self._wire.clear()
        self._next = 0

    def blind(self, bytes_written: int, now: float) -> float:
        """Write bytes of EEPROM from ``now`` on, with interrupts off for each.

        Returns:
            The time of the end, s.
        """
        self._blind_from, self._blind_until = now, now + bytes_written * EEPROM_BYTE_TIME
        self._window, self._kept = -1, 0
        return self._blind_until

    def seen(self, now: float) -> bool:
        """Return whether a byte that arrives now is taken from the UART.

        During an EEPROM write only the first two bytes in the time of each written byte are.
        """
        if now >= self._blind_until:
            return True
        window = int((now - self._blind_from) / EEPROM_BYTE_TIME)
        if window != self._window:
            self._window, self._kept = window, 0
        self._kept += 1
        if self._kept > UART_BYTES:
            self.blinded += 1
            return False
        return True

    def store(self, byte: int) -> None:
        """Put a byte into the ring; it is lost if the ring is full."""
        if len(self.ring) >= self.capacity:
            self.overflowed += 1
            return
        self.ring.append(byte)
        self.fullest = max(self.fullest, len(self.ring))


class Transmitter:
    """Board to host."""

    def __init__(self, baud: float, capacity: int) -> None:
        self.byte_time = BITS_A_BYTE / baud
        self.capacity = capacity
        self.sent = 0
        self._free = -math.inf
        self._out: deque[tuple[float, bytes]] = deque()

    @property
    def arrival(self) -> float:
        """When the host can read the next bytes, s."""
        return self._out[0][0] if self._out else math.inf

    def send(self, data: bytes, now: float) -> float:
        """Print bytes.

        Returns:
            When the printing program can continue, s: the ring has space for the last byte.
        """
        start = max(now, self._free)
        self._free = start + len(data) * self.byte_time
        self.sent += len(data)
        first = 0
        while first < len(data):
            frame = math.ceil((start + (first + 1) * self.byte_time) / USB_FRAME - 1e-6)
            last = min(
                len(data), max(first + 1, int((frame * USB_FRAME - start) / self.byte_time + 1e-6))
            )
            self._out.append((frame * USB_FRAME, data[first:last]))
            first = last
        return max(now, self._free - self.capacity * self.byte_time)

    def collect(self, now: float) -> bytes:
        """Return all bytes that the host can read now."""
        parts = []
        while self._out and self._out[0][0] <= now:
            parts.append(self._out.popleft()[1])
        return b"".join(parts)

    def unplug(self) -> None:
        """Drop the bytes on the wire."""
        self._out.clear()


NEW_LINE = "\r\n"
CRITICAL = (1, 2)
"""Alarms after which only a reset is accepted (interface.md, ``[MSG:Reset to continue]``)."""

ERROR_TEXTS = {
    3: "Invalid $ statement",
    9: "GCode cannot be executed in lock or alarm state",
    20: "Unsupported GCode command",
    33: "Gcode invalid target",
}
"""Errors as FluidNC writes them with ``verbose_errors`` (Error.cpp of its sources)."""


class Abort(Exception):
    """A reset, raised in the main program where it waits."""


def _always() -> bool:
    return True


@dataclass(frozen=True, slots=True)
class Wait:
    """A wait of the main program for a condition or a time, whichever comes first.

    serves: real-time commands are served meanwhile, and a hold or a lock keeps the program waiting.
    """

    condition: Callable[[], bool] = _always
    until: float = math.inf
    serves: bool = True


BUSY = Wait(serves=False)
"""Wait until the processor is free."""
Program = Generator[Wait, None, None]


class Abandon(Exception):
    """An alarm that ends the present line only, raised in the main program where it waits."""


@dataclass(slots=True)
class Flags:
    """Pending real-time commands.

    The same command twice counts once (commands.md, "Realtime commands").
    """

    status: bool = False
    start: bool = False
    hold: bool = False
    door: bool = False
    jog_cancel: bool = False
    sleep: bool = False
    reset: bool = False
    alarm: int = 0
    overrides: list[int] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Event:
    """An action of the board that is not motion.

    Spindle, coolant, dwell, alarm, reset, error, line, hold, resume, pause, end, eeprom.
    """

    time: float
    kind: str
    value: str


class Core:
    """The board without its program. Tests may read every attribute at any time."""

    def __init__(self, profile: FirmwareProfile, baud: float, environment: Environment) -> None:
        self.profile = profile
        self.environment = environment
        self.receiver = Receiver(baud, profile.rx_capacity)
        self.transmitter = Transmitter(baud, profile.tx_capacity)
        self.planner = Planner(profile.planner_blocks)
        self.steppers = Steppers(self.planner, self._trip_at, len(profile.axes))
        self.eeprom = Eeprom(profile.settings, len(profile.axes))
        self.events: list[Event] = []
        self.now = 0.0
        self.cpu_free = 0.0
        self.state = "Idle"
        self.flags = Flags()
        self.spindle_text, self.rpm, self.coolant_text = "M5 0", 0.0, "M9"
        self.lines = 0
        self.last_error = 0
        self.swallow = 0
        self.forced_error = 0
        self.homed = self.commanding = False
        self.pushed_modes = ""
        self.force_reset()

    def force_reset(self) -> None:
        """Reset everything but position, state and memory."""
        self.flags = Flags()
        self.aborted = self.abandoned = self.answering = self.locked = self.locking = False
        self.hold_complete = self.jog_cancelling = self.soft_limit_stop = self.resuming = False
        self.flushed = False
        self.modes = Modes()
        self.shift = self.origin
        self.tool_length = 0.0
        self.probe_position = self.origin
        self.probe_succeeded = False
        self.probe_wanted: bool | None = None
        self.spindle_override = 100
        self.planner.feed_override = self.planner.rapid_override = 100
        self.spindle_stopped = False
        self.wco_counter = self.override_counter = 0
        self.last_error = 0
        self._timers: list[tuple[float, int, Callable[[], None]]] = []
        self._timer_count = 0
        self.steppers.flush()
        self.sync_position()

    @property
    def setting(self) -> dict[int, float]:
        """``$`` settings by number."""
        return self.eeprom.settings

    def per_axis(self, first: int) -> Point:
        """Return the settings of the axes from the number of the first."""
        return tuple(self.setting[first + axis] for axis in range(len(self.profile.axes)))

    @property
    def must_home(self) -> bool:
        """Whether the board is locked until it has homed."""
        return bool(int(self.setting[22]) & self.profile.lock_bit) and not self.homed

    @property
    def rotary(self) -> frozenset[int]:
        """Numbers of the rotary axes: A, B and C on FluidNC, and what ``$376`` names on grblHAL."""
        further = range(3, len(self.profile.axes))
        if self.profile.name == "fluidnc":
            return frozenset(further)
        mask = int(self.setting.get(ROTARY, 0.0))
        return frozenset(axis for axis in further if mask >> (axis - 3) & 1)

    @property
    def origin(self) -> Point:
        """Zero of each axis."""
        return (0.0,) * len(self.profile.axes)

    @property
    def position(self) -> Point:
        """Machine position now, mm."""
        return self.steppers.state(self.now)[0]

    @property
    def place(self) -> ParserPosition:
        """Where the parser stands."""
        return ParserPosition(
            self.parsed,
            self.eeprom.systems | {"G92": self.shift},
            self.tool_length,
            self.profile.codes,
            self.profile.axes,
            self.rotary,
        )

    @property
    def offset(self) -> Point:
        """Work coordinate offset of the parser, mm."""
        return self.place.offset(self.modes.coordinates)

    @property
    def suspended(self) -> bool:
        """Whether the main program is kept from going on."""
        return (
            self.locked
            or self.jog_cancelling
            or (self.state in ("Hold", "Door", "Sleep") and not self.soft_limit_stop)
        )

    def note(self, kind: str, value: str = "") -> None:
        """Record an event."""
        self.events.append(Event(self.now, kind, value))

    def say(self, text: str) -> None:
        """Print a line."""
        self.print(text + NEW_LINE)

    def print(self, text: str) -> None:
        """Print text; the processor is busy until all of it is in the ring."""
        self.cpu_free = max(self.cpu_free, self.transmitter.send(text.encode("latin-1"), self.now))

    def work(self, seconds: float) -> None:
        """Make the processor busy; yield BUSY to let the time pass."""
        self.cpu_free = max(self.cpu_free, self.now) + seconds

    def reply(self, code: int) -> None:
        """Answer a line: ok (0) or an error."""
        if code:
            self.note("error", str(code))
        if self.swallow:
            self.swallow -= 1
            return
        name = ERROR_TEXTS.get(code, code) if self.profile.error_texts else code
        self.say(f"error:{name}" if code else "ok")

    def alarm(self, code: int) -> None:
        """Raise an alarm; it is reported when real-time commands are served."""
        self.flags.alarm = code

    def sync_position(self) -> None:
        """Set the parser's position to that of the machine.

        It is on a whole step, except while homing looks for a switch.
        """
        if self.state != "Home":
            self.steppers.position = self.on_grid(self.steppers.position)
        self.parsed = self.planned = self.steppers.position

    def on_grid(self, point: Point) -> Point:
        """Return the nearest point that whole steps reach."""
        return tuple(
            math.floor(value * steps + 0.5) / steps
            for value, steps in zip(point, self.per_axis(STEPS), strict=True)
        )

    def at(self, time: float, action: Callable[[], None]) -> None:
        """Schedule an action, unless a reset comes first."""
        self._timer_count += 1
        heapq.heappush(self._timers, (time, self._timer_count, action))

    @property
    def timer(self) -> float:
        """When the next scheduled action is due."""
        return self._timers[0][0] if self._timers else math.inf

    def run_timer(self) -> None:
        """Carry out the action that is due."""
        heapq.heappop(self._timers)[2]()

    def set_spindle(self, state: str, speed: float) -> None:
        """Switch the spindle: M3, M4 or M5 at a programmed speed (rev/min)."""
        rpm = speed * self.spindle_override / 100.0 if state != "M5" else 0.0
        if rpm:
            rpm = min(max(rpm, self.setting[31]), self.setting[30])
        text = f"{state} {rpm:g}"
        if text != self.spindle_text:
            self.spindle_text, self.rpm = text, rpm
            self.note("spindle", text)
            self.override_counter = 0

    def set_coolant(self, flood: bool, mist: bool) -> None:
        """Switch the coolants."""
        text = " ".join(word for word, on in (("M7", mist), ("M8", flood)) if on) or "M9"
        if text != self.coolant_text:
            self.coolant_text = text
            self.note("coolant", text)
            self.override_counter = 0

    def outputs_off(self) -> None:
        """Switch spindle and coolants off at once; the parser's modes stay."""
        self.set_spindle("M5", 0.0)
        self.set_coolant(False, False)

    def outputs_on(self) -> None:
        """Switch spindle and coolants to the parser's modes."""
        self.set_spindle(self.modes.spindle, self.modes.speed)
        self.set_coolant(self.modes.flood, self.modes.mist)

    def toggle_coolant(self, mist: bool) -> None:
        """Override a coolant, which also changes the parser's mode (commands.md, 0xA0, 0xA1)."""
        modes = self.modes
        self.modes = (
            replace(modes, mist=not modes.mist) if mist else replace(modes, flood=not modes.flood)
        )
        self.set_coolant(self.modes.flood, self.modes.mist)

    def start_cycle(self) -> None:
        """Begin to move, if a motion waits and the machine rests."""
        if self.state == "Idle" and self.planner.blocks:
            self.state = "Jog" if self.planner.blocks[0].kind == "jog" else "Run"
            self.steppers.start(self.now)

    def motion_event(self) -> None:
        """Handle a block that has ended, come to rest, or tripped a switch or the probe."""
        kind = self.planner.blocks[0].kind
        happened = self.steppers.settle(self.now)
        if happened == "tripped":
            self._tripped(kind)
        elif happened == "done":
            self._rested(kind, held=False)
        elif happened == "held":
            self._rested(kind, held=True)

    def _rested(self, kind: str, held: bool) -> None:
        """Handle the end of the motion."""
        if self.jog_cancelling or (held and kind == "probe" and self.probe_succeeded):
            self.steppers.flush()
            self.sync_position()
            self.jog_cancelling = False
            if self.state in ("Jog", "Run"):
                self.state = "Idle"
        if self.state in ("Run", "Jog") and not self.planner.blocks:
            self.state = "Idle"
            self.steppers.holding = False
        elif self.state in ("Hold", "Door"):
            self.hold_complete = True
            if self.state == "Door":
                self.outputs_off()

    def _tripped(self, kind: str) -> None:
        """Handle a probe contact or a switch."""
        if kind == "probe":
            self.probe_position = self.position
            self.probe_succeeded = True
            self.steppers.hold(self.now)
        elif kind == "home":
            self.steppers.halt(self.now)
        else:
            self.stop_dead()
            self.alarm(1)

    def stop_dead(self) -> None:
        """Stop all motion at once, and switch the outputs off."""
        self.steppers.halt(self.now)
        self.outputs_off()

    def _trip_at(self, move: Move) -> float | None:
        if move.kind == "probe":
            return self.environment.contact(move, self.probe_wanted is True)
        if move.kind == "home" or self.setting[21]:
            return self.environment.switch(move)
        return None
