r"""Blends whose curvature follows the speed, for corners where no axis limits the jerk.

There the curvature may jump, and the speed v alone determines the least radius R(v). The motion has
its least speed and no acceleration at the apex, on the bisector. From there it speeds up by the
ramp of the leg, and always turns at R(v): first to the inside, by phi farther than the leg, and
then back. So it comes to the leg from outside, where it was w away from it.

        C o.                        h: heading from the leg's direction
        | e `-.                     h = -theta/2 at the apex, up to phi, back to 0
        o..    `-.  w
     apex  ``-.._  `-.___________
                 ``--..__,,--     leg

The apex is at the distance e from the corner. For a speed at the apex, w follows from e, and phi
from w. e is the tolerance. Speeds at the apex between
that for w = 0 and the largest one for which w is within the tolerance are rated by the time of the
motion, which is known.

The speed rises along a ramp, and R(v) rises with it. With the heading h for a variable,
dt = R/v dh, and the path is the integral of R (cos h, sin h).

Without these blends, with the motion in time at all corners, 100 random polygons take 1.001 times
as long in the median, and 1.37 times at worst. With legs of 3 to 24 tolerances the worst is 1.44.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats
from cnc.planner.kernels.arrays import LimitArrays
from cnc.planner.kernels.legs import LineBounds
from cnc.planner.kernels.limits import ACCEL_SHARE, UNSEEN
from cnc.planner.kernels.scurve import (
    peak_speed,
    ramp_distance,
    ramp_shape,
    ramp_time,
    reachable_speed,
)

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


PARTS = 4
"""Speeds at the apex that are rated, but one."""

SPEED_STEPS, NEAR_SWING, LEAST_POWER = 20, 0.9999, 0.3
"""Largest number of steps to the speed for which a blend swings so far, the part of the swing that
is near enough, and the least power of the speed with which the swing grows.
"""

SHRINKINGS = 12
"""Times that a blend is made smaller until the legs have room for it."""

SMALLER = 0.98
"""Part of the room that such a blend takes at most."""

ROOM_STEPS, NEAR_ROOM = 10, 0.9995
"""Largest number of steps to the fastest blend for which there is room, and the part of the room
that it is to take.
"""

TURN_STEPS, SCALE_STEPS = 20, 20
"""Largest number of steps to the angle phi, and to the factor on the radius."""

CLOSE = 1e-7
"""Part of a distance by which the end of a blend may be off the leg. It is put on the leg."""

WITHIN, OUTSIDE = 0.997, 0.99
"""Parts of the tolerance that are used, inside and outside. Cubics take less than the rest."""

LOST = 0.03
"""Part of the time in a blend that the plan takes longer than the ramp for which it is made."""

LEAST_OUT = 0.02
"""Part of the tolerance by which the motion goes to the outside at least, or not at all."""

WIDEST = math.radians(60.0)
"""Largest phi."""

MOST_CUBICS = 28
"""Largest number of cubics of a blend: 90 + 60 degrees and 60 degrees back, on each side."""


class Side(NamedTuple):
    """A leg of a corner.

    Attributes:
        room: the length that the blend may take, mm.
        length: that over which the motion is timed, mm.
        rests: whether the motion rests at its far end. Else it has no acceleration there.
        line: bounds along the leg.
    """

    room: float
    length: float
    rests: bool
    line: LineBounds


class Half(NamedTuple):
    """One half of a blend.

    Attributes:
        fits: whether it is within the tolerance and the room.
        ramp: its speeds.
        scale: factor on the least radius.
        turned: phi, rad.
        reach: distance of its far end from the corner, mm.
        time: from the far end of the leg's length to the apex, s.
    """

    fits: bool
    ramp: Ramp
    scale: float
    turned: float
    reach: float
    time: float


class Blend(NamedTuple):
    """A blend.

    Attributes:
        time: that of both halves, s; infinite for none.
        half_turn: theta/2, rad.
        inside: distance of the apex from the corner, mm.
        before: the half on the first leg.
        after: the half on the second leg.
    """

    time: float
    half_turn: float
    inside: float
    before: Half
    after: Half


@njit
def no_blend() -> Blend:
    """Return the blend that stands for none."""
    half = Half(False, Ramp(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, math.inf)
    return Blend(math.inf, 0.0, 0.0, half, half)


@njit
def corner_plane(sine: float, u: Floats, plane: Floats) -> float:
    """Write two directions at right angles in the plane of a corner.

    Args:
        sine: sin(theta/2) for a turn by theta.
        u: (2, axes): the directions of the legs.
        plane: (2, axes): receives that at the apex, and that from the corner to the apex.

    Returns:
        By how much an axis that does not measure the path may be farther from it than the others,
        in mm or degrees per mm; 1 for no more.
    """
    cosine = math.sqrt(1.0 - sine * sine)
    widest = 1.0
    for i in range(u.shape[1]):
        plane[0, i] = (u[0, i] + u[1, i]) / (2.0 * cosine)
        plane[1, i] = (u[1, i] - u[0, i]) / (2.0 * sine)
        for side in (-sine, sine):
            widest = max(widest, abs(cosine * plane[1, i] + side * plane[0, i]))
        widest = max(widest, abs(plane[1, i]))
    return widest


@njit
def largest_speed(plane: Floats, limits: LimitArrays) -> float:
    """Return the largest speed in any direction of a plane, mm/s."""
    v = math.inf
    for i in range(plane.shape[1]):
        most = math.hypot(plane[0, i], plane[1, i])
        if most > 0.0:
            v = min(v, limits.axis_velocity[i] / most)
    return v


@njit
def _peak(v: float, length: float, side: Side) -> float:
    """Return the largest speed within ``length`` of a leg that ends with ``v``, mm/s."""
    line = side.line
    if side.rests:
        return peak_speed(0.0, v, length, max(line.v, v), line.a, line.j)
    return max(v, min(line.v, reachable_speed(v, length, line.a, line.j)))


@njit
def side_time(v: float, length: float, side: Side) -> float:
    """Return the time from the far end of a leg's ``length`` to its near end, s.

    The speed at the near end is ``v``, without acceleration.
    """
    line, peak = side.line, _peak(v, length, side)
    time, passed = ramp_time(v, peak, line.a, line.j), ramp_distance(v, peak, line.a, line.j)
    if side.rests:
        time += ramp_time(0.0, peak, line.a, line.j)
        passed += ramp_distance(0.0, peak, line.a, line.j)
    return time + max(length - passed, 0.0) / peak


@njit
def _ramp(v: float, side: Side, bend: Bend) -> Ramp:
    """Return the ramp from the apex on a leg."""
    top = _peak(v, side.length, side)
    most = min(side.line.a, MOST_GROWTH * bend.accel)
    t_jerk, t_const, accel = ramp_shape(top - v, most, side.line.j)
    return Ramp(v, top, t_jerk, t_const, side.line.j, accel)


@njit
def _half(
    v: float, half_turn: float, inside: float, tolerance: float, side: Side, bend: Bend
) -> Half:
    """Return the half of a blend on one leg.

    Args:
        v: speed at the apex, mm/s.
        half_turn: theta/2, rad.
        inside: distance of the apex from the corner, mm.
        tolerance: largest distance to the outside, mm.
        side: the leg.
        bend: the least radius.
    """
    ramp = _ramp(v, side, bend)
    from_leg = inside * math.cos(half_turn)
    parallel = turned_along(Place(0.0, 0.0, 0.0, 0.0), -half_turn, 0.0, ramp, bend, 1.0)
    out = -parallel.y - from_leg
    scale, turned, end = 1.0, 0.0, parallel
    if out <= LEAST_OUT * tolerance:
        # A larger radius makes the way shorter. The distance grows about as a power of it.
        power = 1.0
        for _ in range(SCALE_STEPS):
            before, was = scale, -end.y
            scale *= (from_leg / was) ** (1.0 / power)
            end = turned_along(Place(0.0, 0.0, 0.0, 0.0), -half_turn, 0.0, ramp, bend, scale)
            if abs(from_leg + end.y) <= CLOSE * from_leg:
                break
            if scale != before:
                power = max(1.0, math.log(-end.y / was) / math.log(scale / before))
    elif out <= tolerance:
        radius = radius_at(speed_at(parallel.t, ramp), bend)
        turned, power, before, was = math.sqrt(out / radius), 2.0, 0.0, 0.0
        for _ in range(TURN_STEPS):
            turned = min(turned, WIDEST)
            end = turned_along(parallel, 0.0, turned, ramp, bend, 1.0)
            end = turned_along(end, turned, 0.0, ramp, bend, 1.0)
            gained = end.y - parallel.y
            if abs(gained - out) <= CLOSE * out or (turned == WIDEST and gained < out):
                break
            # It grows about as the square of the angle.
            if was > 0.0 and turned != before:
                power = max(1.0, math.log(gained / was) / math.log(turned / before))
            before, was = turned, gained
            turned *= (out / gained) ** (1.0 / power)
    reach = inside * math.sin(half_turn) + end.x
    fits = out <= tolerance and reach <= side.room and turned < WIDEST
    time = math.inf
    if fits:
        time = LOST * end.t
        if side.line.a > ramp.accel == MOST_GROWTH * bend.accel:
            # The blend is made for slower motion than the leg allows.
            time += end.t + side_time(speed_at(end.t, ramp), side.length - reach, side)
        else:
            time += side_time(v, end.s + side.length - reach, side)
    return Half(fits, ramp, scale, turned, reach, time)


@njit
def _blend(
    v: float,
    half_turn: float,
    inside: float,
    tolerance: float,
    sides: tuple[Side, Side],
    bend: Bend,
) -> Blend:
    """Return the blend with speed ``v`` at the apex; its time is infinite if it does not fit."""
    before = _half(v, half_turn, inside, tolerance, sides[0], bend)
    after = _half(v, half_turn, inside, tolerance, sides[1], bend)
    return Blend(before.time + after.time, half_turn, inside, before, after)


@njit
def _swing(v: float, half_turn: float, inside: float, side: Side, bend: Bend) -> float:
    """Return how far from the apex the half with that speed there is when parallel to the leg.

    In distances of the apex from the leg: a half that goes farther swings to the outside.
    """
    end = turned_along(Place(0.0, 0.0, 0.0, 0.0), -half_turn, 0.0, _ramp(v, side, bend), bend, 1.0)
    return -end.y / (inside * math.cos(half_turn))


@njit
def _taken(blend: Blend, sides: tuple[Side, Side]) -> float:
    """Return the largest part of the room, or of the largest phi, that a blend takes."""
    before, after = blend.before, blend.after
    room = max(before.reach / sides[0].room, after.reach / sides[1].room)
    return max(room, before.turned / WIDEST, after.turned / WIDEST)


@njit
def _speed_of_swing(
    most: float,
    low: float,
    feed: float,
    half_turn: float,
    inside: float,
    sides: tuple[Side, Side],
    bend: Bend,
) -> float:
    """Return about the largest speed at the apex for which both halves swing by ``most`` or less.

    Args:
        most: see _swing.
        low: a speed for which they do, mm/s; 0 for none that is known.
        feed: largest speed.
        half_turn: theta/2, rad.
        inside: distance of the apex from the corner, mm.
        sides: the legs.
        bend: the least radius.
    """
    v, high, power = feed, feed, 2.0
    before = was = 0.0
    for _ in range(SPEED_STEPS):
        swing = max(
            _swing(v, half_turn, inside, sides[0], bend),
            _swing(v, half_turn, inside, sides[1], bend),
        )
        if swing <= most:
            low = v
            if v == feed or swing >= NEAR_SWING * most:
                break
        else:
            high = v
        # The swing grows about as a power of the speed, from 0 to 2.
        if was > 0.0 and v != before and swing != was:
            power = max(math.log(swing / was) / math.log(v / before), LEAST_POWER)
        before, was = v, swing
        v *= (0.5 * (1.0 + NEAR_SWING) * most / swing) ** (1.0 / power)
        if not low < v < high:
            v = 0.5 * (low + high)
    return low


@njit
def _sought(
    half_turn: float, tolerance: float, feed: float, sides: tuple[Side, Side], bend: Bend
) -> Blend:
    """Return the fastest blend, by a search.

    Args:
        half_turn: theta/2, rad.
        tolerance: mm.
        feed: largest speed at the apex, mm/s.
        sides: the legs before and behind the corner.
        bend: the least radius.
    """
    inside, outside = WITHIN * tolerance, OUTSIDE * tolerance
    for side in sides:
        if side.rests:
            feed = min(feed, reachable_speed(0.0, side.length, side.line.a, side.line.j))
    best, low = no_blend(), 0.0
    for _ in range(SHRINKINGS):
        swing = 1.0 + LEAST_OUT * outside / (inside * math.cos(half_turn))
        low = _speed_of_swing(swing, 0.0, feed, half_turn, inside, sides, bend)
        if low == 0.0:
            return best
        best = _blend(low, half_turn, inside, outside, sides, bend)
        if best.time < math.inf:
            break
        over = max(best.before.reach / sides[0].room, best.after.reach / sides[1].room)
        inside *= min(SMALLER, SMALLER / over)
    if not best.time < math.inf or low >= feed:
        return best
    swing = 1.0 + outside / (inside * math.cos(half_turn))
    high = _speed_of_swing(swing, low, feed, half_turn, inside, sides, bend)
    other = _blend(high, half_turn, inside, outside, sides, bend)
    if other.time == math.inf:
        # The way to the outside grows with the speed, and phi about as its root.
        above, under, over = high - low, _taken(best, sides), _taken(other, sides)
        least, most = 0.0, 1.0
        for k in range(ROOM_STEPS):
            # Every other step halves the range: the others may come from one side alone.
            secant = k % 2 == 0 and over > 1.0 > under
            part = (NEAR_ROOM - under) / (over - under) if secant else 0.5
            x = least + (most - least) * min(max(part, 0.01), 0.99)
            other = _blend(low + above * x * x, half_turn, inside, outside, sides, bend)
            if other.time < math.inf:
                least, under = x, _taken(other, sides)
                if under > 2.0 * NEAR_ROOM - 1.0:
                    break
            else:
                most, over = x, _taken(other, sides)
        high = low + above * least * least
    for part in range(1, PARTS + 1):
        v = low + (high - low) * part / PARTS
        other = _blend(v, half_turn, inside, outside, sides, bend)
        if other.time < best.time:
            best = other
    return best


class KeptBlends(NamedTuple):
    """The last blends. A corner is asked for again in each trial of the path around it.

    Attributes:
        asked: (KEY_SIZE,): what a search depends on.
        bits: (KEY_SIZE,): the same numbers, as integers.
        keys: (PLACES, KEY_SIZE): that of the blend at each place; NaN for none.
        blends: (PLACES, BLEND_SIZE): the blends.
    """

    asked: Floats
    bits: NDArray[np.int64]
    keys: Floats
    blends: Floats


KEY_SIZE, BLEND_SIZE, PLACES = 22, 11, 1024


def no_kept_blends() -> KeptBlends:
    """Return a memory without a blend."""
    asked = np.empty(KEY_SIZE)
    keys = np.full((PLACES, KEY_SIZE), np.nan)
    return KeptBlends(asked, asked.view(np.int64), keys, np.empty((PLACES, BLEND_SIZE)))


@njit
def _write_key(
    half_turn: float,
    tolerance: float,
    feed: float,
    sides: tuple[Side, Side],
    bend: Bend,
    key: Floats,
) -> None:
    """Write what a search depends on to ``key`` (KEY_SIZE,)."""
    key[0], key[1], key[2] = half_turn, tolerance, feed
    key[3], key[4], key[5], key[6] = bend.by_square, bend.by_speed, bend.chord_error, bend.period
    key[7], key[8], key[9] = bend.least, bend.accel, bend.sweep
    at = 10
    for side in sides:
        key[at], key[at + 1] = side.room, side.length
        key[at + 2] = 1.0 if side.rests else 0.0
        key[at + 3], key[at + 4], key[at + 5] = side.line.v, side.line.a, side.line.j
        at += 6


@njit
def _place_of(bits: NDArray[np.int64]) -> int:
    """Return the place of a key with these bits."""
    place = 0
    for number in bits:
        mixed = (number & 0xFFFFF) ^ (number >> 20 & 0xFFFFF) ^ (number >> 40 & 0xFFFFF)
        place = (31 * place ^ mixed) & 0xFFFFF
    return int((place ^ place >> 10) % PLACES)


@njit
def _write_half(half: Half, numbers: Floats) -> None:
    """Write a half to (4,) numbers, without its ramp."""
    numbers[0], numbers[1], numbers[2], numbers[3] = half.scale, half.turned, half.reach, half.time


@njit
def _kept_half(numbers: Floats, speed: float, side: Side, bend: Bend) -> Half:
    """Return the half of (4,) numbers; ``speed``: at the apex, mm/s."""
    ramp = _ramp(speed, side, bend)
    return Half(True, ramp, numbers[0], numbers[1], numbers[2], numbers[3])


@njit
def fastest_blend(
    sine: float,
    tolerance: float,
    feed: float,
    sides: tuple[Side, Side],
    bend: Bend,
    kept: KeptBlends,
) -> Blend:
    """Return the fastest blend; its time is infinite where there is none.

    Args:
        sine: sin(theta/2) for a turn by theta.
        tolerance: mm.
        feed: largest speed at the apex, mm/s.
        sides: the legs before and behind the corner.
        bend: the least radius.
        kept: the last blends; receives this one.
    """
    half_turn = math.asin(sine)
    _write_key(half_turn, tolerance, feed, sides, bend, kept.asked)
    place = _place_of(kept.bits)
    key, numbers = kept.keys[place], kept.blends[place]
    same = True
    for k in range(KEY_SIZE):
        same = same and key[k] == kept.asked[k]
    if not same:
        blend = _sought(half_turn, tolerance, feed, sides, bend)
        key[:] = kept.asked
        numbers[0], numbers[1], numbers[2] = blend.time, blend.inside, blend.before.ramp.v
        _write_half(blend.before, numbers[3:7])
        _write_half(blend.after, numbers[7:11])
    if not numbers[0] < math.inf:
        return no_blend()
    before = _kept_half(numbers[3:7], numbers[2], sides[0], bend)
    after = _kept_half(numbers[7:11], numbers[2], sides[1], bend)
    return Blend(numbers[0], half_turn, numbers[1], before, after)


@njit
def cubics_of(blend: Blend, bend: Bend) -> int:
    """Return the number of cubics of a blend."""
    count = 0
    for half in (blend.before, blend.after):
        count += steps_of(blend.half_turn + half.turned, bend)
        if half.turned > 0.0:
            count += steps_of(half.turned, bend)
    return count


@njit
def write_points(blend: Blend, bend: Bend, points: Floats) -> None:
    """Write the Bezier points of the cubics of a blend, in its plane.

    Args:
        blend: the blend.
        bend: the least radius.
        points: (cubics, 4, 2): receives the points from the corner: along the direction at the
            apex, and to the inside, mm.
    """
    first = 0
    for side in range(2):
        half = blend.after if side else blend.before
        turn = blend.half_turn + half.turned
        main = steps_of(turn, bend)
        back = steps_of(half.turned, bend) if half.turned > 0.0 else 0
        if side == 0:
            first = main + back
        place = Place(0.0, 0.0, 0.0, 0.0)
        for c in range(main + back):
            if c < main:
                step = turn / main
                h1 = -blend.half_turn + c * step
            else:
                step = -half.turned / back
                h1 = half.turned + (c - main) * step
            h2 = h1 + step
            end = turned_to(place, h1, h2, half.ramp, bend, half.scale)
            # The cubic of the time, but with the points of an arc where the speed is constant.
            ahead = 4.0 / 3.0 * math.tan(0.25 * abs(step)) / abs(step) * (end.t - place.t)
            r1, r2 = ahead * speed_at(place.t, half.ramp), ahead * speed_at(end.t, half.ramp)
            # The half on the first leg is mirrored, and its cubics run from its end to the apex.
            row, sign = (first + c, 1.0) if side else (first - 1 - c, -1.0)
            for k in range(4):
                x, y = place.x, place.y
                if k == 1:
                    x, y = place.x + r1 * math.cos(h1), place.y + r1 * math.sin(h1)
                elif k == 2:
                    x, y = end.x - r2 * math.cos(h2), end.y - r2 * math.sin(h2)
                elif k == 3:
                    x, y = end.x, end.y
                # From the direction of the leg to that at the apex.
                c1, s1 = math.cos(blend.half_turn), math.sin(blend.half_turn)
                to = points[row, k if side else 3 - k]
                to[0], to[1] = sign * (x * c1 - y * s1), x * s1 + y * c1 + blend.inside
            place = end
