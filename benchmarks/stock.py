"""CPU time of the simulation of a cut: a million short moves over 200 x 200 mm at 0.1 mm.

A finishing program of a ball or another tool with moves of 0.15 to 0.25 mm over a wavy surface.
Run with ``python -m benchmarks.stock [MOVES]``.
"""

from __future__ import annotations

import math
import sys
from time import perf_counter, process_time

import numpy as np

from cnc.machine.models import Stock
from cnc.model.blocks import Polyline
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.stock.kernels.sweep import BALL, BULL, CONE, FLAT, Assembly, Cutter
from cnc.stock.simulation import Material

WIDTH = 200.0
"""mm. Side of the stock."""
CUTTERS = {
    "ball 6 mm": Cutter(BALL, 3.0, 0.0, 3.0),
    "flat 6 mm": Cutter(FLAT, 3.0, 3.0, 0.0),
    "bull nose 6 mm R1": Cutter(BULL, 3.0, 2.0, 1.0),
    "cone of 60 degrees": Cutter(CONE, 3.0, 0.0, math.sqrt(3.0)),
}


def finishing(moves: int) -> Polyline:
    """Return passes along X over a wavy surface that cover the stock."""
    length = 0.2 * moves
    step = WIDTH * WIDTH / length
    along = np.arange(1, moves + 1) * 0.2
    passes, x = np.divmod(along, WIDTH)
    x = np.where(passes % 2 == 0, x, WIDTH - x)
    y = passes * step
    z = -6.0 + 2.0 * np.sin(x / 9.0) * np.cos(y / 13.0)
    points = np.stack((x, y, z), axis=1)
    return Polyline("", 1, points, np.full(moves, 50.0), np.arange(1, moves + 1, dtype=np.int32))


def main(moves: int) -> None:
    """Print the time of each cutter."""
    stock = Stock(x=(0.0, WIDTH), y=(0.0, WIDTH), z=(-20.0, 0.0))
    block, start = finishing(moves), np.array([0.0, 0.0, -6.0])
    path = build([block], axes=("x", "y", "z"), start=start)
    chunks = [each for each in path if isinstance(each, PathChunk)]
    for name, cutter in CUTTERS.items():
        tool = Assembly(cutter, math.inf, math.inf, 0.0)
        material = Material(stock, 0.1)
        wall, cpu = perf_counter(), process_time()
        for chunk in chunks:
            material.cut(chunk, np.arange(3), np.zeros(3), tool)
        wall, cpu = perf_counter() - wall, process_time() - cpu
        print(
            f"{name:20} {moves} moves  {cpu:6.2f} CPU s  {wall:6.2f} s  "
            f"{material.removed_volume() / 1000.0:.3f} cm3 removed"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
