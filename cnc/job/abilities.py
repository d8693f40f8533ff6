"""What a board can do for a program, and the faults of blocks that ask for more."""

from __future__ import annotations

from dataclasses import dataclass

from cnc.canon import Block, BoardCommand, Probe, SpindleSync, WaitInput
from cnc.drivers.base import LineSink, PulseSink
from cnc.errors import Diagnostic, GcodeError
from cnc.machine.models import Machine
from cnc.onboard import needs_operator, waits

LINE_BOARDS = ("grbl", "grbl-sim")
"""Kinds of board that take lines, and so commands of their own."""


@dataclass(frozen=True, slots=True)
class Abilities:
    """Of the board of a job, or without one of the board that the machine file names.

    board: its name, None without one. senses: probes, inputs and the turning spindle; probes: those at least. lines: it takes lines.
    attended: whether somebody is there to go on after M0 and M6.
    """

    board: str | None
    senses: bool
    probes: bool
    lines: bool
    attended: bool

    @classmethod
    def of(cls, board: PulseSink | LineSink | None, name: str | None, machine: Machine, attended: bool) -> Abilities:
        """Of a board, or of none."""
        if board is None:
            return cls(None, True, True, machine.board.kind in LINE_BOARDS, attended)
        can = board.capabilities
        return cls(name, can.senses, can.probes, can.lines, attended)

    def check(self, block: Block) -> None:
        """GcodeError for a block that this board can't carry out."""
        if isinstance(block, BoardCommand):
            if not self.lines:
                message, hint = f"{block.text} is for a GRBL board", "take it out, or name a machine file whose board.kind is grbl"
                raise GcodeError(Diagnostic("board-command", message, block.file, block.line, hint=hint))
        elif isinstance(block, Probe | WaitInput | SpindleSync):
            if not self.senses and not (self.probes and isinstance(block, Probe)):
                what = "the spindle's turning" if isinstance(block, SpindleSync) else "a probe" if isinstance(block, Probe) else "an input"
                message = f"the board {self.board!r} does not feel {what}"
                raise GcodeError(Diagnostic("board-senseless", message, block.file, block.line, hint="run it on a board that does"))
        elif not self.attended and self.lines and self.board is not None and waits(block):
            raise needs_operator(block)
