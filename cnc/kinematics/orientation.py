r"""Orientations of the tool as vectors: angles of a direction, and great circles between two.

With the angles t (tilt) and c (turn) of ISO 841 the tool points along, as in five_axis.py,

    d = (cos p sin t, sin p sin t, cos t)      p = c - 90 degrees for A and C, p = c for B and C

so, on the branch s = +1 or -1 of the sign of t,

    t = s atan2(sqrt(dx^2 + dy^2), dz)         p = atan2(s dy, s dx)

A great circle from d0 towards the unit vector e at right angles to it is d(u) = d0 cos wu + e sin
wu, with u from 0 to 1. The angles become polynomials of degree 7 on parts of it, as the joints do
in joints.py, with the same proof of their error. A circle through the axis of C has no bounded
speed of C. A circle that begins or ends there is a meridian: C stands still on it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kinematics.base import DEGREES
from cnc.kinematics.interval import Interval
from cnc.kinematics.series import Series, atan2, sine_cosine, sqrt

Floats = NDArray[np.float64]

ACCURACY = 1e-7
"""Largest error of an angle on a great circle, degrees."""
POLE = 1e-4
"""Degrees from the axis of C within which its angle is not defined."""
SAME = 1e-9
"""Degrees; directions that differ by less are the same."""
TURN = 360.0
DEGREE = 7
_ORDER = 8


class Swing(NamedTuple):
    """A change of the orientation.

    Attributes:
        end: tilt and turn at the end, degrees.
        nearest: least angle between the tool and the axis of C, degrees.
        parameters: (n,): share of the way of each control point; empty for a straight line.
        angles: (n, 2): control points of tilt and turn of Bezier curves of degree 7.
        knots: of the curves, 0 to 1.
    """

    end: tuple[float, float]
    nearest: float
    parameters: Floats
    angles: Floats
    knots: Floats


def swing(start: tuple[float, float], direction: Floats, shift: float) -> Swing | None:
    """Return the great circle from an orientation to a direction.

    Args:
        start: effective tilt and turn, degrees.
        direction: (3,) of the tool at the end, from the tip.
        shift: c - p, degrees.

    Returns:
        The change; None for opposite directions. One that passes the axis of C, where ``nearest``
        is below POLE, has no end.
    """
    tilt, turn = math.radians(start[0]), math.radians(start[1] - shift)
    begin = np.array(
        [math.cos(turn) * math.sin(tilt), math.sin(turn) * math.sin(tilt), math.cos(tilt)]
    )
    end = direction / np.linalg.norm(direction)
    across = end - begin * (begin @ end)
    sine, cosine = float(np.linalg.norm(across)), float(begin @ end)
    angle = math.atan2(sine, cosine)
    if angle * DEGREES <= SAME:
        return _straight(start)
    if math.pi - angle <= 1e-6:
        return None
    across /= sine
    pole = math.radians(POLE)
    sign = -1.0 if math.sin(tilt) < 0.0 else 1.0
    if math.hypot(begin[0], begin[1]) <= pole:
        return _straight(_at_turns(start, end, shift))
    if math.hypot(end[0], end[1]) <= pole:
        # The tool goes along a meridian: C stands still. The tilt may have turns of its own.
        whole = TURN * round((start[0] - math.degrees(sign * _tilt(begin))) / TURN)
        return _straight((whole + math.degrees(sign * _tilt(end)), start[1]))
    nearest = _nearest(begin, across, angle)
    if nearest <= pole:
        nothing = np.zeros(0)
        return Swing(start, nearest * DEGREES, nothing, nothing, nothing)
    return _curve(start, _Circle(begin, across, angle, sign), shift, nearest * DEGREES)


def angles_of(start: tuple[float, float], direction: Floats, shift: float) -> tuple[float, float]:
    """Return tilt and turn of a direction, on the branch and nearest to the turns of the start.

    Args:
        start: effective tilt and turn, degrees.
        direction: (3,) of the tool, from the tip.
        shift: c - p, degrees.
    """
    tilt = math.radians(start[0])
    end = direction / np.linalg.norm(direction)
    pole = math.radians(POLE)
    sign = -1.0 if math.sin(tilt) < 0.0 else 1.0
    if math.hypot(end[0], end[1]) > pole and abs(math.sin(tilt)) <= pole:
        return _at_turns(start, end, shift)
    turn = start[1]
    if math.hypot(end[0], end[1]) > pole:
        turn = math.degrees(math.atan2(sign * end[1], sign * end[0])) + shift
        turn += TURN * round((start[1] - turn) / TURN)
    # The tilt may have turns of its own.
    whole = start[0] - math.degrees(sign * math.acos(max(-1.0, min(1.0, math.cos(tilt)))))
    whole = TURN * round(whole / TURN)
    return whole + math.degrees(sign * _tilt(end)), turn


class _Circle(NamedTuple):
    """A great circle, and the branch of the tilt."""

    begin: Floats
    across: Floats
    angle: float
    sign: float

    def series(self, first: Floats, last: Floats | None) -> list[Series]:
        """Return tilt and p, rad, at places (m,), or over parts of the way."""
        order = _ORDER if last is not None else 3
        here = first if last is None else Interval(first, last)
        rate = np.full(len(first), self.angle)
        zeros = [np.zeros(len(first))] * (order - 1)
        sine, cosine = sine_cosine(Series([here * self.angle, rate, *zeros]))
        x, y, z = (cosine * float(self.begin[k]) + sine * float(self.across[k]) for k in range(3))
        flat = sqrt(x.square() + y.square())
        return [atan2(flat, z) * self.sign, atan2(y * self.sign, x * self.sign)]


def _tilt(direction: Floats) -> float:
    return math.atan2(math.hypot(direction[0], direction[1]), direction[2])


def _straight(end: tuple[float, float]) -> Swing:
    nothing = np.zeros(0)
    return Swing(end, math.inf, nothing, nothing, nothing)


def _at_turns(start: tuple[float, float], end: Floats, shift: float) -> tuple[float, float]:
    """Return tilt and turn of a direction, on the branch with the least turn of C."""
    branches = []
    for sign in (1.0, -1.0):
        turn = math.degrees(math.atan2(sign * end[1], sign * end[0])) + shift
        turn += TURN * round((start[1] - turn) / TURN)
        tilt = math.degrees(sign * _tilt(end))
        tilt += TURN * round((start[0] - tilt) / TURN)
        branches.append((abs(turn - start[1]), (tilt, turn)))
    return min(branches)[1]


def _nearest(begin: Floats, across: Floats, angle: float) -> float:
    """Return the least angle, rad, between a great circle and the line of the axis of C."""
    at = math.atan2(across[2], begin[2])
    places = [u for u in (at, at + math.pi, at - math.pi) if 0.0 <= u <= angle]
    directions = [begin * math.cos(u) + across * math.sin(u) for u in (0.0, angle, *places)]
    return min(math.atan2(math.hypot(d[0], d[1]), abs(d[2])) for d in directions)


def _curve(start: tuple[float, float], circle: _Circle, shift: float, nearest: float) -> Swing:
    """Return the Bezier curves of the angles along a great circle."""
    ends = _parts(circle)
    first, last = ends[:-1], ends[1:]
    left, right = (
        [np.stack([np.asarray(t) for t in s.terms]) * DEGREES for s in circle.series(at, None)]
        for at in (first, last)
    )
    columns = []
    for k, begin in enumerate((start[0], start[1] - shift)):
        a, b = left[k], right[k]
        # Whole turns: each part goes on where the last one ended.
        inside = np.rint((a[0] - b[0]) / TURN)
        between = np.rint((np.concatenate(([begin], b[0][:-1])) - a[0]) / TURN)
        turns = np.cumsum(between + np.concatenate(([0.0], inside[:-1])))
        a[0] += TURN * turns
        b[0] += TURN * (turns + inside)
        columns.append(_bezier(a, b, last - first) + (shift if k else 0.0))
    angles = np.stack([column.reshape(-1) for column in columns], axis=1)
    shares = np.arange(DEGREE + 1) / DEGREE
    parameters = (first[:, None] + shares * (last - first)[:, None]).reshape(-1)
    angles[0] = start
    # Curves share their ends.
    keep = np.ones(len(parameters), bool)
    keep[DEGREE + 1 :: DEGREE + 1] = False
    knots = np.concatenate(([0.0], np.repeat(ends, DEGREE), [1.0]))
    end = float(angles[-1, 0]), float(angles[-1, 1])
    return Swing(end, nearest, parameters[keep], angles[keep], knots)


def _parts(circle: _Circle) -> Floats:
    """Return the ends (n + 1,) of the parts on which the polynomials are exact enough."""
    done: list[float] = []
    first, last = np.zeros(1), np.ones(1)
    while len(first):
        worst = np.zeros(len(first))
        for series in circle.series(first, last):
            term, rate = series.terms[_ORDER], series.terms[1]
            assert isinstance(term, Interval)
            assert isinstance(rate, Interval)
            error = np.maximum(-term.lo, term.hi) * (0.5 * (last - first)) ** _ORDER * DEGREES
            swept = np.maximum(-rate.lo, rate.hi) * (last - first)
            error = np.where(swept < 0.5 * math.pi, error, np.inf)
            worst = np.maximum(worst, np.where(np.isnan(error), np.inf, error))
        exact = worst <= ACCURACY
        done += last[exact].tolist()
        a, b = first[~exact], last[~exact]
        middle = 0.5 * (a + b)
        first, last = np.concatenate((a, middle)), np.concatenate((middle, b))
    return np.array([0.0, *sorted(done)])


def _bezier(left: Floats, right: Floats, width: Floats) -> Floats:
    """Return control points (m, 8) of the polynomials with three derivatives at both ends."""
    points = np.zeros((len(width), DEGREE + 1))
    for i in range(4):
        for k in range(i + 1):
            share = math.comb(i, k) / math.comb(DEGREE, k) * width**k
            points[:, i] += share * left[k]
            points[:, DEGREE - i] += share * (-1.0) ** k * right[k]
    return points
