"""Rounds between lines and arcs: tangential to both moves, on the right side, inside of them."""

from __future__ import annotations

import cmath
import math

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from cnc.gcode.core.corners import Arc, Line, Move, round_between

angles = st.floats(-math.pi, math.pi)
lengths = st.floats(5.0, 50.0)
turns = st.floats(0.1, 0.9).flatmap(lambda part: st.sampled_from([part, -part]))
CORNER = 3.0 + 4.0j


def before(length: float, heading: float, part: float, *, arc: bool) -> Move:
    """A move that ends at the corner with a heading."""
    ahead = cmath.rect(1.0, heading)
    if not arc:
        return Line(CORNER - length * ahead, CORNER)
    centre = CORNER + math.copysign(length, part) * 1j * ahead
    return Arc(centre + (CORNER - centre) * cmath.rect(1.0, -math.tau * part), CORNER, centre, part)


def after(length: float, heading: float, part: float, *, arc: bool) -> Move:
    """A move that begins at the corner with a heading."""
    ahead = cmath.rect(1.0, heading)
    if not arc:
        return Line(CORNER, CORNER + length * ahead)
    centre = CORNER + math.copysign(length, part) * 1j * ahead
    return Arc(CORNER, centre + (CORNER - centre) * cmath.rect(1.0, math.tau * part), centre, part)


moves = st.tuples(lengths, angles, turns, st.booleans())


@given(moves, moves, st.floats(0.05, 3.0))
@example((10.0, 0.0, 0.25, False), (10.0, math.pi / 2, 0.25, True), 2.0)
def test_a_round_touches_both_moves(
    one: tuple[float, float, float, bool], other: tuple[float, float, float, bool], radius: float
) -> None:
    first = before(*one[:3], arc=one[3])
    second = after(*other[:3], arc=other[3])
    found = round_between(first, second, radius)
    assume(found is not None)
    assert found is not None
    assert abs(found.begin - found.centre) == pytest.approx(radius, rel=1e-6)
    assert abs(found.end - found.centre) == pytest.approx(radius, rel=1e-6)
    spin = math.copysign(1.0, found.turns)
    for point, move in ((found.begin, first), (found.end, second)):
        heading = spin * 1j * (point - found.centre) / radius
        assert heading == pytest.approx(move.direction(point), abs=1e-6)
        assert move.holds(point)
    # The round turns in the direction of the corner, and leads from the first place to the second.
    turned = (found.begin - found.centre) * cmath.rect(1.0, math.tau * found.turns)
    assert found.centre + turned == pytest.approx(found.end, abs=1e-6)
    change = first.direction(CORNER).conjugate() * second.direction(CORNER)
    assert spin == math.copysign(1.0, change.imag)


@given(st.floats(0.2, 2.0), st.floats(0.05, 0.5), st.sampled_from([1.0, -1.0]))
def test_small_rounds_of_clear_corners_exist(turn: float, radius: float, side: float) -> None:
    for kinds in ((False, True), (True, False), (True, True)):
        first = before(10.0, 0.0, 0.2 * side, arc=kinds[0])
        second = after(10.0, side * turn, 0.2, arc=kinds[1])
        assert round_between(first, second, radius) is not None


def test_a_round_of_a_line_and_a_circle() -> None:
    """Centre 2 above the line and 10 - 2 from the centre of the circle: x = sqrt(8**2 - 2**2)."""
    found = round_between(Line(0j, 10 + 0j), Arc(10 + 0j, 10j, 0j, 0.25), 2.0)
    assert found is not None
    assert found.centre == pytest.approx(math.sqrt(60.0) + 2j)
    assert found.begin == pytest.approx(math.sqrt(60.0))
    assert found.end == pytest.approx((math.sqrt(60.0) + 2j) * 10.0 / 8.0)


@pytest.mark.parametrize(
    ("first", "second", "radius"),
    [
        (Line(0j, 10 + 0j), Arc(10 + 0j, 20 + 10j, 10 + 10j, 0.25), 1.0),  # tangential
        (Line(9.9 + 0j, 10 + 0j), Arc(10 + 0j, 10j, 0j, 0.25), 2.0),  # a line too short
        (Line(0j, 10 + 0j), Arc(10 + 0j, 9.99 + 0.447j, 0j, 0.007), 2.0),  # an arc too short
        (Line(0j, 10 + 0j), Arc(10 + 0j, 10j, 0j, 0.25), 11.0),  # larger than the circle
    ],
)
def test_a_round_that_does_not_fit(first: Move, second: Move, radius: float) -> None:
    assert round_between(first, second, radius) is None
