"""Experiments of Shu et al., 2019, section 4: circles by two methods.

The paper is "An Optimization Algorithm of Circular Interpolation Aiming at Point-by-Point
Comparison Method". A full circle of radius 10 on the grid is made by point-by-point comparison and
by half-step deviation. Then come every radius below 400, the moves of figure 6, and a line.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cnc.papers.kernels.half_step import circle_by_half_steps, circle_by_points, line_by_points
from cnc.papers.page import Cell, Figure, Section, Table
from cnc.path.kernels.curve import LINE
from cnc.path.records import line_records
from cnc.pulses.kernels.grid_moves import Grid, Moves, Piece
from cnc.pulses.kernels.half_step import half_step_rows

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas


# Grid points of the experiments on lines and circles.

Points: TypeAlias = NDArray[np.int64]

FARTHEST = 2**28
"""BLU: squares and products of coordinates stay within 64 bits."""


def checked_end(end: ArrayLike, axes: int | None = None) -> Points:
    """Return the end of a line from the origin as integers.

    Raises:
        ValueError: if it is no grid point in ``axes`` axes, is the origin, or is too far from it.
    """
    given = np.asarray(end)
    whole: Points = np.rint(given).astype(np.int64)
    if whole.ndim != 1 or (axes is not None and len(whole) != axes) or (whole != given).any():
        raise ValueError(f"the end must be a grid point of {axes or 'some'} integers")
    if not 0 < np.abs(whole).max(initial=0) < FARTHEST:
        raise ValueError(f"the end must lie off the origin and within {FARTHEST} BLU of it")
    return whole


def checked_radius(radius: int) -> int:
    """Return the radius; ValueError if it is not positive or too large."""
    if not 0 < radius < FARTHEST:
        raise ValueError(f"the radius must be positive and less than {FARTHEST} BLU")
    return radius


def points(first: Points, step: NDArray[np.int8]) -> Points:
    """Return the grid points (m + 1, n) along the steps (m, n), with the first."""
    return first + np.concatenate(
        (np.zeros((1, len(first)), np.int64), np.cumsum(step, axis=0, dtype=np.int64))
    )


# Half-step deviation (Shu et al. 2019) on the data of the paper: lines and circles.
#
# The line begins at the origin, and the circle is about it, both on the grid.
#
# :mod:`cnc.pulses.kernels.half_step` interpolates lines and arcs of a path anywhere, and this line,
# too.


def half_step_line(end: ArrayLike) -> Points:
    """Return the grid points (m + 1, n) from the origin to ``end`` (n,), integers.

    There is one for each step of the longest axis (equations 8 to 10).
    """
    target = checked_end(end)
    record = line_records(
        np.zeros(len(target)), target[None].astype(np.float64), np.zeros(len(target), np.int64)
    )
    rows = int(np.abs(target).max())
    moves = Moves(np.empty((rows, len(target)), np.int8), np.empty(rows))
    grid = Grid(np.ones(len(target)), np.zeros(len(target), np.int64))
    piece = Piece(LINE, record.data, 0, 0.0)
    rows, _, _ = half_step_rows(piece, 0.0, float(record.length[0]), grid, 0, moves)
    return points(np.zeros(len(target), np.int64), moves.step[:rows])


def half_step_circle(radius: int, *, clockwise: bool = False) -> Points:
    """Return the grid points (m + 1, 2) of a full turn about the origin from (radius, 0).

    Each is the nearer one of the two candidates of its octant.
    """
    step: NDArray[np.int8] = np.empty((8 * checked_radius(radius), 2), np.int8)
    rows = circle_by_half_steps(radius, -1 if clockwise else 1, step)
    return points(np.array([radius, 0]), step[:rows])


# Point-by-point comparison (Shu et al. 2019) on the data of the paper.
#
# They are a line from the origin and a circle about it. The method is the baseline of the paper.
#
# :mod:`cnc.pulses.kernels.crossings` interpolates pieces of a path, within half a BLU instead
# of one.


def point_by_point_line(end: ArrayLike) -> Points:
    """Return the grid points (m + 1, 2) from the origin to ``end`` (2,), integers.

    Each step is of one axis (equations 6 and 7).
    """
    xe, ye = checked_end(end, 2).tolist()
    step = np.empty((abs(xe) + abs(ye), 2), np.int8)
    rows = line_by_points(xe, ye, step)
    return points(np.zeros(2, np.int64), step[:rows])


def point_by_point_circle(
    radius: int, *, clockwise: bool = False, inward_on_circle: bool = True
) -> Points:
    """Return the grid points (m + 1, 2) of a full turn about the origin from (radius, 0).

    inward_on_circle: direction of the step from a point on the circle.
    """
    step = np.empty((8 * checked_radius(radius), 2), np.int8)
    rows = circle_by_points(radius, -1 if clockwise else 1, inward_on_circle, step)
    return points(np.array([radius, 0]), step[:rows])


RADIUS = 10
RADII = range(1, 400)
END = (10, 4)
LARGE = 100_000
"""Radius of the circle that is timed."""
REPEATS = 3
SIGNS = {
    (1, 0): "+X",
    (-1, 0): "-X",
    (0, 1): "+Y",
    (0, -1): "-Y",
    (1, 1): "+X+Y",
    (1, -1): "+X-Y",
    (-1, 1): "-X+Y",
    (-1, -1): "-X-Y",
}

METHODS: dict[str, Callable[[int], Points]] = {
    "point-by-point, F > 0 goes inward": lambda radius: point_by_point_circle(
        radius, inward_on_circle=False
    ),
    "point-by-point, F >= 0 goes inward": point_by_point_circle,
    "half-step": half_step_circle,
}


def off(radius: int, walked: Points) -> tuple[float, float]:
    """Return the distances of the innermost and the outermost grid point from the circle, BLU."""
    radii = np.hypot(walked[:, 0], walked[:, 1]) - radius
    return float(radii.min()), float(radii.max())


def circle_of_ten() -> Table:
    """Figures 7 and 8 in numbers."""
    published = {
        "point-by-point, F > 0 goes inward": (
            "80",
            "9.06 .. 10.77",
            "by section 4; but the largest radius is that of F >= 0",
        ),
        "point-by-point, F >= 0 goes inward": (
            "80",
            "9.06 .. 10.77",
            "by section 3.1.1; but the smallest radius is that of F > 0",
        ),
        "half-step": (
            "64",
            "9.85 .. 10.44",
            "the path with these radii has 56 steps: 30 % fewer than 80, not 20 %",
        ),
    }
    rows: list[list[Cell]] = []
    for name, circle in METHODS.items():
        walked = circle(RADIUS)
        inner, outer = off(RADIUS, walked)
        steps, radii, remark = published[name]
        rows.append(
            [
                name,
                steps,
                len(walked) - 1,
                radii,
                f"{RADIUS + inner:.3f} .. {RADIUS + outer:.3f}",
                remark,
            ]
        )
    return Table(
        "A full circle, R = 10",
        ("", "steps, published", "ours", "radii, published", "ours", "remark"),
        rows,
    )


def every_radius() -> Table:
    """Largest distances from the circle over all RADII, and steps and time on a large one."""
    rows: list[list[Cell]] = []
    for name, circle in METHODS.items():
        extremes = np.array([off(radius, circle(radius)) for radius in RADII])
        seconds = min(_seconds(circle) for _ in range(REPEATS))
        steps = len(circle(LARGE)) - 1
        bound = "0.5" if circle is half_step_circle else "1"
        rows.append(
            [
                name,
                bound,
                f"{-extremes[:, 0].min():.5f}",
                f"{extremes[:, 1].max():.5f}",
                steps,
                f"{1e9 * seconds / steps:.1f}",
            ]
        )
    return Table(
        f"Every radius from {RADII[0]} to {RADII[-1]}, and R = {LARGE}",
        (
            "",
            "largest error, published",
            "ours, inside",
            "ours, outside",
            f"steps at R = {LARGE}",
            "ns a step",
        ),
        rows,
        "Errors in pulses. Computing time of the recursion in integers and of the list of its "
        "grid points.",
    )


def _seconds(circle: Callable[[int], Points]) -> float:
    began = perf_counter()
    circle(LARGE)
    return perf_counter() - began


def octants() -> Table:
    """Figure 6 as found by walking: which moves each eighth of a circle is made of."""
    ways = [half_step_circle(1000, clockwise=clockwise) for clockwise in (False, True)]
    rows: list[list[Cell]] = []
    for octant in range(8):
        feeds = []
        for walked in ways:
            middle = 0.5 * (walked[1:] + walked[:-1])
            inside = (
                np.floor(np.arctan2(middle[:, 1], middle[:, 0]) / (0.25 * np.pi)).astype(np.int64)
                % 8
                == octant
            )
            moves, count = np.unique(np.diff(walked, axis=0)[inside], axis=0, return_counts=True)
            # where two octants meet there may be one move of the next
            feeds.append(
                ", ".join(
                    sorted(
                        SIGNS[int(x), int(y)]
                        for (x, y), often in zip(moves, count, strict=True)
                        if often > 1
                    )
                )
            )
        rows.append([f"{45 * octant} to {45 * octant + 45}", *feeds])
    return Table(
        "Figure 6. The feeds of the octants, R = 1000",
        ("degrees", "counter-clockwise", "clockwise"),
        rows,
        OCTANTS,
    )


OCTANTS = (
    "The signs in rules (1) and (2) of section 3.1.1 are garbled. Each octant has one move along "
    "an axis and one of both."
)


def lines() -> Table:
    """The line of table 1's first region, both ways."""
    rows: list[list[Cell]] = []
    for name, walked in (
        ("point-by-point", point_by_point_line(END)),
        ("half-step", half_step_line(END)),
    ):
        distance = np.abs(END[0] * walked[:, 1] - END[1] * walked[:, 0]) / np.hypot(*END)
        moves = " ".join(SIGNS[int(x), int(y)] for x, y in np.diff(walked, axis=0))
        rows.append([name, len(walked) - 1, f"{distance.max():.3f}", moves])
    return Table(
        f"A line to {END}", ("", "steps", "largest distance, pulses", "moves"), rows, LINES
    )


LINES = (
    "Table 1 of the paper, with the end of section 3 corrected: f >= 0 steps X alone, f < 0 both; "
    "it is printed the other way round there."
)


def picture(walked: Points, title: str) -> Callable[[Canvas], None]:
    """Return a drawing of the grid points, between the circles that enclose them."""

    def draw(canvas: Canvas) -> None:
        axes: Any = canvas.add_subplot(
            aspect="equal", title=title, xlabel="x, pulses", ylabel="y, pulses"
        )
        ticks = range(-RADIUS - 1, RADIUS + 2)
        axes.set(
            xticks=ticks,
            yticks=ticks,
            xlim=(-RADIUS - 1.5, RADIUS + 1.5),
            ylim=(-RADIUS - 1.5, RADIUS + 1.5),
        )
        axes.tick_params(labelsize=6)
        angle = np.linspace(0.0, 2.0 * np.pi, 361)
        inner, outer = off(RADIUS, walked)
        for radius, style in ((RADIUS + inner, ":"), (float(RADIUS), "-"), (RADIUS + outer, ":")):
            axes.plot(
                radius * np.cos(angle), radius * np.sin(angle), style, color="0.5", linewidth=0.8
            )
        axes.plot(walked[:, 0], walked[:, 1], ".-")

    return draw


def figures() -> list[Figure]:
    """Figures 7 and 8."""
    published = point_by_point_circle(RADIUS, inward_on_circle=False)
    return [
        Figure(
            "half-step-7-point-by-point",
            "Figure 7. Circular interpolation by point-by-point comparison",
            picture(published, "point-by-point, 80 steps"),
            (5.0, 5.2),
        ),
        Figure(
            "half-step-8-half-step",
            "Figure 8. Circular interpolation by half-step deviation",
            picture(half_step_circle(RADIUS), "half-step, 56 steps"),
            (5.0, 5.2),
        ),
    ]


TEXT = """\
Two methods for a circle on the grid. Point-by-point comparison moves one axis at a time, towards
the circle or along it by the sign of F = x² + y² - R². Half-step deviation moves the faster axis of
the octant alone or with the other, whichever leaves the smaller |F|, and keeps within half a pulse.
Both run as in the paper, in integers. The paper leaves the recursion on arcs to the reader."""


def section() -> Section:
    """Return the whole section."""
    tables = [circle_of_ten(), every_radius(), octants(), lines()]
    return Section(
        "Half-step deviation and point-by-point comparison (Shu et al. 2019)",
        TEXT,
        tables,
        figures(),
    )
