"""Figures of the experiment on NURBS look-ahead, and the runs that they show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import PathLimits
from cnc.model.units import per_minute
from cnc.papers.algorithms.nurbs_lookahead import interpolate
from cnc.papers.page import Figure
from cnc.path.chunk import PathChunk

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

Floats = NDArray[np.float64]

TRIDENT = ((10, 0), (20, 20), (12, 8), (10, 20), (8, 8), (0, 20), (10, 0))
"""Control points (mm) of the curve of Figure 4."""
AS_PRINTED = ((10, 10), (20, 10), (12, 8), (10, 20), (8, 8), (0, 20), (10, 0))
METRES = per_minute(1.0) / 1e3
"""m/min, of 1 mm/s."""


@dataclass(frozen=True, slots=True)
class Run:
    """One row for each period T.

    Acceleration and jerk are differences of the feed; those of our plan are the plan's own.

    Attributes:
        name: for the tables.
        period: s.
        position: mm.
        feed: in the period before, mm/s.
        accel: along the path, mm/s^2.
        jerk: along the path, mm/s^3.
        chord_error: mm.
        deviation: relative deviation of the step.
        cost: computing time of a sample, s.
        went_back: how often the look-ahead went back.
    """

    name: str
    period: float
    position: Floats
    feed: Floats
    accel: Floats
    jerk: Floats
    chord_error: Floats
    deviation: Floats
    cost: float
    went_back: int = 0

    @property
    def time(self) -> Floats:
        """Time of each row, s."""
        return self.period * np.arange(len(self.feed), dtype=np.float64)


@dataclass(frozen=True)
class LookaheadFigures:
    """Figures 4 to 10 of the paper.

    Attributes:
        trident: The curve of the paper.
        printed: The curve with its control points as they are printed.
        runs: The algorithms to compare; the second is the paper's with its look-ahead.
        limits: Limits of the machine of the paper.
    """

    trident: PathChunk
    printed: PathChunk
    runs: Sequence[Run]
    limits: PathLimits

    def figures(self) -> list[Figure]:
        """Return the figures in the order of the paper."""
        return [
            Figure(
                "nurbs-4-curve",
                "Figure 4. The curve with its control points, and as they are printed",
                self._figure_4,
                (8.0, 4.5),
            ),
            Figure(
                "nurbs-5-trajectory",
                "Figure 5. Trajectory of the interpolation: "
                "the paper's algorithm with its look-ahead",
                self._figure_5,
                (5.5, 5.0),
            ),
            Figure(
                "nurbs-6-projection",
                "Figure 6. Its projection on the plane XY, a point a period",
                self._figure_6,
                (5.5, 4.5),
            ),
            Figure("nurbs-7-feed", "Figure 7. Feed", self._figure_7),
            Figure("nurbs-8-chord-error", "Figure 8. Chord error", self._figure_8),
            Figure("nurbs-9-deviation", "Figure 9. Deviation of the step", self._figure_9),
            Figure(
                "nurbs-10-acceleration",
                "Figure 10. Acceleration along the path, and the jerk that goes with it",
                self._figure_10,
                (7.0, 6.0),
            ),
        ]

    def _over_time(
        self,
        axes: Any,
        shown: Sequence[Run],
        value: Callable[[Run], Floats],
        label: str,
        *bounds: float | None,
    ) -> None:
        for run in shown:
            axes.plot(run.time, value(run), label=run.name, color=f"C{self.runs.index(run)}")
        for bound in bounds:
            if bound is not None:
                axes.axhline(bound, color="0.3", linestyle=":", linewidth=0.8)
        axes.set(xlabel="time, s", ylabel=label)
        axes.legend()

    def _figure_4(self, canvas: Canvas) -> None:
        for k, (name, points, path) in enumerate(
            (("the trident", TRIDENT, self.trident), ("as printed", AS_PRINTED, self.printed))
        ):
            axes = canvas.add_subplot(
                1, 2, k + 1, aspect="equal", title=name, xlabel="x, mm", ylabel="y, mm"
            )
            axes.plot(*np.array(points, float).T, "o--", color="0.6", linewidth=0.8, markersize=3)
            axes.plot(*interpolate(path, self.limits).position[:, :2].T)

    def _figure_5(self, canvas: Canvas) -> None:
        axes = canvas.add_subplot(
            projection="3d", xlabel="x, mm", ylabel="y, mm", zlabel="z, mm", zlim=(-1.0, 1.0)
        )
        axes.plot(*self.runs[1].position.T, ".-", markersize=3, linewidth=0.5)
        axes.set_box_aspect(None, zoom=0.85)  # type: ignore[attr-defined, unused-ignore]

    def _figure_6(self, canvas: Canvas) -> None:
        axes = canvas.add_subplot(aspect="equal", xlabel="x, mm", ylabel="y, mm")
        points = axes.scatter(
            self.runs[1].position[:, 0],
            self.runs[1].position[:, 1],
            c=METRES * self.runs[1].feed,
            s=5,
        )
        canvas.colorbar(points, ax=axes, label="feed, m/min")

    def _figure_7(self, canvas: Canvas) -> None:
        self._over_time(
            canvas.add_subplot(),
            self.runs,
            lambda run: METRES * run.feed,
            "feed, m/min",
            METRES * self.limits.max_feed,
        )

    def _figure_8(self, canvas: Canvas) -> None:
        self._over_time(
            canvas.add_subplot(),
            self.runs,
            lambda run: 1e3 * run.chord_error,
            "chord error, µm",
            1e3 * self.limits.chord_error,
        )

    def _figure_9(self, canvas: Canvas) -> None:
        self._over_time(
            canvas.add_subplot(),
            self.runs[1:],
            lambda run: run.deviation,
            "deviation of the step",
            self.limits.step_deviation,
        )

    def _figure_10(self, canvas: Canvas) -> None:
        most, jerk = self.limits.max_tangential_acceleration or 0.0, self.limits.max_jerk or 0.0
        self._over_time(
            canvas.add_subplot(2, 1, 1),
            self.runs[1:],
            lambda run: run.accel,
            "acceleration, mm/s²",
            -most,
            most,
        )
        axes = canvas.add_subplot(2, 1, 2)
        self._over_time(axes, self.runs[1:], lambda run: run.jerk, "jerk, mm/s³", -jerk, jerk)
        axes.set_yscale("symlog", linthresh=2.0 * jerk)
