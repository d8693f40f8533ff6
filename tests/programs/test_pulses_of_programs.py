"""Programs as pulses: the grid moves of shipped and random programs against the plan."""

from pathlib import Path

import numpy as np
import pytest

from cnc.api import Outputs, RunOptions, check, load_machine, plan, start_position
from cnc.path.kernels.arclength import curve_inv_arclen
from cnc.path.kernels.curve import curve_eval
from cnc.planner.plan import PlanChunk
from tests.support.paths import ROOT
from tests.support.programs.random_programs import random_program
from tests.support.soak import share

PROGRAMS = sorted((ROOT / "programs").glob("*.nc"))
SHORT = [program for program in PROGRAMS if program.name != "finishing.nc"]
MACHINE = load_machine("default")
STEPS_PER_MM = MACHINE.steps_per_mm
ROUNDING = 1e-3
"""BLU that a nanosecond and the arc length's accuracy can make."""
NEAREST = 1e9 / MACHINE.board.max_step_rate
"""ns between two rows."""
FASTEST = max(axis.step_rate for axis in MACHINE.axes.values())
"""Steps a second."""


def place(chunk: PlanChunk, time: float) -> np.ndarray:
    """Return the planned position at a time, (axes,) mm."""
    t = time - chunk.t0
    k = min(
        max(int(np.searchsorted(chunk.phase_t, t, side="right")) - 1, 0), len(chunk.phase_j) - 1
    )
    dt = t - chunk.phase_t[k]
    s = chunk.phase_s[k] + dt * (
        chunk.phase_v[k] + dt * (chunk.phase_a[k] / 2 + dt * chunk.phase_j[k] / 6)
    )
    s = min(max(s, chunk.phase_s[0]), chunk.phase_s[-1])
    piece = min(
        max(int(np.searchsorted(chunk.piece_s, s, side="right")) - 1, 0), len(chunk.path) - 1
    )
    record = int(chunk.path.kind[piece]), chunk.path.data, int(chunk.path.at[piece])
    out = np.zeros((4, len(chunk.path.axes)))
    length = float(chunk.path.length[piece])
    curve_eval(
        *record, curve_inv_arclen(*record, min(max(s - chunk.piece_s[piece], 0.0), length)), out
    )
    return out[0]


def check_pulses(program: Path, tmp_path: Path, looked_at: int) -> None:
    target = tmp_path / "pulses.npz"
    report = check(program, MACHINE, RunOptions(outputs=Outputs(pulses=str(target))))
    report.raise_if_faulty()
    assert not any(report.violations.values())
    assert report.pulse_error_blu is not None
    assert report.pulse_error_blu <= 0.5 + 1e-6
    with np.load(target) as found:
        time, step, line, origin = (
            found[name] for name in ("time_ns", "step", "line", "origin_steps")
        )

    # Rows are grid moves in order, and none is empty.
    assert len(time) == report.pulse_rows
    assert (np.diff(time) >= 0).all()
    assert (np.abs(step) <= 1).all()
    assert step.any(axis=1).all()
    assert (time[-1:] <= report.duration_s * 1e9 + NEAREST + 1).all()
    assert ((line >= 1) & (line <= report.lines)).all()

    # The end is the grid point nearest to the programmed end.
    grid = origin + np.cumsum(step, axis=0, dtype=np.int64)
    end = np.array(list(report.end_position.values())) * STEPS_PER_MM
    assert np.abs(grid[-1] - end).max() <= 0.5 + 1e-6

    # No two rows are nearer than the board takes them, and no axis is stepped faster than its
    # velocity allows: of k steps the first and the last may be half a BLU early or late, as they
    # wait for the leading axis.
    assert (np.diff(time) >= NEAREST - 1).all()
    for axis, limits in enumerate(MACHINE.axes.values()):
        times, ways = time[step[:, axis] != 0], step[step[:, axis] != 0, axis]
        turned = np.concatenate(([0], np.cumsum(np.diff(ways) != 0)))
        for k in (2, 3, 5, 10, 100):
            took = (times[k:] - times[:-k])[turned[k:] == turned[:-k]]
            assert (took >= (k - 1) * 1e9 / limits.step_rate / 1.001 - NEAREST).all()

    # A share of the rows against the plan: half a BLU when a row is made, a BLU and a half just
    # before, and what it waits for the board.
    chunks = [item for item in plan(program, MACHINE) if isinstance(item, PlanChunk)]
    starts = np.array([chunk.t0 for chunk in chunks])
    before = np.vstack([origin, grid[:-1]])
    nearest = np.diff(time, prepend=-(10**9))
    for row in np.unique(np.linspace(0, len(time) - 1, looked_at).astype(int)):
        seconds = float(time[row]) * 1e-9
        chunk = chunks[max(int(np.searchsorted(starts, seconds, side="right")) - 1, 0)]
        exact = place(chunk, seconds) * STEPS_PER_MM
        waited = ROUNDING + (FASTEST * NEAREST * 1e-9 if nearest[row] <= NEAREST + 1 else 0.0)
        assert np.abs(grid[row] - exact).max() <= 0.5 + waited
        assert np.abs(before[row] - exact).max() <= 1.5 + waited


@pytest.mark.parametrize("program", share(PROGRAMS, SHORT[::2]), ids=lambda program: program.name)
def test_shipped_programs(program, tmp_path):
    check_pulses(program, tmp_path, share(20_000, 140))


@pytest.mark.parametrize("first", range(0, share(500, 150), 50))
def test_random_programs(first, tmp_path):
    for seed in range(first, first + share(50, 1)):
        program = tmp_path / f"seed-{seed}.nc"
        program.write_text(random_program(seed))
        check_pulses(program, tmp_path, share(500, 16))


def test_random_programs_have_every_kind_of_block():
    text = "".join(random_program(seed) for seed in range(50))
    for code in (
        "G0 ",
        "G1 ",
        "G2 ",
        "G3 ",
        "G17 ",
        "G18 ",
        "G19 ",
        "G06.2 ",
        "G61\n",
        "G61.1",
        "G64",
        "G4 ",
    ):
        assert code in text


def test_the_start_is_within_the_travel():
    x = MACHINE.axes["x"].model_copy(update={"travel": (20.0, 30.0)})
    machine = MACHINE.model_copy(update={"axes": {**MACHINE.axes, "x": x}})
    assert start_position(machine).tolist() == [20.0, 0.0, 0.0]
