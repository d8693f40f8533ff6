"""The driver of a GRBL board (1.1 or grblHAL): a board that takes lines.

At rest the board is operated: jog, offsets, unlock, the next program after a stop. Sources: "Grbl
v1.1 Jogging" (``$J=`` and the cancel byte 0x85), "Grbl v1.1 Commands" (``$X``), LinuxCNC, G10 L20
and G92, which GRBL follows.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.boards.grbl import faults
from cnc.boards.grbl.fault_monitor import FULL_OVERRIDE
from cnc.boards.grbl.faults import at_door, laser_mode_off, offset_differs, offset_not_kept
from cnc.boards.grbl.line_stream import LineStream
from cnc.boards.grbl.link import POLL_FAST, GrblLink
from cnc.boards.grbl.messages import (
    CONDITIONS,
    INPUTS,
    SAME_POSITION,
    WAITING,
    Alarmed,
    Started,
    Status,
)
from cnc.boards.grbl.protocol import RealTime, State, groups_of
from cnc.boards.grbl.setting_changes import GrblSettings, differences
from cnc.boards.grbl.settings import ACCELERATIONS, RATES, STEPS, SYSTEMS, BoardInfo
from cnc.boards.port import Clock, Port, SystemClock
from cnc.boards.protocols import (
    BoardTraits,
    Capabilities,
    LineSink,
    MachineReport,
    OnReport,
    board_error,
)
from cnc.boards.serial_port import identity, open_port
from cnc.machine.models import Machine
from cnc.model.blocks import AXIS_LETTERS, Block
from cnc.model.diagnostics import BoardError, Diagnostic, UsageError
from cnc.model.operator_control import Control
from cnc.model.streams import LinesSent, PackedLines
from cnc.model.units import per_minute, per_second

SERVED = 0.005
"""Longest time to the next look at the release of a jog, s."""
REPEATED = 0.1
"""Time after which a cancel that shows no effect is sent again, s: a byte may be lost."""
RESTS = 2
"""Reports of rest after the last answer: the first may be older than the motion."""
PIECE_S = 0.05
"""Length of a piece of a jog, s."""
AHEAD_S = 0.25
"""Length of the pieces that the board has, s; it brakes from every speed of a jog within it."""
SHORTEST_PIECE = 0.05
"""mm; GRBL reads three decimals."""
SERVED_IN_RUN = 0.01
"""Longest time until a request of the operator is served during a run, s."""
STOP_LATENCY = 0.05
"""Time from a release to the cancel of a jog at the board, s: the link, and a turn of its loop."""


class GrblBoard(LineSink):
    """A GRBL board at a port; call :meth:`connect` first.

    Faults, each a BoardError at its source line: ``board-error``, ``board-alarm``,
    ``board-silent``, ``board-restarted``, ``reply-lost``, ``reply-missing``, ``board-stuck``,
    ``board-locked``, ``line-too-long``, ``port-lost``, ``board-not-started``, ``board-stopped``.

    Attributes:
        identity: Identifies the board from one run to the next; None if nothing is kept of it.
        restarted: Whether the board restarted when it was connected, and counts from zero.
        check_only: Whether the board only checks lines, and nothing moves.
        stream: Sends the lines.
    """

    traits = BoardTraits(has_settings=True)
    stream_type: type[LineStream] = LineStream

    def __init__(
        self,
        port: Port,
        machine: Machine,
        clock: Clock | None = None,
        name: str = "the port",
        identity: str | None = None,
    ) -> None:
        """``machine`` names the axes; ``name`` is the name of the port, for messages."""
        self.identity = identity
        self.link = GrblLink(port, clock or SystemClock(), name, machine.board.baud)
        self.stream = self.stream_type(self.link)
        self.check_only = False
        self.restarted = False
        self._machine = machine
        self._columns = [AXIS_LETTERS.index(letter) for letter in machine.axes]
        self._offset_unchecked = True
        self._shift_unset = False

    @classmethod
    def from_machine(cls, machine: Machine, target: Path | None = None) -> GrblBoard:
        """Return the connected board at the port of the machine file.

        Raises:
            UsageError: ``no-port``.
            BoardError: The board does not answer as a GRBL board does.
        """
        name = machine.board.port
        if name is None:
            hint = (
                "name it with --port /dev/ttyUSB0, or as board.port in the machine file; "
                "cncrun boards lists the ports"
            )
            raise UsageError(Diagnostic("no-port", "a GRBL board needs a port", hint=hint))
        board = cls(
            open_port(name, machine.board.baud), machine, name=name, identity=identity(name)
        )
        try:
            board.connect()
        except BaseException:
            board.close()
            raise
        return board

    def connect(self) -> None:
        """Find out firmware, settings and position. Nothing moves."""
        self.link.connect()
        # A board that does not stand at zero has not restarted: grblHAL greets each new network
        # connection.
        self.restarted = self.link.greeted_unasked and not any(self.stream.position)
        axes = len(self.stream.position)
        letters = (self.info.letters or "".join(AXIS_LETTERS).upper())[:axes]
        missing = [
            letter.upper()
            for letter, column in zip(self._machine.axes, self._columns, strict=True)
            if letters[column : column + 1] != letter.upper()
        ]
        if missing:
            names = ", ".join(letters)
            message = f"the machine file has an axis {missing[0]}; the board has {names}"
            hint = "give the axis the name that the board has for it, or remove it from the file"
            raise board_error("board-axes", message, hint=hint)
        if self.info.tool_length and self.status.state == "Idle":
            self.link.ask("G49")
            self.info.tool_length = 0.0

    @property
    def state(self) -> str:
        """``idle``, ``running`` or ``stopped``."""
        return self.stream.state

    @property
    def info(self) -> BoardInfo:
        """Firmware, settings and offsets."""
        return self.link.info

    @property
    def status(self) -> Status:
        """The last status report."""
        return self.stream.status

    @property
    def report(self) -> MachineReport:
        """State, work position, feed and spindle speed, as last reported."""
        status, offset = self.status, self.status.offset
        work = [a - b for a, b in zip(status.position or (), offset or (), strict=False)]
        axes = self._machine_axes(tuple(work))
        pins, letters = status.pins, [letter for letter in self._machine.axes if letter in "xyz"]
        inputs = {f"limit {letter}": letter.upper() in pins for letter in letters}
        inputs |= {name: pin in pins for pin, name in INPUTS.items() if pin in "PD" or pin in pins}
        return MachineReport(
            status.state,
            axes,
            status.feed,
            status.speed,
            status.overrides,
            CONDITIONS.get(status.state, "idle"),
            inputs,
        )

    @property
    def operation(self) -> GrblOperation:
        """Its operation at rest."""
        return GrblOperation(self)

    def numbered_settings(self) -> GrblSettings:
        """Return its settings (``$$``). UsageError ``no-settings`` where a file has them."""
        if not self.info.settings:
            message = f"the board has no numbered settings ({self.info.firmware})"
            hint = "FluidNC keeps them in its file config.yaml: change that file"
            raise UsageError(Diagnostic("no-settings", message, hint=hint))
        return GrblSettings(self.link)

    @property
    def capabilities(self) -> Capabilities:
        """The board takes lines and answers probes."""
        rate = self._machine.board.max_step_rate
        return Capabilities(
            axes=len(self._machine.axes),
            max_step_rate=rate,
            tick_ns=1e9 / rate,
            senses=True,
            stop_latency_s=STOP_LATENCY,
            overrides=True,
        )

    @property
    def confirmed_line(self) -> int:
        """Source line of the last line that the board has accepted.

        It lies at most a planner's length ahead of the motion.
        """
        return self.link.protocol.confirmed_line

    @property
    def moving_line(self) -> int:
        """Source line of the move at the last report; 0 where it is not known."""
        return self.stream.monitor.tracker.line

    @property
    def position(self) -> tuple[float, ...]:
        """The last reported machine position, mm, one number for each axis of the machine."""
        return self._machine_axes(self.stream.position)

    @property
    def position_lost(self) -> bool:
        """Whether the motors may have lost steps since the connection: an alarm stopped them."""
        return self.link.position_lost

    @property
    def homed_position(self) -> tuple[float, ...]:
        """Machine position of each axis of the machine after homing, mm, by the settings."""
        columns = zip(self._columns, self.position, strict=True)
        return tuple(self.info.homed(column, here) for column, here in columns)

    @property
    def holds(self) -> bool:
        """Whether the machine rests until it is resumed, as last reported."""
        return self.status.state in WAITING and self.status.at_rest

    @property
    def hold_reason(self) -> str:
        """Why the machine itself holds, and how to go on: the safety door; "" if it does not."""
        return self.status.door

    @property
    def ceiling(self) -> float | None:
        """Highest position of Z that keeps clear of its limit switch, mm; None without one."""
        return self.info.top(AXIS_LETTERS.index("z")) if self.info.homes else None

    @property
    def work_offset(self) -> tuple[float, ...]:
        """Offset that the board adds to coordinates in G54, mm, for each axis of the machine."""
        return self._machine_axes(self.info.g54_offset(len(self.stream.position)))

    @property
    def stored_offsets(self) -> dict[str, tuple[float, ...]]:
        """G54 to G59, G28, G30 and G92 of the board, mm, for each axis of the machine."""
        return {
            name: self._machine_axes(place)
            for name, place in self.info.places.items()
            if len(place) >= len(self._columns)
        }

    @property
    def settings(self) -> dict[int, float]:
        """The ``$`` settings by number."""
        return {
            number: value
            for number in self.info.settings
            if (value := self.info.number(number)) is not None
        }

    def unlike(self, machine: Machine) -> list[Diagnostic]:
        """Return warnings where the settings of the board differ from the machine file."""
        return differences(self.info, machine)

    @property
    def planner_blocks(self) -> int:
        """Moves that the planner of the board holds, 0 where it is not known."""
        return self.info.blocks

    @property
    def codes(self) -> frozenset[str]:
        """M6 and M7, if the board has them."""
        return self.info.codes

    @property
    def unused_tool_change(self) -> str:
        """What grblHAL would do at an M6, in place of our pause; "" for nothing."""
        return self.info.unused_tool_change

    def limited_to_board(self, machine: Machine) -> Machine:
        """Return the machine as the board limits it: travel by its soft limits, laser by its mode.

        Raises:
            BoardError: ``laser-mode-off`` if the board is not in laser mode, but the machine is a
                laser: the beam would stay on in traverses and stops.
        """
        if machine.kind == "laser" and not self.info.may_be_laser:
            raise laser_mode_off()
        return self.info.narrowed(machine)

    @property
    def resolution(self) -> tuple[float, ...]:
        """One step of each axis by the board's settings, else by the machine file, mm."""
        axes = zip(self._columns, self._machine.axes.values(), strict=True)
        return tuple(
            1.0 / (self.info.axis(STEPS, column) or axis.steps_per_mm) for column, axis in axes
        )

    @property
    def buffered(self) -> int:
        """Lines that were sent and are not carried out yet, as far as that is known."""
        return max(self.link.protocol.waiting, self.stream.monitor.tracker.lines)

    @property
    def rapid_override(self) -> int:
        """The last reported override of traverses, per cent."""
        full = (FULL_OVERRIDE, FULL_OVERRIDE, FULL_OVERRIDE)
        return (self.status.overrides or full)[1]

    @property
    def lines_sent(self) -> LinesSent:
        """The lines sent since :meth:`start`."""
        stream = self.stream
        return LinesSent(stream.sent, stream.began, stream.rested_at)

    def now(self) -> float:
        """Return the time by the clock of the link, s."""
        return self.link.now()

    def restore_shift(self, shift: Mapping[str, float]) -> None:
        """Set the G92 that a reset has cleared, and read it back; nothing where the board has one.

        Args:
            shift: Offset by axis, mm. A locked board gets it when it has been homed or unlocked.

        Raises:
            BoardError: ``offset-not-kept`` where the board keeps another offset.
        """
        places = self.info.places
        if any(places.get("G92", ())):
            return
        offsets = [shift.get(letter, 0.0) for letter in AXIS_LETTERS[: len(self.stream.position)]]
        places["G92"] = tuple(offsets)
        self._shift_unset = any(offsets)
        self.set_cleared_shift()

    def shift_cleared(self) -> None:
        """Set G92 as it was before a reset that has cleared it."""
        self._shift_unset = any(self.info.places.get("G92", ()))
        self.set_cleared_shift()

    def set_cleared_shift(self) -> None:
        """Set a cleared G92, as soon as the board is not locked."""
        link, info = self.link, self.info
        if not self._shift_unset or link.refresh().state != "Idle":
            return
        self._shift_unset = False
        wanted, offset = info.places["G92"], info.g54_offset(len(self.stream.position))
        words = "".join(
            f"{letter.upper()}{here - all_offsets:.4f}"
            for letter, here, all_offsets in zip(
                AXIS_LETTERS, self.stream.position, offset, strict=False
            )
        )
        link.ask(f"G21G54G92{words}")
        info.take(link.ask("$#"))
        link.refresh()
        kept = info.places["G92"]
        if any(abs(a - b) > SAME_POSITION for a, b in zip(kept, wanted, strict=True)):
            raise offset_not_kept("G92", wanted, kept)

    def connect_operator(self, control: Control, on_report: OnReport) -> None:
        """Serve the operator's requests, and call ``on_report`` after each status report."""
        self.stream.connect_operator(control, on_report)

    def start(self, origin_steps: NDArray[np.int64]) -> None:
        """Prepare a run.

        Raises:
            BoardError: ``board-busy`` unless the machine is at rest; ``board-moved`` where it was
                moved since the last report.
        """
        self._refuse_if_stopped()
        link, stream = self.link, self.stream
        before, status = stream.position, link.refresh()
        if status.state not in ("Idle", "Alarm"):
            if status.door:
                raise at_door(status)
            hint = "wait until it has come to rest"
            if status.state == "Sleep":
                hint = "reset the board"
            message = f"the board is not ready; it reports {status.state}"
            raise board_error("board-busy", message, hint=hint)
        if any(abs(a - b) > SAME_POSITION for a, b in zip(before, stream.position, strict=True)):
            message = "the machine was moved while the program was read"
            raise board_error("board-moved", message, hint="start again")
        self._offset_unchecked = True
        self.set_cleared_shift()
        stream.state = "running"
        if self.check_only:
            link.ask("$C")
            link.refresh()
        stream.begin(self.info.g54_offset(len(self.stream.position)), moves=not self.check_only)

    def send_lines(self, lines: PackedLines) -> None:
        """Send lines as soon as there is space; those after a stop of the operator stay unsent."""
        stream = self.stream
        self._refuse_unless_running()
        for group in groups_of(lines):
            line = group.lines[0]
            if not stream.send(group):
                return
            if group.kind == "system":
                # The command may change lock and position.
                stream.settle()
                stream.refuse_if_locked(line, unless=stream.stopping)
                if not stream.stopping:
                    self.set_cleared_shift()
            elif self._offset_unchecked and group.kind != "writer":
                self._offset_unchecked = False
                self._check_offset(line)

    def execute(self, block: Block, time_ns: int) -> tuple[float, ...] | None:
        """Wait until the lines sent so far have been carried out.

        Returns:
            After a probe: 1 or 0 for contact or none, and the machine position of the contact, mm.
        """
        self._refuse_unless_running()
        self.stream.settle()
        answer, self.stream.probed = self.stream.probed, None
        if answer is None:
            return None
        return (answer[-1], *self._machine_axes(answer))

    def finish(self) -> None:
        """Return when all lines have been answered and the machine is at rest."""
        self._refuse_unless_running()
        self.stream.settle()
        if self.stream.stopping:
            return
        if self.check_only:
            self.stream.end_check_mode()
            self.shift_cleared()
        else:
            self.stream.end_overrides()
        self.stream.state = "idle"

    def stop(self) -> None:
        """Hold, wait for rest, and reset.

        Lines that are not carried out are dropped; the position is kept.
        """
        running, waiting = self.state == "running", self.link.protocol.waiting
        fault = self.link.halt() if running else None
        self.stream.state = "stopped"
        if fault is not None:
            raise self.stream.at_confirmed(fault)
        if running:
            self.stream.monitor.tracker.stopped(self.stream.position, waiting)

    def abort(self) -> None:
        """Stop: nothing is quicker that keeps the position."""
        self.stop()

    def close(self) -> None:
        """Stop a run, and close the port."""
        with contextlib.suppress(BoardError):
            self.stop()
        self.link.close()

    def _machine_axes(self, values: tuple[float, ...]) -> tuple[float, ...]:
        """Return the values of the machine's axes out of those of the board's."""
        return tuple(values[column] for column in self._columns) if values else ()

    def _check_offset(self, line: int) -> None:
        """Compare the offset of the board with the one that the lines were made for.

        The first line has selected the coordinate system; a line that writes an offset has not.
        """
        stream = self.stream
        if self.status.state == "Alarm":
            self._offset_unchecked = True
            return
        stream.rest()
        offset = self.status.offset
        if stream.stopping or offset is None:
            return
        ours = self.info.g54_offset(len(stream.position))
        if any(abs(a - b) > SAME_POSITION for a, b in zip(offset, ours, strict=False)):
            raise stream.stopped_by(offset_differs(offset, line))

    def _refuse_if_stopped(self) -> None:
        if self.state == "stopped":
            hint = "connect it again"
            raise board_error("board-stopped", "the board has been stopped", hint=hint)

    def _refuse_unless_running(self) -> None:
        self._refuse_if_stopped()
        if self.state != "running":
            raise board_error("board-not-started", "no program has been started on the board")


@dataclass(frozen=True, slots=True)
class JogLine:
    """A straight jog.

    Attributes:
        start: Machine position of the axes that move, mm.
        end: Its end.
        feed: Speed, mm/s.
    """

    start: Mapping[str, float]
    end: Mapping[str, float]
    feed: float

    @property
    def length(self) -> float:
        """Its length, mm."""
        return math.dist(tuple(self.start.values()), tuple(self.end.values()))

    def line(self, distance: float) -> str:
        """Return the line for GRBL that leads to a distance from the start, mm."""
        part = min(distance / self.length, 1.0) if self.length else 1.0
        words = "".join(
            f"{letter.upper()}{place + (self.end[letter] - place) * part:.3f}"
            for letter, place in self.start.items()
        )
        return f"$J=G53G21{words}F{per_minute(self.feed):.1f}"


class GrblOperation:
    """Operation of a GRBL board at rest.

    Args:
        board: The board.
    """

    def __init__(self, board: GrblBoard) -> None:
        self._board = board

    @property
    def homes(self) -> bool:
        """Whether the board has a homing cycle that is switched on."""
        return self._board.info.homes

    @property
    def homed(self) -> bool:
        """Whether the machine is homed as far as the board shows it: no alarm, no restart."""
        board = self._board
        if not self.homes or board.link.status is None:
            return False
        return board.status.state != "Alarm" and not board.restarted

    def begin(self) -> None:
        """Serve requests of the operator within some hundredths of a second from here on."""
        self._board.stream.wait = SERVED_IN_RUN

    def listen(self, listener: Callable[[str, str], None]) -> None:
        """Call ``listener`` with ``->`` or ``<-`` and each line but the status reports."""

        def on_line(arrow: str, text: str) -> None:
            if text not in ("?", "") and not text.startswith("<"):
                listener(arrow, text)

        self._board.link.listen_to_lines(on_line)

    def refresh(self) -> None:
        """Ask for a report, and wait for it."""
        self._board.link.refresh()

    def poll(self) -> None:
        """Ask for the status; BoardError for an alarm or a restart."""
        self._receive(POLL_FAST, 2 * POLL_FAST)

    def limits_for_jogs(self, machine: Machine) -> Machine:
        """Return the machine with the rates and accelerations of the board, without jerk limits."""
        info, axes = self._board.info, dict(machine.axes)
        for letter, axis in axes.items():
            column = AXIS_LETTERS.index(letter)
            rate, acceleration = info.axis(RATES, column), info.axis(ACCELERATIONS, column)
            update: dict[str, float | None] = {"max_jerk": math.inf}
            if rate is not None:
                update["max_velocity"] = min(axis.max_velocity, per_second(rate))
            if acceleration is not None:
                update["max_acceleration"] = acceleration
            axes[letter] = axis.model_copy(update=update)
        path = machine.path.model_copy(
            update={"max_tangential_acceleration": None, "max_jerk": None}
        )
        return machine.model_copy(update={"axes": axes, "path": path})

    def jog(
        self,
        start: Mapping[str, float],
        end: Mapping[str, float],
        feed: float,
        released: Callable[[], bool],
        on_report: OnReport,
    ) -> None:
        """Move in a straight line; return at rest.

        The line is sent in pieces, a quarter of a second ahead. So the machine comes to rest, too,
        when this computer or the cable fails.

        Args:
            start: Machine position of the axes that move, mm.
            end: Its end.
            feed: Speed, mm/s.
            released: Whether the motion must end now.
            on_report: Called after each status report.

        Raises:
            BoardError: ``board-error`` where the board refuses the jog, ``board-alarm``.
        """
        link, move = self._board.link, JogLine(start, end, feed)
        self._refuse_if_locked()
        length, piece = move.length, max(move.feed * PIECE_S, SHORTEST_PIECE)
        began, sent = link.now(), 0.0
        try:
            while sent < length and not released():
                if sent / move.feed - (link.now() - began) < AHEAD_S:
                    sent = min(sent + piece, length)
                    link.ask(move.line(sent))
                else:
                    self._serve(on_report)
        except BoardError:
            with contextlib.suppress(BoardError):
                self._come_to_rest(lambda: True, on_report)
            raise
        self._come_to_rest(released, on_report)

    def _come_to_rest(self, released: Callable[[], bool], on_report: OnReport) -> None:
        """Wait for the end of a jog; cancel it when it is released."""
        board = self._board
        link = board.link
        rests, since, seen = 0, 0.0, link.last_old_report
        link.poll_now()
        while rests < RESTS:
            # A byte may be lost, so the cancel is repeated.
            if released() and link.now() - since > REPEATED:
                since = link.now()
                link.send_realtime(RealTime.JOG_CANCEL)
                link.poll_now()
            self._serve(on_report)
            if link.reports > seen:
                seen = link.reports
                rests = rests + 1 if board.status.state != "Jog" else 0

    def _serve(self, on_report: OnReport) -> None:
        """Receive for a moment; BoardError for an alarm or a restart."""
        link = self._board.link
        before = link.status_at
        self._receive(SERVED, POLL_FAST)
        if link.status_at > before:
            on_report()

    def _receive(self, timeout: float, poll: float) -> None:
        board = self._board
        for event in board.link.pump(timeout, poll):
            if isinstance(event, Alarmed):
                raise faults.alarmed(event.code, 0, board.info.kind)
            if isinstance(event, Started):
                board.restarted = True
                raise faults.restarted(0)

    def set_work_position(self, system: str, values: Mapping[str, float]) -> None:
        """Set the offset of a system so that the axes stand at work positions, and read it back.

        Args:
            system: G54 to G59, on some boards to G59.3, or G92.
            values: Work position of each axis, mm.

        Raises:
            UsageError: ``no-such-system``.
            BoardError: ``offset-not-kept`` where the board keeps another offset.
        """
        board = self._board
        info, link = board.info, board.link
        if system not in info.places:
            hint = f"it has {', '.join(name for name in info.places if name not in ('G28', 'G30'))}"
            message = f"the board has no coordinate system {system}"
            raise UsageError(Diagnostic("no-such-system", message, hint=hint))
        link.refresh()
        self._refuse_if_locked()
        words = "".join(f"{letter.upper()}{value:.4f}" for letter, value in values.items())
        number = "G92" if system == "G92" else f"G10L20P{_number(system)}"
        link.ask(f"G21G54{number}{words}")
        info.take(link.ask("$#"))
        link.refresh()
        for letter, value in values.items():
            column = AXIS_LETTERS.index(letter)
            kept = self.work_position("G54" if system == "G92" else system)[column]
            step = 1.0 / (info.axis(STEPS, column) or 1.0 / SAME_POSITION)
            if abs(kept - value) > SAME_POSITION + step:
                name = letter.upper()
                message = f"{system} was to make {name} {value:g} mm; the board has {kept:g}"
                hint = "read the offsets again, and compare the steps/mm of the board"
                raise board_error("offset-not-kept", message, hint=hint)

    def work_position(self, system: str) -> tuple[float, ...]:
        """Return the position of all axes of the board in a coordinate system, mm."""
        board = self._board
        places = board.info.places
        position = board.stream.position
        nothing = (0.0,) * len(position)
        length = [0.0] * len(position)
        if len(length) > 2:
            length[2] = board.info.tool_length
        parts = zip(
            position, places.get(system, nothing), places.get("G92", nothing), length, strict=False
        )
        return tuple(a - b - c - d for a, b, c, d in parts)

    def _refuse_if_locked(self) -> None:
        """Raise BoardError ``board-locked`` while the board is in alarm."""
        if self._board.status.locked:
            raise faults.locked(0)

    def unlock(self, *, at_switch: bool = True) -> None:
        """Leave an alarm without homing (``$X``); a reset comes first where the alarm needs one.

        Args:
            at_switch: Unlock although a limit switch is pressed, and the board locks itself again
                at its next reset.

        Raises:
            BoardError: ``board-locked`` at a pressed switch; ``board-error`` where the board
                refuses (an open safety door; a board that must be homed).
        """
        board = self._board
        link = board.link
        shift = board.info.places.get("G92", ())
        if link.protocol.state is not State.READY:
            link.connect()
            board.restore_shift(dict(zip(AXIS_LETTERS, shift, strict=False)))
        status = link.refresh()
        if status.locked:
            pressed = "".join(pin for pin in status.pins if pin.lower() in AXIS_LETTERS)
            if pressed and board.info.hard_limits and not at_switch:
                raise faults.at_switch(pressed)
            link.ask("$X")
        link.alarm = None
        link.refresh()
        board.stream.state = "idle"
        self.read_offsets()

    def revive(self) -> None:
        """Accept a next program; after a stop read the offsets, and set G92, as before the reset.

        Raises:
            BoardError: ``board-stopped`` after a fault of the link.
        """
        board = self._board
        link = board.link
        if link.protocol.state is not State.READY:
            message = "the board has been stopped by a fault"
            raise board_error("board-stopped", message, hint="connect it again")
        if board.state == "stopped":
            board.shift_cleared()
            self.read_offsets()
        board.stream.state = "idle"

    def read_offsets(self) -> None:
        """Read the offsets that the board keeps, if it is at rest."""
        board = self._board
        board.set_cleared_shift()
        if board.link.refresh().state == "Idle":
            board.info.take(board.link.ask("$#"))


def _number(system: str) -> int:
    return SYSTEMS.index(system) + 1 if system in SYSTEMS else 6 + int(system[-1])
