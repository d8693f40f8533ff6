"""Speed on the shipped programs: reading, planning and pulses, in one process on one core.

The measurement is made after compilation.

make bench
python -m benchmarks.programs [--repeat N] [PROGRAM...]
"""

from __future__ import annotations

import argparse
import resource
from pathlib import Path

from cnc.api import check, load_machine
from cnc.report.result import Report

FOLDER = Path(__file__).resolve().parent.parent / "programs"
TITLES = (
    ("lines", 8),
    ("steps", 10),
    ("machine s", 10),
    ("read s", 8),
    ("plan s", 8),
    ("pulses s", 8),
    ("lines/s", 10),
    ("steps/s", 12),
)


def best(program: Path, repeat: int) -> Report:
    """Return the fastest of some checks."""
    machine = load_machine()
    reports = [check(program, machine) for _ in range(repeat)]
    for report in reports:
        report.raise_if_faulty()
    return min(reports, key=lambda report: report.timing.total_s)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description="Speed of `cncrun check`, after compilation.")
    parser.add_argument("programs", nargs="*", type=Path, default=sorted(FOLDER.glob("*.nc")))
    parser.add_argument("--repeat", type=int, default=5)
    arguments = parser.parse_args()
    print(f"{'program':24}", *(f"{title:>{width}}" for title, width in TITLES))
    for program in arguments.programs:
        best(program, 1)
        report = best(program, arguments.repeat)
        timing, steps = report.timing, sum(report.steps.values())
        print(
            f"{program.name:24} {report.lines:8d} {steps:10d} {report.duration_s:10.3f} "
            f"{timing.parse_s:8.4f} {timing.plan_s:8.4f} "
            f"{timing.interpolate_s:8.4f} {report.lines / timing.total_s:10.0f} "
            f"{steps / timing.total_s:12.0f}"
        )
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
