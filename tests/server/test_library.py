"""History and summaries of the library: what is damaged is left out, what is cut off is told."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from cnc.server.library import Library, Run

DEEP = "[" * 3000 + "]" * 3000


@pytest.fixture
def library(tmp_path: Path) -> Library:
    return Library(tmp_path)


def history_file(library: Library) -> Path:
    return library.folder / ".cncrun" / "history.jsonl"


def outcomes(library: Library) -> list[tuple[str, str]]:
    return [(run["job"], run["outcome"]) for run in library.history()]


def test_a_run_is_in_the_history_from_its_beginning_on(library: Library) -> None:
    began = Run(job="a.nc", began=1.0)
    library.add_run(began, "")
    assert outcomes(library) == [("a.nc", "running")]
    library.add_run(began.model_copy(update={"outcome": "done", "seconds": 2.0}), "the log")
    assert outcomes(library) == [("a.nc", "done")]
    library.add_run(Run(job="b.nc", began=4.0), "")
    # A new process, after this one was killed.
    again = Library(library.folder)
    assert outcomes(again) == [("b.nc", "cut-off"), ("a.nc", "done")]
    again.add_run(Run(job="b.nc", began=9.0), "")
    assert outcomes(again) == [("b.nc", "running"), ("b.nc", "cut-off"), ("a.nc", "done")]
    assert [run["outcome"] for run in again.history(1, "b.nc")] == ["running"]


def test_damaged_lines_of_the_history_are_left_out(library: Library) -> None:
    good = Run(job="a.nc", began=1.0, outcome="done")
    library.add_run(good, "")
    whole = history_file(library).read_bytes()
    record = json.loads(whole)
    wrong = [
        json.dumps(record | change)
        for change in (
            {"began": float("nan")},
            {"seconds": float("inf")},
            {"line": 10**400},
            {"outcome": "fine"},
            {"job": None},
            {"findings": [{"code": 1}]},
        )
    ]
    lines = [*wrong, DEEP, "null", "{", "\0" * 50, ""]
    history_file(library).write_bytes("\n".join(lines).encode() + b"\n\xff\n" + whole[:20])
    assert library.history() == []
    # The next run begins a line of its own.
    library.add_run(good, "")
    assert outcomes(library) == [("a.nc", "done")]


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", DEEP, '{"program": 1}', "\0"])
def test_a_damaged_summary_is_none(library: Library, text: str) -> None:
    (library.folder / "a.nc").write_text("M2\n")
    library.own("a.nc", "check.json").write_text(text)
    assert library.summary("a.nc") is None


def test_files_that_are_no_jobs_are_named_with_the_reason(library: Library) -> None:
    for name in ("a.nc", "a.nc.checkpoint", "notes.pdf", "con.nc", "x" * 240 + ".nc", ".hidden.nc"):
        (library.folder / name).write_text("M2\n")
    os.close(os.open(bytes(library.folder) + b"/b\xff.nc", os.O_CREAT))
    (library.folder / "link.nc").symlink_to("a.nc")
    assert library.names() == ["a.nc"]
    found = {each["name"]: each["why"] for each in library.left_out()}
    assert len(found) == 5
    assert found["notes.pdf"].startswith("it ends in none of .nc")
    assert found["link.nc"] == "it is a link"
    assert found["con.nc"].endswith("the name of a device")
    assert json.dumps(list(found)).isascii()
    assert "".join(found).encode()
