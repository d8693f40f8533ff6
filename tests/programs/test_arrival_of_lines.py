"""The time of short lines on a GRBL board: by theory, and in the simulator."""

from __future__ import annotations

import math
import random
from pathlib import Path

import pytest

from cnc.api import Machine, load_machine
from cnc.boards.grbl.driver import GrblBoard
from cnc.grbl_lines.board_limits import BoardLimits
from cnc.grbl_lines.grbl_timing import BoardTime
from cnc.simulators.grbl.firmware_profile import settings_of
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort
from tests.support.boards.line_reader import lines_with_effects
from tests.support.session.runs import run_with
from tests.support.soak import share

FAST = {"max_velocity": 100.0, "max_acceleration": 1500.0, "travel": None}
UNO = load_machine("grbl-uno")


def laser(baud: int) -> Machine:
    axes = {letter: axis.model_copy(update=FAST) for letter, axis in UNO.axes.items()}
    path = {"max_feed": 100.0, "max_tangential_acceleration": 1500.0}
    return UNO.model_copy(
        update={
            "kind": "laser",
            "axes": axes,
            "path": UNO.path.model_copy(update=path),
            "board": UNO.board.model_copy(update={"baud": baud}),
        }
    )


def seconds(texts: list[str], baud: int, acceleration: float = 1e6) -> float:
    limits = BoardLimits((500.0,) * 3, (acceleration,) * 3, blocks=14, baud=baud)
    clock = BoardTime(limits)
    for line in lines_with_effects(texts):
        clock.add(line)
    clock.end()
    return clock.seconds


@pytest.mark.parametrize("baud", [9600, 57600])
def test_short_lines_take_the_time_of_their_bytes_on_a_slow_wire(baud: int) -> None:
    texts = [
        "G1 F6000 X0.01 Y0 Z0 S100",
        *(f"X{0.01 * k:.2f} Y0 Z0 S{k % 9}00" for k in range(2, 2000)),
    ]
    # The last line has arrived when the motion ends; the marks are 3 bytes for 20 lines.
    size = sum(len(text) + 1.15 for text in texts[1:])
    assert seconds(texts, baud) == pytest.approx(size * 10.0 / baud, rel=0.01)


def test_short_lines_take_the_time_of_the_board_on_a_fast_wire() -> None:
    texts = ["G1 F6000 X0.01", *(f"X{0.01 * k:.2f}" for k in range(2, 2000))]
    size = sum(len(text) + 1 for text in texts[1:])
    expected = 2.1e-3 * len(texts) + 30e-6 * size
    assert seconds(texts, 1_000_000) == pytest.approx(expected, rel=0.01)


def test_moves_of_a_fluent_program_do_not_wait() -> None:
    texts = ["G1 F600 X1", *(f"X{k}" for k in range(2, 300))]
    assert seconds(texts, 115200, 100.0) == pytest.approx(299 / 10.0 + 10.0 / 100.0, rel=1e-6)


def test_a_long_move_lets_lines_gather_on_the_board() -> None:
    # The planner and the buffer hold the lines of the short moves when the long one ends.
    short = [f"X{100 + 0.01 * k:.2f}" for k in range(1, 14)]
    alone, all_lines = ["G1 F6000 X100"], ["G1 F6000 X100", *short]
    assert seconds(all_lines, 9600) == pytest.approx(seconds(alone, 9600) + 0.13 / 100.0, rel=1e-3)


def test_a_board_at_rest_begins_when_its_planner_is_full() -> None:
    """The wire brings lines faster than the board reads them: 15 moves are planned at the begin."""
    texts = ["G1 F6000 X0.01", *(f"X{0.01 * k:.2f}" for k in range(2, 16)), "X100"]
    assert seconds(texts, 1_000_000) == pytest.approx(1.0, rel=2e-3)


def test_a_move_that_is_planned_late_still_raises_the_speed() -> None:
    """The second line arrives in the middle of the first move, which then does not brake."""
    text = "X20 (" + "." * 90 + ")"
    late = (len(text) + 1.15) * 10.0 / 9600 + 30e-6 * (len(text) + 1) + 2.1e-3
    assert 0.05 < late < 0.18
    expected = 2.0 * 100.0 / 1000.0 + (20.0 - 100.0**2 / 1000.0) / 100.0
    assert seconds(["G1 F6000 X10", text], 9600, 1000.0) == pytest.approx(expected, rel=1e-3)


def raster(rng: random.Random) -> str:
    """Return a raster at an angle, with Z, longer moves or overscan in some."""
    pitch, angle = rng.choice([0.05, 0.1, 0.2]), rng.choice([0.0, 0.3, 1.0, math.pi / 2.0])
    cos, sin = math.cos(angle), math.sin(angle)
    overscan = rng.choice([0.0, 0.0, 3.0])
    tilted, longer, row = rng.random() < 0.4, rng.choice([0.0, 0.02]), rng.choice([40, 150])
    lines = ["G21 G90", "M4 S0", f"F{rng.choice([1500, 3000, 6000])}", "G0 X50 Y50"]
    u = v = 0.0
    for k in range(1000):
        if k and k % row == 0:
            v += pitch
        elif k % row == row - 1:
            u += overscan if k // row % 2 == 0 else -overscan
        else:
            step = pitch * (rng.randint(5, 40) if rng.random() < longer else 1)
            u += step if k // row % 2 == 0 else -step
        z = f" Z{-1.0 - 0.3 * math.sin(u):.3f}" if tilted else ""
        x, y = 50.0 + u * cos - v * sin, 50.0 + u * sin + v * cos
        lines.append(f"{'' if k else 'G1 '}X{x:.3f} Y{y:.3f}{z} S{rng.randint(0, 1000)}")
    return "\n".join([*lines, "M5", "M2", ""])


@pytest.mark.soak
@pytest.mark.parametrize("baud", share([115200, 57600], [57600]))
def test_rasters_take_as_long_as_in_the_simulator(tmp_path: Path, baud: int) -> None:
    program, machine = tmp_path / "p.nc", laser(baud)
    for seed in range(share(100, 2)):
        program.write_text(raster(random.Random(seed)))
        settings = settings_of(machine) | {20: 0.0, 32: 1.0}
        simulator = GrblSimulator(settings=settings, baud=baud)
        port = GrblSimulatorPort(simulator)
        board = GrblBoard(port, machine, port.clock, "the simulator")
        board.connect()
        report = run_with(program, machine, board=board)
        board.close()
        assert report.ok, report.faults
        played = simulator.moves[-1].end_time - simulator.moves[0].begin_time
        assert report.duration_s == pytest.approx(played, rel=0.015), seed
