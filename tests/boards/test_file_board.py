"""The file board: the conformance suite, and what numpy reads back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.boards.file import FileBoard
from cnc.model.blocks import Coolant
from cnc.model.diagnostics import UsageError
from tests.support.boards.board_conformance import AXES, MIN_PULSE_NS, PulseBoardConformance, chunk

NAMES = ("x", "y", "z")


class TestFileBoard(PulseBoardConformance):
    revives = False

    def make(self, folder: Path) -> FileBoard:
        return FileBoard(folder / "pulses.npz", NAMES, [100.0] * AXES, MIN_PULSE_NS)


def record(path: Path, ending: str) -> None:
    board = FileBoard(path, NAMES, [100.0, 200.0, 400.0])
    board.start(np.array([1, 2, 3]))
    board.send(chunk((0, (1, 0, 0)), (5, (0, 1, -1))))
    board.execute(Coolant("p.nc", 9, mist=True, flood=False), 8)
    board.send(chunk((10, (1, 0, 0)), line=10))
    getattr(board, ending)()


@pytest.mark.parametrize("ending", ["finish", "stop"])
def test_archive_contains_the_pulses_and_commands(tmp_path: Path, ending: str) -> None:
    record(tmp_path / "p.npz", ending)
    with np.load(tmp_path / "p.npz", allow_pickle=False) as data:
        assert data["time_ns"].tolist() == [0, 5, 10]
        assert data["time_ns"].dtype == np.int64
        assert data["step"].tolist() == [[1, 0, 0], [0, 1, -1], [1, 0, 0]]
        assert data["step"].dtype == np.int8
        assert data["line"].tolist() == [1, 2, 10]
        assert data["line"].dtype == np.int32
        assert data["axes"].tolist() == list(NAMES)
        assert data["steps_per_mm"].tolist() == [100.0, 200.0, 400.0]
        assert data["origin_steps"].tolist() == [1, 2, 3]
        assert data["command_ns"].tolist() == [8]
        assert data["command_line"].tolist() == [9]
        assert data["command"].tolist() == ["coolant"]


@pytest.mark.parametrize("ending", ["abort", "close"])
def test_abort_leaves_no_file(tmp_path: Path, ending: str) -> None:
    record(tmp_path / "p.npz", ending)
    assert list(tmp_path.iterdir()) == []


def test_empty_program_has_all_arrays(tmp_path: Path) -> None:
    board = FileBoard(tmp_path / "p.npz", NAMES, [100.0] * AXES)
    board.start(np.zeros(AXES, dtype=np.int64))
    board.finish()
    with np.load(tmp_path / "p.npz", allow_pickle=False) as data:
        assert data["step"].shape == (0, AXES)
        assert data["command"].shape == (0,)


def test_missing_folder_is_reported(tmp_path: Path) -> None:
    board = FileBoard(tmp_path / "none" / "p.npz", NAMES, [100.0] * AXES)
    with pytest.raises(UsageError) as caught:
        board.start(np.zeros(AXES, dtype=np.int64))
    assert caught.value.diagnostic.code == "can-not-write"
