"""The machine used by hand while a program waits at M0 or M6, and the way back into the program."""

from __future__ import annotations

import time
from itertools import product

import pytest

from cnc.model.diagnostics import UsageError
from cnc.operate.events import Alarm, Dialog, JobEnded, State
from cnc.operate.probing import mdi_line
from tests.support.soak import share
from tests.support.waiting import wait_until

pytestmark = pytest.mark.usefixtures("quick_board")
PATIENCE = 60
GRID = 0.01
PROGRAM = """\
G21 G90 G94 G17 F600
G0 Z8
G0 X10 Y5
G1 Z2
{pause}
G1 X14
G0 Z8
M30
"""


class Listener:
    """Keeps the events of a session, and answers the question whether to go to the line."""

    def __init__(self, session):
        self.session, self.events, self.lines = session, [], []
        self.lowest = {}
        session.listen(self.take)

    def take(self, event):
        self.events.append(event)
        if isinstance(event, Dialog) and event.kind == "restart":
            self.session.answer(event.id, yes=True)

    def of(self, kind):
        return [event for event in self.events if isinstance(event, kind)]


def zero_here(session):
    """Make the present place the zero of all axes, so that programs have room."""
    session.jog_step({"x": 6.0, "y": 6.0, "z": -14.0}, unhomed=True).exception(PATIENCE)
    session.zero({"x": 0.0, "y": 0.0, "z": 0.0}).result(PATIENCE)
    return session.state.machine


def rests(session):
    """Whether the machine does not move for a while."""
    before = session.state.machine
    time.sleep(0.3)
    return session.state.machine == before


def begun(session, folder, text):
    """Begin a program; return its listener and its end when it waits at its pause."""
    file = folder / "part.nc"
    file.write_text(text)
    listener = Listener(session)
    ended = session.run(file)
    wait_until(lambda: session.state.held)
    wait_until(lambda: rests(session))
    return listener, ended


BOARDS = ("operator", "grbl_shop", "klipper_shop", "stepper_shop")


def on_boards(*some):
    """Run a test on some kinds of boards; under ``make soak`` on all of them."""
    return pytest.mark.parametrize("paused", share(BOARDS, some), indirect=True)


@pytest.fixture(params=BOARDS)
def paused(request, tmp_path):
    """Run a program on each kind of board until its pause."""
    fixture = request.getfixturevalue(request.param)
    session = getattr(fixture, "session", fixture)
    session.origin = zero_here(session)
    return lambda text: (session, *begun(session, tmp_path, text))


def place(session):
    """Return the machine position relative to the first zero, mm."""
    return {
        letter: session.state.machine[letter] - session.origin[letter] for letter in ("x", "y", "z")
    }


PAUSES = ("M0", "T2 M6")


@pytest.mark.parametrize(
    ("paused", "pause"),
    share(list(product(BOARDS, PAUSES)), list(zip(BOARDS, 2 * PAUSES, strict=True))),
    indirect=["paused"],
)
def test_the_program_goes_on_at_the_height_of_a_zero_set_at_its_pause(paused, pause):
    session, listener, ended = paused(PROGRAM.format(pause=pause))
    assert place(session) == pytest.approx({"x": 10.0, "y": 5.0, "z": 2.0}, abs=GRID)
    # The tool is in the part: it is lifted first.
    with pytest.raises(UsageError, match="jog-not-lifted"):
        session.jog_step({"x": 1.0}).result(PATIENCE)
    session.jog_step({"z": 6.0}).result(PATIENCE)
    session.jog_step({"x": 3.0}).result(PATIENCE)
    # Here the surface is found 0.5 mm higher than the old zero.
    session.jog_step({"z": -7.5}).result(PATIENCE)
    assert place(session) == pytest.approx({"x": 13.0, "y": 5.0, "z": 0.5}, abs=GRID)
    session.zero({"z": 0.0}).result(PATIENCE)
    assert session.state.state == "held"
    assert session.state.program == "part.nc"
    begun = len(listener.events)
    session.resume()
    assert ended.result(PATIENCE).outcome == "done"
    # X14 Y5, and Z8 above the new zero.
    assert place(session) == pytest.approx({"x": 14.0, "y": 5.0, "z": 8.5}, abs=GRID)
    # The state no longer names the pause.
    after = [event for event in listener.events[begun:] if isinstance(event, State)]
    assert after[-1].held == ""
    (question,) = [event for event in listener.events[begun:] if isinstance(event, Dialog)]
    # It lifts to the highest place of the program, and goes down to Z2 where it was stopped.
    zero = session.origin
    at = {letter: zero[letter] + value for letter, value in (("x", 10.0), ("y", 5.0), ("z", 8.5))}
    assert question.approach[1][2] == pytest.approx(at["z"], abs=GRID)
    assert question.approach[2][:3] == pytest.approx([at["x"], at["y"], at["z"]], abs=GRID)
    assert question.approach[3][2] == pytest.approx(zero["z"] + 2.5, abs=GRID)
    assert [event.program for event in listener.of(JobEnded)] == ["part.nc"]


def probed(session, name, **parameters):
    line = mdi_line(name, parameters, session.machine)
    ended = session.probe(line).result(PATIENCE)
    assert (ended.outcome, [finding.message for finding in ended.findings]) == ("done", [])


def test_a_surface_probed_at_a_pause_is_the_height_that_holds_then(shop, tmp_path):
    """The spindle stops with the first move by hand."""
    session = shop.session
    session.origin = zero_here(session)
    text = PROGRAM.format(pause="M0").replace("G0 Z8\n", "G0 Z8\nM3 S8000 M8\n", 1)
    _, ended = begun(session, tmp_path, text)
    assert shop.spins()
    session.jog_step({"z": 6.0}).result(PATIENCE)
    assert not shop.spins()
    session.jog_step({"x": 3.0}).result(PATIENCE)
    # A plate of 4 mm lies on the surface, which is 1.5 mm lower than the old zero.
    shop.put(session.origin["z"] + 2.5)
    probed(session, "probe_z", thickness=4.0, distance=10.0, feed=300.0)
    assert place(session)["z"] == pytest.approx(4.5, abs=2 * GRID)
    session.resume()
    assert ended.result(PATIENCE).outcome == "done"
    assert place(session) == pytest.approx({"x": 14.0, "y": 5.0, "z": 6.5}, abs=2 * GRID)


def test_a_tool_measured_at_its_change_has_this_length_then(shop, tmp_path):
    session = shop.session
    session.origin = zero_here(session)
    pause = "G0 Z4\nT2 M6\nG43 H2"
    _, ended = begun(session, tmp_path, PROGRAM.format(pause=pause))
    with pytest.raises(UsageError, match="jog-not-lifted"):
        session.jog_step({"x": 1.0}).result(PATIENCE)
    session.jog_step({"z": 4.0}).result(PATIENCE)
    session.jog_step({"x": -3.0}).result(PATIENCE)
    # The setter is 1 mm above the zero, and the tool touches it at 4.5 mm: it is 3.5 mm long.
    shop.put(session.origin["z"] + 4.5)
    probed(session, "tool_length", tool=2, height=1.0, distance=10.0, feed=300.0)
    session.resume()
    assert ended.result(PATIENCE).outcome == "done"
    assert place(session) == pytest.approx({"x": 14.0, "y": 5.0, "z": 11.5}, abs=2 * GRID)


@on_boards("operator", "grbl_shop")
def test_a_program_resumed_without_an_activity_goes_on_at_once(paused):
    session, listener, ended = paused(PROGRAM.format(pause="M0"))
    session.resume()
    assert ended.result(PATIENCE).outcome == "done"
    assert [event.kind for event in listener.of(Dialog)] == ["stop"]


@on_boards("grbl_shop", "stepper_shop")
def test_the_pass_of_a_loop_at_which_the_run_waited_is_the_one_that_goes_on(paused):
    text = """\
G21 G90 F600
#1 = 0
o1 while [#1 LT 3]
G0 Z8
G0 X[10 * #1]
M0
G1 Y[#1 + 1]
#1 = [#1 + 1]
o1 endwhile
M30
"""
    session, _, ended = paused(text)
    session.resume()
    wait_until(lambda: place(session)["x"] > 9.9 and session.state.held and rests(session))
    session.jog_step({"z": 1.0}).result(PATIENCE)
    session.resume()
    # The third pause comes next, not the second one again.
    wait_until(lambda: place(session)["x"] > 19.9 and session.state.held and rests(session))
    assert place(session)["y"] == pytest.approx(2.0, abs=GRID)
    session.resume()
    assert ended.result(PATIENCE).outcome == "done"
    assert place(session) == pytest.approx({"x": 20.0, "y": 3.0, "z": 8.0}, abs=GRID)


@on_boards("operator", "grbl_shop")
def test_a_zero_that_the_program_would_set_back_is_refused(paused):
    session, listener, ended = paused("G21 G90 F600\nG0 Z8\nG92 X1\nM0\nG0 X2\nM30\n")
    with pytest.raises(UsageError, match="pause-zero"):
        session.zero({"z": 0.0}).result(PATIENCE)
    session.stop()
    assert ended.result(PATIENCE).outcome == "stopped"
    assert listener.of(Alarm)


@on_boards("operator", "klipper_shop")
def test_a_zero_that_leads_out_of_the_travel_can_be_set_again(paused):
    session, listener, ended = paused(PROGRAM.format(pause="M0"))
    session.zero({"z": 5000.0}).result(PATIENCE)
    session.resume()
    wait_until(lambda: any(a.finding.code == "soft-limit" for a in listener.of(Alarm)))
    wait_until(lambda: session.state.state == "held")
    session.zero({"z": 2.0}).result(PATIENCE)
    session.resume()
    assert ended.result(PATIENCE).outcome == "done"
    assert place(session) == pytest.approx({"x": 14.0, "y": 5.0, "z": 8.0}, abs=GRID)


@on_boards("klipper_shop", "stepper_shop")
def test_other_activities_and_a_second_one_wait_for_the_end_of_the_pause(paused):
    session, _, ended = paused(PROGRAM.format(pause="M0"))
    for begin in (lambda: session.mdi("G0 X1"), session.home, session.disconnect):
        with pytest.raises(UsageError, match="machine-busy"):
            begin()
    jog = session.jog({"z": 1.0}, 1.0, keep_alive=PATIENCE)
    with pytest.raises(UsageError, match="machine-busy"):
        session.jog_step({"z": 1.0})
    wait_until(lambda: session.state.activity == "jog")
    session.stop()
    jog.ended.exception(PATIENCE)
    assert ended.result(PATIENCE).outcome == "stopped"
    assert session.state.activity == "none"
    # The machine is free: nothing of the pause is left.
    session.jog_step({"z": 1.0}).result(PATIENCE)


def test_a_pause_behind_a_probe_only_goes_on_by_itself(operator, tmp_path):
    file = tmp_path / "part.nc"
    file.write_text("G21 G90 F600\nG38.3 Z-1\nM0\nG0 Z1\nM30\n")
    operator.origin = zero_here(operator)
    ended = operator.run(file)
    wait_until(lambda: operator.state.held)
    with pytest.raises(UsageError, match="pause-fixed"):
        operator.jog_step({"z": 1.0}).result(PATIENCE)
    operator.resume()
    assert ended.result(PATIENCE).outcome == "done"
