"""Check of the legality of a motion from output files, without the planner's mathematics.

The blocks file has the programmed path, the trace the position at every period, and the pulse file
the time of the last step. Velocity, acceleration and jerk are differences of the positions. The
distance from the path is that from lines, arcs and NURBS (scipy's B-splines). A difference of order
n is a weighted mean of the n-th derivative over n periods, so a motion that keeps a limit shows no
larger one for any period.

A finer trace needs a machine with a shorter period. Some limits depend on it (the chord error, the
speed at a joint), so the motion for it is another one.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from cnc.api import Outputs, RunOptions, check
from cnc.machine.models import Machine
from tests.support.planner.programmed_path import (
    Piece,
    distances_from_segments,
    lengths,
    path_columns,
    programmed,
)
from tests.support.planner.trace_rows import (
    ALLOWED,
    NEVER,
    Override,
    feed_in_force,
    pieces_of_rows,
    range_max,
    time_to_let_go,
)

APART = 1e-6
"""mm; a point may be this much farther from the path than the tolerance."""
NOISE = 1e-12
"""mm; error of a position, from the accuracy of the arc length and from rounding."""


@dataclass
class Findings:
    """Findings of a check: each largest value as a part of its limit, and the errors."""

    duration: float = 0.0
    ratios: dict[str, float] = field(default_factory=dict)
    apart: float = 0.0
    wrong: list[str] = field(default_factory=list)
    refused: str = ""
    moved: bool = False

    @property
    def largest(self) -> tuple[str, float]:
        """The limit that is used most, and the part of it."""
        return max(self.ratios.items(), key=lambda item: item[1], default=("nothing", 0.0))


def examine(
    text: str, machine: Machine, folder: Path, *, compared_with: Machine | None = None
) -> Findings:
    """Check a program with a machine, and the files that this writes to ``folder``.

    They are compared with the limits of the machine, or of ``compared_with``.
    """
    program, blocks, trace, pulses = (
        folder / name for name in ("program.nc", "blocks.jsonl", "trace.npz", "pulses.npz")
    )
    program.write_text(text)
    report = check(
        program,
        machine,
        RunOptions(outputs=Outputs(blocks=str(blocks), trace=str(trace), pulses=str(pulses))),
    )
    if not report.ok:
        return Findings(
            refused=report.faults[0].diagnostic.code,
            wrong=[str(fault.diagnostic.message) for fault in report.faults],
        )
    return compare_files(blocks, trace, pulses, compared_with or machine, report.duration_s)


def compare_files(
    blocks: Path,
    trace: Path,
    pulses: Path,
    machine: Machine,
    duration: float,
    override: Override = NEVER,
) -> Findings:
    """Compare the files of a check or a run with the limits of a machine.

    Args:
        blocks: the blocks file.
        trace: the trace.
        pulses: the pulse file.
        machine: its limits.
        duration: duration of the motion in the report, s.
        override: the feed override during the motion.
    """
    found = Findings(duration)
    rows = dict(np.load(trace).items())
    path = programmed([json.loads(line) for line in blocks.read_text().splitlines()], machine)
    if not all(
        np.isfinite(rows[name]).all() for name in ("t", "position", "s", "feed", "accel", "jerk")
    ):
        found.wrong.append("the trace has numbers that are not finite")
        return found
    found.moved = bool(path)
    _check_clock(rows, np.load(pulses), machine.of_joints, duration, found)
    _check_limits(rows, machine, found)
    tip = rows | {"position": rows.get("tool", rows["position"])[:, path_columns(machine)]}
    _check_along(tip, machine, found)
    if path:
        _check_path(tip, path, machine, override, found)
    for name, ratio in found.ratios.items():
        if not ratio <= 1.0 + ALLOWED:
            found.wrong.append(f"{name} is {ratio:.6g} of its limit")
    return found


def _check_clock(
    rows: dict, pulses: dict, machine: Machine, duration: float, found: Findings
) -> None:
    """Check that rows are a period apart and end with the motion, and check the last pulse.

    The last pulse is within the motion; behind it at most half a step is left. Where several axes
    end half a step from the grid, each further pulse waits for the machine's step rate.
    """
    period, t, p = machine.path.period, rows["t"], rows["position"]
    if abs(float(rows["period"]) - period) > 1e-15 or np.abs(
        t - np.arange(len(t)) * period
    ).max() > 1e-9 * max(1.0, t[-1]):
        found.wrong.append("rows are not a period apart")
    if not duration - 1e-9 <= t[-1] <= duration + period + 1e-9:
        found.wrong.append(f"the trace ends at {t[-1]:.6f} s, the motion at {duration:.6f} s")
    per_mm = machine.steps_per_mm
    grid = pulses["origin_steps"] + pulses["step"].sum(axis=0, dtype=np.int64)
    last = float(pulses["time_ns"][-1]) * 1e-9 if len(pulses["time_ns"]) else 0.0
    left = np.abs(p[min(math.ceil(last / period), len(p) - 1) :] * per_mm - grid)
    # Between two rows an axis that does not lead may be 1.5 steps away; at rest it is not.
    waiting = (len(per_mm) - 1) / machine.board.max_step_rate
    if last > duration + waiting + 2e-9 or left.max() > 1.5 + 1e-3 or left[-1].max() > 0.5 + 1e-3:
        found.wrong.append(
            f"the last pulse comes at {last:.6f} s; the motion goes on to {left.max():.4f} steps "
            f"from there and ends {left[-1].max():.4f} steps from there"
        )


def _check_limits(rows: dict, machine: Machine, found: Findings) -> None:
    """Compare differences of the positions of the joints with their limits."""
    p, s = rows["position"], rows["s"]
    noise = _noise(np.abs(p).max(initial=1.0), machine)
    # A joint that moves far on a short path has the rounding error of the arc length, magnified.
    ds = np.diff(s)
    moving = ds > 1e-9
    steep = (np.abs(np.diff(p, axis=0)[moving]) / ds[moving, None]).max(axis=0, initial=0.0)
    more = 2.0 * np.where(steep > 2.0, steep, 0.0) * np.spacing(s[-1] if len(s) else 0.0)

    for column, (letter, axis) in enumerate(machine.joint_tables.items()):
        limits = (axis.max_velocity, axis.max_acceleration, axis.max_jerk)
        for order, (name, limit) in enumerate(
            zip(("velocity", "acceleration", "jerk"), limits, strict=True), 1
        ):
            values = np.diff(p[:, column], order)
            extra = 2.0**order * float(more[column]) / machine.path.period**order
            unsure = [each + extra for each in noise]
            _note(f"{name} of {letter}", values, order, limit, unsure, machine, found)


def _noise(largest: float, machine: Machine) -> list[float]:
    """Return the error of the derivatives of order 0 to 3 of values up to ``largest``."""
    error = NOISE + 4.0 * np.spacing(largest)
    return [0.0] + [2.0**order * error / machine.path.period**order for order in (1, 2, 3)]


def _note(
    name: str,
    values: np.ndarray,
    order: int,
    limit: float | None,
    unsure: list[float],
    machine: Machine,
    found: Findings,
) -> None:
    """Note the largest of differences as a part of a limit."""
    if limit is not None:
        largest = float(np.abs(values).max(initial=0.0)) / machine.path.period**order
        found.ratios[name] = max(0.0, largest - unsure[order]) / limit


def _check_along(rows: dict, machine: Machine, found: Findings) -> None:
    """Compare the motion along and across the path with the limits."""
    p, s, path = rows["position"], rows["s"], machine.path
    if len(p) < 4:
        return
    noise, s_noise = _noise(np.abs(p).max(initial=1.0), machine), _noise(s[-1], machine)

    def note(
        name: str, values: np.ndarray, order: int, limit: float | None, unsure: list[float]
    ) -> None:
        _note(name, values, order, limit, unsure, machine, found)

    note("tangential acceleration", np.diff(s, 2), 2, path.max_tangential_acceleration, s_noise)
    note("tangential jerk", np.diff(s, 3), 3, path.max_jerk, s_noise)

    # The path length and the normal acceleration are compared with the positions. Near a stop the
    # directions before and after mix.
    step, ds = np.diff(p, axis=0), np.diff(s)
    moving = ds > _crawl(machine)
    chord = lengths(step)
    if (chord > ds * (1.0 + 1e-5) + 1e-10).any():
        found.wrong.append("steps are longer than the path length that they cover")
    both = moving[1:] & moving[:-1]
    bend, along = np.diff(step, axis=0)[both], (step[1:] + step[:-1])[both]
    length = lengths(along)
    normal = bend - along * ((bend * along).sum(axis=1) / length**2)[:, None]
    across = lengths(normal).max(initial=0.0)
    note("normal acceleration", np.array([across]), 2, path.max_normal_acceleration, noise)
    found.ratios["chord error"] = max(0.0, across / 8.0 - NOISE) / path.chord_error


def _crawl(machine: Machine) -> float:
    """Return a length of steps; a shorter one may be beside a rest between two samples, mm."""
    jerk = min(
        machine.path.max_jerk or math.inf,
        math.sqrt(sum((axis.max_jerk or math.inf) ** 2 for axis in machine.axes.values())),
    )
    return max(2.0 * jerk * machine.path.period**3, 1e-9)


def _check_path(
    rows: dict, path: list[Piece], machine: Machine, override: Override, found: Findings
) -> None:
    """Compare the trace with the programmed path, and the path with the trace."""
    p, line, ds = rows["position"], rows["line"], np.diff(rows["s"])
    first, last = pieces_of_rows(line, np.array([piece.line for piece in path]))
    tolerance = np.array([piece.tolerance for piece in path])
    straight = np.array([piece.curve is None for piece in path])
    start, end = np.array([piece.start for piece in path]), np.array([piece.end for piece in path])
    best, allowed = np.full(len(p), math.inf), np.zeros(len(p))
    by_curve: dict[int, list[np.ndarray]] = {}
    for offset in range(int((last - first).max()) + 1):
        rows_here = np.flatnonzero(first + offset <= last)
        piece = first[rows_here] + offset
        allowed[rows_here] = np.maximum(allowed[rows_here], tolerance[piece])
        on_line = straight[piece]
        a, b, q = start[piece[on_line]], end[piece[on_line]], p[rows_here[on_line]]
        best[rows_here[on_line]] = np.minimum(
            best[rows_here[on_line]], distances_from_segments(q, a, b)
        )
        order = np.argsort(piece[~on_line], kind="stable")
        curves, begins = np.unique(piece[~on_line][order], return_index=True)
        on_curve = np.split(rows_here[~on_line][order], begins[1:])
        for k, some in zip(curves.tolist(), on_curve, strict=False):
            by_curve.setdefault(k, []).append(some)
    for everywhere in (False, True):
        for k, some in by_curve.items():
            # Only for rows that are not near enough to another piece.
            wanted = np.concatenate(some)
            enough = allowed[wanted] + 0.5 * APART
            far = best[wanted] > enough
            wanted, enough = wanted[far], enough[far]
            if len(wanted):
                apart = path[k].distance(p[wanted], enough, everywhere=everywhere)
                best[wanted] = np.minimum(best[wanted], apart)
    found.apart = float((best - allowed).max())
    if found.apart > APART:
        worst = int(np.argmax(best - allowed))
        found.wrong.append(
            f"{best[worst]:.3g} mm from the path at {rows['t'][worst]:.4f} s (line {line[worst]})"
        )

    # The step between samples is compared with the path that it covers, except at corners with a
    # stop or a tolerance.
    chord = lengths(np.diff(p, axis=0))
    moving = ds > _crawl(machine)
    inside = np.zeros(len(ds), bool)
    inside[1:-1] = moving[1:-1] & moving[:-2] & moving[2:]
    inside &= (ds > machine.path.chord_error) & (allowed[1:] == 0.0) & (allowed[:-1] == 0.0)
    if machine.path.step_deviation is not None:
        found.ratios["step deviation"] = (
            float(((ds - chord)[inside] / ds[inside]).max(initial=0.0))
            / machine.path.step_deviation
        )

    # The speed is compared with the feed of any piece that the step may lie on. A traverse has
    # none: the axes limit it.
    feed = np.array([piece.feed for piece in path])
    lo, hi = np.minimum(first[:-1], first[1:]), np.maximum(last[:-1], last[1:])
    highest = range_max(feed, lo, hi)
    fed = np.isfinite(highest)
    highest = np.minimum(
        highest
        * feed_in_force(
            override,
            rows["t"][: len(p)],
            rows["s"],
            ds / machine.path.period / highest,
            time_to_let_go(machine),
        ),
        machine.path.max_feed,
    )
    noise = 2.0 * (NOISE + 4.0 * np.spacing(rows["s"][-1])) / machine.path.period
    over = (ds[fed] / machine.path.period - noise) / highest[fed]
    found.ratios["feed"] = max(0.0, float(over.max(initial=0.0)))

    if message := _missed(path, p, ds, machine.path.chord_error):
        found.wrong.append(message)
    if np.abs(p[-1] - path[-1].end).max() > 1e-9:
        found.wrong.append(
            f"the end point is missed by {np.abs(p[-1] - path[-1].end).max():.3g} mm"
        )


def _missed(path: list[Piece], p: np.ndarray, ds: np.ndarray, chord_error: float) -> str:
    """Return the error for the first piece that the samples miss; empty if there is none.

    Every programmed corner and points along every curve lie within the tolerance of the polygon of
    samples. That polygon cuts a bend by the chord error at most, and a corner with a stop by the
    steps beside it.
    """
    points = [piece.points(33) for piece in path]
    targets, which = np.concatenate(points), np.repeat(np.arange(len(path)), list(map(len, points)))
    _, near = cKDTree(p).query(targets, k=min(6, len(p)))
    apart, slack = np.full(len(targets), math.inf), np.full(len(targets), math.inf)
    for candidate in near.T:
        for a in (np.maximum(candidate - 1, 0), np.minimum(candidate, len(p) - 2)):
            apart = np.minimum(apart, distances_from_segments(targets, p[a], p[a + 1]))
            slack = np.minimum(slack, ds[a])
    tolerance = np.pad([piece.tolerance for piece in path], 1)
    reach = np.maximum(np.maximum(tolerance[:-2], tolerance[1:-1]), tolerance[2:])
    allow = reach[which] + chord_error + APART
    for far in np.flatnonzero(apart > allow + slack):
        # The nearest samples may be those of another stretch, where the motion is slower.
        apart[far] = distances_from_segments(
            np.broadcast_to(targets[far], p[1:].shape), p[:-1], p[1:]
        ).min()
    over_by = apart - (allow + slack)
    missed = np.flatnonzero(over_by > 0.0)
    if not len(missed):
        return ""
    own = np.flatnonzero(which == which[missed[0]])
    worst = own[np.argmax(over_by[own])]
    return f"the motion passes line {path[which[worst]].line} by {apart[worst]:.3g} mm"
