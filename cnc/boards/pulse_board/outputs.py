"""State of the outputs of a board: spindle, coolant, motor drivers, fan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from cnc.machine.models import Machine
from cnc.model.blocks import Block, Coolant, End, Spindle


@dataclass(frozen=True, slots=True)
class OutputState:
    """State of all outputs. ``share`` is the speed of the spindle as a share of the highest."""

    enabled: bool = False
    spindle: Literal["cw", "ccw", "off"] = "off"
    share: float = 0.0
    flood: bool = False
    mist: bool = False
    fan: bool = False

    def after(self, block: Block, machine: Machine) -> OutputState:
        """Return the state after a block."""
        match block:
            case Spindle(state=state, rpm=rpm):
                share = 0.0 if state == "off" else rpm / machine.board.max_spindle_rpm
                return replace(self, spindle=state, share=min(max(share, 0.0), 1.0))
            case Coolant(mist=mist, flood=flood):
                return replace(self, flood=flood, mist=mist)
            case End():
                return self.off()
        return self

    def off(self) -> OutputState:
        """Return the state with spindle, coolant and fan off."""
        return replace(self, spindle="off", share=0.0, flood=False, mist=False, fan=False)
