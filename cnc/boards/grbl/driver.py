"""A GRBL board (1.1 or grblHAL) as a line sink: streams, watches, and never waits for something
that can't come.

Whatever goes wrong, the motion is stopped (hold, wait for rest, reset) before it is reported, and
nothing is sent any more.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.boards.grbl import faults
from cnc.boards.grbl.fault_monitor import NORMAL, FaultMonitor
from cnc.boards.grbl.lines import MOST_CHARACTERS, bare, kind_of
from cnc.boards.grbl.link import ANSWER, GrblLink
from cnc.boards.grbl.messages import Feedback
from cnc.boards.grbl.operator_requests import MIN_OVERRIDE, OperatorRequests
from cnc.boards.grbl.protocol import Event, RealTime, Reported, Started
from cnc.boards.grbl.settings import STEPS, BoardInfo
from cnc.boards.grbl.status import Status
from cnc.boards.port import Clock, Port, PortLost, SystemClock
from cnc.boards.protocols import BoardTraits, Capabilities, OnReport, board_error
from cnc.boards.serial_port import identity, open_port
from cnc.machine.models import Machine
from cnc.model.blocks import AXIS_LETTERS, Block
from cnc.model.diagnostics import BoardError, Diagnostic, UsageError
from cnc.model.operator_control import Control
from cnc.model.streams import GcodeLine

WAIT = 0.05
"""Longest wait for the board in s before the operator's requests are looked at."""
MARK_LINES = 20
MARK_TIME = 0.5
"""Lines, and seconds, from one mark to the next: whichever comes first."""
OVERRIDE_PATIENCE = 15.0
"""Seconds for the first override: a step of ten takes a report."""
SAME = 0.002
"""mm: what GRBL's three decimals, of inches even, can make of a position or an offset."""


class GrblBoard:
    """Drives the board at ``port``; :meth:`connect` before anything else. ``name`` is the port's.
    ``machine``: names the axes.

    identity: what tells this board from others from one run to the next, None for one that nothing
    is to be remembered of.

    Faults, each a BoardError at its source line: ``board-error``, ``board-alarm``,
    ``board-silent``, ``board-restarted``, ``reply-lost``, ``reply-missing``, ``board-stuck``,
    ``board-locked``, ``line-too-long``, ``port-lost``, ``board-not-started``, ``board-stopped``.
    """

    traits = BoardTraits(takes_lines=True)

    def __init__(
        self,
        port: Port,
        machine: Machine,
        clock: Clock | None = None,
        name: str = "the port",
        identity: str | None = None,
    ) -> None:
        self.identity = identity
        self.link = GrblLink(port, clock or SystemClock(), name)
        self.check_only = False
        self.state = "idle"
        self._machine = machine
        self._columns = [AXIS_LETTERS.index(letter) for letter in machine.axes]
        self._requests: OperatorRequests | None = None
        self._watcher: OnReport | None = None
        self._monitor = FaultMonitor(self.link.protocol)
        self._marked_at = 0.0
        self._first = True
        self._probed: tuple[float, ...] | None = None
        self.restarted = False

    @classmethod
    def from_machine(cls, machine: Machine, target: Path | None = None) -> GrblBoard:
        """The board at the port of the machine file, connected. UsageError `no-port`; BoardError
        where it does not answer as it should.
        """
        name = machine.board.port
        if name is None:
            hint = "name it with --port /dev/ttyUSB0, or as board.port in the machine file; cncrun boards lists them"
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
        """Get to know the board. Nothing moves."""
        self.link.connect()
        # A board that counts from anywhere else than zero has not restarted: grblHAL greets whoever
        # connects over the network.
        self.restarted = self.link.greeted_unasked and not any(self._position())
        axes = len(self._position())
        missing = [
            letter.upper()
            for letter, column in zip(self._machine.axes, self._columns, strict=True)
            if column >= axes
        ]
        if missing:
            message = f"the machine file has an axis {missing[0]}, the board has {axes} axes"
            raise board_error("board-axes", message, hint="take it out of the machine file")
        if self.info.tool_length and self.status.state == "Idle":
            self.link.ask("G49")
            self.info.tool_length = 0.0

    @property
    def info(self) -> BoardInfo:
        """Firmware, settings, offsets."""
        return self.link.info

    @property
    def status(self) -> Status:
        """As it was reported last."""
        assert self.link.status is not None
        return self.link.status

    @property
    def capabilities(self) -> Capabilities:
        """Lines; the probe answers."""
        rate = self._machine.board.max_step_rate
        return Capabilities(
            axes=len(self._machine.axes),
            max_step_rate=rate,
            tick_ns=1e9 / rate,
            pulses=False,
            lines=True,
            senses=True,
        )

    @property
    def confirmed_line(self) -> int:
        """Source line of the last line that the board has taken: it lies at most a planner's length
        ahead of the motion.
        """
        return self.link.protocol.confirmed_line

    @property
    def moving_line(self) -> int:
        """Source line of the move that the board was on when it reported last, 0 where that is not
        known.
        """
        return self._monitor.way.line

    @property
    def position(self) -> tuple[float, ...]:
        """Machine position in mm, one number an axis of the machine, as it was reported last."""
        return self._own(self._position())

    @property
    def work_offset(self) -> tuple[float, ...]:
        """What the board adds to the coordinates of a line in G54, mm, one number an axis of the
        machine.
        """
        return self._own(self._in_g54())

    @property
    def stored_offsets(self) -> dict[str, tuple[float, ...]]:
        """G54 to G59, G28, G30 and G92 of the board, mm, one number an axis of the machine."""
        return {
            name: self._own(place)
            for name, place in self.info.places.items()
            if len(place) >= len(self._columns)
        }

    @property
    def settings(self) -> dict[int, float]:
        """Rates, accelerations, tolerances and more, by their numbers."""
        return {
            number: value
            for number in self.info.settings
            if (value := self.info.number(number)) is not None
        }

    @property
    def mist(self) -> bool:
        """Whether the board was built with M7."""
        return "M" in self.info.options

    def limited_to_board(self, machine: Machine) -> Machine:
        """The machine with no more travel than the board's soft limits leave it."""
        return self.info.narrowed(machine)

    @property
    def resolution(self) -> tuple[float, ...]:
        """A step of each axis of the machine, by the board's settings, mm."""
        steps = (self.info.axis(STEPS, column) for column in self._columns)
        return tuple(1.0 / each if each else 0.0 for each in steps)

    @property
    def buffered(self) -> int:
        """Lines that were sent and not carried out yet, as far as that is known."""
        return max(self.link.protocol.waiting, self._monitor.way.lines)

    @property
    def rapid_override(self) -> int:
        """Of traverses, per cent, as it was reported last."""
        return (self.status.overrides or (NORMAL, NORMAL, NORMAL))[1]

    def now(self) -> float:
        """The time by the link's clock, s."""
        return self.link.now()

    def connect_operator(self, control: Control, watcher: OnReport) -> None:
        """Carry out the operator's requests at once, and tell ``watcher`` whenever the board has
        reported.
        """
        self._requests, self._watcher = OperatorRequests(control), watcher

    def start(self, origin_steps: NDArray[np.int64]) -> None:
        """Get ready. BoardError ``board-busy`` unless the machine stands still."""
        self._refuse_if_stopped()
        link = self.link
        before, status = self._position(), link.refresh()
        if status.state not in ("Idle", "Alarm"):
            hint = {"Door": "close the safety door", "Sleep": "reset the board"}.get(
                status.state, "wait until it has come to rest"
            )
            raise board_error(
                "board-busy", f"the board is not ready: it says {status.state}", hint=hint
            )
        if any(abs(a - b) > SAME for a, b in zip(before, self._position(), strict=True)):
            raise board_error(
                "board-moved",
                "the machine was moved while the program was read",
                hint="start again",
            )
        self.state = "running"
        self._first = True
        if self.check_only:
            link.ask("$C")
            link.refresh()
        self._monitor.begin(
            self.info, self._position(), self._in_g54(), link.now(), moves=not self.check_only
        )
        self._override_first()

    def send_line(self, line: GcodeLine) -> None:
        """Send as soon as there is room. Returns unsent if the operator stops the run."""
        self._refuse_unless_running()
        protocol, monitor = self.link.protocol, self._monitor
        text = line.text
        if len(text) > MOST_CHARACTERS:
            message = f"a line of {len(text)} characters, the board takes {MOST_CHARACTERS}"
            raise self._fault(board_error("line-too-long", message, line=line.line))
        kind = kind_of(text)
        if kind in ("writer", "system"):
            self._rest()
        if self.status.state == "Alarm" and bare(text)[:2] not in ("$H", "$X"):
            raise self._fault(faults.locked(line.line))
        while (
            protocol.waiting >= monitor.vital.max_waiting
            or not protocol.room(text, kind)
            or monitor.far_ahead(self.status)
        ):
            if self._stopping():
                return
            self._serve(WAIT)
        if self._stopping():
            return
        if kind == "probe":
            self._probed = None
        monitor.sending(line, self.link.now())
        self._write(protocol.send(text, line.line, kind))
        if protocol.mark_fits() and (
            protocol.unmarked >= MARK_LINES or self.link.now() - self._marked_at > MARK_TIME
        ):
            self._mark()
        if kind == "system":
            # It may change what the board is: locked or not, and where.
            self._settle()
            if self.status.state == "Alarm" and not self._stopping():
                raise self._fault(faults.locked(line.line))
        elif self._first:
            self._first = False
            self._compare_offset(line.line)
        elif self.link.due():
            self._serve(0.0)

    def execute(self, block: Block, time_ns: int) -> tuple[float, ...] | None:
        """Wait until the lines sent so far have been carried out. After a probe: 1 or 0 for contact
        or none, and where, machine mm.
        """
        self._refuse_unless_running()
        self._settle()
        answer, self._probed = self._probed, None
        if answer is None:
            return None
        return (answer[-1], *self._own(answer))

    def finish(self) -> None:
        """Return when everything has been answered and the machine stands still."""
        self._refuse_unless_running()
        self._settle()
        if self._stopping():
            return
        if self.check_only:
            self.link.write(self.link.protocol.reset())
            self.link.until(lambda event: isinstance(event, Started), ANSWER)
        self.state = "idle"

    def stop(self) -> None:
        """Hold, wait for rest, reset: what was sent and not carried out is forgotten, the position
        survives.
        """
        wrong = self.link.halt() if self.state == "running" else None
        self.state = "stopped"
        if wrong is not None:
            raise self._at_confirmed(wrong)

    def abort(self) -> None:
        """The same: nothing is quicker that leaves the position known."""
        self.stop()

    def close(self) -> None:
        """Let go of the port. What runs is stopped first."""
        with contextlib.suppress(BoardError):
            self.stop()
        self.link.close()

    def real_time(self, command: RealTime) -> None:
        """Send a real-time command at once, however full the receive buffer is."""
        self._write(command.value)

    def _position(self) -> tuple[float, ...]:
        status = self.link.status
        return () if status is None or status.position is None else status.position

    def _own(self, values: tuple[float, ...]) -> tuple[float, ...]:
        """The machine's axes of the board's."""
        return tuple(values[column] for column in self._columns) if values else ()

    def _in_g54(self) -> tuple[float, ...]:
        places = self.info.places
        nothing = (0.0,) * len(self._position())
        sums = [
            a + b
            for a, b in zip(places.get("G54", nothing), places.get("G92", nothing), strict=False)
        ]
        if len(sums) > 2:
            sums[2] += self.info.tool_length
        return tuple(sums)

    def _stopping(self) -> bool:
        return self._requests is not None and self._requests.control.stopped

    def _drain(self) -> None:
        """Until every line has been answered, or the operator stops the run."""
        protocol = self.link.protocol
        while protocol.waiting and not self._stopping():
            self._serve(WAIT)

    def _rest(self) -> None:
        """Until the machine stands still with nothing under way, or the operator stops the run."""
        self._drain()
        link = self.link
        began = link.now()
        still = 0
        while not self._stopping():
            before = link.status_at
            self._serve(WAIT, fast=True)
            # A report may be older than the last answer, and between an answer and the motion GRBL
            # is Idle for a moment: the second counts.
            if link.status_at > before and link.status_at > began:
                still = still + 1 if self.status.state in ("Idle", "Alarm", "Check", "Sleep") else 0
                if still == 2:
                    return

    def _settle(self) -> None:
        """Until the machine stands still where the lines have led it."""
        self._rest()
        if self._stopping():
            return
        if self._monitor.way.arrived(self._position()):
            # One report may be wrong.
            self.link.refresh()
            off = self._monitor.way.arrived(self._position())
            if off:
                raise self._fault(faults.elsewhere(self._position(), off, self.confirmed_line))
        self._monitor.way.begin(self._position())

    def _serve(self, timeout: float, *, fast: bool = False) -> None:
        """Wait for the board a moment, take in what it says, and carry out the operator's requests.
        Every fault comes out of here.
        """
        link = self.link
        try:
            events = link.pump(timeout, 0.05) if fast else link.pump(timeout)
        except PortLost as error:
            self.state = "stopped"
            raise self._at_confirmed(error) from error
        except BoardError as error:
            link.drop()
            self.state = "stopped"
            raise self._at_confirmed(error) from error
        for event in events:
            self._take(event)
        self._look()
        self._obey()

    def _take(self, event: Event) -> None:
        if isinstance(event, Feedback) and event.kind == "PRB":
            self._probed = self._contact(event.text)
        wrong = self._monitor.told(event, self.link.now())
        if wrong is not None:
            raise self._fault(wrong)
        if isinstance(event, Reported):
            if self._monitor.doubtful:
                self.link.poll_now()
            if self._watcher is not None:
                self._watcher()

    def _look(self) -> None:
        """A board that answers nothing, by what it says of itself."""
        protocol, now = self.link.protocol, self.link.now()
        if protocol.waiting and self._monitor.vital.doubtful(now) and protocol.mark_fits():
            self._mark()
        wrong = self._monitor.verdict(now)
        if wrong is not None:
            raise self._fault(wrong)

    def _obey(self) -> None:
        """The operator's requests become real-time commands."""
        requests, link = self._requests, self.link
        if requests is not None and not requests.control.stopped and self.state == "running":
            data = requests.commands(self.status, link.status_at, link.now())
            if data:
                self._write(data)

    def _override_first(self) -> None:
        """Before anything moves: the override that the operator begins with; a board begins with
        100.
        """
        requests, link = self._requests, self.link
        if requests is None or requests.override == NORMAL:
            return
        deadline = link.now() + OVERRIDE_PATIENCE
        while (
            requests.control.feed_override >= MIN_OVERRIDE
            and link.now() < deadline
            and not self._stopping()
        ):
            self._serve(WAIT, fast=True)
            overrides = self.status.overrides
            if overrides is not None and overrides[0] == requests.override:
                return
        if not self._stopping():
            message = (
                f"the board does not take a feed override of {requests.control.feed_override:g} %"
            )
            hint = f"GRBL's go from {MIN_OVERRIDE} to 200 %; scale the feeds of the program instead"
            raise self._fault(board_error("override-refused", message, hint=hint))

    def _mark(self) -> None:
        self._marked_at = self.link.now()
        self._monitor.vital.marked(self._marked_at)
        self._write(self.link.protocol.mark())

    def _write(self, data: bytes) -> None:
        try:
            self.link.write(data)
        except PortLost as error:
            self.state = "stopped"
            raise self._at_confirmed(error) from error

    def _compare_offset(self, line: int) -> None:
        """The first line has chosen a coordinate system: is its offset the one that the lines were
        made for?
        """
        if self.status.state == "Alarm":
            self._first = True
            return
        self._rest()
        offset = self.status.offset
        if self._stopping() or offset is None:
            return
        if any(abs(a - b) > SAME for a, b in zip(offset, self._in_g54(), strict=False)):
            shown = ", ".join(f"{value:g}" for value in offset)
            hint = "is it set by a start-up line ($N)? Use G54 to G59 for offsets"
            raise self._fault(
                board_error(
                    "offset-differs",
                    f"the board adds another offset than that of its G54: {shown}",
                    line=line,
                    hint=hint,
                )
            )

    def _contact(self, text: str) -> tuple[float, ...] | None:
        """``1.000,2.000,-3.000:1``: where the probe was, mm, and whether it touched."""
        where, _, touched = text.partition(":")
        try:
            unit = self.info.unit
            return (*(float(value) * unit for value in where.split(",")), float(touched))
        except ValueError:
            return None

    def _fault(self, error: BoardError) -> BoardError:
        """Stop everything, then report."""
        if self.state != "running":
            return error
        second = self.link.halt()
        self.state = "stopped"
        return error if second is None else faults.followed_by(error, second)

    def _at_confirmed(self, error: BoardError) -> BoardError:
        line = self.confirmed_line
        found = error.diagnostic
        last = (
            f"; line {line} was the last that the board confirmed"
            if line
            else "; the board had confirmed no line yet"
        )
        return type(error)(Diagnostic(found.code, found.message + last, line=line, hint=found.hint))

    def _refuse_if_stopped(self) -> None:
        if self.state == "stopped":
            raise board_error("board-stopped", "the board has been stopped", hint="open it anew")

    def _refuse_unless_running(self) -> None:
        self._refuse_if_stopped()
        if self.state != "running":
            raise board_error("board-not-started", "no program has been started on the board")
