r"""From a plan to few points that show it: the motion is followed in steps of time, then points
that the rest foretells are left out.

Both steps compare motions, not shapes: the point drawn at a time with the point planned for that
very time. What lies within a tolerance so lies within it as a shape, too, and what is played back
is where the tool is.

      x                 ,o   Between the points kept the tool is drawn at a steady speed. A point can be left out as long as one line
      |            ,-'` .    from the last point kept (A) meets the windows p +- tolerance of all the points since then. Each window
      |      ,-|'`  .  |     leaves a fan of slopes; the next point must lie in what is left of the fan, or else the point before it
      |   ,-'` |.  |         is kept and a new fan begins there. The fan is kept for each axis by itself, with tolerance / sqrt(3),
      A -----------+----- t  so that together they stay within the tolerance.

This is the swinging door of process historians (Bristol, US patent 4669097, 1987), ending on points
of the data. One pass, one point of memory. The chord of a motion over a time h is off by at most
|p''| h^2 / 8; that gives the steps along straight lines, on curves the middle and the quarter of
each step are looked at.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import LINE, curve_eval, curve_inv_arclen
from cnc.kernels.planner.scurve import phase_time
from cnc.kernels.planner.timed import is_timed, timed_motion

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

T, X, Y, Z, S, A, J, RAPID, V, MARK, PIECE = range(11)
"""Columns of a point: time in s, position in mm, path length in mm; of the motion from there to the
next: tangential acceleration mm/s^2, jerk mm/s^3, and 1 for a traverse. Points that are followed
have as well: speed mm/s, marks, number of the piece in the chunk.
"""
KEPT, FOLLOWED = 8, 11
"""Columns of a point that was kept, of one that was followed."""

PHASE, ENTERED = 1, 2
"""Marks: a phase of the plan begins here; a piece of the path begins here."""

NOW_PIECE, NOW_PHASE, STAGE = range(3)
"""Places of the state of :func:`follow`, integers."""
FRESH, UNDER_WAY, AT_END = range(3)
"""Its stages."""
SAME = 1e-9
"""mm: a piece that ends this near to the end of a phase ends with it."""
LEAST_PARTS = 4
"""A curve's stretch within a phase is cut into so many at least, a timed piece into twice as
many.
"""

ANCHOR, LAST, LOW, HIGH, MOST_A, MOST_J, RAPIDLY, HAS, LONG = 0, 8, 16, 19, 22, 23, 24, 25, 26
STATE = 27
"""Places of the state of :func:`thin`: the point kept last, the point seen last, the fan (3 each),
extremes since the former.
"""


@njit
def _place(
    kind: int, data: Floats, at: int, columns: Ints, s: float, q: Floats, p: Floats
) -> float:
    """Position p (3,) at ``s`` mm into the piece, and its parameter there; q: scratch (4, n)."""
    u = curve_inv_arclen(kind, data, at, s)
    curve_eval(kind, data, at, u, q)
    for i in range(3):
        p[i] = q[0, columns[i]] if columns[i] >= 0 else 0.0
    return u


@njit
def _off(p: Floats, a: Floats, b: Floats, part: float) -> float:
    """Distance of p from the point that far along a -> b."""
    square = 0.0
    for i in range(3):
        square += (p[i] - a[i] - part * (b[i] - a[i])) ** 2
    return math.sqrt(square)


@njit
def follow(
    kind: Ints, at: Ints, data: Floats, piece_s: Floats,
    phase_t: Floats, phase_s: Floats, phase_v: Floats, phase_a: Floats, phase_j: Floats,
    t0: float, s0: float, rapid: NDArray[np.bool_], columns: Ints, fine: float, place: Ints, now: Floats, out: Floats,
) -> int:  # fmt: skip
    """Points of a chunk of plan: at the ends of phases and pieces, and so many between that their
    chords are within ``fine`` mm.

    kind .. phase_j: as in PlanChunk. t0, s0: time and path length at its start. rapid (pieces,).
    columns (3,): those of x, y and z in a position, -1 for none. place (3,), now (1,): zeros at
    first, then where the last call came to. out (rows, FOLLOWED). Returns the number of points;
    until the stage is AT_END there are more, the first of which is the last of these once more,
    unmarked.
    """
    n = int(data[at[0]])
    q = np.empty((4, n))
    here = np.empty(3)
    there = np.empty(3)
    middle = np.empty(3)
    piece = place[NOW_PIECE]
    phase = place[NOW_PHASE]
    phases = len(phase_j)
    t = now[0]
    count = 0
    mark = 0
    if place[STAGE] == FRESH:
        place[STAGE] = UNDER_WAY
        while piece < len(kind) - 1 and piece_s[piece + 1] <= phase_s[0] + SAME:
            piece += 1
        mark = PHASE | ENTERED
    while count < len(out):
        v = phase_v[phase]
        a = phase_a[phase]
        j = phase_j[phase]
        shape = int(kind[piece])
        where = int(at[piece])
        began = phase_t[phase]
        duration = phase_t[phase + 1] - began
        done = min(max(t - began, 0.0), duration)
        # where this piece or this phase ends, whichever comes first
        left = piece_s[piece + 1] - phase_s[phase]
        ends_piece = piece < len(kind) - 1 and left <= phase_s[phase + 1] - phase_s[phase] + SAME
        ends_phase = not ends_piece or left >= phase_s[phase + 1] - phase_s[phase] - SAME
        until = duration if ends_phase else max(phase_time(v, a, j, duration, left), done)
        timed = is_timed(shape, data, where)
        s = phase_s[phase] + done * (v + done * (0.5 * a + done * j / 6.0))
        u = _place(shape, data, where, columns, s - piece_s[piece], q, here)
        step = until - done
        if shape == LINE:
            most = max(abs(a + j * done), abs(a + j * until))
            parts = math.ceil(step * math.sqrt(most / (8.0 * fine)) - 1e-6)
            step /= max(parts, 1)
        else:
            step /= 2 * LEAST_PARTS if timed else LEAST_PARTS
        while count < len(out):
            row = out[count]
            row[T] = t0 + began + done
            row[X] = here[0]
            row[Y] = here[1]
            row[Z] = here[2]
            row[S] = s0 + s
            row[V] = max(v + done * (a + 0.5 * done * j), 0.0)
            row[A] = a + done * j
            row[J] = j
            row[RAPID] = 1.0 if rapid[piece] else 0.0
            row[MARK] = mark | (PHASE if timed else 0)
            row[PIECE] = piece
            if timed:
                curve_eval(shape, data, where, u, q)
                row[V], row[A], row[J], _ = timed_motion(data, where, q, v)
            t = began + done
            mark = 0
            count += 1
            if until - done <= 0.0 or count == len(out):
                break
            # one step further; a curve's is cut in half until its chord is near enough
            while True:
                to = min(done + step, until) if until - done > 1.01 * step else until
                s = phase_s[phase] + to * (v + to * (0.5 * a + to * j / 6.0))
                u = _place(shape, data, where, columns, s - piece_s[piece], q, there)
                if shape == LINE or to - done < 1e-9:
                    break
                worst = 0.0
                for part in (0.25, 0.5):
                    x = done + part * (to - done)
                    at_part = phase_s[phase] + x * (v + x * (0.5 * a + x * j / 6.0))
                    _place(shape, data, where, columns, at_part - piece_s[piece], q, middle)
                    worst = max(worst, _off(middle, here, there, part))
                if worst <= 0.5 * fine:
                    break
                step = 0.5 * (to - done)
            done = to
            here[:] = there
            if done >= until:
                break
        if count == len(out):
            break
        if ends_phase:
            phase += 1
            mark |= PHASE
        if ends_piece:
            piece += 1
            mark |= ENTERED
        t = began + until
        if phase == phases:
            # the end, with nothing behind it
            row = out[count]
            row[T] = t0 + t
            row[X] = here[0]
            row[Y] = here[1]
            row[Z] = here[2]
            row[S] = s0 + phase_s[phases]
            row[V] = phase_v[phases]
            row[A] = 0.0
            row[J] = 0.0
            row[RAPID] = 1.0 if rapid[min(piece, len(kind) - 1)] else 0.0
            row[MARK] = PHASE
            row[PIECE] = min(piece, len(kind) - 1)
            count += 1
            place[STAGE] = AT_END
            break
        place[NOW_PIECE] = piece
        place[NOW_PHASE] = phase
    now[0] = t
    return count


@njit
def _keep(state: Floats, out: Floats, count: int) -> int:
    """Write the point kept last with what was met since; the point seen last takes its place."""
    for i in range(S + 1):
        out[count, i] = state[ANCHOR + i]
    out[count, A] = state[MOST_A]
    out[count, J] = state[MOST_J]
    out[count, RAPID] = state[RAPIDLY]
    for i in range(KEPT):
        state[ANCHOR + i] = state[LAST + i]
    for i in range(3):
        state[LOW + i] = -math.inf
        state[HIGH + i] = math.inf
    state[MOST_A] = 0.0
    state[MOST_J] = 0.0
    state[LONG] = 0.0
    return count + 1


@njit
def thin(points: Floats, exact: bool, tolerance: float, state: Floats, out: Floats) -> int:
    """Keep of points (n, KEPT or more) those that the rest needs to stay within ``tolerance`` mm at
    any time; returns how many.

    exact: the acceleration is that at a point and changes with the jerk; else it is the greatest up
    to the next. state (STATE,): zeros at first, carried from call to call. out (n + 1, KEPT): as
    they come, the last one is kept back. Acceleration and jerk become the greatest on the way to
    the next point kept, with their sign. A traverse begins and ends at a point kept, if it is
    longer than the tolerance.
    """
    reach = tolerance / math.sqrt(3.0)
    count = 0
    for row in points:
        if state[HAS] == 0.0:
            state[HAS] = 1.0
            for i in range(KEPT):
                state[LAST + i] = row[i]
                state[ANCHOR + i] = row[i]
            for i in range(3):
                state[LOW + i] = -math.inf
                state[HIGH + i] = math.inf
            continue
        step = row[T] - state[LAST + T]
        if step > 0.0:
            span = row[T] - state[ANCHOR + T]
            fits = True
            moved = 0.0
            for i in range(3):
                slope = (row[X + i] - state[ANCHOR + X + i]) / span
                fits = fits and state[LOW + i] <= slope <= state[HIGH + i]
                moved += (state[LAST + X + i] - state[ANCHOR + X + i]) ** 2
            other = (
                state[LONG] > 0.0
                and state[RAPIDLY] != state[LAST + RAPID]
                and moved > tolerance * tolerance
            )
            if state[LONG] > 0.0 and (other or not fits):
                count = _keep(state, out, count)
                span = step
            for i in range(3):
                change = row[X + i] - state[ANCHOR + X + i]
                state[LOW + i] = max(state[LOW + i], (change - reach) / span)
                state[HIGH + i] = min(state[HIGH + i], (change + reach) / span)
            state[LONG] = 1.0
            state[RAPIDLY] = state[LAST + RAPID]
            a = state[LAST + A]
            later = a + state[LAST + J] * step if exact else a
            a = later if abs(later) > abs(a) else a
            if abs(a) > abs(state[MOST_A]):
                state[MOST_A] = a
            if abs(state[LAST + J]) > abs(state[MOST_J]):
                state[MOST_J] = state[LAST + J]
        for i in range(KEPT):
            state[LAST + i] = row[i]
    return count


@njit
def thin_end(state: Floats, out: Floats) -> int:
    """The points that were kept back, out (2, KEPT); returns how many."""
    if state[HAS] == 0.0:
        return 0
    count = 0
    if state[LONG] > 0.0:
        count = _keep(state, out, count)
    for i in range(KEPT):
        out[count, i] = state[LAST + i] if i <= S else 0.0
    return count + 1
