"""Programs for boards that plan for themselves: such a board knows its own offsets and travel, and
the program is read with those.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from cnc.boards.protocols import LineSink, board_error
from cnc.grbl_lines.board_limits import BoardLimits
from cnc.grbl_lines.grbl_timing import BoardTime
from cnc.grbl_lines.translator import ARC_TOLERANCE, Translator
from cnc.grbl_lines.travel_margin import MARGIN
from cnc.machine.models import Machine
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import AXIS_LETTERS, Block, Stop, Tool
from cnc.model.diagnostics import Diagnostic, GcodeError
from cnc.model.streams import GcodeLine

SYSTEMS = ("G54", "G55", "G56", "G57", "G58", "G59")
FIRST = {
    "G28": numbers.G28_POSITION,
    "G30": numbers.G30_POSITION,
    "G92": numbers.SHIFT,
    **{name: numbers.origin(system) for system, name in enumerate(SYSTEMS)},
}
"""Number of the parameter that holds the X of each place."""
CHANGED = 0.0005
"""mm: an offset that differs by less is the one that the board told."""


def adopted(board: LineSink, machine: Machine) -> dict[int, float]:
    """Parameters of the places that the board remembers: with these a program means what it meant
    if the board read it itself.
    """
    values = {numbers.CURRENT_SYSTEM: 1.0, numbers.SHIFT_IN_EFFECT: 1.0}
    for name, place in board.stored_offsets.items():
        for letter, value in zip(machine.axes, place, strict=True):
            values[FIRST[name] + AXIS_LETTERS.index(letter)] = value
    return values


def to_remember(
    board: LineSink, machine: Machine, values: Mapping[int, float]
) -> Iterator[GcodeLine]:
    """Lines by which a board keeps the coordinate systems that a program has set (G10)."""
    letters = [letter for letter in machine.axes if letter in "xyz"]
    for number, name in enumerate(SYSTEMS, start=1):
        place = dict(zip(machine.axes, board.stored_offsets.get(name, ()), strict=False))
        new = {
            letter: values.get(FIRST[name] + AXIS_LETTERS.index(letter), 0.0) for letter in letters
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


def translator(board: LineSink, machine: Machine) -> Translator:
    """What makes lines for this board. BoardError ``board-axes`` where it has not the axes that
    lines need.
    """
    offsets = dict(zip(machine.axes, board.work_offset, strict=True))
    if not offsets:
        raise board_error(
            "board-axes", "the board tells no offsets", hint="is it GRBL 1.1 or grblHAL?"
        )
    work_offset = [offsets.get(letter, 0.0) for letter in ("x", "y", "z")]
    settings = board.settings
    return Translator(
        machine,
        work_offset=work_offset,
        arc_tolerance=settings.get(12) or ARC_TOLERANCE,
        mist=board.mist,
        margin=MARGIN if settings.get(20) else 0.0,
    )


def clock(board: LineSink, machine: Machine) -> BoardTime:
    """What adds up how long this board takes for lines that begin where it stands."""
    offsets = dict(zip(machine.axes, board.work_offset, strict=False))
    places = dict(zip(machine.axes, board.position, strict=False))
    x, y, z = (places.get(letter, 0.0) - offsets.get(letter, 0.0) for letter in ("x", "y", "z"))
    return BoardTime(BoardLimits.of_board(machine, board.settings), (x, y, z))


def waits(block: Block) -> str:
    """Why a machine waits at a block until the operator goes on; empty where it does not. As in
    GRBL, M1 is no stop.
    """
    if isinstance(block, Tool) and block.change:
        return f"put in tool {block.number}"
    if isinstance(block, Stop) and not block.optional:
        return "change the pallet" if block.pallet else "the program stops here"
    return ""


def needs_operator(block: Block) -> GcodeError:
    """The fault of a block that waits, where there is nobody."""
    hint = (
        "run it in a terminal, where the space bar goes on, or with --yes, which goes on by itself"
    )
    message = f"{waits(block)}, and there is no terminal to go on from"
    return GcodeError(Diagnostic("needs-operator", message, block.file, block.line, hint=hint))
