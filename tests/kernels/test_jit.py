"""Removal of compiled code of earlier texts."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from cnc.kernels import jit

HOUR = 3600.0
Place = Callable[[str, float], Path]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Place:
    """Return a function that makes a folder of compiled code, last written some seconds ago.

    The kernels are one file, ``path/curve.py``.
    """
    sources, cache = tmp_path / "kernels", tmp_path / "compiled"
    (sources / "path").mkdir(parents=True)
    (sources / "path" / "curve.py").write_text("one")
    monkeypatch.setattr(jit, "_SOURCES", sources)
    monkeypatch.setattr(jit, "_cache_folder", cache)
    monkeypatch.setattr(jit, "_is_ours", True)

    def make(name: str, age: float) -> Path:
        folder = cache / name
        (folder / "inner").mkdir(parents=True)
        code = folder / "inner" / "code.nbc"
        code.touch()
        then = time.time() - age
        for path in (code, code.parent, folder):
            os.utime(path, (then, then))
        return folder

    return make


def remove() -> None:
    jit._remove_old_code.__wrapped__()


def test_code_of_an_earlier_text_is_removed(place: Place, tmp_path: Path) -> None:
    current = place(jit._folder_of(tmp_path / "kernels" / "path" / "curve.py").name, 2 * HOUR)
    earlier = place(f"path.curve-{jit._TAG}-0123456789abcdef", 2 * HOUR)
    renamed = place(f"path.bend-{jit._TAG}-0123456789abcdef", 2 * HOUR)
    without_tag = place("curve-0123456789abcdef", 2 * HOUR)
    remove()
    assert current.exists()
    assert not earlier.exists()
    assert not renamed.exists()
    assert not without_tag.exists()


def test_code_that_another_process_may_use_stays(place: Place) -> None:
    recent = place(f"path.curve-{jit._TAG}-0123456789abcdef", 0.5 * HOUR)
    other_python = place("path.curve-cpython-399-0123456789abcdef", 2 * HOUR)
    # The folder is old, but code was written into it just now.
    in_use = place(f"path.curve-{jit._TAG}-fedcba9876543210", 2 * HOUR)
    (in_use / "inner" / "more.nbc").touch()
    remove()
    assert recent.exists()
    assert other_python.exists()
    assert in_use.exists()


def test_nothing_is_removed_from_a_folder_that_the_user_has_named(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    earlier = place(f"path.curve-{jit._TAG}-0123456789abcdef", 2 * HOUR)
    monkeypatch.setattr(jit, "_is_ours", False)
    remove()
    assert earlier.exists()


def test_two_processes_may_remove_at_once(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    folders = [place(f"path.curve-{jit._TAG}-{k:016x}", 2 * HOUR) for k in range(3)]
    last_written = jit._last_written

    def after_the_other(folder: Path) -> float:
        """Remove the folder between the decision and the removal, and another before its turn."""
        found = last_written(folder)
        for each in folders[:2]:
            shutil.rmtree(each, ignore_errors=True)
        return found

    monkeypatch.setattr(jit, "_last_written", after_the_other)
    remove()
    assert not any(folder.exists() for folder in folders)
