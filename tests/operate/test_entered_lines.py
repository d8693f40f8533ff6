"""Entered lines mean what they mean in one file: tool length, tool, shift, spindle, coolant."""

from __future__ import annotations

import pytest

from cnc.machine.load import load_machine
from cnc.operate.operator_session import OperatorSession

PATIENCE = 60
GRID = 0.01


@pytest.fixture(params=["loopback", "grbl-sim"])
def session(request, tmp_path, quick_board):
    """A session whose tool 3 is 7.25 mm long; it answers each question."""
    machine = load_machine("grbl-uno" if request.param == "grbl-sim" else None)
    table = tmp_path / "mill.tbl"
    table.write_text("T3 P3 Z7.25 D6\n")
    update = {"tool_table": table, "parameters": tmp_path / "mill.var"}
    program = machine.program.model_copy(update=update)
    with OperatorSession(machine.model_copy(update={"program": program})) as session:
        session.seen = []
        session.listen(session.seen.append)
        session.listen(lambda event: answer(session, event))
        session.connect(request.param).result(PATIENCE)
        yield session


def answer(session, event):
    if event.event == "dialog":
        session.ask(OperatorSession.answer, event.id, True)


def enter(session, *lines):
    for line in lines:
        ended = session.mdi(line).result(PATIENCE)
        assert ended.outcome == "done", ended.findings


def notices(session):
    return [each.finding.message for each in session.seen if each.event == "notice"]


def sent(session):
    lines = [each for each in session.seen if each.event == "console"]
    return [each.text for each in lines if each.direction == "sent"]


@pytest.mark.parametrize(
    ("lines", "height"),
    [
        (["G43 H3"], 12.25),
        (["T3 M6", "G43"], 12.25),
        (["G21 G43.1 Z2"], 7.0),
        (["G43 H3", "G49"], 5.0),
    ],
)
def test_the_tool_length_holds_for_the_next_lines(session, lines, height):
    enter(session, *lines, "G0 Z5")
    assert session.state.machine["z"] == pytest.approx(height, abs=GRID)
    enter(session, "X0.5", "Z4")
    assert session.state.machine["z"] == pytest.approx(height - 1.0, abs=GRID)


def test_the_tool_length_ends_with_a_program(session, tmp_path):
    """The program may have changed the tool."""
    program = tmp_path / "part.nc"
    program.write_text("G90 G0 X0.5\nM2\n")
    enter(session, "G43 H3")
    assert session.state.modes == "G21 G43 H3"
    session.run(program).result(PATIENCE)
    assert session.state.modes == ""
    enter(session, "G0 Z5")
    assert session.state.machine["z"] == pytest.approx(5.0, abs=GRID)


def test_a_shift_by_g92_holds_for_the_next_lines(session):
    enter(session, "G10 L2 P1 Y1", "G92 X-1 Y1", "G0 X0 Y2")
    assert session.state.machine == pytest.approx({"x": 1.0, "y": 1.0, "z": 0.0}, abs=GRID)
    assert session.state.work == pytest.approx({"x": 0.0, "y": 2.0, "z": 0.0}, abs=GRID)
    enter(session, "G92.1", "G0 X0 Y-1")
    assert session.state.machine == pytest.approx({"x": 0.0, "y": 0.0, "z": 0.0}, abs=GRID)


def test_modes_that_end_with_their_line_are_named(session):
    enter(session, "G16 G0 X1 Y0")
    assert notices(session) == ["G16 was in effect for this line only"]


def test_spindle_and_coolant_last_on_a_board_with_m5_and_stop_by_it(session):
    enter(session, "M3 S1000", "M8")
    if session.state.board == "grbl-sim":
        enter(session, "M5", "M9", "T3 M6")
        own = [each for each in sent(session) if each[0] == "M"]
        # The tool is changed at rest, whatever has started the spindle.
        assert own[:5] == ["M3 S1000", "M8", "M5", "M9", "M5"]
        assert own[5].startswith("M0")
        assert notices(session) == []
    else:
        stop = "spindle and coolant stop at the end of the line on this board"
        assert notices(session) == [stop, stop]
