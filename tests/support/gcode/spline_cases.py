"""Helpers for tests of splines: the curves of a program, and points on them computed by scipy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from cnc.model.blocks import NurbsFeed
from tests.support.gcode.gcode_cases import run

Floats = NDArray[np.float64]


def curves_of(source: str, **options: Any) -> list[NurbsFeed]:
    """The NURBS blocks of a program."""
    return [block for block in run(source, **options) if isinstance(block, NurbsFeed)]


def curve(source: str, **options: Any) -> NurbsFeed:
    """The only NURBS of a program."""
    (found,) = curves_of(source, **options)
    return found


def points_on(block: NurbsFeed, at: Floats) -> Floats:
    """Points of a block's curve at parameters from 0 (its start) to 1 (its end)."""
    knots, weights = block.knots, block.weights
    u = knots[0] + (knots[-1] - knots[0]) * at
    top = BSpline(knots, block.control_points * weights[:, None], block.degree)(u)
    return np.asarray(top / BSpline(knots, weights, block.degree)(u)[:, None])
