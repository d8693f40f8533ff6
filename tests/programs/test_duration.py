"""The estimated time of a program equals its time on the loopback board."""

from pathlib import Path

import numpy as np
import pytest

from cnc.api import check, load_machine, run
from cnc.boards.loopback import Loopback
from cnc.machine.models import Machine
from cnc.model.blocks import Dwell, End
from cnc.model.streams import PulseChunk
from cnc.session.options import RunOptions
from tests.support.paths import ROOT
from tests.support.programs.random_programs import random_program
from tests.support.soak import share


class Clock(Loopback):
    """A board that keeps the times of its commands and pulses."""

    def __init__(self, machine: Machine) -> None:
        super().__init__(len(machine.axes), 1e9 / machine.board.max_step_rate)
        self.times: list[np.ndarray] = []

    def send(self, chunk: PulseChunk) -> None:
        super().send(chunk)
        self.times.append(chunk.time_ns)


def rest(machine: Machine) -> float:
    """Seconds that the way of a step to rest takes, twice: a jerk J goes it in the cube root of 6 /
    J from or to rest.
    """
    return max(
        2.0
        * (6.0 / axis.steps_per_mm / (axis.max_jerk or machine.path.max_jerk or np.inf))
        ** (1.0 / 3.0)
        for axis in machine.axes.values()
    )


def held(program: Path, machine: Machine) -> None:
    """Compare the estimate with the times of the board's commands and pulses."""
    report = check(program, machine)
    assert report.ok, report.findings
    board = Clock(machine)
    played = run(program, machine, board=board)
    assert played.ok
    period = machine.path.period
    assert played.duration_s == pytest.approx(report.duration_s, abs=period)
    ends = [time * 1e-9 for time, block in board.commands if isinstance(block, End)]
    assert ends == [pytest.approx(report.duration_s, abs=period)]
    times = np.concatenate(board.times) if board.times else np.zeros(0, np.int64)
    assert len(times) == report.pulse_rows
    if len(times):
        last = float(times[-1]) * 1e-9
        assert last <= report.duration_s + period
        if not any(isinstance(block, Dwell) for _, block in board.commands):
            assert last >= report.duration_s - rest(machine) - period


@pytest.mark.parametrize(
    ("name", "machine"),
    [
        ("trident", "paper-nurbs"),
        *share([(name, "default") for name in ("drilling", "bezier", "engraving")], []),
    ],
)
def test_a_shipped_program_takes_as_long_as_estimated(name, machine):
    held(ROOT / "programs" / f"{name}.nc", load_machine(machine))


@pytest.mark.parametrize("seed", range(share(300, 3)))
def test_a_random_program_takes_as_long_as_estimated(seed, tmp_path):
    """Lines, arcs, splines and dwells, in every mode of path control."""
    file = tmp_path / "p.nc"
    file.write_text(random_program(seed))
    held(file, load_machine("default"))


def test_a_thread_in_two_moves_takes_the_time_of_one(tmp_path: Path) -> None:
    """A rest between the moves would shift the second one against the spindle."""
    begin, end = "G21 G18 G97 S600 M3\nG0 X40 Z5\n", "\nG0 X60\nM2\n"
    durations = []
    for moves in ("G33 Z-30 K2", "G33 Z-20 K2\nZ-30 K2"):
        file = tmp_path / "thread.ngc"
        file.write_text(begin + moves + end)
        machine = load_machine(ROOT / "config" / "lathe.toml")
        report = check(file, machine, RunOptions(dialect="linuxcnc"))
        durations.append(report.duration_s)
    assert durations[1] == pytest.approx(durations[0], abs=1e-6)
