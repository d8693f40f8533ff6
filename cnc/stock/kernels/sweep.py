"""Removal of material from a height field by a tool that moves along the pieces of a path.

The stock is a grid of cells over X and Y. Each has one height, that of the material at its centre.
A move lowers the cells that the tool passes to the surface that it leaves there:

    y ^      ,---------------.        For each column of cells (one x) the cells under the tool are
      |     (  o--------->o   )       one range of y, because the area is convex.
      |      '---------------'
      +--------|||||||-------> x

Columns are independent of each other. So each processor takes a band of them, and the result does
not depend on their number. A rapid move, the shank and the holder must not touch material: the
depth by which they would enter is measured in the same way.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit, njit_for_threads
from cnc.path.kernels.curve import LENGTH, LINE, START, U0, U1, Pieces, curve_eval

Floats = NDArray[np.float64]

# Shape of a rotating tool, and the lowest surface that it leaves along a straight move.
#
# A tool is a height h(r) of its cutting surface above its tip, for the distance r from its axis:
#
#     FLAT        h = 0                                            r <= R
#     BALL        h = R - sqrt(R^2 - r^2)                          r <= R
#     BULL        h = 0 for r <= a = R - c, else                   r <= R, c the corner's radius
#                 h = c - sqrt(c^2 - (r - a)^2)
#     CONE        h = k max(0, r - a)                              r <= R, k = 1 / tan(half angle)
#
# The tool moves from its start with the slope -m, m >= 0 (downwards; an upward move is the same one
# backwards). A cell lies u along the move and v beside it. With the tool at t the cell is at
# r^2 = v^2 + (u - t)^2, and the surface left there is
#
#     z(u, v) = min over t of  z0 - m t + h(r),        r <= R,  0 <= t <= L
#
# h grows with r and is convex, so the sum is convex in t and has one minimum. Write s = t - u, the
# lead of the tool. Without ends it lies where h'(r) s / r = m:
#
#     FLAT        s = sqrt(R^2 - v^2)                  (the rim behind)
#     BALL        s = m sqrt(R^2 - v^2) / sqrt(1 + m^2)
#     CONE        s = m v / sqrt(k^2 - m^2), at least the edge of the tip, at most the rim
#     BULL        s = sqrt(r^2 - v^2), r = a + c x, x the root in 0..1 of
#                 P(x) = (1 + m^2) x^2 r^2 - v^2 x^2 - m^2 r^2, by Newton's method
#
# x is the sine of the slope of the surface at the contact. The iteration begins above the root, at
# the lesser of two bounds: s is at most its largest share of the rim's, which it has at v = 0 or at
# v = R; and x is at most (v - a) / c + cbrt(m^2 R / 2 c), the second term being that for v = a.
#
# t = u + s is then limited to the move. If the tool does not reach the cell there, it does not
# reach it at all.

FLAT, BALL, BULL, CONE = range(4)
"""Shapes of a tool."""
ROUNDS = 3
"""Steps of Newton's method for a bull nose. Any lead lies on the tool's way. So an error of the
lead leaves material and never removes too much: less than 1e-5 of the radius for slopes from 0.001
to 100.
"""


class Cutter(NamedTuple):
    """A tool.

    Attributes:
        shape: FLAT, BALL, BULL or CONE.
        radius: radius R, mm.
        flat: radius of the flat part of the tip, mm: a of BULL and CONE.
        rise: corner radius c of BULL, mm; slope k of CONE.
    """

    shape: int
    radius: float
    flat: float
    rise: float


@njit
def height(cutter: Cutter, r: float) -> float:
    """Return the height (mm) of the cutting surface above the tip at ``r`` mm from the axis."""
    if cutter.shape == FLAT:
        return 0.0
    if cutter.shape == BALL:
        return cutter.radius - math.sqrt(max(0.0, cutter.radius * cutter.radius - r * r))
    beyond = max(0.0, r - cutter.flat)
    if cutter.shape == CONE:
        return cutter.rise * beyond
    return cutter.rise - math.sqrt(max(0.0, cutter.rise * cutter.rise - beyond * beyond))


@njit
def reach(cutter: Cutter, room: float) -> float:
    """Return the radius (mm) up to which the tool is at most ``room`` mm above its tip."""
    if cutter.shape == FLAT:
        return cutter.radius
    if cutter.shape == CONE:
        return min(cutter.radius, cutter.flat + room / cutter.rise)
    corner = cutter.radius if cutter.shape == BALL else cutter.rise
    if room >= corner:
        return cutter.radius
    return cutter.radius - corner + math.sqrt(room * (2.0 * corner - room))


@njit
def lead(cutter: Cutter, slope: float, v: float) -> float:
    """Return the lead s (mm) of the tool for a cell ``v`` mm beside a move with a slope m >= 0."""
    square = v * v
    rim = math.sqrt(max(0.0, cutter.radius * cutter.radius - square))
    if slope == 0.0:
        return 0.0
    if cutter.shape == FLAT:
        return rim
    if cutter.shape == BALL:
        return slope * rim / math.sqrt(1.0 + slope * slope)
    edge = math.sqrt(max(0.0, cutter.flat * cutter.flat - square))
    if cutter.shape == CONE:
        steep = cutter.rise * cutter.rise - slope * slope
        return rim if steep <= 0.0 else min(rim, max(edge, slope * abs(v) / math.sqrt(steep)))
    share, spread = first_bounds(cutter, slope)
    flat, rise, steep = cutter.flat, cutter.rise, slope * slope
    x = (math.sqrt(square + share * share * rim * rim) - flat) / rise
    x = max(0.0, min(x, max(0.0, (abs(v) - flat) / rise) + spread, 1.0))
    for _ in range(ROUNDS):
        r = flat + rise * x
        value = (1.0 + steep) * x * x * r * r - square * x * x - steep * r * r
        rate = (1.0 + steep) * x * r * (r + rise * x) - square * x - steep * rise * r
        x = max(0.0, x - max(0.0, 0.5 * value / rate if rate > 0.0 else 0.0))
    r = flat + rise * x
    return math.sqrt(max(0.0, r * r - square))


@njit
def first_bounds(cutter: Cutter, slope: float) -> tuple[float, float]:
    """Return the largest share of the rim's lead, and the bound of x at v = a, for a bull nose.

    The slope is greater than 0.
    """
    radius, rise = cutter.radius, cutter.rise
    steep = slope * slope
    middle = (cutter.flat + rise * slope / math.sqrt(1.0 + steep)) / radius
    at_rim = 1.0 / math.sqrt(1.0 + rise / (steep * radius))
    return max(middle, at_rim), (0.5 * steep * radius / rise) ** (1.0 / 3.0)


# Cells of one column under a tool that moves along a straight line.


class Move(NamedTuple):
    """A straight move that does not rise.

    Attributes:
        along: its length L in X and Y, mm.
        dx: x of its direction in X and Y.
        dy: y of its direction.
        slope: its slope m downwards, at least 0.
        low: height of the tip at its start, mm; of a vertical move at its lower end.
    """

    along: float
    dx: float
    dy: float
    slope: float
    low: float


@njit
def cut_column(column: Floats, y: float, cell: float, x: float, move: Move, cutter: Cutter) -> None:
    """Lower the cells of a column under the tool; these loops are the formulas of ``cutter``.

    They are written out, without calls, so that the compiler takes several cells at once.

    Args:
        column: heights of the cells under the tool, mm.
        y: y of the first of them, from the start of the move, mm.
        cell: distance of the cells, mm.
        x: x of the column, from the start of the move, mm.
        move: the move.
        cutter: the tool.
    """
    along, dx, dy, slope, low = move.along, move.dx, move.dy, move.slope, move.low
    square, flat, rise = cutter.radius * cutter.radius, cutter.flat, cutter.rise
    if cutter.shape == FLAT and slope == 0.0:
        for k in range(len(column)):
            column[k] = min(column[k], low)
    elif cutter.shape == FLAT:
        for k in range(len(column)):
            b = y + k * cell
            u, v = x * dx + b * dy, b * dx - x * dy
            t = min(max(u + math.sqrt(max(0.0, square - v * v)), 0.0), along)
            column[k] = min(column[k], low - slope * t)
    elif cutter.shape == BALL:
        share = slope / math.sqrt(1.0 + slope * slope)
        for k in range(len(column)):
            b = y + k * cell
            u, v = x * dx + b * dy, b * dx - x * dy
            rim = square - v * v
            t = min(max(u + share * math.sqrt(max(0.0, rim)), 0.0), along)
            z = low + cutter.radius - slope * t - math.sqrt(max(0.0, rim - (u - t) * (u - t)))
            column[k] = min(column[k], z)
    elif cutter.shape == CONE:
        steep = rise * rise - slope * slope
        share = slope / math.sqrt(steep) if steep > 0.0 else 1e9
        for k in range(len(column)):
            b = y + k * cell
            u, v = x * dx + b * dy, b * dx - x * dy
            rim = math.sqrt(max(0.0, square - v * v))
            s = 0.0
            if slope > 0.0:
                s = min(rim, max(math.sqrt(max(0.0, flat * flat - v * v)), share * abs(v)))
            t = min(max(u + s, 0.0), along)
            r = math.sqrt(v * v + (u - t) * (u - t))
            column[k] = min(column[k], low - slope * t + rise * max(0.0, r - flat))
    else:
        steep, share, spread = slope * slope, 0.0, 0.0
        if slope > 0.0:
            share, spread = first_bounds(cutter, slope)
        for k in range(len(column)):
            b = y + k * cell
            u, v = x * dx + b * dy, b * dx - x * dy
            s = 0.0
            if slope > 0.0:
                beside = v * v
                contact = math.sqrt(beside + share * share * max(0.0, square - beside))
                sine = max(0.0, (abs(v) - flat) / rise) + spread
                sine = max(0.0, min((contact - flat) / rise, sine, 1.0))
                for _ in range(ROUNDS):
                    r = flat + rise * sine
                    value = ((1.0 + steep) * r * r - beside) * sine * sine - steep * r * r
                    rate = (1.0 + steep) * sine * r * (r + rise * sine) - beside * sine
                    rate -= steep * rise * r
                    sine = max(0.0, sine - max(0.0, 0.5 * value / max(rate, 1e-300)))
                r = flat + rise * sine
                s = math.sqrt(max(0.0, r * r - beside))
            t = min(max(u + s, 0.0), along)
            beyond = max(0.0, math.sqrt(v * v + (u - t) * (u - t)) - flat)
            corner = rise - math.sqrt(max(0.0, rise * rise - beyond * beyond))
            column[k] = min(column[k], low - slope * t + corner)


@njit
def depth_in_column(
    column: Floats, y: float, cell: float, x: float, move: Move, cutter: Cutter
) -> tuple[float, int]:
    """Return how deep (mm) the tool enters a column, and the cell; arguments as of the cut."""
    deepest, place = 0.0, 0
    for k in range(len(column)):
        b = y + k * cell
        u, v = x * move.dx + b * move.dy, b * move.dx - x * move.dy
        t = min(max(u + lead(cutter, move.slope, v), 0.0), move.along)
        r = min(math.sqrt(v * v + (u - t) * (u - t)), cutter.radius)
        depth = column[k] - (move.low - move.slope * t + height(cutter, r))
        if depth > deepest:
            deepest, place = depth, k
    return deepest, place


NEAREST = 0.71
"""Cells. A tool of any size covers the cell whose centre is nearest to its axis."""
SAME = 1e-9
"""mm. A shorter move in X and Y is vertical."""
SPACING = 2.0
"""Cells. Distance of the points between which a curve is cut as a straight move."""
LONGEST_RUN = 16
"""Most lines that one chord replaces."""


class Field(NamedTuple):
    """Heights of the material.

    Attributes:
        surface: (nx, ny) height of each cell, mm.
        low: (2,) x and y of the corner of the grid, mm.
        cell: width of a cell, mm.
        top: height above which there is no material, mm.
    """

    surface: Floats
    low: Floats
    cell: float
    top: float


class Route(NamedTuple):
    """The path of the tool tip.

    Attributes:
        pieces: the curves of the path.
        rapid: (n,) whether each piece is a traverse.
        columns: (3,) columns of x, y and z in a position.
        offset: (3,) tool offset, subtracted from a position to give the tool tip, mm.
    """

    pieces: Pieces
    rapid: NDArray[np.bool_]
    columns: NDArray[np.int64]
    offset: Floats


class Assembly(NamedTuple):
    """A tool with the parts of it that do not cut.

    Attributes:
        cutter: the part that cuts.
        flutes: length of the cutting part from the tip, mm; infinite if it is not known.
        stickout: distance of the holder from the tip, mm; infinite without a holder.
        holder: radius of the holder, mm.
    """

    cutter: Cutter
    flutes: float
    stickout: float
    holder: float


RAPID, SHANK, HOLDER = range(3)
"""Wrong contacts: the tool on a rapid move, the shank above the flutes, the holder."""


class Depths(NamedTuple):
    """Depths (mm) by which parts enter material on each piece; 0 without a contact.

    Attributes:
        depth: (n, 3) largest depth of each part on each piece; the parts are RAPID, SHANK, HOLDER.
        place: (n, 3, 2) x and y there, mm.
    """

    depth: Floats
    place: Floats


@njit
def _range(x: float, y: float, move: Move, radius: float, out: Floats) -> bool:
    """Write into ``out`` (2,) the range of y in which a column of cells lies under the tool.

    Args:
        x: x of the column, from the start of the move, mm.
        y: y of the first cell, from the start of the move, mm.
        move: the move.
        radius: radius of the tool, mm.
        out: lowest and highest y from the first cell, mm.

    Returns:
        Whether there is such a range.
    """
    along, dx, dy = move.along, move.dx, move.dy
    low, high = math.inf, -math.inf
    half = radius * radius - x * x
    if half >= 0.0:
        half = math.sqrt(half)
        low, high = -half, half
    beyond = x - along * dx
    half = radius * radius - beyond * beyond
    if half >= 0.0:
        half = math.sqrt(half)
        low, high = min(low, along * dy - half), max(high, along * dy + half)
    # The rectangle between both ends: |v| <= radius and 0 <= u <= along.
    first, last = -math.inf, math.inf
    if dx != 0.0:
        first = (x * dy - math.copysign(radius, dx)) / dx
        last = (x * dy + math.copysign(radius, dx)) / dx
    elif abs(x) > radius:
        last = -math.inf
    if dy != 0.0:
        one, other = -x * dx / dy, (along - x * dx) / dy
        first, last = max(first, min(one, other)), min(last, max(one, other))
    elif not 0.0 <= x * dx <= along:
        last = -math.inf
    if first <= last:
        low, high = min(low, first), max(high, last)
    out[0], out[1] = low - y, high - y
    return low <= high


@njit
def _segment(
    field: Field,
    band: tuple[int, int],
    start: Floats,
    end: Floats,
    cutter: Cutter,
    inset: float,
    bounds: Floats,
) -> float:
    """Move the tool from ``start`` (3,) to ``end`` (3,), mm.

    Args:
        field: the material.
        band: first column of cells, and the one behind the last.
        start: position of the tip, mm.
        end: position of the tip, mm.
        cutter: the tool.
        inset: negative to remove the material. Else nothing is removed, and the cells are examined
            that lie at least this far inside the rim of the tool, mm.
        bounds: (4,) for intermediate results. Behind the first two stand x and y of the place
            where the tool is deepest in material, mm.

    Returns:
        The depth by which the tool enters material, mm; 0 if it is removed.
    """
    surface, cell = field.surface, field.cell
    if end[2] > start[2]:
        start, end = end, start
    if end[2] >= field.top:
        return 0.0
    radius = max(reach(cutter, field.top - end[2]) - max(0.0, inset), NEAREST * cell)
    left = (min(start[0], end[0]) - radius - field.low[0]) / cell
    right = (max(start[0], end[0]) + radius - field.low[0]) / cell
    first = max(band[0], math.ceil(min(max(0.0, left), 1e9) - 0.5))
    behind = min(band[1], math.floor(min(max(right, -1.0), 1e9) - 0.5) + 1)
    if first >= behind:
        return 0.0
    along = math.hypot(end[0] - start[0], end[1] - start[1])
    move = Move(along, 1.0, 0.0, 0.0, end[2])
    if along > SAME:
        drop = start[2] - end[2]
        dx, dy = (end[0] - start[0]) / along, (end[1] - start[1]) / along
        move = Move(along, dx, dy, drop / along, start[2])
    y = field.low[1] + 0.5 * cell - start[1]
    deepest = 0.0
    for i in range(first, behind):
        x = field.low[0] + (i + 0.5) * cell - start[0]
        if not _range(x, y, move, radius, bounds):
            continue
        one = math.ceil(min(max(0.0, bounds[0] / cell), 1e9))
        stop = min(surface.shape[1], math.floor(min(max(-1.0, bounds[1] / cell), 1e9)) + 1)
        if one >= stop:
            continue
        column = surface[i, one:stop]
        if inset < 0.0:
            cut_column(column, y + one * cell, cell, x, move, cutter)
        else:
            depth, place = depth_in_column(column, y + one * cell, cell, x, move, cutter)
            if depth > deepest:
                deepest = depth
                bounds[2] = x + start[0]
                bounds[3] = y + (one + place) * cell + start[1]
    return deepest


@njit
def _tip(route: Route, piece: int, share: float, q: Floats, out: Floats) -> None:
    """Write the position (3,) of the tip at a share of a piece's parameter, mm."""
    pieces = route.pieces
    at = int(pieces.at[piece])
    u0, u1 = pieces.data[at + U0], pieces.data[at + U1]
    curve_eval(int(pieces.kind[piece]), pieces.data, at, u0 + share * (u1 - u0), q)
    for k in range(3):
        out[k] = q[0, route.columns[k]] - route.offset[k]


@njit
def _end(route: Route, piece: int, axes: int, out: Floats) -> None:
    """Write the position (3,) of the tip at the end of a piece, mm."""
    at = int(route.pieces.at[piece]) + START + axes
    for k in range(3):
        out[k] = route.pieces.data[at + route.columns[k]] - route.offset[k]


@njit
def _lies_on_chord(start: Floats, end: Floats, point: Floats, tolerance: float) -> bool:
    """Return whether a point (3,) lies between two others and within a tolerance of their chord."""
    length = dot = square = 0.0
    for k in range(3):
        chord, there = end[k] - start[k], point[k] - start[k]
        length += chord * chord
        dot += chord * there
        square += there * there
    if length <= 0.0 or not 0.0 <= dot <= length:
        return False
    return square - dot * dot / length <= tolerance * tolerance


@njit
def _run_of_lines(
    route: Route, first: int, start: Floats, tolerance: float, axes: int, points: Floats
) -> int:
    """Return how many lines from ``first`` on one chord replaces within a tolerance (mm).

    Args:
        route: the path.
        first: index of a line.
        start: (3,) position of the tip at its start, mm.
        tolerance: largest distance of the path from the chord, mm.
        axes: number of the columns of a position.
        points: (m, 3) for the ends of at most m lines; the last in use is the end of the chord.
    """
    pieces, count = route.pieces, 0
    while count < len(points) and first + count < len(pieces.kind):
        piece = first + count
        if pieces.kind[piece] != LINE or route.rapid[piece] != route.rapid[first]:
            break
        _end(route, piece, axes, points[count])
        if count and route.rapid[first]:
            break
        fits = True
        for k in range(count):
            fits = fits and _lies_on_chord(start, points[count], points[k], tolerance)
        if not fits:
            break
        count += 1
    return count


@njit
def _raised(
    field: Field,
    band: tuple[int, int],
    ends: tuple[Floats, Floats],
    part: Cutter,
    lift: float,
    bounds: Floats,
) -> float:
    """Return how deep (mm) a part ``lift`` mm above the tip enters material."""
    start, end = ends[0].copy(), ends[1].copy()
    start[2] += lift
    end[2] += lift
    return _segment(field, band, start, end, part, field.cell, bounds)


@njit
def _note(depths: Depths, piece: int, part: int, depth: float, bounds: Floats) -> None:
    """Keep a depth if it is the largest of its piece and part."""
    if depth > depths.depth[piece, part]:
        depths.depth[piece, part] = depth
        depths.place[piece, part, 0], depths.place[piece, part, 1] = bounds[2], bounds[3]


@njit_for_threads
def cut_pieces(
    field: Field,
    band: tuple[int, int],
    route: Route,
    tool: Assembly,
    tolerance: float,
    depths: Depths,
) -> None:
    """Remove the material along a path, and write the depths of wrong contacts.

    A rapid move removes material, too; so it is found once.

    Args:
        field: the material; lowered.
        band: first column of cells, and the one behind the last.
        route: the path.
        tool: the tool.
        tolerance: largest distance of a chord from the path that it replaces, mm.
        depths: written for each piece; a chord's stand at its first line.
    """
    pieces = route.pieces
    axes = int(pieces.data[int(pieces.at[0])]) if len(pieces.kind) else 0
    q, bounds = np.empty((4, axes)), np.empty(4)
    start, end, points = np.empty(3), np.empty(3), np.empty((LONGEST_RUN, 3))
    shank = Cutter(FLAT, tool.cutter.radius, tool.cutter.radius, 0.0)
    holder = Cutter(FLAT, tool.holder, tool.holder, 0.0)
    piece = 0
    while piece < len(pieces.kind):
        at = int(pieces.at[piece])
        for k in range(3):
            start[k] = pieces.data[at + START + route.columns[k]] - route.offset[k]
        parts, done = 1, 1
        if pieces.kind[piece] == LINE:
            done = max(1, _run_of_lines(route, piece, start, tolerance, axes, points))
            end[:] = points[done - 1]
        else:
            parts = max(2, math.ceil(pieces.data[at + LENGTH] / (SPACING * field.cell)))
        for part in range(parts):
            if parts > 1:
                _tip(route, piece, (part + 1) / parts, q, end)
            low = min(start[2], end[2])
            if route.rapid[piece]:
                depth = _segment(field, band, start, end, tool.cutter, field.cell, bounds)
                _note(depths, piece, RAPID, depth, bounds)
            if low + tool.flutes < field.top:
                depth = _raised(field, band, (start, end), shank, tool.flutes, bounds)
                _note(depths, piece, SHANK, depth, bounds)
            if low + tool.stickout < field.top:
                depth = _raised(field, band, (start, end), holder, tool.stickout, bounds)
                _note(depths, piece, HOLDER, depth, bounds)
            _segment(field, band, start, end, tool.cutter, -1.0, bounds)
            start[:] = end
        piece += done
