"""Files that are kept between runs: a damaged one is told and set aside, and never used."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cnc import check, load_machine
from cnc.boards.klipper.position import PositionStore, StoredPosition
from cnc.model import state_file
from cnc.model.diagnostics import Diagnostic
from cnc.session.checkpoint import Checkpoint
from cnc.session.position_check import read_offsets, write_offsets

Read = Callable[[], tuple[Any, list[Diagnostic]]]
DEEP = "[" * 3000 + "]" * 3000
LONG = "9" * 400


@pytest.fixture(autouse=True)
def own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


def offsets(_: Path) -> tuple[Path, Read, dict[str, Any], list[str]]:
    write_offsets("a board", {"G54": {"x": 1.5, "y": -2.0}})
    (file,) = state_file.folder().iterdir()
    good = json.loads(file.read_text())
    wrong = [
        '{"G54": {"q": 1.0}}',
        f'{{"G54": {{"x": {LONG}}}}}',
        '{"G54": {"x": Infinity}}',
        '{"G54": {"x": "1"}}',
        '{"G54": [1, 2]}',
        f'{{"G54": {{"x": {DEEP}}}}}',
    ]
    return file, lambda: read_offsets("a board"), good, wrong


def klipper(_: Path) -> tuple[Path, Read, dict[str, Any], list[str]]:
    store = PositionStore("a board")
    store.write(
        StoredPosition(layout=7, number=8, offset=[9, -10], known=[True, False], moving=False)
    )
    (file,) = state_file.folder().iterdir()
    good = json.loads(file.read_text())
    changes: list[tuple[str, str]] = [
        ('"layout":7', f'"layout":{LONG}'),
        ('"layout":7', '"layout":-1'),
        ('"number":8', '"number":8.5'),
        ("9,-10", f"9,{LONG}"),
        ("9,-10", "9,NaN"),
        ("9,-10", DEEP),
        ("true,false", '"true",false'),
        ('"moving":false', '"moving":0'),
        (',"moving":false', ""),
        ('"layout"', '"extra":1,"layout"'),
    ]
    text = file.read_text()
    wrong = [text.replace(old, new) for old, new in changes]
    assert text not in wrong
    return file, store.read, good, wrong


def checkpoint(folder: Path) -> tuple[Path, Read, dict[str, Any], list[str]]:
    program = str(folder / "p.nc")
    good = Checkpoint(program=program, sha256="0", machine="m", board="b", line=3).model_dump()
    file = Path(program + ".checkpoint")
    file.write_text(json.dumps(good))
    wrong = [
        json.dumps(good | {"line": int(LONG)}),
        json.dumps(good | {"position": {"x": float("inf")}}),
        json.dumps(good).replace('"position": null', f'"position": {DEEP}'),
    ]
    return file, lambda: Checkpoint.read(program), good, wrong


KINDS = [offsets, klipper, checkpoint]


def content(found: Any) -> Any:
    return found if isinstance(found, dict) else found.model_dump()


@pytest.mark.parametrize("kind", KINDS)
def test_a_whole_file_is_read_and_a_missing_one_is_no_fault(kind: Any, tmp_path: Path) -> None:
    file, read, good, _ = kind(tmp_path)
    found, warnings = read()
    assert (content(found), warnings) == (good, [])
    file.unlink()
    assert read() == (None, [])


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_is_told_and_set_aside(kind: Any, tmp_path: Path) -> None:
    file, read, _, wrong = kind(tmp_path)
    whole = file.read_bytes()
    cut = [whole[:n] for n in range(len(whole))]
    for data in (*cut, *(text.encode() for text in wrong), b"[]", b"null", b"\0" * 100, b"\xff"):
        file.write_bytes(data)
        found, (warning,) = read()
        assert found is None
        assert (warning.code, warning.severity) == ("state-file-damaged", "warning")
        assert warning.file == str(file)
        assert warning.hint
        assert file.with_name(f"{file.name}.damaged").read_bytes() == data
        assert read() == (None, [])


@pytest.mark.skipif(os.name == "nt", reason="Windows has no pipes in folders")
@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir], ids=["pipe", "folder"])
@pytest.mark.parametrize("kind", KINDS)
def test_something_else_in_its_place_is_told(
    kind: Any, make: Callable[[Path], None], tmp_path: Path
) -> None:
    file, read, *_ = kind(tmp_path)
    file.unlink()
    make(file)
    found, (warning,) = read()
    assert found is None
    assert "no regular file" in warning.message
    assert read() == (None, [])


def test_a_check_tells_of_damaged_offsets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = tmp_path / "m.toml"
    text = Path(load_machine("grbl-uno").file).read_text()
    port = "/dev/serial/by-id/usb-none"
    machine.write_text(text.replace('kind = "grbl"', f'kind = "grbl"\nport = "{port}"', 1))
    assert port in machine.read_text()
    monkeypatch.setattr("cnc.session.required_capabilities.identity", lambda port: "a board")
    write_offsets("a board", {"G54": {"x": 1.0}})
    (file,) = state_file.folder().iterdir()
    file.write_text('{"G54": {"x": Infinity}}')
    program = tmp_path / "p.nc"
    program.write_text("G21 G90\nG0 X1\nM2\n")
    report = check(program, machine)
    assert "state-file-damaged" in [each.code for each in report.warnings]
    assert not report.offset or not report.offset.kept
