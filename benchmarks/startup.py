"""Time of the first minute: new installation, compilation, later starts.

Each figure is processor time of the process and its children, and wall time. Compiled code goes
into a temporary folder. The load of the machine is printed, because it changes both.

    python -m benchmarks.startup            all figures but the compilation of everything
    python -m benchmarks.startup --all      with it
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

ROOT = Path(__file__).parents[1]
REPEAT = 3
WRONG = "G21 G90\nG1 X\n"


def measured(arguments: Sequence[str], cache: Path) -> tuple[float, float]:
    """Run ``cncrun``; return processor time and wall time, s."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), perf_counter()
    subprocess.run(
        [sys.executable, "-m", "cnc.cli", *arguments],
        cwd=ROOT,
        env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=False,
    )
    wall, after = perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime, wall


def show(name: str, arguments: Sequence[str], cache: Path, repeat: int = 1) -> None:
    """Print the least processor time and wall time of some runs."""
    results = [measured(arguments, cache) for _ in range(repeat)]
    cpu, wall = (min(values) for values in zip(*results, strict=True))
    print(f"{name:46} {cpu:8.2f} {wall:8.2f}", flush=True)


def main() -> None:
    """Print all figures."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    print(f"{os.cpu_count()} processors, load {load:.1f} before the measurement")
    print(f"{'':46} {'CPU s':>8} {'wall s':>8}")
    with tempfile.TemporaryDirectory(prefix="cnc-") as folder:
        cold = Path(folder) / "cold"
        wrong = Path(folder) / "wrong.nc"
        wrong.write_text(WRONG)
        show("--help", ["--help"], cold, REPEAT)
        show("a syntax error, nothing compiled", ["check", str(wrong)], cold, REPEAT)
        show("trident.nc, nothing compiled", ["programs/trident.nc"], cold)
        show("trident.nc, compiled", ["programs/trident.nc"], cold, REPEAT)
        if "--all" in sys.argv[1:]:
            show("warm: all kernels", ["warm"], Path(folder) / "all")


if __name__ == "__main__":
    main()
