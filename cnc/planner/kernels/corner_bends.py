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
"""Steps of an integral for each cubic. The jerk is not constant in them. To compare speeds, one is
enough.
"""

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
def turned_to(
    place: Place, h1: float, h2: float, ramp: Ramp, bend: Bend, scale: float, substeps: int
) -> Place:
    """Return the place at which the heading is ``h2``, from that at which it is ``h1``.

    The turn is at most that of a cubic.
    """
    step = (h2 - h1) / substeps
    for k in range(substeps):
        place = _step(place, h1 + k * step, h1 + (k + 1) * step, ramp, bend, scale)
    return place


@njit
def steps_of(turn: float, bend: Bend) -> int:
    """Return the number of steps, or cubics, of a turn."""
    return max(1, math.ceil(abs(turn) / bend.sweep - 1e-9))


@njit
def turned_along(
    place: Place, h1: float, h2: float, ramp: Ramp, bend: Bend, scale: float, substeps: int
) -> Place:
    """Return the place at which the heading is ``h2``, in steps."""
    steps = steps_of(h2 - h1, bend)
    for k in range(steps):
        step = (h2 - h1) / steps
        place = turned_to(place, h1 + k * step, h1 + (k + 1) * step, ramp, bend, scale, substeps)
    return place


PARTS = 4
"""Speeds at the apex that are rated, but one."""

HALVINGS = 20
NARROW = (1e-3, 0.02)
"""Most halvings of a range of speeds at the apex. They end where it is this part of the speed, and
of the range of speeds that are rated.
"""

SHRINKINGS = 12
"""Times that a blend is made smaller until the legs have room for it."""

SMALLER = 0.98
"""Part of the room that such a blend takes at most."""

TURN_STEPS, SCALE_STEPS = 20, 20
"""Largest number of steps to the angle phi, and to the factor on the radius."""

CLOSE, ROUGHLY = 1e-7, 1e-3
"""Part of a distance by which the end of a blend may be off the leg. It is put on the leg. To
compare speeds, the second one is enough.
"""

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
    v: float,
    half_turn: float,
    inside: float,
    tolerance: float,
    side: Side,
    bend: Bend,
    exact: bool,
) -> Half:
    """Return the half of a blend on one leg.

    Args:
        v: speed at the apex, mm/s.
        half_turn: theta/2, rad.
        inside: distance of the apex from the corner, mm.
        tolerance: largest distance to the outside, mm.
        side: the leg.
        bend: the least radius.
        exact: whether its end is on the leg; it is near if not.
    """
    ramp = _ramp(v, side, bend)
    close, substeps = (CLOSE, SUBSTEPS) if exact else (ROUGHLY, 1)
    from_leg = inside * math.cos(half_turn)
    parallel = turned_along(Place(0.0, 0.0, 0.0, 0.0), -half_turn, 0.0, ramp, bend, 1.0, substeps)
    out = -parallel.y - from_leg
    scale, turned, end = 1.0, 0.0, parallel
    if out <= LEAST_OUT * tolerance:
        # A larger radius makes the way shorter. The distance grows about as a power of it.
        power = 1.0
        for _ in range(SCALE_STEPS):
            before, was = scale, -end.y
            scale *= (from_leg / was) ** (1.0 / power)
            end = turned_along(
                Place(0.0, 0.0, 0.0, 0.0), -half_turn, 0.0, ramp, bend, scale, substeps
            )
            if abs(from_leg + end.y) <= close * from_leg:
                break
            if scale != before:
                power = max(1.0, math.log(-end.y / was) / math.log(scale / before))
    elif out <= tolerance:
        radius = radius_at(speed_at(parallel.t, ramp), bend)
        turned = math.sqrt(out / radius)
        for _ in range(TURN_STEPS):
            turned = min(turned, WIDEST)
            end = turned_along(parallel, 0.0, turned, ramp, bend, 1.0, substeps)
            end = turned_along(end, turned, 0.0, ramp, bend, 1.0, substeps)
            gained = end.y - parallel.y
            if abs(gained - out) <= close * out or (turned == WIDEST and gained < out):
                break
            # It grows about as the square of the angle.
            turned *= math.sqrt(out / gained)
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
    exact: bool,
) -> Blend:
    """Return the blend with speed ``v`` at the apex; its time is infinite if it does not fit."""
    before = _half(v, half_turn, inside, tolerance, sides[0], bend, exact)
    after = _half(v, half_turn, inside, tolerance, sides[1], bend, exact)
    return Blend(before.time + after.time, half_turn, inside, before, after)


@njit
def _without_swing(v: float, half_turn: float, inside: float, side: Side, bend: Bend) -> bool:
    """Return whether the half with that speed at the apex stays inside."""
    start, ramp = Place(0.0, 0.0, 0.0, 0.0), _ramp(v, side, bend)
    end = turned_along(start, -half_turn, 0.0, ramp, bend, 1.0, 1)
    return -end.y <= inside * math.cos(half_turn)


@njit
def fastest_blend(
    sine: float, tolerance: float, feed: float, sides: tuple[Side, Side], bend: Bend
) -> Blend:
    """Return the fastest blend.

    Args:
        sine: sin(theta/2) for a turn by theta.
        tolerance: mm.
        feed: largest speed at the apex, mm/s.
        sides: the legs before and behind the corner.
        bend: the least radius.
    """
    half_turn = math.asin(sine)
    inside = WITHIN * tolerance
    for side in sides:
        if side.rests:
            feed = min(feed, reachable_speed(0.0, side.length, side.line.a, side.line.j))
    best, low = no_blend(), 0.0
    for _ in range(SHRINKINGS):
        low, high = 0.0, feed
        for k in range(HALVINGS):
            v = high if k == 0 else 0.5 * (low + high)
            if _without_swing(v, half_turn, inside, sides[0], bend) and _without_swing(
                v, half_turn, inside, sides[1], bend
            ):
                low = v
                if k == 0:
                    break
            else:
                high = v
            if high - low < NARROW[0] * low:
                break
        if low == 0.0:
            return best
        best = _blend(low, half_turn, inside, OUTSIDE * tolerance, sides, bend, True)
        if best.time < math.inf:
            break
        over = max(best.before.reach / sides[0].room, best.after.reach / sides[1].room)
        inside *= min(SMALLER, SMALLER / over)
    if not best.time < math.inf or low >= feed:
        return best
    high, most = feed, low
    for k in range(HALVINGS):
        v = high if k == 0 else 0.5 * (most + high)
        if _blend(v, half_turn, inside, OUTSIDE * tolerance, sides, bend, False).time < math.inf:
            most = v
            if k == 0:
                break
        else:
            high = v
        if high - most < NARROW[1] * (most - low):
            break
    fastest, least = low, best.time
    for part in range(1, PARTS + 1):
        v = low + (most - low) * part / PARTS
        time = _blend(v, half_turn, inside, OUTSIDE * tolerance, sides, bend, False).time
        if time < least:
            fastest, least = v, time
    if fastest > low:
        faster = _blend(fastest, half_turn, inside, OUTSIDE * tolerance, sides, bend, True)
        if faster.time < best.time:
            return faster
    return best


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
            end = turned_to(place, h1, h2, half.ramp, bend, half.scale, SUBSTEPS)
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
