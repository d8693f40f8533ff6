"""Homing without switches: the motor driver tells that its motor stalls at a hard stop."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cnc.api import home
from cnc.boards.klipper.driver import Klipper
from cnc.boards.klipper.trinamic import GCONF, TCOOLTHRS
from cnc.machine.klipper import TrinamicDriver
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError
from cnc.simulators.klipper.ends import HardStop
from cnc.simulators.klipper.ports import KlipperSimulatorPort, simulator_for
from tests.support.boards.gantry_board import gantry
from tests.support.boards.homing_bench import small
from tests.support.boards.klipper_rig import pins, place, with_board
from tests.support.session.runs import run_with
from tests.support.soak import share

KEYS = {
    "tmc2209": {"uart": "gpio26"},
    "tmc2130": {"select": "gpio27", "spi_bus": "spi0c"},
    "tmc5160": {"select": "gpio27", "spi_bus": "spi0c"},
}
RIGHT = {"tmc2209": 60, "tmc2130": 5, "tmc5160": 5}
STOP = -300
"""Place of the hard stop of X, steps."""


def sensorless(kind: str, level: int, **keys: Any) -> Machine:
    known = with_board(small())
    x = pins(known).x
    assert x is not None
    values = {"kind": kind, "run_current": 0.8, "stallguard": level, **KEYS[kind], **keys}
    driver = TrinamicDriver.model_validate(values)
    return with_board(
        small(), x=x.model_copy(update={"driver": (driver,), "endstop": ("^gpio28",)})
    )


class Bench:
    """A simulated board whose X axis has a hard stop."""

    def __init__(self, known: Machine) -> None:
        self.known = known
        self.simulator = simulator_for(known)
        x = pins(known).x
        assert x is not None
        assert x.driver is not None
        driver = x.driver[0]
        if driver.uart is not None:
            self.model = self.simulator.uarts[self.simulator.pin(driver.uart)].drivers[0]
        else:
            self.model = self.simulator.spi[self.simulator.pin(str(driver.select))]
        self.stop = HardStop(self.simulator, self.model, x.step[0], (-1, STOP))
        self.simulator.set_pin("gpio28", self.stop.diag)

    def driver(self) -> Klipper:
        port = KlipperSimulatorPort(self.simulator)
        return Klipper(port, self.known, "the simulator", clock=port)


@pytest.mark.parametrize("silent", share([False, True], [False]))
@pytest.mark.parametrize("kind", share(["tmc2209", "tmc2130", "tmc5160"], ["tmc5160"]))
def test_axis_ends_off_its_hard_stop(kind: str, silent: bool) -> None:
    """The mode of the machine file is that of cutting; homing measures in its own mode."""
    bench = Bench(sensorless(kind, RIGHT[kind], stealthchop=silent))
    board = bench.driver()
    assert home(bench.known, ("x",), board=board)["x"] == 0.0
    # The pull-off is 0.5 mm, 50 steps.
    assert bench.stop.place == pytest.approx(STOP + 50, abs=2)
    mode = bench.model.registers[GCONF] >> 2 & 1
    assert bool(mode) == (silent if kind != "tmc2209" else not silent)
    assert bench.model.registers[TCOOLTHRS] == 0
    assert home(bench.known, ("x",), board=board)["x"] == 0.0
    board.close()
    assert bench.stop.place == pytest.approx(STOP + 50, abs=2)


@pytest.mark.parametrize(("kind", "level"), [("tmc2209", 20), ("tmc5160", 40)][:: share(1, 2)])
def test_too_low_a_sensitivity_is_an_error(kind: str, level: int) -> None:
    bench = Bench(sensorless(kind, level))
    board = bench.driver()
    with pytest.raises(BoardError) as caught:
        home(bench.known, ("x",), board=board)
    board.close()
    assert caught.value.diagnostic.code == "homing-switch"
    assert "did not close within" in caught.value.diagnostic.message


@pytest.mark.parametrize(("kind", "level"), [("tmc2209", 255), ("tmc5160", -60)][:: share(1, 2)])
def test_too_high_a_sensitivity_stalls_in_the_open(kind: str, level: int) -> None:
    """The model shows the fault of real drivers: the axis believes that it is at its stop."""
    bench = Bench(sensorless(kind, level))
    board = bench.driver()
    home(bench.known, ("x",), board=board)
    board.close()
    assert bench.stop.place > STOP + 100


def test_stall_does_not_count_in_a_program(tmp_path: Path) -> None:
    """While cutting, a high load is no limit switch."""
    known = sensorless("tmc2209", 255, stealthchop=True)
    axes = {letter: axis.model_copy(update={"homing": None}) for letter, axis in known.axes.items()}
    bench = Bench(known.model_copy(update={"axes": axes}))
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X3 F1200\nM2\n")
    board = bench.driver()
    report = run_with(tmp_path / "p.ngc", bench.known, board=board)
    board.close()
    assert report.ok, report.faults
    assert place(bench.known, bench.simulator)[0] == 300


def test_gantry_without_switches_squares_at_two_stops() -> None:
    known = with_board(gantry(0.0))
    values = {"kind": "tmc2209", "run_current": 0.8, "stallguard": 60, "uart": "gpio26"}
    drivers = tuple(
        TrinamicDriver.model_validate({**values, "address": address}) for address in (0, 1)
    )
    y = pins(known).y
    assert y is not None
    both = y.model_copy(
        update={
            "step": ("gpio22", "gpio23"),
            "direction": ("gpio24", "gpio25"),
            "endstop": ("gpio27", "gpio28"),
            "driver": drivers,
        }
    )
    known = with_board(gantry(0.0), y=both)
    simulator = simulator_for(known)
    wire = simulator.uarts[simulator.pin("gpio26")]
    stops = []
    for motor, at in enumerate((-410, -470)):
        stop = HardStop(simulator, wire.drivers[motor], both.step[motor], (-1, at))
        simulator.set_pin(both.endstop[motor], stop.diag)  # type: ignore[index]
        stops.append(stop)
    port = KlipperSimulatorPort(simulator)
    board = Klipper(port, known, "the simulator", clock=port)
    assert home(known, ("y",), board=board)["y"] == -2.0
    board.close()
    assert [stop.place for stop in stops] == pytest.approx([-360, -420], abs=2)
