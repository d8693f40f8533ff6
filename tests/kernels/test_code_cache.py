"""Removal of compiled code of earlier texts."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from cnc.compiled import code_cache

HOUR = 3600.0
Place = Callable[[str, float], Path]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Place:
    """Return a function that makes a folder of compiled code, last written some seconds ago.

    The kernels are one file, ``path/kernels/curve.py``.
    """
    sources, cache = tmp_path / "sources", tmp_path / "compiled"
    (sources / "path" / "kernels").mkdir(parents=True)
    (sources / "path" / "kernels" / "curve.py").write_text("one")
    monkeypatch.setattr(code_cache, "_SOURCES", sources)
    monkeypatch.setattr(code_cache, "cache_folder", lambda: cache)
    monkeypatch.setattr(code_cache, "_is_ours", True)

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
    code_cache._remove_old_code.__wrapped__()


def test_code_of_an_earlier_text_is_removed(place: Place, tmp_path: Path) -> None:
    current = place(
        code_cache.folder_name(tmp_path / "sources" / "path" / "kernels" / "curve.py"), 2 * HOUR
    )
    earlier = place(f"path.kernels.curve-{code_cache._TAG}-0123456789abcdef", 2 * HOUR)
    renamed = place(f"path.kernels.bend-{code_cache._TAG}-0123456789abcdef", 2 * HOUR)
    without_tag = place("curve-0123456789abcdef", 2 * HOUR)
    remove()
    assert current.exists()
    assert not earlier.exists()
    assert not renamed.exists()
    assert not without_tag.exists()


@pytest.mark.parametrize(
    ("home", "named", "found"),
    [
        ("home", None, "home/.cache/cnc/compiled"),
        ("missing", None, "temporary"),
        ("missing", "caches", "caches/cnc/compiled"),
    ],
)
def test_the_cache_of_an_installation_that_is_read_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, home: str, named: str | None, found: str
) -> None:
    (tmp_path / "home").mkdir()
    (tmp_path / "temporary").mkdir()
    (tmp_path / "installed").mkdir()
    (tmp_path / "installed" / "__pycache__").touch()
    monkeypatch.setattr(code_cache, "_HERE", tmp_path / "installed")
    monkeypatch.setattr(code_cache, "_is_ours", True)
    monkeypatch.setattr(code_cache.tempfile, "tempdir", str(tmp_path / "temporary"))
    monkeypatch.setenv("HOME", str(tmp_path / home))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    if named:
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / named))
    folder = code_cache.cache_folder.__wrapped__()
    assert folder.is_relative_to(tmp_path / found)
    assert not (tmp_path / "missing").exists()


def test_code_that_another_process_may_use_stays(place: Place) -> None:
    recent = place(f"path.kernels.curve-{code_cache._TAG}-0123456789abcdef", 0.5 * HOUR)
    other_python = place("path.kernels.curve-cpython-399-0123456789abcdef", 2 * HOUR)
    # The folder is old, but code was written into it just now.
    in_use = place(f"path.kernels.curve-{code_cache._TAG}-fedcba9876543210", 2 * HOUR)
    (in_use / "inner" / "more.nbc").touch()
    remove()
    assert recent.exists()
    assert other_python.exists()
    assert in_use.exists()


def test_nothing_is_removed_from_a_folder_that_the_user_has_named(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    earlier = place(f"path.kernels.curve-{code_cache._TAG}-0123456789abcdef", 2 * HOUR)
    monkeypatch.setattr(code_cache, "_is_ours", False)
    remove()
    assert earlier.exists()


def test_two_processes_may_remove_at_once(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    folders = [place(f"path.kernels.curve-{code_cache._TAG}-{k:016x}", 2 * HOUR) for k in range(3)]
    last_written = code_cache._last_written

    def after_the_other(folder: Path) -> float:
        """Remove the folder between the decision and the removal, and another before its turn."""
        found = last_written(folder)
        for each in folders[:2]:
            shutil.rmtree(each, ignore_errors=True)
        return found

    monkeypatch.setattr(code_cache, "_last_written", after_the_other)
    remove()
    assert not any(folder.exists() for folder in folders)


def test_compiled_code_depends_on_the_file_and_its_imports(tmp_path, monkeypatch):
    # A called kernel may change without a change of the file of its caller.
    texts = {
        "caller.py": "from cnc.deep.callee import f",
        "deep/callee.py": "one",
        "other.py": "other",
    }

    def folders(changed):
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        for name, text in {**texts, **changed}.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text)
        monkeypatch.setattr(code_cache, "_SOURCES", folder)
        return [code_cache.folder_name(folder / name) for name in texts]

    caller, callee, other = folders({})
    assert len({caller, callee, other}) == 3
    assert folders({}) == [caller, callee, other]
    changed = folders({"deep/callee.py": "two"})
    assert changed[0] != caller
    assert changed[1] != callee
    assert changed[2] == other
