"""The board: its parts, and the one clock that moves them.

Nothing happens by itself: :meth:`GrblSimulator.advance` goes from event to event in the order of time,
each the earliest of

    a byte is off the wire | the processor is free | a wait is over | a block ends | a timer | a
    fault

so a run depends on nothing but the bytes, their moments, and the faults asked for.
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
"""Seconds from a reset by DTR to the welcome: the Arduino's boot loader waits for a new program
first.
"""
PROBE_ALARMS = (4, 5)
WITHOUT_RESET = (*CRITICAL, *PROBE_ALARMS)
"""Alarms that do not come with a reset of the firmware: those that wait for one, and the
probe's.
"""


@dataclass(slots=True)
class Due:
    """A fault that waits for its moment."""

    fault: Fault
    byte: int | None
    line: int | None
    time: float


class GrblSimulator:
    """A GRBL board, not yet switched on. ``settings``: ``$`` settings that differ from a fresh
    board's. ``environment``: what is around it.
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
        """Whether the host's DTR line is up. Its rise resets the processor, through a capacitor, as
        on every Arduino.
        """
        self._byte_faults = ByteFaults()
        self._due: list[Due] = []
        self._program = self.firmware.run()
        self._wait: Wait = BUSY

    @property
    def now(self) -> float:
        """The simulator's clock, s."""
        return self.core.now

    @property
    def position(self) -> Point:
        """True machine position, mm."""
        return self.core.position

    @property
    def speed(self) -> float:
        """Along the path, mm/s."""
        return self.core.steppers.state(self.core.now)[1]

    @property
    def moves(self) -> list[Move]:
        """Every block that has begun to move, in order."""
        return self.core.steppers.moves

    @property
    def events(self) -> list[Event]:
        """Everything else that was done, in order."""
        return self.core.events

    def toolpath(self) -> NDArray[np.float64]:
        """Every corner of the way that was moved, (n, 3) mm: what lies between two rows is
        straight.
        """
        corners = [corner for move in self.moves for corner in (move.start, move.reached)]
        return np.array(corners or [self.position])

    @property
    def lost(self) -> int:
        """Bytes that reached the board and were lost there: to a full ring or to an EEPROM
        write.
        """
        return self.core.receiver.lost

    @property
    def fullest(self) -> int:
        """The most bytes that the ring has held."""
        return self.core.receiver.fullest

    def raise_dtr(self, delay: float = BOOT_TIME) -> None:
        """A host raises DTR, as every system does when it opens a port: a reset, unless the line
        was left up.
        """
        if not (self.dtr and self.plugged):
            self.power_up(delay)
        self.dtr = True

    def drop_dtr(self) -> None:
        """The host drops DTR, as closing a port does unless HUPCL is off. The board does not
        notice.
        """
        self.dtr = False

    def power_up(self, delay: float = BOOT_TIME) -> None:
        """A reset: motion stops dead, position, offset (G92) and state are lost, memory stays;
        bytes sent in ``delay`` s are lost.
        """
        core = self.core
        if core.steppers.running:
            core.note("reset", "power")
        core.stop_dead()
        core.receiver.ring.clear()
        core.receiver.unplug()
        core.transmitter.unplug()
        (a, b, c), (x, y, z) = core.environment.offset, core.position
        core.environment.offset = (a + x, b + y, c + z)
        core.steppers.position = (0.0, 0.0, 0.0)
        core.state = "Idle"
        core.force_reset()
        core.cpu_free = core.now + delay
        self.plugged = True
        self.firmware = Firmware(core)
        self._program = self.firmware.run()
        self._wait = BUSY

    def write(self, data: bytes) -> None:
        """The host sends."""
        if self.plugged:
            self.core.receiver.write(data, self.core.now)

    def read(self) -> bytes:
        """What the host can read now."""
        return self.core.transmitter.collect(self.core.now)

    def inject(
        self,
        fault: Fault,
        *,
        byte: int | None = None,
        line: int | None = None,
        time: float | None = None,
    ) -> None:
        """Let something go wrong: now, or at the byte or line that is the simulator's number ``byte`` or
        ``line`` (from 1), or at a time.
        """
        when = (
            -math.inf
            if byte is None and line is None and time is None
            else math.inf
            if time is None
            else time
        )
        self._due.append(Due(fault, byte, line, when))
        self._strike()

    def advance(self, until: float, *, answer: bool = False) -> None:
        """Let time pass to ``until``; with ``answer``, no further than to when the host can read
        something, or finds the cable gone.
        """
        core = self.core
        while True:
            self._run_program()
            limit = min(until, core.transmitter.arrival) if answer else until
            motion, timer, byte = core.steppers.event, core.timer, core.receiver.arrival
            other = min(motion, timer, self._wake(), self._fault_time())
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
                self._strike()

    def _wake(self) -> float:
        """When the main program may go on without anything else happening."""
        core = self.core
        if core.now < core.cpu_free:
            return core.cpu_free
        return (
            self._wait.until
            if self._wait.serves and not core.suspended and self._wait.until > core.now
            else math.inf
        )

    def _receive(self, until: float) -> None:
        """Bytes off the wire, as long as none of them makes something happen before ``until``."""
        core, receiver, firmware = self.core, self.core.receiver, self.firmware
        while receiver.arrival <= until:
            core.now = max(core.now, receiver.arrival)
            for byte in self._byte_faults.pass_on(receiver.take()):
                if not receiver.seen(core.now):
                    continue
                if realtime.is_realtime(byte):
                    realtime.receive(core, byte)
                    until = -math.inf
                elif (
                    firmware.reading
                    and not receiver.ring
                    and not firmware.complete
                    and not core.suspended
                ):
                    # The program waits for bytes: they go through the ring without staying in it.
                    receiver.fullest = max(receiver.fullest, 1)
                    if firmware.buffer.feed(byte):
                        firmware.complete = True
                        until = -math.inf
                else:
                    receiver.store(byte)
                    if firmware.reading:
                        until = -math.inf
            if self._due:
                self._strike()
                until = -math.inf

    def _run_program(self) -> None:
        """Let the main program go on as far as it can."""
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
            if self._due:
                self._strike()

    def _fault_time(self) -> float:
        return min((due.time for due in self._due), default=math.inf)

    def _strike(self) -> None:
        """Let those faults happen whose moment has come."""
        core = self.core
        for due in list(self._due):
            by_byte = due.byte is not None and core.receiver.received + 1 >= due.byte
            by_line = due.line is not None and core.lines >= due.line
            if by_byte or by_line or due.time <= core.now:
                self._due.remove(due)
                self._happen(due.fault)

    def _happen(self, fault: Fault) -> None:
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
