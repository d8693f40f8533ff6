"""Positions in X that a program of O-words moves to."""

from __future__ import annotations

from cnc.model.blocks import Polyline
from tests.support.gcode.gcode_cases import run


def xs(source: str, **options: object) -> list[float]:
    """The X positions of a program's moves."""
    blocks = run(source, axes=("x",), **options)
    return [
        float(point)
        for block in blocks
        if isinstance(block, Polyline)
        for point in block.points[:, 0]
    ]
