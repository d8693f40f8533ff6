"""Boards by name."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from cnc.boards import registry
from cnc.boards.file import FileBoard
from cnc.boards.loopback import Loopback
from cnc.boards.protocols import BoardTraits
from cnc.machine.models import Axis, Board, Machine
from cnc.model.diagnostics import UsageError


def machine(**board: object) -> Machine:
    axis = Axis(steps_per_mm=100.0, max_velocity=50.0, max_acceleration=100.0, max_jerk=1000.0)
    return Machine(axes={"x": axis, "z": axis}, board=Board.model_validate(board))


def test_built_in_boards_are_known() -> None:
    assert {"file", "loopback"} <= set(registry.board_names())
    assert list(registry.board_names()) == sorted(registry.board_names())
    assert registry.board_factory("loopback") is Loopback


def test_unknown_board_lists_the_known_ones() -> None:
    with pytest.raises(UsageError) as caught:
        registry.board_factory("loopbak")
    found = caught.value.diagnostic
    assert found.code == "unknown-board"
    assert "file, " in found.message
    assert "loopback" in found.message
    assert found.hint == "did you mean loopback?"
    assert caught.value.exit_code == 2


class Neither:
    traits = BoardTraits()
    takes = "words"


def test_boards_of_other_packages_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [
        EntryPoint("mine", "cnc.boards.loopback:Loopback", registry.GROUP),
        EntryPoint("bare", "collections:OrderedDict", registry.GROUP),
        EntryPoint("neither", f"{__name__}:Neither", registry.GROUP),
        EntryPoint("gone", "no_such_package.x:Y", registry.GROUP),
    ]
    monkeypatch.setattr(registry, "entry_points", lambda group: points)
    assert set(registry.board_names()) == {"bare", "gone", "mine", "neither", *registry.BUILT_IN}
    assert registry.board_factory("mine") is Loopback
    for name, reason in (("gone", "no_such_package"), ("bare", "traits"), ("neither", "words")):
        with pytest.raises(UsageError) as caught:
            registry.board_factory(name)
        assert caught.value.diagnostic.code == "board-not-loadable"
        assert reason in caught.value.diagnostic.message


def test_installed_packages_are_not_searched_for_a_built_in_board(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def search(group: str) -> list[EntryPoint]:
        raise AssertionError(group)

    monkeypatch.setattr(registry, "entry_points", search)
    for name in registry.BUILT_IN:
        registry.board_factory(name)


def test_drivers_are_imported_only_when_used() -> None:
    code = (
        "import sys; from cnc.boards import registry; registry.board_names(); "
        "print('cnc.boards.loopback' in sys.modules)"
    )
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout.strip()
        == "False"
    )


def test_loopback_from_a_machine() -> None:
    board = registry.open_board(machine(max_step_rate=100_000.0))
    assert isinstance(board, Loopback)
    assert board.axes == 2
    assert board.min_pulse_ns == pytest.approx(10_000)


def test_file_board_from_a_machine(tmp_path: Path) -> None:
    board = registry.open_board(machine(), kind="file", target=tmp_path / "p.npz")
    assert isinstance(board, FileBoard)
    board.start(np.zeros(2, dtype=np.int64))
    board.finish()
    assert (tmp_path / "p.npz").exists()
    other = registry.open_board(machine(kind="file", port=str(tmp_path / "q.npz")))
    assert isinstance(other, FileBoard)
    assert other.path == tmp_path / "q.npz"
    with pytest.raises(UsageError) as caught:
        registry.open_board(machine(kind="file"))
    assert caught.value.diagnostic.code == "no-target"
