"""The simulated board: its parts, real-time commands, faults on demand, and the clock.

Nothing happens by itself. :meth:`GrblSimulator.advance` goes from event to event in the order of
time. An event is one of

    a byte is off the wire | the processor is free | a wait is over | a block ends | a timer | a
    fault

so a run depends only on the bytes, their times, and the faults.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.simulators.grbl.core import BUSY, CRITICAL, Abandon, Abort, Core, Event, Wait
from cnc.simulators.grbl.firmware import Firmware
from cnc.simulators.grbl.firmware_profile import GRBL, FirmwareProfile
from cnc.simulators.grbl.planner import Move, Point
from cnc.simulators.grbl.report import parser_state, status_report
from cnc.simulators.grbl.workpiece import Environment

# Real-time commands (commands.md, "Realtime commands").
#
# Each is noted as its byte arrives, and carried out when the main program next serves them.
#
# Idle --queued motion--> Run --!--> Hold:1 --at rest--> Hold:0 --~--> Run or Idle
# any of these --0x84--> Door:2 --at rest--> Door:0 (Door:1 while the door is open)
# Door:0 --~--> Door:3 --> Run or Idle
# Idle --M6 (grblHAL)--> Tool --~--> Idle
# Jog --! or 0x85--> at rest, the queue dropped --> Idle

RESET = 0x18
PRINTABLE = {ord("?"): "status", ord("~"): "start", ord("!"): "hold"}
EXTENDED = {0x84: "door", 0x85: "jog_cancel"}
HAL = {0x80: "status", 0x81: "start", 0x82: "hold", 0x87: "status"}
"""grblHAL's second set, for hosts that do not send printable characters."""
MODES_TOO = 512
FEED = {0x90: 0, 0x91: 10, 0x92: -10, 0x93: 1, 0x94: -1}
RAPID = {0x95: 100, 0x96: 50, 0x97: 25}
SPINDLE = {0x99: 0, 0x9A: 10, 0x9B: -10, 0x9C: 1, 0x9D: -1}
SPINDLE_STOP, FLOOD, MIST = 0x9E, 0xA0, 0xA1
LEAST, LARGEST = 10, 200
"""Per cent of a feed or spindle override."""
SPINDLE_DELAY, COOLANT_DELAY = 4.0, 1.0
"""Seconds for spindle and coolant before motion resumes after a door or a spindle stop."""


def is_realtime(core: Core, byte: int) -> bool:
    """Return whether a byte is taken out of the stream: the printable ones, and all above ASCII."""
    if byte in PRINTABLE:
        return core.profile.printable_anywhere or not core.commanding
    return byte == RESET or byte >= 0x80


def receive(core: Core, byte: int) -> None:
    """Note a real-time command; a reset stops the machine at once."""
    flags = core.flags
    if byte == RESET:
        reset(core)
        return
    name = (
        PRINTABLE.get(byte)
        or EXTENDED.get(byte)
        or (HAL.get(byte) if core.profile.name == "grblhal" else None)
    )
    if name == "jog_cancel":
        _note_jog_cancel(core)
    elif name is not None:
        setattr(flags, name, True)
    elif byte in FEED or byte in RAPID or byte in SPINDLE or byte in (SPINDLE_STOP, FLOOD, MIST):
        flags.overrides.append(byte)


def _note_jog_cancel(core: Core) -> None:
    """Note a jog cancel.

    GRBL ignores one that arrives before the jog has begun. grblHAL drops the bytes that it has not
    read, so that their lines get no answer.
    """
    if core.profile.jog_cancel_flushes:
        core.receiver.ring.clear()
        core.flushed = core.flags.jog_cancel = True
    elif core.state == "Jog":
        core.flags.jog_cancel = True


def reset(core: Core) -> None:
    """Switch outputs off and stop motion, with an alarm if there was motion (0x18)."""
    if core.flags.reset or core.environment.stop_pressed:
        return
    core.flags.reset = True
    core.note("reset", core.state)
    if core.steppers.running or core.state == "Home":
        core.alarm(6 if core.state == "Home" else 3)
    core.stop_dead()


def serve(core: Core) -> None:
    """Carry out the commands that have been noted."""
    flags = core.flags
    if flags.alarm:
        code, flags.alarm = flags.alarm, 0
        core.state = "Alarm"
        core.note("alarm", str(code))
        core.say(f"ALARM:{code}")
        core.locking = code in CRITICAL or code == core.profile.estop_alarm
        core.work(core.profile.alarm_s)
        if core.now < core.cpu_free:
            return
    if core.locking:
        # a reset that came while the alarm was printed is ignored
        core.say("[MSG:Reset to continue]")
        core.locking, core.locked, flags.reset = False, True, False
        return
    if core.locked:
        flags.status = False
        if not flags.reset:
            return
        core.locked = False
    if flags.reset:
        core.aborted = True
        return
    if core.state == "Home":
        _serve_homing(core)
        return
    if flags.status:
        flags.status = False
        core.say(status_report(core))
        _push_modes(core)
    # A hold that arrives together with a cycle start prevails.
    core.flags.start &= not (core.flags.hold or core.flags.jog_cancel or core.flags.door)
    _serve_holds(core)
    _serve_start(core)
    for byte in flags.overrides:
        _override(core, byte)
    flags.overrides.clear()


def _push_modes(core: Core) -> None:
    """Report the modes behind a status report if they have changed (bit 9 of grblHAL's ``$10``)."""
    if core.profile.name == "grblhal" and int(core.setting[10]) & MODES_TOO:
        modes = parser_state(core)
        if modes != core.pushed_modes:
            core.pushed_modes = modes
            core.say(modes)


def _serve_homing(core: Core) -> None:
    """Serve the door, and on FluidNC a status report: there is nothing else during homing."""
    if core.flags.status and core.profile.reports_homing:
        core.flags.status = False
        core.say(status_report(core))
    if core.flags.door:
        core.flags.door = False
        core.stop_dead()
        core.flags.reset = True
        core.alarm(7)
        serve(core)


def _serve_holds(core: Core) -> None:
    """Serve hold, jog cancel, door and sleep."""
    flags, state = core.flags, core.state
    if flags.hold or flags.jog_cancel:
        jogging = state == "Jog" and not core.jog_cancelling
        if jogging:
            _cancel_jog(core)
        elif flags.hold and state in ("Idle", "Run"):
            core.state = "Hold"
            core.note("hold")
            core.hold_complete = not core.steppers.running
            core.steppers.hold(core.now)
        flags.hold = flags.jog_cancel = False
    if flags.door:
        flags.door = False
        if state not in ("Alarm", "Check", "Sleep"):
            _open_door(core)
    if flags.sleep:
        flags.sleep = False
        core.outputs_off()
        core.state = "Sleep"
        core.say("[MSG:Sleeping]")


def _cancel_jog(core: Core) -> None:
    """Brake, then drop the queue."""
    core.note("hold")
    if core.steppers.running:
        core.jog_cancelling = True
        core.steppers.hold(core.now)


def _open_door(core: Core) -> None:
    """Serve the safety door: as a hold, with the outputs off at rest."""
    core.say("[MSG:Check Door]")
    core.note("door")
    if core.state == "Jog":
        _cancel_jog(core)
    core.state = "Door"
    core.resuming = False
    core.hold_complete = not core.steppers.running
    core.steppers.hold(core.now)
    if core.hold_complete:
        core.outputs_off()


def _serve_start(core: Core) -> None:
    """Serve cycle start and resume."""
    if not core.flags.start:
        return
    core.flags.start = False
    if core.state == "Idle":
        core.start_cycle()
    elif core.state == "Tool":
        core.note("resume")
        core.state = "Idle"
    elif core.state == "Hold" and core.hold_complete and not core.resuming:
        if core.spindle_stopped:
            core.spindle_stopped = False
            core.outputs_on()
            core.resuming = True
            core.at(core.now + SPINDLE_DELAY, lambda: _resume(core))
        else:
            _resume(core)
    elif (
        core.state == "Door"
        and core.hold_complete
        and not core.resuming
        and not core.environment.door_open
    ):
        core.spindle_stopped = False
        modes = core.modes
        delay = (SPINDLE_DELAY if modes.spindle != "M5" else 0.0) + (
            COOLANT_DELAY if modes.flood or modes.mist else 0.0
        )
        core.outputs_on()
        core.resuming = True
        core.at(core.now + delay, lambda: _resume(core))


def _resume(core: Core) -> None:
    """Resume after a hold."""
    core.note("resume")
    core.resuming = core.hold_complete = False
    core.steppers.holding = False
    core.state = "Idle"
    if core.planner.blocks:
        core.state = "Run"
        core.steppers.resume(core.now)


def _override(core: Core, byte: int) -> None:
    """Serve overrides of feed, rapid and spindle, and toggles of spindle and coolants."""
    planner = core.planner
    before = (planner.feed_override, planner.rapid_override, core.spindle_override)
    if byte in FEED:
        planner.feed_override = _scaled(planner.feed_override, FEED[byte])
    elif byte in RAPID:
        planner.rapid_override = RAPID[byte]
    elif byte in SPINDLE:
        core.spindle_override = _scaled(core.spindle_override, SPINDLE[byte])
        if core.spindle_text[:2] != "M5":
            core.set_spindle(core.modes.spindle, core.modes.speed)
    elif byte == SPINDLE_STOP and core.state == "Hold" and core.modes.spindle != "M5":
        core.spindle_stopped = not core.spindle_stopped
        core.set_spindle("M5" if core.spindle_stopped else core.modes.spindle, core.modes.speed)
    elif (byte == FLOOD or (byte == MIST and "M7" in core.profile.codes)) and core.state in (
        "Idle",
        "Run",
        "Hold",
    ):
        core.toggle_coolant(mist=byte == MIST)
    if before != (planner.feed_override, planner.rapid_override, core.spindle_override):
        core.override_counter = 0
        core.note(
            "override", f"{planner.feed_override},{planner.rapid_override},{core.spindle_override}"
        )
        core.steppers.replan(core.now)


def _scaled(percent: int, change: int) -> int:
    """Return a new override; a change of 0 sets it to 100."""
    return min(max(percent + change, LEAST), LARGEST) if change else 100


# Faults on demand, and when they happen.
#
# simulator.inject(Drop(3), byte=200)        from the 200th byte that the host sends
# simulator.inject(Swallow(1), line=40)      the next reply after the 40th line
# simulator.inject(Unplug(), time=2.5)       2.5 s after the simulator was made
# simulator.inject(Alarm(3))                 now


@dataclass(frozen=True, slots=True)
class Drop:
    """The next ``count`` bytes towards the board are lost."""

    count: int = 1


@dataclass(frozen=True, slots=True)
class Duplicate:
    """The next ``count`` bytes towards the board arrive twice."""

    count: int = 1


@dataclass(frozen=True, slots=True)
class Corrupt:
    """The next ``count`` bytes towards the board have one bit wrong."""

    count: int = 1


@dataclass(frozen=True, slots=True)
class Swallow:
    """The next ``count`` replies (ok, error:n) are not sent."""

    count: int = 1


@dataclass(frozen=True, slots=True)
class Freeze:
    """The main program hangs: no answers; planned motion runs out; bytes still fill the ring."""

    seconds: float = math.inf


@dataclass(frozen=True, slots=True)
class Unplug:
    """The cable is unplugged. The board continues."""


@dataclass(frozen=True, slots=True)
class Alarm:
    """An alarm with its stop."""

    code: int


@dataclass(frozen=True, slots=True)
class Error:
    """The next line is not carried out, but answered with this error."""

    code: int


Fault = Drop | Duplicate | Corrupt | Swallow | Freeze | Unplug | Alarm | Error
WRONG_BIT = 0x04
"""The wrong bit of a corrupted byte: a letter becomes another, a digit another or a sign."""


COUNTED: dict[str, type[Drop | Duplicate | Corrupt | Swallow]] = {
    "drop": Drop,
    "duplicate": Duplicate,
    "corrupt": Corrupt,
    "swallow": Swallow,
}
KINDS = (*COUNTED, "freeze", "unplug", "alarm", "error")


@dataclass(frozen=True, slots=True)
class ScheduledFault:
    """A fault and when it happens, as GrblSimulator.inject takes them."""

    fault: Fault
    byte: int | None = None
    line: int | None = None
    time: float | None = None


def parse_fault(text: str) -> ScheduledFault:
    """Return the fault of ``kind[:amount][@byte|line|time:number]``.

    Examples: ``drop:3@line:40``, ``unplug@time:2.5``.

    Raises:
        ValueError: The text does not have this form.
    """
    kind, _, moment = text.partition("@")
    name, _, amount = kind.partition(":")
    if name not in KINDS:
        raise ValueError(f"no fault is called {name!r}; known are {', '.join(KINDS)}")
    if name == "freeze":
        fault: Fault = Freeze(float(amount)) if amount else Freeze()
    elif name in ("alarm", "error"):
        fault = (Alarm if name == "alarm" else Error)(int(amount))
    elif name == "unplug":
        fault = Unplug()
    else:
        fault = COUNTED[name](int(amount or "1"))
    where, _, number = moment.partition(":")
    if not moment:
        return ScheduledFault(fault)
    if where == "time":
        return ScheduledFault(fault, time=float(number))
    if where == "byte":
        return ScheduledFault(fault, byte=int(number))
    if where == "line":
        return ScheduledFault(fault, line=int(number))
    raise ValueError(f"a fault happens at a byte, a line or a time, not at {where!r}")


class ByteFaults:
    """Faults of bytes on the wire to the board."""

    def __init__(self) -> None:
        self.drop = self.duplicate = self.corrupt = 0

    def pass_on(self, byte: int) -> tuple[int, ...]:
        """Return the bytes that arrive for one byte."""
        if self.drop:
            self.drop -= 1
            return ()
        if self.corrupt:
            self.corrupt -= 1
            byte ^= WRONG_BIT
        if self.duplicate:
            self.duplicate -= 1
            return (byte, byte)
        return (byte,)


BAUD = 115200
BOOT_TIME = 1.5
"""Seconds of the Arduino's boot loader, from a reset by DTR to the welcome."""
PROBE_ALARMS = (4, 5)
WITHOUT_RESET = (*CRITICAL, *PROBE_ALARMS)
"""Alarms without a reset of the firmware: those that wait for one, and those of the probe."""


@dataclass(slots=True)
class PendingFault:
    """A fault that waits for its byte, line or time."""

    fault: Fault
    byte: int | None
    line: int | None
    time: float


class GrblSimulator:
    """A GRBL board without power.

    Args:
        profile: The firmware.
        baud: Speed of the link, bit/s.
        settings: ``$`` settings that differ from those of a new board.
        environment: Switches, workpiece and door around the board.

    Attributes:
        plugged: Whether the cable is connected.
        dtr: Whether the host's DTR line is up. Its rise resets the processor through a capacitor,
            as on every Arduino.
    """

    def __init__(
        self,
        profile: FirmwareProfile = GRBL,
        *,
        baud: float = BAUD,
        settings: dict[int, float] | None = None,
        environment: Environment | None = None,
    ) -> None:
        memory = profile.settings | (settings or {})
        self.core = Core(
            profile,
            baud,
            environment or Environment.of_travels(memory[130], memory[131], memory[132]),
        )
        self.core.eeprom.settings.update(memory)
        self.firmware = Firmware(self.core)
        self.plugged = True
        self.dtr = False
        self._byte_faults = ByteFaults()
        self._pending: list[PendingFault] = []
        self._program = self.firmware.run()
        self._wait: Wait = BUSY

    @property
    def now(self) -> float:
        """Time of the simulator's clock, s."""
        return self.core.now

    @property
    def position(self) -> Point:
        """True machine position, mm."""
        return self.core.position

    @property
    def speed(self) -> float:
        """Speed along the path, mm/s."""
        return self.core.steppers.state(self.core.now)[1]

    @property
    def moves(self) -> list[Move]:
        """Every block that has begun to move, in order."""
        return self.core.steppers.moves

    @property
    def events(self) -> list[Event]:
        """Every other action, in order."""
        return self.core.events

    def toolpath(self) -> NDArray[np.float64]:
        """Return the corners of the toolpath (n, 3), mm, with straight lines between them."""
        corners = [corner for move in self.moves for corner in (move.start, move.reached)]
        return np.array(corners or [self.position])

    @property
    def lost(self) -> int:
        """Bytes that the board has lost, to a full ring or during an EEPROM write."""
        return self.core.receiver.lost

    @property
    def fullest(self) -> int:
        """Most bytes that the ring has held."""
        return self.core.receiver.fullest

    def raise_dtr(self, delay: float = BOOT_TIME) -> None:
        """Raise DTR, as every system does when it opens a port: a reset, unless the line was up."""
        if not (self.dtr and self.plugged):
            self.power_up(delay)
        self.dtr = True

    def drop_dtr(self) -> None:
        """Drop DTR, as closing a port does unless HUPCL is off. The board does not react."""
        self.dtr = False

    def power_up(self, delay: float = BOOT_TIME) -> None:
        """Reset the board.

        Motion stops at once. Position, offset (G92) and state are lost; the memory is kept.
        Bytes that arrive within ``delay`` s are lost.
        """
        core = self.core
        if core.steppers.running:
            core.note("reset", "power")
        core.stop_dead()
        core.receiver.ring.clear()
        core.receiver.unplug()
        core.transmitter.unplug()
        core.environment.offset = tuple(
            a + x for a, x in zip(core.environment.offset, core.position, strict=False)
        )
        core.steppers.position = core.origin
        core.state = "Idle"
        core.force_reset()
        core.cpu_free = core.now + delay
        self.plugged = True
        self.firmware = Firmware(core)
        self._program = self.firmware.run()
        self._wait = BUSY

    def write(self, data: bytes) -> None:
        """Send bytes from the host."""
        if self.plugged:
            self.core.receiver.write(data, self.core.now)

    def read(self) -> bytes:
        """Return the bytes that the host can read now."""
        return self.core.transmitter.collect(self.core.now)

    def inject(
        self,
        fault: Fault,
        *,
        byte: int | None = None,
        line: int | None = None,
        time: float | None = None,
    ) -> None:
        """Cause a fault: now, or at a byte, a line or a time.

        Args:
            fault: The fault.
            byte: Number of the received byte, from 1.
            line: Number of the received line, from 1.
            time: Time of the simulator's clock, s.
        """
        when = (
            -math.inf
            if byte is None and line is None and time is None
            else math.inf
            if time is None
            else time
        )
        self._pending.append(PendingFault(fault, byte, line, when))
        self._trigger_faults()

    def advance(self, until: float, *, answer: bool = False) -> None:
        """Let time pass.

        Args:
            until: Time to reach, s.
            answer: Stop as soon as the host can read bytes, or finds the cable unplugged.
        """
        core = self.core
        while True:
            self._run_program()
            limit = min(until, core.transmitter.arrival) if answer else until
            motion, timer, byte = core.steppers.event, core.timer, core.receiver.arrival
            other = min(motion, timer, self._program_time(), self._fault_time())
            time = min(byte, other)
            if answer and not self.plugged:
                return
            if time > limit:
                core.now = max(core.now, limit)
                return
            core.now = max(core.now, time)
            if byte <= other:
                self._receive(min(other, limit))
            elif time == motion:
                core.motion_event()
            elif time == timer:
                core.run_timer()
            else:
                self._trigger_faults()

    def _program_time(self) -> float:
        """Return when the main program can continue without another event."""
        core = self.core
        if core.now < core.cpu_free:
            return core.cpu_free
        return (
            self._wait.until
            if self._wait.serves and not core.suspended and self._wait.until > core.now
            else math.inf
        )

    def _receive(self, until: float) -> None:
        """Take bytes off the wire before ``until``, until one of them causes an event."""
        core, receiver, firmware = self.core, self.core.receiver, self.firmware
        while receiver.arrival <= until:
            core.now = max(core.now, receiver.arrival)
            for byte in self._byte_faults.pass_on(receiver.take()):
                if not receiver.seen(core.now):
                    continue
                if is_realtime(core, byte):
                    receive(core, byte)
                    until = -math.inf
                elif (
                    firmware.reading
                    and not receiver.ring
                    and not firmware.complete
                    and not core.suspended
                ):
                    # The program waits for bytes: they pass through the ring at once.
                    receiver.fullest = max(receiver.fullest, 1)
                    if firmware.buffer.feed(byte):
                        firmware.complete = True
                        until = -math.inf
                else:
                    receiver.store(byte)
                    if firmware.reading:
                        until = -math.inf
            if self._pending:
                self._trigger_faults()
                until = -math.inf

    def _run_program(self) -> None:
        """Run the main program as far as it can go."""
        core = self.core
        while core.now >= core.cpu_free:
            wait = self._wait
            if wait.serves:
                serve(core)
                if core.now < core.cpu_free:
                    return
                if core.aborted:
                    self._wait = self._program.throw(Abort)
                    continue
                if core.abandoned:
                    core.abandoned = False
                    self._wait = self._program.throw(Abandon)
                    continue
                if core.suspended or not (core.now >= wait.until or wait.condition()):
                    return
            self._wait = next(self._program)
            if self._pending:
                self._trigger_faults()

    def _fault_time(self) -> float:
        return min((pending.time for pending in self._pending), default=math.inf)

    def _trigger_faults(self) -> None:
        """Cause the faults that are due."""
        core = self.core
        for pending in list(self._pending):
            by_byte = pending.byte is not None and core.receiver.received + 1 >= pending.byte
            by_line = pending.line is not None and core.lines >= pending.line
            if by_byte or by_line or pending.time <= core.now:
                self._pending.remove(pending)
                self._apply(pending.fault)

    def _apply(self, fault: Fault) -> None:
        core = self.core
        match fault:
            case Drop(count):
                self._byte_faults.drop += count
            case Duplicate(count):
                self._byte_faults.duplicate += count
            case Corrupt(count):
                self._byte_faults.corrupt += count
            case Swallow(count):
                core.swallow += count
            case Freeze(seconds):
                core.cpu_free = max(core.cpu_free, core.now) + seconds
            case Unplug():
                self.plugged = self.dtr = False
                core.receiver.unplug()
                core.transmitter.unplug()
            case Error(code):
                core.forced_error = code
            case Alarm(code):
                core.stop_dead()
                core.sync_position()
                core.abandoned = core.answering and code in PROBE_ALARMS
                core.flags.reset = core.flags.reset or code not in (
                    *WITHOUT_RESET,
                    core.profile.estop_alarm,
                )
                core.alarm(code)
