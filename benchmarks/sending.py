"""CPU time of ``cncrun --board grbl --check-on-board`` for each line.

The board is the GRBL simulator in a process of its own at a pseudo-terminal, in real time: 115200
baud, with GRBL's buffer and its time for a line. The start-up time of the command is left out: each
program is run short and long, and the difference counts.

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
from collections.abc import Callable, Iterator
from pathlib import Path

WIRE = 443.0
"""Lines of 26 bytes that 115200 baud carry in a second."""
SHORT = 200


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


def cost(program: Path) -> tuple[float, int]:
    """Return the CPU seconds of a run, and the number of lines that were sent."""
    with tempfile.TemporaryDirectory() as folder:
        lines = Path(folder) / "lines.nc"
        board = subprocess.Popen(
            [sys.executable, "-m", "cnc.boards.grbl.simulator"], stdout=subprocess.PIPE, text=True
        )
        try:
            assert board.stdout is not None
            port = board.stdout.readline().strip()
            command = [
                sys.executable,
                "-m",
                "cnc.cli",
                str(program),
                "--machine",
                "grbl-uno",
                "--board",
                "grbl",
                "--port",
                port,
            ]
            command += ["--check-on-board", "--yes", "--quiet", "--lines", str(lines)]
            sender = subprocess.Popen(command)
            _, status, usage = os.wait4(sender.pid, 0)
            sender.returncode = os.waitstatus_to_exitcode(status)
            if sender.returncode:
                raise SystemExit(f"{' '.join(command)} ended with {sender.returncode}")
            return usage.ru_utime + usage.ru_stime, len(lines.read_text().splitlines())
        finally:
            board.terminate()
            board.wait()
            assert board.stdout is not None
            board.stdout.close()


def main() -> None:
    """Print the CPU time of a line, and the load of a core at the rate of the wire."""
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--lines", type=int, default=6000)
    options.add_argument("--repeat", type=int, default=3)
    wanted = options.parse_args()
    programs: dict[str, Callable[[int], Iterator[str]]] = {"prepared": prepared, "jagged": jagged}
    with tempfile.TemporaryDirectory() as folder:
        for name, program in programs.items():
            best = math.inf
            for _ in range(wanted.repeat):
                costs = []
                for count in SHORT, wanted.lines:
                    path = Path(folder) / f"{name}-{count}.nc"
                    path.write_text(
                        "G21 G90 G94\nG1 F1500\n" + "\n".join(program(count)) + "\nM2\n"
                    )
                    costs.append(cost(path))
                (little, few), (much, many) = costs
                best = min(best, (much - little) / (many - few))
            print(
                f"{name:10} {best * 1e3:.3f} ms a line, "
                f"{best * WIRE:.1%} of a core at {WIRE:.0f} lines/s",
                flush=True,
            )


if __name__ == "__main__":
    main()
