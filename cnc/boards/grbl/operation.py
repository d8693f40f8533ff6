"""Operation of a GRBL board at rest: jog, offsets, unlock, and the next program after a stop.

Sources: "Grbl v1.1 Jogging" (``$J=`` and the cancel byte 0x85), "Grbl v1.1 Commands" (``$X``),
LinuxCNC, G10 L20 and G92, which GRBL follows.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from cnc.boards.errors import board_error
from cnc.boards.grbl import faults
from cnc.boards.grbl.driver import SAME_POSITION, GrblBoard
from cnc.boards.grbl.events import Alarmed, Started
from cnc.boards.grbl.link import POLL_FAST
from cnc.boards.grbl.protocol import RealTime, State
from cnc.boards.grbl.settings import STEPS, SYSTEMS
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.diagnostics import BoardError, Diagnostic, UsageError

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
MM_PER_MIN = 60.0


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
        return f"$J=G53G21{words}F{self.feed * MM_PER_MIN:.1f}"


def jog(
    board: GrblBoard,
    move: JogLine,
    released: Callable[[], bool],
    on_report: Callable[[], None],
) -> None:
    """Move in a straight line; return at rest.

    The line is sent in pieces, a quarter of a second ahead. So the machine comes to rest, too, when
    this computer or the cable fails.

    Args:
        board: The board, at rest.
        move: The jog.
        released: Whether the motion must end now.
        on_report: Called after each status report.

    Raises:
        BoardError: ``board-error`` where the board refuses the jog, ``board-alarm``.
    """
    link = board.link
    refuse_if_locked(board)
    length, piece = move.length, max(move.feed * PIECE_S, SHORTEST_PIECE)
    began, sent = link.now(), 0.0
    try:
        while sent < length and not released():
            if sent / move.feed - (link.now() - began) < AHEAD_S:
                sent = min(sent + piece, length)
                link.ask(move.line(sent))
            else:
                _serve(board, on_report)
    except BoardError:
        with contextlib.suppress(BoardError):
            _come_to_rest(board, lambda: True, on_report)
        raise
    _come_to_rest(board, released, on_report)


def _come_to_rest(
    board: GrblBoard, released: Callable[[], bool], on_report: Callable[[], None]
) -> None:
    """Wait for the end of a jog; cancel it when it is released."""
    link = board.link
    rests, since, seen = 0, 0.0, link.last_old_report
    link.poll_now()
    while rests < RESTS:
        # A byte may be lost, so the cancel is repeated.
        if released() and link.now() - since > REPEATED:
            since = link.now()
            link.send_realtime(RealTime.JOG_CANCEL)
            link.poll_now()
        _serve(board, on_report)
        if link.reports > seen:
            seen = link.reports
            rests = rests + 1 if board.status.state != "Jog" else 0


def _serve(board: GrblBoard, on_report: Callable[[], None]) -> None:
    """Receive for a moment; BoardError for an alarm or a restart."""
    link = board.link
    before = link.status_at
    for event in link.pump(SERVED, POLL_FAST):
        if isinstance(event, Alarmed):
            raise faults.alarmed(event.code, 0, board.info.kind)
        if isinstance(event, Started):
            raise faults.restarted(0)
    if link.status_at > before:
        on_report()


def set_work_position(board: GrblBoard, system: str, values: Mapping[str, float]) -> None:
    """Set the offset of a system so that the axes stand at work positions, and read it back.

    Args:
        board: The board, at rest.
        system: G54 to G59, on some boards to G59.3, or G92.
        values: Work position of each axis, mm.

    Raises:
        UsageError: ``no-such-system``.
        BoardError: ``offset-not-kept`` where the board keeps another offset.
    """
    info, link = board.info, board.link
    if system not in info.places:
        hint = f"it has {', '.join(name for name in info.places if name not in ('G28', 'G30'))}"
        message = f"the board has no coordinate system {system}"
        raise UsageError(Diagnostic("no-such-system", message, hint=hint))
    link.refresh()
    refuse_if_locked(board)
    words = "".join(f"{letter.upper()}{value:.4f}" for letter, value in values.items())
    number = "G92" if system == "G92" else f"G10L20P{_number(system)}"
    link.ask(f"G21G54{number}{words}")
    info.take(link.ask("$#"))
    link.refresh()
    for letter, value in values.items():
        column = AXIS_LETTERS.index(letter)
        kept = work_position(board, "G54" if system == "G92" else system)[column]
        step = 1.0 / (info.axis(STEPS, column) or 1.0 / SAME_POSITION)
        if abs(kept - value) > SAME_POSITION + step:
            message = f"{system} was to make {letter.upper()} {value:g} mm; the board has {kept:g}"
            hint = "read the offsets again, and compare the steps/mm of the board"
            raise board_error("offset-not-kept", message, hint=hint)


def work_position(board: GrblBoard, system: str) -> tuple[float, ...]:
    """Return the position of all axes of the board in a coordinate system, mm."""
    places = board.info.places
    position = board.stream.position
    nothing = (0.0,) * len(position)
    length = [0.0] * len(position)
    if len(length) > 2:
        length[2] = board.info.tool_length
    each = zip(
        position, places.get(system, nothing), places.get("G92", nothing), length, strict=False
    )
    return tuple(a - b - c - d for a, b, c, d in each)


def refuse_if_locked(board: GrblBoard) -> None:
    """Raise BoardError ``board-locked`` while the board is in alarm."""
    if board.status.locked:
        raise faults.locked(0)


def unlock(board: GrblBoard, *, at_switch: bool = True) -> None:
    """Leave an alarm without homing (``$X``); a reset comes first where the alarm needs one.

    Args:
        board: The board.
        at_switch: Unlock although a limit switch is pressed, and the board locks itself again at
            its next reset.

    Raises:
        BoardError: ``board-locked`` at a pressed switch; ``board-error`` where the board refuses
            (an open safety door; a board that must be homed).
    """
    link = board.link
    shift = board.info.places.get("G92", ())
    if link.protocol.state is not State.READY:
        link.connect()
        board.restore_shift(dict(zip(AXIS_LETTERS, shift, strict=False)))
    status = link.refresh()
    if status.locked:
        pressed = "".join(each for each in status.pins if each.lower() in AXIS_LETTERS)
        if pressed and board.info.hard_limits and not at_switch:
            raise faults.at_switch(pressed)
        link.ask("$X")
    link.alarm = None
    link.refresh()
    board.stream.state = "idle"
    read_offsets(board)


def revive(board: GrblBoard) -> None:
    """Accept a next program; after a stop read the offsets, and set G92, which the reset clears.

    Raises:
        BoardError: ``board-stopped`` after a fault of the link.
    """
    link = board.link
    if link.protocol.state is not State.READY:
        message = "the board has been stopped by a fault"
        raise board_error("board-stopped", message, hint="connect it again")
    if board.state == "stopped":
        board.shift_cleared()
        read_offsets(board)
    board.stream.state = "idle"


def read_offsets(board: GrblBoard) -> None:
    """Read the offsets that the board keeps, if it is at rest."""
    board.set_cleared_shift()
    if board.link.refresh().state == "Idle":
        board.info.take(board.link.ask("$#"))


def _number(system: str) -> int:
    return SYSTEMS.index(system) + 1 if system in SYSTEMS else 6 + int(system[-1])
