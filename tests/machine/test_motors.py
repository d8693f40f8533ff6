"""Motors of an axis in machine files: their number, their tables, and what contradicts them."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.machine.load import load_machine
from cnc.machine.models import Motor
from cnc.model.diagnostics import MachineFileError

FILE = """[axes.x]
steps_per_mm = 100
max_velocity = 20
max_acceleration = 200
max_jerk = 9000

[axes.y]
steps_per_mm = 100
max_velocity = 20
max_acceleration = 200
max_jerk = 9000
travel = [0, 100]
{motors}
homing = {{ pull_off = 1.0, {homing} }}
"""


def load(folder: Path, motors: str, homing: str = "seek = 8.0", more: str = "") -> object:
    file = folder / "m.toml"
    file.write_text(FILE.format(motors=motors, homing=homing) + more)
    return load_machine(file)


@pytest.mark.parametrize(
    ("text", "motors"),
    [
        ("", (Motor(),)),
        ("motors = 1", (Motor(),)),
        ("motors = 2", (Motor(), Motor())),
        (
            "motors = [{}, { offset = 0.35, invert = true }]",
            (Motor(), Motor(offset=0.35, invert=True)),
        ),
        ("motors = [{}, { offset = -7.0 }, {}]", (Motor(), Motor(offset=-7.0), Motor())),
    ],
)
def test_motors_of_an_axis(tmp_path: Path, text: str, motors: tuple[Motor, ...]) -> None:
    known = load(tmp_path, text)
    assert known.axes["y"].motors == motors  # type: ignore[attr-defined]
    assert known.axes["x"].motors == (Motor(),)  # type: ignore[attr-defined]
    homing = known.axes["y"].homing  # type: ignore[attr-defined]
    assert homing.squaring_limit == 2.5


@pytest.mark.parametrize(
    ("text", "homing", "message"),
    [
        ("motors = 0", "", "must be 1 to 4"),
        ("motors = 5", "", "must be 1 to 4"),
        ("motors = -2", "", "must be 1 to 4"),
        ("motors = true", "", "axes.y.motors"),
        ('motors = "2"', "", "axes.y.motors"),
        ("motors = []", "", "axes.y.motors"),
        ("motors = [{}, { ofset = 1.0 }]", "", "no such key"),
        ("motors = [{}, { offset = nan }]", "", "finite"),
        ("motors = [{ offset = 1.0 }, {}]", "", "the offset of the first motor is not 0"),
        # The switch at the low end of motor 2 would be closed where the axis rests.
        ("motors = [{}, { offset = 1.0 }]", "", "is closed 1 mm off that of motor 1"),
        ("motors = [{}, { offset = -1.5 }]", 'end = "high"', "is closed 1 mm off"),
        ("motors = 2", "squaring_limit = 0.0", "must be greater than 0"),
        ("motors = 2", "squaring_limit = -1.0", "must be greater than 0"),
    ],
)
def test_wrong_motors_are_refused_at_their_line(
    tmp_path: Path, text: str, homing: str, message: str
) -> None:
    with pytest.raises(MachineFileError) as caught:
        load(tmp_path, text, homing or "seek = 8.0")
    found = caught.value.diagnostic
    assert message in found.message
    assert found.line == (14 if homing.startswith("squaring") else 13)


KLIPPER = """
[board]
kind = "klipper"

[board.klipper.x]
step = "gpio0"
direction = "gpio1"

[board.klipper.y]
step = {step}
direction = ["gpio4", "gpio5"]
endstop = {endstop}
{driver}
"""
TWO, ONE = '["gpio2", "gpio3"]', '"^gpio6"'
BOTH = '["^gpio6", "^gpio7"]'
TMC = '{ kind = "tmc2209", uart = "gpio9", address = 0, run_current = 0.8 }'
OTHER = TMC.replace("address = 0", "address = 1")


@pytest.mark.parametrize(
    ("motors", "keys"),
    [
        ("motors = 2", (TWO, ONE, "")),
        ("motors = 2", (TWO, BOTH, "")),
        ("", (TWO, ONE, "")),
        ("motors = 2", (TWO, BOTH, f"driver = [{TMC}, {OTHER}]")),
        (
            "motors = 2",
            (
                TWO,
                BOTH,
                f"driver = [{TMC}, {OTHER}]".replace('"gpio9"', '"gpio9", transmit = "gpio8"'),
            ),
        ),
    ],
)
def test_pins_of_a_gantry(tmp_path: Path, motors: str, keys: tuple[str, str, str]) -> None:
    step, endstop, driver = keys
    load(tmp_path, motors, more=KLIPPER.format(step=step, endstop=endstop, driver=driver))


@pytest.mark.parametrize(
    ("motors", "keys", "message"),
    [
        ("motors = 3", (TWO, ONE, ""), "3 motors, but 2 step pins"),
        ("motors = 2", (TWO, '["^gpio6", "^gpio7", "^gpio8"]', ""), "3 limit switches"),
        ("", (TWO, BOTH, ""), "2 limit switches, but one motor"),
        ("motors = 2", (TWO, '["^gpio6", "^gpio6"]', ""), "gpio6 is used"),
        ("motors = 2", (TWO, BOTH, f"driver = {TMC}"), "2 motors have 1 drivers"),
        ("motors = 2", (TWO, BOTH, f"driver = [{TMC}, {TMC}]"), "gpio9 is used"),
        ("motors = 2", (TWO, BOTH, f"driver = [{TMC}, {{ kind = 3 }}]"), "driver"),
    ],
)
def test_wrong_pins_of_a_gantry(
    tmp_path: Path, motors: str, keys: tuple[str, str, str], message: str
) -> None:
    step, endstop, driver = keys
    with pytest.raises(MachineFileError) as caught:
        load(tmp_path, motors, more=KLIPPER.format(step=step, endstop=endstop, driver=driver))
    assert message in caught.value.diagnostic.message
    assert caught.value.diagnostic.line > 14
