"""Guided measurements with the probe on machines with known errors: the errors are found."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.measure.probing import Face, backlash, pitch, square
from cnc.measure.procedures import GoTo, Scale, Todo, Touch
from cnc.model.diagnostics import UsageError
from tests.support.boards.probe_bench import Part, Slab
from tests.support.faulty_machine import FaultyMachine

WIDE = (-math.inf, math.inf)
STEPS = 200.0
"""Steps per mm of each axis."""
STEP = 1.0 / STEPS
NOISE = 0.002
"""Repeatability of the probe, mm."""
FAR = 500.0


class Rig:
    """Drives a procedure on a faulty machine, whose probe touches a part.

    All steps of the motors are kept, because the nuts depend on them.
    """

    def __init__(self, faulty, part, start=(0.0, 0.0, 0.0), on_todo=lambda _: None):
        self.faulty, self.part, self.on_todo = faulty, part, on_todo
        self.motors = [np.array(start) + 1.0, np.array(start)]

    def tool(self, motor):
        return self.faulty.tool(np.array([*self.motors, motor]))[-1:]

    def to(self, column, place):
        motor = self.motors[-1].copy()
        motor[column] = round(place * STEPS) / STEPS
        assert self.part.distance(self.tool(motor))[0] > self.part.radius, "a collision"
        self.motors.append(motor)

    def contact(self, column, way):
        """Move until the contact; return the place of the motor."""
        near, sign = self.part.contact_distance(), math.copysign(STEP, way)
        begin, low, high = self.motors[-1], 0, round(abs(way) * STEPS)

        def at(count):
            motor = begin.copy()
            motor[column] += sign * count
            return motor

        assert self.part.distance(self.tool(at(high)))[0] <= near, "no contact"
        while high - low > 1:
            middle = (low + high) // 2
            if self.part.distance(self.tool(at(middle)))[0] <= near:
                high = middle
            else:
                low = middle
        self.motors.append(at(high))
        return float(at(high)[column])

    def touch(self, step):
        column, back = "xyz".index(step.axis), math.copysign(1.0, step.way)
        start, contacts = float(self.motors[-1][column]), []
        met = self.contact(column, step.way)
        for _ in range(step.contacts):
            self.to(column, met - back)
            contacts.append(self.contact(column, 2.0 * back))
        self.to(column, start)
        return tuple(contacts)

    def run(self, procedure):
        answer = 0.0
        try:
            step = next(procedure)
            while True:
                if isinstance(step, GoTo):
                    assert step.guarded
                    self.to("xyz".index(step.axis), step.place)
                elif isinstance(step, Todo):
                    self.on_todo(step.text)
                else:
                    assert isinstance(step, Touch)
                    answer = self.touch(step)
                step = procedure.send(answer)
        except StopIteration as end:
            return end.value


def scale(letter="x", place=0.0, travel=WIDE):
    return Scale(letter, STEPS, place, travel)


def slanted(degrees, towards, pair=(0, 1)):
    """Return a block whose long face is 6 mm from zero along the second direction of the pair."""
    away = 6.0 * math.cos(math.radians(degrees))
    low, high = [-FAR, -FAR, -FAR], [FAR, FAR, FAR]
    low[pair[1]], high[pair[1]] = (away, away + FAR) if towards > 0 else (-away - FAR, -away)
    return Slab(tuple(low), tuple(high), degrees, pair)


@given(
    play=st.floats(0.01, 0.2),
    degrees=st.sampled_from([-52.0, -45.0, -38.0, 38.0, 45.0, 52.0]),
    towards=st.sampled_from([1, -1]),
    axes=st.sampled_from(["xy", "yx", "xz", "zy"]),
    radius=st.floats(0.5, 3.0),
    seed=st.integers(0, 2**32 - 1),
)
def test_backlash_is_measured_to_a_step(play, degrees, towards, axes, radius, seed):
    """Neither the ball, nor the play of the axis that touches, nor the angle of the face counts."""
    letter, other = axes
    faulty = FaultyMachine(0.1, -0.1, 0.05, backlash={letter: play, other: 0.07})
    pair = ("xyz".index(letter), "xyz".index(other))
    part = Part([slanted(degrees, towards, pair)], radius, NOISE, seed)
    procedure = backlash(scale(letter), scale(other), Face(towards, 12.0))
    measured = Rig(faulty, part).run(procedure)
    assert abs(measured.keys["axes", letter, "backlash"] - play) <= STEP
    assert "contacts within 0.0" in measured.remark


def test_an_axis_without_play_loses_the_key():
    part = Part([slanted(45.0, 1)], 1.0)
    measured = Rig(FaultyMachine(), part).run(backlash(scale(), scale("y"), Face()))
    assert measured.keys == {("axes", "x", "backlash"): None}


@given(
    seed=st.integers(0, 2**32 - 1),
    towards=st.sampled_from([1, -1]),
    count=st.integers(4, 12),
    play=st.sampled_from([0.0, 0.05]),
)
def test_errors_of_a_screw_are_measured_to_a_step(seed, towards, count, play):
    """Faces at distances of their own; the probe passes over them."""
    rng = np.random.default_rng(seed)
    size, slope = 0.03 * rng.uniform(-1, 1), 1e-4 * rng.uniform(-1, 1)
    phase = rng.uniform(0, 6)

    def error(x):
        return size * np.sin(x / 60.0 + phase) + slope * x

    faulty = FaultyMachine(screws={"x": error}, backlash={"x": play} if play else {})
    faces = np.concatenate(([0.0], np.cumsum(rng.uniform(22.0, 27.0, count - 1))))
    # The first face lies 5 mm from the probe; each is one side of a block of 8 mm.
    first = 5.0 * towards + (1.0 if towards > 0 else -1.0)
    slabs = [
        Slab(
            (first + at - (0.0 if towards > 0 else 8.0), -FAR, -FAR),
            (first + at + (8.0 if towards > 0 else 0.0), FAR, 12.0),
        )
        for at in faces
    ]
    travel = (-20.0, float(faces[-1]) + 20.0)
    procedure = pitch(
        scale(travel=travel),
        scale("z"),
        Face(towards, 10.0),
        faces=tuple(faces),
        lift=20.0,
        blocks=False,
    )
    measured = Rig(faulty, Part(slabs, 1.0, NOISE, seed)).run(procedure)
    table = measured.table[1:-1]
    assert len(table) == count
    nuts = np.array([row.place for row in table]) - 0.5 * towards * play
    off = np.array([row.forward for row in table]) - error(nuts)
    assert 0.5 * np.ptp(off) <= STEP
    assert all(row.forward == row.reverse for row in table)
    assert ("axes", "x", "backlash") not in measured.keys


@given(
    angle=st.floats(-0.5, 0.5),
    own=st.floats(-0.1, 0.1),
    laid=st.floats(-1.0, 1.0),
    outside=st.booleans(),
    signs=st.sampled_from([(1, 1), (1, -1), (-1, 1), (-1, -1)]),
    letters=st.sampled_from(["xy", "xz", "yz"]),
    seed=st.integers(0, 2**32 - 1),
)
def test_the_angle_between_two_axes_is_measured(angle, own, laid, outside, signs, letters, seed):
    """The square lies askew and has an error of its own, which goes when it is turned over."""
    pair = ("xyz".index(letters[0]), "xyz".index(letters[1]))
    lengths = (signs[0] * 150.0, signs[1] * 130.0)
    part = Part([], 1.0, NOISE, seed)
    side = -1.0 if outside else 1.0

    def lay(corner, ways, error):
        """Lay the square so that the probe is 6 mm from its legs, at their corner."""
        first, second = math.radians(laid), math.radians(laid + error)
        spans = []
        for k, way in enumerate(ways):
            # A leg reaches from 40 mm before the corner to 40 mm behind its end; outside from
            # the corner, and the second one from behind the first one's face.
            before = -6.0 - 4.0 * k if outside else 40.0
            spans.append(sorted((-before * math.copysign(1.0, way), way + 40.0 * np.sign(way))))
        across = [-np.sign(ways[1 - k]) * side for k in range(2)]
        part.slabs = []
        for k, turn in enumerate((first, second)):
            low, high = [-FAR] * 3, [FAR] * 3
            low[pair[k]], high[pair[k]] = spans[k]
            near = sorted((across[k] * 6.0, across[k] * 16.0))
            low[pair[1 - k]], high[pair[1 - k]] = near
            part.slabs.append(
                Moved(Slab(tuple(low), tuple(high), math.degrees(turn), pair), corner)
            )

    class Moved:
        def __init__(self, slab, corner):
            self.slab, self.corner = slab, corner

        def distance(self, places):
            return self.slab.distance(places - self.corner)

    faulty = FaultyMachine(**{letters: angle}, backlash={"x": 0.05, "y": 0.03})
    rig = Rig(faulty, part, (10.0, -20.0, 5.0))

    def turned_over(text):
        assert "turn the square over" in text
        lay(rig.tool(rig.motors[-1])[0], (lengths[0], -lengths[1]), -own)

    rig.on_todo = turned_over
    lay(rig.tool(rig.motors[-1])[0], lengths, own)
    scales = tuple(scale(letter, (10.0, -20.0, 5.0)["xyz".index(letter)]) for letter in letters)
    measured = rig.run(square(scales, Face(1, 12.0), lengths=lengths, outside=outside))
    ((path, text),) = measured.keys.items()
    assert path == ("machine", "squareness", letters)
    assert abs((0.0 if text is None else float(text.removesuffix(" deg"))) - angle) <= 0.005
    assert abs(float(measured.remark.split("own error ")[1].split()[0]) - own) <= 0.005


def refused(procedure, part, faulty=None):
    with pytest.raises(UsageError) as raised:
        Rig(faulty or FaultyMachine(), part).run(procedure)
    return raised.value.diagnostic


@pytest.mark.parametrize(("degrees", "towards"), [(5.0, 1), (-8.0, -1), (78.0, 1)])
def test_a_face_that_is_not_slanted_is_refused(degrees, towards):
    face = Face(towards, 100.0)
    wrong = refused(backlash(scale(), scale("y"), face), Part([slanted(degrees, towards)], 0.1))
    assert (wrong.code, "leans by" in wrong.message) == ("measure-readings", True)


def test_contacts_that_do_not_agree_are_refused():
    part = Part([slanted(45.0, 1)], 1.0, 0.05, 3)
    wrong = refused(backlash(scale(), scale("y"), Face(1, 12.0)), part)
    assert (wrong.code, "contacts along Y differ" in wrong.message) == ("measure-readings", True)


def test_one_bad_contact_is_touched_again():
    part = Part([slanted(45.0, 1)], 1.0)
    draws = iter([1.0, 1.3])
    part.contact_distance = lambda: next(draws, 1.0)
    measured = Rig(FaultyMachine(backlash={"x": 0.05}), part).run(
        backlash(scale(), scale("y"), Face(1, 12.0))
    )
    assert measured.keys["axes", "x", "backlash"] == pytest.approx(0.05, abs=STEP)
    assert "contacts within 0.0000 mm" in measured.remark


@pytest.mark.parametrize(
    ("procedure", "code"),
    [
        (backlash(scale(), scale("x"), Face()), "measure-option"),
        (backlash(scale(), scale("y"), Face(1, -5.0)), "measure-option"),
        (backlash(scale(), scale("y"), Face(1, 5.0, 0)), "measure-option"),
        (backlash(scale(travel=(0.0, 9.0)), scale("y"), Face()), "measure-travel"),
        (backlash(scale(), scale("y", travel=(-5.0, 5.0)), Face()), "measure-travel"),
        (square((scale(), scale("y")), Face(), lengths=(5.0, 90.0)), "measure-option"),
        (
            square((scale(), scale("y")), Face(), lengths=(25.0, 90.0), outside=True),
            "measure-option",
        ),
        (
            square((scale(), scale("y", travel=(-5.0, 99.0))), Face(), lengths=(90.0, 90.0)),
            "measure-travel",
        ),
        *(
            (
                pitch(
                    scale(travel=(0.0, 60.0)),
                    scale("z"),
                    Face(1, 4.0),
                    faces=faces,
                    lift=lift,
                    blocks=False,
                ),
                code,
            )
            for faces, lift, code in [
                ((0.0,), 20.0, "measure-option"),
                ((1.0, 50.0), 20.0, "measure-option"),
                ((0.0, 30.0, 30.5, 60.0), 20.0, "measure-option"),
                ((0.0, 10.0, 20.0), 20.0, "measure-option"),
                ((0.0, 30.0, 60.0), 0.0, "measure-option"),
                ((0.0, 30.0, 60.0), 20.0, "measure-travel"),
            ]
        ),
    ],
)
def test_what_cannot_be_measured_is_refused_before_the_first_move(procedure, code):
    with pytest.raises(UsageError) as raised:
        next(procedure)
    assert raised.value.diagnostic.code == code
