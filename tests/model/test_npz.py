"""The streaming archive: what numpy reads back, the same bytes each time, nothing left behind."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from cnc.model.npz import NpzWriter


def write(path: Path) -> None:
    with NpzWriter(path) as out:
        out.append("time_ns", np.arange(5, dtype=np.int64))
        out.append("step", np.ones((5, 3), dtype=np.int8))
        out.scalar("axes", ["x", "y", "z"])
        out.append("time_ns", np.arange(5, 7, dtype=np.int64))
        out.append("step", np.zeros((2, 3), dtype=np.int8)[:, ::-1])
        out.scalar("period", 1e-3)
        out.append("line", np.empty(0, dtype=np.int32))


def test_numpy_reads_the_archive(tmp_path: Path) -> None:
    write(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as data:
        assert data.files == ["time_ns", "step", "axes", "period", "line"]
        np.testing.assert_array_equal(data["time_ns"], np.arange(7))
        assert data["time_ns"].dtype == np.int64
        assert data["step"].dtype == np.int8
        assert data["step"].shape == (7, 3)
        assert data["step"].sum() == 15
        assert list(data["axes"]) == ["x", "y", "z"]
        assert float(data["period"]) == 1e-3
        assert data["line"].shape == (0,)
        assert data["line"].dtype == np.int32


def test_equal_data_give_equal_bytes(tmp_path: Path) -> None:
    write(tmp_path / "a.npz")
    write(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.npz", "b.npz"]


def test_failure_keeps_the_old_file(tmp_path: Path) -> None:
    write(tmp_path / "a.npz")
    before = (tmp_path / "a.npz").read_bytes()

    def fail() -> None:
        with NpzWriter(tmp_path / "a.npz") as out:
            out.append("t", np.zeros(3))
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert (tmp_path / "a.npz").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]


def test_missing_folder_fails_at_once(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="none"):
        NpzWriter(tmp_path / "none" / "a.npz")


@pytest.mark.parametrize("rows", [np.zeros((2, 2)), np.zeros(2, dtype=np.float32)])
def test_rows_must_match_earlier_rows(tmp_path: Path, rows: np.ndarray) -> None:
    with NpzWriter(tmp_path / "a.npz") as out:
        out.append("t", np.zeros(2))
        with pytest.raises(ValueError, match=r"^t: rows of"):
            out.append("t", rows)


def test_objects_and_second_scalars_are_refused(tmp_path: Path) -> None:
    with NpzWriter(tmp_path / "a.npz") as out:
        out.scalar("period", 1.0)
        with pytest.raises(ValueError, match="exists already"):
            out.scalar("period", 2.0)
        with pytest.raises(ValueError, match="written as a scalar"):
            out.append("period", np.zeros(1))
        with pytest.raises(ValueError, match="must be numbers or text"):
            out.append("t", np.array([None]))
        with pytest.raises(ValueError, match="must be numbers or text"):
            out.scalar("u", [object()])


def test_memory_does_not_grow_with_rows(tmp_path: Path) -> None:
    rows = np.zeros((65536, 4))
    with NpzWriter(tmp_path / "a.npz") as out:
        tracemalloc.start()
        for _ in range(16):
            out.append("q", rows)
        out.close()
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < 4 * rows.nbytes
    with np.load(tmp_path / "a.npz") as data:
        assert data["q"].shape == (16 * 65536, 4)
