"""The audit: every finished plan is looked at again, by other means than it was made with, before it is handed on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import ceil

import numpy as np

from cnc.errors import Diagnostic, MotionLimitError
from cnc.kernels.audit import (
    ACCEL,
    CHORD_ERROR,
    FEED,
    JERK,
    NORMAL_ACCEL,
    OVERSPEED,
    STEP_DEVIATION,
    audit_phases,
    audit_samples,
    timed_joints,
)
from cnc.planner.limits import Limits
from cnc.planner.plan import PlanChunk

TOLERANCE = 1e-3
"""How far a value may lie above its limit, relative: what sampling and rounding can show of a legal plan."""

POSITION = 1e-12
"""mm; the accuracy of the arc lengths that the path comes with, and so of a position at an instant."""


class Audit:
    """Checks plans in the order in which they run and keeps the largest values seen.

    feed mm/s, accel mm/s^2, jerk mm/s^3 along the path; normal_accel mm/s^2; chord_error mm; step_deviation (relative); axis_velocity,
    axis_acceleration, axis_jerk (axes,). ``violations`` counts the plans that broke each limit: a legal run has none.
    """

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        n = len(limits.axis_velocity)
        self._largest = np.zeros(7)
        self.axis_velocity = np.zeros(n)
        self.axis_acceleration = np.zeros(n)
        self.axis_jerk = np.zeros(n)
        self.violations: dict[str, int] = {}
        self._index = 0
        self._known = 0
        self._last = np.zeros((5, n))

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

    def jump(self) -> None:
        """The machine stands where no plan has ended (a probe made contact): the next plan begins there, at rest."""
        self._known = 0

    def passed(self, plans: Iterable[PlanChunk]) -> Iterator[PlanChunk]:
        """Hand on each plan that is legal.

        Raises:
            MotionLimitError: ``plan-illegal``, naming the limit and the source line where the plan begins.
        """
        for chunk in plans:
            self.check(chunk)
            yield chunk

    def check(self, chunk: PlanChunk) -> None:
        """Look at one plan and raise if it breaks a limit."""
        broken = self._continuity(chunk) + self._values(chunk)
        for name, _ in broken:
            self.violations[name] = self.violations.get(name, 0) + 1
        if broken:
            first, last = int(chunk.path.line[0]), int(chunk.path.line[-1])
            raise MotionLimitError(
                Diagnostic(
                    "plan-illegal",
                    f"the planned motion of lines {first} to {last} breaks a limit: " + "; ".join(text for _, text in broken),
                    chunk.path.file,
                    first,
                    hint="nothing of it was sent to the board; please report the program and the machine file",
                )
            )

    def _continuity(self, chunk: PlanChunk) -> list[tuple[str, str]]:
        """Integrate each phase and compare its end with the start of the next: along the path, or in every axis about timed pieces."""
        dt = np.diff(chunk.phase_t)
        s, v, a, j = chunk.phase_s, chunk.phase_v, chunk.phase_a, chunk.phase_j
        s_end = s[:-1] + dt * (v[:-1] + dt * (a[:-1] / 2 + dt * j / 6))
        v_end = v[:-1] + dt * (a[:-1] + dt * j / 2)
        a_end = a[:-1] + dt * j
        speed_gap, accel_gap = np.abs(v_end - v[1:]), np.abs(a_end - a[1:])
        path = chunk.path
        touched = np.zeros(len(j) - 1, np.bool_)
        moved, faster, pushed = timed_joints(path.kind, path.at, path.data, chunk.piece_s, chunk.phase_t, s, v, a, j, touched)
        speed_gap[:-1][touched] = accel_gap[:-1][touched] = 0.0
        highest = max(self.limits.max_feed, float(v.max()))
        gaps = {
            "position": (max(np.abs(s_end - s[1:]).max(), moved), 1e-9 + 1e-12 * float(s[-1])),
            "speed": (max(speed_gap.max(), faster), 1e-9 * highest),
            "acceleration": (max(accel_gap.max(), pushed), 1e-6 * max(1.0, float(np.abs(a).max()))),
            "time": (-float(dt.min()), 0.0),
            "standing still": (-float(v.min()), 1e-9),
        }
        return [("continuity", f"{name} jumps by {gap:g}") for name, (gap, allowed) in gaps.items() if not gap <= allowed]

    def _values(self, chunk: PlanChunk) -> list[tuple[str, str]]:
        limits, path = self.limits, chunk.path
        feeds = limits.feeds(path)
        phases = (chunk.piece_s, chunk.phase_t, chunk.phase_s, chunk.phase_v, chunk.phase_a, chunk.phase_j)
        largest, axes = np.zeros(7), np.zeros((3, len(self.axis_velocity)))
        audit_phases(path.kind, path.at, path.data, feeds, *phases, limits.period, largest, axes[0], axes[1], axes[2])
        # Between the plans the machine stands where this one begins: three instants of that are as good as a long dwell.
        standing = ceil(chunk.t0 / limits.period) - 3
        if standing > self._index:
            self._index, self._known = standing, 0
        self._index, self._known = audit_samples(
            path.kind, path.at, path.data, *phases, chunk.t0, limits.period, limits.chord_error, self._index, self._known, self._last,
            largest, axes[0], axes[1], axes[2],
        )  # fmt: skip
        checks = [
            ("feed", largest[OVERSPEED], 1.0),
            ("accel", largest[ACCEL], limits.tangential_acceleration),
            ("jerk", largest[JERK], limits.tangential_jerk),
            ("normal_accel", largest[NORMAL_ACCEL], limits.normal_acceleration),
            ("chord_error", largest[CHORD_ERROR], limits.chord_error),
            ("step_deviation", largest[STEP_DEVIATION], limits.step_deviation),
        ]
        names = path.axes
        for row, (name, bounds) in enumerate(
            (("velocity", limits.axis_velocity), ("acceleration", limits.axis_acceleration), ("jerk", limits.axis_jerk))
        ):
            # A difference of order n of positions, each known to POSITION, is off by up to 2^n times that.
            unsure = 2.0 ** (row + 1) * POSITION / limits.period ** (row + 1)
            checks += [(f"{name}_{axis}", axes[row, i] - unsure, bounds[i]) for i, axis in enumerate(names)]
        self._largest = np.maximum(self._largest, largest)
        self.axis_velocity = np.maximum(self.axis_velocity, axes[0])
        self.axis_acceleration = np.maximum(self.axis_acceleration, axes[1])
        self.axis_jerk = np.maximum(self.axis_jerk, axes[2])
        return [
            (name, f"{name} reaches {value:g}, the limit is {bound:g}")
            for name, value, bound in checks
            if not value <= bound * (1.0 + TOLERANCE)
        ]
