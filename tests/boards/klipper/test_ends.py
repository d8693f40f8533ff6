"""Homing of the simulated board: its switches and hard stops follow the motors."""

from __future__ import annotations

import pytest

from cnc.api import home
from cnc.machine.klipper import TrinamicDriver
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.simulators.klipper.ports import KlipperSimulatorBoard, with_pins
from tests.support.boards.gantry_board import gantry
from tests.support.boards.homing_bench import QUICK, axis, small
from tests.support.boards.klipper_rig import pins, place, with_board
from tests.support.soak import share


def homed(known: Machine) -> tuple[dict[str, float | None], list[int]]:
    """Return the coordinates after homing, and how far the motors went, steps."""
    board = KlipperSimulatorBoard.from_machine(known)
    try:
        return home(known, (), board=board), place(with_pins(known), board.simulator)
    finally:
        board.close()


def test_each_axis_rests_where_its_switch_has_opened() -> None:
    """Ends are 0.5 mm beyond the homed positions 0, -2 and 1; the machine begins at zero."""
    known, went = homed(with_board(small()))
    assert known == {"x": 0.0, "y": -2.0, "z": 1.0}
    for made, wanted in zip(went, (0, -200, 100), strict=True):
        assert abs(made - wanted) <= 1


def test_no_switch_is_pressed_at_the_start() -> None:
    """The homed position is on the far side of machine zero, where the simulator begins."""
    up = QUICK.model_copy(update={"end": "low", "position": 3.0})
    axes = {"x": axis((3.0, 8.0), up), "y": axis((-2.0, 6.0)), "z": axis((-5.0, 1.0))}
    known, went = homed(with_board(small(axes=axes)))
    assert known == {"x": 3.0, "y": -2.0, "z": 1.0}
    assert abs(went[0]) <= 1


def test_both_motors_of_a_gantry_have_a_switch() -> None:
    known, _ = homed(with_board(gantry(0.0)))
    assert None not in known.values()


@pytest.mark.parametrize("keys", [{"kind": "tmc2209", "uart": "gpio26", "stallguard": 60}])
def test_a_driver_finds_the_end_without_a_switch(keys: dict[str, object]) -> None:
    plain = with_board(small())
    x = pins(plain).x
    assert x is not None
    driver = TrinamicDriver.model_validate({"run_current": 0.8, **keys})
    x = x.model_copy(update={"driver": (driver,), "endstop": ("^gpio28",)})
    known, went = homed(with_board(small(), x=x))
    assert known == {"x": 0.0, "y": -2.0, "z": 1.0}
    assert went[1] == pytest.approx(-200, abs=1)


SHIPPED = ["corexy", "trunnion", "klipper-uno", "klipper-pico"]


@pytest.mark.parametrize("name", share(SHIPPED, SHIPPED[:2]))
def test_shipped_machines_home(name: str) -> None:
    known = load_machine(name)
    board = KlipperSimulatorBoard.from_machine(known)
    try:
        assert None not in home(known, (), board=board).values()
    finally:
        board.close()
