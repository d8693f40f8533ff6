"""The picture of a program, and samples of its plan for comparison."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.api import load_machine, plan, start_position
from cnc.model.blocks import Dwell
from cnc.planner.joints import Joints
from cnc.planner.kernels.timed import is_timed
from cnc.planner.plan import PlanChunk
from cnc.pulses.sampled import Sampled
from cnc.view.collect import Collector, Picture, Sizes

EVERYTHING = Sizes(strokes=1 << 19, curves=1 << 17, origins=1 << 20)
PERIOD = 0.0013
"""s. It is no multiple of other times."""


@dataclass(frozen=True)
class Drawn:
    """A picture, and samples of the plan every PERIOD.

    Attributes:
        picture: the picture.
        t: (n,) times of the samples, s.
        position: (n, 3) positions, mm.
        values: (3, n) feed mm/s, acceleration mm/s^2 and jerk mm/s^3.
        line: (n,) source lines.
        timed: (n,) whether the sample lies in a motion past a corner, where the jerk changes.
    """

    picture: Picture
    t: NDArray[np.float64]
    position: NDArray[np.float64]
    values: NDArray[np.float64]
    line: NDArray[np.int32]
    timed: NDArray[np.bool_]


def drawn(program: Path, machine_name: str = "default", sizes: Sizes = EVERYTHING) -> Drawn:
    machine = load_machine(machine_name)
    start = start_position(machine)
    collector = Collector(machine, sizes, str(program), start)
    sampler = Sampled(PERIOD, Joints(machine).columns(start))
    samples, clock = [], 0.0
    spans: list[tuple[float, float]] = []
    for item in plan(program, machine):
        collector.add(item)
        if isinstance(item, PlanChunk):
            samples += sampler.samples(item)
            spans += timed_spans(item)
            clock = item.t0 + item.duration
        elif isinstance(item, Dwell):
            clock += item.seconds
    samples += sampler.finish(clock)
    t = np.concatenate([chunk.first + np.arange(len(chunk.s)) for chunk in samples]) * PERIOD
    columns = [
        np.concatenate([getattr(chunk, name) for chunk in samples])
        for name in ("position", "feed", "accel", "jerk", "line")
    ]
    inside = t <= clock
    return Drawn(
        collector.picture(),
        t[inside],
        columns[0][inside, :3],
        np.stack(columns[1:4])[:, inside],
        columns[4][inside],
        in_spans(t[inside], spans),
    )


def timed_spans(chunk: PlanChunk) -> list[tuple[float, float]]:
    """Return first and last time of each timed piece: one phase, which begins with it."""
    path, found = chunk.path, []
    for k in range(len(path)):
        if is_timed(int(path.kind[k]), path.data, int(path.at[k])):
            phase = int(np.argmin(np.abs(chunk.phase_s - chunk.piece_s[k])))
            times = chunk.t0 + chunk.phase_t[phase : phase + 2]
            found.append((float(times[0]), float(times[1])))
    return found


def in_spans(t: NDArray[np.float64], spans: list[tuple[float, float]]) -> NDArray[np.bool_]:
    """Return whether each time lies in one of the spans, which follow each other."""
    if not spans:
        return np.zeros(len(t), np.bool_)
    first, last = np.array(spans).T
    k = np.searchsorted(first, t, side="right") - 1
    inside: NDArray[np.bool_] = (k >= 0) & (t <= last[k])
    return inside


def write(folder: Path, text: str, name: str = "p.nc") -> Path:
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return file
