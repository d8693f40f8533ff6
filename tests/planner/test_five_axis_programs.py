"""Random programs under tool-tip control: the limits of every joint, and the path of the tip."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from cnc.api import Outputs, RunOptions, check
from tests.support.five_axis import TYPES, five_axis_machine, table_of, tip_of
from tests.support.planner.legality import compare_files
from tests.support.planner.random_jobs import Job
from tests.support.soak import share

LENGTH = 80.0
_MOVE = re.compile(r"G[0-3] X")


def with_angles(program: str, tilt: str, rng: np.random.Generator) -> str:
    """Return a program under tool-tip control with angles in most of its moves."""
    lines = ["G21 G90", f"G43.1 Z{LENGTH}", "M428", "G0 X0 Y0 Z0"]
    angles, turning = np.zeros(2), rng.normal(0.0, 1.0, 2)
    largest = 10 ** rng.uniform(-1.0, 1.5)
    smooth = rng.random() < 0.6
    before = ""
    for line in program.split("\n"):
        place = " ".join(re.findall(r"[XYZ]\S+", line))
        # Without a move of the tip the length of the path would be in degrees.
        before, moves = place or before, place != before
        if _MOVE.match(line) and moves and rng.random() < 0.85:
            turning = 0.9 * turning + 0.3 * rng.normal(0.0, 1.0, 2)
            step = turning if smooth else rng.normal(0.0, 1.0, 2)
            angles = np.clip(angles + 0.3 * largest * step, -120.0, 120.0).round(4)
            line += f" {tilt}{angles[0]:.4f} C{angles[1]:.4f}"
        lines.append(line)
    return "\n".join(lines)


@pytest.mark.parametrize("seed", range(share(60, 1)))
@pytest.mark.parametrize("kind", share(TYPES, ("xyzac", "xyzbc-head", "xyzac-head-table")))
def test_random_programs_keep_the_limits_of_every_joint(
    kind: str, seed: int, tmp_path: Path
) -> None:
    """The message has the seed, which is a new one in each run of ``make soak``."""
    fresh = share(int(np.random.default_rng().integers(2**32)), 1)
    rng = np.random.default_rng([fresh, seed])
    period = float(rng.choice(share((1e-3, 1e-4), (1e-3,))))
    machine = five_axis_machine(kind, rng, period=period)
    program = tmp_path / "part.ngc"
    program.write_text(
        with_angles(Job(rng, share(8.0, 2.0)).write(), table_of(kind).tilting.upper(), rng)
    )
    blocks, trace, pulses = (
        tmp_path / each for each in ("blocks.jsonl", "trace.npz", "pulses.npz")
    )
    outputs = Outputs(blocks=str(blocks), trace=str(trace), pulses=str(pulses))
    report = check(program, machine, RunOptions(outputs=outputs))
    assert report.ok, (fresh, seed, [fault.diagnostic.message for fault in report.faults])
    found = compare_files(blocks, trace, pulses, machine, report.duration_s)
    assert not found.wrong, (fresh, seed, found.wrong)
    rows = np.load(trace)
    tip = tip_of(kind, rows["position"], np.array([0.0, 0.0, LENGTH]))
    # an error of 1e-6 degrees moves the tip by less than 1e-5 mm on these machines
    assert np.abs(tip - rows["tool"][:, :3]).max() < 2e-5, (fresh, seed)
    assert report.pulse_error_blu <= 0.5 + 1e-6
