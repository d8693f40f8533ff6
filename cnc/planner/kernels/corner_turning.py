r"""A curve whose curvature follows the speed: it always turns at the least radius.

The speed rises along a ramp, and the least radius R(v) that the limits along the path allow rises
with it. With the heading h for a variable, dt = R/v dh, and the path is the integral of
R (cos h, sin h).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats
from cnc.planner.kernels.arrays import LimitArrays
from cnc.planner.kernels.limits import ACCEL_SHARE, UNSEEN

LARGER = 1.003
"""Factor on the least radius. A cubic is bent by less than the rest more than the blend is."""

SMALLEST = 0.005
"""Least radius, by the tolerance."""

SWEEP, GROWTH = math.radians(30.0), 0.7
"""Largest turn of a cubic, and the ratio of the ramp's acceleration to the normal one up to which
it holds. By this ratio the speed grows with the turn. Beyond it half the turn holds.
"""

SUBSTEPS = 4
"""Steps of an integral for each cubic. The jerk is not constant in them."""

MOST_GROWTH = 2.0
"""Largest such ratio."""


class Bend(NamedTuple):
    """The least radius at the speed v: the largest of the four.

    Attributes:
        by_square: by v^2, s^2/mm.
        by_speed: by v, s.
        chord_error: mm; that of a chord of one period.
        period: s.
        least: mm.
        accel: least normal acceleration where v^2 counts, mm/s^2.
        sweep: largest turn of a cubic, rad.
    """

    by_square: float
    by_speed: float
    chord_error: float
    period: float
    least: float
    accel: float
    sweep: float


class Ramp(NamedTuple):
    """Speeding up from the apex.

    Attributes:
        v: speed at the apex, mm/s.
        top: largest speed, mm/s.
        t_jerk: duration of the two phases of jerk, s.
        t_const: duration between them, s.
        jerk: mm/s^3.
        accel: between them, mm/s^2.
    """

    v: float
    top: float
    t_jerk: float
    t_const: float
    jerk: float
    accel: float


class Place(NamedTuple):
    """A place of one half of a blend.

    Attributes:
        t: time from the apex, s.
        x: distance from the apex along the leg, mm.
        y: distance from the apex to the inside, mm.
        s: length from the apex, mm.
    """

    t: float
    x: float
    y: float
    s: float


@njit
def no_bend() -> Bend:
    """Return the least radius that stands for none."""
    return Bend(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@njit
def bend_of(plane: Floats, tolerance: float, accel: float, limits: LimitArrays) -> Bend:
    """Return the least radius in the plane of a corner.

    Args:
        plane: (2, axes): directions at right angles in it.
        tolerance: mm.
        accel: largest acceleration along the legs, mm/s^2.
        limits: of the machine.
    """
    by_square = 1.0 / limits.normal_acceleration
    for i in range(plane.shape[1]):
        most = math.hypot(plane[0, i], plane[1, i])
        by_square = max(by_square, most / (ACCEL_SHARE * limits.axis_acceleration[i]))
    shortest = math.sqrt(24.0 * (1.0 - UNSEEN) * limits.step_deviation)
    normal = min(1.0 / by_square, 8.0 * limits.chord_error / limits.period**2)
    return Bend(
        LARGER * by_square,
        LARGER * limits.period / shortest,
        limits.chord_error,
        LARGER * limits.period,
        SMALLEST * tolerance,
        normal,
        SWEEP if accel <= GROWTH * normal else 0.5 * SWEEP,
    )


@njit
def radius_at(v: float, bend: Bend) -> float:
    """Return the least radius at a speed, mm."""
    step, error = v * bend.period, bend.chord_error
    chord = 0.5 * (0.25 * step * step / error + error) if error < math.inf else 0.0
    if chord < error:
        # The chord of a half circle leaves it by the radius.
        chord = min(error, 0.5 * step)
    return max(bend.least, bend.by_square * v * v, bend.by_speed * v, chord)


@njit
def speed_at(t: float, ramp: Ramp) -> float:
    """Return the speed at a time from the apex, mm/s."""
    if t < ramp.t_jerk:
        return ramp.v + 0.5 * ramp.jerk * t * t
    left = 2.0 * ramp.t_jerk + ramp.t_const - t
    if left <= 0.0:
        return ramp.top
    if left < ramp.t_jerk:
        return ramp.top - 0.5 * ramp.jerk * left * left
    return ramp.v + ramp.accel * (t - 0.5 * ramp.t_jerk)


@njit
def _rate(t: float, ramp: Ramp, bend: Bend, scale: float) -> float:
    """Return the time by the turn, s."""
    v = speed_at(t, ramp)
    return scale * radius_at(v, bend) / v


@njit
def _step(place: Place, h1: float, h2: float, ramp: Ramp, bend: Bend, scale: float) -> Place:
    """Return the place at which the heading is ``h2``, by one step of an integral."""
    d = abs(h2 - h1)
    first = _rate(place.t, ramp, bend, scale)
    second = _rate(place.t + 0.5 * d * first, ramp, bend, scale)
    third = _rate(place.t + 0.5 * d * second, ramp, bend, scale)
    fourth = _rate(place.t + d * third, ramp, bend, scale)
    t = place.t + d / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
    last = _rate(t, ramp, bend, scale)
    middle = 0.5 * (place.t + t) + 0.125 * d * (first - last)
    r1 = scale * radius_at(speed_at(place.t, ramp), bend) * d / 6.0
    r2 = scale * radius_at(speed_at(middle, ramp), bend) * d * 4.0 / 6.0
    r3 = scale * radius_at(speed_at(t, ramp), bend) * d / 6.0
    h = 0.5 * (h1 + h2)
    return Place(
        t,
        place.x + r1 * math.cos(h1) + r2 * math.cos(h) + r3 * math.cos(h2),
        place.y + r1 * math.sin(h1) + r2 * math.sin(h) + r3 * math.sin(h2),
        place.s + r1 + r2 + r3,
    )


@njit
def turned_to(place: Place, h1: float, h2: float, ramp: Ramp, bend: Bend, scale: float) -> Place:
    """Return the place at which the heading is ``h2``, from that at which it is ``h1``.

    The turn is at most that of a cubic.
    """
    step = (h2 - h1) / SUBSTEPS
    for k in range(SUBSTEPS):
        place = _step(place, h1 + k * step, h1 + (k + 1) * step, ramp, bend, scale)
    return place


@njit
def steps_of(turn: float, bend: Bend) -> int:
    """Return the number of steps, or cubics, of a turn."""
    return max(1, math.ceil(abs(turn) / bend.sweep - 1e-9))


@njit
def turned_along(place: Place, h1: float, h2: float, ramp: Ramp, bend: Bend, scale: float) -> Place:
    """Return the place at which the heading is ``h2``, in steps."""
    steps = steps_of(h2 - h1, bend)
    for k in range(steps):
        step = (h2 - h1) / steps
        place = turned_to(place, h1 + k * step, h1 + (k + 1) * step, ramp, bend, scale)
    return place
