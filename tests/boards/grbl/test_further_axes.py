"""Boards with more than three axes: lines, reports, offsets, limits, and what is refused."""

import math
import random
from pathlib import Path

import numpy as np
import pytest

from cnc.api import RunOptions, run
from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.grbl.link import GrblLink, machine_file
from cnc.boards.grbl.messages import Feedback, Firmware
from cnc.boards.grbl.settings import BoardInfo
from cnc.machine.load import load_machine
from cnc.machine.models import Axis, Machine
from cnc.model.diagnostics import BoardError
from cnc.session.program_reader import InlineProgram
from cnc.simulators.grbl.board import GrblSimulatorBoard
from cnc.simulators.grbl.firmware_profile import GRBL, GRBLHAL
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import NAME, GrblSimulatorPort
from cnc.simulators.grbl.report import status_report
from cnc.simulators.grbl.workpiece import HalfSpace, Workpiece
from tests.support.boards.simulator_bench import HOMING, Bench

ROTARY = Axis(steps_per_mm=100, max_velocity=60, max_acceleration=300, travel=(-3600, 3600))


@pytest.fixture
def four_axes() -> Machine:
    machine = load_machine(Path("config/grbl-uno.toml"))
    return machine.model_copy(update={"axes": {**machine.axes, "a": ROTARY}})


def text(program: str) -> InlineProgram:
    return InlineProgram("test.nc", program.encode())


def played(machine: Machine, program: str) -> GrblSimulatorBoard:
    board = GrblSimulatorBoard.from_machine(machine)
    report = run(text(program), machine, board=board)
    assert report.ok, report.faults
    return board


def test_feed_is_along_x_y_z_while_a_turns_with_it(four_axes):
    """The board takes F along all axes, so the F word grows with the turn."""
    rng = random.Random(7)
    program, expected, at = ["G21 G90 G0 X50 Y50 Z0 A0"], [], np.array([50.0, 50.0, 0.0, 0.0])
    for _ in range(40):
        step = np.array([*(rng.uniform(-3.0, 3.0) for _ in range(3)), rng.uniform(-9.0, 9.0)])
        end = np.round(np.clip(at + step, [10, 10, -20, -900], [90, 90, 10, 900]), 3)
        feed = rng.choice((120.0, 300.0, 700.0))
        x, y, z, a = end.tolist()
        program.append(f"G1 X{x:.3f} Y{y:.3f} Z{z:.3f} A{a:.3f} F{feed:g}")
        seconds = math.dist(end[:3], at[:3]) / (feed / 60.0)
        expected.append((end, max(seconds, abs(end[3] - at[3]) / ROTARY.max_velocity)))
        at = end
    board = played(four_axes, "\n".join([*program, "M2"]))
    moves = [move for move in board.simulator.moves if move.kind == "feed"]
    assert len(moves) == len(expected)
    for move, (end, seconds) in zip(moves, expected, strict=True):
        assert move.end == pytest.approx(end, abs=0.01)
        assert move.length / move.programmed == pytest.approx(seconds, rel=2e-3)


def test_an_axis_that_does_not_home_has_no_ends(tmp_path: Path) -> None:
    """``boards > mill.toml`` of grblHAL with homing of X, Y and Z, and soft limits."""
    simulator = GrblSimulator(
        GRBLHAL.with_axes("XYZA"), settings=HOMING | {22: 7.0, 113: 3600.0, 123: 500.0}
    )
    port = GrblSimulatorPort(simulator)
    link = GrblLink(port, port.clock, "the simulator")
    link.connect()
    (tmp_path / "mill.toml").write_text(machine_file("COM3", link.info, 115200))
    made = load_machine(tmp_path / "mill.toml")
    assert made.axes["a"].travel is None
    assert made.axes["x"].travel == (-200.0, 0.0)
    board = GrblBoard(port, made, port.clock, "the simulator")
    board.connect()
    program = "G21 G90\nG0 X-20 Y-20\nG1 A400 F3000\nG1 A-90 X-30\nM2\n"
    report = run(text(program), made, RunOptions(home=True), board=board)
    assert report.ok, report.faults
    assert simulator.position == pytest.approx((-30.0, -20.0, -1.0, -90.0), abs=0.01)


def test_a_alone_turns_by_degrees_a_minute(four_axes):
    board = played(four_axes, "G21 G90 G1 A90 F1800\nM2\n")
    (move,) = board.simulator.moves
    assert (move.end, move.programmed) == ((0.0, 0.0, 0.0, 90.0), 30.0)


def test_an_arc_with_a_turn_becomes_lines_within_the_tolerance(four_axes):
    board = played(four_axes, "G21 G90 G0 X50 Y50\nG2 X70 Y50 I10 J0 A90 F600\nM2\n")
    corners = np.array([m.end for m in board.simulator.moves if m.kind == "feed"])
    assert np.abs(np.linalg.norm(corners[:, :2] - [60.0, 50.0], axis=1) - 10.0).max() < 0.005
    chords = np.linalg.norm(np.diff(corners[:, :2], axis=0), axis=1)
    assert 10.0 - np.sqrt(100.0 - (chords.max() / 2.0) ** 2) < four_axes.path.tolerance
    turned = np.degrees(np.arctan2(corners[:, 1] - 50.0, 60.0 - corners[:, 0]))
    assert corners[:, 3] == pytest.approx(turned / 2.0, abs=0.01)


def test_the_work_offset_of_a_is_the_boards(four_axes):
    simulator = GrblSimulator(GRBLHAL.with_axes("XYZA"), settings={})
    port = GrblSimulatorPort(simulator)
    port.read(2.0)
    port.write(b"G10 L2 P1 X1 A15\n")
    port.read(0.5)
    board = GrblBoard(port, four_axes, port.clock, NAME)
    board.connect()
    assert board.work_offset == (1.0, 0.0, 0.0, 15.0)
    report = run(text("G21 G90 G0 A30\nM2\n"), four_axes, board=board)
    assert report.ok and simulator.position[3] == 45.0
    assert report.end_position["a"] == 45.0


def test_a_stop_and_the_probe_keep_a_where_it_is(four_axes):
    board = GrblSimulatorBoard.from_machine(four_axes)
    board.simulator.core.environment.workpiece = Workpiece((HalfSpace((0.0, 0.0, 1.0), -5.0),))
    program = "G21 G90 G0 A90\nG38.2 Z-20 F200\nG91 G0 Z2\nG90\nG38.2 Z-20 F50\nG0 Z5 A0\nM2\n"
    assert run(text(program), four_axes, board=board).ok
    assert board.simulator.position == (0.0, 0.0, 5.0, 0.0)


@pytest.mark.parametrize(
    ("profile", "axes"),
    [(GRBL, "X, Y, Z"), (GRBLHAL.with_axes("XYZB"), "X, Y, Z, B")],
)
def test_a_board_without_the_axis_is_refused(four_axes, profile, axes):
    simulator = GrblSimulator(profile)
    port = GrblSimulatorPort(simulator)
    with pytest.raises(BoardError) as caught:
        GrblBoard(port, four_axes, port.clock, NAME).connect()
    assert caught.value.diagnostic.code == "board-axes"
    assert f"has an axis A; the board has {axes}" in caught.value.diagnostic.message


def test_settings_and_reports_of_six_axes():
    bench = Bench(GRBLHAL.with_axes("XYZABC"))
    lines = bench.send("$$\n$I\n$#\n", 2.0)
    assert "$105=250.000" in lines and "$133=200.000" in lines
    assert "[AXS:6:XYZABC]" in lines and "[OPT:VNMSL,35,1024,6,0]" in lines
    assert "[G54:0.000,0.000,0.000,0.000,0.000,0.000]" in lines
    assert bench.reply("$376=7") == "ok"
    assert bench.send("G20 G1 B10 F5 A-2\n", 0.1)[0] == "ok"
    bench.finish()
    # inches do not scale degrees
    assert bench.simulator.position == (0.0, 0.0, 0.0, -2.0, 10.0, 0.0)
    assert bench.reply("$J=G91 C5 F100") == "ok"


def test_grbl_refuses_a_word_of_a_fourth_axis():
    assert Bench().reply("G1 A10 F100") == "error:20"


@pytest.mark.parametrize(
    ("mask", "reported"),
    [(1, "0.3937,0.0000,-0.1969,90.000"), (0, "0.3937,0.0000,-0.1969,3.5433")],
)
def test_inches_in_reports_do_not_scale_rotary_axes(four_axes, mask, reported):
    """``$376`` names the rotary axes; by default grblHAL takes A for one more axis of lengths."""
    settings = {13: 1.0, 376: float(mask)}
    simulator = GrblSimulator(GRBLHAL.with_axes("XYZA"), settings=settings)
    simulator.core.environment.workpiece = Workpiece((HalfSpace((0.0, 0.0, 1.0), -5.0),))
    port = GrblSimulatorPort(simulator)
    board = GrblBoard(port, four_axes, port.clock, NAME)
    board.connect()
    program = "G21 G90 G10 L2 P1 A15\nG0 A75\nG0 X10\nG38.2 Z-20 F100\nG0 Z-5\nM2\n"
    report = run(text(program), four_axes, board=board)
    assert report.ok, report.faults
    assert simulator.position == pytest.approx((10.0, 0.0, -5.0, 90.0), abs=0.01)
    assert report.end_position == pytest.approx({"x": 10, "y": 0, "z": -5, "a": 90}, abs=0.02)
    board.operation.read_offsets()
    assert board.work_offset == pytest.approx((0.0, 0.0, 0.0, 15.0), abs=0.01)
    assert f"MPos:{reported}" in status_report(simulator.core)


@pytest.mark.parametrize(
    ("info", "expected"),
    [
        (
            BoardInfo("1.1f", Firmware.HAL, settings={13: "1", 376: "2"}),
            (25.4, 25.4, 25.4, 25.4, 1.0),
        ),
        (BoardInfo("1.1f", Firmware.HAL, settings={13: "1"}), (25.4, 25.4, 25.4, 25.4, 25.4)),
        (BoardInfo("3.7", Firmware.FLUID, settings={13: "1"}), (25.4, 25.4, 25.4, 1.0, 1.0)),
    ],
)
def test_offsets_are_read_in_the_units_of_their_axes(info, expected):
    info.take([Feedback("G54", "1,1,1,1,1")])
    assert info.places["G54"] == expected
