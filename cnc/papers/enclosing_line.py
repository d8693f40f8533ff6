"""Experiments of Samad & Wan Yusof, 2002: a circle and a polynomial by two interpolators.

The paper is "Reference pulse CNC interpolator based on enclosing line for 2D parametric curve",
Jurnal Teknologi 37(D).

A circle and a polynomial, by the enclosing line and by Kiritsis's interpolator: as printed, and as
they are made here.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cache, partial
from math import comb
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cnc.model.blocks import ArcFeed, Block, NurbsFeed
from cnc.papers.kernels.enclosing_line import enclosing_line_as_printed, kiritsis_as_printed
from cnc.papers.page import Cell, Figure, Section, Table
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.path.kernels.arclength import curve_inv_arclen
from cnc.path.kernels.curve import START, Pieces, curve_eval, curve_range
from cnc.pulses.arrays import pieces_of
from cnc.pulses.kernels.enclosing_line import monotone_rows
from cnc.pulses.kernels.grid_moves import Grid, Moves, Piece, round_to

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

Floats = NDArray[np.float64]


# Reference pulses on a bare curve by enclosing lines and by Kiritsis.
#
# There is no plan: the results are grid points and their places on the curve. The kernels are
# those that run programs (:mod:`cnc.pulses.kernels.enclosing_line`), and the paper's procedures as
# printed, for comparison.

Function = Callable[[float], ArrayLike]

ROWS = 65536
"""Most iterations at a time."""
DEGREE = 7
NODES = np.array([0.0, 1 / 3, 2 / 3, 1.0])
"""Places in a piece at which the polynomial has the position and the derivative of the curve."""
CHECKS = np.array([0.15, 0.5, 0.85])
NARROWEST = 2.0**-40
"""Part of the whole range that is not divided any more, because the derivative jumps in it."""
AXES = ("x", "y", "z", "a", "b", "c", "u", "v", "w")


class Algorithm(Enum):
    """Choice of the next grid point: nearest to the exit from the square, or shortest normal."""

    ENCLOSING_LINE = "enclosing line"
    KIRITSIS = "Kiritsis"


PRINTED = {
    Algorithm.ENCLOSING_LINE: enclosing_line_as_printed,
    Algorithm.KIRITSIS: kiritsis_as_printed,
}


@dataclass(frozen=True, slots=True)
class Steps:
    """One row for each iteration.

    Attributes:
        step: (m, n): -1, 0 or 1 for each axis.
        u: (m,): parameter of the curve.
        grid: (m + 1, n): grid points, with the first.
        error_blu: largest distance of a grid point from r(u), in any axis, or straight where the
            procedure is as printed.
        seconds: computing time.
    """

    step: NDArray[np.int8]
    u: Floats
    grid: NDArray[np.int64]
    error_blu: float
    seconds: float

    @property
    def null(self) -> int:
        """Number of iterations in which no axis steps."""
        return int((self.step == 0).all(axis=1).sum())


def interpolate(
    curve: PathChunk, steps_per_mm: ArrayLike, algorithm: Algorithm = Algorithm.ENCLOSING_LINE
) -> Steps:
    """Return the grid points of a curve, from its rounded start to its rounded end.

    Each is within half a BLU of the curve in every axis.
    """
    pieces, grid = _arrays(curve, steps_per_mm)
    first = grid.point.copy()
    moves = Moves(np.empty((ROWS, len(first)), dtype=np.int8), np.empty(ROWS))
    steps = [moves.step[:0].copy()]
    places = [moves.s[:0].copy()]
    error = seconds = 0.0
    by_normal = algorithm is Algorithm.KIRITSIS
    for kind, at in zip(pieces.kind.tolist(), pieces.at.tolist(), strict=True):
        piece = Piece(kind, pieces.data, at, 0.0)
        u, u1 = curve_range(kind, pieces.data, at)
        width = 0.0
        while u < u1:
            begin = perf_counter()
            rows, u, off, width = monotone_rows(by_normal, piece, u, u1, width, grid, 0, moves)
            seconds += perf_counter() - begin
            steps.append(moves.step[:rows].copy())
            reached = [curve_inv_arclen(kind, pieces.data, at, s) for s in moves.s[:rows].tolist()]
            places.append(np.array(reached))
            error = max(error, float(off))
    here = np.empty((4, len(first)))
    rows, _, off, _ = round_to(piece, u1, u1, grid, here, error, 0, moves)
    steps.append(moves.step[:rows].copy())
    places.append(np.full(rows, u1))
    return _steps(np.concatenate(steps), np.concatenate(places), first, float(off), seconds)


def as_printed(
    curve: PathChunk, steps_per_mm: ArrayLike, algorithm: Algorithm = Algorithm.ENCLOSING_LINE
) -> Steps:
    """Carry out the printed procedure on a curve of one piece in two axes.

    Only signs are corrected. It stops before it would pass the end.
    """
    if len(curve) != 1 or len(curve.axes) != 2:
        raise ValueError("the printed procedures take one smooth curve in two axes")
    kernel = PRINTED[algorithm]
    pieces, grid = _arrays(curve, steps_per_mm)
    first = grid.point.copy()
    most = 4 * int(np.ceil(float(curve.length[0]) * grid.scale.max())) + 16
    moves = Moves(np.empty((most, 2), dtype=np.int8), np.empty(most))
    begin = perf_counter()
    rows, error = kernel(int(pieces.kind[0]), pieces.data, int(pieces.at[0]), grid, moves)
    seconds = perf_counter() - begin
    return _steps(moves.step[:rows], moves.s[:rows], first, float(error), seconds)


def fitted(
    position: Function, derivative: Function, u0: float, u1: float, accuracy: float = 1e-9
) -> PathChunk:
    """Return a curve r(u), given as position (mm) and derivative by u, as pieces of path.

    Each piece is the polynomial of degree 7 with r and r' at four places (Hermite). It is halved
    until three places between agree to ``accuracy`` mm.
    """
    breaks = [u0]
    points = [np.asarray(position(u0), dtype=np.float64)[None]]
    waiting = [(u0, u1)]
    while waiting:
        a, b = waiting.pop()
        width = b - a
        values = np.array([position(u) for u in a + width * NODES])
        control = FROM_NODES @ np.concatenate(
            (values, width * np.array([derivative(u) for u in a + width * NODES]))
        )
        control[0], control[-1] = values[0], values[-1]
        off = np.abs(
            _bernstein(CHECKS) @ control - np.array([position(u) for u in a + width * CHECKS])
        ).max()
        if off > accuracy and width > NARROWEST * (u1 - u0):
            middle = 0.5 * (a + b)
            waiting += [(middle, b), (a, middle)]
        else:
            breaks.append(b)
            points.append(control[1:])
    knots = np.concatenate(([u0], np.repeat(breaks, DEGREE), [u1]))
    control = np.concatenate(points)
    block = NurbsFeed("", 1, DEGREE, knots, control, np.ones(len(control)), 1.0)
    chunks = [
        item
        for item in build([block], axes=AXES[: control.shape[1]], start=control[0])
        if isinstance(item, PathChunk)
    ]
    if len(chunks) != 1:
        raise ValueError(
            "the curve has no length"
            if not chunks
            else f"the curve needs {len(breaks) - 1} pieces: is it smooth?"
        )
    return chunks[0]


def _bernstein(t: Floats, degree: int = DEGREE) -> Floats:
    """Return the Bernstein polynomials at t (k,): (k, degree + 1)."""
    i = np.arange(degree + 1)
    choose = np.array([comb(degree, k) for k in i.tolist()], dtype=np.float64)
    return np.asarray(choose * t[:, None] ** i * (1.0 - t[:, None]) ** (degree - i))


def _bernstein_slopes(t: Floats) -> Floats:
    """Return their derivatives (The NURBS Book, equation 1.9)."""
    lower = _bernstein(t, DEGREE - 1)
    return DEGREE * (np.pad(lower, ((0, 0), (1, 0))) - np.pad(lower, ((0, 0), (0, 1))))


FROM_NODES = np.linalg.inv(np.concatenate((_bernstein(NODES), _bernstein_slopes(NODES))))
"""Matrix from values and derivatives by t at NODES to Bernstein coefficients."""


def _arrays(curve: PathChunk, steps_per_mm: ArrayLike) -> tuple[Pieces, Grid]:
    """Return the pieces of a curve, and the grid with the rounded start as its point."""
    pieces = pieces_of(curve)
    scale = np.array(np.broadcast_to(np.asarray(steps_per_mm, dtype=np.float64), len(curve.axes)))
    start = pieces.data[pieces.at[0] + START :][: len(scale)]
    return pieces, Grid(scale, np.rint(start * scale).astype(np.int64))


def _steps(
    step: NDArray[np.int8], u: Floats, first: NDArray[np.int64], error: float, seconds: float
) -> Steps:
    grid = first + np.concatenate(
        (np.zeros((1, step.shape[1]), np.int64), np.cumsum(step, axis=0, dtype=np.int64))
    )
    return Steps(step.copy(), u.copy(), grid, error, seconds)


FINE, COARSE = 1000.0, 1.0
"""Steps per mm: BLU 0.001 mm of the tables, 1 mm of the figures."""
REPEATS = 20
"""Times are the least of so many."""
EQUATIONS = {
    Algorithm.KIRITSIS: (
        "uo - ((Xi - xo) * x1 + (Yi - yo) * y1) / ((Xi - xo) * x2 + (Yi - yo) * y2 - x1**2 - "
        "y1**2)",
        "(Xi - xi)**2 + (Yi - yi)**2",
    ),
    Algorithm.ENCLOSING_LINE: ("abs(x1) * dy - abs(y1) * dx", "(X + S) - x", "(Y + S) - y"),
}
"""Equations counted in Table 6: 2 and 3 for each neighbour; geometric factor and distances."""
OPERATORS: tuple[tuple[type[ast.operator], ...], ...] = (
    (ast.Add, ast.Sub),
    (ast.Mult, ast.Div),
    (ast.Pow,),
)
NEIGHBOURS = {Algorithm.KIRITSIS: 3, Algorithm.ENCLOSING_LINE: 1}
ORDER = (Algorithm.KIRITSIS, Algorithm.ENCLOSING_LINE)


def section() -> Section:
    """Tables 6 to 8, Figures 4 and 5, and the extensions of the algorithm."""
    circle_table = _table(
        "Table 7: the circle, BLU 0.001 mm",
        circle(),
        {Algorithm.KIRITSIS: (0.49996, 12.14), Algorithm.ENCLOSING_LINE: (0.49999, 4.13)},
    )
    polynomial_table = _table(
        "Table 8: the polynomial, BLU 0.001 mm", polynomial(),
        {Algorithm.KIRITSIS: (0.499898, 13.39), Algorithm.ENCLOSING_LINE: (0.499990, 5.20)},
    )  # fmt: skip
    return Section(
        "Reference pulses by enclosing lines (Samad & Wan Yusof, 2002)",
        "The circle (cos u, sin u), 0 <= u <= 2 pi, and the polynomial (1.22 u - u^2, 5.25 - "
        "u^2), 0 <= u <= 4, in mm; the paper calls it "
        "cubic. *As printed* is the paper's procedure with signs corrected: abs(x') and abs(y') "
        "in the geometric factor and in Table 4. "
        "*Ours* finds the place on the enclosing line by Newton's iteration, checks which line "
        "comes first, and ends on the rounded end "
        "point; it is what runs programs. Published times are those of a 500 MHz Celeron.",
        (_operations(), circle_table, polynomial_table, _further()),
        (
            Figure(
                "enclosing-line-circle",
                "Figure 4: the circle, BLU 1 mm",
                lambda canvas: _draw(canvas, circle()),
                (8.0, 4.7),
            ),
            Figure(
                "enclosing-line-polynomial",
                "Figure 5: the polynomial, BLU 1 mm",
                lambda canvas: _draw(canvas, polynomial()),
                (8.0, 4.7),
            ),
        ),
    )


@cache
def circle() -> PathChunk:
    """r(u) = (cos u, sin u)."""
    start = np.array([1.0, 0.0])
    return _path(ArcFeed("", 1, "XY", (0.0, 0.0), start, 1.0, 1.0, 1.0), start)


@cache
def polynomial() -> PathChunk:
    """r(u) = (1.22 u - u^2, 5.25 - u^2)."""
    points = np.array([[0.0, 5.25], [2.44, 5.25], [-11.12, -10.75]])
    return _path(NurbsFeed("", 1, 2, np.repeat([0.0, 4.0], 3), points, np.ones(3), 1.0), points[0])


def _operations() -> Table:
    """Table 6, counted in the equations themselves."""
    rows: list[list[Cell]] = []
    published = {Algorithm.KIRITSIS: "36, 15, 12", Algorithm.ENCLOSING_LINE: "5, 2, 0"}
    for algorithm in ORDER:
        kinds = [
            type(node.op)
            for text in EQUATIONS[algorithm]
            for node in ast.walk(ast.parse(text))
            if isinstance(node, ast.BinOp)
        ]
        counts = [
            NEIGHBOURS[algorithm] * sum(kinds.count(kind) for kind in column)
            for column in OPERATORS
        ]
        rows.append([algorithm.value, published[algorithm], ", ".join(map(str, counts))])
    return Table(
        "Table 6: additions, multiplications, squares of an iteration",
        ("interpolator", "published", "counted in the equations"),
        rows,
    )


def _table(title: str, curve: PathChunk, published: dict[Algorithm, tuple[float, float]]) -> Table:
    """Table 7 or 8."""
    rows: list[list[Cell]] = []
    times: list[float] = []
    for algorithm in ORDER:
        printed = _timed(partial(as_printed, curve, FINE, algorithm))
        ours = _timed(partial(interpolate, curve, FINE, algorithm))
        error, microseconds = published[algorithm]
        times.append(_cost(printed))
        rows.append(
            [
                algorithm.value,
                f"{error:g}",
                f"{printed.error_blu:.6f}",
                f"{ours.error_blu:.6f}",
                f"{microseconds:g}",
                f"{_cost(printed):.4f}",
                f"{_cost(ours):.4f}",
                len(printed.step),
                len(ours.step),
            ]
        )
    ratio = published[ORDER[0]][1] / published[ORDER[1]][1]
    rows.append(
        [
            "Kiritsis / enclosing line",
            "",
            "",
            "",
            f"{ratio:.2f}",
            f"{times[0] / times[1]:.2f}",
            "",
            "",
            "",
        ]
    )
    columns = (
        "interpolator",
        "error, BLU: published",
        "as printed",
        "ours",
        "us an iteration: published",
        "as printed, here",
        "ours",
        "iterations, as printed",
        "ours",
    )
    note = (
        "Kiritsis's largest error is published nearer to half a BLU than it comes out here; the "
        "paper does not say how it was measured. Ours "
        "evaluates a polynomial that stands for some 150 steps of the curve, which helps "
        "Kiritsis's most, with three times the evaluations."
    )
    return Table(title, columns, rows, note)


def _further() -> Table:
    """Return results beyond the paper: a coarse BLU, cusps, turns inside the square, space."""
    curves: dict[str, tuple[PathChunk, Sequence[float]]] = {
        "circle, BLU 1 mm": (circle(), (COARSE, COARSE)),
        "polynomial, BLU 1 mm": (polynomial(), (COARSE, COARSE)),
        "polynomial, BLU 0.01 mm in x, 0.0025 mm in y": (polynomial(), (100.0, 400.0)),
        "cusp (u^2, u^3), -1 <= u <= 1, BLU 0.01 mm": (cusp(), (100.0, 100.0)),
        "trefoil in space, BLU 0.001 mm": (trefoil(), (1000.0, 1000.0, 1000.0)),
    }  # fmt: skip
    rows: list[list[Cell]] = []
    for name, (curve, scale) in curves.items():
        runs = [
            (algorithm.value, _timed(partial(interpolate, curve, scale, algorithm)))
            for algorithm in ORDER
        ]
        if len(curve) == 1 and len(scale) == 2:
            runs = [
                (f"{algorithm.value}, as printed", as_printed(curve, scale, algorithm))
                for algorithm in ORDER
            ] + runs
        for kind, steps in runs:
            miss = float(np.abs(steps.grid[-1] - _end(curve) * scale).max())
            axis_steps = int(np.abs(steps.step).sum())
            rows.append(
                [
                    name,
                    kind,
                    len(steps.step),
                    axis_steps,
                    steps.null,
                    f"{steps.error_blu:.6f}",
                    f"{miss:.3f}",
                ]
            )
    note = (
        "As printed both stop before the end, and at a coarse BLU the tangent alone leads astray: "
        "a null step and more than half a BLU on "
        "the polynomial, normals that lead elsewhere. In space the square is a box and Kiritsis "
        "has seven neighbours to try."
    )
    return Table(
        "Corrected and extended",
        (
            "curve",
            "interpolator",
            "iterations",
            "axis steps",
            "null",
            "error, BLU",
            "end missed by, BLU",
        ),
        rows,
        note,
    )


@cache
def cusp() -> PathChunk:
    """r(u) = (u^2, u^3)."""
    return fitted(lambda u: [u * u, u**3], lambda u: [2.0 * u, 3.0 * u * u], -1.0, 1.0)


@cache
def trefoil() -> PathChunk:
    """A closed curve in space, 6 mm across."""
    return fitted(
        lambda u: [np.sin(u) + 2 * np.sin(2 * u), np.cos(u) - 2 * np.cos(2 * u), -np.sin(3 * u)],
        lambda u: [
            np.cos(u) + 4 * np.cos(2 * u),
            -np.sin(u) + 4 * np.sin(2 * u),
            -3 * np.cos(3 * u),
        ],
        0.0,
        2.0 * np.pi,
    )


def _path(block: Block, start: Floats) -> PathChunk:
    (path,) = (
        item for item in build([block], axes=("x", "y"), start=start) if isinstance(item, PathChunk)
    )
    return path


def _end(curve: PathChunk) -> Floats:
    """The curve's last point."""
    n = len(curve.axes)
    return curve.data[curve.at[-1] + START + n :][:n]


def _timed(run: Callable[[], Steps]) -> Steps:
    """The fastest of some runs."""
    return min((run() for _ in range(REPEATS)), key=lambda steps: steps.seconds)


def _cost(steps: Steps) -> float:
    """Microseconds an iteration."""
    return 1e6 * steps.seconds / len(steps.step)


def _draw(canvas: Canvas, curve: PathChunk) -> None:
    """The curve at BLU 1 mm, as printed beside ours."""
    kind, at = int(curve.kind[0]), int(curve.at[0])
    u0, u1 = curve_range(kind, curve.data, at)
    here = np.empty((4, 2))
    points = []
    for u in np.linspace(u0, u1, 400).tolist():
        curve_eval(kind, curve.data, at, u, here)
        points.append(here[0].copy())
    line = np.array(points)
    plots: Any = canvas.subplots(1, 2, sharex=True, sharey=True)
    for plot, name, steps in zip(
        plots,
        ("as printed", "ours"),
        (as_printed(curve, COARSE), interpolate(curve, COARSE)),
        strict=True,
    ):
        plot.plot(line[:, 0], line[:, 1], color="0.6", label="curve")
        plot.plot(
            steps.grid[:, 0],
            steps.grid[:, 1],
            "o-",
            markersize=3.5,
            color="tab:blue",
            label="enclosing line",
        )
        plot.set_title(f"{name}: {len(steps.step)} iterations, {steps.error_blu:.3f} BLU")
        plot.set_xlabel("x, mm")
        plot.set_aspect("equal")
        plot.locator_params(integer=True)
    plots[0].set_ylabel("y, mm")
    plots[0].legend()
