"""The planner's figures: motions with their best known legal time, and the time that ours may take.

``best`` are feasible motions found by a nonlinear optimum on a fine grid with exact constant-jerk
intervals, or theory where it has a formula. Lengths mm, times s. Programs start at machine zero, so
nothing but the motion itself is timed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Axis, Board, Machine, PathLimits

CHORD = 0.15
TOLERANCE = 0.01
TRIDENT = ((10, 0), (20, 20), (12, 8), (10, 20), (8, 8), (0, 20), (10, 0))
TRIDENT_KNOTS = (0, 0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1, 1)


@dataclass(frozen=True)
class Case:
    """A program for a machine, the best known time, and the longest that is accepted."""

    name: str
    machine: Machine
    program: str
    best: float
    wanted: float
    points: NDArray[np.float64]
    """The path as a polygon, for planners without curves."""


def machine(
    accel: float = 2400.0,
    jerk: float = 48000.0,
    normal: float = 4903.3,
    *,
    per_axis: bool = False,
    feed: float = 300.0,
    period: float = 1e-3,
) -> Machine:
    """Return a machine with limits along the path, or with limits of each axis only."""
    axis = Axis(
        steps_per_mm=100.0,
        max_velocity=1000.0,
        max_acceleration=accel if per_axis else None,
        max_jerk=jerk if per_axis else None,
    )
    path = PathLimits(
        max_feed=feed,
        max_tangential_acceleration=None if per_axis else accel,
        max_normal_acceleration=None if per_axis else normal,
        max_jerk=None if per_axis else jerk,
        chord_error=0.001,
        tolerance=TOLERANCE,
        period=period,
    )
    return Machine(
        axes={"x": axis, "y": axis, "z": axis}, path=path, board=Board(max_step_rate=1e6)
    )


def with_period(case: Machine, period: float) -> Machine:
    """Return the same machine with another period and the same chord error."""
    return case.model_copy(update={"path": case.path.model_copy(update={"period": period})})


def chain(
    points: NDArray[np.float64], feed: float, mode: str = f"G64 P{TOLERANCE:g}", digits: int = 4
) -> str:
    """Return straight moves from the first of the points through all others."""
    moves = (
        " ".join(f"{letter}{value:.{digits}f}" for letter, value in zip("XYZ", point, strict=False))
        for point in points[1:].tolist()
    )
    return "\n".join(
        ("G21 G90 G94 G17", mode, f"F{60 * feed:g}", *("G1 " + move for move in moves), "M2", "")
    )


def circle(radius: float, feed: float) -> str:
    """Return a full circle from the machine's zero."""
    return f"G21 G90 G94 G17\nG61\nG2 X0 Y0 I{radius:g} J0 F{60 * feed:g}\nM2\n"


def ring(radius: float, chord: float) -> NDArray[np.float64]:
    """Return the same circle as a polygon of equal chords."""
    angle = np.linspace(0.0, 2 * math.pi, round(2 * math.pi * radius / chord) + 1)
    return np.stack((radius - radius * np.cos(angle), radius * np.sin(angle)), axis=1)


def trident() -> str:
    """Return the symmetric trident of Hui, Wei and Gao (2013) with its first point at zero."""
    rows = [
        f"U{knot:g} X{x - 10:g} Y{y:g} W1"
        for knot, (x, y) in zip(TRIDENT_KNOTS, TRIDENT, strict=False)
    ]
    rest = [f"U{knot:g}" for knot in TRIDENT_KNOTS[len(TRIDENT) :]]
    return "\n".join(
        ("G21 G90 G94 G17", "G61", f"G06.2 K3 {rows[0]} F18000", *rows[1:], *rest, "M2", "")
    )


def trident_points(count: int = 2000) -> NDArray[np.float64]:
    """Return points along the trident, by de Boor's recurrence."""

    def basis(i: int, degree: int, u: NDArray[np.float64]) -> NDArray[np.float64]:
        knots = TRIDENT_KNOTS
        if degree == 0:
            last = knots[i + 1] == 1 and knots[i] < 1
            return np.asarray((u >= knots[i]) & ((u < knots[i + 1]) | (last & (u == 1.0))), float)
        left, right = knots[i + degree] - knots[i], knots[i + degree + 1] - knots[i + 1]
        rise = (u - knots[i]) / left * basis(i, degree - 1, u) if left else np.zeros_like(u)
        fall = (
            (knots[i + degree + 1] - u) / right * basis(i + 1, degree - 1, u)
            if right
            else np.zeros_like(u)
        )
        return rise + fall

    u = np.linspace(0.0, 1.0, count + 1)
    return sum(
        (np.outer(basis(i, 3, u), (x - 10.0, y)) for i, (x, y) in enumerate(TRIDENT)),
        np.zeros((count + 1, 2)),
    )


def straight(piece: float, length: float = 100.0) -> NDArray[np.float64]:
    """Return a straight line cut into pieces."""
    points = np.zeros((math.ceil(length / piece - 1e-9) + 1, 2))
    points[:, 0] = np.minimum(np.arange(len(points)) * piece, length)
    return points


def finishing(moves: int = 4000, length: float = 630.0) -> NDArray[np.float64]:
    """Return a finishing pass over a wavy surface: rows joined by half circles.

    The moves have equal length; their ends are rounded to four digits.
    """
    radius, row = 1.5, 40.0
    rows = 20
    x, y = [], []
    along, bow = (
        np.linspace(0.0, row, 4000, endpoint=False),
        np.linspace(0.0, math.pi, 400, endpoint=False),
    )
    for k in range(rows):
        forth = k % 2 == 0
        x += [
            along if forth else row - along,
            row + radius * np.sin(bow) if forth else -radius * np.sin(bow),
        ]
        y += [np.full(len(along), 2 * radius * k), 2 * radius * k + radius * (1 - np.cos(bow))]
    flat = np.stack((np.concatenate(x), np.concatenate(y)), axis=1)
    height = 1.5 * np.sin(flat[:, 0] / 5.0) * np.cos(flat[:, 1] / 6.0)
    path = np.column_stack((flat, height))
    s = np.concatenate(([0.0], np.cumsum(np.sqrt((np.diff(path, axis=0) ** 2).sum(axis=1)))))
    wanted = np.linspace(0.0, length, moves + 1)
    return np.round(np.stack([np.interp(wanted, s, column) for column in path.T], axis=1), 4)


def cases() -> Iterator[Case]:
    """Yield the cases of the table."""
    line = straight(100.0)
    ten, curve = ring(10.0, 0.05), trident_points()
    yield Case("line 100 mm", machine(), chain(line, 300.0, "G61"), 0.50833, 0.5084, line)
    yield Case(
        "circle R10, aN 2400", machine(normal=2400.0), circle(10.0, 300.0), 0.5201, 0.531, ten
    )
    yield Case("circle R10, aN 4903", machine(), circle(10.0, 300.0), 0.4260, 0.435, ten)
    yield Case(
        "circle R10, per axis", machine(per_axis=True), circle(10.0, 300.0), 0.5293, 0.556, ten
    )
    yield Case("trident", machine(), trident(), 0.7090, 0.723, curve)
    yield Case("trident, per axis", machine(per_axis=True), trident(), 0.7264, 0.763, curve)

    def short(*, per_axis: bool = False) -> Machine:
        return machine(1000.0, 50_000.0, 1000.0, per_axis=per_axis)

    # v / A + A / J longer than at constant speed.
    uncut = 100.0 / 50.0 + 50.0 / 1000.0 + 1000.0 / 50_000.0
    for piece in (5.0, 1.0, 0.15, 0.05):
        points = straight(piece)
        yield Case(
            f"line in pieces of {piece:g}",
            short(),
            chain(points, 50.0),
            uncut,
            1.005 * uncut,
            points,
        )
    big, pass_ = ring(50.0, CHORD), finishing()
    for name, points, margin in (
        ("circle R50 in chords", big, 1.02),
        ("finishing, 4000 moves", pass_, 1.03),
    ):
        length = float(np.sqrt((np.diff(points, axis=0) ** 2).sum(axis=1)).sum())
        for per_axis in (False, True):
            title = name + (", per axis" if per_axis else "")
            yield Case(
                title,
                short(per_axis=per_axis),
                chain(points, 25.0),
                length / 25.0,
                margin * length / 25.0,
                points,
            )
    corner = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])
    for per_axis in (True, False):
        title = "corner of 90 degrees" + (", per axis" if per_axis else "")
        yield Case(title, machine(per_axis=per_axis), chain(corner, 300.0), 0.376, 0.357, corner)
