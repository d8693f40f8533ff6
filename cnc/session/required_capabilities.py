"""What a board can do for a program, and the faults of blocks that ask for more: one table for all
boards.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from cnc.boards.protocols import ACTIONS, Action, Capabilities, KnownInAdvance, LineSink, PulseSink
from cnc.boards.registry import board_factory
from cnc.machine.models import Machine
from cnc.model.blocks import (
    AnalogOutput,
    Block,
    BoardCommand,
    Coolant,
    DigitalOutput,
    Orient,
    Probe,
    Spindle,
    SpindleSync,
    WaitInput,
)
from cnc.model.diagnostics import Diagnostic, GcodeError, UsageError
from cnc.session.board_offsets import needs_operator, waits

WORDS: dict[Action, str] = {
    "spindle": "spindle (M3)",
    "spindle backward": "spindle that turns backward (M4)",
    "surface speed": "constant surface speed (G96)",
    "orient": "spindle that can be oriented (M19)",
    "flood": "flood (M8)",
    "mist": "mist (M7)",
    "outputs": "outputs to switch or set (M62 to M68)",
}


def wanted(block: Block) -> Iterator[Action]:
    """What a board has to be able to do for a block."""
    match block:
        case Spindle(state="cw" | "ccw" as state, surface_speed=speed):
            yield "spindle" if state == "cw" else "spindle backward"
            if speed:
                yield "surface speed"
        case Orient():
            yield "orient"
        case Coolant(mist=mist, flood=flood):
            if mist:
                yield "mist"
            if flood:
                yield "flood"
        case DigitalOutput() | AnalogOutput():
            yield "outputs"


@dataclass(frozen=True, slots=True)
class Abilities:
    """Of the board of a job, or without one of the board that the machine file names.

    board: its name. real: there is one. senses: probes, inputs and the turning spindle; probes:
    those at least. lines: it takes lines. actions: what it can do between moves. moves: a machine
    moves by it. attended: whether somebody is there to go on after M0 and M6.
    """

    board: str
    real: bool
    senses: bool
    probes: bool
    lines: bool
    actions: frozenset[Action]
    moves: bool
    attended: bool

    @classmethod
    def of(
        cls, board: PulseSink | LineSink | None, name: str | None, machine: Machine, attended: bool
    ) -> Abilities:
        """Of a board, or of none."""
        known = machine.board.kind if name is None else name
        can = _expected_capabilities(machine) if board is None else board.capabilities
        if can is None:
            return cls(known, False, True, True, _takes_lines(known), ACTIONS, False, attended)
        return cls(
            known,
            board is not None,
            can.senses,
            can.probes,
            can.lines,
            can.actions,
            can.lines or can.slice_s > 0.0,
            attended,
        )

    def check(self, block: Block) -> None:
        """GcodeError for a block that this board can't carry out."""
        if isinstance(block, BoardCommand):
            if not self.lines:
                message, hint = (
                    f"{block.text} is for a GRBL board",
                    "take it out, or name a machine file whose board.kind is grbl",
                )
                raise GcodeError(
                    Diagnostic("board-command", message, block.file, block.line, hint=hint)
                )
        elif isinstance(block, Probe | WaitInput | SpindleSync):
            if not self.senses and not (self.probes and isinstance(block, Probe)):
                what = (
                    "the spindle's turning"
                    if isinstance(block, SpindleSync)
                    else "a probe"
                    if isinstance(block, Probe)
                    else "an input"
                )
                message = f"the board {self.board!r} does not feel {what}"
                raise GcodeError(
                    Diagnostic(
                        "board-senseless",
                        message,
                        block.file,
                        block.line,
                        hint="run it on a board that does",
                    )
                )
        elif self.real and self.moves and not self.attended and waits(block):
            raise needs_operator(block)
        else:
            for action in wanted(block):
                if action not in self.actions:
                    message = f"the board {self.board!r} has no {WORDS[action]}"
                    hint = "take it out, or run it on a board that has"
                    raise GcodeError(
                        Diagnostic("not-on-board", message, block.file, block.line, hint=hint)
                    )


def _takes_lines(kind: str) -> bool:
    """Whether boards of this kind take lines; False for a kind without a driver."""
    try:
        return board_factory(kind).traits.takes_lines
    except UsageError:
        return False


def _expected_capabilities(machine: Machine) -> Capabilities | None:
    """What the board of the machine file will be able to do, as far as its driver knows without
    one.
    """
    try:
        factory = board_factory(machine.board.kind)
    except UsageError:
        return None
    return factory.expected_capabilities(machine) if isinstance(factory, KnownInAdvance) else None
