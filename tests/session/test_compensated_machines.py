"""Machines with errors: where the tool is, after the compensation of what their file states."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cnc.api import Callbacks, Control, Outputs, Report, RunOptions, check, home
from cnc.boards.loopback import Loopback, switch_places
from cnc.boards.registry import open_board
from cnc.machine.compensation import ErrorPoint, Squareness
from cnc.machine.models import Axis, Homing, Machine, PathLimits
from cnc.model.blocks import Block, Dwell
from cnc.operate.jogging import JogMove
from cnc.operate.machines import PulseMachine
from cnc.planner.joints import Joints
from cnc.session.run_pulses import Progress
from tests.support.boards.gantry_board import RecordedLoopback
from tests.support.boards.klipper_rig import played, steps_of, with_board
from tests.support.faulty_machine import FaultyMachine, pushed
from tests.support.planner.legality import compare_files
from tests.support.planner.random_jobs import Job
from tests.support.session.runs import run_with
from tests.support.soak import share

Floats = NDArray[np.float64]
SCALE = 200.0
STEP = 1.0 / SCALE
TOLERANCE = 0.002
RESTS = 1.05 * STEP
"""Distance of the tool from the place of the program at rest: half a step of each of 3 motors."""
FEEDS = (600, 3000, 6000)
CIRCLE = f"""G21 G90 G17 G64 P{TOLERANCE}
G0 X30 Y-10 Z-5
G1 X25 Y0 F%d
G3 X25 Y0 I-25 J0
G1 X40 Y20
M2
"""
LIMITS = {"max_acceleration": 900.0, "max_jerk": 20_000.0}


def wave(size: float, length: float):
    """Return an error of a screw that returns after ``length``, mm."""
    return lambda place: size * np.sin(2.0 * np.pi * place / length + 0.4)


PITCH = {"x": wave(0.03, 70.0), "y": wave(-0.02, 95.0)}
PLAY = {"x": 0.04, "y": 0.05, "z": 0.03}
LEAN = {"xy": 0.2, "xz": -0.1, "yz": 0.15}
FAULTY = FaultyMachine(**LEAN, screws=PITCH, backlash=PLAY)


def table(letter: str) -> tuple[ErrorPoint, ...]:
    """Return the errors of a screw, measured every 5 mm."""
    errors = PITCH[letter]
    return tuple(
        ErrorPoint(float(place), float(errors(place)), float(errors(place)))
        for place in range(-100, 101, 5)
    )


def machine(*, compensated: bool = True, **changes: object) -> Machine:
    """Return a mill, of which the file states the errors of FAULTY."""
    axes = {
        letter: Axis(
            steps_per_mm=SCALE,
            max_velocity=120.0,
            travel=(-90.0, 90.0),
            error_table=table(letter) if compensated and letter in PITCH else None,
            backlash=PLAY[letter] if compensated else None,
            **LIMITS,
        )
        for letter in "xyz"
    }
    square = Squareness(**{pair: f"{angle} deg" for pair, angle in LEAN.items()})
    return Machine(axes=axes, path=PathLimits(max_feed=120.0)).model_copy(  # type: ignore[arg-type]
        update={"squareness": square if compensated else None, **changes}
    )


def off_circle(tool: Floats) -> float:
    """Return the largest distance from the programmed circle, mm."""
    return float(np.abs(np.hypot(tool[:, 0], tool[:, 1]) - 25.0).max())


def tool_on_line(pulses: Path, line: int) -> Floats:
    """Return the places of the tool of the faulty machine after each step of a line."""
    moved = np.load(pulses)
    motors = (moved["origin_steps"] + np.cumsum(moved["step"], axis=0)) / SCALE
    return FAULTY.tool(motors)[moved["line"] == line]


def test_a_file_has_the_motion_and_the_take_up_behind_it(tmp_path: Path) -> None:
    program, file = tmp_path / "part.ngc", tmp_path / "file.npz"
    program.write_text("G21 G90\nG1 X5 F600\nX2\nM2\n")
    known = machine()
    with closing(open_board(known, kind="file", port=str(file))) as board:
        assert run_with(program, known, board=board).ok
    moved = dict(np.load(file).items())
    x = moved["step"][:, 0].astype(np.int64)
    # The motor goes 5 mm and 3 mm on a screw that is longer by the slope of its wave at 2 mm. It
    # takes up the play at the turn, and at the end once more.
    ways = 8.0 * (1.0 - 0.03 * 2.0 * np.pi / 70.0 * np.cos(0.4 + 2.0 * np.pi * 2.0 / 70.0))
    assert np.abs(x).sum() == pytest.approx((ways + 2.0 * PLAY["x"]) * SCALE, abs=2)
    assert x.sum() == pytest.approx(2.0 * SCALE, abs=2)


@pytest.mark.parametrize("feed", share(FEEDS, FEEDS[:1]))
def test_a_circle_is_one_after_compensation(feed: int, tmp_path: Path) -> None:
    program, pulses = tmp_path / "circle.ngc", tmp_path / "pulses.npz"
    program.write_text(CIRCLE % feed)
    outputs = Outputs(pulses=str(pulses))
    assert check(program, machine(compensated=False), RunOptions(outputs=outputs)).ok
    assert off_circle(tool_on_line(pulses, 4)) > 10.0 * STEP
    board = Loopback(3)
    report = run_with(program, machine(), board=board, outputs=outputs)
    assert report.ok, report.faults
    assert not any(report.violations.values())
    tool = tool_on_line(pulses, 4)
    assert off_circle(tool) <= STEP + TOLERANCE
    # The blends at both ends are at X25: the other quadrants have the marks of reversals alone.
    assert off_circle(tool[tool[:, 0] < 22.0]) <= STEP


def test_a_circle_on_a_klipper_board_is_one(tmp_path: Path) -> None:
    """The edges of the motors' pins lead the tool."""
    program = tmp_path / "circle.ngc"
    program.write_text(CIRCLE % FEEDS[1])
    known = with_board(machine())
    report, simulator = played(program, tmp_path, known)
    assert report.ok, report.faults
    moves = [(*steps_of(known.of_joints, simulator, letter), k) for k, letter in enumerate("xyz")]
    clock = np.concatenate([clock for clock, _, _ in moves])
    step = np.concatenate([sign[:, None] * np.eye(3, dtype=int)[k] for _, sign, k in moves])
    origin = np.load(tmp_path / "pulses.npz")["origin_steps"]
    motors = origin + np.cumsum(step[np.argsort(clock, kind="stable")], axis=0)
    tool = FAULTY.tool(motors / SCALE)
    radius = np.hypot(tool[:, 0], tool[:, 1])
    angle = np.unwrap(np.arctan2(tool[:, 1], tool[:, 0]))
    # The circle is the one turn behind X25 Y0.
    begin = int(np.flatnonzero((radius < 25.0 + STEP) & (tool[:, 2] < -4.9))[0])
    turn = (angle > angle[begin] + 0.05) & (angle < angle[begin] + 2.0 * np.pi - 0.05)
    turn[:begin] = False
    assert turn.sum() > 10_000
    assert np.abs(radius[turn] - 25.0).max() <= STEP + TOLERANCE


def _check_take_up(moved: dict[str, NDArray[np.int64]], duration: float) -> None:
    """Check that behind the motion the motors push their nuts up, and no tool moves."""
    motors = (moved["origin_steps"] + np.cumsum(moved["step"], axis=0)) / SCALE
    if not len(motors):
        return
    behind = moved["time_ns"] > duration * 1e9 + 1e3
    assert (moved["step"][behind] >= 0).all()
    tool = FAULTY.tool(np.vstack((moved["origin_steps"] / SCALE, motors)))[1:]
    assert np.abs(tool - moved["tip"]).max() <= 1e-3, "the table lies within 1 um of the wave"
    assert np.abs(tool[behind] - tool[~behind][-1]).max(initial=0.0) <= RESTS
    for motor, play in zip(motors.T, PLAY.values(), strict=True):
        assert abs(motor[-1] - pushed(motor, play, 0.0)[-1] - 0.5 * play) <= 2.0 * STEP


@pytest.mark.parametrize("seed", range(share(20, 1)))
def test_random_programs_keep_the_limits_of_the_motors(seed: int, tmp_path: Path) -> None:
    fresh = share(int(np.random.default_rng().integers(2**32)), 1)
    dice = np.random.default_rng([fresh, seed])
    program, blocks, trace, pulses = (
        tmp_path / name for name in ("part.nc", "blocks.jsonl", "trace.npz", "pulses.npz")
    )
    program.write_text("G21 G90 G17\n" + Job(dice, 8.0).write())
    outputs = Outputs(blocks=str(blocks), trace=str(trace), pulses=str(pulses))
    report = check(program, machine(), RunOptions(outputs=outputs))
    assert report.ok, (fresh, seed, report.faults)
    moved = dict(np.load(pulses).items())
    _check_take_up(moved, report.duration_s)
    within = moved["time_ns"] <= report.duration_s * 1e9 + 1e3
    for name in ("time_ns", "step", "line", "position", "tip"):
        moved[name] = moved[name][within]
    np.savez(pulses, **moved)
    found = compare_files(blocks, trace, pulses, machine(), report.duration_s)
    assert not found.wrong, (fresh, seed, found.wrong)


def test_positions_are_true_places(tmp_path: Path) -> None:
    """The board counts the motors; the report and the console show the tool."""
    program = tmp_path / "part.ngc"
    program.write_text("G21 G90\nG1 X60 Y-45 Z-20 F4000\nG1 X61 F10\nM2\n")
    board, control = Loopback(3), Control()

    def on_sent(sent: Progress) -> None:
        if sent.line == 3:
            control.stop()

    report = run_with(
        program, machine(), board=board, control=control, callbacks=Callbacks(on_sent=on_sent)
    )
    place = FAULTY.tool(board.position_steps[None] / SCALE)[0]
    assert report.end_position is not None
    stopped = [report.end_position[letter] for letter in "xyz"]
    assert np.abs(place - stopped).max() < 1e-3, "the table lies within 1 um of the wave"
    assert np.abs(place - [60.0, -45.0, -20.0]).max() < 0.5
    operated = PulseMachine(board, machine())
    shown = operated.readings().position
    assert [shown[letter] for letter in "xyz"] == pytest.approx(stopped, abs=1e-9)


HIGH = Homing(end="high", seek=40.0, latch=10.0, pull_off=1.0)
LOW = HIGH.model_copy(update={"end": "low"})


def with_switches() -> Machine:
    """Return the machine with switches at the low end of X, and the high ends of Y and Z."""
    known = machine()
    homing = {"x": LOW, "y": HIGH, "z": HIGH}
    axes = {k: axis.model_copy(update={"homing": homing[k]}) for k, axis in known.axes.items()}
    return known.model_copy(update={"axes": axes})


class Shop:
    """The faulty machine behind a board with switches, and all steps that its motors have made."""

    def __init__(self, folder: Path, known: Machine) -> None:
        self.machine, self.folder = known, folder
        self.board = RecordedLoopback(known, switch_places(known))
        self.origin = self.board.position_steps

    @property
    def motors(self) -> Floats:
        """The places of the motors since the begin (n, 3), as homing has set their zero, mm."""
        made = np.cumsum(np.concatenate([rows for _, rows in self.board.rows_sent]), axis=0)
        return (made - made[-1] + self.board.position_steps) / SCALE

    @property
    def tool(self) -> Floats:
        """The place of the tool (3,), mm."""
        return FAULTY.tool(self.motors)[-1]

    @property
    def shown(self) -> list[float]:
        """The place that an operator sees."""
        position = PulseMachine(self.board, self.machine).readings().position
        return [position[letter] for letter in "xyz"]

    def run(self, text: str, **options: object) -> Report:
        (self.folder / "part.ngc").write_text(text)
        return run_with(self.folder / "part.ngc", self.machine, board=self.board, **options)


@pytest.fixture
def shop(tmp_path: Path) -> Shop:
    """Return a shop whose machine is homed."""
    made = Shop(tmp_path, with_switches())
    found = home(made.machine, (), board=made.board)
    assert [found[letter] for letter in "xyz"] == pytest.approx([-90.0, 90.0, 90.0], abs=STEP)
    return made


def test_the_tool_is_at_home_after_homing(shop: Shop) -> None:
    """The pull-off from the switches of Y and Z leads down: the motors take up the play."""
    assert np.abs(shop.tool - [-90.0, 90.0, 90.0]).max() <= RESTS
    assert abs(shop.motors[-1, 0] + 90.0) > 0.1, "X makes up for the lean of Y"
    assert shop.run("G21 G90\nG0 X0 Y0 Z0\nG0 X-90 Y90 Z90\nM2\n").ok
    assert np.abs(shop.tool - [-90.0, 90.0, 90.0]).max() <= RESTS


def test_the_display_has_the_place_of_the_tool_at_rest(shop: Shop) -> None:
    """After a program, a jog and a stop that end downwards; the next motion begins there."""
    assert shop.run("G21 G90\nG1 X10 Y10 Z10 F5000\nX5 Y4 Z3\nM2\n").ok
    assert np.abs(shop.tool - [5.0, 4.0, 3.0]).max() <= RESTS
    assert np.abs(shop.tool - shop.shown).max() <= RESTS
    operated = PulseMachine(shop.board, shop.machine)
    operated.jog(
        JogMove(dict(zip("xyz", shop.shown, strict=True)), {"x": 3.0}, 20.0),
        Control(),
        lambda _: None,
    )
    assert np.abs(shop.tool - [3.0, 4.0, 3.0]).max() <= RESTS
    assert np.abs(shop.tool - shop.shown).max() <= RESTS
    control = Control()

    def stop(sent: Progress) -> None:
        if sent.line == 2 and sent.rows > 700:
            control.stop()

    report = shop.run(
        "G21 G90\nG1 X-30 Y-40 Z-5 F6000\nM2\n",
        control=control,
        callbacks=Callbacks(on_sent=stop),
    )
    assert report.end_position is not None
    assert np.abs(shop.tool - list(report.end_position.values())).max() <= RESTS
    assert np.abs(shop.tool - shop.shown).max() <= RESTS
    shop.board.revive()
    assert shop.run("G21 G90\nG1 X20 F5000\nX1\nM2\n").ok
    assert abs(shop.tool[0] - 1.0) <= RESTS


def test_the_display_follows_the_tool_in_motion(shop: Shop) -> None:
    """Where nuts turn twice between two reports, it is off by the play at most."""
    text = "G21 G90 F4000\n" + "G1 X2 Y1 Z1\nX-1 Y0 Z0\n" * 2 + "M2\n"
    assert shop.run("G21 G90\nG0 X0 Y0 Z0\nM2\n").ok
    begun, before = len(shop.motors), shop.motors[-1]
    assert shop.run(text).ok
    motors, tool = shop.motors, FAULTY.tool(shop.motors)
    for every, allowed in ((1, 1e-3), (40, max(PLAY.values()) + 1e-3)):
        tips = Joints(shop.machine).tips_from(before)
        shown = tips(motors[begun::every])
        assert np.abs(tool[begun::every] - shown).max() <= allowed


def test_each_stop_of_an_exact_path_is_at_its_place(shop: Shop) -> None:
    """Turns back on a line, with and without motion of other axes; every stop is one step near."""
    dice = np.random.default_rng(share(None, 5))
    places = np.round(np.cumsum(dice.uniform(-3.0, 3.0, (share(60, 12), 3)), axis=0), 3)
    places[3::4, 1] = places[2:-1:4, 1][: len(places[3::4])]
    lines = [f"X{x} Y{y} Z{z}" for x, y, z in places.tolist()]
    seen: list[Floats] = []
    execute = shop.board.execute

    def noted(block: Block, time_ns: int) -> tuple[float, ...] | None:
        if isinstance(block, Dwell):
            seen.append(shop.tool)
        return execute(block, time_ns)

    shop.board.execute = noted  # type: ignore[method-assign]
    text = "G21 G90 G61 F5000\nG1 " + "\nG4 P0\nG1 ".join([*lines, "X0 Y0 Z0"]) + "\nM2\n"
    report = shop.run(text)
    assert report.ok, report.faults
    assert not any(report.violations.values())
    assert len(seen) == len(places)
    # A nut that has just turned lags by the deviation of a window, and rounding.
    assert np.abs(np.array(seen) - places).max() <= RESTS + STEP


def test_the_travel_is_one_of_true_places(tmp_path: Path) -> None:
    """At Y90 the motor of X is 0.3 mm ahead of the tool, beyond its own travel."""
    program = tmp_path / "part.ngc"
    program.write_text("G21 G90\nG0 X89.99 Y89.99\nM2\n")
    assert check(program, machine()).ok
    program.write_text("G21 G90\nG0 X90.02 Y0\nM2\n")
    (fault,) = check(program, machine()).faults
    assert fault.diagnostic.code == "soft-limit"
    assert "X" in fault.diagnostic.message
