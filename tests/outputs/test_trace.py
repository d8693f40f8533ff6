"""The trace as .npz and .csv: names, types, and every bit of the values."""

import numpy as np
import pytest

from cnc.machine.load import load_machine
from cnc.model.streams import SampleChunk
from cnc.report.trace import trace_writer

MACHINE = load_machine("paper-nurbs")
AXES = MACHINE.axis_names


def samples(first: int, count: int) -> SampleChunk:
    k = np.arange(first, first + count, dtype=np.float64)
    return SampleChunk(
        first,
        0.001,
        np.stack([k / 3, k / 7, k * 0], axis=1),
        k / 11,
        k / 13,
        k / 17,
        k / 19,
        k * 0,
        np.full(count, 4, np.int32),
    )


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_a_trace_keeps_every_bit(tmp_path, suffix):
    file = tmp_path / f"t{suffix}"
    writer = trace_writer(str(file), MACHINE)
    writer.write(samples(0, 5))
    writer.write(samples(5, 3))
    writer.close()
    k = np.arange(8.0)
    if suffix == ".npz":
        with np.load(file) as found:
            assert set(found) == {
                "t",
                "position",
                "s",
                "feed",
                "accel",
                "jerk",
                "line",
                "period",
                "axes",
            }
            assert found["period"] == MACHINE.path.period
            assert found["axes"].tolist() == list(AXES)
            assert found["line"].dtype == np.int32
            columns = [
                found["t"],
                *found["position"].T,
                found["s"],
                found["feed"],
                found["accel"],
                found["jerk"],
            ]
            assert all(column.dtype == np.float64 for column in columns)
    else:
        assert file.read_text().splitlines()[0] == "t,x,y,z,s,feed,accel,jerk,line"
        columns = list(np.loadtxt(file, delimiter=",", skiprows=1).T[:-1])
    for column, expected in zip(
        columns, (k * 0.001, k / 3, k / 7, k * 0, k / 11, k / 13, k / 17, k / 19), strict=True
    ):
        assert np.array_equal(column, expected)


def test_a_trace_without_motion_has_empty_arrays(tmp_path):
    trace_writer(str(tmp_path / "t.npz"), MACHINE).close()
    with np.load(tmp_path / "t.npz") as found:
        assert found["position"].shape == (0, 3)
        assert found["t"].shape == (0,)
