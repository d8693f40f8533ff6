"""CPU time of ``cncrun --board grbl --check-on-board``: before the first line, and for each line.

The board is the GRBL simulator at a pseudo-terminal, in real time: 115200 baud, with GRBL's buffer
and its time for a line. Two parts are printed apart:

- start and check: the CPU time until the board has read the first line with a motion. The program
  is checked and translated as a whole before that, once, however long it is played.
- streaming: the CPU time from then to the last line, for each line, and as the load of a core at
  the rate of the wire.

    python -m benchmarks.sending [--lines N] [--repeat N]

``prepared``: short chords of a smooth curve. ``jagged``: long moves between random points.
"""

from __future__ import annotations

import argparse
import math
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import PtyServer

WIRE = 443.0
"""Lines of 26 bytes that 115200 baud carry in a second."""
SAMPLING = 0.02
"""Seconds between two looks at the board."""


class Sample(NamedTuple):
    """Lines with a motion that the board has read, with the times of the sender, s."""

    lines: int
    cpu: float
    wall: float


class Cost(NamedTuple):
    """CPU seconds before the first line; CPU seconds a line; lines a second."""

    start: float
    line: float
    rate: float


def prepared(count: int) -> Iterator[str]:
    """Yield chords of some tenths of a millimetre along a wavy path."""
    for k in range(count):
        x, y = 20 + 15 * math.cos(0.02 * k), 20 + 15 * math.sin(0.023 * k)
        yield f"X{x:.3f} Y{y:.3f} Z{-2 + math.sin(0.05 * k):.3f}"


def jagged(count: int) -> Iterator[str]:
    """Yield random points."""
    rng = random.Random(1)
    for _ in range(count):
        yield f"X{rng.uniform(0, 40):.3f} Y{rng.uniform(0, 40):.3f} Z{rng.uniform(-4, 0):.3f}"


def cpu_seconds(process: int) -> float:
    """Return the CPU seconds of a process so far, by proc(5)."""
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def samples(sender: subprocess.Popen[bytes], simulator: GrblSimulator) -> Iterator[Sample]:
    """Yield a sample each time that the board has read lines with a motion, until the end."""
    seen = lines = 0
    while sender.poll() is None:
        events = simulator.events[seen:]
        moving = sum(event.kind == "line" and "X" in event.value for event in events)
        seen += len(events)
        if moving:
            lines += moving
            yield Sample(lines, cpu_seconds(sender.pid), time.monotonic())
        time.sleep(SAMPLING)


def cost(program: Path) -> Cost:
    """Return the cost of a run."""
    simulator = GrblSimulator()
    with PtyServer(simulator) as server:
        command = [sys.executable, "-m", "cnc.cli", str(program), "--machine", "grbl-uno"]
        command += ["--board", "grbl", "--port", server.name, "--check-on-board", "--yes"]
        environment = os.environ | {"XDG_STATE_HOME": str(program.parent)}
        sender = subprocess.Popen([*command, "--quiet"], env=environment)
        taken = list(samples(sender, simulator))
        if sender.wait():
            raise SystemExit(f"{' '.join(command)} ended with {sender.returncode}")
    first, last = taken[0], taken[-1]
    lines = last.lines - first.lines
    return Cost(first.cpu, (last.cpu - first.cpu) / lines, lines / (last.wall - first.wall))


def main() -> None:
    """Print both parts of the CPU time, and the load of a core at the rate of the wire."""
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--lines", type=int, default=6000)
    options.add_argument("--repeat", type=int, default=3)
    wanted = options.parse_args()
    programs: dict[str, Callable[[int], Iterator[str]]] = {"prepared": prepared, "jagged": jagged}
    with tempfile.TemporaryDirectory() as folder:
        for name, program in programs.items():
            path = Path(folder) / f"{name}.nc"
            lines = "\n".join(program(wanted.lines))
            path.write_text(f"G21 G90 G94\nG1 F1500\n{lines}\nM2\n")
            runs = [cost(path) for _ in range(wanted.repeat)]
            best = min(runs, key=lambda run: run.line)
            print(
                f"{name:10} start and check {min(run.start for run in runs):.2f} s; streaming "
                f"{best.line * 1e3:.3f} ms a line, {best.line * best.rate:.1%} of a core at "
                f"{best.rate:.0f} lines/s, {best.line * WIRE:.1%} at {WIRE:.0f} lines/s",
                flush=True,
            )


if __name__ == "__main__":
    main()
