"""Arcs and NURBS as members of a fitted chain.

A chain takes the ends of chords of a curve in place of the curve. The chords are no farther from it
than SAGITTA tolerances, and the spline keeps within the rest of the tolerance of the chords.

The middle of an arc that is long beside the bend that it needs at its ends stays an arc:

    line       spline         arc        spline       line
    ──────────|──────────|───────────|──────────|──────────
                         d                      d

There the spline ends with the arc's position and its first four derivatives.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import PLANE_AXES, ArcFeed, NurbsFeed
from cnc.path.block_pieces import Frame, check_arc, check_finite, joined
from cnc.path.kernels.bspline import nurbs_chord_ends
from cnc.path.records import TURN, Floats, Ints, Records, arc_records, sweep_and_angle

SAGITTA = 0.04
"""Largest distance of a curve from its chords, in tolerances."""
LEFT = 0.955
"""Part of the tolerance that is left to the spline."""
BENDS = 11.0
"""An arc of radius r is left to the spline for BENDS sqrt(r tolerance) at an end. A line that
is tangent to it is 60 tolerances away there.
"""
SPARE = 3.0
"""An arc longer than this times both ends keeps its middle."""
STEEPEST = 0.3
"""rad. Largest turn of a chord: a larger one could be a corner of the chain."""
LEAST_RADIUS = 1e-3
"""mm. An arc that is smaller anywhere is no member of a chain."""
DERIVATIVES = 5
SPANS_AT_ONCE = 64
"""Spans of a NURBS whose chords are made at once."""


@dataclass(frozen=True, slots=True)
class Arc:
    """An arc, helix or spiral; lengths in mm, angles in rad.

    Attributes:
        start: (n,): its start.
        end: (n,): its end.
        plane: columns of the two axes of its plane.
        center: in these.
        radius: at the start.
        grown: radius at the end minus that at the start.
        angle: of the start, seen from the centre.
        sweep: from start to end, counter-clockwise positive.
        feed: mm/s.
        line: source line.
    """

    start: Floats
    end: Floats
    plane: tuple[int, int]
    center: tuple[float, float]
    radius: float
    grown: float
    angle: float
    sweep: float
    feed: float
    line: int

    @property
    def smallest(self) -> float:
        """Smallest radius."""
        return min(self.radius, self.radius + self.grown)

    def derivatives(self, part: float, order: int) -> Floats:
        """Return position and derivatives (order + 1, n) by the part of the sweep, at ``part``."""
        out = np.zeros((order + 1, len(self.start)))
        out[0] = self.start + part * (self.end - self.start)
        out[1:2] = self.end - self.start
        i, j = self.plane
        # In the plane: r e^(i w u), with r linear in u.
        turned = complex(0.0, self.sweep)
        unit = complex(math.cos(self.angle + part * self.sweep), 0.0)
        unit += 1j * math.sin(self.angle + part * self.sweep)
        for k in range(order + 1):
            value = (self.radius + part * self.grown) * turned**k * unit
            if k:
                value += k * self.grown * turned ** (k - 1) * unit
            out[k, i], out[k, j] = value.real, value.imag
        out[0, i] += self.center[0]
        out[0, j] += self.center[1]
        if part in (0.0, 1.0):
            out[0] = self.start if part == 0.0 else self.end
        return out

    def state(self, part: float, metrics: NDArray[np.bool_]) -> Floats:
        """Return position and derivatives 1 to 4 by length (5, n) at ``part`` of the sweep.

        metrics: (n,): axes that measure the length. It is exact where the radius is constant. Else
        the speed of the parameter changes along the arc, and the curve is the same.
        """
        state = self.derivatives(part, DERIVATIVES - 1)
        speed = float(np.linalg.norm(state[1, metrics]))
        for k in range(1, DERIVATIVES):
            state[k] /= speed**k
        return state

    def direction(self, part: float) -> list[float]:
        """Return the direction (n,) at ``part`` of the sweep; its length is that of the arc."""
        direction = [b - a for a, b in zip(self.start.tolist(), self.end.tolist(), strict=True)]
        angle, radius = self.angle + part * self.sweep, self.radius + part * self.grown
        cosine, sine = math.cos(angle), math.sin(angle)
        direction[self.plane[0]] = self.grown * cosine - self.sweep * radius * sine
        direction[self.plane[1]] = self.grown * sine + self.sweep * radius * cosine
        return direction

    def between(self, first: float, last: float) -> Arc:
        """Return the part of the arc from ``first`` to ``last``, parts of its sweep."""
        ends = [self.derivatives(part, 0)[0] for part in (first, last)]
        return replace(
            self,
            start=ends[0],
            end=ends[1],
            radius=self.radius + first * self.grown,
            grown=(last - first) * self.grown,
            angle=self.angle + first * self.sweep,
            sweep=(last - first) * self.sweep,
        )

    def chords(self, tolerance: float) -> int:
        """Return the number of chords with which it is within SAGITTA tolerances of them."""
        largest = max(self.radius, self.radius + self.grown)
        # A chord over the angle h is at most |r''| h^2 / 8 away.
        bend = largest + 2.0 * abs(self.grown / self.sweep)
        most = min(math.sqrt(8.0 * SAGITTA * tolerance / bend), STEEPEST)
        return math.ceil(abs(self.sweep) / most)

    def last_chord(self, count: int) -> list[float]:
        """Return the last of so many chords, from its start to its end (n,)."""
        part = (count - 1) / count
        start, end = self.start.tolist(), self.end.tolist()
        chord = [(1.0 - part) * (b - a) for a, b in zip(start, end, strict=True)]
        radius, angle = self.radius + part * self.grown, self.angle + part * self.sweep
        i, j = self.plane
        chord[i] = end[i] - (self.center[0] + radius * math.cos(angle))
        chord[j] = end[j] - (self.center[1] + radius * math.sin(angle))
        return chord

    def bend(self, tolerance: float) -> float:
        """Return the part of the sweep that is left to the spline at an end."""
        return BENDS * math.sqrt(tolerance / self.smallest) / abs(self.sweep)

    def records(self, frame: Frame) -> Iterator[Records]:
        """Yield the records of the exact arc."""
        yield from arc_records(
            self.start,
            self.end,
            self.plane,
            self.center,
            self.sweep / TURN,
            frame.classes,
            frame.accuracy,
        )


def chord_ends(arcs: Sequence[Arc], counts: Ints) -> Floats:
    """Return the ends (sum, n) of the chords of arcs, without their starts.

    Args:
        arcs: the arcs.
        counts: (arcs,): number of chords of each.
    """
    which = np.repeat(np.arange(len(arcs)), counts)
    behind = np.cumsum(counts)
    part = (np.arange(1, behind[-1] + 1) - np.repeat(behind - counts, counts)) / counts[which]
    start = np.array([arc.start for arc in arcs])
    end = np.array([arc.end for arc in arcs])
    points: Floats = start[which] + part[:, None] * (end - start)[which]
    circles = np.array([(arc.radius, arc.grown, arc.angle, arc.sweep, *arc.center) for arc in arcs])
    r, grown, begin, sweep, x, y = circles.T
    radius, angle = r[which] + part * grown[which], begin[which] + part * sweep[which]
    first, second = np.array([arc.plane for arc in arcs]).T
    row = np.arange(len(which))
    points[row, first[which]] = x[which] + radius * np.cos(angle)
    points[row, second[which]] = y[which] + radius * np.sin(angle)
    points[behind - 1] = end
    return points


def arc_of(block: ArcFeed, position: Floats, frame: Frame) -> Arc | None:
    """Return the arc of a block from ``position`` (n,), or None if it is no member of a chain.

    Raises:
        GcodeError: ``not-finite``.
    """
    end = np.array(block.end, np.float64)
    there = end.tolist()
    check_arc(block, there)
    first, second = PLANE_AXES[block.plane]
    i, j = frame.axes.index(first), frame.axes.index(second)
    x0, y0 = float(position[i]) - block.center[0], float(position[j]) - block.center[1]
    x1, y1 = there[i] - block.center[0], there[j] - block.center[1]
    r0, r1 = math.hypot(x0, y0), math.hypot(x1, y1)
    if frame.classes[i] or frame.classes[j] or min(r0, r1) < LEAST_RADIUS:
        return None
    sweep, angle = sweep_and_angle((x0, y0), (x1, y1), block.turns)
    if abs(sweep) * min(r0, r1) < LEAST_RADIUS:
        return None
    return Arc(
        position.copy(),
        end,
        (i, j),
        block.center,
        r0,
        r1 - r0,
        angle,
        sweep,
        block.feed,
        block.line,
    )


def arc_chords(block: ArcFeed, begin: Floats, axes: tuple[str, ...], sagitta: float) -> Floats:
    """Return the ends (n, axes) of chords within ``sagitta`` mm of an arc from ``begin`` (axes,).

    The sagitta of a chord over an angle h is at most r h^2 / 8. A spiral bends little more.
    """
    plane = [axes.index(letter) for letter in PLANE_AXES[block.plane]]
    center, end = np.array(block.center), np.asarray(block.end, np.float64)
    here = begin[plane] - center
    radius, last = float(np.hypot(*here)), float(np.hypot(*(end[plane] - center)))
    sweep = 2.0 * math.pi * block.turns
    part = math.sqrt(8.0 * sagitta / (1.1 * max(radius, last, 1e-9)))
    count = max(math.ceil(abs(sweep) / min(part, math.pi / 4.0)), 1)
    share = np.arange(1, count + 1) / count
    points: Floats = begin + share[:, None] * (end - begin)
    angle = math.atan2(here[1], here[0]) + share * sweep
    radii = radius + share * (last - radius)
    points[:, plane[0]] = center[0] + radii * np.cos(angle)
    points[:, plane[1]] = center[1] + radii * np.sin(angle)
    points[-1] = end
    return points


def nurbs_chords(
    block: NurbsFeed, position: Floats, frame: Frame, tolerance: float
) -> Iterator[Floats] | None:
    """Return ends (m, n) of chords within SAGITTA tolerances of a NURBS, some spans at a time.

    Returns:
        They come without the start. None if axes other than x, y and z move: the curve is no member
        of a chain.

    Raises:
        GcodeError: if the curve does not start at ``position`` (n,), or is not continuous.
    """
    check_finite(block, block.knots, block.control_points, block.weights, np.array(block.feed))
    points = joined(block, position)
    if np.ptp(points[:, frame.classes != 0], axis=0).any():
        return None
    return _chords(block, points, SAGITTA * tolerance)


def _chords(block: NurbsFeed, points: Floats, sagitta: float) -> Iterator[Floats]:
    """Yield ends of chords, see nurbs_chords; points (m, n): the control points."""
    knots = np.asarray(block.knots, np.float64)
    weighted = np.column_stack((points, np.ones(len(points))))
    weighted *= np.asarray(block.weights, np.float64)[:, None]
    inner = np.unique(knots[block.degree : len(points) + 1])
    for first in range(0, len(inner) - 1, SPANS_AT_ONCE):
        u = inner[first : first + SPANS_AT_ONCE + 1]
        ends = nurbs_chord_ends(block.degree, knots, weighted, u, sagitta, STEEPEST)
        if first + SPANS_AT_ONCE >= len(inner) - 1:
            ends[-1] = points[-1]
        yield ends
