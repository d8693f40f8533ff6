"""Outputs of the stepper board: spindle, coolant, motor drivers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from cnc.boards.protocols import Action
from cnc.machine.models import Machine
from cnc.model.blocks import Block, Coolant, End, Spindle

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


@dataclass(frozen=True, slots=True)
class Outputs:
    """State of all outputs. ``duty`` is that of the spindle's PWM, 0 to 255."""

    enabled: bool = False
    spindle: Literal["cw", "ccw", "off"] = "off"
    duty: int = 0
    flood: bool = False
    mist: bool = False

    @property
    def bytes(self) -> tuple[int, int]:
        """Arguments of the command in the stream."""
        on = ENABLED * self.enabled | FLOOD * self.flood | MIST * self.mist
        if self.spindle != "off":
            on |= SPINDLE | BACKWARD * (self.spindle == "ccw")
        return on, self.duty

    def after(self, block: Block, machine: Machine) -> Outputs:
        """Return the state after a block."""
        match block:
            case Spindle(state=state, rpm=rpm):
                share = rpm / machine.board.max_spindle_rpm
                duty = 0 if state == "off" else min(max(round(255 * share), 0), 255)
                return replace(self, spindle=state, duty=duty)
            case Coolant(mist=mist, flood=flood):
                return replace(self, flood=flood, mist=mist)
            case End():
                return self.off()
        return self

    def off(self) -> Outputs:
        """Return the state with spindle and coolant off."""
        return replace(self, spindle="off", duty=0, flood=False, mist=False)
