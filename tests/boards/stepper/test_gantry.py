"""A gantry on the stepper board: the firmware's fourth output is a second motor of any axis."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cnc.api import check, home
from cnc.boards.stepper.driver import Stepper
from cnc.boards.stepper.outputs import MotorOutputs
from cnc.boards.stepper.protocol import Kind, StepperLink, frame
from cnc.machine.models import Machine, Motor
from cnc.model.diagnostics import BoardError
from cnc.session.homing import Squared
from tests.support.boards.gantry_board import gantry
from tests.support.boards.stepper_simulator import (
    DIRECTION_PINS,
    STEP_PINS,
    Simulator,
    SimulatorPort,
)
from tests.support.session.runs import run_with
from tests.support.soak import share

SWITCH_PINS = (9, 10, 18, 16)
"""Pins of the limit switches of a board with four outputs: D9, D10, A4, A2."""
FAR = 1e9


class Bench:
    """The chip with four outputs, and switches that follow them.

    Args:
        known: The machine.
        switches: Direction and place of the switch of each output, steps.
    """

    def __init__(self, known: Machine, *switches: tuple[int, float]) -> None:
        self.known, self.switches = known, list(switches)
        self.signs = np.ones(4, np.int64)
        self.signs[:] = MotorOutputs(known).direction
        self.simulator = Simulator(axes=4)
        self.port = SimulatorPort(self.simulator)
        self.place, self.backward = [0, 0, 0, 0], [0, 0, 0, 0]
        self.seen = 0
        self._run = self.simulator.run
        self.simulator.run = self.felt  # type: ignore[method-assign]
        self.set()

    def felt(self, seconds: float, *, or_byte: bool = False) -> None:
        self._run(min(seconds, 5e-4), or_byte=or_byte)
        edges = self.simulator.edges()
        for _, pin, level, _ in edges[self.seen :].tolist():
            if pin in DIRECTION_PINS:
                self.backward[DIRECTION_PINS.index(pin)] = level
            elif pin in STEP_PINS and level:
                k = STEP_PINS.index(pin)
                self.place[k] += int(self.signs[k]) * (1 - 2 * self.backward[k])
        self.seen = len(edges)
        self.set()

    def set(self) -> None:
        for output, (towards, at) in enumerate(self.switches):
            closed = (self.place[output] - at) * towards >= 0
            self.simulator.set_pin(SWITCH_PINS[output], 0 if closed else 1)

    def driver(self) -> Stepper:
        return Stepper(self.port, self.known, "the simulator", clock=self.port)

    def home(self, *axes: str) -> tuple[dict[str, float | None], list[Squared]]:
        board, found = self.driver(), []
        try:
            return home(self.known, axes, board=board, on_squared=found.append), found
        finally:
            board.close()

    def standing(self) -> tuple[int | None, ...]:
        board = self.driver()
        try:
            return board.known_steps
        finally:
            board.close()


@pytest.fixture
def benches() -> Iterator[list[Bench]]:
    made: list[Bench] = []
    yield made
    for each in made:
        each.simulator.close()


def bench(benches: list[Bench], known: Machine, *switches: tuple[int, float]) -> Bench:
    benches.append(Bench(known, *switches))
    return benches[-1]


Y_SWITCHES = ((-1, -300), (-1, -410), (1, 150), (-1, -410))


@pytest.mark.parametrize("apart", share([-200, -60, 0, 120], [-60]))
@pytest.mark.parametrize("inverted", share([False, True], [True]))
def test_squared_motors_make_the_same_steps(
    benches: list[Bench], apart: int, inverted: bool, tmp_path: Path
) -> None:
    known = gantry(0.0)
    motors = (Motor(), Motor(offset=0.2, invert=inverted))
    known = known.model_copy(
        update={"axes": {**known.axes, "y": known.axes["y"].model_copy(update={"motors": motors})}}
    )
    here = bench(benches, known, *Y_SWITCHES[:3], (-1, -410 + apart))
    position, found = here.home()
    assert position == {"x": 0.0, "y": -2.0, "z": 1.0}
    assert found[0].skew[1] == pytest.approx((apart - 20) / 100, abs=0.05)
    x, y, z, second = here.place
    # Pins are set every half millisecond.
    assert (x, y, z) == pytest.approx((-250, -360, 100), abs=2)
    assert second - y == pytest.approx(apart - 20, abs=2)
    assert here.standing() == (0, -200, 100)
    rows = len(here.simulator.moves()[1])
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X2 Y3 Z0 F900\nG2 X4 Y1 R3\nM2\n")
    board = here.driver()
    report = run_with(tmp_path / "p.ngc", known, board=board)
    board.close()
    assert report.ok, report.faults
    made = here.simulator.moves()[1][rows:]
    sign = -1 if inverted else 1
    np.testing.assert_array_equal(made[:, 1], sign * made[:, 3])
    assert made[:, 1].any()
    assert made.sum(axis=0)[:3].tolist() == [400, 300, -100]


@pytest.mark.soak
@pytest.mark.parametrize(("letter", "output"), share([("x", 0), ("z", 2)], [("z", 2)]))
def test_fourth_output_is_a_motor_of_any_axis(
    benches: list[Bench], letter: str, output: int
) -> None:
    known = gantry(0.0, letter=letter)
    towards, at = Y_SWITCHES[output]
    here = bench(benches, known, *Y_SWITCHES[:3], (towards, at + 40))
    _, found = here.home(letter)
    assert [each.letter for each in found] == [letter]
    assert here.place[3] - here.place[output] == pytest.approx(40, abs=2)


@pytest.mark.soak
@pytest.mark.parametrize("broken", share([1, 3], [3]))
def test_switch_that_never_closes(benches: list[Bench], broken: int) -> None:
    switches = list(Y_SWITCHES)
    switches[broken] = (-1, -FAR)
    here = bench(benches, gantry(0.0), *switches)
    with pytest.raises(BoardError) as caught:
        here.home("y")
    found = caught.value.diagnostic
    assert found.code == "homing-square"
    assert f"motor {1 if broken == 3 else 2} closed its switch after 4.1" in found.message
    assert abs(here.place[1] - here.place[3]) <= 1
    assert here.standing()[1] is None


def test_lost_steps_on_one_side_are_found(benches: list[Bench]) -> None:
    here = bench(benches, gantry(0.0), *Y_SWITCHES)
    here.home("y")
    here.place[3] += 70
    _, found = here.home("y")
    assert found[0].skew[1] == pytest.approx(-0.7, abs=0.05)
    assert here.place[1] == pytest.approx(here.place[3], abs=2)


def test_limit_switch_of_the_second_motor_ends_a_program(
    benches: list[Bench], tmp_path: Path
) -> None:
    known = gantry(0.0)
    here = bench(benches, known, *Y_SWITCHES)
    here.home()
    here.switches[3] = (1, here.place[3] + 150)
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X2 Y3 Z0 F900\nM2\n")
    board = here.driver()
    report = run_with(tmp_path / "p.ngc", known, board=board)
    board.close()
    assert [each.diagnostic.code for each in report.faults] == ["board-limit"]
    assert "the limit switch of Y was hit" in report.faults[0].diagnostic.message


def test_board_of_three_outputs_or_of_old_firmware_is_refused() -> None:
    known = gantry(0.0)
    simulator = Simulator(axes=3)
    port = SimulatorPort(simulator)
    with pytest.raises(BoardError) as caught:
        Stepper(port, known, "the simulator", clock=port)
    assert caught.value.diagnostic.code == "board-axes"
    assert "AXES=4" in caught.value.diagnostic.hint
    simulator.close()
    link = StepperLink()
    old = b"cnc\x01\x04\xf4\x01\x9c\x03\x24\x00\x00\x00"
    [welcome] = link.receive(frame(Kind.WELCOME, 0, old), 0.0)
    assert not welcome.fourth_limit  # type: ignore[union-attr]
    [welcome] = StepperLink().receive(frame(Kind.WELCOME, 0, old + b"\x01"), 0.0)
    assert welcome.fourth_limit  # type: ignore[union-attr]


def test_five_motors_are_refused(tmp_path: Path) -> None:
    known = gantry(0.0, 0.0)
    board = known.board.model_copy(update={"kind": "stepper", "max_step_rate": 20_000})
    known = known.model_copy(update={"board": board})
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X2 F900\nM2\n")
    report = check(tmp_path / "p.ngc", known)
    [fault] = report.faults
    assert fault.diagnostic.code == "board-axes"
    assert "5 motors, the board 4" in fault.diagnostic.message
