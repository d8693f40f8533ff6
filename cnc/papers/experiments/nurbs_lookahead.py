"""Experiments of Hui, Wei and Gao, 2013, section 5: a NURBS sampled with and without look-ahead.

The paper is "Study on the algorithm for real-time interpolation of NURBS curve and simulation",
TELKOMNIKA 11(5). The trident runs at 18 m/min and is sampled every millisecond: by the paper's
interpolator without and with its look-ahead, and by our plan.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.curve import START
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.model.blocks import NurbsFeed
from cnc.papers.algorithms.nurbs_lookahead import interpolate
from cnc.papers.experiments.nurbs_lookahead_figures import (
    AS_PRINTED,
    METRES,
    TRIDENT,
    LookaheadFigures,
    Run,
)
from cnc.papers.page import Cell, Section, Table
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.pulses.sampled import Sampled

Floats = NDArray[np.float64]

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
