"""Guided measurements on machines with known errors: the errors are found."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.machine.compensation import screw
from cnc.measure.procedures import GoTo, Reading, Scale, backlash, pitch, square
from cnc.model.diagnostics import UsageError
from tests.support.faulty_machine import FaultyMachine

WIDE = (-math.inf, math.inf)
STEPS = 400.0
"""Steps per mm of each axis."""


class Rig:
    """Drives a procedure on a faulty machine, with a gauge that reads what ``gauge`` returns."""

    def __init__(self, faulty, gauge, start=(0.0, 0.0, 0.0), backlash_before=1.0):
        self.faulty, self.gauge = faulty, gauge
        self.motors = [np.array(start) + backlash_before, np.array(start)]

    def run(self, procedure):
        answer = 0.0
        try:
            step = next(procedure)
            while True:
                if isinstance(step, GoTo):
                    place = self.motors[-1].copy()
                    # A motor goes to whole steps.
                    place["xyz".index(step.axis)] = round(step.place * STEPS) / STEPS
                    self.motors.append(place)
                else:
                    assert isinstance(step, Reading)
                    answer = self.gauge(self.faulty.tool(np.array(self.motors))[-1], step.text)
                step = procedure.send(answer)
        except StopIteration as end:
            return end.value


def scale(letter="x", place=0.0, travel=WIDE):
    return Scale(letter, STEPS, place, travel)


def hundredths(value):
    return round(value, 2)


@given(
    play=st.floats(0.004, 0.3),
    place=st.floats(-50.0, 50.0),
    offset=st.floats(-5.0, 5.0),
    axis=st.sampled_from("xyz"),
)
def test_backlash_is_measured_to_a_step(play, place, offset, axis):
    column = "xyz".index(axis)
    start = np.zeros(3)
    start[column] = round(place * STEPS) / STEPS
    rig = Rig(FaultyMachine(backlash={axis: play}), lambda tool, _: offset - tool[column], start)
    measured = rig.run(backlash(scale(axis, float(start[column]))))
    value = measured.keys["axes", axis, "backlash"]
    assert abs(value - play) <= 1.0 / STEPS
    assert all(abs(row.after) <= 1.0 / STEPS for row in measured.rows)


def test_backlash_of_a_gauge_of_hundredths_is_right_within_one():
    faulty = FaultyMachine(backlash={"x": 0.05})
    rig = Rig(faulty, lambda tool, _: hundredths(tool[0] + 0.003))
    assert rig.run(backlash(scale())).keys["axes", "x", "backlash"] == pytest.approx(0.05, abs=0.01)


def test_an_axis_without_play_loses_the_key():
    rig = Rig(FaultyMachine(), lambda tool, _: tool[0])
    measured = rig.run(backlash(scale()))
    assert measured.keys == {("axes", "x", "backlash"): None}
    assert "no backlash" in measured.title


@pytest.mark.parametrize(
    ("gauge", "reason"),
    [
        (lambda tool, _: 1.0, "does not follow"),
        (lambda tool, _: 2.0 * tool[0], "the gauge moved"),
        (lambda tool, text: tool[0] + 0.03 * ("reversal 2" in text), "reversals differ"),
        (lambda tool, text: tool[0] + 0.03 * ("began" in text), "where it showed"),
    ],
)
def test_readings_of_a_loose_gauge_are_refused(gauge, reason):
    with pytest.raises(UsageError) as refused:
        Rig(FaultyMachine(), gauge).run(backlash(scale()))
    assert refused.value.diagnostic.code == "measure-readings"
    assert reason in refused.value.diagnostic.message


@given(
    seed=st.integers(0, 2**32 - 1),
    play=st.sampled_from([0.0, 0.02, 0.06]),
    count=st.integers(4, 20),
)
def test_errors_of_a_screw_are_measured_to_a_step(seed, play, count):
    rng = np.random.default_rng(seed)
    a, b, phase = 0.03 * rng.uniform(-1, 1), 1e-4 * rng.uniform(-1, 1), rng.uniform(0, 6)

    def error(x):
        return a * np.sin(x / 60.0 + phase) + b * x

    faulty = FaultyMachine(screws={"x": error}, backlash={"x": play} if play else {})
    begin = rng.uniform(-5, 5)
    rig = Rig(faulty, lambda tool, _: tool[0] + begin)
    axis = scale(travel=(-102.0, 202.0))
    measured = rig.run(pitch(axis, first=-100.0, last=200.0, places=count, both=bool(play)))
    assert (("axes", "x", "backlash") in measured.keys) == bool(play)
    table = measured.table[1:-1]
    places = np.array([row.place for row in table])
    middle = places + (0.0 if not play else -0.5 * play)
    expected = error(middle) - error(middle)[0]
    forward = np.array([row.forward for row in table])
    assert np.abs(forward - expected).max() <= 1.0 / STEPS
    widths = [row.reverse - row.forward for row in table]
    assert widths == pytest.approx([play] * count, abs=1.0 / STEPS)
    # With the table the machine stands where it shall, at places between too.
    correction = screw(measured.table, None)
    for side in (1.0, -1.0)[: 2 if play else 1]:
        motors = places + correction.correction(places, side)
        reached = motors - 0.5 * side * play + error(motors - 0.5 * side * play)
        off = reached - places
        assert np.ptp(off) <= 2.0 / STEPS + 1e-3


@given(
    angle=st.floats(-0.5, 0.5),
    own=st.floats(-0.1, 0.1),
    laid=st.floats(-2.0, 2.0),
    to_plus=st.booleans(),
    pair=st.sampled_from([("x", "y"), ("x", "z"), ("y", "z")]),
)
def test_the_angle_between_two_axes_is_measured(angle, own, laid, to_plus, pair):
    """The square lies askew and has an error of its own, which goes when it is turned over."""
    name = "".join(pair)
    faulty = FaultyMachine(**{name: angle})
    columns = ["xyz".index(letter) for letter in pair]
    legs = {"turned": False}

    def gauge(tool, text):
        if "turn the square over" in text:
            legs["turned"] = True
        where = tool[columns]
        first = math.radians(laid)
        second = first + math.radians(90.0 + (-own if legs["turned"] else own))
        if f"leg along {pair[0].upper()}," in text:
            legs["leg"] = 0
        elif f"leg along {pair[1].upper()}," in text:
            legs["leg"] = 1
        # Place of the leg across the axis, from that of the gauge.
        if legs["leg"] == 0:
            away = where[0] * math.tan(first) - where[1]
        else:
            away = where[1] / math.tan(second) - where[0]
        return 3.0 + (-away if to_plus else away)

    procedure = square(
        (scale(pair[0]), scale(pair[1])), lengths=(120.0, -90.0), points_to_plus=to_plus
    )
    measured = Rig(faulty, gauge).run(procedure)
    (path, text) = next(iter(measured.keys.items()))
    assert path == ("machine", "squareness", name)
    value = 0.0 if text is None else float(text.removesuffix(" deg"))
    assert abs(value - angle) <= 0.005
    remark = float(measured.remark.split("own error ")[1].split()[0])
    assert abs(remark - own) <= 0.005


@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: backlash(scale(), reverse=0.0), "measure-option"),
        (lambda: backlash(scale(), repeats=0), "measure-option"),
        (lambda: backlash(scale(travel=(-1.0, 10.0))), "measure-travel"),
        (lambda: pitch(scale(), first=0.0, last=50.0), "measure-option"),
        (lambda: pitch(scale(travel=(-2.0, 3.0)), first=0.0, last=0.5), "measure-option"),
        (
            lambda: pitch(scale(travel=(-2.0, 3.0)), first=0.0, last=2.0, places=1000),
            "measure-option",
        ),
        (lambda: pitch(scale(travel=(0.0, 51.0)), first=0.0, last=50.0), "measure-travel"),
        (lambda: pitch(scale(travel=(0.0, 100.0)), first=2.0, last=50.0), "measure-option"),
        (
            lambda: pitch(scale(travel=(-2.0, 60.0)), first=math.nan, last=50.0),
            "measure-option",
        ),
        (lambda: square((scale("x"), scale("y")), lengths=(5.0, 50.0)), "measure-option"),
        (
            lambda: square((scale("x"), scale("y", travel=(0.0, 9.0))), lengths=(50.0, 50.0)),
            "measure-travel",
        ),
    ],
)
def test_what_cannot_be_measured_is_refused_before_a_move(make, code):
    with pytest.raises(UsageError) as refused:
        next(make())
    assert refused.value.diagnostic.code == code


def test_the_table_covers_the_travel():
    """Beyond the places the error is that of the nearest one: the axis cannot come from there."""
    rig = Rig(FaultyMachine(screws={"x": lambda x: 1e-4 * x}), lambda tool, _: tool[0])
    axis = scale(travel=(-10.0, 110.0))
    measured = rig.run(pitch(axis, first=0.0, last=100.0, places=6))
    assert [row.place for row in measured.table] == [-10, 0, 20, 40, 60, 80, 100, 110]
    assert measured.table[0].forward == measured.table[1].forward
    assert measured.table[-1].forward == measured.table[-2].forward


def test_readings_of_no_screw_are_refused():
    rig = Rig(FaultyMachine(), lambda tool, _: -tool[0])
    with pytest.raises(UsageError, match="no screw does"):
        rig.run(pitch(scale(travel=(-2.0, 102.0)), first=0.0, last=100.0, places=5))
