"""Speed of reading: text to canonical blocks, after compilation, a CPU second, in one process.

The baseline is LinuxCNC's own interpreter on the same programs in the same run, its start included,
its output thrown away; where `rs274` is not installed, this interpreter with every line read by the
grammar.

python -m benchmarks.language [--lines N] [--long N] [--repeat N]
"""

from __future__ import annotations

import argparse
import math
import random
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

from cnc.gcode.program.program import interpret
from cnc.gcode.syntax import source_text
from cnc.gcode.syntax.scanner import Scan, scan
from cnc.gcode.syntax.source_text import Text
from cnc.model.blocks import Polyline
from cnc.session.kernel_cache import use_language

PLAIN_LINES, MIXED_LINES, LONG_LINES = 1_000_000, 200_000, 10_000_000
FEWER = 20
"""The share of a program's lines that the grammar is asked to read, where it is the baseline."""
BODY = """\
  #1 = [#<count> MOD 360]
  #2 = [10 * COS[#1]]
  #<depth> = [-1 - ABS[SIN[#1]] / 2]
  G0 X[#2 + 1] Y#1 (to the start)
  G1 Z#<depth> F600
  X[#2 + 2] Y[#1 + SIN[#1]]
  ; there and back
  G2 X[#2 + 4] I1 J0
  G3 X[#2 + 2] I-1 J0
  G1 X#2 Y[#1 / 2] F[600 + #1]
  o200 if [#1 GT 180]
    Y[#1 - 1]
  o200 else
    Y[#1 + 1]
  o200 endif
  G0 Z1
  #<count> = [#<count> + 1]
"""
TRIES = 3
"""Runs of rs274 that may fail: two at once don't always get on with each other."""
EXECUTED = 15
"""Lines that are executed of BODY each time, and the one that begins the loop."""


@dataclass(frozen=True)
class Speed:
    """Executed lines a CPU second, and a word on how they were read."""

    name: str
    lines_per_s: float


def write_plain(path: Path, lines: int) -> int:
    """A finishing program: short moves over a wavy surface, 26 bytes a line. The number of its
    lines.
    """
    rng = random.Random(1)
    with path.open("w", newline="") as file:
        file.write("G21 G90 G1 F1200\n")
        for n in range(lines - 2):
            line = f"X{0.05 * (n % 2000):.3f} Y{0.1 * (n // 2000):.3f} Z{3 * math.sin(0.01 * n) + 0.01 * rng.random():.4f}"
            file.write(f"{line:25.25}\n")
        file.write("M2\n")
    return lines


def write_mixed(path: Path, lines: int) -> int:
    """Parameters, expressions, arcs, comments and control flow in a loop. The number of lines that
    are executed.
    """
    turns = lines // (EXECUTED + 1)
    path.write_text(
        f"G21 G90 G17 G64\n#<count> = 0\no100 while [#<count> LT {turns}]\n{BODY}o100 endwhile\nM2\n",
        newline="",
    )
    return turns * (EXECUTED + 1) + 5


def moves_of(path: Path) -> int:
    """Read a program and throw its blocks away; the number of moves."""
    moves = 0
    for block in interpret(Text.of_file(path)):
        moves += len(block.points) if isinstance(block, Polyline) else 1
    return moves


def seconds(work: Callable[[], object], who: int = resource.RUSAGE_SELF) -> float:
    """CPU seconds of some work, this process's or its children's."""
    before = resource.getrusage(who)
    work()
    after = resource.getrusage(who)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measured(path: Path, lines: int, repeat: int) -> Speed:
    """The interpreter of this house, the quickest of some runs."""
    return Speed("cnc", lines / min(seconds(lambda: moves_of(path)) for _ in range(repeat)))


def baseline(path: Path, lines: int) -> Speed:
    """LinuxCNC's interpreter, or else this one with the grammar for every line."""
    if rs274 := shutil.which("rs274"):
        command = [rs274, "-g", str(path)]

        def run() -> None:
            subprocess.run(
                command,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                cwd=path.parent,
                check=True,
            )

        for _ in range(TRIES):
            with suppress(subprocess.CalledProcessError):
                return Speed("rs274", lines / seconds(run, resource.RUSAGE_CHILDREN))
    few = path.with_name("few.ngc")
    fewer = (write_mixed if "mixed" in path.name else write_plain)(few, lines // FEWER)
    with patch.object(source_text, "scan", nothing_is_plain):
        return Speed("grammar", fewer / seconds(lambda: moves_of(few)))


def nothing_is_plain(data: bytes, *, whole: bool) -> Scan:
    """A scan that leaves every line to the grammar."""
    found = scan(data, whole=whole)
    found.lines.plain[: found.count] = 0
    found.lines.straight[: found.count] = 0
    return found


def peak_mb(path: Path) -> float:
    """Largest memory, in MB, of a process that reads a program."""
    command = [sys.executable, "-m", "benchmarks.language", "--read", str(path)]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def largest_memory_mb() -> float:
    """Of this process, so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (
        1e6 if sys.platform == "darwin" else 1e3
    )


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description="Speed and memory of reading, beside a baseline.")
    parser.add_argument("--lines", type=int, default=PLAIN_LINES, help="lines of the plain program")
    parser.add_argument(
        "--long",
        type=int,
        default=LONG_LINES,
        help="lines of the program whose memory is measured; 0 for none",
    )
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument(
        "--read", type=Path, help="only read this program, and print the memory that it took"
    )
    arguments = parser.parse_args()
    if arguments.read:
        moves_of(arguments.read)
        print(largest_memory_mb())
        return
    use_language()
    with tempfile.TemporaryDirectory(prefix="cnc-") as folder:
        plain, mixed = Path(folder) / "plain.ngc", Path(folder) / "mixed.ngc"
        programs = [
            (plain, write_plain(plain, arguments.lines)),
            (mixed, write_mixed(mixed, MIXED_LINES)),
        ]
        print(
            f"{'program':10} {'lines':>10} {'lines/s':>12} {'baseline':>10} {'lines/s':>12} {'ratio':>8}"
        )
        for path, lines in programs:
            own, other = measured(path, lines, arguments.repeat), baseline(path, lines)
            row = f"{path.stem:10} {lines:10d} {own.lines_per_s:12.0f} {other.name:>10} {other.lines_per_s:12.0f}"
            print(row, f"{own.lines_per_s / other.lines_per_s:8.1f}")
        if arguments.long:
            lines = write_plain(plain, arguments.long)
            print(
                f"largest memory, {lines} plain lines ({plain.stat().st_size / 1e6:.0f} MB of text): {peak_mb(plain):.0f} MB"
            )


if __name__ == "__main__":
    main()
