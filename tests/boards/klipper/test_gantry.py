"""A gantry on the Klipper board: motors of an axis with a switch each are squared, then equal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.api import home
from cnc.boards.klipper.driver import Klipper
from cnc.machine.klipper import KlipperAxis
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError
from cnc.session.homing import Squared
from cnc.simulators.klipper.ports import KlipperSimulatorPort, simulator_for
from tests.support.boards.gantry_board import PLACES, SwitchPlaces, gantry
from tests.support.boards.klipper_rig import end_level, event_ticks, pins, steps_of, with_board
from tests.support.session.runs import run_with
from tests.support.soak import share

Y = KlipperAxis(
    step=("gpio23", "gpio24"),
    direction=("gpio25", "!gpio26"),
    endstop=("^!gpio27", "^!gpio28"),
)


class Bench:
    """A simulated board with switches that follow the motors."""

    def __init__(self, known: Machine, places: SwitchPlaces = PLACES) -> None:
        self.known = known
        self.simulator = simulator_for(known)
        for (column, motor), end in places.items():
            self.set_switch(column, motor, end)

    def set_switch(self, column: int, motor: int, end: tuple[int, float]) -> None:
        """Set direction and place of a switch, unless the motors share one."""
        letter = tuple(self.known.axes)[column]
        axis = pins(self.known).axis(letter)
        assert axis is not None
        assert axis.endstop is not None
        if motor < len(axis.endstop):
            level = end_level(self.known, self.simulator, letter, end, motor)
            self.simulator.set_pin(axis.endstop[motor].strip("^!"), level)

    def place(self, column: int, motor: int = 0) -> int:
        axis = pins(self.known).axis(tuple(self.known.axes)[column])
        assert axis is not None
        counted = self.simulator.positions.get(self.simulator.pin(axis.step[motor]), 0)
        return -counted if axis.direction[motor].startswith("!") else counted

    def driver(self) -> Klipper:
        port = KlipperSimulatorPort(self.simulator)
        return Klipper(port, self.known, "the simulator", clock=port, identity="the gantry")

    def home(self, *axes: str) -> tuple[dict[str, float | None], list[Squared]]:
        driver, found = self.driver(), []
        try:
            return home(self.known, axes, board=driver, on_squared=found.append), found
        finally:
            driver.close()


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.mark.parametrize("apart", share([-180, -40, 0, 90, 200], [-40]))
def test_squared_motors_make_the_same_steps(apart: int, tmp_path: Path) -> None:
    known = with_board(gantry(0.2), y=Y)
    bench = Bench(known, {**PLACES, (1, 1): (-1, PLACES[1, 1][1] + apart)})
    position, found = bench.home()
    assert position == {"x": 0.0, "y": -2.0, "z": 1.0}
    assert found[0].skew[1] == pytest.approx((apart - 20) / 100, abs=0.03)
    first, second = bench.place(1, 0), bench.place(1, 1)
    assert abs(first - (PLACES[1, 0][1] + 50)) <= 1
    assert abs(second - first - (apart - 20)) <= 2
    counts = [len(steps_of(known, bench.simulator, "y", motor)[0]) for motor in range(2)]
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X2 Y3 Z0 F900\nG2 X4 Y1 R3\nM2\n")
    driver = bench.driver()
    assert driver.known_steps == (0, -200, 100)
    report = run_with(tmp_path / "p.ngc", known, board=driver)
    driver.close()
    assert report.ok, report.faults
    one, two = (
        [each[begin:] for each in steps_of(known, bench.simulator, "y", motor)]
        for motor, begin in enumerate(counts)
    )
    np.testing.assert_array_equal(one[1], two[1])
    assert np.abs(one[0] - two[0]).max() <= 2 * event_ticks(bench.simulator)


@pytest.mark.soak
@pytest.mark.parametrize("broken", share([0, 1], [1]))
def test_switch_that_never_closes(broken: int) -> None:
    bench = Bench(with_board(gantry(0.0), y=Y), {**PLACES, (1, broken): (-1, -1e9)})
    with pytest.raises(BoardError) as caught:
        bench.home("y")
    assert caught.value.diagnostic.code == "homing-square"
    assert abs(bench.place(1, 0) - bench.place(1, 1)) <= 1
    driver = bench.driver()
    assert driver.known_steps[1] is None
    driver.close()


def test_each_limit_switch_of_a_gantry_ends_the_motion(tmp_path: Path) -> None:
    known = with_board(gantry(0.0), y=Y)
    bench = Bench(known)
    bench.home()
    bench.set_switch(1, 1, (1, bench.place(1, 1) + 150))
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X2 Y3 Z0 F900\nM2\n")
    driver = bench.driver()
    report = run_with(tmp_path / "p.ngc", known, board=driver)
    driver.close()
    assert [each.diagnostic.code for each in report.faults] == ["board-limit"]
    assert "limit switch of Y" in report.faults[0].diagnostic.message


def test_one_switch_for_both_motors_moves_them_together(tmp_path: Path) -> None:
    shared = Y.model_copy(update={"endstop": Y.endstop[:1]})  # type: ignore[index]
    bench = Bench(with_board(gantry(0.0), y=shared))
    _, found = bench.home()
    assert not found
    assert bench.place(1, 0) == bench.place(1, 1)
