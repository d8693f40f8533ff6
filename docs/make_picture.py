"""Pictures of the documentation: ``make picture``.

It draws docs/trident.svg, with path, feed, acceleration and jerk of the trident on the machine of
the paper. It takes screenshots of the pages that `cncrun view` makes of the trident and of the
finishing pass, in Chromium.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.collections import LineCollection

from cnc.api import Outputs, RunOptions, check, load_machine, parse
from cnc.model.blocks import NurbsFeed
from tests.support.paths import ROOT
from tests.support.view.browser import FOUND, INSTALL, Browser

plt.switch_backend("svg")
PAGE_SIZE = (1200, 760)
PROGRAM = ROOT / "programs" / "trident.nc"


def draw(target: Path) -> None:
    """Check the program, read its trace, and draw it."""
    machine = load_machine("paper-nurbs")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "trace.npz"
        report = check(PROGRAM, machine, RunOptions(outputs=Outputs(trace=str(file))))
        report.raise_if_faulty()
        with np.load(file) as trace:
            columns = {
                name: trace[name] for name in ("t", "position", "feed", "accel", "jerk", "line")
            }
    # The curve without the traverse before it.
    curve = next(block for block in parse(PROGRAM, machine) if isinstance(block, NurbsFeed))
    on_curve = columns["line"] == curve.line
    columns = {name: column[on_curve] for name, column in columns.items()}
    columns["t"] = columns["t"] - columns["t"][0]

    plt.rcParams.update(
        {
            "font.size": 9,
            "svg.hashsalt": "cnc",
            "axes.grid": True,
            "grid.alpha": 0.3,
            "lines.linewidth": 1.2,
        }
    )
    figure = plt.figure(figsize=(10, 4.6), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1, 1.4))

    space = figure.add_subplot(grid[:, 0], aspect="equal", title="path (mm) and feed (mm/s)")
    points = columns["position"][::2, :2]
    lines = LineCollection(
        list(np.stack([points[:-1], points[1:]], axis=1)),
        array=columns["feed"][2::2],
        cmap="viridis",
        linewidth=2.5,
    )
    space.plot(*curve.control_points[:, :2].T, "o--", color="0.6", linewidth=0.8, markersize=3)
    space.add_collection(lines)
    figure.colorbar(lines, ax=space, shrink=0.7)

    limits = report.limits
    rows = (("feed", "feed\nmm/s"), ("accel", "acceleration\nmm/s²"), ("jerk", "jerk\nmm/s³"))
    for row, (name, label) in enumerate(rows):
        limit = float(getattr(limits, name))
        axes = figure.add_subplot(grid[row, 1])
        axes.plot(
            columns["t"],
            columns[name],
            color=f"C{row}",
            drawstyle="steps-post" if name == "jerk" else "default",
        )
        for bound in (limit,) if name == "feed" else (limit, -limit):
            axes.axhline(bound, color="0.4", linestyle=":", linewidth=1)
        axes.set_ylabel(label)
        axes.set_xlim(0, columns["t"][-1])
    axes.set_xlabel("time, s (dotted: limits of the machine)")
    figure.savefig(target, metadata={"Date": None})


def take_screenshot(program: str, machine: str, target: Path, *, dark: bool, then: str) -> None:
    """Take a screenshot of the page of a program.

    Args:
        program: the program.
        machine: the machine.
        target: the image file.
        dark: whether the colour scheme is dark.
        then: JavaScript to run in the page before, with the model ``m``.
    """
    with tempfile.TemporaryDirectory() as folder, Browser(*PAGE_SIZE) as browser:
        page = Path(folder) / "page.html"
        check(program, machine, RunOptions(outputs=Outputs(picture=str(page)))).raise_if_faulty()
        width, height = PAGE_SIZE
        browser.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        browser.dark(dark)
        browser.open(page)
        browser.evaluate(f"opened.then(m => {{ {then}; m.draw(); }})")
        browser.screenshot(target)


if __name__ == "__main__":
    if FOUND is None:
        sys.exit(f"chromium is not installed: {INSTALL}")
    os.chdir(ROOT)
    take_screenshot(
        "programs/trident.nc",
        "paper-nurbs",
        ROOT / "docs" / "view-trident.png",
        dark=True,
        then="m.press({channel: 1})",
    )
    take_screenshot(
        "programs/finishing.nc",
        "default",
        ROOT / "docs" / "view-finishing.png",
        dark=False,
        then="m.chooseTime(40)",
    )
    draw(ROOT / "docs" / "trident.svg")
