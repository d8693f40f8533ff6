"""The room that the legs of a corner have for a blend whose curvature follows the speed.

Where they have too little, the plan stops at the corner, and one motion passes this and the corners
beside it.
"""

from __future__ import annotations

import math

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import LINE, Floats
from cnc.planner.kernels.arrays import LimitArrays, PathArrays
from cnc.planner.kernels.corner_bends import Blend, Side, corner_plane, fastest_blend, largest_speed
from cnc.planner.kernels.corner_cubic import Scratch
from cnc.planner.kernels.corner_turning import Bend, bend_of
from cnc.planner.kernels.legs import LEGS_SHARE, REVERSED, LineBounds, directions, line_bounds

TIGHT = 0.75
"""Where the legs have room for a blend of less than this part of the tolerance, corners are passed
together.
"""

LEAST_TURN = 1e-4
"""Sine of half the smallest turn of a blend whose curvature follows the speed. Below, the plane of
the corner is not known well.
"""


@njit
def only_along(limits: LimitArrays) -> bool:
    """Return whether the jerk is limited along the path, and in no axis."""
    return bool(limits.tangential_jerk < math.inf and limits.axis_jerk.min() == math.inf)


@njit
def side_of(length: float, rests: bool, line: LineBounds) -> Side:
    """Return a leg of a corner.

    Half of it belongs to the corner at its other end, which may be none; the whole leg where the
    motion rests there.
    """
    if rests:
        return Side(2.0 * LEGS_SHARE * length, length, True, line)
    return Side(LEGS_SHARE * length, 0.5 * length, False, line)


@njit
def legs_of(
    path: PathArrays, k: int, bound: Floats, limits: LimitArrays, rests: bool, u: Floats
) -> tuple[Side, Side]:
    """Return the legs of the corner behind line ``k``, with their directions ``u`` (2, axes)."""
    before = path.stop_after[k - 1] if k > 0 else rests
    return (
        side_of(path.length[k], before, line_bounds(u[0], bound[k], limits)),
        side_of(
            path.length[k + 1], path.stop_after[k + 1], line_bounds(u[1], bound[k + 1], limits)
        ),
    )


@njit
def blend_along(
    path: PathArrays,
    k: int,
    bound: Floats,
    limits: LimitArrays,
    sides: tuple[Side, Side],
    sine: float,
    scratch: Scratch,
) -> tuple[Blend, Bend, bool]:
    """Return the fastest blend where no axis limits the jerk, and whether its legs are too short.

    Args:
        path: the path.
        k: the line before the corner.
        bound: largest feed of each piece, mm/s.
        limits: of the machine.
        sides: the legs.
        sine: of half the turn.
        scratch: with the directions of the legs; receives the plane of the corner.
    """
    eps = path.tolerance[k] / corner_plane(sine, scratch.u, scratch.plane)
    feed = min(bound[k], bound[k + 1], largest_speed(scratch.plane, limits))
    bend = bend_of(scratch.plane, eps, max(sides[0].line.a, sides[1].line.a), limits)
    blend = fastest_blend(sine, eps, feed, sides, bend)
    return blend, bend, blend.inside < TIGHT * eps


@njit
def passed_beside(
    path: PathArrays, k: int, bound: Floats, limits: LimitArrays, rests: bool, scratch: Scratch
) -> bool:
    """Return whether what is behind the shorter leg of the corner behind line ``k`` is passed too.

    It is where the motion rests there, or the legs of the corner there are too short as well. Next
    to a blend, the motion past a stop would have too little room. Beside a curve, the ramp to a
    stop would end outside of the leg.
    """
    first = path.length[k] <= path.length[k + 1]
    other = k - 1 if first else k + 2
    if not 0 <= other < len(path.length):
        return True
    if path.pieces.kind[other] != LINE:
        return False
    c = k - 1 if first else k + 1
    if path.stop_after[c] or not path.tolerance[c] > 0.0:
        return True
    turn = directions(
        path.pieces.data, path.pieces.at[c], path.pieces.data, path.pieces.at[c + 1], scratch.u
    )
    if not LEAST_TURN < turn.sine < REVERSED:
        return True
    sides = legs_of(path, c, bound, limits, rests, scratch.u)
    return blend_along(path, c, bound, limits, sides, turn.sine, scratch)[2]
