"""Protocol of the positions of joints and tip under tool-tip control."""

from __future__ import annotations

from typing import Protocol

Offset = tuple[float, float, float]


class ToolTip(Protocol):
    """Positions of the joints and of the tip of a machine, mm or degrees (axes,)."""

    def joints(self, tip: list[float], offset: Offset) -> list[float]:
        """Return the joints of a tip with a tool offset (X, Y, Z)."""

    def tip(self, joints: list[float], offset: Offset) -> list[float]:
        """Return the tip of joints."""
