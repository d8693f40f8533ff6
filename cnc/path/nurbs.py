"""NURBS: the Curve protocol over span records (equation 1 of Hui, Wei, Gao 2013)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Self

import numpy as np

from cnc.kernels.path.bernstein import split
from cnc.kernels.path.curve import SPAN_BODY, START, U0, U1
from cnc.path.curve import RecordCurve
from cnc.path.records import Floats, Records, spline_records


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
