"""Capabilities that a program requires of a board: one table for all boards."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from cnc.boards.protocols import ACTIONS, Action, Capabilities, LineSink, PulseSink
from cnc.boards.registry import BoardFactory, board_factory
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
    TipControl,
    WaitInput,
)
from cnc.model.diagnostics import Diagnostic, GcodeError, UsageError
from cnc.session.pauses import needs_operator, pause_reason

ACTION_NAMES: dict[Action, str] = {
    "spindle": "spindle (M3)",
    "spindle backward": "reversible spindle (M4)",
    "surface speed": "constant surface speed (G96)",
    "orient": "spindle orientation (M19)",
    "flood": "flood (M8)",
    "mist": "mist (M7)",
    "outputs": "outputs (M62 to M68)",
}


def required_actions(block: Block) -> Iterator[Action]:
    """Yield the actions that a block requires of a board."""
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
class CapabilityCheck:
    """Checks blocks against the capabilities of the board, or of the board in the machine file.

    Attributes:
        board: Name of the board.
        real: Whether the session has a board.
        senses: Whether the board reads probes, inputs and the spindle position.
        probes: Whether it reads probes.
        lines: Whether it accepts lines.
        actions: Actions that it can carry out between moves.
        moves: Whether it moves a machine.
        attended: Whether an operator can continue the program after M0 and M6.
        skips_commands: Whether a command of a GRBL board is only a warning where nothing moves.
    """

    board: str
    real: bool
    senses: bool
    probes: bool
    lines: bool
    actions: frozenset[Action]
    moves: bool
    attended: bool
    skips_commands: bool = False

    @classmethod
    def of(
        cls, board: PulseSink | LineSink | None, name: str | None, machine: Machine, attended: bool
    ) -> CapabilityCheck:
        """Return the check for a board, or for none."""
        known = machine.board.kind if name is None else name
        can = expected_capabilities(machine) if board is None else board.capabilities
        lines = takes_lines(known) if board is None else board.takes == "lines"
        if can is None:
            return cls(known, False, True, True, lines, ACTIONS, False, attended)
        return cls(
            known,
            board is not None,
            can.senses,
            can.probes,
            lines,
            can.actions,
            lines or can.slice_s > 0.0,
            attended,
        )

    def check(self, block: Block) -> None:
        """Raise GcodeError for a block that the board cannot carry out."""
        if isinstance(block, BoardCommand):
            if not self.lines and not self._skips(block):
                message, hint = (
                    f"{block.text} is for a GRBL board",
                    "remove it, or use a machine file whose board.kind is grbl",
                )
                raise GcodeError(
                    Diagnostic("board-command", message, block.file, block.line, hint=hint)
                )
        elif isinstance(block, TipControl) and self.lines:
            message = f"the board {self.board!r} has no tool-tip control"
            hint = "end it with G49 or M429, or run the program on a board that takes pulses"
            raise GcodeError(Diagnostic("not-on-board", message, block.file, block.line, hint=hint))
        elif isinstance(block, Probe | WaitInput | SpindleSync):
            if not self.senses and not (self.probes and isinstance(block, Probe)):
                kind = {SpindleSync: "the spindle position", Probe: "a probe"}.get(
                    type(block), "an input"
                )
                message = f"the board {self.board!r} cannot read {kind}"
                raise GcodeError(
                    Diagnostic(
                        "board-senseless",
                        message,
                        block.file,
                        block.line,
                        hint="run the program on a board that can",
                    )
                )
        elif self.real and self.moves and not self.attended and pause_reason(block):
            raise needs_operator(block)
        else:
            for action in required_actions(block):
                if action not in self.actions:
                    message = f"the board {self.board!r} has no {ACTION_NAMES[action]}"
                    hint = "remove it, or run the program on a board that has it"
                    raise GcodeError(
                        Diagnostic("not-on-board", message, block.file, block.line, hint=hint)
                    )

    def _skips(self, block: Block) -> bool:
        """Whether a command of a GRBL board is left out, because nothing moves anyway."""
        return (
            isinstance(block, BoardCommand)
            and self.skips_commands
            and not (self.real and self.moves)
        )

    def skipped(self, block: Block) -> Diagnostic | None:
        """Return the warning for a command of a GRBL board that this board does not get."""
        if self.lines or not self._skips(block):
            return None
        assert isinstance(block, BoardCommand)
        message = f"{block.text} is for a GRBL board; here it has no effect"
        return Diagnostic(
            "board-command-skipped", message, block.file, block.line, severity="warning"
        )


def takes_lines(kind: str) -> bool:
    """Whether boards of this kind take lines; False for a kind without a driver."""
    driver = known_driver(kind)
    return driver is not None and driver.takes == "lines"


def known_driver(kind: str) -> BoardFactory | None:
    """Return the driver class of a kind of board, None without one."""
    try:
        return board_factory(kind)
    except UsageError:
        return None


def expected_capabilities(machine: Machine) -> Capabilities | None:
    """Return the capabilities of the board in the machine file; None if its driver cannot tell."""
    driver = known_driver(machine.board.kind)
    if driver is None or driver.takes == "lines":
        return None
    return driver.expected_capabilities(machine)
