"""Time of the first minute: new installation, compilation, later starts.

Each figure is processor time of the process and its children, wall time, and the load of the
machine before the measurement, because it changes both. Of several runs the least counts. Compiled
code goes into a temporary folder.

    python -m benchmarks.startup            start and compilation of what trident.nc needs
    python -m benchmarks.startup --all      also the compilation of all kernels
    python -m benchmarks.startup --clone    also make run in a new clone of the last commit; pip
                                            takes packages from its cache, or downloads them
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
REPEAT = 5
WRONG = "G21 G90\nG1 X\n"
RIGHT = "G21 G90 G61\nF600\n" + "G1 X10\nY10\nX0\nY0\n" * 4 + "M2\n"
TRIDENT = "programs/trident.nc"
LEFT_OUT = ("PYTHONDONTWRITEBYTECODE", "NUMBA_CACHE_DIR", "PYTHONPATH", "VIRTUAL_ENV")
"""Variables that would slow the start or point to another installation."""


def measured(command: Sequence[str], folder: Path, cache: Path | None) -> tuple[float, float]:
    """Run a command; return processor time and wall time, s."""
    environment = {name: value for name, value in os.environ.items() if name not in LEFT_OUT}
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = str(cache)
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), perf_counter()
    subprocess.run(
        command,
        cwd=folder,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=False,
    )
    wall, after = perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime, wall


def show(
    name: str, command: Sequence[str], cache: Path | None, repeat: int = 1, folder: Path = ROOT
) -> None:
    """Print the load, and the least processor time and wall time of some runs."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    results = [measured(command, folder, cache) for _ in range(repeat)]
    cpu, wall = (min(values) for values in zip(*results, strict=True))
    print(f"{name:46} {cpu:8.2f} {wall:8.2f} {load:6.1f}", flush=True)


def main() -> None:
    """Print all figures."""
    cncrun = [sys.executable, "-m", "cnc.cli"]
    print(f"{os.cpu_count()} processors")
    print(f"{'':46} {'CPU s':>8} {'wall s':>8} {'load':>6}")
    with tempfile.TemporaryDirectory(prefix="cnc-") as name:
        folder = Path(name)
        cold = folder / "cold"
        (folder / "wrong.nc").write_text(WRONG)
        (folder / "right.nc").write_text(RIGHT)
        right = [*cncrun, "check", str(folder / "right.nc")]
        wrong = [*cncrun, "check", str(folder / "wrong.nc")]
        show("--help", [*cncrun, "--help"], cold, REPEAT)
        show("a syntax error, nothing compiled", wrong, cold, REPEAT)
        show("trident.nc, nothing compiled", [*cncrun, TRIDENT], cold)
        show("trident.nc, compiled", [*cncrun, TRIDENT], cold, REPEAT)
        show("check of 20 lines, compiled", right, cold, REPEAT)
        show("a syntax error, compiled", wrong, cold, REPEAT)
        if "--all" in sys.argv[1:]:
            show("warm: all kernels", [*cncrun, "warm"], folder / "all")
        if "--clone" in sys.argv[1:]:
            subprocess.run(["git", "clone", "--quiet", ROOT, folder / "clone"], check=True)
            show("make run in a new clone", ["make", "run"], None, folder=folder / "clone")


if __name__ == "__main__":
    main()
