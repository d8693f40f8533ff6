"""Draws docs/trident.svg: the trident on the machine of the paper, its path and its feed,
acceleration and jerk over time.

And photographs the pages that `cncrun view` makes of it and of the finishing pass, in Debian's
chromium.

make picture
"""

from __future__ import annotations

import io
import os
import re
import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.collections import LineCollection
from rich.console import Console

from cnc.api import Outputs, RunOptions, check, load_machine, parse
from cnc.model.blocks import NurbsFeed
from cnc.report.result import Report
from cnc.report.summary import print_summary

ROOT = Path(__file__).resolve().parent.parent
from tests.support.view.browser import FOUND, INSTALL, Browser  # noqa: E402

plt.switch_backend("svg")
PAGE_SIZE = (1200, 760)
PROGRAM = ROOT / "programs" / "trident.nc"


def draw(target: Path) -> Report:
    """Run the program dry, read its trace, draw."""
    machine = load_machine("paper-nurbs")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "trace.npz"
        report = check(PROGRAM, machine, RunOptions(outputs=Outputs(trace=str(file))))
        report.raise_if_faulty()
        with np.load(file) as trace:
            columns = {
                name: trace[name] for name in ("t", "position", "feed", "accel", "jerk", "line")
            }
    # The curve alone, without the traverse that leads to it.
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

    place = figure.add_subplot(grid[:, 0], aspect="equal", title="path (mm) and feed (mm/s)")
    points = columns["position"][::2, :2]
    lines = LineCollection(
        list(np.stack([points[:-1], points[1:]], axis=1)),
        array=columns["feed"][2::2],
        cmap="viridis",
        linewidth=2.5,
    )
    place.plot(*curve.control_points[:, :2].T, "o--", color="0.6", linewidth=0.8, markersize=3)
    place.add_collection(lines)
    figure.colorbar(lines, ax=place, shrink=0.7)

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
    axes.set_xlabel("time, s (dotted: the machine's limits)")
    figure.savefig(target, metadata={"Date": None})
    return report


def describe(report: Report, readme: Path) -> None:
    """Replace the summary behind the README's ``$ cncrun`` line."""
    report.program = str(PROGRAM.relative_to(ROOT))
    console = Console(file=io.StringIO(), width=120, highlight=False)
    with console.capture() as shown:
        print_summary(report, console)
    text = "\n".join(line.rstrip() for line in shown.get().splitlines())
    old = readme.read_text(encoding="utf-8")
    new = re.sub(
        r"(?<=```\n)(\$ cncrun [^\n]*\n).*?(?=\n```)",
        lambda found: found[1] + text,
        old,
        count=1,
        flags=re.DOTALL,
    )
    readme.write_text(new, encoding="utf-8")


def photograph(program: str, machine: str, target: Path, *, dark: bool, then: str) -> None:
    """The page of a program, after ``then`` was carried out in it."""
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
    photograph(
        "programs/trident.nc",
        "paper-nurbs",
        ROOT / "docs" / "view-trident.png",
        dark=True,
        then="m.press({channel: 1})",
    )
    photograph(
        "programs/finishing.nc",
        "default",
        ROOT / "docs" / "view-finishing.png",
        dark=False,
        then="m.chooseTime(40)",
    )
    describe(draw(ROOT / "docs" / "trident.svg"), ROOT / "README.md")
