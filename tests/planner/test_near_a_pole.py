"""Moves near a pose in which a rotary axis turns without bound take a short computing time.

There the axis turns by thousands of degrees on a millimetre of path.
"""

import math
from pathlib import Path

import numpy as np
import pytest

from cnc.model.blocks import Block
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import curve_range
from cnc.planner.joints import Joints
from cnc.planner.known_path import STANDSTILL, intervals_of
from cnc.planner.limits import Limits
from cnc.pulses.kernels.grid_moves import Piece
from cnc.pulses.kernels.windows import begin_window, following, new_window, next_window
from cnc.session.options import RunOptions
from cnc.session.session import Session
from tests.support.five_axis import five_axis_machine
from tests.support.soak import share

STEPS_PER_UNIT = 200.0


def direction(tilt: float, turn: float) -> str:
    """Return the words of a direction of the tool on a machine with A and C."""
    tilted, turned = math.radians(tilt), math.radians(turn)
    across, up = math.sin(tilted), math.cos(tilted)
    return f"I{across * math.sin(turned):.9f} J{-across * math.cos(turned):.9f} K{up:.9f}"


def swing_past_the_pole(turn: float, folder: Path) -> PathChunk:
    """Return the path of a great circle that passes the axis of C."""
    machine, program = five_axis_machine("xyzac-head"), folder / "swing.nc"
    begin, end = direction(20.0, 0.0), direction(20.0, turn)
    lines = ["%", "O1", "G21 G90 G94", "T1 M6", "G43.5 H1", f"G1 X0 Y0 Z0 F1000 {begin}"]
    program.write_text("\n".join([*lines, f"X50 {end}", "M30", "%"]) + "\n")
    options = RunOptions(dialect="fanuc", tool_lengths="zero")
    blocks: list[Block] = list(Session(program, machine, options).blocks())
    start = np.zeros(5)
    path = Joints(machine).path(build(blocks, axes=machine.axis_names, start=start), start)
    return max((item for item in path if isinstance(item, PathChunk)), key=len)


@pytest.mark.parametrize("turn", (179.98, 179.9, 179.999)[:: share(1, 3)])
def test_a_swing_past_the_pole_is_cut_into_few_parts(turn, tmp_path):
    """It had 350 000 intervals, and its pulses a million windows."""
    chunk = swing_past_the_pole(turn, tmp_path)
    machine = five_axis_machine("xyzac-head")
    known = intervals_of(chunk, Limits.of(machine), STANDSTILL, STANDSTILL)
    slopes = np.abs(known.samples[:, :, 0]).max()
    assert slopes > 1000.0
    assert len(known.end) < 5000
    scale = np.full(len(chunk.axes), STEPS_PER_UNIT)
    for kind, at in zip(chunk.kind.tolist(), chunk.at.tolist(), strict=True):
        piece, window = Piece(kind, chunk.data, at, 0.0), new_window(len(scale))
        u, end = curve_range(kind, chunk.data, at)
        # An axis turns just behind the start of the piece: a window ends there.
        turn_at = u + 4e-6 * (end - u)
        width, count = end - u, 0
        begin_window(piece, u, window)
        while u < end:
            limit = turn_at if u < turn_at else end
            u, width, _ = next_window(piece, u, limit, width, scale, window)
            window, count = following(window), count + 1
            assert count < 500
