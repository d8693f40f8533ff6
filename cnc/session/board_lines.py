"""Lines for a board that plans for itself: their translator, and their times on the board."""

from __future__ import annotations

from cnc.boards.errors import board_error
from cnc.boards.protocols import LineSink
from cnc.grbl_lines.board_limits import BoardLimits
from cnc.grbl_lines.grbl_timing import BoardTime
from cnc.grbl_lines.number_format import board_axes
from cnc.grbl_lines.translator import ARC_TOLERANCE, JUNCTION_DEVIATION, Translator
from cnc.grbl_lines.travel_margin import MARGIN
from cnc.machine.models import Machine


def line_translator(board: LineSink, machine: Machine) -> Translator:
    """Return the translator that makes lines for this board.

    Raises:
        BoardError: ``board-axes`` if the board does not report its offsets.
    """
    offsets = dict(zip(machine.axes, board.work_offset, strict=True))
    if not offsets:
        raise board_error(
            "board-axes", "the board reports no offsets", hint="is it GRBL 1.1 or grblHAL?"
        )
    work_offset = [offsets.get(letter, 0.0) for letter in board_axes(machine.axes)]
    settings = board.settings
    return Translator(
        machine,
        work_offset=work_offset,
        arc_tolerance=settings.get(12) or ARC_TOLERANCE,
        junction_deviation=settings.get(11, JUNCTION_DEVIATION),
        codes=board.codes,
        margin=MARGIN if settings.get(20) else 0.0,
    )


def board_timing(board: LineSink, machine: Machine) -> BoardTime:
    """Return the timing of lines on this board, from its present position."""
    offsets = dict(zip(machine.axes, board.work_offset, strict=False))
    places = dict(zip(machine.axes, board.position, strict=False))
    start = tuple(
        places.get(letter, 0.0) - offsets.get(letter, 0.0) for letter in board_axes(machine.axes)
    )
    limits = BoardLimits.of_board(machine, board.settings, board.planner_blocks)
    return BoardTime(limits, start)
