"""Where a GRBL board's machine stands: whether its report agrees with where the last run ended, and
what is kept for the next run.

A board that has restarted counts from zero wherever the tool is, and another sender may have moved
the machine. A program that began there would cut displaced, so it is refused (``position-lost``)
until it homes the machine first, or the operator confirms the board's report.
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
"""mm: what the three decimals of a report, of inches even, can make of a position."""
HOMING_CYCLE = 22
"""The setting that switches homing on."""
UNSEEN = frozenset({"port-lost", "board-silent", "board-restarted"})
"""Faults after which the board's last report is not where the machine stands."""


class Standing:
    """Of one run. machine: names the axes. checkpoint: of the run that is gone on with, None for
    none. trusted: the operator confirms.
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
        """Compare. BoardError ``position-lost`` for a program (its ``blocks``) that does not home
        the machine before it moves.
        """
        last = self._last
        if (
            self._trusted
            or last is None
            or not (last.lost or self._board.restarted or self._differs(last.position))
        ):
            return
        self._disagrees = True
        self.homes_at(homing_line(blocks))
        if not self._homing_line:
            # It stays lost if the board does not greet the next time.
            replace(last, lost=True).write()
            raise BoardError(self._lost(last))

    def homes_at(self, line: int) -> None:
        """The position counts as lost until a line that homes the machine has been carried out."""
        self._doubtful, self._homing_line = True, line

    def begin(self) -> None:
        """The machine is about to move: what was kept is not true any more."""
        if self._identity is not None:
            self._begun = True
            kept = (
                self._last.position
                if self._doubtful and self._last is not None
                else self._position()
            )
            LastPosition(self._identity, kept, lost=self._doubtful).write()

    def end(self, ended: str, seen: Mapping[str, float] | None) -> None:
        """The run is over. ended: "end", "stopped" or the code of a fault. seen: the last position
        reported before a fault.
        """
        if self._identity is None or not self._begun:
            return
        self._begun = False
        homed = (
            not self._doubtful or ended == "end" or self._board.confirmed_line > self._homing_line
        )
        if not homed and self._last is not None:
            # A board that refuses $H has not moved.
            replace(
                self._last, lost=self._last.lost or self._disagrees or ended != "board-error"
            ).write()
        elif ended in UNSEEN:
            LastPosition(self._identity, seen or self._position(), ended, lost=True).write()
        else:
            LastPosition(self._identity, self._position(), ended).write()

    def _expected(self, identity: str, checkpoint: Checkpoint | None) -> LastPosition | None:
        """Where the machine should stand: where the last run on the board ended; of one that has no
        end, by its checkpoint.
        """
        last = LastPosition.read(identity)
        if checkpoint is None or not checkpoint.position or (last is not None and last.ended):
            return last
        return LastPosition(
            identity, checkpoint.position, checkpoint.ended, lost=last is not None and last.lost
        )

    def _position(self) -> dict[str, float]:
        return dict(zip(self._axes, self._board.position, strict=False))

    def _differs(self, expected: Mapping[str, float]) -> bool:
        """Whether an axis stands more than a step from where it should."""
        each = zip(self._axes, self._board.position, self._board.resolution, strict=False)
        return any(
            letter in expected and abs(here - expected[letter]) > max(step, ROUNDING)
            for letter, here, step in each
        )

    def _lost(self, last: LastPosition) -> Diagnostic:
        here, there = _words(self._position()), _words(last.position)
        restarted = "has restarted and " if self._board.restarted else ""
        how = {"": "was under way at", "end": "ended at", "stopped": "was stopped at"}.get(
            last.ended, f"ended ({last.ended}) at"
        )
        message = f"the board {restarted}reports that the machine stands at {here}; the last run {how} {there}"
        trust = "if the position that the board reports is right, confirm it with --trust-position"
        if self._board.settings.get(HOMING_CYCLE):
            return Diagnostic(
                "position-lost", message, hint=f"home the machine with cncrun home; {trust}"
            )
        return Diagnostic(
            "position-lost",
            message,
            hint=f"this board does not home ($22=0): look where the tool stands; {trust}",
        )


def home_by_board(
    board: LineSink, machine: Machine, axes: Sequence[str], control: Control
) -> dict[str, float]:
    """Let a GRBL board home the machine, and keep where each axis then stands, mm. Raises as
    :func:`cnc.executor.homing.home_by_board`.
    """
    standing = Standing(board, machine, None, trusted=False)
    standing.homes_at(homing.HOME_LINE)
    standing.begin()
    ended = "broken off"
    try:
        homing.home_by_board(board, axes, control)
        ended = "end"
    except BoardError as error:
        ended = error.diagnostic.code
        raise
    finally:
        standing.end(ended, None)
    return dict(zip(machine.axes, board.position, strict=False))


def homing_line(blocks: Iterable[Block]) -> int:
    """The line at which a program homes all axes before it moves any, 0 if it does not."""
    for block in blocks:
        if isinstance(block, BoardCommand) and block.text.replace(" ", "").upper() == homing.HOME:
            return block.line
        if isinstance(block, Polyline | ArcFeed | NurbsFeed | Probe):
            return 0
    return 0


def _words(position: Mapping[str, float]) -> str:
    return " ".join(f"{letter.upper()}{value:.3f}" for letter, value in position.items())
