"""Homing of a Klipper board on switches that follow the motors, and the position between runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.api import home
from cnc.boards.klipper.driver import Klipper
from cnc.kinematics.five_axis import FiveAxis
from cnc.machine.models import HomingOrder, Machine
from cnc.model.diagnostics import BoardError
from cnc.session.homing import homing_sequence
from cnc.simulators.klipper.klipper_simulator import KlipperSimulator
from cnc.simulators.klipper.ports import simulator_for
from tests.support.boards.homing_bench import axis, small
from tests.support.boards.klipper_rig import (
    connected,
    count,
    end_level,
    pins,
    place,
    with_board,
)
from tests.support.session.runs import run_with

SWITCHES = {"x": (-1, -300), "y": (-1, -410), "z": (1, 150)}
"""Direction and place of each switch, steps from the start: 3, 4.1 and 1.5 mm."""
IDENTITY = "the bench"


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


class Bench:
    """A simulated board with switches."""

    def __init__(self, known: Machine, switches: dict[str, tuple[int, int]] = SWITCHES) -> None:
        self.known = known
        self.simulator: KlipperSimulator = simulator_for(known)
        self.ports = 0
        for letter, end in switches.items():
            pin = getattr(pins(known), letter).endstop[0].strip("^!")
            self.simulator.set_pin(pin, end_level(known, self.simulator, letter, end))

    def driver(self) -> Klipper:
        return connected(self.known, self.simulator, identity=IDENTITY)

    def home(self, *axes: str) -> dict[str, float | None]:
        driver = self.driver()
        try:
            return home(self.known, axes, board=driver)
        finally:
            driver.close()

    def standing(self) -> tuple[int | None, ...]:
        driver = self.driver()
        try:
            return driver.known_steps
        finally:
            driver.close()


@pytest.fixture
def bench() -> Bench:
    return Bench(with_board(small()))


def test_axes_end_off_their_switches_with_known_positions(bench: Bench) -> None:
    assert bench.standing() == (None, None, None)
    assert bench.home() == {"x": 0.0, "y": -2.0, "z": 1.0}
    # A switch is seen within 0.2 ms, which is 4 steps at 20 mm/s and less than one when latching.
    for at, switch in zip(place(bench.known, bench.simulator), (-250, -360, 100), strict=True):
        assert abs(at - switch) <= 1
    assert bench.standing() == (0, -200, 100)


def test_tilting_and_turning_axes_home_on_their_switches(tmp_path: Path) -> None:
    """A trunnion: the rotary axes home first, in degrees; then a program moves the tip."""
    letters = ("x", "y", "z", "a", "c")
    travels = ((0.0, 8.0), (-2.0, 6.0), (-5.0, 1.0), (-6.0, 3.0), (0.0, 9.0))
    known = Machine(
        kinematics=FiveAxis(type="xyzac", tilt_point=(1.0, 2.0, -30.0)),
        axes={letter: axis(travel) for letter, travel in zip(letters, travels, strict=True)},
        homing=HomingOrder(order=("c", "a", "z", "x", "y")),
    )
    switches = SWITCHES | {"a": (-1, -220), "c": (-1, -70)}
    bench = Bench(with_board(known), switches)
    assert homing_sequence(known, (), 5)[0].description.startswith(
        "C: down to its switch, at most 10 \u00b0"
    )
    assert bench.home() == {"x": 0.0, "y": -2.0, "z": 1.0, "a": -6.0, "c": 0.0}
    places = (-250, -360, 100, -170, -20)
    for at, switch in zip(place(bench.known, bench.simulator), places, strict=True):
        assert abs(at - switch) <= 1
    assert bench.standing() == (0, -200, 100, -600, 0)
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X2 Y0 Z0 A0 C3 F600\nM2\n")
    driver = bench.driver()
    report = run_with(tmp_path / "p.ngc", bench.known, board=driver)
    driver.close()
    assert report.ok, report.faults
    assert bench.standing() == (200, 0, 0, 0, 300)


@pytest.mark.soak
def test_program_begins_at_the_homed_position(bench: Bench, tmp_path: Path) -> None:
    bench.home()
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X2 Y0 Z0 F600\nM2\n")
    before = place(bench.known, bench.simulator)
    driver = bench.driver()
    report = run_with(tmp_path / "p.ngc", bench.known, board=driver)
    driver.close()
    assert report.ok, report.faults
    moved = [b - a for a, b in zip(before, place(bench.known, bench.simulator), strict=True)]
    assert moved == [200, 200, -100]
    assert bench.standing() == (200, 0, 0)


def test_reset_and_other_configurations_lose_the_position(bench: Bench) -> None:
    bench.home()
    bench.simulator.reset()
    bench.simulator.advance(bench.simulator.boots_until)
    assert bench.standing() == (None, None, None)
    bench.home()
    axis = pins(bench.known).x
    assert axis is not None
    swapped = axis.model_copy(update={"direction": (f"!{axis.direction[0]}",)})
    first, bench.known = bench.known, with_board(small(), x=swapped)
    assert bench.standing() == (None, None, None)
    bench.known = first
    assert bench.standing() == (None, None, None)


def test_killed_program_loses_the_position(bench: Bench, tmp_path: Path) -> None:
    """The board counted every step, but the motors stopped without a ramp."""
    bench.home()
    driver = bench.driver()
    driver.prepare_next_start(watched=[True] * 3, known=[True] * 3)
    driver.start(driver._sender.position)
    bench.simulator.advance(bench.simulator.now + 3.0)
    assert bench.standing() == (None, None, None)


def test_switch_that_never_closes(bench: Bench) -> None:
    pin = pins(bench.known).z.endstop[0].strip("^!")
    bench.simulator.set_pin(pin, 1)
    with pytest.raises(BoardError) as caught:
        bench.home("z")
    assert caught.value.diagnostic.code == "homing-switch"
    assert place(bench.known, bench.simulator)[2] <= 700


def test_other_switches_end_the_motion(bench: Bench) -> None:
    """While Z homes, the switch of X closes."""
    pin = pins(bench.known).x.endstop[0].strip("^!")
    bench.simulator.set_pin(pin, lambda: int(count(bench.known, bench.simulator, "z") < 40))
    with pytest.raises(BoardError) as caught:
        bench.home("z")
    assert caught.value.diagnostic.code == "board-limit"
    assert bench.standing() == (None, None, None)
