"""Random programs under tool-tip control: the limits of every joint, and the path of the tip."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.api import Outputs, RunOptions, check
from tests.support.five_axis import TYPES, five_axis_machine, table_of, tip_of
from tests.support.planner.legality import compare_files
from tests.support.planner.random_jobs import TOOL_LENGTH, Job, with_angles
from tests.support.soak import share


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
    tip = tip_of(kind, rows["position"], np.array([0.0, 0.0, TOOL_LENGTH]))
    # an error of 1e-6 degrees moves the tip by less than 1e-5 mm on these machines
    assert np.abs(tip - rows["tool"][:, :3]).max() < 2e-5, (fresh, seed)
    assert report.pulse_error_blu <= 0.5 + 1e-6
