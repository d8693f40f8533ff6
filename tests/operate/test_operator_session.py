"""One session on two kinds of boards: jogs, offsets, MDI lines, requests."""

from __future__ import annotations

import re
import threading
import time

import pytest

from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.protocols import board_error
from cnc.machine.load import load_machine
from cnc.model.diagnostics import UsageError
from cnc.operate.events import DialogClosed, EventStream, JobEnded, OffsetsChanged, State, as_object
from cnc.operate.operator_session import OperatorSession
from cnc.operate.program_session import KEEP_ALIVE
from tests.support.paths import ROOT
from tests.support.waiting import wait_until

REST_TIME = 0.2
GRID = 0.01
PATIENCE = 60

quick = pytest.mark.usefixtures("quick_board")


class Listener:
    """Keeps the events of a session."""

    def __init__(self, session):
        self.events = []
        session.listen(self.events.append)

    def of(self, kind):
        return [each for each in self.events if isinstance(each, kind)]


def ended(session, line):
    return session.mdi(line).result(PATIENCE)


def moves(operator, letter="x"):
    """Whether a jog has begun to move."""
    before = operator.state.machine[letter]
    return lambda: abs(operator.state.machine[letter] - before) > 0.5


@quick
def test_a_step_ends_at_its_distance(any_operator):
    before = any_operator.state.machine
    any_operator.jog_step({"x": 1.5, "y": 2.0}).result(PATIENCE)
    after = any_operator.state.machine
    assert after["x"] - before["x"] == pytest.approx(1.5, abs=GRID)
    assert after["y"] - before["y"] == pytest.approx(2.0, abs=GRID)


def test_a_released_jog_comes_to_rest_in_time(any_operator):
    moving = moves(any_operator)
    jog = any_operator.jog({"x": 1.0}, keep_alive=PATIENCE)
    wait_until(moving)
    places = [any_operator._worker.view.readings.position["x"]]
    released = time.monotonic()
    jog.release()
    jog.ended.result(PATIENCE)
    assert any_operator.state.machine["x"] < 100.0
    # The motion itself: at the jog's speed it would be further after the time to rest.
    travelled = any_operator.state.machine["x"] - places[0]
    assert travelled <= jog.feed * REST_TIME + GRID
    assert time.monotonic() > released


def test_a_jog_without_a_sign_of_life_ends(any_operator):
    jog = any_operator.jog({"x": 1.0}, keep_alive=0.1)
    jog.ended.result(PATIENCE)
    assert any_operator.state.machine["x"] < 60.0


def test_three_signs_of_life_of_the_page_fit_in_the_silence():
    page = (ROOT / "cnc" / "server" / "page" / "jog.js").read_text(encoding="utf-8")
    period = re.search(r"const KEEP = (\d+);", page)
    assert 3 * int(period[1]) <= 1000 * KEEP_ALIVE


@quick
def test_a_jog_never_passes_the_end_of_the_travel(any_operator):
    jog = any_operator.jog({"x": -1.0}, keep_alive=PATIENCE)
    jog.ended.result(PATIENCE)
    low = any_operator.travel["x"][0]
    assert any_operator.state.machine["x"] == pytest.approx(low, abs=GRID)
    with pytest.raises(UsageError, match="soft-limit"):
        any_operator.jog({"x": -1.0})


def test_a_second_activity_is_refused(any_operator):
    jog = any_operator.jog({"x": 1.0}, keep_alive=PATIENCE)
    with pytest.raises(UsageError, match="machine-busy"):
        any_operator.mdi("G0 X1")
    jog.release()
    jog.ended.result(PATIENCE)


@pytest.mark.parametrize(
    ("begin", "name"),
    [
        (OperatorSession.settings, "settings"),
        (OperatorSession.unlock, "unlock"),
        (OperatorSession.disconnect, "connect"),
    ],
)
def test_the_state_names_whatever_refuses_another_activity(any_operator, begin, name):
    refused = []

    def try_another(event):
        if isinstance(event, State) and event.activity == name and not refused:
            with pytest.raises(UsageError, match="machine-busy") as caught:
                any_operator.mdi("G0 X1")
            refused.append(caught.value.diagnostic.message)

    end = any_operator.listen(try_another)
    begin(any_operator).exception(PATIENCE)
    end()
    assert refused == [f"the machine is busy: {name}"]
    assert any_operator.state.activity == "none"


def test_no_state_comes_after_a_newer_one():
    stream, seen = EventStream(), []
    stream.listen(lambda event: seen.append(event.activity))
    begun, overtaken = threading.Event(), threading.Event()

    def older():
        begun.set()
        overtaken.wait(0.1)
        return State(activity="none")

    def newer():
        stream.emit_present(lambda: State(activity="program"))
        overtaken.set()

    first = threading.Thread(target=stream.emit_present, args=(older,))
    first.start()
    begun.wait(PATIENCE)
    newer()
    first.join()
    assert seen == ["none", "program"]


@quick
def test_the_modes_before_a_line_give_no_warnings(any_operator):
    assert ended(any_operator, "G1 X1 F600").outcome == "done"
    kept = ended(any_operator, "G0 X2")
    assert (kept.outcome, kept.findings) == ("done", ())
    own = ended(any_operator, "G0 X3 F500")
    assert [(each.code, each.line) for each in own.findings] == [("word-without-effect", 1)]


def test_a_stop_ends_a_jog_and_the_next_activity_begins(any_operator):
    jog = any_operator.jog({"x": 1.0}, keep_alive=PATIENCE)
    any_operator.stop()
    jog.ended.result(PATIENCE)
    assert ended(any_operator, "G0 X2").outcome == "done"


@quick
def test_zero_and_half(any_operator):
    seen = Listener(any_operator)
    any_operator.jog_step({"x": 4.0, "y": 2.0}).result(PATIENCE)
    offsets = any_operator.zero({"x": 0.0, "y": 1.0}).result(PATIENCE)
    assert offsets["G54"]["x"] == pytest.approx(4.0, abs=GRID)
    assert offsets["G54"]["y"] == pytest.approx(1.0, abs=GRID)
    assert seen.of(OffsetsChanged)[-1].offsets == offsets
    any_operator.jog_step({"x": 3.0}).result(PATIENCE)
    any_operator.zero({"x": 0.0}, half=True).result(PATIENCE)
    assert any_operator.state.work["x"] == pytest.approx(1.5, abs=GRID)
    assert any_operator.state.work["y"] == pytest.approx(1.0, abs=GRID)


@quick
def test_a_line_that_only_writes_an_offset_is_done(any_operator):
    for y in (2.0, 2.5):
        assert ended(any_operator, f"G10 L2 P1 X1 Y{y} Z3").outcome == "done"
        assert any_operator.offsets["G54"] == pytest.approx({"x": 1.0, "y": y, "z": 3.0})
    assert ended(any_operator, "G0 X1").outcome == "done"
    assert any_operator.state.machine["x"] == pytest.approx(2.0, abs=GRID)


@quick
def test_a_shift_of_g92_is_set(any_operator):
    any_operator.jog_step({"x": 4.0}).result(PATIENCE)
    any_operator.zero({"x": 1.0}, "G92").result(PATIENCE)
    assert any_operator.state.work["x"] == pytest.approx(1.0, abs=GRID)


@quick
def test_a_program_uses_the_zero(any_operator):
    any_operator.jog_step({"x": 4.0, "y": 2.0}).result(PATIENCE)
    any_operator.zero({"x": 0.0, "y": 0.0}, "G55").result(PATIENCE)
    assert ended(any_operator, "G55 G0 X1 Y3").outcome == "done"
    assert any_operator.state.machine["x"] == pytest.approx(5.0, abs=GRID)
    assert any_operator.state.machine["y"] == pytest.approx(5.0, abs=GRID)


def test_an_unknown_system_is_refused(any_operator):
    with pytest.raises(UsageError, match="no-such-system"):
        any_operator.zero({"x": 0.0}, "G57.7").result(PATIENCE)


@quick
def test_an_entered_line_keeps_the_modes_of_the_lines_before(any_operator):
    assert ended(any_operator, "G91 G1 X2 F1200").outcome == "done"
    assert ended(any_operator, "X1").outcome == "done"
    assert any_operator.state.machine["x"] == pytest.approx(3.0, abs=GRID)
    assert any_operator.history == ["G91 G1 X2 F1200", "X1"]


def test_an_entered_line_uses_the_parameters_of_the_lines_before(operator):
    for line in ("G91", "#1=1.5 #100=2", "G0 X#1 Y[#100 + 0.5]", "X#1"):
        assert ended(operator, line).outcome == "done"
    assert operator.state.machine["x"] == pytest.approx(3.0, abs=GRID)
    assert operator.state.machine["y"] == pytest.approx(2.5, abs=GRID)


@quick
def test_the_error_of_an_entered_line_is_that_of_a_file(any_operator):
    assert ended(any_operator, "G90 G1 X2 F1200").outcome == "done"
    found = ended(any_operator, "G1 X2 Q+").findings[0]
    assert (found.code, found.file, found.line, found.column) == ("number-missing", "MDI", 1, 7)


def test_hold_resume_and_stop_of_a_program(any_operator, tmp_path):
    program = tmp_path / "long.nc"
    program.write_text("G90 G1 X40 F1500\nM2\n")
    moving = moves(any_operator)
    future = any_operator.run(program)
    wait_until(moving)
    any_operator.hold()
    wait_until(lambda: any_operator.state.state == "held")
    wait_until(lambda: any_operator.state.held != "")
    any_operator.resume()
    wait_until(lambda: any_operator.state.state == "running")
    any_operator.stop()
    outcome = future.result(PATIENCE)
    assert outcome.outcome == "stopped"
    assert outcome.stopped_at_line == 1
    assert ended(any_operator, "G0 X0").outcome == "done"


@pytest.mark.parametrize(
    ("board", "asked", "code"),
    [
        ("operator", {"feed": 50.0, "rapid": 50}, "rapid-override"),
        ("operator", {"feed": 50.0, "spindle": 50.0}, "spindle-override"),
        ("grbl_operator", {"spindle": 50.0, "feed": 5.0}, "feed-override"),
    ],
)
def test_an_override_that_the_board_does_not_have_is_refused_as_a_whole(
    request, board, asked, code
):
    """GRBL has feed overrides of 10 to 200 %, and only GRBL has one of traverses and spindle."""
    session = request.getfixturevalue(board)
    with pytest.raises(UsageError) as refusal:
        session.override(**asked)
    assert refusal.value.diagnostic.code == code
    assert ended(session, "G4 P0.1").outcome == "done"
    shown = session.state.overrides
    assert (shown.feed, shown.rapid, shown.spindle) == (100.0, 100.0, 100.0)


@quick
def test_a_program_stop_asks_the_operator(any_operator, tmp_path):
    program = tmp_path / "stop.nc"
    program.write_text("G90 G0 X1\nM0 (turn the part)\nG0 X2\nM2\n")
    seen, asked = Listener(any_operator), threading.Event()

    def answer(event):
        if event.event == "dialog":
            assert event.kind == "stop"
            assert "turn the part" in event.text
            asked.set()
            threading.Thread(target=any_operator.answer, args=(event.id, True)).start()

    any_operator.listen(answer)
    assert any_operator.run(program).result(PATIENCE).outcome == "done"
    assert asked.is_set()
    assert seen.of(DialogClosed)
    assert seen.of(JobEnded)[-1].program == "stop.nc"


def test_a_start_line_is_confirmed_first(operator, tmp_path):
    program = tmp_path / "middle.nc"
    program.write_text("G90 G21\nG0 Z5\nG1 X5 F1200\nG1 X10\nM2\n")
    from cnc.session.options import RunOptions

    def refuse(event):
        if event.event == "dialog":
            assert event.kind == "restart"
            assert event.steps
            assert event.text == "from line 4, in machine coordinates:"
            threading.Thread(target=operator.answer, args=(event.id, False)).start()

    operator.listen(refuse)
    outcome = operator.run(program, RunOptions(from_line=4)).result(PATIENCE)
    assert outcome.outcome == "stopped"
    assert outcome.stopped_at_line is None
    assert operator.state.machine["x"] == pytest.approx(0.0, abs=GRID)


def test_the_question_before_a_start_line_names_skipped_lines(operator, tmp_path):
    program = tmp_path / "skipping.nc"
    program.write_text("G90 G21\nM0\nG1 X5 F1200\nG1 X10\nM2\n")
    from cnc.session.options import RunOptions

    texts = []

    def stop(event):
        if event.event == "dialog":
            texts.append(event.text)
            threading.Thread(target=operator.stop).start()

    operator.listen(stop)
    operator.run(program).result(PATIENCE)
    operator.run(program, RunOptions(from_line=4)).result(PATIENCE)
    assert "the last run reached line" not in texts[0]
    assert re.match(r"the last run reached line 2; the lines .* 4 are skipped; from", texts[1])


def test_the_state_comes_ten_times_a_second(any_operator):
    seen = Listener(any_operator)
    began = time.monotonic()
    wait_until(lambda: len(seen.of(State)) >= 5)
    assert time.monotonic() - began >= 0.35
    shown = as_object(seen.of(State)[-1])
    assert shown["event"] == "state"
    assert set(shown["machine"]) == {"x", "y", "z"}


def test_without_a_board_nothing_moves(pulse_machine):
    from cnc.operate.operator_session import OperatorSession

    with OperatorSession(pulse_machine) as session:
        for action in (
            lambda: session.jog({"x": 1.0}),
            lambda: session.mdi("G0 X1"),
            lambda: session.home(),
            lambda: session.zero({"x": 0.0}),
        ):
            with pytest.raises(UsageError, match="not-connected"):
                action()


def test_a_zero_without_a_parameter_file_is_refused():
    with OperatorSession(load_machine(None)) as session:
        session.connect().result(PATIENCE)
        with pytest.raises(UsageError, match="no-parameter-file"):
            session.zero({"x": 0.0}).result(PATIENCE)


@pytest.mark.parametrize("board", ["loopback", "grbl-sim", "klipper-sim"])
def test_simulated_boards_run_in_real_time(pulse_machine, board):
    machine = load_machine("grbl-uno") if board == "grbl-sim" else pulse_machine
    with OperatorSession(machine) as session:
        session.connect(board).result(PATIENCE)
        began = time.monotonic()
        assert ended(session, "G4 P0.3").outcome == "done"
        assert time.monotonic() - began >= 0.3


def test_a_board_that_fails_after_a_run_does_not_change_its_outcome(operator, monkeypatch):
    def fail() -> None:
        raise board_error("board-stopped", "the board has been stopped", hint="connect it again")

    monkeypatch.setattr(operator._worker.operated, "revive", fail)
    assert ended(operator, "G0 X2").outcome == "done"
    assert operator.state.board == ""


def test_a_file_is_not_operated(pulse_machine):
    with OperatorSession(pulse_machine) as session, pytest.raises(UsageError) as caught:
        session.connect("file").result(PATIENCE)
    assert caught.value.diagnostic.code == "no-operation"


def test_a_line_board_that_only_runs_programs_is_not_operated(monkeypatch):
    monkeypatch.setattr(GrblBoard, "operation", None)
    with OperatorSession(load_machine("grbl-uno")) as session:
        with pytest.raises(UsageError) as caught:
            session.connect("grbl-sim").result(PATIENCE)
        assert session.state.board == ""
    assert caught.value.diagnostic.code == "no-operation"


@pytest.mark.parametrize("value", [1e300, -1e6])
def test_a_zero_beyond_any_machine_is_refused_and_the_board_stays(any_operator, value):
    before = any_operator.offsets
    with pytest.raises(UsageError, match="zero-value"):
        any_operator.zero({"x": value}).result(PATIENCE)
    assert any_operator.offsets == before
    assert any_operator.state.board


def test_the_kernels_of_a_jog_are_loaded_with_the_connection(pulse_machine, monkeypatch):
    """A board that plays the first jog does not wait for them."""
    loaded = []
    monkeypatch.setattr("cnc.operate.machines.load_kernels", loaded.append)
    with OperatorSession(pulse_machine) as session:
        session.connect("loopback").result(PATIENCE)
    assert [set(jobs) >= {"paths", "planning", "pulses"} for jobs in loaded] == [True]
