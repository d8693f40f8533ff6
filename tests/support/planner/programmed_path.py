"""Programmed path of a blocks file, and the distance of points from it.

Arcs are computed by angles, NURBS by scipy's B-splines.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.spatial import cKDTree

from cnc.api import start_position
from cnc.machine.models import Machine

PLANES = {"XY": ("x", "y"), "ZX": ("z", "x"), "YZ": ("y", "z")}


@dataclass
class Piece:
    """A programmed move.

    ``curve`` maps u of 0..1 (n,) to points (n, axes); it is None for a straight move.
    """

    line: int
    feed: float
    tolerance: float
    start: np.ndarray
    end: np.ndarray
    curve: Callable[[np.ndarray], np.ndarray] | None = None
    corners: tuple[float, ...] = ()

    def points(self, count: int) -> np.ndarray:
        """Return points along a curve, and its possible corners."""
        u = np.unique(np.concatenate((np.linspace(0.0, 1.0, count), self.corners)))
        return np.stack((self.start, self.end)) if self.curve is None else self.curve(u)

    def distance(
        self, points: np.ndarray, enough: np.ndarray, *, everywhere: bool = False
    ) -> np.ndarray:
        """Return the distance of points from the curve.

        The nearest of many chords, even in u and along the curve, are found first; golden sections
        between their ends follow. The nearest chords are those of the nearest ends of chords,
        unless ``everywhere``. The two differ where the curve passes a point twice, once with
        shorter chords. A distance of up to ``enough`` (n,) may be that from the nearest part only,
        which is an upper bound. One that must be larger may be that from the chords.
        """
        u = np.linspace(0.0, 1.0, 4097)
        along = np.concatenate(([0.0], np.cumsum(lengths(np.diff(self.curve(u), axis=0)))))
        u = np.unique(
            np.concatenate(
                (u, np.interp(np.linspace(0.0, along[-1], 4097), along, u), self.corners)
            )
        )
        on = self.curve(u)
        if everywhere:
            chords = np.stack(
                [
                    np.argsort(
                        distances_from_segments(
                            np.broadcast_to(point, on[1:].shape), on[:-1], on[1:]
                        )
                    )[:16]
                    for point in points
                ]
            )
        else:
            _, near = cKDTree(on).query(points, k=8)
            chords = np.clip(np.concatenate((near - 1, near), axis=1), 0, len(u) - 2)
        apart = np.stack(
            [distances_from_segments(points, on[chord], on[chord + 1]) for chord in chords.T],
            axis=1,
        )
        best = apart.min(axis=1)
        # The curve is no farther from a chord than the chord's ends are apart, or little farther.
        hopeful = best <= enough + 2.0 * lengths(np.diff(on, axis=0)).max()
        best[hopeful] = math.inf
        # Most points are on the curve, where the distance from the first chord grows evenly.
        some = np.flatnonzero(hopeful)
        first = chords[some, apart[some].argmin(axis=1)]
        best[some] = self._by_secants(points[some], u[first], u[first + 1])
        for rank in range(3):
            some = np.flatnonzero(hopeful & (best > enough))
            if not len(some):
                break
            near = points[some]
            chord = chords[some, np.argsort(apart[some], axis=1)[:, rank]]
            low, high = u[chord], u[chord + 1]
            for _ in range(32):
                third = (high - low) * 0.381966
                nearer = lengths(self.curve(low + third) - near) < lengths(
                    self.curve(high - third) - near
                )
                low, high = np.where(nearer, low, low + third), np.where(nearer, high - third, high)
            best[some] = np.minimum(best[some], lengths(self.curve(0.5 * (low + high)) - near))
        return best

    def _by_secants(self, points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return distances of points from the curve near the chord from ``low`` to ``high``."""
        begin, end = self.curve(low), self.curve(high)
        along = end - begin
        u, last = low, high
        ahead, before = ((begin - points) * along).sum(axis=1), ((end - points) * along).sum(axis=1)
        best = np.full(len(points), math.inf)
        for _ in range(3):
            rise = before - ahead
            step = np.divide(ahead * (last - u), rise, out=np.zeros(len(u)), where=rise != 0.0)
            last, before, u = u, ahead, np.clip(u - step, low, high)
            off = self.curve(u) - points
            ahead = (off * along).sum(axis=1)
            best = np.minimum(best, lengths(off))
        return best


def path_columns(machine: Machine) -> list[int]:
    """Return the columns of the axes that make the path: under tool-tip control X, Y and Z."""
    names = machine.axis_names
    return [
        k
        for k, axis in enumerate(names)
        if axis in "xyz" or not machine.kinematics.with_tip_control
    ]


def programmed(blocks: list[dict], machine: Machine) -> list[Piece]:
    """Return the moves of a blocks file."""
    columns = path_columns(machine)
    axes = tuple(machine.axis_names[k] for k in columns)
    here, tolerance = np.array(start_position(machine), float)[columns], 0.0
    pieces: list[Piece] = []

    def add(
        end: np.ndarray, curve: Callable | None = None, corners: tuple[float, ...] = ()
    ) -> None:
        nonlocal here
        if curve is not None or (end != here).any():
            feed = block.get("feed")
            pieces.append(
                Piece(
                    block["line"],
                    math.inf if feed is None else feed / 60.0,
                    tolerance,
                    here,
                    end,
                    curve,
                    corners,
                )
            )
        here = end

    for block in blocks:
        match block["kind"]:
            case "path-mode":
                tolerance = (
                    (block["tolerance"] or machine.path.tolerance)
                    if block["control"] == "blend"
                    else 0.0
                )
            case "line" | "traverse" | "probe":
                add(_place(block["end"], axes))
            case "arc":
                end = _place(block["end"], axes)
                add(end, _arc(block, axes, here, end))
            case "nurbs":
                curve, corners = _nurbs(block, axes, here)
                add(curve(np.ones(1))[0], curve, corners)
    return pieces


def _place(where: dict[str, float], axes: tuple[str, ...]) -> np.ndarray:
    return np.array([where[axis] for axis in axes])


def _arc(
    block: dict, axes: tuple[str, ...], start: np.ndarray, end: np.ndarray
) -> Callable[[np.ndarray], np.ndarray]:
    plane = [axes.index(axis) for axis in PLANES[block["plane"]]]
    center = np.array([block["center"][axis] for axis in PLANES[block["plane"]]])
    out, back = start[plane] - center, end[plane] - center
    first, radii = math.atan2(out[1], out[0]), (math.hypot(*out), math.hypot(*back))

    def curve(u: np.ndarray) -> np.ndarray:
        points = start + u[:, None] * (end - start)
        angle, radius = (
            first + 2 * math.pi * block["turns"] * u,
            radii[0] + (radii[1] - radii[0]) * u,
        )
        points[:, plane[0]], points[:, plane[1]] = (
            center[0] + radius * np.cos(angle),
            center[1] + radius * np.sin(angle),
        )
        return points

    return curve


def _nurbs(
    block: dict, axes: tuple[str, ...], start: np.ndarray
) -> tuple[Callable[[np.ndarray], np.ndarray], tuple[float, ...]]:
    degree, knots, weights = block["degree"], np.array(block["knots"]), np.array(block["weights"])
    points = np.tile(start, (len(weights), 1))
    for column, axis in enumerate(block["axes"]):
        if axis not in axes:
            continue
        points[:, axes.index(axis)] = np.array(block["control_points"])[:, column]
    above, below = (
        BSpline(knots, points * weights[:, None], degree),
        BSpline(knots, weights, degree),
    )
    low, high = knots[degree], knots[-degree - 1]
    # Just before a knot of full multiplicity the curve has another limit than at it.
    inner = np.unique(knots[(knots > low) & (knots < high)])

    def curve(u: np.ndarray) -> np.ndarray:
        x = np.clip(low + u * (high - low), low, high)
        return above(x) / below(x)[:, None]

    return curve, tuple(((inner - low) / (high - low)).tolist())


def lengths(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt((vectors**2).sum(axis=1))


def distances_from_segments(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the distance of each point from its own segment a..b."""
    along = b - a
    square = (along**2).sum(axis=1)
    part = np.divide(
        ((points - a) * along).sum(axis=1), square, out=np.zeros(len(points)), where=square > 0.0
    )
    return lengths(a + np.clip(part, 0.0, 1.0)[:, None] * along - points)
