r"""A slow motion past a chain of corners, with which the search for the fastest one begins.

It turns from one leg to the next by a jerk J across the bisector, for a time tau on each side:

          r'' = J (tau - |t|) n,     |t| < tau,     n = (u2 - u1) / |u2 - u1|,
          v = J tau^2 / |u2 - u1|,   distance from the corner J tau^3 / 6.

In its middle the jerk along the path is 2 J tan(theta/2) for a turn by theta. The legs take v far
from zero, where the jerk along the path has no bound: this is why the search does not begin with
the stops of the plan. Between two turns the speed is a polynomial of the time.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats
from cnc.planner.kernels.corner_tube import Tube
from cnc.planner.kernels.scurve import reachable_speed

LIMITS_SHARE = 0.8
"""Part of the limits of velocity, acceleration and jerk on the legs that the slow motion takes."""

TURN_JERK = 0.5
"""Part of the jerk that a turn takes."""

TURN_TOLERANCE = 0.5
"""Part of the tolerance that a turn takes."""

TURN_LENGTH = 0.35
"""Part of a leg that a turn may take."""

SLOWEST = 0.3
"""The speed on a leg becomes no less than this part of that at its ends."""

EVEN = 1e-6
"""The speed may exceed the feed by this part: where it is the feed at both ends, a rounding error
would decide.
"""

LONGER, TRIALS = 1.1, 60
"""A leg takes so many times longer from trial to trial."""


class Slow(NamedTuple):
    """A slow motion.

    Attributes:
        passes: (legs + 1,): times at its start, at the corners and at its end, s.
        tau: (legs + 1,): half the duration of each turn, s; 0 at both ends.
        jerk: (legs + 1,): of each turn, mm/s^3.
        speed: (legs + 1,): in each turn, mm/s, and at both ends.
        across: (legs + 1, d): direction of the jerk.
        first: (legs,): place of each leg at which its turn ends, on its line, mm.
        pull: (2,): acceleration along the legs at both ends, mm/s^2.
        rise: (legs,): speed in the middle of a leg above the mean of that at its ends.
    """

    passes: Floats
    tau: Floats
    jerk: Floats
    speed: Floats
    across: Floats
    first: Floats
    pull: Floats
    rise: Floats


@njit
def _bound_in(tube: Tube, u: Floats, bounds: Floats, most: float) -> float:
    """Return the largest multiple of direction ``u`` (d,) within the bounds of the axes."""
    for i in range(len(bounds)):
        part = 0.0
        for q in range(len(u)):
            part += tube.axes[i, q] * u[q]
        if part != 0.0:
            most = min(most, bounds[i] / abs(part))
    return most


@njit
def _write_turn(tube: Tube, leg: int, space: tuple[float, float], slow: Slow) -> None:
    """Write the turn from ``leg`` to the next; ``space`` is the length of both, mm."""
    d = tube.axes.shape[1]
    k = leg + 1
    square = 0.0
    for q in range(d):
        slow.across[k, q] = tube.along[k, q] - tube.along[leg, q]
        square += slow.across[k, q] ** 2
    width = math.sqrt(square)
    for q in range(d):
        slow.across[k, q] /= width
    tangent = 0.5 * width / math.sqrt(max(1.0 - 0.25 * square, 1e-9))
    jerk = min(tube.along_jerk / (2.0 * tangent), tube.along_jerk)
    jerk = TURN_JERK * _bound_in(tube, slow.across[k], tube.jerk, jerk)
    pull = min(tube.along_pull, tube.across_pull)
    pull = LIMITS_SHARE * _bound_in(tube, slow.across[k], tube.acceleration, pull)
    far = min(TURN_TOLERANCE * tube.tolerance, TURN_LENGTH * min(space[0], space[1]) * width / 6.0)
    tau = (6.0 * far / jerk) ** (1.0 / 3.0)
    tau = min(tau, pull / jerk)
    feed = LIMITS_SHARE * min(tube.feed[leg], tube.feed[k])
    for side in range(2):
        feed = min(
            feed, LIMITS_SHARE * _bound_in(tube, tube.along[leg + side], tube.velocity, feed)
        )
    tau = min(tau, math.sqrt(feed * width / jerk))
    slow.tau[k], slow.jerk[k] = tau, jerk
    slow.speed[k] = jerk * tau * tau / width


@njit
def _slow_down(slow: Slow, k: int, speed: float) -> None:
    """Lower the speed in a turn, and keep its duration."""
    if speed < slow.speed[k]:
        slow.jerk[k] *= speed / slow.speed[k]
        slow.speed[k] = speed


@njit
def slow_motion(tube: Tube) -> Slow:
    """Return the slow motion between the states at the ends of a tube."""
    legs, d = len(tube.feed), tube.axes.shape[1]
    slow = Slow(
        np.zeros(legs + 1),
        np.zeros(legs + 1),
        np.zeros(legs + 1),
        np.zeros(legs + 1),
        np.zeros((legs + 1, d)),
        np.zeros(legs),
        np.zeros(2),
        np.zeros(legs),
    )
    ends = np.zeros(2)
    for end in range(2):
        leg = (legs - 1) * end
        for q in range(d):
            ends[end] += (tube.ends[end, 0, q] - tube.start[leg, q]) * tube.along[leg, q]
            slow.speed[legs * end] += tube.ends[end, 1, q] * tube.along[leg, q]
            slow.pull[end] += tube.ends[end, 2, q] * tube.along[leg, q]
    length = np.empty(legs)
    for leg in range(legs):
        length[leg] = tube.reach[leg, 1] - tube.reach[leg, 0]
    length[0], length[legs - 1] = tube.reach[0, 1] - ends[0], ends[1]
    a, j = np.empty(legs), np.empty(legs)
    for leg in range(legs):
        u = tube.along[leg]
        a[leg] = LIMITS_SHARE * _bound_in(tube, u, tube.acceleration, tube.along_pull)
        j[leg] = LIMITS_SHARE * _bound_in(tube, u, tube.jerk, tube.along_jerk)
    for leg in range(legs - 1):
        _write_turn(tube, leg, (length[leg], length[leg + 1]), slow)
    for leg in range(legs):
        free = length[leg] - slow.tau[leg] * slow.speed[leg]
        free -= slow.tau[leg + 1] * slow.speed[leg + 1]
        if leg + 1 < legs:
            _slow_down(slow, leg + 1, reachable_speed(slow.speed[leg], free, a[leg], j[leg]))
    for leg in range(legs - 1, 0, -1):
        free = length[leg] - slow.tau[leg] * slow.speed[leg]
        free -= slow.tau[leg + 1] * slow.speed[leg + 1]
        _slow_down(slow, leg, reachable_speed(slow.speed[leg + 1], free, a[leg], j[leg]))
    for leg in range(legs):
        begin = (ends[0] if leg == 0 else tube.reach[leg, 0]) + slow.tau[leg] * slow.speed[leg]
        slow.first[leg] = begin
        free = length[leg] - slow.tau[leg] * slow.speed[leg]
        free -= slow.tau[leg + 1] * slow.speed[leg + 1]
        feed = LIMITS_SHARE * _bound_in(tube, tube.along[leg], tube.velocity, tube.feed[leg])
        pulls = (slow.pull[0] if leg == 0 else 0.0, slow.pull[1] if leg == legs - 1 else 0.0)
        speeds = (slow.speed[leg], slow.speed[leg + 1])
        time, slow.rise[leg] = _between(free, speeds, pulls, feed, a[leg], j[leg])
        slow.passes[leg + 1] = slow.passes[leg] + slow.tau[leg] + time + slow.tau[leg + 1]
    return slow


@njit
def _between(
    length: float,
    speeds: tuple[float, float],
    pulls: tuple[float, float],
    feed: float,
    a: float,
    j: float,
) -> tuple[float, float]:
    """Return the duration of a length between two speeds, and the rise of the speed in its middle.

    ``pulls``: the accelerations at both ends.
    """
    low, high = min(speeds[0], speeds[1]), max(speeds[0], speeds[1])
    mean = 0.5 * (speeds[0] + speeds[1])
    feed = max(feed, high)
    time = length / feed
    rise = 0.0
    for _ in range(TRIALS):
        rise = (length / time - mean - time * (pulls[0] - pulls[1]) / 12.0) * 15.0 / 8.0
        bent = abs(pulls[0]) + abs(pulls[1])
        legal = mean + rise <= (1.0 + EVEN) * feed
        legal = legal and 1.5 * (high - low) + 3.1 * abs(rise) <= a * time
        legal = legal and 6.0 * (high - low) + 32.0 * abs(rise) + 4.0 * bent * time <= j * time**2
        if legal or (rise <= 0.0 and time * mean > length):
            break
        time *= LONGER
    least = (SLOWEST - 1.0) * low
    if rise < least:
        bent = (pulls[0] - pulls[1]) / 12.0
        mean += least * 8.0 / 15.0
        square = mean**2 + 4.0 * bent * length
        if square > 0.0:
            return 2.0 * length / (mean + math.sqrt(square)), least
    return time, rise


@njit
def slow_state(tube: Tube, slow: Slow, t: float, r: Floats, a: Floats) -> None:
    """Write position and acceleration (d,) of a slow motion at time ``t``."""
    legs, d = len(tube.feed), tube.axes.shape[1]
    leg = 0
    while leg + 1 < legs and t > slow.passes[leg + 1]:
        leg += 1
    begins, ends = slow.passes[leg] + slow.tau[leg], slow.passes[leg + 1] - slow.tau[leg + 1]
    v1, v2 = slow.speed[leg], slow.speed[leg + 1]
    on, pull = slow.first[leg], 0.0
    turn = -1
    if t < begins:
        on -= v1 * (begins - t)
        turn = leg
    else:
        time = ends - begins
        u = min((t - begins) / time, 1.0)
        a1 = slow.pull[0] if leg == 0 else 0.0
        a2 = slow.pull[1] if leg == legs - 1 else 0.0
        rise, more = slow.rise[leg], v2 - v1
        on += time * (
            v1 * u
            + more * u**3 * (1.0 - 0.5 * u)
            + rise * 16.0 * u**3 * (1.0 / 3.0 - 0.5 * u + 0.2 * u * u)
            + a1 * time * u * u * (0.5 - 2.0 / 3.0 * u + 0.25 * u * u)
            + a2 * time * u**3 * (0.25 * u - 1.0 / 3.0)
        )
        pull = 6.0 * more * u * (1.0 - u) + 32.0 * rise * u * (1.0 - u) * (1.0 - 2.0 * u)
        pull /= time
        pull += a1 * (1.0 - u) * (1.0 - 3.0 * u) + a2 * u * (3.0 * u - 2.0)
        if t > ends:
            on += v2 * (t - ends)
            turn, pull = leg + 1, 0.0
    for q in range(d):
        r[q] = tube.start[leg, q] + on * tube.along[leg, q]
        a[q] = pull * tube.along[leg, q]
    if turn > 0 and turn < legs:
        left = slow.tau[turn] - abs(t - slow.passes[turn])
        for q in range(d):
            r[q] += slow.jerk[turn] * left**3 / 6.0 * slow.across[turn, q]
            a[q] += slow.jerk[turn] * left * slow.across[turn, q]
