"""Benchmark of segments: bytes per move, moves per second, largest deviation from the time.

python -m benchmarks.segments [PULSES.npz ...]

Without files it uses lines, circles and random moves. Files are those of ``cncrun --pulses``.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.boards.stepper.segments import SegmentEncoder, split
from cnc.model.streams import PulseChunk
from tests.support.boards.segment_decoder import SegmentDecoder

Times = NDArray[np.int64]
Steps = NDArray[np.int8]

MOVES = 1_000_000
CHUNK = 65536


def crossings(path: NDArray[np.float64], seconds: float) -> tuple[Times, Steps]:
    """Return the moves of a path (points, axes) in steps, traversed in even time.

    A move is due where the path is halfway between two grid points.
    """
    grid = np.floor(path + 0.5).astype(np.int64)
    times, axes, signs = [], [], []
    for axis in range(path.shape[1]):
        row = np.flatnonzero(np.diff(grid[:, axis]))
        line = np.maximum(grid[row, axis], grid[row + 1, axis]) - 0.5
        part = (line - path[row, axis]) / (path[row + 1, axis] - path[row, axis])
        times.append((row + part) / (len(path) - 1) * seconds * 1e9)
        axes.append(np.full(len(row), axis))
        signs.append(np.sign(path[row + 1, axis] - path[row, axis]))
    order = np.argsort(np.concatenate(times), kind="stable")
    step = np.zeros((len(order), path.shape[1]), np.int8)
    step[np.arange(len(order)), np.concatenate(axes)[order]] = np.concatenate(signs)[order]
    return np.concatenate(times)[order].astype(np.int64), step


def fastest_leads(slopes: list[float], rate: float) -> tuple[Times, Steps]:
    """A line whose first axis steps in every move."""
    places = np.floor(np.arange(MOVES + 1)[:, None] * np.array(slopes) + 0.5)
    return np.round(np.arange(1, MOVES + 1) / rate * 1e9).astype(np.int64), np.diff(
        places, axis=0
    ).astype(np.int8)


def circles(radius: float, rate: float) -> tuple[Times, Steps]:
    """Circles by their crossings. radius in steps, rate in moves/s."""
    angle = np.linspace(0.0, MOVES / (8.0 * radius) * 2.0 * np.pi, 2 * MOVES + 1)
    return crossings(radius * np.stack([np.cos(angle), np.sin(angle)], axis=1), MOVES / rate)


def disorder() -> tuple[Times, Steps]:
    """Any mask after any time."""
    random = np.random.default_rng(1)
    mask = random.integers(1, 8, MOVES // 10)
    step = np.where(mask[:, None] >> np.arange(3) & 1, 1, 0).astype(np.int8)
    return np.cumsum(random.integers(20_000, 200_000, len(mask))), step


def measure(name: str, times: Times, step: Steps) -> None:
    """Encode, play, compare, print a line."""
    line = np.zeros(len(times), np.int32)
    chunks = [
        PulseChunk(times[k : k + CHUNK], step[k : k + CHUNK], line[k : k + CHUNK])
        for k in range(0, len(times), CHUNK)
    ]
    encoder = SegmentEncoder(step.shape[1])
    begin = time.process_time()
    data = b"".join([encoder.push(chunk) for chunk in chunks] + [encoder.flush(end=True)])
    encoding = time.process_time() - begin
    begin = time.process_time()
    parts = list(SegmentDecoder(step.shape[1]).play(data))
    playing = time.process_time() - begin
    if not np.array_equal(np.concatenate([made for _, made in parts]), step):
        raise AssertionError("The moves came out in another order.")
    off = np.abs(np.concatenate([at for at, _ in parts]) - times).max()
    segments = sum(1 for _ in split(data))
    print(
        f"{name:34} {len(step):9} moves  {len(data) / len(step):6.3f} bytes a move  "
        f"{len(step) / segments:6.1f} moves a segment  "
        f"encoded {len(step) / encoding / 1e6:6.1f} M/s  "
        f"played {len(step) / playing / 1e6:6.1f} M/s  at most {off / 1000:.2f} us off"
    )


def main() -> None:
    """Print a line for each path."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="*", type=Path, metavar="PULSES.npz")
    files = parser.parse_args().files
    encoder = SegmentEncoder(3)
    encoder.push(PulseChunk(np.array([0]), np.ones((1, 3), np.int8), np.zeros(1, np.int32)))
    list(SegmentDecoder(3).play(encoder.flush()))
    for file in files:
        pulses = np.load(file)
        measure(file.name, pulses["time_ns"], pulses["step"])
    if not files:
        line = np.linspace(0.0, 1.0, 2 * MOVES + 1)[:, None] * MOVES
        measure("line, 3 axes, the fastest leads", *fastest_leads([1.0, 0.7123, 0.2871], 30_000))
        measure(
            "line, 2 axes, where they cross", *crossings(line * [0.6123, 0.3877], MOVES / 30_000)
        )
        measure(
            "line, 3 axes, where they cross",
            *crossings(line * [0.5123, 0.3077, 0.18], MOVES / 30_000),
        )
        measure("circles of 4000 steps, crossings", *circles(4000, 10_000))
        measure("circles of 4000 steps, faster", *circles(4000, 40_000))
        measure("no order", *disorder())


if __name__ == "__main__":
    main()
