"""Guided measurements of a session, on a machine whose motors move a tool with errors."""

import numpy as np
import pytest

from cnc.boards.protocols import Accelerations
from cnc.machine.load import load_machine
from cnc.measure.orders import Backlash, Pitch, Ringing, Square, TouchProbe
from cnc.model.diagnostics import BoardError, Diagnostic, UsageError
from cnc.operate.measuring import Moves
from cnc.operate.operator_session import OperatorSession
from tests.support.boards.probe_bench import Part, ProbeBench
from tests.support.faulty_machine import FaultyMachine
from tests.support.waiting import wait_until

PATIENCE = 60.0
STEPS = 400.0
STEP = 1.0 / STEPS
PLAY = 0.05
AXIS = """\
[axes.{letter}]
steps_per_mm = 400.0
max_velocity = 400.0
max_acceleration = 8000.0
max_jerk = 400000.0
travel = [-60, 60]
backlash = {play}

"""


def machine_with(tmp_path, play=PLAY):
    file = tmp_path / "mill.toml"
    tables = "".join(AXIS.format(letter=letter, play=play) for letter in "xyz")
    file.write_text(f'[machine]\nname = "Mill"\n\n{tables}[board]\nkind = "loopback"\n')
    return load_machine(file)


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """A session connected to a bench with play in each nut, which the machine file states."""

    class Bench(ProbeBench):
        @classmethod
        def for_operator(cls, machine, start):
            faulty = FaultyMachine(backlash=dict.fromkeys("xyz", PLAY))
            return cls(machine, (PLAY / 2.0,) * 3, faulty, Part([]))

    monkeypatch.setattr("cnc.boards.registry.board_factory", lambda _: Bench)
    with OperatorSession(machine_with(tmp_path)) as session:
        session.connect().result(PATIENCE)
        session.board = session._worker.machine.board
        yield session


@pytest.fixture
def paced(tmp_path):
    """A session of the loopback board in real time; the machine has backlash."""
    with OperatorSession(machine_with(tmp_path)) as session:
        session.connect("loopback").result(PATIENCE)
        yield session


class Answers:
    """Answers each question with what a function reads; keeps the events."""

    def __init__(self, session, read):
        self.session, self.read, self.texts, self.codes = session, read, [], []
        session.listen(self)

    def __call__(self, event):
        if event.event == "notice":
            self.codes.append(event.finding.code)
        if event.event == "dialog":
            self.texts.append(event.text)
            value = self.read(event.text)
            if value is not None:
                self.session.answer(event.id, True, value)


def is_compensated(session):
    """Whether positions and programs are those of the compensated machine."""
    machines = (session._programs.machine, session._worker.machine.machine)
    return all(machine.axes["x"].backlash == PLAY for machine in machines)


def test_between_readings_the_machine_is_not_compensated(bench):
    """The file states the whole play, and the measurement finds it all the same."""
    seen = []

    def gauge(_):
        seen.append(bench._programs.machine.axes["x"].backlash)
        return float(bench.board.tool[0])

    Answers(bench, gauge)
    measured = bench.measure(Backlash(axis="x"), Moves()).result(PATIENCE)
    assert measured.keys["axes", "x", "backlash"] == pytest.approx(PLAY, abs=STEP)
    assert seen == [None] * 7
    assert is_compensated(bench)
    # What moves between two activities goes by the compensated machine again.
    for way in (3.0, -7.0, 2.0):
        bench.jog_step({"x": way}).result(PATIENCE)
        assert bench.board.tool[0] == pytest.approx(bench.state.machine["x"], abs=1.5 * STEP)


def test_nuts_that_end_pushed_down_are_pushed_up(bench):
    """Else the display, and the next program, are off by the backlash."""
    answers = Answers(bench, lambda _: float(bench.board.tool[0]))
    order = Pitch(axis="x", first=-50.0, last=50.0, places=5, both=True)
    measured = bench.measure(order, Moves()).result(PATIENCE)
    assert {round(row.reverse - row.forward, 2) for row in measured.table} == {PLAY}
    assert bench.board.tool[0] == pytest.approx(-50.0 + PLAY / 2.0, abs=1.5 * STEP)
    assert bench.state.machine["x"] == pytest.approx(bench.board.tool[0], abs=1.5 * STEP)
    assert answers.codes == []


def test_nothing_else_moves_the_machine_between_two_readings(bench):
    answers = Answers(bench, lambda _: None)
    future = bench.measure(Backlash(axis="x"), Moves())
    wait_until(lambda: answers.texts)
    assert bench.state.activity == "measure"
    for act in (
        lambda: bench.jog_step({"x": 1.0}),
        lambda: bench.mdi("G0 X1"),
        lambda: bench.measure(Backlash(axis="y"), Moves()),
        bench.disconnect,
    ):
        with pytest.raises(UsageError, match="the machine is busy: measure"):
            act()
    with pytest.raises(UsageError, match="no number for: the gauge"):
        bench.answer(bench.dialog.id, True)
    with pytest.raises(UsageError, match="no number for"):
        bench.answer(bench.dialog.id, True, float("nan"))
    bench.stop()
    assert future.result(PATIENCE) is None


@pytest.mark.parametrize("how", ["stop", "no", "lost board", "close"])
def test_a_measurement_that_does_not_end_well_leaves_the_compensated_machine(bench, how):
    answers = Answers(bench, lambda _: None)
    future = bench.measure(Backlash(axis="x"), Moves())
    wait_until(lambda: answers.texts)
    assert not is_compensated(bench)

    def lost(*_):
        raise BoardError(Diagnostic("link-lost", "the link is lost"))

    if how == "stop":
        bench.stop()
    elif how == "no":
        bench.answer(bench.dialog.id, False)
    elif how == "close":
        bench.close()
    else:
        type(bench.board).switches = property(lost)
        type(bench.board).revive = lost
    if how == "lost board":
        with pytest.raises(UsageError, match="no board is connected"):
            future.result(PATIENCE)
        assert bench.state.board == ""
    else:
        assert future.result(PATIENCE) is None
        assert "measurement-stopped" in answers.codes
    assert bench.dialog is None
    assert bench._programs.machine.axes["x"].backlash == PLAY


def test_a_stop_in_motion_brings_the_axis_to_rest_and_asks_for_homing(paced):
    answers = Answers(paced, lambda _: None)
    future = paced.measure(Backlash(axis="x"), Moves(feed=0.5))
    wait_until(lambda: paced.state.machine["x"] < -0.1)
    paced.stop()
    assert future.result(PATIENCE) is None
    assert answers.texts == []
    assert answers.codes == ["measurement-stopped", "measurement-home"]
    assert -1.4 < paced.state.machine["x"] < -0.1
    assert is_compensated(paced)


def test_a_hold_waits_and_the_move_goes_on(paced):
    answers = Answers(paced, lambda _: None)
    future = paced.measure(Backlash(axis="x"), Moves(feed=4.0))
    wait_until(lambda: paced.state.machine["x"] < -0.2)
    paced.hold()
    wait_until(lambda: paced.state.state == "held")
    assert paced.state.held == "hold request"
    assert not answers.texts
    paced.resume()
    wait_until(lambda: answers.texts)
    # It has come to the place from below.
    assert paced.state.machine["x"] == pytest.approx(PLAY / 2.0, abs=STEP)
    paced.stop()
    future.result(PATIENCE)


@pytest.mark.parametrize(
    ("order", "code"),
    [
        (Backlash(axis="q"), "measure-axis"),
        (Square(axes="xx", lengths=(50.0, 50.0)), "measure-axis"),
        (Pitch(axis="x"), "measure-option"),
        (Backlash(axis="x", probe=TouchProbe(touch="Y")), "measure-option"),
        (Pitch(axis="x", probe=TouchProbe(touch="Y-")), "measure-option"),
    ],
)
def test_an_order_that_cannot_be_carried_out_is_refused_at_once(paced, order, code):
    with pytest.raises(UsageError) as refused:
        paced.measure(order, Moves())
    assert refused.value.diagnostic.code == code
    assert paced.state.activity == "none"


def test_a_simulated_board_has_no_probe(paced):
    order = Backlash(axis="x", probe=TouchProbe(touch="Y-"))
    with pytest.raises(UsageError, match="a simulated board has no probe"):
        paced.measure(order, Moves()).result(PATIENCE)


RATE = 1000.0


class Sensor:
    """An accelerometer at a tool that rings after each move, written from the formula of a decay.

    A sample is taken for each millisecond of a rest; between them the axis moves, which is noise.
    """

    def __init__(self, frequency, damping):
        self.frequency, self.damping, self.calls = frequency, damping, []

    def begin(self):
        self.calls.append("begin")

    def mark(self):
        self.calls.append("mark")

    def end(self):
        self.calls.append("end")
        rests = self.calls.count("mark") // 2
        t = np.arange(700) / RATE
        w = 2.0 * np.pi * self.frequency
        wave = np.exp(-self.damping * w * t) * np.cos(w * (1.0 - self.damping**2) ** 0.5 * t)
        moves = np.random.default_rng(5).normal(0.0, 3.0, 50)
        rest = [np.zeros(700), *([wave] * (rests - 1))]
        column = 9.81 + np.concatenate([np.concatenate((part, moves)) for part in rest])
        marks = tuple(750 * k + end for k in range(rests) for end in (0, 700))
        return Accelerations(RATE, {"x": column, "y": 0.0 * column}, marks)


def test_an_axis_is_shaken_and_its_rests_show_the_mode(bench, monkeypatch):
    monkeypatch.setattr("cnc.measure.ringing.REST", 0.01)
    sensor = Sensor(33.0, 0.04)
    type(bench.board).accelerometer = sensor
    places = []

    def mark():
        sensor.calls.append("mark")
        places.append(round(bench.state.machine["x"] - PLAY / 2.0, 2))

    sensor.mark = mark
    measured = bench.measure(Ringing(axis="X"), Moves()).result(PATIENCE)
    (mode,) = measured.modes
    assert mode.axis == "x"
    assert mode.frequency == pytest.approx(33.0, rel=0.001)
    assert mode.damping == pytest.approx(0.04, rel=0.02)
    (row,) = measured.keys["vibration", "x"]
    assert row == {"frequency": round(mode.frequency, 2), "damping": round(mode.damping, 4)}
    ways = [0.8, 1.3, 2.1, 3.4, 5.5]
    assert places == [0.0, 0.0, *(at for way in ways for at in (way, way, 0.0, 0.0))]
    assert (sensor.calls[0], sensor.calls[-1], sensor.calls.count("end")) == ("begin", "end", 1)
    assert is_compensated(bench)


def test_a_stop_ends_the_record(bench):
    sensor = type(bench.board).accelerometer = Sensor(33.0, 0.04)
    future = bench.measure(Ringing(axis="x"), Moves())
    wait_until(lambda: sensor.calls.count("mark") >= 3)
    bench.stop()
    assert future.result(PATIENCE) is None
    assert sensor.calls[-1] == "end"


def test_a_board_without_an_accelerometer_moves_nothing(bench):
    with pytest.raises(UsageError, match="the board has no accelerometer"):
        bench.measure(Ringing(axis="x"), Moves()).result(PATIENCE)
    assert bench.board.rows == 0
