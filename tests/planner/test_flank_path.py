"""A published five-axis path: legal, and near the fastest motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.optimum import times_of
from cnc.api import Outputs, RunOptions, check
from tests.support.flank_path import LENGTH, flank_blocks, flank_machine, poses
from tests.support.planner.legality import compare_files
from tests.support.soak import share

COUNT = 401


@pytest.mark.parametrize("period", share((1e-3, 1e-4), (1e-3,)))
def test_the_published_path_is_legal(period: float, tmp_path: Path) -> None:
    places = poses(COUNT)
    words = [
        " ".join(f"{letter}{value:.7f}" for letter, value in zip("XYZAC", pose, strict=True))
        for pose in places
    ]
    program = tmp_path / "flank.ngc"
    program.write_text(
        f"G21 G90 G64 P0.005 F3000\nG43.1 Z{LENGTH}\nM428\nG0 {words[0]}\n"
        + "\n".join(f"G1 {each}" for each in words[1:])
        + "\nM2\n"
    )
    blocks, trace, pulses = (
        tmp_path / each for each in ("blocks.jsonl", "trace.npz", "pulses.npz")
    )
    outputs = Outputs(blocks=str(blocks), trace=str(trace), pulses=str(pulses))
    machine = flank_machine(period)
    report = check(program, machine, RunOptions(dialect="linuxcnc", outputs=outputs))
    assert report.ok, report.faults
    found = compare_files(blocks, trace, pulses, machine, report.duration_s)
    assert not found.wrong
    assert np.load(trace)["tool"].shape[1] == 5


@pytest.mark.skipif(not share(True, False), reason="the optimum takes many seconds")
@pytest.mark.parametrize(("count", "tolerance"), [(COUNT, 0.005), (201, 0.02)])
def test_the_published_path_is_near_the_fastest(count: int, tolerance: float) -> None:
    """The tolerances are larger than the distance of the chords from the curve."""
    start, blocks = flank_blocks(count, 50.0, tolerance)
    times = times_of(blocks, ("x", "y", "z", "a", "c"), flank_machine(), start=start)
    assert times.solved
    assert times.ours <= 1.02 * times.t3
