"""Position check of a GRBL board: its reported position against the end of the last run.

A board that has restarted counts from zero at the present position of the tool. Another sender may
also have moved the machine. A program would then cut at a displaced position. It is refused
(``position-lost``) unless it homes the machine first, or the operator confirms the reported
position.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from cnc.boards.protocols import LineSink
from cnc.executor import homing
from cnc.machine.models import Machine
from cnc.model.blocks import ArcFeed, Block, BoardCommand, NurbsFeed, Polyline, Probe
from cnc.model.diagnostics import BoardError, Diagnostic
from cnc.model.operator_control import Control
from cnc.session.checkpoint import Checkpoint
from cnc.session.last_position import LastPosition

ROUNDING = 0.002
"""Rounding of a reported position, mm: three decimals, in inches in the worst case."""
HOMING_CYCLE = 22
"""Number of the GRBL setting that enables homing."""
UNREPORTED = frozenset({"port-lost", "board-silent", "board-restarted"})
"""Faults after which the last report of the board does not show the final position."""


class PositionCheck:
    """The check of one run, and the record for the next run.

    Args:
        board: The board.
        machine: Names the axes.
        checkpoint: Checkpoint of the run that is continued, or None.
        trusted: Whether the operator confirms the reported position.
    """

    def __init__(
        self, board: LineSink, machine: Machine, checkpoint: Checkpoint | None, *, trusted: bool
    ) -> None:
        self._board, self._axes, self._trusted = board, tuple(machine.axes), trusted
        self._identity = None if board.check_only else board.identity
        self._last = None if self._identity is None else self._expected(self._identity, checkpoint)
        self._disagrees = self._doubtful = False
        self._homing_line = 0
        self._begun = False

    def check(self, blocks: Iterable[Block]) -> None:
        """Compare the reported position with the expected one.

        Raises:
            BoardError: ``position-lost`` if they differ and the program with these ``blocks`` does
                not home the machine before its first move.
        """
        last = self._last
        if last is None or not self.doubtful:
            return
        self._disagrees = True
        self.lost_until(homing_line(blocks))
        if not self._homing_line:
            if last.file is None:
                # The next run may not see the restart, so the loss is recorded.
                replace(last, lost=True).write()
            raise BoardError(self._lost(last))

    @property
    def doubtful(self) -> bool:
        """Whether the machine may not be where the last run ended, and nobody confirms it."""
        last = self._last
        return (
            not self._trusted
            and last is not None
            and (last.lost or self._board.restarted or self._differs(last.position))
        )

    def lost_until(self, line: int) -> None:
        """Treat the position as lost until the line that homes the machine is done."""
        self._doubtful, self._homing_line = True, line

    def begin(self) -> None:
        """Record that the machine is about to move."""
        if self._identity is not None:
            self._begun = True
            kept = (
                self._last.position
                if self._doubtful and self._last is not None
                else self._position()
            )
            self._write(kept, lost=self._doubtful)

    def end(self, ended: str, seen: Mapping[str, float] | None) -> None:
        """Record the end of the run.

        Args:
            ended: "end", "stopped" or the code of a fault.
            seen: The last position that was reported before a fault.
        """
        if self._identity is None or not self._begun:
            return
        self._begun = False
        homed = (
            not self._doubtful or ended == "end" or self._board.confirmed_line > self._homing_line
        )
        if not homed and self._last is not None:
            # If the board refused $H, the machine has not moved.
            replace(
                self._last, lost=self._last.lost or self._disagrees or ended != "board-error"
            ).write()
        elif ended in UNREPORTED:
            self._write(seen or self._position(), ended, lost=True)
        else:
            self._write(self._position(), ended, lost=self._board.position_lost)

    def _write(self, position: Mapping[str, float], ended: str = "", *, lost: bool) -> None:
        """Record a position, and the shift that the board has."""
        if self._identity is not None:
            lost_shift = {} if self._last is None else self._last.lost_shift
            shift = shift_of(self._board, self._axes)
            LastPosition(self._identity, position, ended, lost, shift, lost_shift).write()

    def _expected(self, identity: str, checkpoint: Checkpoint | None) -> LastPosition | None:
        """Return the end of the last run; by the checkpoint if the run has no recorded end."""
        last = LastPosition.read(identity)
        if checkpoint is None or not checkpoint.position or (last is not None and last.ended):
            return last
        return LastPosition(
            identity, checkpoint.position, checkpoint.ended, lost=last is not None and last.lost
        )

    def _position(self) -> dict[str, float]:
        return dict(zip(self._axes, self._board.position, strict=False))

    def _differs(self, expected: Mapping[str, float]) -> bool:
        return differs(self._board, self._axes, expected)

    def _lost(self, last: LastPosition) -> Diagnostic:
        here, there = _words(self._position()), _words(last.position)
        if last.file is not None:
            message = (
                f"the board reports that the machine stands at {here}; the record of its last "
                f"position cannot be read: {last.file}"
            )
            return Diagnostic("position-lost", message, hint=self._hint())
        restarted = "has restarted and " if self._board.restarted else ""
        how = {"": "was under way at", "end": "ended at", "stopped": "was stopped at"}.get(
            last.ended, f"ended ({last.ended}) at"
        )
        message = (
            f"the board {restarted}reports that the machine stands at {here}; "
            f"the last run {how} {there}"
        )
        if last.lost and not self._differs(last.position):
            message += ", and the motors may have lost steps then"
        return Diagnostic("position-lost", message, hint=self._hint())

    def _hint(self) -> str:
        trust = "if the position that the board reports is right, confirm it with --trust-position"
        if self._board.settings.get(HOMING_CYCLE):
            return f"home the machine with cncrun home, or with --home before the program; {trust}"
        return f"this board does not home ($22=0): check where the tool stands; {trust}"


def differs(board: LineSink, axes: Sequence[str], expected: Mapping[str, float]) -> bool:
    """Return whether an axis is more than a step away from its expected position, mm."""
    return any(
        letter in expected and abs(here - expected[letter]) > max(step, ROUNDING)
        for letter, here, step in zip(axes, board.position, board.resolution, strict=False)
    )


def shift_of(board: LineSink, axes: Sequence[str]) -> dict[str, float]:
    """Return the G92 of a board by axis, mm; empty without one."""
    each = zip(axes, board.stored_offsets.get("G92", ()), strict=False)
    return {letter: value for letter, value in each if value}


def recall_shift(board: LineSink, machine: Machine) -> LastPosition | None:
    """Set the G92 of the last run or command again, which a new connection has cleared.

    It is lost where the board has restarted, or the machine was moved otherwise: G92 counts in
    machine coordinates.

    Returns:
        The record of the board; None without one.

    Raises:
        BoardError: ``offset-not-kept``.
    """
    last = None if board.identity is None else LastPosition.read(board.identity)
    if last is None or not last.shift:
        return last
    if board.restarted or differs(board, tuple(machine.axes), last.position):
        lost = last.lost or board.restarted
        last = replace(last, shift={}, lost_shift=last.shift, lost=lost)
        last.write()
    else:
        board.restore_shift(last.shift)
    return last


def refuse_lost_shift(board: LineSink, machine: Machine) -> None:
    """Do the same, and tell once that a G92 is lost.

    Raises:
        BoardError: ``offset-lost``, and as :func:`recall_shift`.
    """
    last = recall_shift(board, machine)
    if last is None or not last.lost_shift:
        return
    replace(last, lost_shift={}).write()
    names = " ".join(letter.upper() for letter in last.lost_shift)
    message = (
        f"the zero that G92 had set is lost (its offset was {_words(last.lost_shift)} mm): the "
        "board has restarted, or another program has moved the machine"
    )
    hint = f"set it again: cncrun zero {names} --system G92; the next run begins without it"
    raise BoardError(Diagnostic("offset-lost", message, hint=hint))


def record_shift(board: LineSink, machine: Machine) -> None:
    """Record the G92 that has been set on a board: each reset of the board clears it."""
    if board.identity is None:
        return
    axes = tuple(machine.axes)
    last = LastPosition.read(board.identity)
    here = dict(zip(machine.axis_names, board.position, strict=False))
    lost = last is not None and (
        last.lost or board.restarted or differs(board, axes, last.position)
    )
    ended = "end" if last is None else last.ended
    LastPosition(board.identity, here, ended, lost, shift_of(board, axes)).write()


def home_by_board(
    board: LineSink, machine: Machine, axes: Sequence[str], control: Control
) -> dict[str, float]:
    """Let a GRBL board home the machine, and record the position for the next run.

    Returns:
        Position of each axis, mm.

    Raises:
        BoardError, UsageError, HomingStopped: As :func:`cnc.executor.homing.home_by_board`.
    """
    recall_shift(board, machine)
    check = PositionCheck(board, machine, None, trusted=False)
    check.lost_until(homing.HOME_LINE)
    check.begin()
    ended = "broken off"
    try:
        homing.home_by_board(board, axes, control)
        board.restarted, ended = False, "end"
    except BoardError as error:
        ended = error.diagnostic.code
        # No program has this line.
        raise type(error)(replace(error.diagnostic, line=0)) from error
    finally:
        check.end(ended, None)
    return dict(zip(machine.axes, board.position, strict=False))


def homing_line(blocks: Iterable[Block]) -> int:
    """Return the line that homes all axes before the first move of a program, 0 for none."""
    for block in blocks:
        if isinstance(block, BoardCommand) and block.text.replace(" ", "").upper() == homing.HOME:
            return block.line
        if isinstance(block, Polyline | ArcFeed | NurbsFeed | Probe):
            return 0
    return 0


def _words(position: Mapping[str, float]) -> str:
    return " ".join(f"{letter.upper()}{value:.3f}" for letter, value in position.items())
