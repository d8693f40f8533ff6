"""A zero by G92 outlives the resets of a GRBL board, or its loss is told."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.api import Control
from cnc.cli import exit_code
from cnc.model import state_file
from cnc.operate.machines import LineMachine
from cnc.session.position_check import LastPosition
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort
from tests.support.boards.grbl_cable import grbl_cable
from tests.support.boards.line_board_conformance import ORIGIN
from tests.support.session.position_runs import (
    BELOW_ZERO,
    FAST,
    MACHINE,
    SWITCHES,
    connected,
    ran,
    refused,
    run_on,
    stopping,
)

pytestmark = pytest.mark.usefixtures("nothing_kept")
SHIFT = (5.0, 4.0, 0.0)


@pytest.fixture
def program(tmp_path: Path) -> Path:
    file = tmp_path / "p.nc"
    file.write_text("G21 G90\nG0 X2 Y1\nX1\nM2\n")
    return file


def zeroed(tmp_path: Path, settings: dict[int, float] | None = None) -> GrblSimulator:
    """Return a board that stands at X5 Y4, where G92 has set the zero."""
    simulator = GrblSimulator(settings=settings or FAST)
    there = tmp_path / "there.nc"
    there.write_text("G21 G90\nG0 X5 Y4\nM2\n")
    assert ran(simulator, there).ok
    with connected(simulator) as board:
        LineMachine(board, board.operation, MACHINE).set_work_position("G92", {"x": 0.0, "y": 0.0})
    return simulator


def test_a_zero_of_one_command_holds_in_the_next(program: Path) -> None:
    with grbl_cable(GrblSimulator(settings=FAST)) as cable:
        there = ("--machine", "grbl-uno", "--port", cable.name, "--quiet")
        for command in (("jog", "X5", "Y4"), ("zero", "X", "Y", "--system", "G92"), (program,)):
            assert exit_code([*map(str, command), *there]) == 0
            assert not cable.is_open
        assert cable.simulator.position == pytest.approx((6.0, 5.0, 0.0), abs=0.005)


def test_the_zero_holds_in_every_run(program: Path, tmp_path: Path) -> None:
    simulator = zeroed(tmp_path)
    for dialect in ("auto", "grbl", "linuxcnc"):
        assert ran(simulator, program, dialect=dialect).ok
        assert simulator.position == pytest.approx((6.0, 5.0, 0.0), abs=0.005)
    assert ran(simulator, program, check_on_board=True).ok
    assert ran(simulator, program).ok
    assert simulator.position == pytest.approx((6.0, 5.0, 0.0), abs=0.005)


def test_the_zero_holds_after_a_stop(tmp_path: Path, program: Path) -> None:
    simulator, control = zeroed(tmp_path), Control()
    long = tmp_path / "long.nc"
    long.write_text("G21 G90\nG1 X20 F600\nM2\n")
    assert ran(simulator, long, control=control, callbacks=stopping(control, 8.0)).resume_line
    assert ran(simulator, program).ok
    assert simulator.position == pytest.approx((6.0, 5.0, 0.0), abs=0.005)


def test_the_zero_holds_after_a_stop_in_one_connection(tmp_path: Path) -> None:
    simulator = zeroed(tmp_path)
    with connected(simulator) as board:
        machine = LineMachine(board, board.operation, MACHINE)
        assert board.stored_offsets["G92"] == pytest.approx(SHIFT, abs=0.005)
        board.connect_operator(Control(), lambda: None)
        board.start(ORIGIN)
        board.stop()
        machine.revive()
        assert simulator.core.shift == pytest.approx(SHIFT, abs=0.005)
        assert machine.offsets()["G92"]["x"] == pytest.approx(5.0, abs=0.005)
        board.operation.unlock()
        assert simulator.core.shift == pytest.approx(SHIFT, abs=0.005)


def test_a_zero_that_was_removed_stays_removed(program: Path, tmp_path: Path) -> None:
    simulator = zeroed(tmp_path)
    with connected(simulator) as board:
        LineMachine(board, board.operation, MACHINE).keep_shift({})
    assert ran(simulator, program).ok
    assert simulator.position == pytest.approx((1.0, 1.0, 0.0), abs=0.005)


@pytest.mark.parametrize("how", ["power", "another sender"])
def test_a_lost_zero_is_told_once(program: Path, tmp_path: Path, how: str) -> None:
    simulator = zeroed(tmp_path)
    if how == "power":
        simulator.power_up()
    else:
        port = GrblSimulatorPort(simulator, hang_up=False)
        port.write(b"G91G0X0.1\n")
        port.clock.sleep(2.0)
        port.close()
    before = len(simulator.moves)
    (fault,) = ran(simulator, program).faults
    assert fault.diagnostic.code == "offset-lost"
    assert "X5.000 Y4.000" in fault.diagnostic.message
    assert "cncrun zero X Y --system G92" in fault.diagnostic.hint
    refused(ran(simulator, program))
    assert len(simulator.moves) == before
    assert ran(simulator, program, trust_position=True).ok
    assert simulator.position == pytest.approx((1.0, 1.0, 0.0), abs=0.005)


def test_a_lost_zero_that_was_set_again_holds(program: Path, tmp_path: Path) -> None:
    simulator = zeroed(tmp_path)
    simulator.power_up()
    with connected(simulator) as board:
        LineMachine(board, board.operation, MACHINE).set_work_position("G92", {"x": -1.0})
    refused(ran(simulator, program))
    assert ran(simulator, program, trust_position=True).ok
    assert simulator.position == pytest.approx((2.0, 1.0, 0.0), abs=0.005)


def test_the_zero_holds_when_the_machine_is_homed(program: Path, tmp_path: Path) -> None:
    """The board is locked when it is reset in Alarm, and takes no G92 until it has homed."""
    file = tmp_path / "home.nc"
    file.write_text("G21 G90\n$H\nG0 X-12 Y-8\nM2\n")
    simulator = GrblSimulator(settings=SWITCHES)
    assert run_on(simulator, file, BELOW_ZERO).ok
    with connected(simulator, BELOW_ZERO) as board:
        LineMachine(board, board.operation, BELOW_ZERO).set_work_position(
            "G92", {"x": -7.0, "y": -7.0}
        )
    file.write_text("$H\nG21 G90\nG0 X-10 Y-9\nM2\n")
    assert run_on(simulator, file, BELOW_ZERO).ok
    assert simulator.position[:2] == pytest.approx((-15.0, -10.0), abs=0.005)


@pytest.mark.parametrize(
    "damage",
    [
        b"",
        b"{",
        b"[]",
        b"{}",
        b'{"board": "the simulator", "position": {}}',
        b'{"board": "the simulator", "position": {"x": NaN}}',
        b'{"board": "the simulator", "position": {"x": 1e999}}',
        b'{"board": "the simulator", "position": {"x": "far"}}',
        b'{"board": "another", "position": {"x": 0.0}}',
        b"[" * 3000,
        b'{"board": "the simulator", "position": {"x": ' + b"9" * 400 + b"}}",
        b"\xff\xfe",
        None,
    ],
)
def test_an_unreadable_record_is_a_lost_position(program: Path, damage: bytes | None) -> None:
    simulator = GrblSimulator(settings=FAST)
    assert ran(simulator, program).ok
    file = state_file.folder() / "the%20simulator.json"
    if damage is None:
        file.unlink()
        file.mkdir()
    else:
        file.write_bytes(damage)
    before = len(simulator.moves)
    for _ in range(2):
        assert str(file) in refused(ran(simulator, program))
    assert len(simulator.moves) == before
    assert ran(simulator, program, trust_position=True).ok
    if damage is not None:
        assert ran(simulator, program).ok


def test_a_cut_record_is_a_lost_position_at_each_length(program: Path) -> None:
    simulator = GrblSimulator(settings=FAST)
    assert ran(simulator, program).ok
    file = state_file.folder() / "the%20simulator.json"
    whole = file.read_bytes()
    for length in range(len(whole)):
        file.write_bytes(whole[:length])
        known = LastPosition.read("the simulator")
        assert known is not None and known.lost and known.file == file
