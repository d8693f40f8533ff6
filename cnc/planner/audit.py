"""The audit: a check of every finished plan, by other means than those that made it.

The kernels (:mod:`cnc.planner.kernels.audit`) compute the largest values that a plan reaches. Here
they are compared with the limits. A plan that breaks one is an error of the planner: it is never
sent on.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from math import ceil, inf

import numpy as np
from numpy.typing import NDArray

from cnc.model.diagnostics import Diagnostic, MotionLimitError
from cnc.path.kernels.curve import START, Pieces
from cnc.planner.kernels.audit import (
    ACCEL,
    CHORD_ERROR,
    ENTRIES,
    FEED,
    GAPS,
    JERK,
    NORMAL_ACCEL,
    OVERSPEED,
    STEP_DEVIATION,
    Largest,
    audit_phases,
    continuity,
)
from cnc.planner.kernels.audit_samples import audit_samples
from cnc.planner.limits import Limits
from cnc.planner.plan import PlanChunk

TOLERANCE = 1e-3
"""Relative; a value may exceed its limit by this, because of sampling and rounding."""

POSITION = 1e-12
"""mm; the accuracy of the arc lengths of the path, and so of a position at an instant."""


def values_allowed(limits: Limits) -> NDArray[np.float64]:
    """Return the limits in the order of the largest values: along the path, then of each axis."""
    along = np.full(ENTRIES, inf)
    along[ACCEL], along[JERK], along[OVERSPEED] = (
        limits.tangential_acceleration,
        limits.tangential_jerk,
        1.0,
    )
    along[NORMAL_ACCEL], along[CHORD_ERROR], along[STEP_DEVIATION] = (
        limits.normal_acceleration,
        limits.chord_error,
        limits.step_deviation,
    )
    return np.concatenate((along, limits.axis_velocity, limits.axis_acceleration, limits.axis_jerk))


def largest_values(values: NDArray[np.float64]) -> Largest:
    """Return views of the values in that order, as kernels take them."""
    return Largest(values[:ENTRIES], *values[ENTRIES:].reshape(3, -1))


class Audit:
    """Checks plans in the order in which they run, and keeps the largest values.

    Attributes:
        limits: of the machine.
        violations: number of plans that broke each limit, by its name; empty for a legal run.
    """

    def __init__(self, limits: Limits, *, judges: bool = True) -> None:
        """Create an audit; with ``judges`` a plan that breaks a limit is a fault."""
        self.limits = limits
        self._judges = judges
        n = len(limits.axis_velocity)
        self.violations: dict[str, int] = {}
        self._limits = values_allowed(limits)
        # The error of a difference of order k of positions is up to 2^k times POSITION.
        order = np.arange(1, 4)
        self._unsure = np.concatenate(
            (np.zeros(ENTRIES), np.repeat(2.0**order * POSITION / limits.period**order, n))
        )
        # The maxima of all plans, and those of the legal ones, with which the next plan starts.
        self._largest = np.zeros(len(self._limits))
        self._legal = np.zeros(len(self._limits))
        self._steep = np.zeros(len(self._limits))
        self._index = 0
        self._kept = 0
        self._last = np.zeros((5, n))

    @property
    def axis_velocity(self) -> NDArray[np.float64]:
        """Largest speed of each axis (axes,), mm/s."""
        return self._axes[0]

    @property
    def axis_acceleration(self) -> NDArray[np.float64]:
        """Largest acceleration of each axis (axes,), mm/s^2."""
        return self._axes[1]

    @property
    def axis_jerk(self) -> NDArray[np.float64]:
        """Largest jerk of each axis (axes,), mm/s^3."""
        return self._axes[2]

    @property
    def _axes(self) -> tuple[NDArray[np.float64], ...]:
        return tuple(self._largest[ENTRIES:].reshape(3, -1))

    @property
    def feed(self) -> float:
        """Largest speed, mm/s."""
        return float(self._largest[FEED])

    @property
    def accel(self) -> float:
        """Largest tangential acceleration, mm/s^2."""
        return float(self._largest[ACCEL])

    @property
    def jerk(self) -> float:
        """Largest tangential jerk, mm/s^3."""
        return float(self._largest[JERK])

    @property
    def normal_accel(self) -> float:
        """Largest normal acceleration, mm/s^2."""
        return float(self._largest[NORMAL_ACCEL])

    @property
    def chord_error(self) -> float:
        """Largest distance of the path from the chord of one period, mm."""
        return float(self._largest[CHORD_ERROR])

    @property
    def step_deviation(self) -> float:
        """Largest relative difference of a period's chord from its arc."""
        return float(self._largest[STEP_DEVIATION])

    @property
    def judges(self) -> bool:
        """Whether a plan that breaks a limit is a fault."""
        return self._judges

    def shares(self, axes: Sequence[str]) -> dict[str, float]:
        """Return the largest values as parts of the limits, less their errors, by their names."""
        sure = (self._largest - self._unsure - self._steep) / self._limits
        return {name: float(part) for name, part in zip(_names(axes), sure, strict=True) if name}

    def jump(self) -> None:
        """Note that the next plan begins at rest at another place: a probe made contact there."""
        self._kept = 0

    def leave_out(self, chunk: PlanChunk) -> None:
        """Go on behind a plan that is not to be carried out; no difference reaches across it."""
        self._index = ceil((chunk.t0 + chunk.duration) / self.limits.period)
        self._kept = 0

    def check(self, chunk: PlanChunk) -> None:
        """Check one plan.

        Raises:
            MotionLimitError: ``plan-illegal`` if it breaks a limit and this audit judges.
        """
        broken, _ = self.examined(chunk)
        if broken:
            raise self.refusal(chunk, broken)

    def examined(self, chunk: PlanChunk) -> tuple[list[tuple[str, str]], Audit]:
        """Check one plan. A plan that breaks a limit leaves the audit as it was.

        Returns:
            Name and description of each limit that it breaks, none if the audit does not judge; and
            the audit as it was before the plan.
        """
        before = self.copy()
        broken = self._continuity(chunk) + self._values(chunk)
        if not self._judges:
            return [], before
        if broken:
            self.adopt(before)
        return broken, before

    def refusal(self, chunk: PlanChunk, broken: list[tuple[str, str]]) -> MotionLimitError:
        """Count the violations of a plan, and return the error that reports them."""
        for name, _ in broken:
            self.violations[name] = self.violations.get(name, 0) + 1
        first, last = int(chunk.path.line[0]), int(chunk.path.line[-1])
        return MotionLimitError(
            Diagnostic(
                "plan-illegal",
                f"the planned motion of lines {first} to {last} breaks a limit: "
                + "; ".join(text for _, text in broken),
                chunk.path.file,
                first,
                hint="nothing of it was sent to the board; "
                "please report the program and the machine file",
            )
        )

    def copy(self) -> Audit:
        """Return an audit that goes on independently from the same state."""
        other = copy(self)
        other.violations = dict(self.violations)
        other._last = self._last.copy()
        return other

    def adopt(self, other: Audit) -> None:
        """Go on from the state of another audit of the same machine."""
        self.violations = dict(other.violations)
        self._largest, self._legal, self._steep = other._largest, other._legal, other._steep
        self._index, self._kept, self._last = other._index, other._kept, other._last.copy()

    def _continuity(self, chunk: PlanChunk) -> list[tuple[str, str]]:
        """Compare the end of each phase with the start of the next."""
        path, gaps = chunk.path, np.full(GAPS, -inf)
        continuity(Pieces(path.kind, path.at, path.data), chunk.arrays, gaps)
        highest = max(self.limits.max_feed, float(chunk.phase_v.max()))
        strongest = max(1.0, float(chunk.phase_a.max()), -float(chunk.phase_a.min()))
        end = float(chunk.phase_s[-1])
        allowed = (1e-9 + 1e-12 * end, 1e-9 * highest, 1e-6 * strongest, 0.0, 1e-9)
        names = ("position", "speed", "acceleration", "time", "standing still")
        return [
            ("continuity", f"{name} jumps by {gap:g}")
            for name, gap, most in zip(names, gaps.tolist(), allowed, strict=True)
            if not gap <= most
        ]

    def _steepness(self, chunk: PlanChunk) -> NDArray[np.float64]:
        """Return the error of differences of axes that move much farther than the path is long.

        A rotary axis may turn by many degrees on a micrometre of path. The rounding error of the
        arc length is then one of degrees, by the ratio of both.
        """
        n, period = len(self._last[0]), self.limits.period
        at = chunk.path.at[:, None] + START + np.arange(n)
        moved = np.abs(chunk.path.data[at + n] - chunk.path.data[at])
        # A curve may be steeper in its middle than on the whole.
        ratio = 2.0 * (moved / chunk.path.length[:, None]).max(axis=0)
        error = np.where(ratio > 2.0, ratio, 0.0) * np.spacing(np.abs(chunk.phase_s).max())
        order = np.arange(1, 4)[:, None]
        axes = (2.0**order * error / period**order).reshape(-1)
        return np.concatenate((np.zeros(ENTRIES), axes))

    def _values(self, chunk: PlanChunk) -> list[tuple[str, str]]:
        """Raise the maxima to those of the plan, and compare them with the limits."""
        limits, path, plan = self.limits, chunk.path, chunk.arrays
        pieces = Pieces(path.kind, path.at, path.data)
        values = self._legal.copy()
        largest = largest_values(values)
        audit_phases(pieces, plan, limits.feeds(path), limits.period, largest)
        # Before this plan the machine rests at its start: three instants are as good as more.
        standing = ceil(chunk.t0 / limits.period) - 3
        if standing > self._index:
            self._index, self._kept = standing, 0
        self._index, self._kept = audit_samples(
            pieces,
            plan,
            chunk.t0,
            limits.period,
            limits.chord_error,
            self._index,
            self._kept,
            self._last,
            largest,
        )
        self._largest = np.maximum(self._largest, values)
        sure = values - self._unsure
        broken = ~(sure <= self._limits * (1.0 + TOLERANCE))
        if broken.any():
            # The largest values stay, and so does their error.
            self._steep = np.maximum(self._steep, self._steepness(chunk))
            sure = sure - self._steep
            broken = ~(sure <= self._limits * (1.0 + TOLERANCE))
        if not broken.any():
            self._legal = values
            return []
        names = _names(path.axes)
        return [
            (names[k], f"{names[k]} reaches {sure[k]:g}, the limit is {self._limits[k]:g}")
            for k in np.flatnonzero(broken).tolist()
        ]


def _names(axes: Sequence[str]) -> list[str]:
    """Return the names of the largest values; empty for one without a limit."""
    names = ["", "accel", "jerk", "normal_accel", "chord_error", "step_deviation", "feed"]
    return names + [
        f"{name}_{axis}" for name in ("velocity", "acceleration", "jerk") for axis in axes
    ]
