"""The position check of a GRBL board: a program runs only from a confirmed position."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from cnc.api import Callbacks, Control, Report, run
from cnc.boards.grbl.driver import GrblBoard
from cnc.cli import exit_code
from cnc.model import state_file
from cnc.session.position_check import LastPosition
from cnc.session.run_pulses import Progress
from cnc.simulators.grbl.grbl_simulator import Alarm, Error, GrblSimulator, Unplug
from cnc.simulators.grbl.ports import GrblSimulatorPort, PtyServer
from tests.support.boards.grbl_cable import GrblCable, grbl_cable
from tests.support.session.position_runs import (
    END,
    FAST,
    MACHINE,
    connected,
    ran,
    refused,
    stopping,
    tool,
)
from tests.support.session.runs import run_with
from tests.support.waiting import wait_until

pytestmark = pytest.mark.usefixtures("nothing_kept")


def stopped(square: Path, cable: GrblCable) -> Report:
    """Return the report of a run that the operator stops at X6.5."""
    control = Control()
    return run(
        square,
        MACHINE,
        board="grbl",
        port=cable.name,
        control=control,
        callbacks=stopping(control, 6.5),
    )


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals here")
def test_two_runs_in_a_row_do_not_shift(square: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with PtyServer(GrblSimulator(settings=FAST), 20.0) as server:
        command = [str(square), "--machine", "grbl-uno", "--port", server.name, "--quiet"]
        assert exit_code(command) == 0, capsys.readouterr().err
        assert tool(server.simulator) == END
        wait_until(lambda: not server.is_open)
        assert exit_code(command) == 0, capsys.readouterr().err
        assert tool(server.simulator) == END
        assert not [
            event
            for event in server.simulator.events
            if event.kind == "reset" and event.value == "power"
        ]


def test_a_stopped_run_continues_at_its_position(
    square: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with grbl_cable(GrblSimulator(settings=FAST)) as cable:
        first = stopped(square, cable)
        assert first.resume_line is not None
        assert tool(cable.simulator)[0] > 6.0
        assert not cable.is_open
        more = [
            "--machine",
            "grbl-uno",
            "--port",
            cable.name,
            "--from-line",
            str(first.resume_line),
            "--yes",
            "--quiet",
        ]
        assert exit_code([str(square), *more]) == 0, capsys.readouterr().err
        assert tool(cable.simulator) == END


def test_yes_does_not_confirm_the_position_of_a_board_that_was_reset(
    square: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with grbl_cable(GrblSimulator(settings=FAST)) as cable:
        first = stopped(square, cable)
        stands = tool(cable.simulator)
        cable.simulator.drop_dtr()
        command = [
            str(square),
            "--machine",
            "grbl-uno",
            "--port",
            cable.name,
            "--from-line",
            str(first.resume_line),
            "--yes",
        ]
        for _ in range(2):
            assert not cable.is_open
            assert exit_code(command) == 3
            said = capsys.readouterr().err
            assert "position-lost" in said
            assert "X0.000 Y0.000 Z0.000" in said
            assert f"X{stands[0]:.3f} Y{stands[1]:.3f} Z{stands[2]:.3f}" in said
            assert "--trust-position" in said
            assert tool(cable.simulator) == stands
        assert not cable.is_open
        assert exit_code([*command, "--trust-position", "--quiet"]) == 0, capsys.readouterr().err
        assert tool(cable.simulator) == pytest.approx(
            [a + b for a, b in zip(stands, END, strict=True)], abs=0.01
        )


def test_a_board_without_a_record_is_accepted(square: Path) -> None:
    simulator = GrblSimulator(settings=FAST)
    assert ran(simulator, square).ok
    kept = LastPosition.read("the simulator")
    assert kept is not None
    assert (kept.position, kept.ended, kept.lost) == ({"x": 4.0, "y": 3.0, "z": -1.0}, "end", False)


@pytest.mark.parametrize("how", ["power", "another sender"])
def test_another_position_is_refused_until_it_is_confirmed(square: Path, how: str) -> None:
    simulator = GrblSimulator(settings=FAST)
    assert ran(simulator, square).ok
    if how == "power":
        simulator.power_up()
    else:
        port = GrblSimulatorPort(simulator, hang_up=False)
        port.write(b"G91G0X0.1\n")
        port.read(0.0)
        port.clock.sleep(2.0)
        port.close()
    before = len(simulator.moves)
    said = refused(ran(simulator, square))
    assert ("X0.000 Y0.000 Z0.000" if how == "power" else "X4.100 Y3.000 Z-1.000") in said
    assert "ended at X4.000 Y3.000 Z-1.000" in said
    assert ("has restarted" in said) == (how == "power")
    assert "does not home ($22=0)" in said
    assert "has restarted" not in refused(ran(simulator, square)), "once is enough to forget it"
    assert len(simulator.moves) == before
    assert ran(simulator, square, trust_position=True).ok
    assert ran(simulator, square).ok


def test_a_difference_below_one_step_is_accepted(square: Path) -> None:
    simulator = GrblSimulator(settings=FAST)
    assert ran(simulator, square).ok
    step = 1.0 / 250.0
    LastPosition("the simulator", {"x": 4.0 + step, "y": 3.0, "z": -1.0}, "end").write()
    assert ran(simulator, square).ok
    LastPosition("the simulator", {"x": 4.0, "y": 3.0 - 2.1 * step, "z": -1.0}, "end").write()
    assert "Y2.992" in refused(ran(simulator, square))


def test_a_restart_at_zero_is_refused_too(square: Path) -> None:
    """The tool may have moved while the board was off, and a second opening shows no restart."""
    simulator = GrblSimulator(settings=FAST)
    square.write_text("G21 G90\nG1 X3 F900\nG0 X0\nM2\n")
    assert ran(simulator, square).ok
    simulator.power_up()
    assert "has restarted" in refused(ran(simulator, square))
    refused(ran(simulator, square))
    assert ran(simulator, square, trust_position=True).ok


@pytest.mark.parametrize("code", ["port-lost", "board-restarted"])
def test_a_run_without_a_final_report_leaves_a_lost_position(square: Path, code: str) -> None:
    simulator = GrblSimulator(settings=FAST)

    def on_sent(sent: Progress) -> None:
        if sent.position is not None and sent.position[0] > 8.0:
            if code == "port-lost":
                simulator.inject(Unplug())
            else:
                simulator.power_up()

    report = ran(simulator, square, callbacks=Callbacks(on_sent=on_sent))
    assert [fault.diagnostic.code for fault in report.faults] == [code]
    kept = LastPosition.read("the simulator")
    assert kept is not None and kept.lost and kept.ended == code
    assert kept.position["x"] > 8.0
    assert f"ended ({code}) at X" in refused(ran(simulator, square))
    assert ran(simulator, square, trust_position=True).ok


def test_after_a_fault_that_leaves_the_position_known_the_next_run_begins(square: Path) -> None:
    simulator = GrblSimulator(settings=FAST)
    simulator.inject(Error(20), line=14)
    report = ran(simulator, square)
    assert [fault.diagnostic.code for fault in report.faults] == ["board-error"]
    kept = LastPosition.read("the simulator")
    assert kept is not None and (kept.ended, kept.lost) == ("board-error", False)
    assert ran(simulator, square).ok


def test_the_checkpoint_is_used_if_the_run_has_no_recorded_end(square: Path) -> None:
    """The record of the board is missing, or the computer crashed during the run."""
    simulator, control = GrblSimulator(settings=FAST), Control()
    first = ran(simulator, square, control=control, callbacks=stopping(control, 10.0))
    assert first.resume_line == 5
    kept = LastPosition.read("the simulator")
    assert kept is not None and kept.ended == "stopped"
    for file in state_file.folder().iterdir():
        file.unlink()
    simulator.power_up()
    assert "was stopped at X1" in refused(ran(simulator, square, from_line=5))
    for file in state_file.folder().iterdir():
        file.unlink()
    LastPosition("the simulator", {"x": 0.0, "y": 0.0, "z": 0.0}).write()
    assert "was stopped at X1" in refused(ran(simulator, square, from_line=5))


def test_a_check_on_the_board_ignores_and_keeps_the_record(square: Path) -> None:
    simulator = GrblSimulator(settings=FAST)
    assert ran(simulator, square).ok
    kept = LastPosition.read("the simulator")
    simulator.power_up()
    with connected(simulator) as board:
        board.check_only = True
        assert run(square, MACHINE, board=board).ok
    assert LastPosition.read("the simulator") == kept
    refused(ran(simulator, square))


def test_an_unwritable_record_does_not_stop_the_run(
    square: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = tmp_path / "file"
    blocked.touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(blocked))
    assert ran(GrblSimulator(settings=FAST), square).ok
    assert LastPosition.read("the simulator") is None


def test_a_stop_names_the_line_of_the_motion(square: Path) -> None:
    simulator = GrblSimulator(settings=FAST)
    control = Control()
    report = ran(simulator, square, control=control, callbacks=stopping(control, 11.0))
    # Line 6 was sent 1.5 s ahead, at X9.5: line 5 has 100 mm/min.
    assert 11.0 < report.end_position["x"] < 12.0
    assert report.stopped_at_line == 5
    assert report.resume_line == 5


@pytest.mark.parametrize("text", [b"ALARM", b"ALRM"])
def test_after_an_abrupt_stop_an_unlocked_board_is_not_trusted(square: Path, text: bytes) -> None:
    simulator = GrblSimulator(settings=FAST)
    port = GrblSimulatorPort(simulator, hang_up=False)
    # An alarm with a damaged message may be any, even if it is a 4.
    simulator.inject(Alarm(1 if text == b"ALARM" else 4), time=6.5)
    board = GrblBoard(port, MACHINE, port.clock, "the simulator", identity="the simulator")
    read = port.read
    port.read = lambda timeout: read(timeout).replace(b"ALARM", text)  # type: ignore[method-assign]
    board.connect()
    (fault,) = run_with(square, MACHINE, board=board).faults
    board.close()
    assert fault.diagnostic.code == "board-alarm"
    for _ in range(2):
        simulator.advance(simulator.now + 1.0)
        port = GrblSimulatorPort(simulator, hang_up=False)
        board = GrblBoard(port, MACHINE, port.clock, "the simulator")
        board.connect()
        board.link.ask("$X")
        board.close()
        assert "may have lost steps" in refused(ran(simulator, square))
    assert ran(simulator, square, trust_position=True).ok
    assert ran(simulator, square).ok


def test_an_alarm_without_an_abrupt_stop_keeps_the_position(tmp_path: Path) -> None:
    program = tmp_path / "probe.nc"
    program.write_text("G21 G90\nG38.2 Z-3 F600\nM2\n")
    simulator = GrblSimulator(settings=FAST)
    assert [fault.diagnostic.code for fault in ran(simulator, program).faults] == [
        "probe-no-contact"
    ]
    kept = LastPosition.read("the simulator")
    assert kept is not None and (kept.position["z"], kept.lost) == (-3.0, False)
