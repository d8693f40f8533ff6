"""Probing of the stepper board in the simulator."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cnc.api import Report, run
from cnc.boards.stepper.driver import Stepper
from cnc.kinematics.planar import CoreXY
from cnc.machine.compensation import ErrorPoint
from cnc.machine.models import Machine
from tests.support.boards.stepper_rig import PROBE_PIN, Part, machine
from tests.support.boards.stepper_simulator import Simulator, SimulatorPort
from tests.support.faulty_machine import FaultyMachine
from tests.support.soak import share

PROBING_PROGRAM = """G21 G90
G38.{kind} X20 F300
G1 X#5061 Y2 F600
G0 X1 Y0
M2
"""


def probed(
    folder: Path,
    text: str,
    part: int | None = None,
    *,
    touched: bool = False,
    known: Machine | None = None,
) -> tuple[Report, NDArray[np.int8]]:
    """Run a program; return the report and the grid moves of the pins.

    Args:
        folder: Folder for the program.
        text: The program.
        part: X of the part that is touched, steps.
        touched: Whether the probe touches something from the start.
        known: The machine; None for the router.
    """
    known = known or machine()
    (folder / "probe.ngc").write_text(text)
    simulator = Simulator()
    if touched:
        simulator.set_pin(PROBE_PIN, 0)
    port = SimulatorPort(simulator)
    if part is not None:
        Part(simulator, part)
    board = Stepper(port, known.of_joints, "the simulator", clock=port)
    report = run(folder / "probe.ngc", known, board=board)
    board.close()
    _, made = simulator.moves()
    simulator.close()
    return report, made


@pytest.mark.parametrize("kind", share([2, 3], [2]))
def test_probe_ends_at_its_grid_move(tmp_path: Path, kind: int) -> None:
    report, made = probed(tmp_path, PROBING_PROGRAM.format(kind=kind), 1000)
    assert report.ok, report.faults
    places = made.cumsum(axis=0, dtype=np.int64)
    # 300 mm/min are 2 steps a millisecond: contact, seen within 0.2 ms, at the latest at the next
    # grid move
    contact = int(places[np.flatnonzero(places[:, 1] > 0)[0] - 1, 0])
    assert 1000 <= contact <= 1002
    assert places[:, 0].max() <= 1002
    assert places[-1].tolist() == [400, 0, 0]
    assert report.end_position["x"] == pytest.approx(1.0)


@pytest.mark.parametrize("behind", share(["", "G4 P0.1\n", "M5\n"], ["M5\n"]))
def test_no_motion_follows_the_contact(tmp_path: Path, behind: str) -> None:
    """The program ends there. The rest of the probe's move is not made later."""
    report, made = probed(tmp_path, f"G21 G90\nG38.2 X20 F300\n{behind}M2\n", 1000)
    assert report.ok, report.faults
    assert 1000 <= made[:, 0].sum(dtype=np.int64) <= 1002


def test_probe_without_contact(tmp_path: Path) -> None:
    report, made = probed(
        tmp_path, "G21 G90\nG38.3 X2 F600\nG1 X[2 + #5070] F600\nG38.2 X4 F600\nM2\n"
    )
    assert [fault.diagnostic.code for fault in report.faults] == ["probe-no-contact"]
    assert made.sum(axis=0, dtype=np.int64).tolist() == [1600, 0, 0]


def test_probe_with_contact_at_its_start(tmp_path: Path) -> None:
    report, made = probed(tmp_path, "G21 G90\nG38.2 X2 F600\nM2\n", touched=True)
    assert [fault.diagnostic.code for fault in report.faults] == ["probe-contact"]
    assert not len(made)


def test_a_probe_answers_with_the_place_of_the_tool(tmp_path: Path) -> None:
    """The screw is 0.25 mm ahead of its motor: the contact at 1000 steps is at X 0.25 mm more."""
    router = machine()
    x = router.axes["x"]
    rows = tuple(ErrorPoint(place, 0.25, 0.25) for place in (-500.0, 500.0))
    known = router.model_copy(
        update={"axes": {**router.axes, "x": x.model_copy(update={"error_table": rows})}}
    )
    report, made = probed(
        tmp_path, "G21 G90\nG38.2 X20 F300\nG1 X[#5061 - 1] Y#5062 F600\nM2\n", 1000, known=known
    )
    assert report.ok, report.faults
    contact = made[:, 0].astype(np.int64).cumsum().max()
    assert 1000 <= contact <= 1002
    assert made[:, 0].sum(dtype=np.int64) == pytest.approx(contact - x.steps_per_mm, abs=1)
    assert not made[:, 1].any()


def test_a_probe_on_belts_answers_with_the_place_of_the_tool(tmp_path: Path) -> None:
    """The board counts both belts: 1000 steps each are X alone."""
    router = machine()
    place = {letter: router.axes[letter] for letter in "xyz"}
    known = router.model_copy(
        update={
            "kinematics": CoreXY(type="corexy"),
            "joints": {"a": place["x"], "b": place["x"]},
            "axes": place,
        }
    )
    report, made = probed(
        tmp_path, "G21 G90\nG38.2 X20 F300\nG1 X1 Y[#5062 + 1] F600\nM2\n", 1000, known=known
    )
    assert report.ok, report.faults
    scale = place["x"].steps_per_mm
    assert made[:, 0].sum(dtype=np.int64) == pytest.approx((1.0 + 1.0) * scale, abs=1)
    assert made[:, 1].sum(dtype=np.int64) == pytest.approx(0.0, abs=1)


def with_backlash(play: float) -> Machine:
    """Return the router with play of X and Y, mm."""
    router = machine()
    axes = {
        letter: axis.model_copy(update={"backlash": play} if letter in "xy" else {})
        for letter, axis in router.axes.items()
    }
    return router.model_copy(update={"axes": axes})


def test_a_probe_downwards_answers_with_the_place_of_the_tool(tmp_path: Path) -> None:
    """The motor pushes the nut down then: it turns, and moves by the play and 1 mm."""
    known, play = with_backlash(0.05), 0.05
    scale = known.axes["x"].steps_per_mm
    report, made = probed(
        tmp_path, "G21 G90\nG38.2 X-4 F300\nG1 X[#5061 + 1] F600\nM2\n", -1000, known=known
    )
    assert report.ok, report.faults
    places = made[:, 0].astype(np.int64).cumsum()
    assert -1002 <= places.min() <= -1000
    assert places[-1] - places.min() == pytest.approx((1.0 + play) * scale, abs=1)


def test_a_circle_on_the_stepper_board_is_one(tmp_path: Path) -> None:
    """The edges of its pins move a machine with play of X and Y."""
    known, faulty = with_backlash(0.05), FaultyMachine(backlash={"x": 0.05, "y": 0.05})
    program = "G21 G90 G17\nG1 X2 Y0 F600\nG3 X2 Y0 I-2 J0\nG1 X0\nM2\n"
    scale = np.array([axis.steps_per_mm for axis in known.axes.values()])
    report, made = probed(tmp_path, program, known=known)
    assert report.ok, report.faults
    motors = made[:, :3].astype(np.int64).cumsum(axis=0) / scale + [0.025, 0.025, 0.0]
    tool = faulty.tool(motors)
    radius = np.hypot(tool[:, 0], tool[:, 1])
    # The lines before and behind the circle lie on Y0.
    begin = int(np.flatnonzero(np.abs(tool[:, 1]) > 0.05)[0])
    end = int(np.flatnonzero(np.abs(tool[:, 1]) > 0.05)[-1])
    turn = slice(begin, end)
    assert end - begin > 4000
    assert np.abs(radius[turn] - 2.0).max() <= 1.0 / scale[0]
    assert np.abs(tool[-1]).max() <= 1.0 / scale[0]
