"""Protocols of the positions of joints, tip and tool under tool-tip control."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Offset = tuple[float, float, float]


class Swing(Protocol):
    """A change of the orientation along a great circle; angles in degrees."""

    @property
    def end(self) -> tuple[float, float]:
        """Tilt and turn at the end."""

    @property
    def nearest(self) -> float:
        """Least angle between the tool and the axis of C."""

    @property
    def parameters(self) -> Floats:
        """Share of the way of each control point (n,); empty where both angles change linearly."""

    @property
    def angles(self) -> Floats:
        """Control points of tilt and turn (n, 2) of Bezier curves of degree 7."""

    @property
    def knots(self) -> Floats:
        """Knots of the curves, 0 to 1."""


class ToolTip(Protocol):
    """Positions of the joints and of the tip of a machine, mm or degrees (axes,)."""

    @property
    def rotary(self) -> tuple[int, int]:
        """Columns of the axis that tilts and of the one that turns."""

    @property
    def points_missing(self) -> tuple[str, ...]:
        """Keys of the points of the rotary axes that the machine file does not give."""

    def joints(self, tip: list[float], offset: Offset) -> list[float]:
        """Return the joints of a tip with a tool offset (X, Y, Z)."""

    def tip(self, joints: list[float], offset: Offset) -> list[float]:
        """Return the tip of joints."""

    def angles(self, here: list[float], direction: Floats) -> tuple[float, float]:
        """Return tilt and turn of a direction of the tool (3,), from a position (axes,)."""

    def swing(self, here: list[float], direction: Floats) -> Swing | None:
        """Return the way from a position (axes,) to a direction of the tool (3,).

        None for the opposite direction; without an end where it passes the axis of C.
        """
