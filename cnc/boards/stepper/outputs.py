"""What blocks between moves mean for the outputs of the stepper board."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from cnc.boards.protocols import Action
from cnc.machine.models import Machine
from cnc.model.blocks import Block

ENABLED, SPINDLE, BACKWARD, FLOOD, MIST = 1, 2, 4, 8, 16


def actions(axes: int) -> frozenset[Action]:
    """What a board of so many axes can do between moves: step and direction of a fourth one take
    the pins of two outputs.
    """
    usual: frozenset[Action] = frozenset(("spindle", "flood"))
    return usual if axes == 4 else usual | {"spindle backward", "mist"}


@dataclass(frozen=True, slots=True)
class Outputs:
    """All outputs at once. duty: of the spindle's PWM, 0 to 255."""

    enabled: bool = False
    spindle: Literal["cw", "ccw", "off"] = "off"
    duty: int = 0
    flood: bool = False
    mist: bool = False

    @property
    def bytes(self) -> tuple[int, int]:
        """The arguments of the stream's command."""
        on = ENABLED * self.enabled | FLOOD * self.flood | MIST * self.mist
        if self.spindle != "off":
            on |= SPINDLE | BACKWARD * (self.spindle == "ccw")
        return on, self.duty

    def after(self, block: Block, machine: Machine) -> Outputs:
        """After a block: the drivers' floor knows blocks by their names."""
        match type(block).__name__:
            case "Spindle":
                state: Literal["cw", "ccw", "off"] = getattr(block, "state", "off")
                share = float(getattr(block, "rpm", 0.0)) / machine.board.max_spindle_rpm
                return replace(
                    self,
                    spindle=state,
                    duty=0 if state == "off" else min(max(round(255 * share), 0), 255),
                )
            case "Coolant":
                return replace(
                    self,
                    flood=bool(getattr(block, "flood", False)),
                    mist=bool(getattr(block, "mist", False)),
                )
            case "End":
                return replace(self, spindle="off", duty=0, flood=False, mist=False)
        return self
