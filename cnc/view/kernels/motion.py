"""Points along a plan, dense enough that the chords between them show the motion.

Motions are compared, not shapes: the point drawn at a time with the point planned for the same
time. What lies within a tolerance in this sense also does so as a shape, and the animation shows
the tool at its planned position.

The chord of a motion over a time h is off by at most |p''| h^2 / 8. That gives the steps along
straight lines. On curves the middle and the quarter of each step are compared.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.path.kernels.arclength import curve_inv_arclen
from cnc.path.kernels.curve import LINE, Pieces, curve_eval
from cnc.planner.kernels.arrays import PlanArrays
from cnc.planner.kernels.scurve import phase_time
from cnc.planner.kernels.timed import is_timed, timed_motion

# Points of a drawn motion, as arrays with names.

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Points(NamedTuple):
    """Points of a motion, in order of time.

    Attributes:
        t: (n,) time, s.
        position: (n, 3) x, y and z, mm.
        s: (n,) path length, mm.
        accel: (n,) tangential acceleration from there to the next point, mm/s^2.
        jerk: (n,) tangential jerk from there to the next point, mm/s^3.
        rapid: (n,) whether a traverse leads to the next point.
    """

    t: Floats
    position: Floats
    s: Floats
    accel: Floats
    jerk: Floats
    rapid: NDArray[np.bool_]

    def part(self, first: int, last: int | None = None) -> Points:
        """Return the points from ``first`` up to ``last`` as views."""
        part = slice(first, last)
        return Points(
            self.t[part],
            self.position[part],
            self.s[part],
            self.accel[part],
            self.jerk[part],
            self.rapid[part],
        )


def new_points(count: int) -> Points:
    """Return ``count`` points without values."""
    return Points(
        np.empty(count),
        np.empty((count, 3)),
        np.empty(count),
        np.empty(count),
        np.empty(count),
        np.empty(count, np.bool_),
    )


class Followed(NamedTuple):
    """Points along a plan, with more about each of them.

    Attributes:
        points: the points.
        speed: (n,) speed along the path, mm/s.
        mark: (n,) sum of PHASE and ENTERED.
        piece: (n,) index of the piece in the chunk.
    """

    points: Points
    speed: Floats
    mark: Ints
    piece: Ints


PHASE, ENTERED = 1, 2
"""Marks: a phase of the plan begins here; a piece of the path begins here."""


def new_followed(count: int) -> Followed:
    """Return ``count`` points along a plan without values."""
    return Followed(
        new_points(count),
        np.empty(count),
        np.empty(count, np.int64),
        np.empty(count, np.int64),
    )


FRESH, UNDER_WAY, AT_END = range(3)
"""Stages of :func:`follow`."""
PROGRESS = np.dtype(
    [("piece", np.int64), ("phase", np.int64), ("stage", np.int64), ("t", np.float64)]
)
"""State of :func:`follow`: piece, phase and time (s) in the chunk, and the stage."""

SAME = 1e-9
"""mm. A piece that ends this close to the end of a phase ends with it."""
MIN_PARTS = 4
"""Least number of parts of a curve within a phase; a timed piece has twice as many."""


class Route(NamedTuple):
    """The path to be drawn.

    Attributes:
        pieces: the curves of the path.
        rapid: (n,) whether each piece is a traverse.
        columns: (3,) indices of x, y and z in a position, -1 for an axis that is missing.
        tolerance: largest distance of a chord from the motion, mm.
    """

    pieces: Pieces
    rapid: NDArray[np.bool_]
    columns: Ints
    tolerance: float


class Origin(NamedTuple):
    """Time (s) and path length (mm) at the start of a chunk, since the start of the program."""

    t: float
    s: float


class _Scratch(NamedTuple):
    """Arrays for intermediate results: derivatives (4, n) and positions (3,)."""

    q: Floats
    here: Floats
    there: Floats
    middle: Floats


@njit
def _locate(route: Route, piece: int, s: float, q: Floats, out: Floats) -> float:
    """Compute the position (3,) at ``s`` mm into a piece, and return its parameter there."""
    pieces = route.pieces
    kind = int(pieces.kind[piece])
    at = int(pieces.at[piece])
    u = curve_inv_arclen(kind, pieces.data, at, s)
    curve_eval(kind, pieces.data, at, u, q)
    for i in range(3):
        column = route.columns[i]
        out[i] = q[0, column] if column >= 0 else 0.0
    return u


@njit
def _chord_distance(p: Floats, a: Floats, b: Floats, part: float) -> float:
    """Return the distance of p from the point at ``part`` of the chord from a to b."""
    square = 0.0
    for i in range(3):
        square += (p[i] - a[i] - part * (b[i] - a[i])) ** 2
    return math.sqrt(square)


@njit
def _arc_length(plan: PlanArrays, phase: int, dt: float) -> float:
    """Return the arc length at ``dt`` s after the start of a phase."""
    v = plan.v[phase]
    a = plan.a[phase]
    j = plan.j[phase]
    return plan.s[phase] + dt * (v + dt * (0.5 * a + dt * j / 6.0))


@njit
def _next_step(
    route: Route, plan: PlanArrays, piece: int, phase: int,
    span: tuple[float, float, float], work: _Scratch,
) -> tuple[float, float, float]:  # fmt: skip
    """Find the next point; on a curve the step is halved until its chord is close enough.

    Args:
        route: the path.
        plan: phases of the chunk.
        piece: index of the piece.
        phase: index of the phase.
        span: time in the phase, the step, and the end of the stretch, s.
        work: ``here`` is the present position; ``there`` receives the next one.

    Returns:
        Time in the phase at the next point, the step, and the parameter of the piece there.
    """
    done, step, until = span
    kind = int(route.pieces.kind[piece])
    begin = plan.piece_s[piece]
    while True:
        to = min(done + step, until) if until - done > 1.01 * step else until
        u = _locate(route, piece, _arc_length(plan, phase, to) - begin, work.q, work.there)
        if kind == LINE or to - done < 1e-9:
            return to, step, u
        worst = 0.0
        for part in (0.25, 0.5):
            x = done + part * (to - done)
            _locate(route, piece, _arc_length(plan, phase, x) - begin, work.q, work.middle)
            worst = max(worst, _chord_distance(work.middle, work.here, work.there, part))
        if worst <= 0.5 * route.tolerance:
            return to, step, u
        step = 0.5 * (to - done)


@njit
def _first_step(
    route: Route, plan: PlanArrays, piece: int, phase: int, done: float, until: float
) -> float:
    """Return the first step in s of a stretch of one phase over one piece."""
    pieces = route.pieces
    kind = int(pieces.kind[piece])
    step = until - done
    if kind == LINE:
        a = plan.a[phase]
        j = plan.j[phase]
        most = max(abs(a + j * done), abs(a + j * until))
        parts = math.ceil(step * math.sqrt(most / (8.0 * route.tolerance)) - 1e-6)
        return step / max(parts, 1)
    if is_timed(kind, pieces.data, int(pieces.at[piece])):
        # Parts of the whole phase: points may be asked for in small portions.
        return (plan.t[phase + 1] - plan.t[phase]) / (2 * MIN_PARTS)
    return step / MIN_PARTS


@njit
def _write(
    out: Followed, row: int, t: float, s: float, motion: tuple[float, float, float],
    position: Floats, rapid: bool, mark: int, piece: int,
) -> None:  # fmt: skip
    """Write a point; ``motion`` is speed, acceleration and jerk."""
    points = out.points
    points.t[row] = t
    points.position[row] = position
    points.s[row] = s
    out.speed[row], points.accel[row], points.jerk[row] = motion
    points.rapid[row] = rapid
    out.mark[row] = mark
    out.piece[row] = piece


@njit
def _follow_stretch(
    route: Route, plan: PlanArrays, origin: Origin, place: tuple[int, int, int],
    done: float, until: float, work: _Scratch, count: int, out: Followed,
) -> tuple[int, float]:  # fmt: skip
    """Write the points of one phase over one piece, as long as there is room.

    Args:
        route: the path.
        plan: phases of the chunk.
        origin: time and path length at the start of the chunk.
        place: piece, phase, and the marks of the first point.
        done: time in the phase at the first point, s.
        until: time in the phase at the end of the stretch, s.
        work: arrays for intermediate results; ``here`` is the last position at the end.
        count: number of points in ``out``.
        out: receives the points.

    Returns:
        The number of points in ``out``, and the time in the chunk of the last point.
    """
    piece, phase, mark = place
    pieces = route.pieces
    kind = int(pieces.kind[piece])
    at = int(pieces.at[piece])
    timed = is_timed(kind, pieces.data, at)
    v = plan.v[phase]
    a = plan.a[phase]
    j = plan.j[phase]
    began = plan.t[phase]
    s = _arc_length(plan, phase, done)
    u = _locate(route, piece, s - plan.piece_s[piece], work.q, work.here)
    step = _first_step(route, plan, piece, phase, done, until)
    while True:
        motion = (max(v + done * (a + 0.5 * done * j), 0.0), a + done * j, j)
        if timed:
            curve_eval(kind, pieces.data, at, u, work.q)
            speed, accel, jerk, _ = timed_motion(pieces.data, at, work.q, *motion)
            motion = (speed, accel, jerk)
            mark |= PHASE
        now = origin.t + began + done
        _write(out, count, now, origin.s + s, motion, work.here, route.rapid[piece], mark, piece)
        t = began + done
        mark = 0
        count += 1
        if until - done <= 0.0 or count == len(out.speed):
            return count, t
        done, step, u = _next_step(route, plan, piece, phase, (done, step, until), work)
        s = _arc_length(plan, phase, done)
        work.here[:] = work.there
        if done >= until:
            return count, t


@njit
def _stretch_end(
    plan: PlanArrays, place: tuple[int, int, int], t: float
) -> tuple[float, float, bool, bool]:
    """Find the end of a stretch: that of the piece or of the phase, whichever comes first.

    Args:
        plan: phases of the chunk.
        place: piece, phase, and the last piece of the chunk.
        t: time in the chunk at the start of the stretch, s.

    Returns:
        Times in the phase at the start and the end of the stretch (s), and whether the stretch
        ends the piece and the phase.
    """
    piece, phase, last_piece = place
    began = plan.t[phase]
    duration = plan.t[phase + 1] - began
    done = min(max(t - began, 0.0), duration)
    left = plan.piece_s[piece + 1] - plan.s[phase]
    phase_length = plan.s[phase + 1] - plan.s[phase]
    ends_piece = piece < last_piece and left <= phase_length + SAME
    ends_phase = not ends_piece or left >= phase_length - SAME
    if ends_phase:
        return done, duration, ends_piece, ends_phase
    crossing = phase_time(plan.v[phase], plan.a[phase], plan.j[phase], duration, left)
    return done, max(crossing, done), ends_piece, ends_phase


@njit
def follow(
    route: Route, plan: PlanArrays, origin: Origin, progress: NDArray[np.void], out: Followed
) -> int:
    """Write points of a chunk: the ends of phases and pieces, and enough points between them.

    Args:
        route: the path of the chunk.
        plan: its phases.
        origin: time and path length at its start.
        progress: (1,) PROGRESS, zeros at the first call; keeps the state until the next call.
        out: receives the points.

    Returns:
        The number of points. Until the stage is AT_END there are more points; the first of them
        repeats the last one without marks.
    """
    state = progress[0]
    pieces = route.pieces
    last_piece = len(pieces.kind) - 1
    phases = len(plan.j)
    work = _Scratch(
        np.empty((4, int(pieces.data[pieces.at[0]]))), np.empty(3), np.empty(3), np.empty(3)
    )
    piece = int(state["piece"])
    phase = int(state["phase"])
    t = float(state["t"])
    count = 0
    mark = 0
    if state["stage"] == FRESH:
        state["stage"] = UNDER_WAY
        while piece < last_piece and plan.piece_s[piece + 1] <= plan.s[0] + SAME:
            piece += 1
        state["piece"] = piece
        mark = PHASE | ENTERED
    while count < len(out.speed):
        done, until, ends_piece, ends_phase = _stretch_end(plan, (piece, phase, last_piece), t)
        began = plan.t[phase]
        count, t = _follow_stretch(
            route, plan, origin, (piece, phase, mark), done, until, work, count, out
        )
        mark = 0
        if count == len(out.speed):
            break
        if ends_phase:
            phase += 1
            mark |= PHASE
        if ends_piece:
            piece += 1
            mark |= ENTERED
        t = began + until
        if phase == phases:
            piece = min(piece, last_piece)
            motion = (plan.v[phases], 0.0, 0.0)
            s = origin.s + plan.s[phases]
            _write(out, count, origin.t + t, s, motion, work.here, route.rapid[piece], PHASE, piece)
            count += 1
            state["stage"] = AT_END
            break
        state["piece"] = piece
        state["phase"] = phase
    state["t"] = t
    return count
