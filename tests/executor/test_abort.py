"""``(ABORT, text)``: the moves before it are made, the machine rests there, and the run ends with
the fault.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc import cli
from cnc.api import Report, check, run
from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.loopback import Loopback
from cnc.machine.load import load_machine
from cnc.model.blocks import Probe
from cnc.model.diagnostics import BoardError, Diagnostic
from cnc.model.streams import PulseChunk
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort
from tests.support.boards.simulator_bench import material_below

MILL = load_machine(None)
GRBL = load_machine("grbl-uno")
PROBED = (
    "G21 G90\nM3 S1000\nG38.3 Z-5 F600\no1 if [#5070 EQ {}]\nG0 X3\nG1 X7 F6000\n"
    "(ABORT, contact %d#5070)\no1 endif\nG0 X9\nM2\n"
)
ABORT = 7
"""Its line."""


class Feeling(Loopback):
    """A board whose probe gives set answers. It keeps the pulses, and counts the waits."""

    def __init__(self, contact: float, fault: bool = False) -> None:
        super().__init__(3)
        self.contact = contact
        self.fault = fault
        self.times: list[int] = []
        self.finished = 0

    def execute(self, block, time_ns):  # type: ignore[no-untyped-def]
        super().execute(block, time_ns)
        return (self.contact, *block.end.tolist()) if isinstance(block, Probe) else None

    def send(self, chunk: PulseChunk) -> None:
        super().send(chunk)
        self.times += chunk.time_ns.tolist()

    def finish(self) -> None:
        if self.fault:
            raise BoardError(Diagnostic("board-fault", "on the way"))
        super().finish()
        self.finished += 1


@pytest.fixture
def program(tmp_path: Path) -> Path:
    return tmp_path / "p.nc"


def written(program: Path, text: str) -> Path:
    program.write_text(text)
    return program


def test_certain_abort_moves_nothing(program: Path, capfd: pytest.CaptureFixture[str]) -> None:
    written(program, "G21 G90\nG0 X5\n(ABORT, the vice is missing)\nM2\n")
    pulses = program.with_suffix(".npz")
    for words in (["check", str(program)], [str(program), "--pulses", str(pulses)]):
        assert cli.exit_code(words) == 1
        err = capfd.readouterr().err.splitlines()
        assert (
            err[-4]
            == f"{program}:3:1: program-abort: the program aborts itself: the vice is missing"
        )
        assert err[-3:-1] == ["  (ABORT, the vice is missing)", "  ^" + "~" * 27]
        assert not pulses.exists()
    board = Loopback(3)
    assert not run(program, board=board).ok
    assert not board.rows


def test_abort_in_a_branch_that_is_not_taken(
    program: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    written(program, "G21 G90\no1 if [0]\n(ABORT, never)\no1 else\nG0 X5\no1 endif\nM2\n")
    for words in (["check", str(program)], [str(program)]):
        assert cli.exit_code(words) == 0
        assert "abort" not in capfd.readouterr().err


def test_abort_by_an_answer_follows_the_earlier_moves(program: Path) -> None:
    board = Feeling(0.0)
    (fault,) = run(written(program, PROBED.format(0)), board=board).faults
    found = fault.diagnostic
    assert (found.code, found.line, fault.exit_code) == ("program-abort", ABORT, 1)
    assert found.message == "the program aborts itself: contact 0"
    steps = MILL.steps_per_mm
    assert board.position_steps.tolist() == (steps * [7, 0, -5]).tolist()
    assert (board.finished, board.state) == (1, "stopped")
    gaps = np.diff(board.times)
    assert gaps[-1] > 4 * gaps[-300:].min(), "and comes to rest"


def test_another_answer_completes_the_program(program: Path) -> None:
    board = Feeling(1.0)
    assert run(written(program, PROBED.format(0)), board=board).ok
    assert board.position_steps[0] == 9 * MILL.axes["x"].steps_per_mm


def test_check_without_an_answer_warns(program: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """A check assumes contact, which would abort.

    It checks the rest of the program all the same.
    """
    written(program, PROBED.format(1))
    assert cli.exit_code(["check", str(program)]) == 0
    assert (
        f"warning: {program}:{ABORT}:1: abort-possible: the program may abort itself: contact 1"
        in capfd.readouterr().err
    )
    assert check(program).end_position["x"] == 9.0
    assert run(program, board=Feeling(0.0)).ok
    program.write_text(program.read_text().replace("X9", "X9999"))
    assert [fault.diagnostic.code for fault in check(program).faults] == ["soft-limit"]
    # The GRBL simulator makes contact.
    program.write_text(program.read_text().replace("X9999", "X9"))
    assert cli.exit_code([str(program)]) == 1
    assert "program-abort: the program aborts itself: contact 1\n  (ABORT" in capfd.readouterr().err


def test_board_fault_before_the_abort_is_reported(program: Path) -> None:
    (fault,) = run(written(program, PROBED.format(0)), board=Feeling(0.0, fault=True)).faults
    assert (fault.diagnostic.code, fault.exit_code) == ("board-fault", 3)


@pytest.mark.parametrize("surface", [-4.0, None])
def test_abort_on_a_line_board(program: Path, surface: float | None) -> None:
    simulator = (
        GrblSimulator() if surface is None else GrblSimulator(environment=material_below(surface))
    )
    port = GrblSimulatorPort(simulator)
    board = GrblBoard(port, GRBL, port.clock, "the simulator")
    board.connect()
    report: Report = run(written(program, PROBED.format(0)), GRBL, board=board)
    board.close()
    spindle = [event.value for event in simulator.events if event.kind == "spindle"]
    if surface is not None:
        assert report.ok
        assert simulator.position == pytest.approx((9.0, 0.0, -4.0), abs=0.01)
        return
    assert [fault.diagnostic.code for fault in report.faults] == ["program-abort"]
    assert simulator.position == pytest.approx((7.0, 0.0, -5.0), abs=0.01)
    assert simulator.lost == 0
    assert spindle[0] == "M3 1000"
    assert spindle[-1].startswith("M5")
