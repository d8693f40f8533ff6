"""The comparison of two records, and the parts that a record leaves out."""

from __future__ import annotations

import copy
import json
import zipfile

import numpy as np
import pytest

from tests.golden.golden import PLACE, compare, file_hash, main, summary_of

RECORD = {
    "cases": {
        "a.nc": {
            "exit": 0,
            "messages": [],
            "summary": {
                "duration_s": 1.5,
                "errors": [{"code": "feed-unreachable", "line": 3, "column": 1}],
            },
            "files": {"pulses": "0f", "trace": "1e"},
        },
        "b.nc": {"exit": 1, "messages": ["b.nc:2:7: word-unused"], "summary": None, "files": {}},
    }
}


def changed(*path, value):
    """Return the record with another value at a place; None removes the place."""
    record = copy.deepcopy(RECORD)
    *keys, last = path
    place = record["cases"]
    for key in keys:
        place = place[key]
    if value is None:
        del place[last]
    else:
        place[last] = value
    return record


def test_equal_records_have_no_differences():
    assert compare(RECORD, copy.deepcopy(RECORD)) == []


@pytest.mark.parametrize(
    ("path", "value", "difference"),
    [
        (("a.nc", "files", "pulses"), "0e", 'a.nc: files.pulses: "0f" -> "0e"'),
        (("a.nc", "files", "trace"), None, 'a.nc: files.trace: "1e" -> absent'),
        (("a.nc", "files", "blocks"), "2d", 'a.nc: files.blocks: absent -> "2d"'),
        (
            ("a.nc", "summary", "duration_s"),
            1.5000000000000002,
            "a.nc: summary.duration_s: 1.5 -> 1.5000000000000002",
        ),
        (("a.nc", "summary", "errors", 0, "column"), 2, "a.nc: summary.errors[0].column: 1 -> 2"),
        (("a.nc", "exit"), False, "a.nc: exit: 0 -> false"),
        (("b.nc", "messages"), [], 'b.nc: messages: ["b.nc:2:7: word-unused"] -> []'),
        (("b.nc", "exit"), 2, "b.nc: exit: 1 -> 2"),
        (("b.nc",), None, "b.nc: only in the old record"),
        (("c.nc",), {}, "c.nc: only in the new record"),
    ],
)
def test_a_difference_names_the_case_and_the_artefact(path, value, difference):
    assert compare(RECORD, changed(*path, value=value)) == [difference]


def test_the_exit_code_says_whether_two_records_differ(tmp_path, capsys):
    old, new = tmp_path / "old.json", tmp_path / "new.json"
    old.write_text(json.dumps(RECORD))
    new.write_text(json.dumps(changed("b.nc", "exit", value=0)))
    assert main(["compare", str(old), str(old)]) == 0
    assert main(["compare", str(old), str(new)]) == 1
    assert capsys.readouterr().out.splitlines()[-2:] == ["b.nc: exit: 1 -> 0", "differences: 1"]


def test_a_summary_without_times_wording_and_folders():
    fault = {"message": "m", "hint": "h", "file": "/y/s.ngc", "line": 1}
    summary = {"program": "/x/p.nc", "timing": {"plan_s": 1}, "steps": {"x": 2}, "errors": [fault]}
    assert summary_of(json.dumps(summary)) == {
        "program": "p.nc",
        "steps": {"x": 2},
        "errors": [{"file": "s.ngc", "line": 1}],
    }
    several = json.dumps([summary, {"program": "q.nc", "lines": 2}])
    assert list(summary_of(several).values())[1] == {"program": "q.nc", "lines": 2}
    assert summary_of("") is None
    assert summary_of("not JSON") == "not JSON"


def test_the_hash_of_arrays_ignores_the_archive_but_nothing_else(tmp_path):
    arrays = {"time_ns": np.arange(5), "step": np.ones((2, 3), np.int8)}

    def hashed(**changes):
        file = tmp_path / "f.npz"
        np.savez(file, **{**arrays, **changes})
        return file_hash(file)

    same = hashed()
    np.savez_compressed(tmp_path / "other.npz", **dict(reversed(arrays.items())))
    with zipfile.ZipFile(tmp_path / "other.npz") as archive:
        assert archive.infolist()[0].compress_type == zipfile.ZIP_DEFLATED
    assert file_hash(tmp_path / "other.npz") == same
    different = {
        hashed(time_ns=np.arange(1, 6)),
        hashed(time_ns=np.arange(5, dtype=np.int32)),
        hashed(step=np.ones((3, 2), np.int8)),
        hashed(line=np.zeros(1)),
    }
    assert len(different) == 4 and same not in different


def test_the_hash_of_text_ignores_the_folder_alone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "b.jsonl"
    texts = (f"{tmp_path}/s.ngc", "s.ngc", "t.ngc")
    hashes = [file_hash(file) for text in texts if file.write_text(text)]
    assert hashes[0] == hashes[1] != hashes[2]


@pytest.mark.parametrize(
    ("text", "groups"),
    [
        (
            "dir/p.nc:2:7: word-unused: Q5 has no use\n  G1 Q5\n     ^~",
            ("dir/p.nc", "2", "7", "word-unused"),
        ),
        ("p.nc:2: soft-limit: outside", ("p.nc", "2", None, "soft-limit")),
        ("p.nc: no-such-file: not there", (None, None, None, "no-such-file")),
        ("no-such-file: not there", (None, None, None, "no-such-file")),
    ],
)
def test_a_message_is_its_place_and_code(text, groups):
    (found,) = PLACE.finditer(text)
    assert found.group("file", "line", "column", "code") == groups


def test_help_is_no_message():
    assert not list(PLACE.finditer("  help: give I and J"))
