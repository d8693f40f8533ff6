"""Outputs of the stepper board: spindle, coolant, motor drivers."""

from __future__ import annotations

from cnc.boards.protocols import Action
from cnc.boards.pulse_board.outputs import OutputState

ENABLED, SPINDLE, BACKWARD, FLOOD, MIST = 1, 2, 4, 8, 16
"""Bits of the outputs."""


def actions(motors: int) -> frozenset[Action]:
    """Return the actions that a board supports between moves.

    Step and direction of a fourth motor use the pins of two outputs.

    Args:
        motors: Number of motors of the board.
    """
    usual: frozenset[Action] = frozenset(("spindle", "flood"))
    return usual if motors == 4 else usual | {"spindle backward", "mist"}


def output_bytes(state: OutputState) -> tuple[int, int]:
    """Return the arguments of the command in the stream: bits, and duty of the spindle's PWM."""
    on = ENABLED * state.enabled | FLOOD * state.flood | MIST * state.mist
    if state.spindle != "off":
        on |= SPINDLE | BACKWARD * (state.spindle == "ccw")
    return on, round(255 * state.share)
