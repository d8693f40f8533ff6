"""The simulated board: its parts, and the clock that advances them.

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

from cnc.boards.grbl.simulator import realtime
from cnc.boards.grbl.simulator.core import BUSY, CRITICAL, Abandon, Abort, Core, Event, Wait
from cnc.boards.grbl.simulator.environment import Environment
from cnc.boards.grbl.simulator.faults import (
    Alarm,
    ByteFaults,
    Corrupt,
    Drop,
    Duplicate,
    Error,
    Fault,
    Freeze,
    Swallow,
    Unplug,
)
from cnc.boards.grbl.simulator.firmware import Firmware
from cnc.boards.grbl.simulator.firmware_profile import GRBL, FirmwareProfile
from cnc.boards.grbl.simulator.planner import Move, Point

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
                if realtime.is_realtime(core, byte):
                    realtime.receive(core, byte)
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
                realtime.serve(core)
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
