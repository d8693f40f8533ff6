"""A finishing program of any length, as a CAM system writes it.

It is a zig-zag over a smooth surface in moves of 0.15 mm.

    python -m benchmarks.finishing MOVES FILE
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import AxisLetter

AXES: tuple[AxisLetter, ...] = ("x", "y", "z")
MOVE = 0.15
"""mm along X between the points of a row, and along Y between rows."""
MOVES_IN_ROW = 1000
FEED = 25.0
"""mm/s."""
TOLERANCE = 0.01
"""mm: G64 P."""
DEPTH_CHANGE = 3.0
"""mm: amplitude of the surface."""


def machine(*, tangential: bool = True, per_axis: bool = False) -> Machine:
    """Return a machine with 1000 mm/s^2 and 50 000 mm/s^3 along the path, per axis, or both."""
    axis = Axis(
        steps_per_mm=100.0,
        max_velocity=100.0,
        max_acceleration=1000.0 if per_axis else None,
        max_jerk=50_000.0 if per_axis else None,
    )
    path = PathLimits(
        max_feed=100.0,
        max_tangential_acceleration=1000.0 if tangential else None,
        max_normal_acceleration=1000.0 if tangential else None,
        max_jerk=50_000.0 if tangential else None,
        tolerance=TOLERANCE,
    )
    return Machine(axes=dict.fromkeys(AXES, axis), path=path)


def points(moves: int) -> NDArray[np.float64]:
    """Return the start of the first move and the ends of all (moves + 1, 3), mm.

    They are rounded to a micrometre.
    """
    number = np.arange(moves + 1)
    row, column = np.divmod(number, MOVES_IN_ROW)
    across = np.where(row % 2 == 0, column, MOVES_IN_ROW - 1 - column) * MOVE
    along = row * MOVE
    height = DEPTH_CHANGE * np.sin(across / 7.0 + 0.3 * np.sin(along / 5.0)) * np.cos(along / 9.0)
    xyz: NDArray[np.float64] = np.stack((20.0 + across, 20.0 + along, height - 10.0), axis=1)
    return xyz.round(3)


def lines(moves: int, tolerance: float = TOLERANCE) -> Iterator[str]:
    """Yield the lines of the program; words that do not change are left out."""
    x, y, z = points(1)[0].tolist()
    yield from (
        "G21 G90 G17 G94 G40 G49 G80",
        "G54",
        "S16000 M3",
        f"G64 P{tolerance:g}",
        "G0 Z20",
        f"G0 X{x:g} Y{y:g}",
        "G0 Z5",
        f"G1 Z{z:g} F400",
    )
    feed = f" F{60 * FEED:g}"
    for before, here in itertools.pairwise(points(moves).tolist()):
        words = (
            f"{letter}{value:.3f}".rstrip("0").rstrip(".")
            for letter, value, old in zip("XYZ", here, before, strict=True)
            if value != old
        )
        yield " ".join(words) + feed
        feed = ""
    yield from ("G0 Z20", "M5", "M30")


def write(file: Path, moves: int, tolerance: float = TOLERANCE) -> None:
    """Write the program to a file."""
    with file.open("w", encoding="ascii", newline="\n") as out:
        out.writelines(line + "\n" for line in lines(moves, tolerance))


def main() -> None:
    """Write a program of so many moves."""
    parser = argparse.ArgumentParser(description="Write a finishing program.")
    parser.add_argument("moves", type=int)
    parser.add_argument("file", type=Path)
    arguments = parser.parse_args()
    write(arguments.file, arguments.moves)


if __name__ == "__main__":
    main()
