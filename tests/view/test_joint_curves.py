"""Curves of the joints: bounded tables, and what they say of a motion."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.api import Outputs, RunOptions, check, load_machine
from cnc.view.collect import Collector, JointTable, Sizes
from tests.support.paths import ROOT
from tests.support.view.drawn import drawn

PROGRAM = ROOT / "programs" / "five-axis" / "cone.nc"


@given(st.integers(0, 2**32 - 1), st.integers(1, 300), st.sampled_from([4, 6, 50]))
def test_rows_contain_every_sample_and_its_differences(seed: int, count: int, most: int) -> None:
    random = np.random.default_rng(seed)
    period = 0.004
    position = np.cumsum(random.normal(size=(count, 2)), axis=0)
    table = JointTable(most, 2, period)
    for part in np.array_split(position, random.integers(1, 9)):
        table.add(part)
    curves = table.curves()
    assert len(curves.low) <= most
    assert curves.t[0] == 0.0
    assert curves.t[-1] >= (count - 1) * period
    assert np.allclose(np.diff(curves.t), curves.t[1])
    full = np.concatenate((position[:1], position[:1], position))
    speed = (full[1:] - full[:-1])[1:] / period
    accel = (full[2:] - 2.0 * full[1:-1] + full[:-2]) / period**2
    row = np.floor(np.arange(count) * period / curves.t[1] + 1e-6).astype(int)
    for k, values in enumerate((position, speed, accel)):
        for joint in range(2):
            for r in range(len(curves.low)):
                mine = values[row == r, joint]
                assert curves.low[r, k, joint] == pytest.approx(mine.min(), abs=1e-7)
                assert curves.high[r, k, joint] == pytest.approx(mine.max(), abs=1e-7)


@pytest.mark.parametrize("rows", [64, 1 << 14])
def test_the_curves_are_those_of_the_trace(rows: int, tmp_path) -> None:
    machine = load_machine("trunnion")
    trace = tmp_path / "trace.npz"
    report = check(PROGRAM, machine, RunOptions(outputs=Outputs(trace=str(trace))))
    assert report.ok
    found = np.load(trace)
    sizes = Sizes(strokes=1 << 12, curves=1 << 12, origins=1 << 12, joints=rows)
    curves = drawn(PROGRAM, "trunnion", sizes).picture.joints
    assert curves is not None
    assert len(curves.low) <= rows
    position = found["position"]
    inside = np.clip(np.searchsorted(curves.t, found["t"] + 1e-9) - 1, 0, len(curves.low) - 1)
    assert (curves.low[inside, 0] <= position + 1e-9).all()
    assert (position <= curves.high[inside, 0] + 1e-9).all()
    reached = np.abs(np.stack((curves.low, curves.high))).max(axis=(0, 1))
    for joint, letter in enumerate(("x", "y", "z", "a", "c")):
        limits = machine.axes[letter]
        largest = report.largest.axes[letter]
        assert reached[1, joint] == pytest.approx(largest["velocity"], rel=5e-3)
        assert reached[1, joint] <= 1.001 * limits.max_velocity
        assert reached[2, joint] <= 1.001 * limits.max_acceleration


def test_a_machine_whose_joints_are_its_axes_has_none() -> None:
    machine = load_machine(None)
    sizes = Sizes(strokes=64, curves=64, origins=64, joints=64)
    assert Collector(machine, sizes, "p.nc", np.zeros(3)).picture().joints is None
