"""State that the parts of the simulator share.

Memory, rings, planner, steppers, the state of the machine, and the record of its actions.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace

from cnc.boards.grbl.simulator.eeprom import Eeprom
from cnc.boards.grbl.simulator.environment import Environment
from cnc.boards.grbl.simulator.firmware_profile import ROTARY, STEPS, FirmwareProfile
from cnc.boards.grbl.simulator.line_check import ParserPosition
from cnc.boards.grbl.simulator.modal import Modes
from cnc.boards.grbl.simulator.planner import Move, Planner, Point
from cnc.boards.grbl.simulator.steppers import Steppers
from cnc.boards.grbl.simulator.wire import Receiver, Transmitter

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
