"""Modes in a machine file: what is read, and what is refused at its line."""

from pathlib import Path

import pytest

from cnc.machine.load import load_machine, shipped_machines
from cnc.model.diagnostics import MachineFileError

DEFAULT = shipped_machines()["default"].read_text()
LINE = DEFAULT.count("\n") + 3


def load(tmp_path: Path, modes: str):
    file = tmp_path / "m.toml"
    file.write_text(f"{DEFAULT}\n[vibration]\n{modes}\n")
    return load_machine(file)


def test_a_table_is_one_mode_and_a_list_two(tmp_path: Path) -> None:
    text = "x = {frequency = 38}\ntool = [{frequency = 20.5, damping = 0}, {frequency = 61}]"
    modes = load(tmp_path, text).vibration
    assert [(mode.frequency, mode.damping) for mode in modes["x"]] == [(38.0, 0.05)]
    assert [(mode.frequency, mode.damping) for mode in modes["tool"]] == [(20.5, 0.0), (61.0, 0.05)]


@pytest.mark.parametrize(
    ("modes", "words"),
    [
        ("a = {frequency = 38}", "vibration.a: there is no such axis"),
        ("x = {frequency = 501}", "vibration.x: a mode is above 500 Hz, half the rate"),
        ("x = {frequency = 0}", "vibration.x.frequency: must be at least 1"),
        ("x = {frequency = nan}", "vibration.x.frequency: "),
        ("x = {frequency = 38, damping = 0.6}", "vibration.x.damping: must be at most 0.5"),
        ("x = {damping = 0.1}", "vibration.x.frequency: is missing"),
        ("x = 38", "vibration.x: must be a table, {frequency = 38.0, damping = 0.05}"),
        ("x = []", "vibration.x: must have at least 1"),
        (f"x = [{', '.join(['{frequency = 38}'] * 3)}]", "vibration.x: must have at most 2"),
    ],
)
def test_a_wrong_mode_is_refused_at_its_line(tmp_path: Path, modes: str, words: str) -> None:
    with pytest.raises(MachineFileError) as error:
        load(tmp_path, modes)
    diagnostic = error.value.diagnostic
    assert diagnostic.code == "machine-file"
    assert diagnostic.message.startswith(words)
    assert diagnostic.line == LINE
