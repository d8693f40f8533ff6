"""Benchmark of a check of many programs: one process against several, start-up included.

python -m benchmarks.checking [--files N] [--lines N] [--jobs N] [--repeat N]
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from cnc.session.kernel_cache import ensure_compiled

TIME_KEYS = ("timing", "lines_per_s", "steps_per_s")


def write(folder: Path, files: int, lines: int) -> None:
    """Write finishing passes of short moves, each program with another wave."""
    for number in range(files):
        moves = (
            f"X{100.0 * k / lines:.3f} Y{20.0 + 10.0 * math.sin(0.01 * k + number):.3f} "
            f"Z{-2.0 + math.cos(0.013 * k):.3f}"
            for k in range(lines)
        )
        (folder / f"{number:04d}.nc").write_text(
            "G21 G90 G94 G64 P0.02\nG1 F2400\n" + "\n".join(moves) + "\nM2\n"
        )


def checked(folder: Path, jobs: int) -> tuple[float, list[dict[str, Any]]]:
    """Return the seconds of a check in ``jobs`` processes, and its summaries."""
    command = [sys.executable, "-m", "cnc.cli", "check", str(folder), "--quiet"]
    options = ["--jobs", str(jobs), "--format", "json"]
    began = time.perf_counter()
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - began
    if done.returncode:
        raise SystemExit(done.stderr)
    return seconds, [
        {key: value for key, value in each.items() if key not in TIME_KEYS}
        for each in json.loads(done.stdout)
    ]


def main() -> None:
    """Print the times and their ratio."""
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, value in ("files", 200), ("lines", 10_000), ("jobs", 2), ("repeat", 1):
        options.add_argument(f"--{name}", type=int, default=value)
    wanted = options.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write(folder, wanted.files, wanted.lines)
        # The kernels are compiled before the measurement.
        ensure_compiled(None)
        for _ in range(wanted.repeat):
            load = os.getloadavg()[0]
            alone, found = checked(folder, 1)
            together, same = checked(folder, wanted.jobs)
            assert same == found
            print(
                f"{wanted.files} files of {wanted.lines} lines: 1 process {alone:.2f} s, "
                f"{wanted.jobs} processes {together:.2f} s, {alone / together:.2f} times as fast "
                f"(load before: {load:.1f})",
                flush=True,
            )


if __name__ == "__main__":
    main()
