"""The Curve protocol, and curves made of piece records.

A curve r(u) runs through the machine's axes over u in [u0, u1]. The methods are those of kurbo's
ParamCurve: evaluate, differentiate, measure, bound, cut out. :class:`~cnc.path.curve.Line`,
:class:`~cnc.path.curve.Arc` and :class:`~cnc.path.curve.Nurbs` make the same records as the builder
of paths. They call the same kernels, one point at a time; work on many points belongs in a kernel.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import PLANE_AXES, ArcFeed, Plane
from cnc.path.kernels import curve as kernels
from cnc.path.kernels.arclength import curve_arclen, curve_inv_arclen
from cnc.path.kernels.curve import SPAN_BODY, START, U0, U1, piece_boxes
from cnc.path.kernels.span_shape import split
from cnc.path.records import (
    Floats,
    Records,
    arc_records,
    axis_classes,
    line_records,
    moving,
    spline_records,
)

ACCURACY = 1e-9
"""mm. Default accuracy of arc lengths."""


@runtime_checkable
class Curve(Protocol):
    """A parametric curve over the axes of a machine; lengths in mm."""

    @property
    def u_range(self) -> tuple[float, float]:
        """First and last parameter."""
        ...

    def eval(self, u: float) -> Floats:
        """Position (n,) at u."""
        ...

    def deriv(self, u: float, order: int = 1) -> Floats:
        """Derivative (n,) of order 1 to 3 by u."""
        ...

    def curvature(self, u: float) -> float:
        """Curvature in 1/mm over the metric axes; infinite where the direction jumps."""
        ...

    def arclen(self, ua: float, ub: float, accuracy: float = ACCURACY) -> float:
        """Arc length from ua to ub."""
        ...

    def inv_arclen(self, s: float, accuracy: float = ACCURACY) -> float:
        """The u at arc length s from the start."""
        ...

    def bounding_box(self) -> tuple[Floats, Floats]:
        """Smallest and largest coordinates (n,), (n,)."""
        ...

    def subsegment(self, ua: float, ub: float) -> Curve:
        """The part from ua to ub as a curve of its own."""
        ...


@dataclass(frozen=True, slots=True)
class _Pieces:
    """Records in order, made to one accuracy.

    Attributes:
        accuracy: mm.
        shape: kind, data and index of each record.
        u: parameter at the start of each piece and at the end of the last.
        s: arc length there, mm.
    """

    accuracy: float
    shape: list[tuple[int, Floats, int]]
    u: list[float]
    s: list[float]


class RecordCurve(ABC):
    """A curve of one or more piece records, which the subclass makes to a given accuracy."""

    def __init__(self, axes: tuple[str, ...]) -> None:
        self.axes = axes
        self._classes: NDArray[np.int64] = axis_classes(axes)
        self._made: _Pieces | None = None

    @abstractmethod
    def records(self, accuracy: float) -> Iterable[Records]:
        """The piece records of the whole curve."""

    @abstractmethod
    def subsegment(self, ua: float, ub: float) -> Self:
        """The part from ua to ub as a curve of its own; its parameter need not be the same."""

    def _pieces(self, accuracy: float = ACCURACY) -> _Pieces:
        if self._made is None or self._made.accuracy > accuracy:
            shape = [
                (records.kind, records.data, int(at))
                for records in self.records(accuracy)
                for at in records.at
            ]
            if not shape:
                raise ValueError("the curve has no length")
            ranges = [kernels.curve_range(*piece) for piece in shape]
            lengths = [float(data[at + kernels.LENGTH]) for _, data, at in shape]
            self._made = _Pieces(
                accuracy,
                shape,
                [float(a) for a, _ in ranges] + [float(ranges[-1][1])],
                [0.0, *(float(s) for s in np.cumsum(lengths))],
            )
        return self._made

    def _at(self, pieces: _Pieces, u: float) -> tuple[int, Floats, int]:
        """Return the piece in which u lies; the later one where two meet."""
        return pieces.shape[min(max(bisect_right(pieces.u, u) - 1, 0), len(pieces.shape) - 1)]

    @property
    def u_range(self) -> tuple[float, float]:
        """First and last parameter."""
        pieces = self._pieces()
        return pieces.u[0], pieces.u[-1]

    def _derivatives(self, u: float) -> Floats:
        out = np.empty((4, len(self.axes)))
        kernels.curve_eval(*self._at(self._pieces(), u), float(u), out)
        return out

    def eval(self, u: float) -> Floats:
        """Position (n,) at u."""
        position: Floats = self._derivatives(u)[0]
        return position

    def deriv(self, u: float, order: int = 1) -> Floats:
        """Derivative (n,) of order 1 to 3 by u; to the right where two pieces meet."""
        if not 1 <= order <= 3:
            raise ValueError("order must be 1, 2 or 3")
        derivative: Floats = self._derivatives(u)[order]
        return derivative

    def curvature(self, u: float) -> float:
        """|q''| over the metric axes in 1/mm; infinite where |dr/du| vanishes."""
        kind, data, at = self._at(self._pieces(), u)
        out = np.empty((4, len(self.axes)))
        if kernels.curve_eval_s(kind, data, at, float(u), out):
            return float("inf")
        metric = data[
            at + kernels.METRIC : at + kernels.METRIC + int(data[at + kernels.METRICS])
        ].astype(np.int64)
        return float(np.linalg.norm(out[2, metric]))

    def arclen(self, ua: float, ub: float, accuracy: float = ACCURACY) -> float:
        """Arc length from ua to ub in mm, negative if ub < ua."""
        if ub < ua:
            return -self.arclen(ub, ua, accuracy)
        pieces = self._pieces(accuracy)
        total = 0.0
        for shape, u0, u1 in zip(pieces.shape, pieces.u, pieces.u[1:], strict=False):
            a, b = max(ua, u0), min(ub, u1)
            if a < b:
                total += float(curve_arclen(*shape, float(a), float(b)))
        return total

    def inv_arclen(self, s: float, accuracy: float = ACCURACY) -> float:
        """The u at arc length s from the start, to ``accuracy`` mm."""
        pieces = self._pieces(accuracy)
        k = min(max(bisect_right(pieces.s, s) - 1, 0), len(pieces.shape) - 1)
        return float(curve_inv_arclen(*pieces.shape[k], float(s - pieces.s[k])))

    def bounding_box(self) -> tuple[Floats, Floats]:
        """Smallest and largest coordinates (n,), (n,): exact, also between the end points."""
        boxes = []
        for kind, data, at in self._pieces().shape:
            low, high = np.empty((1, len(self.axes))), np.empty((1, len(self.axes)))
            piece_boxes(np.array([kind]), np.array([at]), data, low, high)
            boxes.append((low[0], high[0]))
        return np.min([low for low, _ in boxes], axis=0), np.max(
            [high for _, high in boxes], axis=0
        )


# Arcs, helices and slight spirals: the Curve protocol over arc records, one for each turn.


class Arc(RecordCurve):
    """An arc, helix or spiral.

    Args:
        axes: names of the axes.
        start: (n,) mm.
        end: (n,) mm.
        plane: its plane.
        center: first and second axis of the plane, mm.
        turns: whole and part turns, counter-clockwise positive.
    """

    def __init__(
        self,
        axes: tuple[str, ...],
        start: Floats,
        end: Floats,
        plane: Plane,
        center: tuple[float, float],
        turns: float,
    ) -> None:
        super().__init__(axes)
        self.start = np.array(start, np.float64)
        self.end = np.array(end, np.float64)
        self.plane: Plane = plane
        self.center = center
        self.turns = turns

    def records(self, accuracy: float) -> Iterable[Records]:
        """Yield one record for each turn."""
        first, second = PLANE_AXES[self.plane]
        plane = self.axes.index(first), self.axes.index(second)
        yield from arc_records(
            self.start, self.end, plane, self.center, self.turns, self._classes, accuracy
        )

    def subsegment(self, ua: float, ub: float) -> Self:
        """Return the part from ua to ub, its parameter starting at 0 again.

        The angle is proportional to u, and so are the turns.
        """
        u0, u1 = self.u_range
        return type(self)(
            self.axes,
            self.eval(ua),
            self.eval(ub),
            self.plane,
            self.center,
            self.turns * (ub - ua) / (u1 - u0),
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


# Straight moves: the Curve protocol over a line record, with u as the arc length.


class Line(RecordCurve):
    """A straight move from ``start`` to ``end`` (n,), longer than 1e-9 mm."""

    def __init__(self, axes: tuple[str, ...], start: Floats, end: Floats) -> None:
        super().__init__(axes)
        self.start = np.array(start, np.float64)
        self.end = np.array(end, np.float64)

    def records(self, accuracy: float) -> Iterable[Records]:
        """Yield one record, if there is any motion."""
        if moving(self.start, self.end[None])[0]:
            yield line_records(self.start, self.end[None], self._classes)

    def subsegment(self, ua: float, ub: float) -> Self:
        """Return the part from ua to ub, its parameter starting at 0 again."""
        return type(self)(self.axes, self.eval(ua), self.eval(ub))


# NURBS: the Curve protocol over span records (equation 1 of Hui, Wei, Gao 2013).


class Nurbs(RecordCurve):
    """A NURBS.

    Args:
        axes: names of the axes.
        degree: 1 to 9.
        knots: (m + degree + 1,).
        control_points: (m, n) mm.
        weights: (m,): > 0.
    """

    def __init__(
        self,
        axes: tuple[str, ...],
        degree: int,
        knots: Floats,
        control_points: Floats,
        weights: Floats,
    ) -> None:
        super().__init__(axes)
        self.degree = degree
        self.knots = np.array(knots, np.float64)
        self.control_points = np.array(control_points, np.float64)
        self.weights = np.array(weights, np.float64)

    def records(self, accuracy: float) -> Iterable[Records]:
        """Yield one record for each span, two where it has a cusp."""
        yield from spline_records(
            self.degree, self.knots, self.control_points, self.weights, self._classes, accuracy
        )

    def subsegment(self, ua: float, ub: float) -> Self:
        """Return the part from ua to ub with the same parameter, as a NURBS of Bezier spans.

        Its degree is at least 3.
        """
        n = len(self.axes)
        knots: list[float] = []
        rows: list[Floats] = []
        degree = max(self.degree, 3)
        for _, data, at in self._pieces().shape:
            u0, u1 = float(data[at + U0]), float(data[at + U1])
            a, b = max(ua, u0), min(ub, u1)
            if not a < b:
                continue
            first = at + START + 2 * n + SPAN_BODY
            form = data[first : first + (n + 1) * (degree + 1)].reshape(n + 1, degree + 1).copy()
            form[1:] += form[0] * data[at + START : at + START + n, None]
            for row in form:
                behind = row.copy()
                split(behind, 0, degree, (b - u0) / (u1 - u0), row, 0)
                split(row, 0, degree, (a - u0) / (b - u0), behind, 0)
            # A common factor for the weights of a span joins it to the span before.
            if rows:
                form *= rows[-1][-1, 0] / form[0, 0]
            rows.append(form.T)
            knots.extend([a] * (degree if knots else degree + 1))
        knots.extend([min(ub, self.u_range[1])] * (degree + 1))
        # The end of a span is the start of the next: one point for both.
        homogeneous = np.concatenate([rows[0]] + [row[1:] for row in rows[1:]])
        return type(self)(
            self.axes,
            degree,
            np.array(knots),
            homogeneous[:, 1:] / homogeneous[:, :1],
            homogeneous[:, 0],
        )
