r"""S-curve ramps: changes of speed at bounded acceleration and jerk.

A ramp starts and ends with zero acceleration. Between speeds v0 and v1 it has up to three phases:
jerk, constant acceleration, opposite jerk. A profile over a length is a ramp up, a cruise and a
ramp down: the seven phases of Hui, Wei and Gao (2013), section 4.1.

        a
      A |    ________
        |   /        \
        |  /          \
        +-/------------\----- t

With dv = |v1 - v0| the ramp takes

    t = dv/A + A/J       if dv >= A^2/J, where the acceleration A is reached,
    t = 2 sqrt(dv/J)     otherwise, with a triangle of acceleration.

It is symmetric about its middle, so that its length is t (v0 + v1) / 2.
"""

from __future__ import annotations

import math

from cnc.compiled.jit import njit
from cnc.planner.kernels.arrays import Phases, write_phase

PEAK_ITERATIONS = 100
"""Bisection halves the bracket to neighbouring floats in fewer steps than this."""

ROUNDING = 1e-13
"""Relative; larger than the rounding error of a speed in these formulas."""


@njit
def ramp_shape(change: float, accel: float, jerk: float) -> tuple[float, float, float]:
    """Return the shape of a ramp for a change of speed.

    Returns:
        The duration of each of its two jerk phases, that of its phase of constant acceleration, and
        its largest acceleration.
    """
    if change * jerk >= accel * accel:
        t_jerk = accel / jerk
        return t_jerk, change / accel - t_jerk, accel
    t_jerk = math.sqrt(change / jerk)
    return t_jerk, 0.0, jerk * t_jerk


@njit
def ramp_time(v0: float, v1: float, accel: float, jerk: float) -> float:
    """Return the duration of the ramp between two speeds."""
    t_jerk, t_const, _ = ramp_shape(abs(v1 - v0), accel, jerk)
    return 2.0 * t_jerk + t_const


@njit
def ramp_distance(v0: float, v1: float, accel: float, jerk: float) -> float:
    """Return the length of the ramp between two speeds, rising or falling."""
    return 0.5 * (v0 + v1) * ramp_time(v0, v1, accel, jerk)


@njit
def reachable_speed(v0: float, distance: float, accel: float, jerk: float) -> float:
    """Return the largest speed that a ramp from ``v0`` reaches within ``distance``.

    By symmetry it is also the largest speed from which a ramp slows to ``v0``. It is rounded down
    by more than its rounding error, so that the ramp fits.
    """
    if distance <= 0.0:
        return v0
    plateau = accel * accel / jerk
    # With the plateau: v1^2 + plateau v1 + (plateau v0 - v0^2 - 2 accel distance) = 0.
    discriminant = plateau * plateau - 4.0 * (plateau * v0 - v0 * v0 - 2.0 * accel * distance)
    if discriminant > 0.0:
        v1 = 0.5 * (math.sqrt(discriminant) - plateau)
        if v1 - v0 >= plateau:
            return max(v0, v1 * (1.0 - ROUNDING))
    # Without it, with x = sqrt((v1 - v0) / jerk): jerk x^3 + 2 v0 x = distance. This is convex for
    # x > 0, so Newton's method converges from above.
    x = (distance / jerk) ** (1.0 / 3.0)
    if v0 > 0.0:
        x = min(x, distance / (2.0 * v0))
        for _ in range(60):
            step = ((jerk * x * x + 2.0 * v0) * x - distance) / (3.0 * jerk * x * x + 2.0 * v0)
            x -= step
            if abs(step) <= 1e-15 * x:
                break
    return max(v0, (v0 + jerk * x * x) * (1.0 - ROUNDING))


@njit
def peak_speed(
    v0: float, v1: float, distance: float, cap: float, accel: float, jerk: float
) -> float:
    """Return the largest speed up to ``cap`` with which the ramps v0 -> peak -> v1 fit.

    They must fit into ``distance`` with the larger of v0 and v1 for a peak.
    """
    if ramp_distance(v0, cap, accel, jerk) + ramp_distance(cap, v1, accel, jerk) <= distance:
        return cap
    low = max(v0, v1)
    high = cap
    for _ in range(PEAK_ITERATIONS):
        middle = 0.5 * (low + high)
        if middle <= low or middle >= high:
            break
        if (
            ramp_distance(v0, middle, accel, jerk) + ramp_distance(middle, v1, accel, jerk)
            <= distance
        ):
            low = middle
        else:
            high = middle
    return low


@njit
def ramp_distance_to_speed(v0: float, v1: float, accel: float, jerk: float, v: float) -> float:
    """Return the distance from the start at which the rising ramp v0 -> v1 has speed ``v``."""
    t_jerk, t_const, top = ramp_shape(v1 - v0, accel, jerk)
    gained = v - v0
    by_jerk = 0.5 * jerk * t_jerk * t_jerk
    if gained <= by_jerk:
        t = math.sqrt(2.0 * gained / jerk)
        return t * (v0 + jerk * t * t / 6.0)
    if gained <= by_jerk + top * t_const:
        t = (gained - by_jerk) / top
        return t_jerk * (v0 + jerk * t_jerk * t_jerk / 6.0) + t * (v0 + by_jerk + 0.5 * top * t)
    t = math.sqrt(2.0 * max(v1 - v, 0.0) / jerk)
    return 0.5 * (v0 + v1) * (2.0 * t_jerk + t_const) - t * (v1 - jerk * t * t / 6.0)


@njit
def write_ramp(
    v0: float, v1: float, accel: float, jerk: float, s: float, phases: Phases, count: int
) -> tuple[int, float]:
    """Append the phases of a ramp from ``v0`` to ``v1`` that starts at arc length ``s``.

    Returns:
        The new count of phases, and the arc length at the end of the ramp.
    """
    change = abs(v1 - v0)
    if change == 0.0:
        return count, s
    sign = 1.0 if v1 > v0 else -1.0
    t_jerk, t_const, top = ramp_shape(change, accel, jerk)
    a = sign * top
    j = sign * jerk
    end = s + 0.5 * (v0 + v1) * (2.0 * t_jerk + t_const)
    write_phase(phases, count, t_jerk, s, v0, 0.0, j)
    count += 1
    s += t_jerk * (v0 + j * t_jerk * t_jerk / 6.0)
    v = v0 + 0.5 * j * t_jerk * t_jerk
    if t_const > 0.0:
        write_phase(phases, count, t_const, s, v, a, 0.0)
        count += 1
        s += t_const * (v + 0.5 * a * t_const)
        v = v1 - 0.5 * j * t_jerk * t_jerk
    write_phase(phases, count, t_jerk, s, v, a, -j)
    return count + 1, end


@njit
def write_profile(
    v0: float,
    v1: float,
    start: float,
    end: float,
    peak: float,
    accel: float,
    jerk: float,
    phases: Phases,
    count: int,
) -> int:
    """Append ramp, cruise and ramp over [start, end] with the given peak speed.

    The cruise takes up the rounding of the length, so that the last phase ends at ``end``. Returns
    the new count of phases.
    """
    down = ramp_distance(peak, v1, accel, jerk)
    count, s = write_ramp(v0, peak, accel, jerk, start, phases, count)
    cruise = (end - down) - s
    if cruise > 0.0 and peak > 0.0:
        write_phase(phases, count, cruise / peak, s, peak, 0.0, 0.0)
        count += 1
        s = end - down
    count, s = write_ramp(peak, v1, accel, jerk, s, phases, count)
    return count


@njit
def phase_time(v: float, a: float, j: float, duration: float, distance: float) -> float:
    """Return the time at which a phase has covered ``distance``, by Newton's method in a bracket.

    The phase starts with speed ``v`` and acceleration ``a``; its speed is never negative.
    """
    low = 0.0
    high = duration
    t = duration * 0.5
    for _ in range(PEAK_ITERATIONS):
        error = t * (v + t * (0.5 * a + t * j / 6.0)) - distance
        if error > 0.0:
            high = t
        else:
            low = t
        speed = v + t * (a + 0.5 * t * j)
        following = t - error / speed if speed > 0.0 else low
        if not (low < following < high):
            following = 0.5 * (low + high)
        if following == t or abs(following - t) <= 1e-16 * duration:
            break
        t = following
    return t
