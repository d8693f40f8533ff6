"""What it costs to send: CPU time of ``cncrun --board grbl --check-on-board`` for each line,
against a board in the simulator at wire speed.

The board is a process of its own behind a pseudo-terminal, in the wall's time: 115200 baud, GRBL's
buffer, its time a line. What the command costs before its first line is left out: each program is
run short and long, and the difference counts.

    python -m benchmarks.sending [--lines N] [--repeat N]

``prepared``: short chords that the planner passes on as they are. ``jagged``: corners at each of
which the plan stops, in which arcs are looked for in vain.
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
    """Chords of some tenths of a millimetre along a wavy way."""
    for k in range(count):
        yield f"X{20 + 15 * math.cos(0.02 * k):.3f} Y{20 + 15 * math.sin(0.023 * k):.3f} Z{-2 + math.sin(0.05 * k):.3f}"


def jagged(count: int) -> Iterator[str]:
    """Places that have nothing to do with each other."""
    rng = random.Random(1)
    for _ in range(count):
        yield f"X{rng.uniform(0, 40):.3f} Y{rng.uniform(0, 40):.3f} Z{rng.uniform(-4, 0):.3f}"


def sent(program: Path) -> tuple[float, int]:
    """CPU seconds of a run, and lines that came to the board."""
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
    """Print CPU time a line, and the part of a core that it makes at the wire's rate."""
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
                    costs.append(sent(path))
                (little, few), (much, many) = costs
                best = min(best, (much - little) / (many - few))
            print(
                f"{name:10} {best * 1e3:.3f} ms a line, {best * WIRE:.1%} of a core at {WIRE:.0f} lines/s",
                flush=True,
            )


if __name__ == "__main__":
    main()
