"""Alarms of a Klipper board: what has stopped the motors, and what to do."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from cnc.boards.errors import board_error
from cnc.boards.klipper.layout import EMERGENCY, EXPIRED, LIMIT
from cnc.model.diagnostics import BoardError

RELEASE = "release it when it is safe, then home the machine"
DEAD_STOP = "the motors stopped without a ramp and may have lost steps: home the machine"
SLOW = "reduce the load of this computer"
KEPT = "the position is kept: find the cause, then start again"


class Alarm(NamedTuple):
    """Code, message and hint of an alarm."""

    code: str
    message: str
    hint: str


def alarm_of(reason: int, letter: Callable[[int], str]) -> Alarm:
    """Return the alarm for the reason of a trigger.

    Args:
        reason: The reason.
        letter: Gives the letter of an axis by its column.
    """
    if reason == EMERGENCY:
        return Alarm("board-emergency-stop", "the e-stop is pressed", RELEASE)
    if reason >= LIMIT:
        hint = "move away from it by hand with the drivers off, then home the machine"
        message = f"the limit switch of {letter(reason - LIMIT)} was hit"
        return Alarm("board-limit", message, hint)
    if reason == EXPIRED:
        return Alarm("board-silence", "the board heard nothing from this computer", DEAD_STOP)
    message = f"the board stopped the motors for an unknown reason, {reason}"
    return Alarm("board-alarm", message, DEAD_STOP)


def reset_error(name: str) -> BoardError:
    """Return the fault of a board on a port that was reset during a run."""
    message = f"the board on {name} was reset; its position is lost"
    hint = "check its supply and its reset line; home the machine before the next run"
    return board_error("board-reset", message, hint=hint)
