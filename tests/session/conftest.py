"""Set-up that the tests of runs on a GRBL board share."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.session.position_runs import SQUARE


@pytest.fixture
def nothing_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No run before has left a record."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def square(tmp_path: Path) -> Path:
    """The program of :mod:`tests.support.session.position_runs`."""
    (tmp_path / "p.ngc").write_text(SQUARE)
    return tmp_path / "p.ngc"
