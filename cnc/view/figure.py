"""The picture as PNG or SVG, drawn by matplotlib: what the page shows when it opens.

matplotlib comes with the extra ``view`` and is imported when it is needed.
"""

from __future__ import annotations

import io
import itertools
import math
import warnings
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Machine
from cnc.report.result import UNITS, Report
from cnc.view.collect import DRAWN_AXES, Picture, Sizes, stock_box, travel_box
from cnc.view.tables import Curves, Strokes, tolerance_shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

SIZES = Sizes(strokes=1 << 15, curves=1 << 12, origins=4)
"""What a picture that stands still can show."""
INCHES = (11.0, 8.0)
DOTS_PER_INCH = 120
YAW, PITCH = 0.6, 0.55
"""rad: from where a path in space is seen; that in a plane is seen from above."""
LIGHT = (-0.48, 0.6, 0.64)
"""Where the light comes from: right, up, towards the viewer."""
RAPID, TRAVEL, STOCK, INK = "#9aa3ab", "#b4bcc4", "#b08968", "#222a31"
CURVES = (
    ("feed", "feed", "#1f7a8c"),
    ("accel", "acceleration", "#3d5a80"),
    ("jerk", "jerk", "#7d5ba6"),
)
STRAIGHT = 0.9998
"""Cosine of the angle between strokes that go straight on."""
FAR = 2.5
"""Times the greatest value: a limit above that is not shown, it would only make the motion flat."""
BRIGHTEST = 0.78
"""Of viridis; what is brighter can't be seen on white."""


def draw(picture: Picture, report: Report, kind: Literal["png", "svg"]) -> bytes:
    """The file."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    look: Any = {
        "font.size": 9,
        "axes.grid": True,
        "grid.alpha": 0.3,
        "lines.linewidth": 1.0,
        "svg.hashsalt": "cnc",
        "text.color": INK,
    }
    with rc_context(look), warnings.catch_warnings():
        # A name may have letters that the font lacks: they become boxes.
        warnings.filterwarnings("ignore", message="Glyph")
        figure = Figure(figsize=INCHES, dpi=DOTS_PER_INCH, layout="constrained")
        name = "".join(letter if letter.isprintable() else "·" for letter in report.program)
        figure.suptitle(
            f"{name} · {picture.duration:.6g} s · {report.machine.name}", parse_math=False
        )
        grid = figure.add_gridspec(4, 1, height_ratios=(4.2, 1, 1, 1))
        place = figure.add_subplot(grid[0])
        turn = _path(place, picture, report.machine)
        first: Axes | None = None
        for row, (key, label, colour) in enumerate(CURVES):
            axes = figure.add_subplot(grid[row + 1], sharex=first)
            first = first or axes
            _curve(axes, picture.curves, row, colour)
            limit = getattr(report.limits, key)
            near = limit is not None and limit <= FAR * np.abs(axes.get_ylim()).max()
            for bound in () if not near else (limit,) if row == 0 else (limit, -limit):
                axes.axhline(bound, color="0.5", linestyle=":", linewidth=1)
            axes.set_ylabel(f"{label}\n{UNITS[key]}")
            axes.tick_params(labelbottom=row == 2)
            axes.set_xlim(0.0, picture.duration or 1.0)
        accuracy = f"the tool at every moment within {tolerance_shown(picture.strokes.tolerance)} mm of the plan"
        axes.set_xlabel(f"time, s   (dashed: traverses; dotted: the machine's limits; {accuracy})")
        # The scale fits itself into what the layout leaves.
        figure.draw_without_rendering()
        if not place.axison:
            _scale(place, turn)
        out = io.BytesIO()
        figure.savefig(out, format=kind, metadata={"Date": None} if kind == "svg" else None)
        return out.getvalue()


def _turn(flat: bool) -> Floats:
    """Rows: right, up and towards the viewer in the machine's axes."""
    if flat:
        return np.eye(3)
    c, s, cp, sp = math.cos(YAW), math.sin(YAW), math.cos(PITCH), math.sin(PITCH)
    return np.array([[c, s, 0.0], [-s * sp, c * sp, cp], [s * cp, -c * cp, sp]])


def _path(axes: Axes, picture: Picture, machine: Machine) -> Floats:
    """Draw the path; returns the matrix that it was seen by."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import LineCollection
    from matplotlib.colors import ListedColormap, Normalize

    strokes = picture.strokes
    extent = np.ptp(strokes.position, axis=0)
    flat = bool(extent[2] < 0.01 * max(float(np.linalg.norm(extent)), 1e-9))
    turn = _turn(flat)
    seen = strokes.position @ turn.T
    feeding = np.flatnonzero(~strokes.rapid[:-1])
    most = float(strokes.feed[feeding].max(initial=0.0)) or 1.0
    colours: Any = ListedColormap(colormaps["viridis"](np.linspace(0.0, BRIGHTEST, 256)))
    # From back to front, and those across the light brighter.
    feeding = feeding[np.argsort(seen[feeding, 2] + seen[feeding + 1, 2], kind="stable")]
    way = seen[feeding + 1] - seen[feeding]
    towards = way @ np.array(LIGHT) / np.maximum(np.linalg.norm(way, axis=1), 1e-9)
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
    room = 0.06 * max(float((high - low).max()), 1e-3)
    axes.update_datalim(np.stack((low - room, high + room)))
    axes.margins(0.0)
    axes.set_aspect("equal", adjustable="datalim")
    for box, colour in ((travel_box(machine), TRAVEL), (stock_box(machine), STOCK)):
        lines = [(turn @ edge.T).T[:, :2] for edge in _edges(box)] if box else []
        axes.add_collection(LineCollection(lines, colors=colour, linewidths=0.8), autolim=False)
    if flat:
        axes.set_xlabel("X, mm")
        axes.set_ylabel("Y, mm")
    else:
        axes.set_axis_off()
    bar = axes.figure.colorbar(ScalarMappable(Normalize(0.0, most), colours), ax=axes, shrink=0.8)
    bar.set_label("feed, mm/s")
    return turn


def traverses(strokes: Strokes) -> list[Floats]:
    """Straight traverses, (2, 3) each. Those over the same line are one: dashes over dashes would
    fill the gaps.
    """
    position = strokes.position
    step = np.diff(position, axis=0)
    length = np.linalg.norm(step, axis=1)
    number = np.flatnonzero(strokes.rapid[:-1] & (length > 0.0))
    if not len(number):
        return []
    way = step[number] / length[number, None]
    bends = (np.diff(number) > 1) | ((way[1:] * way[:-1]).sum(axis=1) < STRAIGHT)
    first, last = number[np.append(True, bends)], number[np.append(bends, True)] + 1
    spans: dict[tuple[int, ...], list[tuple[float, float]]] = {}
    lines: dict[tuple[int, ...], tuple[Floats, Floats]] = {}
    for start, end in zip(position[first], position[last], strict=True):
        size = float(np.linalg.norm(end - start))
        if size <= strokes.tolerance:
            continue  # how a corner is drawn
        along = (end - start) / size
        along *= np.sign(along[np.argmax(np.abs(along) > 0.5 * np.abs(along).max())])
        foot = start - (start @ along) * along
        # Shifted, so that round values are not on the edge of a cell.
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
    """The twelve edges of a box, (2, 3) each."""
    corners = np.array(list(itertools.product(*box)))
    return [
        np.stack((a, b))
        for a, b in itertools.combinations(corners, 2)
        if np.count_nonzero(a != b) == 1
    ]


def _scale(axes: Axes, turn: Floats) -> None:
    """In the lower left corner: the directions of the axes, and a length."""
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
    """Feed, acceleration or jerk: as it is, or between its least and greatest values."""
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
