"""The Curve protocol, and curves made of piece records.

A curve r(u) runs through the machine's axes over u in [u0, u1]. The methods are those of kurbo's
ParamCurve: evaluate, differentiate, measure, bound, cut out. :class:`~cnc.path.line.Line`,
:class:`~cnc.path.arc.Arc` and :class:`~cnc.path.nurbs.Nurbs` make the same records as the builder
of paths. They call the same kernels, one point at a time; work on many points belongs in a kernel.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path import curve as kernels
from cnc.kernels.path.arclength import curve_arclen, curve_inv_arclen
from cnc.kernels.path.extremes import piece_boxes
from cnc.path.records import Floats, Records, axis_classes

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
