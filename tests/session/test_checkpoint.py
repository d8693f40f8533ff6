"""The checkpoint of an interrupted run, and runs that continue there."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from cnc.api import Callbacks, Control, Report, run
from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.loopback import Loopback
from cnc.boards.stepper.driver import Stepper
from cnc.cli import exit_code
from cnc.machine.load import load_machine
from cnc.session import checkpoint
from cnc.session.checkpoint import Checkpoint, CheckpointWriter, checkpoint_schema
from cnc.session.run_pulses import Progress
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort
from tests.support.boards.stepper_rig import machine
from tests.support.boards.stepper_simulator import Simulator, SimulatorPort
from tests.support.session.runs import run_with
from tests.support.soak import share

PROGRAM = (
    "G21 G90 G64\nM3 S500\nG0 Z3\nG1 Z-1 F600\n"
    + "".join(f"G1 X{k} Y{k % 3} F1200\n" for k in range(1, 9))
    + "G0 Z5\nM2\n"
)
"""Line k + 4 moves to X k."""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    (tmp_path / "p.ngc").write_text(PROGRAM)
    return tmp_path / "p.ngc"


@pytest.fixture
def simulator() -> Iterator[Simulator]:
    made = Simulator()
    yield made
    made.close()


def first_of(program: str) -> Checkpoint:
    return Checkpoint(program=program, sha256="0" * 64, machine="m", board="b")


def record(program: Path) -> dict:
    return json.loads(Path(f"{program}.checkpoint").read_text())


def on_board(simulator: Simulator, program: Path, **more: object) -> Report:
    port = SimulatorPort(simulator)
    board = Stepper(port, machine(), "the simulator", clock=port)
    try:
        return run_with(program, machine(), board=board, **more)
    finally:
        board.close()


class Died(BaseException):
    """Stands for the death of the process."""


def trouble(simulator: Simulator, kind: str, control: Control):
    """Return the callback that causes a fault when X has reached 4 mm."""
    received = simulator.received

    def on_sent(sent: Progress) -> None:
        if sent.position is None or sent.position[0] < 4.0:
            return
        if kind == "e-stop":
            simulator.set_pin(14, 0)
        elif kind == "stopped":
            control.stop()
        elif kind == "cable":
            simulator.send = lambda data: None  # type: ignore[method-assign]
            simulator.received = lambda: received()[:0]  # type: ignore[method-assign]
        else:
            raise Died

    return on_sent


@pytest.mark.parametrize("kind", share(["e-stop", "stopped", "cable", "died"], ["died"]))
def test_an_interrupted_run_continues_at_its_checkpoint(
    simulator: Simulator, program: Path, kind: str
) -> None:
    control = Control()
    send, received = simulator.send, simulator.received
    watch = Callbacks(on_sent=trouble(simulator, kind, control))
    if kind == "died":
        with pytest.raises(Died):
            on_board(simulator, program, control=control, callbacks=watch)
    else:
        first = on_board(simulator, program, control=control, callbacks=watch)
        assert first.exit_code == (0 if kind == "stopped" else 3)
        hint = f"--from-line {first.resume_line}"
        assert kind == "stopped" or hint in first.faults[0].diagnostic.hint
        assert first.resume_line == record(program)["line"]
    simulator.send, simulator.received = send, received  # type: ignore[method-assign]
    simulator.set_pin(14, 1)
    simulator.run(0.6)
    stands = simulator.moves()[1].sum(axis=0, dtype=np.int64) / 400
    found = record(program)
    assert 3.9 < stands[0] < 8
    # the line that the machine has come to, or one before: nothing is left out; what the board did
    # without a cable, or without this computer, is not known
    unknown = {"cable": 3, "died": 2}.get(kind, 1)
    assert 0 <= int(np.ceil(stands[0] - 1e-3)) - (found["line"] - 4) <= unknown
    assert (
        found["ended"]
        == {
            "e-stop": "board-emergency-stop",
            "stopped": "stopped",
            "cable": "board-silent",
            "died": "broken off",
        }[kind]
    )
    assert found["position"]["x"] == pytest.approx(
        stands[0], abs=0.2 if kind in ("e-stop", "stopped") else 5.0
    )
    reported: list[str] = []
    before = len(simulator.moves()[1])

    def agree(story) -> bool:
        reported.extend(story)
        return True

    second = on_board(
        simulator, program, from_line=found["line"], callbacks=Callbacks(on_beginning=agree)
    )
    assert second.ok, second.faults
    made = simulator.moves()[1]
    assert (made.sum(axis=0, dtype=np.int64) / 400).tolist() == [8.0, 2.0, 5.0]
    assert (made[before, :2] == 0).all() and made[before, 2] == 1, "up before anything else"
    assert reported[0] == f"from line {found['line']}, in machine coordinates:"
    assert any("spindle cw" in line for line in reported)
    assert not Path(f"{program}.checkpoint").exists(), "it came to its end"
    assert not second.warnings


def test_a_checkpoint_that_does_not_fit_gives_a_warning(
    simulator: Simulator, program: Path
) -> None:
    control = Control()
    on_board(
        simulator,
        program,
        control=control,
        callbacks=Callbacks(on_sent=trouble(simulator, "stopped", control)),
    )
    line = record(program)["line"]

    def codes(**more: object) -> list[str]:
        return [
            found.code
            for found in on_board(
                simulator, program, callbacks=Callbacks(on_beginning=lambda _: False), **more
            ).warnings
        ]

    assert codes(from_line=line) == []
    assert codes(from_line=line + 2) == ["checkpoint-before"]
    program.write_text(PROGRAM.replace("X8", "X8.5"))
    assert codes(from_line=line) == ["checkpoint-differs"]
    program.write_text(PROGRAM)
    assert "run-unfinished" in codes()


def test_the_loopback_board_has_a_checkpoint(
    program: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    report = run(program, board=Loopback(3, fail_after=2_000))
    assert [fault.diagnostic.code for fault in report.faults] == ["board-fault"]
    assert record(program)["line"] == report.resume_line
    assert report.faults[0].diagnostic.line >= (report.resume_line or 0) > 0
    monkeypatch.setattr("cnc.api.open_board", lambda *_, **__: Loopback(3, fail_after=2_000))
    assert exit_code([str(program)]) == 3
    assert f"continue with --from-line {report.resume_line}" in capsys.readouterr().err
    monkeypatch.setattr("cnc.api.open_board", lambda *_, **__: Loopback(3))
    assert exit_code([str(program), "--from-line", str(report.resume_line), "--yes"]) == 0
    assert not Path(f"{program}.checkpoint").exists()


def test_a_run_that_ends_in_a_subprogram_continues_at_the_call(tmp_path: Path) -> None:
    program = tmp_path / "p.ngc"
    program.write_text(
        "G21 G90\nG1 X1 F600\no1 sub\nG1 Y2 F600\nG1 X9\no1 endsub\nG1 Z1\no1 call\nM2\n"
    )
    per_mm = round(load_machine().axes["x"].steps_per_mm)
    report = run(program, board=Loopback(3, fail_after=5 * per_mm))
    assert [fault.diagnostic.code for fault in report.faults] == ["board-fault"]
    assert report.resume_line == record(program)["line"] == 8


def test_a_killed_run_in_a_subprogram_continues_at_the_call_without_a_warning(
    tmp_path: Path,
) -> None:
    """Until its end, a run writes the line itself. The advice and the warning name one line."""
    program = tmp_path / "p.ngc"
    program.write_text(
        "G21 G90\nG1 X1 F600\no1 sub\nG1 Y2 F600\nG1 X9\no1 endsub\nG1 Z1\no1 call\nM2\n"
    )
    per_mm = round(load_machine().axes["x"].steps_per_mm)
    run_with(program, load_machine(), board=Loopback(3, fail_after=5 * per_mm))
    killed = Checkpoint.model_validate(record(program) | {"line": 5, "ended": ""})
    Path(f"{program}.checkpoint").write_text(killed.model_dump_json())
    stop = Callbacks(on_beginning=lambda _: False)
    again = partial(run_with, program, load_machine(), callbacks=stop)
    (found,) = again(board=Loopback(3), from_line=9).warnings
    assert found.code == "checkpoint-before"
    assert "reached line 8" in found.message
    assert again(board=Loopback(3), from_line=8).warnings == []
    (found,) = again(board=Loopback(3, fail_after=1)).warnings
    assert found.code == "run-unfinished"
    assert "--from-line 8 continues there" in found.hint


def test_a_run_that_ends_on_its_way_to_the_line_continues_at_this_line(program: Path) -> None:
    """Settings of earlier lines are restored on the way; those lines are done."""
    program.write_text(PROGRAM.replace("G1 X4 ", "G64 P0.02 G1 X4 "))
    for after in (0, 1, 500, 3_000):
        board = Loopback(3, fail_after=after)
        report = run_with(program, load_machine(), board=board, from_line=10)
        assert [fault.diagnostic.code for fault in report.faults] == ["board-fault"]
        assert report.resume_line == record(program)["line"] == 10


def test_the_checkpoint_of_a_grbl_board_is_the_line_in_motion(program: Path) -> None:
    """The last line that the board has taken may be a planner buffer ahead."""
    simulator, control = GrblSimulator(), Control()
    port = GrblSimulatorPort(simulator)
    board = GrblBoard(port, load_machine("grbl-uno"), port.clock, "the simulator")
    board.connect()

    def on_sent(sent: Progress) -> None:
        if sent.position is not None and sent.position[0] > 4.0:
            control.stop()

    report = run_with(
        program,
        load_machine("grbl-uno"),
        board=board,
        dialect="linuxcnc",
        control=control,
        callbacks=Callbacks(on_sent=on_sent),
    )
    board.close()
    assert report.resume_line is not None
    assert report.resume_line - 4 <= np.ceil(simulator.position[0])
    assert report.resume_line >= 7


def test_a_reader_never_sees_a_partial_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file is read again and again, from its first version on."""
    monkeypatch.setattr(checkpoint, "WRITE_INTERVAL", 0.001)
    name = str(tmp_path / "p.ngc")
    recorder = CheckpointWriter(first_of(name), ("x", "y"))
    seen: set[int] = set()
    for line in range(1, 300):
        recorder.note(Progress(0.0, line, 0, position=(line, 0.0), at=line))
        threading.Event().wait(0.001)
        found, _ = Checkpoint.read(name)
        if seen:
            assert found is not None and found.position is not None
        if found is not None and found.position is not None:
            assert found.position["x"] == found.line
            seen.add(found.line)
    recorder.note(Progress(0.0, 999, 0, at=999, file="sub.ngc"))
    assert recorder.end("x", 999, {}, int) == 299, "the line of another file is none to begin at"
    assert len(seen) > 5
    assert sorted(path.name for path in tmp_path.iterdir()) == ["p.ngc.checkpoint"]
    Path(name + ".checkpoint").write_text("{")
    assert Checkpoint.read(name)[0] is None


@pytest.mark.parametrize(
    ("key", "value"),
    [("line", -1), ("line", "far"), ("sha256", 5), ("position", {"x": "left"}), ("speed", 1.0)],
)
def test_a_checkpoint_with_a_wrong_value_is_not_read(
    tmp_path: Path, key: str, value: object
) -> None:
    name = str(tmp_path / "p.ngc")
    good = first_of(name).model_dump() | {"line": 3, "position": {"x": 1.0}}
    jsonschema.validate(good, checkpoint_schema())
    Path(name + ".checkpoint").write_text(json.dumps(good))
    found, _ = Checkpoint.read(name)
    assert found is not None and (found.line, found.position) == (3, {"x": 1.0})
    Path(name + ".checkpoint").write_text(json.dumps(good | {key: value}))
    assert Checkpoint.read(name)[0] is None
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(good | {key: value}, checkpoint_schema())


def test_a_checkpoint_that_cannot_be_written_does_not_stop_the_run(tmp_path: Path) -> None:
    recorder = CheckpointWriter(first_of(str(tmp_path / "no" / "p.ngc")), ("x",))
    recorder.note(Progress(0.0, 5, 0, at=5))
    assert recorder.end("stopped", 7, {"x": 1.0}, int) == 7
    recorder.done()
