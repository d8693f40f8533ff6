"""Plans that the board cannot play are refused before motion, with the board and without."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.boards.stepper.driver import Stepper
from cnc.boards.stepper.feasibility import LATE_NS, StepperFeasibility
from cnc.boards.stepper.outputs import MotorOutputs
from cnc.cli import exit_code
from cnc.machine.models import Machine
from cnc.model.diagnostics import CncError
from cnc.model.streams import PulseChunk
from tests.support.boards.stepper_rig import chunks, line, machine, wander, with_axes
from tests.support.boards.stepper_simulator import Simulator, SimulatorPort
from tests.support.session.runs import check_with, run_with

LEAST_NS = 18_000


def bear(gap_ns: int, rows: int, baud: int = 1_000_000) -> StepperFeasibility:
    feasibility = StepperFeasibility(MotorOutputs(with_axes(3)), LEAST_NS, baud)
    time_ns, step = line(rows, gap_ns)
    for part in chunks(time_ns, step):
        feasibility.add(part)
    return feasibility


def test_short_bursts_pass_and_long_ones_are_refused() -> None:
    """n moves at an interval of g are late by n * (least - g)."""
    rows = LATE_NS // (LEAST_NS - 10_000)
    assert bear(10_000, rows).most_late_ns == (rows - 1) * (LEAST_NS - 10_000) + LEAST_NS - 10_000
    with pytest.raises(CncError) as caught:
        bear(10_000, rows + 2)
    assert caught.value.diagnostic.code == "board-step-rate"
    assert caught.value.diagnostic.line == rows + 1
    assert bear(LEAST_NS, 20_000).most_late_ns == 0


def test_random_moves_need_a_fast_line() -> None:
    time_ns, step = wander(1, 4_000, 60_000)
    fast = StepperFeasibility(MotorOutputs(with_axes(3)), LEAST_NS, 1_000_000)
    slow = StepperFeasibility(MotorOutputs(with_axes(3)), LEAST_NS, 40_000)
    for part in chunks(time_ns, step):
        fast.add(part)

    def all_of_it() -> None:
        for part in chunks(time_ns, step):
            slow.add(part)

    with pytest.raises(CncError) as caught:
        all_of_it()
    assert caught.value.diagnostic.code == "board-too-dense"
    assert caught.value.diagnostic.hint


def test_empty_chunk_passes() -> None:
    feasibility = StepperFeasibility(MotorOutputs(with_axes(3)), LEAST_NS, 1_000_000)
    feasibility.add(
        PulseChunk(np.zeros(0, np.int64), np.zeros((0, 3), np.int8), np.zeros(0, np.int32))
    )
    assert feasibility.most_late_ns == 0


def dense() -> Machine:
    """45 000 steps/s on each of three axes.

    Half steps share rows; crossings need a row for each axis.
    """
    known = machine()
    quick = {
        "max_velocity": 45.0,
        "max_acceleration": 4000.0,
        "max_jerk": 300_000.0,
        "steps_per_mm": 1000.0,
    }
    axes = {letter: axis.model_copy(update=quick) for letter, axis in known.axes.items()}
    board = known.board.model_copy(update={"max_step_rate": 55_000.0})
    return known.model_copy(
        update={
            "axes": axes,
            "board": board,
            "path": known.path.model_copy(update={"max_feed": 80.0}),
        }
    )


PROGRAM = "G21 G90\nG1 X1 F600\nG1 X8.1 Y7.3 Z6.77 F4000\nM2\n"


@pytest.mark.parametrize(("algorithm", "codes"), [(None, []), ("crossings", ["board-too-dense"])])
def test_refused_programs_do_not_reach_the_board(
    tmp_path: Path, algorithm, codes: list[str]
) -> None:
    (tmp_path / "p.ngc").write_text(PROGRAM)
    checked = check_with(tmp_path / "p.ngc", dense(), algorithm=algorithm)
    simulator = Simulator()
    port = SimulatorPort(simulator)
    board = Stepper(port, dense(), "the simulator", clock=port)
    ran = run_with(tmp_path / "p.ngc", dense(), board=board, algorithm=algorithm)
    board.close()
    for report in (checked, ran):
        assert [fault.diagnostic.code for fault in report.faults] == codes
        assert report.exit_code == (1 if codes else 0)
        if codes:
            assert report.faults[0].diagnostic.line == 3
            assert report.faults[0].diagnostic.file == str(tmp_path / "p.ngc")
    assert bool(len(simulator.moves()[0])) != bool(codes)
    simulator.close()


@pytest.mark.parametrize(
    ("letters", "velocity", "code"),
    [
        ("xyz", 100, "board-step-rate"),
        ("xzy", 10, "board-axes"),
        ("xz", 10, "board-axes"),
        ("xyzab", 10, "board-axes"),
        ("xyzu", 10, ""),
        ("xy", 10, ""),
    ],
)
def test_unsuitable_machine_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], letters: str, velocity: int, code: str
) -> None:
    """The machine file alone is enough: it is too fast, or its axes or their order differ from the
    board's.
    """
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X1 F600\nM2\n")
    text = "".join(
        f"[axes.{letter}]\nsteps_per_mm = 1000\nmax_velocity = {velocity}\n"
        "max_acceleration = 4000\nmax_jerk = 300000\n"
        for letter in letters
    )
    (tmp_path / "m.toml").write_text(text + '[board]\nkind = "stepper"\nmax_step_rate = 200000\n')
    assert exit_code(
        ["check", str(tmp_path / "p.ngc"), "--machine", str(tmp_path / "m.toml"), "--quiet"]
    ) == (1 if code else 0)
    assert code in capsys.readouterr().err
