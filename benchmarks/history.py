"""Computing time of checks by commit, in units of the machine's speed: ``benchmarks/history.json``.

    python -m benchmarks.history                    measure, and compare with the last commit there
    python -m benchmarks.history --record           also add this commit to the file
    python -m benchmarks.history --beside COMMIT    measure that commit too, in turn with this one

Each figure is the CPU time of a check, from text to pulses, in one process on one core, after
everything is loaded. The speed is the CPU time of work that never changes: half of it is compiled
code, half is Python. It is measured before and behind each check, and the check is divided by it:
so figures of different machines, and of a loaded one, can be compared. A figure that took 10 %
longer than before is marked. ``--beside`` is more exact: both commits run in turn. It compiles the
kernels of that commit first.

A longer motion in less computing time is no gain, so both are shown.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from datetime import date
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any, Literal, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "benchmarks" / "history.json"
ROUNDS = 5
Limits = Literal["installed", "axes", "path"]
"""The machine of a check: the installed one, or one with limits of the axes or along the path."""
SLOWER = 1.1
"""Ratio to the commit before above which a figure is marked."""


class Figure(NamedTuple):
    """What a check took.

    Attributes:
        cpu_s: the least CPU time, s.
        work: the median of the CPU time by the speed around it.
        motion_s: machine time of the program, s.
    """

    cpu_s: float
    work: float
    motion_s: float


class Entry(NamedTuple):
    """The figures of a commit.

    Attributes:
        commit: its hash.
        day: ISO date of the measurement.
        speed_s: the least CPU time of the work that never changes, s.
        figures: by name.
    """

    commit: str
    day: str
    speed_s: float
    figures: dict[str, Figure]


# The programs. Their text must never change: a new kind of program gets a new name.


def _wavy() -> Iterator[str]:
    """Yield a finishing pass over a wavy surface."""
    yield "G21 G90 G17 G64 P0.01\nG0 X0 Y0 Z20\nF3000"
    for row in range(30):
        for number in range(1000):
            column = number if row % 2 == 0 else 999 - number
            x, y = 0.15 * column, 0.2 * row
            z = 2.0 * math.sin(x / 9.0) * math.cos(y / 7.0) + 0.5 * math.sin(x / 3.0 + y / 5.0)
            yield f"G1 X{x:.3f} Y{y:.3f} Z{z:.3f}"
    yield "M2"


def _polygons() -> Iterator[str]:
    """Yield polygons of a few short legs, each at another place."""
    draw = random.Random(1)
    x = y = 0.0
    yield "G21 G90 G17 G64 P0.05\nF3000"
    for _ in range(40):
        heading = draw.uniform(0.0, 2.0 * math.pi)
        for _ in range(draw.randint(3, 6)):
            leg = draw.uniform(0.15, 1.2)
            x, y = x + leg * math.cos(heading), y + leg * math.sin(heading)
            heading += math.radians(draw.uniform(5.0, 175.0)) * draw.choice((-1, 1))
            yield f"G1 X{x:.4f} Y{y:.4f}"
        x += 2.0
        yield f"G0 Z2\nG0 X{x:.4f}\nG1 Z0"
    yield "M2"


def _holes() -> Iterator[str]:
    yield "G21 G90 G17 G98\nF300\nG81 X0 Y0 Z-5 R2"
    yield from (f"X{number * 7 % 97} Y{number * 13 % 89}" for number in range(1500))
    yield "M2"


def _arcs() -> Iterator[str]:
    """Yield a row of half turns with short lines between them."""
    yield "G21 G90 G17 G64 P0.01\nF2500\nG0 X0 Y0"
    for number in range(1000):
        x = 0.2 * number
        there, back = (0.0, 6.0) if number % 2 == 0 else (6.0, 0.0)
        yield f"G{2 + number % 2} X{x:.3f} Y{back:g} I0 J{(back - there) / 2:g}\nG1 X{x + 0.2:.3f}"
    yield "M2"


def _feeds() -> Iterator[str]:
    """Yield a curve of short moves, each with a feed of its own, in inverse time and per minute."""
    draw = random.Random(2)
    yield "G21 G90 G17 G64 P0.01\nG0 X80 Y50"
    for number in range(4000):
        if number in (0, 2000):
            yield "G94" if number == 0 else "G93"
        angle = number / 200.0
        x, y = 50.0 + 30.0 * math.cos(angle), 50.0 + 30.0 * math.sin(1.1 * angle)
        feed = draw.uniform(900.0, 1800.0) if number < 2000 else draw.uniform(6000.0, 9000.0)
        yield f"G1 X{x:.3f} Y{y:.3f} F{feed:.1f}"
    yield "M2"


def _stops() -> Iterator[str]:
    draw = random.Random(3)
    yield "G21 G90 G17 G61\nF1500"
    for _ in range(2000):
        yield f"G1 X{draw.uniform(0.0, 90.0):.3f} Y{draw.uniform(0.0, 90.0):.3f}"
    yield "M2"


def _finishing() -> Iterator[str]:
    """Yield the shipped finishing pass, which has 20 018 lines."""
    yield from (ROOT / "programs" / "finishing.nc").read_text().splitlines()


PROGRAMS: dict[str, tuple[Callable[[], Iterator[str]], Limits]] = {
    "finishing.nc, installed machine": (_finishing, "installed"),
    "wavy surface": (_wavy, "axes"),
    "wavy surface, limits along the path": (_wavy, "path"),
    "polygons": (_polygons, "axes"),
    "polygons, limits along the path": (_polygons, "path"),
    "holes": (_holes, "axes"),
    "arcs": (_arcs, "axes"),
    "feeds on each line": (_feeds, "axes"),
    "exact stops": (_stops, "axes"),
}
"""By name: the lines and the machine."""


def _machine(limits: Limits) -> Any:
    """Return the installed machine, or one with limits of each axis, or along the path alone."""
    from cnc.api import load_machine
    from cnc.machine.models import Axis, Machine, PathLimits
    from cnc.model.blocks import AxisLetter

    if limits == "installed":
        return load_machine()
    along = limits == "path"
    axis = Axis(
        steps_per_mm=200.0,
        max_velocity=100.0,
        max_acceleration=None if along else 1000.0,
        max_jerk=None if along else 40_000.0,
    )
    path = PathLimits(
        max_feed=100.0,
        max_tangential_acceleration=1000.0 if along else None,
        max_normal_acceleration=1000.0 if along else None,
        max_jerk=40_000.0 if along else None,
    )
    letters: tuple[AxisLetter, ...] = ("x", "y", "z")
    return Machine(axes=dict.fromkeys(letters, axis), path=path)


# The measurement, in a process of its own, of the code that is on its path.


def _speed() -> Callable[[], float]:
    """Return a function that returns the CPU time of work that never changes, s."""
    import numba

    @numba.njit  # type: ignore[untyped-decorator]
    def compiled(count: int) -> float:
        total = 0.0
        for number in range(count):
            total += math.sqrt(number + 1.0) / (1.0 + total * total)
        return total

    def interpreted(count: int) -> int:
        seen: dict[int, tuple[int, float]] = {}
        for number in range(count):
            seen[number % 977] = (number, 0.5 * number)
        return len(seen)

    def speed() -> float:
        began = process_time()
        compiled(6_000_000)
        interpreted(350_000)
        return process_time() - began

    compiled(10)
    return speed


def measure() -> dict[str, Any]:
    """Return the speeds, and CPU time, work and motion of each check, of the imported code."""
    from cnc.api import check, from_text

    speed = _speed()
    speeds, figures = [speed()], {}
    for name, (lines, limits) in PROGRAMS.items():
        text, machine = "\n".join([*lines(), ""]), _machine(limits)
        check(from_text("\n".join(text.split("\n")[:40]) + "\nM2\n"), machine)
        began = process_time()
        report = check(from_text(text), machine)
        took = process_time() - began
        report.raise_if_faulty()
        speeds.append(speed())
        figures[name] = (took, 2.0 * took / (speeds[-2] + speeds[-1]), report.duration_s)
    return {"speed_s": min(speeds), "figures": figures}


def measured_in(tree: Path) -> dict[str, Any]:
    """Return what :func:`measure` returns for the code in a folder."""
    shown = subprocess.run(
        [sys.executable, str(Path(__file__).resolve()), "--measure"],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    ).stdout
    figures: dict[str, Any] = json.loads(shown.splitlines()[-1])
    return figures


def joined(rounds: list[dict[str, Any]], commit: str) -> Entry:
    """Return the entry of a commit from some measurements."""
    figures = {}
    for name in rounds[0]["figures"]:
        times, works, motions = zip(*(each["figures"][name] for each in rounds), strict=True)
        figures[name] = Figure(min(times), median(works), motions[0])
    speed = min(each["speed_s"] for each in rounds)
    return Entry(commit, date.today().isoformat(), speed, figures)


# The file, and the comparison.


def read(file: Path = FILE) -> list[Entry]:
    """Return the entries of the file, the oldest first."""
    if not file.exists():
        return []
    return [
        Entry(
            each["commit"],
            each["day"],
            each["speed_s"],
            {name: Figure(*figure) for name, figure in each["figures"].items()},
        )
        for each in json.loads(file.read_text())
    ]


def write(entries: list[Entry], file: Path = FILE) -> None:
    """Write the file: one line for each figure, so that changes can be read."""
    texts = []
    for entry in entries:
        figures = ",\n".join(
            f"   {json.dumps(name)}: [{figure.cpu_s:.4f}, {figure.work:.3f}, {figure.motion_s:.3f}]"
            for name, figure in entry.figures.items()
        )
        texts.append(
            f' {{"commit": "{entry.commit}", "day": "{entry.day}", '
            f'"speed_s": {entry.speed_s:.4f},\n  "figures": {{\n{figures}\n  }}}}'
        )
    file.write_text("[\n" + ",\n".join(texts) + "\n]\n")


def recorded(entries: list[Entry], entry: Entry) -> list[Entry]:
    """Return the entries with another one; it replaces an earlier one of the same commit."""
    return [each for each in entries if each.commit != entry.commit] + [entry]


def compared(now: Entry, before: Entry | None) -> Iterator[str]:
    """Yield the lines of a table: the figures of two commits, by the speed of their machine."""
    name = "" if before is None else f"beside {before.commit[:8]} of {before.day}"
    yield f"{'check, text to pulses':38} {'CPU s':>8} {'/speed':>8} {'motion s':>10}  {name}"
    for title, figure in now.figures.items():
        line = f"{title:38} {figure.cpu_s:8.3f} {figure.work:8.2f} {figure.motion_s:10.3f}"
        old = None if before is None else before.figures.get(title)
        if old is not None:
            ratio = figure.work / old.work
            motion = figure.motion_s / old.motion_s
            line += f"  CPU {ratio:5.2f}, motion {motion:7.5f}"
            if ratio > SLOWER:
                line += f"  SLOWER by {100.0 * (ratio - 1.0):.0f} %"
        yield line


def _git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    return done.stdout.strip()


def _beside(commit: str) -> tuple[Entry, Entry]:
    """Measure this tree and a commit in turn."""
    name = _git("rev-parse", commit)
    with tempfile.TemporaryDirectory(prefix="cnc-") as folder:
        tree = Path(folder) / "before"
        _git("worktree", "add", "--detach", str(tree), name)
        try:
            pairs = [(measured_in(ROOT), measured_in(tree)) for _ in range(ROUNDS)]
        finally:
            _git("worktree", "remove", "--force", str(tree))
    now, before = zip(*pairs, strict=True)
    return joined([*now], _git("rev-parse", "HEAD")), joined([*before], name)


def main() -> None:
    """Measure, compare and record."""
    parser = argparse.ArgumentParser(description="Computing time of checks by commit.")
    parser.add_argument("--record", action="store_true", help="add this commit to the file")
    parser.add_argument("--beside", metavar="COMMIT", help="measure this commit too, in turn")
    parser.add_argument("--measure", action="store_true", help="only print what checks take here")
    arguments = parser.parse_args()
    if arguments.measure:
        print(json.dumps(measure()))
        return
    changed = bool(_git("status", "--porcelain", "--untracked-files=no"))
    if arguments.record and changed:
        parser.error("commit the changes first: the figures are those of a commit")
    entries = read()
    before: Entry | None
    if arguments.beside:
        now, before = _beside(arguments.beside)
    else:
        commit = _git("rev-parse", "HEAD")
        now = joined([measured_in(ROOT) for _ in range(ROUNDS)], commit)
        others = [entry for entry in entries if entry.commit != commit or changed]
        before = others[-1] if others else None
    print(*compared(now, before), sep="\n")
    if arguments.record:
        write(recorded(entries, now))


if __name__ == "__main__":
    main()
