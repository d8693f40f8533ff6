"""Experiments of Hui, Wei and Gao, 2013, section 5: a NURBS sampled with and without look-ahead.

The paper is "Study on the algorithm for real-time interpolation of NURBS curve and simulation",
TELKOMNIKA 11(5). The trident runs at 18 m/min and is sampled every millisecond: by the paper's
interpolator without and with its look-ahead, and by our plan.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from time import process_time
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cnc.machine.load import load_machine
from cnc.machine.models import Machine, PathLimits
from cnc.model.blocks import NurbsFeed
from cnc.model.diagnostics import Diagnostic, MotionLimitError
from cnc.model.units import per_minute
from cnc.papers.kernels import nurbs_lookahead as kernel
from cnc.papers.page import Cell, Figure, Section, Table
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import START, U0, U1
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.pulses.arrays import pieces_of
from cnc.pulses.sampled import Sampled

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

Floats = NDArray[np.float64]


# The sampled NURBS interpolator of Hui, Wei and Gao on a bare curve, from rest to rest.
#
# The paper is in TELKOMNIKA 11(5), 2013.
#
# Programs are planned (:mod:`cnc.planner`) and sampled from the plan (:mod:`cnc.pulses.sampled`).
# This is the method of the paper, for comparison.


@dataclass(frozen=True, slots=True)
class Samples:
    """One row a period, the first at rest at the start.

    Attributes:
        period: s.
        u: (m,): parameter.
        position: (m, n), mm.
        step: (m,): step that the speed asked for in the period that led there, mm.
        chord: (m,): chord made in it, mm.
        chord_error: (m,): distance of the curve from that chord, mm.
        deviation: (m,): relative deviation of the chord from the step.
        went_back: how often the look-ahead went back.
    """

    period: float
    u: Floats
    position: Floats
    step: Floats
    chord: Floats
    chord_error: Floats
    deviation: Floats
    went_back: int

    @property
    def feed(self) -> Floats:
        """Feed asked for in the period that led to each row, mm/s."""
        return self.step / self.period


def interpolate(curve: PathChunk, limits: PathLimits, *, look_ahead: bool = True) -> Samples:
    """Sample one curve by sections 3.2 (adaptive feed step) and 4.2 (look-ahead) of the paper.

    Args:
        curve: pieces over which the parameter runs on, as those of a NURBS.
        limits: limits; those that are None do not limit.
        look_ahead: whether section 4.2 is carried out.

    Raises:
        ValueError: if the parameter does not run on.
        MotionLimitError: ``plan-failed`` if the look-ahead comes to no end.
    """
    pieces = pieces_of(curve)
    _, at, data = pieces
    if np.any(data[at[1:] + U0] != data[at[:-1] + U1]):
        raise ValueError("the parameter does not run on from piece to piece")
    values = kernel.Limits(
        feed=limits.max_feed,
        period=limits.period,
        normal=_or_infinite(limits.max_normal_acceleration),
        tangential=_or_infinite(limits.max_tangential_acceleration),
        jerk=min(_or_infinite(limits.max_jerk), 1e6 * limits.max_feed / limits.period**2),
        chord_error=limits.chord_error,
        deviation=limits.step_deviation or 1e-12,
    )
    n = len(curve.axes)
    work = np.empty((3, 4, n))
    rows = 4096
    while True:
        u, step, chord, error, deviation, queue = np.empty((6, rows))
        out = kernel.Samples(u, np.empty((rows, n)), step, chord, error, deviation)
        outcome, count, backs = kernel.interpolate(pieces, values, look_ahead, out, queue, *work)
        if outcome == kernel.STUCK:
            raise MotionLimitError(
                Diagnostic(
                    "plan-failed",
                    "the look-ahead of the paper does not come to an end on this curve",
                    hint="use the planner",
                )
            )
        if outcome == kernel.DONE:
            break
        rows *= 8
    return Samples(
        limits.period,
        out.u[:count],
        out.position[:count],
        out.step[:count],
        out.chord[:count],
        out.error[:count],
        out.deviation[:count],
        backs,
    )


def _or_infinite(limit: float | None) -> float:
    return math.inf if limit is None else limit


# Figures of the experiment on NURBS look-ahead, and the runs that they show.

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


KNOTS = (0.0, 0.0, 0.0, 0.0, 0.25, 0.5, 0.75, 1.0, 1.0, 1.0, 1.0)
"""Ten are printed, but 7 points of degree 3 need 11. Of the seven weights of 1 six are printed."""
REPEATS = 20
"""Times are the least of so many."""


@cache
def machine() -> Machine:
    """Return the machine with the limits of the paper.

    F 18 m/min, T 1 ms, a_N 0.5 g, A 2400 mm/s^2, J 48000 mm/s^3, h_max 1 um, delta_max 0.001.
    """
    return load_machine("paper-nurbs")


def curve(points: Sequence[tuple[float, float]]) -> PathChunk:
    """Return the cubic NURBS with weights of 1 over these control points."""
    control = np.array([(x, y, 0.0) for x, y in points])
    block = NurbsFeed(
        "", 1, 3, np.array(KNOTS), control, np.ones(len(control)), machine().path.max_feed
    )
    (path,) = (
        item
        for item in build([block], axes=machine().axis_names, start=control[0])
        if isinstance(item, PathChunk)
    )
    return path


def papers_run(path: PathChunk, *, look_ahead: bool) -> Run:
    """Run the paper's interpolator, with or without section 4.2."""
    limits = machine().path
    cost, samples = _timed(lambda: interpolate(path, limits, look_ahead=look_ahead))
    period = limits.period
    accel = np.diff(samples.feed, prepend=0.0) / period
    jerk = np.diff(accel, prepend=0.0) / period
    name = "paper, with look-ahead" if look_ahead else "paper, adaptive step alone"
    return Run(
        name,
        period,
        samples.position,
        samples.feed,
        accel,
        jerk,
        samples.chord_error,
        samples.deviation,
        cost / len(samples.u),
        samples.went_back,
    )


def planned_run(path: PathChunk) -> Run:
    """Run our plan, sampled.

    The chord errors are measured in the middle of each period, by samples at twice the rate.
    """
    limits = machine().path
    start = path.data[path.at[0] :][START : START + len(path.axes)]
    plans = [item for item in LookAhead(machine()).plan([path]) if isinstance(item, PlanChunk)]
    end = plans[-1].t0 + plans[-1].duration

    def sampled(period: float) -> list[Floats]:
        sampler = Sampled(period, start)
        chunks = [chunk for plan in plans for chunk in sampler.samples(plan)] + list(
            sampler.finish(end)
        )
        return [np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in NAMES]

    cost, (position, feed, accel, jerk, deviation) = _timed(lambda: sampled(limits.period))
    middle = sampled(0.5 * limits.period)[0][1::2][: len(position) - 1]
    chord = np.diff(position, axis=0)
    square = np.maximum((chord * chord).sum(axis=1, keepdims=True), 1e-30)
    off = middle - position[:-1]
    off -= (off * chord).sum(axis=1, keepdims=True) / square * chord
    error = np.concatenate([[0.0], np.linalg.norm(off, axis=1)])
    return Run(
        "our plan, sampled",
        limits.period,
        position,
        feed,
        accel,
        jerk,
        error,
        deviation,
        cost / len(feed),
    )


NAMES = ("position", "feed", "accel", "jerk", "step_deviation")


def _timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return the least processor time of some runs (s), and the result of the work."""
    least = float("inf")
    for _ in range(REPEATS):
        began = process_time()
        result = work()
        least = min(least, process_time() - began)
    return least, result


def table_1(printed: Run, trident: Run, ours: Run) -> Table:
    """Return the extremes of the paper, of its algorithm on both curves, and of our plan."""

    def row(
        what: str, published: str, value: Callable[[Run], float], remark: str = ""
    ) -> list[Cell]:
        return [what, published, *(f"{value(run):.5g}" for run in (printed, trident, ours)), remark]

    # Without the start, to which no step leads, and the last step, which may be any part.
    return Table(
        "Table 1. Results of the interpolation",
        (
            "",
            "published",
            "paper's algorithm, points as printed",
            "the same, the trident",
            "our plan, the trident",
            "remark",
        ),
        (
            row(
                "h, largest, mm",
                "6.1359e-4",
                lambda r: r.chord_error.max(),
                "published rows max and min swapped; a_N T^2 / 8 = 6.13e-4",
            ),
            row(
                "h, smallest, mm",
                "3.1493e-13",
                lambda r: r.chord_error[1:-1].min(),
                "the first steps: rounding",
            ),
            row(
                "delta, largest",
                "9.7969e-4",
                lambda r: r.deviation.max(),
                "delta_max is 1e-3; ours: the chord against the arc",
            ),
            row("delta, smallest", "1.574e-7", lambda r: r.deviation[1:-1].min(), "chance"),
            row("F, largest, m/min", "17.916", lambda r: METRES * r.feed.max(), FEED_REMARK),
            row(
                "F, smallest, m/min",
                "4.8e-5",
                lambda r: METRES * r.feed[1:-1].min(),
                "J T^2 = 4.8e-5 m/s: published in another unit",
            ),
            row("a, largest, mm/s^2", "2400", lambda r: r.accel.max()),
            row("a, smallest, mm/s^2", "-2400", lambda r: r.accel.min()),
            row(
                "cost of a sample, us",
                "5 to 57",
                lambda r: 1e6 * r.cost,
                "predict, correct, evaluate, limit; ours without the plan",
            ),
        ),
    )


FEED_REMARK = (
    "from rest with these A and J it takes 26 mm; the adaptive step alone reaches it without a "
    "limit"
)


def legality(runs: Sequence[Run]) -> Table:
    """Return which limits of acceleration and jerk each run keeps, and the time that it takes."""
    limits = machine().path
    rows: list[list[Cell]] = [
        [
            run.name,
            len(run.feed) - 1,
            f"{run.time[-1]:.3f}",
            f"{METRES * run.feed.max():.3f}",
            f"{run.chord_error.max():.4g}",
            f"{np.abs(run.accel).max():.0f}",
            f"{np.abs(run.jerk).max():.3g}",
            run.went_back,
        ]
        for run in runs
    ]
    return Table(
        "The trident: limits that each keeps",
        (
            "",
            "periods",
            "time, s",
            "largest F, m/min",
            "largest h, mm",
            "largest a, mm/s^2",
            "largest jerk, mm/s^3",
            "went back",
        ),
        rows,
        f"The limits along the path are {limits.max_tangential_acceleration:.0f} mm/s^2 "
        f"and {limits.max_jerk:.0f} mm/s^3. The adaptive step alone comes to the end of the curve "
        "at full speed. Going back limits the acceleration. Only the plan limits both, and the "
        "deviation of the chord from the arc. That takes the additional time.",
    )


TEXT = """\
The trident, a closed cubic NURBS, with F 18 m/min, T 1 ms, a_N 0.5 g, A 2400 mm/s², J 48 000 mm/s³,
h_max 1 µm, delta_max 0.001. The paper's interpolator runs in its corrected form: equation 7 with
`dL1` outside of the root, equation 5 iterated to delta_max, 11 knots and 7 weights (10 and 6 are
printed), and control points that give the curve of its Figure 4 (as printed it is lopsided). Our
plan keeps to the same limits of the path, and to the jerk, too."""


def section() -> Section:
    """Return the whole section."""
    trident, printed = curve(TRIDENT), curve(AS_PRINTED)
    runs = [
        papers_run(trident, look_ahead=False),
        papers_run(trident, look_ahead=True),
        planned_run(trident),
    ]
    tables = [table_1(papers_run(printed, look_ahead=True), runs[1], runs[2]), legality(runs)]
    return Section(
        "Sampled interpolation of NURBS with look-ahead (Hui, Wei, Gao 2013)",
        TEXT,
        tables,
        LookaheadFigures(trident, printed, runs, machine().path).figures(),
    )
