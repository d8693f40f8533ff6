"""Pins of a Klipper board in a machine file: notation, and errors at their lines."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.api import check
from cnc.boards.klipper.firmware import FIRMWARES
from cnc.boards.klipper.layout import Layout, LayoutBuilder
from cnc.machine.klipper import Pin
from cnc.machine.load import load_machine, shipped_machines
from cnc.model.diagnostics import Diagnostic, MachineFileError

AXES = "".join(
    f"[axes.{letter}]\nsteps_per_mm = 100\nmax_velocity = 50\nmax_acceleration = 500\n"
    "max_jerk = 9000\n"
    for letter in "xy"
)
GOOD = (
    AXES
    + """[board]
kind = "klipper"
[board.klipper.x]
step = "PA0"
direction = "!PA1"
enable = "!PA2"
endstop = "^!PA3"
[board.klipper.y]
step = ["PA4", "PA5"]
direction = ["PA6", "!PA7"]
enable = "!PA2"
"""
)


def layout(file: Path) -> Layout:
    return LayoutBuilder(load_machine(file), FIRMWARES["atmega328p"].dictionary).build()


def fault(folder: Path, text: str) -> Diagnostic:
    (folder / "m.toml").write_text(text)
    with pytest.raises(MachineFileError) as caught:
        layout(folder / "m.toml")
    return caught.value.diagnostic


def test_pins_of_a_machine_file(tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(GOOD)
    made = layout(tmp_path / "m.toml")
    assert [motor.column for motor in made.motors] == [0, 1, 1]
    assert [motor.forward for motor in made.motors] == [0, 1, 0]
    assert [each.name for each in made.outputs] == ["enable"]
    limit = made.limits(0)[0]
    assert limit is not None
    assert limit.active == 0


@pytest.mark.parametrize(
    ("text", "pin"),
    [
        ("PA3", Pin("PA3", inverted=False, pull_up=False)),
        ("!gpio4", Pin("gpio4", inverted=True, pull_up=False)),
        ("^!P1.24", Pin("P1.24", inverted=True, pull_up=True)),
        ("!^PA3", Pin("PA3", inverted=True, pull_up=True)),
    ],
)
def test_notation(text: str, pin: Pin) -> None:
    assert Pin.of(text) == pin


@pytest.mark.parametrize(
    ("old", "new", "place", "message"),
    [
        ('step = "PA0"', 'step = "PA1"', "direction", "PA1 is used by board.klipper.x.step"),
        ('"PA4", "PA5"', '"PA4", "PA4"', "step = [", "PA4 is used by board.klipper.y.step"),
        ('step = "PA0"', 'step = "^PA0"', "step = ", "an output has no pull-up resistor"),
        ('step = "PA0"', 'step = "!!PA0"', "step = ", "must be the name of a pin"),
        ('step = "PA0"', 'step = "PZ9"', "step = ", "the board has no pin PZ9"),
        ('"PA6", "!PA7"', '"PA6"', 'direction = ["', "2 motors have 1 direction pins"),
        ('enable = "!PA2"\nend', 'enable = "PA2"\nend', 'enable = "!', "the pin PA2 is used"),
        ('endstop = "^!PA3"', 'endstopp = "^!PA3"', "endstopp", "there is no such key"),
        ("[board.klipper.y]", "[board.klipper.z]", "[board.", "the axis y has no motor"),
        (
            'endstop = "^!PA3"',
            'driver = { kind = "tmc2209", run_current = 1.0 }',
            "driver",
            "a tmc2209 needs the pin uart",
        ),
    ],
)
def test_errors_name_their_lines(
    old: str, new: str, place: str, message: str, tmp_path: Path
) -> None:
    assert old in GOOD
    text = GOOD.replace(old, new, 1)
    found = fault(tmp_path, text)
    assert message in found.message
    lines = text.splitlines()
    assert found.line == 1 + next(k for k, each in enumerate(lines) if each.startswith(place))
    assert found.file == str(tmp_path / "m.toml")


SPI = 'driver = { kind = "tmc5160", select = "PC0", run_current = 1.0, spi_bus = "spi" }'


@pytest.mark.parametrize(
    ("mcu", "change", "place", "message"),
    [
        ("atmega328p", ('step = "PA0"', 'step = "PZ9"'), "step = ", "the board has no pin PZ9"),
        ("", ('step = "PA0"', 'step = "PZ9"'), "", ""),
        ("atmega328p", ('endstop = "^!PA3"', SPI), "", ""),
        ("atmega328p", ('endstop = "^!PA3"', SPI.replace('"spi"', '"spi1"')), "driver", "spi1"),
        (
            "atmega328p",
            ('endstop = "^!PA3"', f'endstop = "^!PB4"\n{SPI}'),
            "endstop",
            "the pin PB4 belongs to the SPI bus spi",
        ),
    ],
)
def test_pins_are_compared_with_the_named_microcontroller(
    mcu: str, change: tuple[str, str], place: str, message: str, tmp_path: Path
) -> None:
    """The check without a board knows the pins, if the machine file names a microcontroller."""
    text = GOOD.replace(*change, 1)
    if mcu:
        text += f'[board.klipper]\nmcu = "{mcu}"\n'
    (tmp_path / "m.toml").write_text(text)
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X0.1 F300\nM2\n")
    report = check(tmp_path / "p.ngc", load_machine(tmp_path / "m.toml"))
    if not message:
        assert report.ok, report.faults
        return
    found = report.faults[0].diagnostic
    assert message in found.message
    lines = text.splitlines()
    assert found.line == 1 + next(k for k, each in enumerate(lines) if each.startswith(place))
    assert found.file == str(tmp_path / "m.toml")


def test_machine_without_pins_is_refused(tmp_path: Path) -> None:
    found = fault(tmp_path, AXES + '[board]\nkind = "klipper"\n')
    assert "needs the pins of its motors" in found.message


@pytest.mark.parametrize("name", [name for name in shipped_machines() if "klipper" in name])
def test_shipped_machines_suit_their_microcontrollers(name: str) -> None:
    machine = load_machine(name)
    assert machine.board.klipper is not None
    firmware = FIRMWARES[machine.board.klipper.mcu]
    assert LayoutBuilder(machine, firmware.dictionary).build().motors
