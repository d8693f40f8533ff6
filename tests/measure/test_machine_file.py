"""Changed keys in machine files: the rest stays, and what cannot be changed is told."""

import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.machine.load import load_machine, shipped_machines
from cnc.measure.machine_file import changed_text, write
from cnc.model.diagnostics import MachineFileError, UsageError

TEXT = """\
# my mill
[machine]
name = "Mill"  # the small one

[axes.x]
steps_per_mm = 400.0
max_velocity = 50.0 # slow
max_acceleration = 500.0
max_jerk = 5000.0
backlash = 0.1  # guessed

# below
[axes.y]
steps_per_mm = 400.0
max_velocity = 50.0
max_acceleration = 500.0
max_jerk = 5000.0
"""
REMARK = "measured 2026-11-30"


def test_a_key_is_replaced_added_and_taken_away_with_a_remark():
    new = changed_text(TEXT, {("axes", "x", "backlash"): 0.043}, REMARK)
    assert new == TEXT.replace("backlash = 0.1  # guessed", f"backlash = 0.043  # {REMARK}")
    new = changed_text(TEXT, {("axes", "x", "backlash"): None}, REMARK)
    assert new == TEXT.replace("backlash = 0.1  # guessed\n", "")
    new = changed_text(TEXT, {("axes", "y", "backlash"): 0.02}, REMARK)
    assert new == f"{TEXT}backlash = 0.02  # {REMARK}\n"
    new = changed_text(TEXT, {("axes", "x", "error_table"): "x.csv"}, REMARK)
    assert f'backlash = 0.1  # guessed\nerror_table = "x.csv"  # {REMARK}\n\n# below' in new


def test_the_ends_of_lines_stay():
    changes = {("axes", "x", "backlash"): 0.043, ("axes", "y", "backlash"): 0.02}
    new = changed_text(TEXT.replace("\n", "\r\n"), changes, REMARK)
    assert new == changed_text(TEXT, changes, REMARK).replace("\n", "\r\n")


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("", {"xy": "0.0200 deg"}),
        ('squareness = {xz = "0.1 deg"}\n', {"xz": "0.1 deg", "xy": "0.0200 deg"}),
        ('squareness = {xy = "0.1 mm/m"}  # old\n', {"xy": "0.0200 deg"}),
        ('[machine.squareness]\nxz = "0.1 deg"\n', {"xz": "0.1 deg", "xy": "0.0200 deg"}),
    ],
)
def test_an_angle_joins_the_others_however_they_are_written(before, after):
    text = TEXT.replace("# the small one\n", f"# the small one\n{before}")
    new = changed_text(text, {("machine", "squareness", "xy"): "0.0200 deg"}, REMARK)
    assert tomllib.loads(new)["machine"]["squareness"] == after
    assert REMARK in new


@pytest.mark.parametrize(
    "text",
    [
        TEXT.replace("[axes.x]", "[axes]\nx.backlash = 0.2\n[axes.z]"),
        TEXT.replace("backlash = 0.1  # guessed", "note = '''\n[axes.y]\n'''"),
        "axes = {x = {steps_per_mm = 1.0}}\n",
    ],
)
def test_a_form_that_is_not_changed_here_is_told_with_the_lines_to_write(text):
    changes = {("axes", "x", "backlash"): 0.05, ("axes", "y", "backlash"): 0.06}
    with pytest.raises(UsageError) as refused:
        changed_text(text, changes, REMARK)
    finding = refused.value.diagnostic
    assert finding.code == "machine-file-form"
    assert "backlash = 0.05 in [axes.x]" in finding.hint


@given(
    name=st.sampled_from(sorted(shipped_machines())),
    letter=st.sampled_from("xyz"),
    value=st.floats(0.001, 0.5),
)
def test_shipped_machine_files_change_in_this_key_alone(name, letter, value):
    text = shipped_machines()[name].read_text(encoding="utf-8")
    before = tomllib.loads(text)
    if letter not in before["axes"]:
        return
    after = tomllib.loads(changed_text(text, {("axes", letter, "backlash"): value}, REMARK))
    assert after["axes"][letter].pop("backlash") == value
    assert after == before


def test_a_file_that_would_be_wrong_is_not_written(tmp_path):
    file = tmp_path / "mill.toml"
    file.write_text(TEXT, encoding="utf-8")
    with pytest.raises(MachineFileError):
        write(file, TEXT.replace("backlash = 0.1", "backlash = -0.1"))
    assert file.read_text(encoding="utf-8") == TEXT
    assert list(tmp_path.iterdir()) == [file]
    write(file, changed_text(TEXT, {("axes", "x", "backlash"): 0.043}, REMARK))
    assert load_machine(Path(file)).axes["x"].backlash == 0.043
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize("old", [None, "position,error\n0,0\n1,0\n"])
def test_the_table_of_a_file_that_is_not_written_is_as_before(old, tmp_path):
    file, table = tmp_path / "mill.toml", tmp_path / "x.csv"
    text = TEXT.replace("backlash = 0.1  # guessed", "travel = [0.0, 100.0]")
    file.write_text(text, encoding="utf-8")
    if old is not None:
        table.write_text(old, encoding="utf-8")
    new = changed_text(text, {("axes", "x", "error_table"): "x.csv"}, REMARK)
    with pytest.raises(MachineFileError, match=r"mill\.toml"):
        write(file, new, {table: "position,error\n0,0\n"})
    assert file.read_text(encoding="utf-8") == text
    assert (table.read_text(encoding="utf-8") if table.exists() else None) == old
    write(file, new, {table: "position,error\n0,0\n100,0.01\n"})
    assert load_machine(file).axes["x"].error_table is not None


def test_only_these_files_are_left(tmp_path):
    file = tmp_path / "mill.toml"
    file.write_text(TEXT, encoding="utf-8")
    write(file, TEXT)
    assert list(tmp_path.iterdir()) == [file]
