"""Homing of the machine before a program (``--home``)."""

from __future__ import annotations

import logging

import numpy as np

from cnc.boards.protocols import LineSink, PulseSink
from cnc.session.context import SessionContext

log = logging.getLogger(__name__)


def home_line_board(context: SessionContext, board: LineSink) -> None:
    """Let a GRBL board home the machine; the program begins where it stands then.

    Raises:
        BoardError, HomingStopped: As :func:`cnc.session.position_check.home_by_board`.
    """
    from cnc.session.position_check import home_by_board

    reader = context.reader
    log.info("homing")
    home_by_board(board, reader.machine, (), context.observer.control)
    reader.start = np.array(board.position)
    reader.begin_at(context.options.from_line)


def home_pulse_board(context: SessionContext, board: PulseSink) -> None:
    """Home the machine on a board that plays pulses.

    Raises:
        BoardError, HomingStopped: As :func:`cnc.executor.homing.home`.
    """
    from cnc.executor.homing import home

    log.info("homing")
    home(
        board,
        context.reader.machine,
        (),
        context.reader.start,
        control=context.observer.control,
        on_progress=context.observer.sent,
        on_squared=lambda found: log.info("%s", found.description),
    )
