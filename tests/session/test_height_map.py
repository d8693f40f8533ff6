"""The planned motion of a warped program against scipy's surface, and its run on boards."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from cnc.gcode.reader.parameters import write_parameters
from cnc.machine.height_map import HeightMap, save_height_map
from cnc.machine.load import load_machine
from cnc.session.options import Outputs, RunOptions
from cnc.session.session import Session
from cnc.simulators.grbl.board import GrblSimulatorBoard

DEPTH = -1.0
PROGRAM = """\
G21 G90 G94 G17 {mode}
G0 Z3
G0 X5 Y5
G1 Z{depth} F600
G1 X55 Y8 F1500
G3 X55 Y38 J15
G2 X45 Y28 I-10 J0
G1 X10 Y42
G5 I5 J5 P-5 Q5 X30 Y20
G0 Z3
M2
"""


@pytest.fixture
def bumps(tmp_path):
    """A height map of hills with slopes up to about 0.1, and its file."""
    random = np.random.default_rng(8)
    x, y = np.linspace(0.0, 75.0, 6), np.linspace(0.0, 60.0, 5)
    heights = random.uniform(-0.6, 0.6, (5, 6))
    found = HeightMap(
        x=tuple(x.tolist()),
        y=tuple(y.tolist()),
        heights=tuple(map(tuple, heights.tolist())),
        interpolation="bicubic",
    )
    file = tmp_path / "map.json"
    save_height_map(found, file)

    def height(px, py):
        of_x, of_y = (CubicSpline(k, np.eye(len(k)), bc_type="natural") for k in (x, y))
        return np.einsum("nj,ji,ni->n", of_y(py), heights, of_x(px))

    return str(file), height, found.tolerance


@pytest.mark.parametrize(("mode", "blend"), [("G61", 0.0), ("G64 P0.02", 0.02)])
def test_the_planned_motion_follows_the_surface(tmp_path, bumps, mode, blend):
    file, height, tolerance = bumps
    program, trace = tmp_path / "p.nc", tmp_path / "t.npz"
    program.write_text(PROGRAM.format(mode=mode, depth=DEPTH))
    options = RunOptions(dialect="linuxcnc", height_map=file, outputs=Outputs(trace=str(trace)))
    report = Session(program, load_machine(None), options).run()
    assert report.ok, report.faults
    assert sum(report.violations.values()) == 0
    found = np.load(trace)
    position, line = found["position"], found["line"]
    cut = (line >= 5) & (line <= 9)
    x, y, z = position[cut].T
    off = z - DEPTH - height(x, y)
    # A blend may leave the path in X and Y too, where the surface has a slope.
    assert np.abs(off).max() <= tolerance + 1.2 * blend
    assert np.ptp(height(x, y)) > 0.3
    assert report.height_map.pieces > 100
    assert report.height_map.tolerance_mm == tolerance


def test_a_grbl_board_follows_the_surface(tmp_path, bumps):
    file, height, tolerance = bumps
    machine, program = load_machine("grbl-uno"), tmp_path / "p.nc"
    program.write_text("G21 G90\nG0 Z3\nG0 X5 Y5\nG1 Z-1 F600\nG1 X55 Y8 F1500\nG0 Z3\nM2\n")
    board = GrblSimulatorBoard.from_machine(machine)
    report = Session(program, machine, RunOptions(height_map=file)).run(board, "grbl-sim")
    assert report.ok, report.faults
    ends = np.array([move.end for move in board.simulator.moves if move.kind == "feed"])
    cut = ends[1:]
    assert len(cut) > 10
    off = cut[:, 2] + 1.0 - height(cut[:, 0], cut[:, 1])
    # A step of the board, and the rounding of its lines.
    assert np.abs(off).max() <= tolerance + 0.002
    assert report.end_position["z"] == pytest.approx(
        3.0 + height(np.array([55.0]), np.array([8.0]))[0], abs=0.002
    )


@pytest.mark.parametrize(
    ("now", "expected"),
    [
        ({}, "X by -10.000 mm, Y by -5.000 mm, Z by 2.500 mm"),
        ({5221: 10.0, 5222: 5.0, 5223: -2.5}, ""),
        ({5221: 10.0, 5222: 5.0, 5223: -2.498}, ""),
        ({5221: 10.0, 5222: 5.0, 5223: -1.5}, "Z by 1.000 mm"),
        ({5221: 9.0, 5222: 5.0, 5223: -2.5, 5210: 1.0, 5211: 1.0}, ""),
        ({5221: 9.0, 5222: 5.0, 5223: -2.5, 5210: 0.0, 5211: 1.0}, "X by -1.000 mm"),
    ],
)
def test_a_zero_that_was_moved_after_the_probing_is_a_warning(tmp_path, now, expected):
    flat = HeightMap(
        x=(0.0, 80.0),
        y=(0.0, 80.0),
        heights=((0.1, 0.1), (0.1, 0.1)),
        system="G54",
        work_zero={"x": 10.0, "y": 5.0, "z": -2.5, "a": 4.0},
    )
    save_height_map(flat, tmp_path / "map.json")
    (tmp_path / "p.nc").write_text("G21 G90\nG0 X20 Y20 Z3\nM2\n")
    machine, values = load_machine(None), tmp_path / "machine.var"
    write_parameters(values, now)
    program = machine.program.model_copy(update={"parameters": values})
    machine = machine.model_copy(update={"program": program})
    options = RunOptions(height_map=str(tmp_path / "map.json"))
    report = Session(tmp_path / "p.nc", machine, options).run()
    assert report.ok, report.faults
    found = [each for each in report.warnings if each.code == "height-map-zero"]
    assert [each.message.partition(": ")[2] for each in found] == ([expected] if expected else [])
