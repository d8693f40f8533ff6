"""Machines with errors in their volume: where the tool is, after the compensation of all errors."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from cnc.api import Callbacks, Control, Outputs, RunOptions, check, home
from cnc.boards.loopback import Loopback, switch_places
from cnc.machine.compensation import ErrorPoint, Squareness
from cnc.machine.error_map import read_error_map
from cnc.machine.models import Axis, Homing, Machine, PathLimits
from cnc.operate.jogging import JogMove
from cnc.operate.machines import PulseMachine
from cnc.session.run_pulses import Progress
from tests.support.boards.gantry_board import RecordedLoopback
from tests.support.faulty_machine import FaultyMachine, Floats
from tests.support.planner.legality import compare_files
from tests.support.planner.random_jobs import Job
from tests.support.session.runs import run_with
from tests.support.soak import share

SCALE = 200.0
STEP = 1.0 / SCALE
TOLERANCE = 0.002
RESTS = 1.05 * STEP
FEEDS = (600, 3000, 6000)
CIRCLE = f"""G21 G90 G17 G64 P{TOLERANCE}
G0 X30 Y-10 Z-5
G1 X25 Y0 F%d
G3 X25 Y0 I-25 J0
G1 X40 Y20
M2
"""


def bent(places: Floats) -> Floats:
    """Return errors of a machine whose ways are bent and twisted, mm."""
    x, y, z = (places / 100.0).T
    return 0.06 * np.stack(
        (
            np.sin(2.1 * y + 0.4) + 0.4 * x * z,
            np.cos(1.1 * x - 0.3) + 0.3 * np.sin(1.2 * z),
            0.7 * np.sin(0.9 * x + 1.1 * y) - 0.2 * z,
        ),
        axis=1,
    )


PLAY = {"x": 0.04, "y": 0.05}


def pitch(place: Floats) -> Floats:
    return 0.02 * np.sin(2.0 * np.pi * place / 90.0)


@pytest.fixture(scope="module")
def error_map(tmp_path_factory):
    """Return the map of the errors, measured every 15 and 20 mm."""
    grid = [np.arange(-90.0, 91.0, 15.0)] * 2 + [np.arange(-90.0, 91.0, 20.0)]
    points = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, 3)
    rows = np.random.default_rng(1).permutation(np.hstack((points, bent(points))))
    file = tmp_path_factory.mktemp("map") / "map.csv"
    lines = (",".join(f"{value:.9g}" for value in row) for row in rows.tolist())
    file.write_text("# measured\nx,y,z,dx,dy,dz\n" + "\n".join(lines) + "\n")
    return read_error_map(file)


def machine(error_map, *, others: bool = False) -> Machine:
    """Return a mill with the map; ``others`` are squareness, error table and backlash."""
    rows = tuple(ErrorPoint(float(at), *2 * [float(pitch(at))]) for at in range(-100, 101, 5))
    axes = {
        letter: Axis(
            steps_per_mm=SCALE,
            max_velocity=120.0,
            max_acceleration=900.0,
            max_jerk=20_000.0,
            travel=(-90.0, 90.0),
            error_table=rows if others and letter == "y" else None,
            backlash=PLAY.get(letter) if others else None,
        )
        for letter in "xyz"
    }
    square = Squareness(xy="0.2 deg") if others else None
    return Machine(axes=axes, path=PathLimits(max_feed=120.0)).model_copy(  # type: ignore[arg-type]
        update={"error_map": error_map, "squareness": square}
    )


def faulty(*, others: bool = False) -> FaultyMachine:
    if not others:
        return FaultyMachine(volume=bent)
    return FaultyMachine(xy=0.2, screws={"y": pitch}, backlash=PLAY, volume=bent)


def tool_on_line(pulses: Path, line: int, *, others: bool) -> Floats:
    moved = np.load(pulses)
    motors = (moved["origin_steps"] + np.cumsum(moved["step"], axis=0)) / SCALE
    return faulty(others=others).tool(motors)[moved["line"] == line]


@pytest.mark.parametrize(
    ("feed", "others"),
    share(list(product(FEEDS, (False, True))), [(FEEDS[1], False), (FEEDS[2], True)]),
)
def test_a_circle_is_one_after_compensation(error_map, feed, others, tmp_path: Path) -> None:
    program, pulses = tmp_path / "circle.ngc", tmp_path / "pulses.npz"
    program.write_text(CIRCLE % feed)
    outputs = Outputs(pulses=str(pulses))
    assert check(program, machine(None), RunOptions(outputs=outputs)).ok
    off = np.abs(np.hypot(*tool_on_line(pulses, 4, others=others)[:, :2].T) - 25.0).max()
    assert off > 5.0 * STEP
    report = run_with(
        program, machine(error_map, others=others), board=Loopback(3), outputs=outputs
    )
    assert report.ok, report.faults
    assert not any(report.violations.values())
    tool = tool_on_line(pulses, 4, others=others)
    assert np.abs(np.hypot(*tool[:, :2].T) - 25.0).max() <= STEP + TOLERANCE
    assert np.abs(tool[:, 2] + 5.0).max() <= STEP + TOLERANCE


@pytest.mark.parametrize(
    ("seed", "others"),
    share(list(product(range(20), (False, True))), [(0, False), (1, True)]),
)
def test_random_programs_keep_the_limits_of_the_motors(
    error_map, seed, others, tmp_path: Path
) -> None:
    fresh = share(int(np.random.default_rng().integers(2**32)), 1)
    dice = np.random.default_rng([fresh, seed])
    program, blocks, trace, pulses = (
        tmp_path / name for name in ("part.nc", "blocks.jsonl", "trace.npz", "pulses.npz")
    )
    program.write_text("G21 G90 G17\n" + Job(dice, 8.0).write())
    outputs = Outputs(blocks=str(blocks), trace=str(trace), pulses=str(pulses))
    known = machine(error_map, others=others)
    report = check(program, known, RunOptions(outputs=outputs))
    assert report.ok, (fresh, seed, report.faults)
    moved = dict(np.load(pulses).items())
    motors = (moved["origin_steps"] + np.cumsum(moved["step"], axis=0)) / SCALE
    if len(motors):
        begin = np.vstack((moved["origin_steps"] / SCALE, motors))
        tool = faulty(others=others).tool(begin)[1:]
        assert np.abs(tool - moved["tip"]).max() <= 0.002
    # The motors push their nuts up behind the motion.
    within = moved["time_ns"] <= report.duration_s * 1e9 + 1e3
    for name in ("time_ns", "step", "line", "position", "tip"):
        moved[name] = moved[name][within]
    np.savez(pulses, **moved)
    found = compare_files(blocks, trace, pulses, known, report.duration_s)
    assert not found.wrong, (fresh, seed, found.wrong)


def test_motion_along_one_axis_takes_up_the_play_of_another(error_map, tmp_path: Path) -> None:
    """The map lets X turn back on the way along Y: its nut follows."""
    program, pulses = tmp_path / "line.ngc", tmp_path / "pulses.npz"
    program.write_text("G21 G90\nG0 X0 Y-80 Z0\nG1 Y80 F1500\nY-80\nM2\n")
    known = machine(error_map, others=True).model_copy(update={"squareness": None})
    report = check(program, known, RunOptions(outputs=Outputs(pulses=str(pulses))))
    assert report.ok, report.faults
    assert not any(report.violations.values())
    moved = np.load(pulses)
    motors = (moved["origin_steps"] + np.cumsum(moved["step"], axis=0)) / SCALE
    tool = replace(faulty(others=True), xy=0.0).tool(motors)
    for line in (3, 4):
        off = np.abs(tool[moved["line"] == line])
        assert off[:, 0].max() <= STEP + TOLERANCE
        assert off[:, 2].max() <= STEP + TOLERANCE


@pytest.mark.parametrize("others", share([False, True], [True]))
def test_positions_are_true_places(error_map, others, tmp_path: Path) -> None:
    """After homing, a program, a stop and a jog; the travel is one of true places."""
    plain = machine(error_map, others=others)
    homing = Homing(end="high", seek=40.0, latch=10.0, pull_off=1.0)
    axes = {
        letter: axis.model_copy(update={"homing": homing}) for letter, axis in plain.axes.items()
    }
    known = plain.model_copy(update={"axes": axes})
    board = RecordedLoopback(known, switch_places(known))

    def tool() -> Floats:
        made = np.cumsum(np.concatenate([rows for _, rows in board.rows_sent]), axis=0)
        motors = (made - made[-1] + board.position_steps) / SCALE
        return faulty(others=others).tool(motors)[-1]

    def shown() -> list[float]:
        position = PulseMachine(board, known).readings().position
        return [position[letter] for letter in "xyz"]

    place = home(known, (), board=board)
    assert [place[letter] for letter in "xyz"] == pytest.approx([90.0] * 3, abs=STEP)
    assert np.abs(tool() - 90.0).max() <= RESTS
    program, control = tmp_path / "part.ngc", Control()

    def on_sent(sent: Progress) -> None:
        if sent.line == 3:
            control.stop()

    program.write_text("G21 G90\nG1 X60 Y-45 Z-20 F4000\nG1 X61 F10\nM2\n")
    report = run_with(
        program, known, board=board, control=control, callbacks=Callbacks(on_sent=on_sent)
    )
    assert report.end_position is not None
    assert np.abs(tool() - list(report.end_position.values())).max() <= RESTS
    assert np.abs(tool() - shown()).max() <= RESTS
    board.revive()
    move = JogMove(dict(zip("xyz", shown(), strict=True)), {"x": 3.0, "y": 30.0}, 20.0)
    PulseMachine(board, known).jog(move, Control(), lambda _: None)
    assert np.abs(tool()[:2] - [3.0, 30.0]).max() <= RESTS
    assert np.abs(tool() - shown()).max() <= RESTS
    program.write_text("G21 G90\nG0 X89.99 Y89.99 Z-89.99\nM2\n")
    assert check(program, known).ok
    program.write_text("G21 G90\nG0 X90.02 Y0\nM2\n")
    (fault,) = check(program, known).faults
    assert fault.diagnostic.code == "soft-limit"
