"""Programs that are held, resumed and overridden while they run have legal traces."""

from pathlib import Path

import numpy as np
import pytest

from cnc.api import Callbacks, Control, Outputs, Report, RunOptions, run
from cnc.machine.models import Machine
from cnc.session.run_pulses import Progress
from tests.support.planner.legality import Findings, compare_files
from tests.support.planner.random_jobs import random_job
from tests.support.soak import share

HOLD = 0.0
FACTORS = (HOLD, HOLD, 0.01, 0.1, 0.3, 0.7, 1.0, 1.5, 2.0)


def scheduled(
    program: Path, machine: Machine, requests: list[tuple[float, float]], folder: Path
) -> tuple[Report, Findings, int]:
    """Run with requests (machine time, factor of the feed).

    Returns the report, the findings of the check of its files, and the number of holds.
    """
    control, left, holds = Control(), list(requests), 0
    since, factors = [0.0], [1.0]

    def on_sent(sent: Progress) -> None:
        nonlocal holds
        if sent.held:
            holds += 1
            control.resume()
            return
        while left and sent.time >= left[0][0]:
            factor = left.pop(0)[1]
            if factor == HOLD:
                control.hold()
            else:
                control.override(100.0 * factor)
                since.append(sent.time)
                factors.append(factor)

    files = {
        name: str(folder / f"{name}.{'jsonl' if name == 'blocks' else 'npz'}")
        for name in ("blocks", "trace", "pulses")
    }
    report = run(
        program,
        machine,
        RunOptions(outputs=Outputs(**files)),
        control=control,
        callbacks=Callbacks(on_sent=on_sent),
    )
    report.raise_if_faulty()
    override = (np.array(since), np.array(factors))
    return (
        report,
        compare_files(
            *(Path(file) for file in files.values()), machine, report.duration_s, override
        ),
        holds,
    )


@pytest.mark.parametrize(
    "seeds",
    [
        (63, 81, 159, 190)[:: share(1, 4)],
        *(range(first, first + share(20, 3)) for first in range(0, share(500, 20), 20)),
    ],
)
def test_random_programs_under_random_schedules_are_legal(seeds, tmp_path):
    held = 0
    for seed in seeds:
        text, machine = random_job(seed)
        program = tmp_path / "program.nc"
        program.write_text(text)
        plain = run(program, machine)
        rng = np.random.default_rng(seed)
        times = np.sort(rng.uniform(0.0, 1.2 * plain.duration_s, 6))
        requests = [(time, float(rng.choice(FACTORS))) for time in times.tolist()]
        report, found, holds = scheduled(program, machine, requests, tmp_path)
        assert not found.wrong, (seed, requests)
        assert report.end_position == plain.end_position
        # Where a ramp may run past a corner by less than the tolerance, a step there and back is
        # one more or less.
        if "G64" not in text.replace("G64 P0\n", ""):
            assert report.steps == plain.steps, (seed, requests)
        held += holds
    assert held > 0
