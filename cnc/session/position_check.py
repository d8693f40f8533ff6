"""Position check of a GRBL board: its reported position against the end of the last run.

A board that has restarted counts from zero at the present position of the tool. Another sender may
also have moved the machine. A program would then cut at a displaced position. It is refused
(``position-lost``) unless it homes the machine first, or the operator confirms the reported
position.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, field, replace
from pathlib import Path
from typing import cast
from urllib.parse import quote

from pydantic import ConfigDict, FiniteFloat, RootModel, TypeAdapter
from pydantic.dataclasses import dataclass

from cnc.boards.protocols import LineSink
from cnc.grbl_lines.number_format import BOARD_LETTERS
from cnc.machine.models import Machine
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import (
    AXIS_LETTERS,
    ArcFeed,
    AxisLetter,
    Block,
    BoardCommand,
    NurbsFeed,
    Polyline,
    Probe,
)
from cnc.model.diagnostics import BoardError, Diagnostic
from cnc.model.state_file import folder, read_state
from cnc.model.streams import GcodeLine
from cnc.session.checkpoint import Checkpoint, replace_json

log = logging.getLogger(__name__)

# Machine position at the end of the last run on a board, kept on disk between the runs.
#
# A GRBL board counts its steps from its position at power-up, and its reports do not show a
# restart. Therefore the reported position is compared with the position at the end of the last run.
#
#     STATE/positions/BOARD.json: `board`, `position` {axis: mm}, `ended`, `lost`, `shift`,
#                                 `lost_shift`
#
# STATE is ``XDG_STATE_HOME/cnc`` (``~/.local/state/cnc``), on Windows ``LOCALAPPDATA/cnc``. `ended`
# is "" during a run, and after a crash of the computer. Then it is "end", "stopped", or the code of
# a fault. `lost`: whether the position is unreliable. `shift` {axis: mm} is the G92 of the board,
# which each reset clears. It is `lost_shift` after a restart, until the operator is told.
#
# A record that is there and cannot be read is not an absent one: the position is lost.


@dataclass(frozen=True, slots=True)
class LastPosition:
    """Content of the file. ``position`` is in machine coordinates, mm (degrees), by axis."""

    board: str
    position: Mapping[str, FiniteFloat]
    ended: str = ""
    lost: bool = False
    shift: Mapping[str, FiniteFloat] = field(default_factory=dict)
    lost_shift: Mapping[str, FiniteFloat] = field(default_factory=dict)

    @classmethod
    def read(cls, board: str) -> LastPosition | None:
        """Return the last position of a board by its identity; None if there is none.

        A record that cannot be read is returned as a lost position without axes.
        """
        unreadable = cls(board, {}, lost=True)
        try:
            record = _RECORD.validate_json(_position_file(board).read_bytes())
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError):
            return unreadable
        return record if record.position and record.board == board else unreadable

    @property
    def file(self) -> Path | None:
        """The record that cannot be read; None where the position is known."""
        return None if self.position else _position_file(self.board)

    def write(self) -> None:
        """Replace the file of this board. A failure does not stop the machine."""
        file = _position_file(self.board)
        with contextlib.suppress(OSError):
            file.parent.mkdir(parents=True, exist_ok=True)
        replace_json(file, asdict(self), lasting=True)


_RECORD = TypeAdapter(LastPosition)


def _position_file(board: str) -> Path:
    return folder() / f"{quote(board, safe='')}.json"


HOME, HOME_LINE = "$H", 1
"""GRBL's own homing cycle, and its line number."""
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
    offsets = zip(axes, board.stored_offsets.get("G92", ()), strict=False)
    return {letter: value for letter, value in offsets if value}


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


def homing_line(blocks: Iterable[Block]) -> int:
    """Return the line that homes all axes before the first move of a program, 0 for none."""
    for block in blocks:
        if isinstance(block, BoardCommand) and block.text.replace(" ", "").upper() == HOME:
            return block.line
        if isinstance(block, Polyline | ArcFeed | NurbsFeed | Probe):
            return 0
    return 0


def _words(position: Mapping[str, float]) -> str:
    return " ".join(f"{letter.upper()}{value:.3f}" for letter, value in position.items())


# Offsets (G54 to G59, G28, G30) of a GRBL board, kept on disk for checks without the board.
#
# They are those of the end of the last run, or of ``cncrun boards``. G92 is not among them, because
# a reset of the board clears it.
#
#     STATE/positions/BOARD.offsets.json: {name: {axis: mm}}, see :mod:`cnc.session.position_check`

KEPT = ("G54", "G55", "G56", "G57", "G58", "G59", "G28", "G30")
Offsets = dict[str, dict[str, float]]
"""Offset of each axis, mm, by name."""


class _Content(RootModel[dict[str, dict[AxisLetter, FiniteFloat]]]):
    """Content of the file."""

    model_config = ConfigDict(defer_build=True, strict=True)


def read_offsets(board: str) -> tuple[Offsets | None, list[Diagnostic]]:
    """Return the offsets of a board by its identity, None if none can be read, and warnings."""
    hint = "cncrun boards reads the offsets of the board, and keeps them for later checks"
    content, warnings = read_state(_offsets_file(board), _Content, hint)
    if content is None:
        return None, warnings
    kept = {name: place for name, place in content.root.items() if name in KEPT}
    return {
        name: {str(axis): value for axis, value in place.items()} for name, place in kept.items()
    }, []


def write_offsets(board: str, offsets: Mapping[str, Mapping[str, float]]) -> None:
    """Replace the file of a board. A failure does not stop the machine."""
    file = _offsets_file(board)
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
    content = {name: dict(place) for name, place in offsets.items() if name in KEPT}
    replace_json(file, content, lasting=False)


def _offsets_file(board: str) -> Path:
    return folder() / f"{quote(board, safe='')}.offsets.json"


# Offsets of a board that plans for itself: the program is read with them, and writes them back.

SYSTEMS = numbers.SYSTEMS[:6]
FIRST_PARAMETERS = {
    "G28": numbers.G28_POSITION,
    "G30": numbers.G30_POSITION,
    "G92": numbers.SHIFT,
    **{name: numbers.origin(system) for system, name in enumerate(SYSTEMS)},
}
"""Number of the parameter with the X of each offset."""
CHANGED = 0.0005
"""Smallest change of an offset that is written to the board, mm: its reports have 3 decimals."""


def board_parameters(board: LineSink, machine: Machine) -> dict[int, float]:
    """Return the parameters of the offsets that the board keeps.

    With them a program has the same meaning as if the board read it.
    """
    return offset_parameters(named_offsets(board, machine))


def named_offsets(board: LineSink, machine: Machine) -> Offsets:
    """Return the offsets that the board keeps."""
    return {
        name: dict(zip(machine.axes, place, strict=True))
        for name, place in board.stored_offsets.items()
    }


def offset_parameters(offsets: Mapping[str, Mapping[str, float]]) -> dict[int, float]:
    """Return the parameters of offsets."""
    values = {numbers.CURRENT_SYSTEM: 1.0, numbers.SHIFT_IN_EFFECT: 1.0}
    for name, place in offsets.items():
        for letter, value in place.items():
            values[FIRST_PARAMETERS[name] + AXIS_LETTERS.index(cast(AxisLetter, letter))] = value
    return values


def offsets_in(values: Mapping[int, float], machine: Machine) -> Offsets:
    """Return the offsets in the parameters of a program."""
    return {
        name: {
            letter: values.get(FIRST_PARAMETERS[name] + AXIS_LETTERS.index(letter), 0.0)
            for letter in machine.axes
        }
        for name in KEPT
    }


def offset_lines(
    board: LineSink, machine: Machine, values: Mapping[int, float]
) -> Iterator[GcodeLine]:
    """Yield the lines that write changed coordinate systems (G10) to the board.

    Args:
        board: The board.
        machine: The machine.
        values: Parameters at the end of the program, by number.
    """
    letters = [letter for letter in machine.axes if letter.upper() in BOARD_LETTERS]
    for number, name in enumerate(SYSTEMS, start=1):
        place = dict(zip(machine.axes, board.stored_offsets.get(name, ()), strict=False))
        new = {
            letter: values.get(FIRST_PARAMETERS[name] + AXIS_LETTERS.index(letter), 0.0)
            for letter in letters
        }
        changed = [
            letter
            for letter in letters
            if letter in place and abs(new[letter] - place[letter]) > CHANGED
        ]
        if changed:
            yield GcodeLine(
                " ".join(
                    (
                        f"G10 L2 P{number}",
                        *(f"{letter.upper()}{new[letter]:.3f}" for letter in changed),
                    )
                ),
                0,
            )
