"""Targets of output: whole files or none, devices, permissions and suffixes."""

import os
from pathlib import Path

import pytest

from cnc.model.diagnostics import UsageError
from cnc.report.targets import NpzTarget, TextTarget, check_suffixes


@pytest.mark.parametrize(
    ("trace", "pulses"), [("t.txt", None), ("trace", None), (None, "p.csv"), (None, "p")]
)
def test_an_unknown_suffix_is_refused(trace, pulses):
    with pytest.raises(UsageError, match="output-format"):
        check_suffixes(trace, pulses, None)


@pytest.mark.parametrize("target", [TextTarget, NpzTarget])
def test_a_file_is_replaced_as_a_whole_or_not_at_all(tmp_path, target):
    file = tmp_path / "f.npz"
    file.write_text("old")
    one = target(str(file))
    one.discard()
    assert file.read_text() == "old"
    other = target(str(file))
    assert file.read_text() == "old"
    other.close()
    other.discard()
    assert file.read_bytes() != b"old"
    assert os.listdir(tmp_path) == ["f.npz"]


def test_a_text_file_has_the_usual_permissions(tmp_path):
    target = TextTarget(str(tmp_path / "f"))
    target.close()
    (tmp_path / "g").touch()
    assert (tmp_path / "f").stat().st_mode == (tmp_path / "g").stat().st_mode


@pytest.mark.parametrize("target", [TextTarget, NpzTarget])
@pytest.mark.parametrize("name", ["no/such/folder.npz", "."])
def test_an_unwritable_file_is_refused_at_once(tmp_path, monkeypatch, target, name):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match="can-not-write"):
        target(name)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_is_a_usage_error():
    target = TextTarget("/dev/full")
    with pytest.raises(UsageError, match="can-not-write"):
        target.write("x" * 10_000_000)
    target.discard()


@pytest.mark.skipif(not Path("/dev/null").exists(), reason="no /dev/null here")
@pytest.mark.parametrize("target", [TextTarget, NpzTarget])
def test_a_device_is_not_replaced(target):
    one = target("/dev/null")
    one.close()
    assert not Path("/dev/null").is_file()
