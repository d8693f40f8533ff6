"""The picture as PNG or SVG, drawn by matplotlib: the first view of the HTML page.

matplotlib belongs to the extra ``view``, so this module is imported when a picture is drawn.
"""

from __future__ import annotations

import io
import itertools
import math
import warnings
from typing import Any, Literal

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cnc.machine.models import Machine
from cnc.report.result import UNITS, Report
from cnc.view.collect import DRAWN_AXES, Picture, Sizes, stock_box, travel_box
from cnc.view.tables import Curves, Strokes, tolerance_shown

Floats = NDArray[np.float64]

SIZES = Sizes(strokes=1 << 15, curves=1 << 12, origins=4)
"""Sizes of the tables of an image."""
INCHES = (11.0, 8.0)
DOTS_PER_INCH = 120
YAW, PITCH = 0.6, 0.55
"""rad. View direction of a path in space; a flat path is seen from above."""
LIGHT = (-0.48, 0.6, 0.64)
"""Direction to the light: right, up, towards the viewer."""
RAPID, TRAVEL, STOCK, INK = "#9aa3ab", "#b4bcc4", "#b08968", "#222a31"
CURVES = (
    ("feed", "feed", "#1f7a8c"),
    ("accel", "acceleration", "#3d5a80"),
    ("jerk", "jerk", "#7d5ba6"),
)
STRAIGHT = 0.9998
"""Cosine of the largest angle between strokes of one straight line."""
FAR = 2.5
"""Ratio to the greatest value. A higher limit is not drawn, because it would flatten the curve."""
BRIGHTEST = 0.78
"""Part of viridis that is used; brighter colours are invisible on white."""


def draw(picture: Picture, report: Report, kind: Literal["png", "svg"]) -> bytes:
    """Return the contents of the image file."""
    look: Any = {
        "font.size": 9,
        "axes.grid": True,
        "grid.alpha": 0.3,
        "lines.linewidth": 1.0,
        "svg.hashsalt": "cnc",
        "text.color": INK,
    }
    with rc_context(look), warnings.catch_warnings():
        # The font may lack letters of the name.
        warnings.filterwarnings("ignore", message="Glyph")
        figure = Figure(figsize=INCHES, dpi=DOTS_PER_INCH, layout="constrained")
        name = "".join(letter if letter.isprintable() else "·" for letter in report.program)
        figure.suptitle(
            f"{name} · {picture.duration:.6g} s · {report.machine.name}", parse_math=False
        )
        grid = figure.add_gridspec(4, 1, height_ratios=(4.2, 1, 1, 1))
        space = figure.add_subplot(grid[0])
        turn = _path(space, picture, report.machine)
        first: Axes | None = None
        for row in range(len(CURVES)):
            axes = figure.add_subplot(grid[row + 1], sharex=first)
            first = first or axes
            _strip(axes, picture, report, row)
        accuracy = tolerance_shown(picture.strokes.tolerance)
        axes.set_xlabel(
            "time, s   (dashed: traverses; dotted: limits of the machine; "
            f"the tool at every time within {accuracy} mm of the plan)"
        )
        # The scale fits into the space that the layout leaves.
        figure.draw_without_rendering()
        if not space.axison:
            _scale(space, turn)
        out = io.BytesIO()
        figure.savefig(out, format=kind, metadata={"Date": None} if kind == "svg" else None)
        return out.getvalue()


def _strip(axes: Axes, picture: Picture, report: Report, row: int) -> None:
    """Draw feed (row 0), acceleration (1) or jerk (2) over time, with its limits."""
    key, label, colour = CURVES[row]
    _curve(axes, picture.curves, row, colour)
    limit = getattr(report.limits, key)
    if limit is not None and limit <= FAR * np.abs(axes.get_ylim()).max():
        for bound in (limit,) if row == 0 else (limit, -limit):
            axes.axhline(bound, color="0.5", linestyle=":", linewidth=1)
    axes.set_ylabel(f"{label}\n{UNITS[key]}")
    axes.tick_params(labelbottom=row == len(CURVES) - 1)
    axes.set_xlim(0.0, picture.duration or 1.0)


def _view_matrix(*, flat: bool, lathe: bool) -> Floats:
    """Return a matrix with the rows right, up and towards the viewer, in machine axes."""
    if lathe:
        return np.eye(3)[[2, 0, 1]]
    if flat:
        return np.eye(3)
    c, s, cp, sp = math.cos(YAW), math.sin(YAW), math.cos(PITCH), math.sin(PITCH)
    return np.array([[c, s, 0.0], [-s * sp, c * sp, cp], [s * cp, -c * cp, sp]])


def _path(axes: Axes, picture: Picture, machine: Machine) -> Floats:
    """Draw the path and return the matrix of the view."""
    strokes = picture.strokes
    extent = np.ptp(strokes.position, axis=0)
    flat = bool(extent[2] < 0.01 * max(float(np.linalg.norm(extent)), 1e-9))
    lathe = machine.kind == "lathe"
    turn = _view_matrix(flat=flat, lathe=lathe)
    seen = strokes.position @ turn.T
    feeding = np.flatnonzero(~strokes.rapid[:-1])
    most = float(strokes.feed[feeding].max(initial=0.0)) or 1.0
    colours: Any = ListedColormap(colormaps["viridis"](np.linspace(0.0, BRIGHTEST, 256)))
    # From back to front; strokes across the light are brighter.
    feeding = feeding[np.argsort(seen[feeding, 2] + seen[feeding + 1, 2], kind="stable")]
    along = seen[feeding + 1] - seen[feeding]
    towards = along @ np.array(LIGHT) / np.maximum(np.linalg.norm(along, axis=1), 1e-9)
    shades = colours(strokes.feed[feeding] / most)
    shades[:, :3] *= (0.7 + 0.3 * np.sqrt(np.maximum(1.0 - towards * towards, 0.0)))[:, None]
    dashed = [(line @ turn.T)[:, :2] for line in traverses(strokes)]
    axes.add_collection(
        LineCollection(dashed, colors=RAPID, linestyles=(0, (4, 3)), linewidths=1.0)
    )
    segments = np.stack((seen[feeding, :2], seen[feeding + 1, :2]), axis=1)
    axes.add_collection(
        LineCollection(list(segments), colors=shades, linewidths=1.4, capstyle="round")
    )
    stock = [np.concatenate(_edges(box)) @ turn.T for box in [stock_box(machine)] if box]
    whole = np.concatenate((seen, *stock))
    low, high = whole[:, :2].min(axis=0), whole[:, :2].max(axis=0)
    margin = 0.06 * max(float((high - low).max()), 1e-3)
    axes.update_datalim(np.stack((low - margin, high + margin)))
    axes.margins(0.0)
    axes.set_aspect("equal", adjustable="datalim")
    for box, colour in ((travel_box(machine), TRAVEL), (stock_box(machine), STOCK)):
        lines = [(turn @ edge.T).T[:, :2] for edge in _edges(box)] if box else []
        axes.add_collection(LineCollection(lines, colors=colour, linewidths=0.8), autolim=False)
    if lathe:
        axes.set_xlabel("Z, mm")
        axes.set_ylabel("X (diameter), mm")
        axes.yaxis.set_major_formatter(lambda radius, _: f"{2.0 * radius:g}")
    elif flat:
        axes.set_xlabel("X, mm")
        axes.set_ylabel("Y, mm")
    else:
        axes.set_axis_off()
    bar = axes.figure.colorbar(ScalarMappable(Normalize(0.0, most), colours), ax=axes, shrink=0.8)
    bar.set_label("feed, mm/s")
    return turn


def traverses(strokes: Strokes) -> list[Floats]:
    """Return straight traverses as (2, 3) arrays.

    Traverses over the same line are joined, because dashes over dashes would fill the gaps.
    """
    position = strokes.position
    step = np.diff(position, axis=0)
    length = np.linalg.norm(step, axis=1)
    number = np.flatnonzero(strokes.rapid[:-1] & (length > 0.0))
    if not len(number):
        return []
    direction = step[number] / length[number, None]
    bends = (np.diff(number) > 1) | ((direction[1:] * direction[:-1]).sum(axis=1) < STRAIGHT)
    first, last = number[np.append(True, bends)], number[np.append(bends, True)] + 1
    spans: dict[tuple[int, ...], list[tuple[float, float]]] = {}
    lines: dict[tuple[int, ...], tuple[Floats, Floats]] = {}
    for start, end in zip(position[first], position[last], strict=True):
        size = float(np.linalg.norm(end - start))
        if size <= strokes.tolerance:
            continue  # the drawing of a corner
        along = (end - start) / size
        along *= np.sign(along[np.argmax(np.abs(along) > 0.5 * np.abs(along).max())])
        foot = start - (start @ along) * along
        # The shift keeps round values away from the edges of cells.
        key = tuple(
            np.rint(np.concatenate((100.0 * along, 10.0 * foot)) + 0.137).astype(int).tolist()
        )
        lines.setdefault(key, (along, foot))
        spans.setdefault(key, []).append(
            (min(start @ along, end @ along), max(start @ along, end @ along))
        )
    out = []
    for key, (along, foot) in lines.items():
        low, high = (np.array(ends) for ends in zip(*sorted(spans[key]), strict=True))
        reached = np.maximum.accumulate(high)
        gaps = low[1:] > reached[:-1]
        for a, b in zip(low[np.append(True, gaps)], reached[np.append(gaps, True)], strict=True):
            out.append(np.stack((foot + a * along, foot + b * along)))
    return out


def _edges(box: list[list[float]]) -> list[Floats]:
    """Return the twelve edges of a box as (2, 3) arrays."""
    corners = np.array(list(itertools.product(*box)))
    return [
        np.stack((a, b))
        for a, b in itertools.combinations(corners, 2)
        if np.count_nonzero(a != b) == 1
    ]


def _scale(axes: Axes, turn: Floats) -> None:
    """Draw the directions of the axes and a length in the lower left corner."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    size = 0.07 * min(right - left, top - bottom)
    x, y = left + 2.0 * size, bottom + 1.5 * size
    for number, (axis, colour) in enumerate(
        zip(DRAWN_AXES, ("#c0504d", "#5a9a5a", "#4f81bd"), strict=True)
    ):
        dx, dy = size * turn[0, number], size * turn[1, number]
        axes.plot([x, x + dx], [y, y + dy], color=colour, linewidth=1.5)
        axes.text(
            x + 1.35 * dx, y + 1.35 * dy, axis.upper(), color=colour, ha="center", va="center"
        )
    length = 10.0 ** math.floor(math.log10(3.0 * size))
    axes.plot([x + 2.0 * size, x + 2.0 * size + length], [y, y], color=INK, linewidth=1.5)
    axes.text(
        x + 2.0 * size + 0.5 * length, y + 0.25 * size, f"{length:g} mm", ha="center", va="bottom"
    )


def _curve(axes: Axes, curves: Curves, row: int, colour: str) -> None:
    """Draw feed, acceleration or jerk exactly, or between its least and greatest values."""
    if curves.within:
        axes.fill_between(
            curves.t,
            np.append(curves.low[row], 0.0),
            np.append(curves.high[row], 0.0),
            step="post",
            color=colour,
            linewidth=0.6,
        )
        return
    v, a, j = curves.start
    span = np.diff(curves.t)
    part = np.linspace(0.0, 1.0, 9) if row == 0 else np.array([0.0, 1.0])
    h = part * span[:, None]
    value = (
        v[:, None] + h * (a[:, None] + 0.5 * h * j[:, None]),
        a[:, None] + h * j[:, None],
        j[:, None] + 0.0 * h,
    )[row]
    axes.plot((curves.t[:-1, None] + h).ravel(), value.ravel(), color=colour)
