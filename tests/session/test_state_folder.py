"""The folder in which runs keep the last positions of boards."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.model import state_file


def test_the_folder_of_positions(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert state_file.folder() == tmp_path / "cnc" / "positions"
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "me"))
    monkeypatch.setattr(state_file.sys, "platform", "linux")
    assert state_file.folder() == tmp_path / "me" / ".local" / "state" / "cnc" / "positions"
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "local"))
    monkeypatch.setattr(state_file.sys, "platform", "win32")
    assert state_file.folder() == tmp_path / "local" / "cnc" / "positions"
