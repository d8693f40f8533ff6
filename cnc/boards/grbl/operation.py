"""Operation of a GRBL board at rest: jog, offsets, unlock, and the next program after a stop.

Sources: "Grbl v1.1 Jogging" (``$J=`` and the cancel byte 0x85), "Grbl v1.1 Commands" (``$X``),
LinuxCNC, G10 L20 and G92, which GRBL follows.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cnc.boards.grbl import faults
from cnc.boards.grbl.link import POLL_FAST
from cnc.boards.grbl.messages import SAME_POSITION, Alarmed, Started
from cnc.boards.grbl.protocol import RealTime, State
from cnc.boards.grbl.settings import ACCELERATIONS, RATES, STEPS, SYSTEMS
from cnc.boards.protocols import OnReport, board_error
from cnc.machine.models import Machine
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.diagnostics import BoardError, Diagnostic, UsageError
from cnc.model.units import per_minute, per_second

if TYPE_CHECKING:
    from cnc.boards.grbl.driver import GrblBoard

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
