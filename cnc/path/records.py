"""Records of pieces, as :mod:`cnc.path.kernels.curve` reads them, from end points, arcs and NURBS.

A :class:`Records` is a run of pieces that follow each other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cnc.path.kernels import curve
from cnc.path.kernels.arclength import MAX_ROWS, measure
from cnc.path.kernels.bspline import NUMBERS_PER_AXIS, RECORD_NUMBERS, Nurbs, nurbs_records
from cnc.path.kernels.span_shape import MAX_CUTS, NEGLIGIBLE, NOTICEABLE

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CLASS_OF_LETTER = {"x": 0, "y": 0, "z": 0, "u": 1, "v": 1, "w": 1, "a": 2, "b": 2, "c": 2}
"""Classes of axes. The first class that moves measures the length."""
TURN = 2.0 * math.pi


@dataclass(frozen=True, slots=True)
class Records:
    """Pieces of one kind: indices of their records in ``data`` (m,), and lengths (m,) in mm."""

    kind: int
    at: Ints
    data: Floats
    length: Floats


def axis_classes(axes: tuple[str, ...]) -> Ints:
    """Return the class of each axis (n,): 0 for x y z, 1 for u v w, 2 for a b c."""
    return np.array([CLASS_OF_LETTER[axis] for axis in axes], np.int64)


@lru_cache(maxsize=16)
def _metric_columns(classes: bytes) -> Floats:
    """Return the head entries (number of metric axes, columns) of a record for each class, (3, 4).

    classes: the bytes of the array of classes.
    """
    rows = np.full((3, 4), -1.0)
    for k in range(3):
        columns = np.flatnonzero(np.frombuffer(classes, np.int64) == k)
        rows[k, 0] = len(columns)
        rows[k, 1 : 1 + len(columns)] = columns
    rows.flags.writeable = False
    return rows


def moving(start: Floats, points: Floats) -> NDArray[np.bool_]:
    """Return which of the moves start -> points[0] -> points[1] .. (m, n) have a length.

    Such a move ends farther than NEGLIGIBLE from the end of the last one that had.
    """
    # Axis by axis: numpy takes several times as long for the largest of each short row.
    ends = np.ascontiguousarray(np.concatenate((start[None], points)).T)
    steps = np.abs(np.diff(ends)).max(axis=0, initial=0.0)
    keep: NDArray[np.bool_] = steps > NEGLIGIBLE
    # A step of exactly 0 can be left out on its own. Tiny ones add up.
    if np.any((steps > 0.0) & ~keep):
        last = start
        for i, point in enumerate(points):
            keep[i] = np.abs(point - last).max() > NEGLIGIBLE
            if keep[i]:
                last = point
    return keep


def _lengths(steps: Floats, classes: Ints) -> tuple[Floats, Ints]:
    """Return lengths of moves, steps (m, n), by class (3, m), and the class that measures each."""
    squares = steps * steps
    lengths = np.zeros((3, len(steps)))
    for k in range(3):
        for column in np.flatnonzero(classes == k):
            lengths[k] += squares[:, column]
    np.sqrt(lengths, out=lengths)
    which: Ints = np.argmax(lengths > NOTICEABLE, axis=0)
    faint = lengths[which, np.arange(len(steps))] <= NOTICEABLE
    if np.any(faint):
        which[faint] = np.argmax(lengths[:, faint] > NEGLIGIBLE, axis=0)
    return lengths, which


def move_classes(steps: Floats, classes: Ints) -> Ints:
    """Return the class (m,) that measures each of the moves, steps (m, n)."""
    if not classes.any():
        return np.zeros(len(steps), np.int64)
    return _lengths(steps, classes)[1]


def line_records(start: Floats, points: Floats, classes: Ints) -> Records:
    """Return the records of straight moves start (n,) -> points[0] -> .. (m, n).

    Each is longer than NEGLIGIBLE, see :func:`moving`.
    """
    m, n = points.shape
    ends = np.concatenate((start[None], points))
    lengths, which = _lengths(np.diff(ends, axis=0), classes)
    rows = np.arange(m)
    length = lengths[which, rows]
    stride = curve.START + 2 * n
    data = np.zeros((m, stride))
    data[:, curve.AXES] = n
    data[:, curve.U1] = length
    data[:, curve.LENGTH] = length
    data[:, curve.METRICS : curve.METRICS + 4] = _metric_columns(classes.tobytes())[which]
    data[:, curve.START : curve.START + n] = ends[:-1]
    data[:, curve.START + n :] = ends[1:]
    return Records(curve.LINE, rows * stride, data.reshape(-1), length)


def line_record(start: list[float], end: list[float], classes: Ints) -> Records:
    """Return the record of one straight move of axes that all have the class 0; see line_records.

    ``start``, ``end`` (n,).
    """
    length = math.sqrt(sum((b - a) * (b - a) for a, b in zip(start, end, strict=True)))
    head = (len(start), 0.0, length, length, *_metric_columns(classes.tobytes())[0].tolist(), 0.0)
    return Records(
        curve.LINE,
        np.zeros(1, np.int64),
        np.array((*head, *start, *end), np.float64),
        np.array((length,)),
    )


def arc_records(
    start: Floats,
    end: Floats,
    plane: tuple[int, int],
    center: tuple[float, float],
    turns: float,
    classes: Ints,
    accuracy: float,
) -> Iterator[Records]:
    """Yield the records of an arc, helix or spiral, one for each turn.

    The angle follows from the end points, and ``turns`` gives the number of whole turns. So the end
    is met whatever its rounding. The parameter runs on from turn to turn.

    Args:
        start: (n,) mm.
        end: (n,) mm.
        plane: columns of the plane.
        center: coordinates in these columns, mm.
        turns: counter-clockwise positive.
        classes: (n,): class of each axis.
        accuracy: largest error of the inverse arc length, mm.
    """
    # Numbers of Python: an array for a few numbers takes ten times as long.
    i, j = plane
    here, last_end = start.tolist(), end.tolist()
    x0, y0 = here[i] - center[0], here[j] - center[1]
    x1, y1 = last_end[i] - center[0], last_end[j] - center[1]
    r0, r1 = math.hypot(x0, y0), math.hypot(x1, y1)
    if max(r0, r1) <= NEGLIGIBLE or abs(TURN * turns) <= 1e-15:
        if moving(start, end[None])[0]:
            yield line_records(start, end[None], classes)
        return
    sweep, theta = sweep_and_angle((x0, y0), (x1, y1), turns)
    ex, ey = (x0 / r0, y0 / r0) if r0 > 0.0 else (math.cos(theta), math.sin(theta))
    grown = r1 - r0
    if abs(grown) <= 4e-15 * (r0 + abs(center[0]) + abs(center[1])):
        grown = 0.0
    whole = max(1, math.ceil(abs(turns) - 1e-9))
    begin, moved = here, [b - a for a, b in zip(here, last_end, strict=True)]
    moved[i] = moved[j] = 0.0
    others = math.hypot(
        *(distance for distance, k in zip(moved, classes.tolist(), strict=True) if k == 0)
    )
    extent = math.hypot(sweep * 0.5 * (r0 + r1), others) / whole
    metrics = _metric_columns(classes.tobytes())[0].tolist()
    n = len(here)
    for piece in range(whole):
        last = piece == whole - 1
        part = (piece + 1) / whole
        radius, growth = r0 + grown * piece / whole, grown / whole
        if last:
            there = last_end
        else:
            there = [a + part * b for a, b in zip(begin, moved, strict=True)]
            c, s = math.cos(part * sweep), math.sin(part * sweep)
            there[i] = center[0] + (r0 + part * grown) * (ex * c - ey * s)
            there[j] = center[1] + (r0 + part * grown) * (ex * s + ey * c)
        turned = sweep * piece / whole
        c, s = math.cos(turned), math.sin(turned)
        px, py = ex * c - ey * s, ex * s + ey * c
        swept = sweep / whole
        # the gap that rounding leaves at the end of the piece
        half = math.sin(0.5 * swept)
        along = growth - (radius + growth) * 2.0 * half * half
        across = (radius + growth) * 2.0 * half * math.cos(0.5 * swept)
        open_x = there[i] - here[i] - (along * px - across * py)
        open_y = there[j] - here[j] - (along * py + across * px)
        head = (n, piece * extent, (piece + 1) * extent, extent, *metrics, 0.0)
        body = i, j, radius, growth, swept, theta + turned, px, py, open_x, open_y
        data = np.array((*head, *here, *there, *body), np.float64)
        if grown:
            size = len(data)
            data = np.concatenate((data, np.zeros(3 + curve.ROW * (MAX_ROWS + 1))))
            size = measure(curve.ARC, data, 0, size, accuracy, np.empty((4, n)))
            data = data[:size].copy()
        yield Records(
            curve.ARC, np.zeros(1, np.int64), data, data[curve.LENGTH : curve.LENGTH + 1].copy()
        )
        here = there


def sweep_and_angle(
    start: tuple[float, float], end: tuple[float, float], turns: float
) -> tuple[float, float]:
    """Return the sweep of an arc and the angle of its start, in rad.

    start and end are measured from the centre, mm. The sweep is the angle between them, with the
    whole turns of ``turns``.
    """
    (x0, y0), (x1, y1) = start, end
    sweep = TURN * turns
    from_centre = math.hypot(x0, y0) > 0.0
    if from_centre and math.hypot(x1, y1) > 0.0:
        between = math.atan2(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1)
        exact = between + TURN * round(turns - between / TURN)
        if exact != 0.0:
            sweep = exact
    return sweep, math.atan2(y0, x0) if from_centre else math.atan2(y1, x1) - sweep


def spline_records(
    degree: int,
    knots: Floats,
    points: Floats,
    weights: Floats,
    classes: Ints,
    accuracy: float,
    *,
    most: int = 1024,
) -> Iterator[Records]:
    """Yield the records of the spans of a NURBS.

    Args:
        degree: 1 to 9.
        knots: (m + degree + 1,).
        points: (m, n): control points, mm.
        weights: (m,): > 0.
        classes: (n,): class of each axis.
        accuracy: largest error of the inverse arc length, mm.
        most: largest number of pieces in a run.
    """
    n = points.shape[1]
    knots, points, weights = (
        np.ascontiguousarray(array, np.float64) for array in (knots, points, weights)
    )
    position = points[0].copy()
    most = max(most, MAX_CUTS + 1)
    data = np.empty(
        (MAX_CUTS + 1) * (RECORD_NUMBERS + n * NUMBERS_PER_AXIS) + 512 * min(most, len(points))
    )
    at = np.empty(most, np.int64)
    length = np.empty(most)
    nurbs = Nurbs(degree, knots, points, weights)
    span = degree
    while span < len(points):
        span, pieces, used = nurbs_records(
            nurbs, classes, span, position, accuracy, data, at, length
        )
        if pieces:
            yield Records(
                curve.SPAN, at[:pieces].copy(), data[:used].copy(), length[:pieces].copy()
            )
