"""Random programs and machines, with requests of the operator at random moments."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import corners, optimum_cases
from cnc.api import parse
from cnc.machine.models import Machine
from cnc.model.blocks import Block, PathMode
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.planner.joints import Joints
from cnc.planner.motion_time import motion_time
from tests.support.five_axis import TYPES, five_axis_machine, table_of
from tests.support.planner.random_jobs import Job, with_angles

Random = np.random.Generator


class Program(NamedTuple):
    """A program: its family, the path with the blocks between, and the machine."""

    family: str
    path: list[PathChunk | Block]
    machine: Machine


def of_blocks(family: str, blocks: list[Block], machine: Machine) -> Program:
    """Return the program of blocks for the axes or the joints of a machine."""
    start, joints = np.zeros(len(machine.axis_names)), Joints(machine)
    path = build(
        blocks,
        axes=machine.axis_names,
        start=start,
        tolerance=machine.path.tolerance,
        short_legs=joints.short_legs,
        duration=motion_time(machine),
    )
    return Program(family, list(joints.path(path, start)), machine)


def rosette(rng: Random) -> list[Block]:
    """Return the chords of a rosette: a bent path without an end of its bends."""
    petals, size = int(rng.integers(3, 9)), 10 ** rng.uniform(0.8, 1.5)
    count = int(rng.integers(150, 700))
    u = np.linspace(0.0, 2.0 * math.pi * rng.uniform(0.3, 1.0), count)
    radius = size * (1.0 + rng.uniform(0.1, 0.6) * np.cos(petals * u))
    points = np.stack((radius * np.cos(u), radius * np.sin(u), np.zeros(count)), axis=1)
    points = (points - points[0]).round(int(rng.choice((3, 4))))
    tolerance = float(rng.choice((0.01, 0.003)))
    moves = optimum_cases.moves(points, optimum_cases.feed_of(rng))
    return [PathMode("", 1, "blend", tolerance), moves]


def polygon(rng: Random) -> tuple[list[Block], Machine]:
    """Return a polygon whose corners are passed within a tolerance."""
    case = corners.random_case(str(rng.choice(corners.FAMILIES)), rng)
    return corners.blocks_of(case), case.machine


PLANAR: dict[str, Callable[[Random], tuple[list[Block], Machine]]] = {
    **{name: family[0] for name, family in optimum_cases.FAMILIES.items()},
    "rosettes": lambda rng: (rosette(rng), optimum_cases.random_machine(rng)),
    "polygons": polygon,
}
FIVE_AXES = "five axes"
FAMILIES = (*PLANAR, FIVE_AXES)


def random_program(family: str, rng: Random, folder: Path) -> Program:
    """Return a random program of a family. Those of five axes are written to ``folder``."""
    if family != FIVE_AXES:
        return of_blocks(family, *PLANAR[family](rng))
    kind = str(rng.choice(TYPES))
    machine, file = five_axis_machine(kind, rng), folder / "five.ngc"
    file.write_text(with_angles(Job(rng, 8.0).write(), table_of(kind).tilting.upper(), rng))
    return of_blocks(family, list(parse(file, machine)), machine)
