"""Speed of the interpreter: lines of text to canonical blocks in a CPU second, by shape of lines.

The measurement is made after compilation, in one process whose other objects are frozen for the
garbage collector, which looks for garbage as often as in the command line. The baseline is
LinuxCNC's own interpreter on the same programs in the same run, its start included and its output
discarded. If `rs274` is not installed, the baseline is this interpreter without compiled code for
runs of lines.

python -m benchmarks.language [--lines N] [--long N] [--repeat N]
"""

from __future__ import annotations

import argparse
import gc
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

from benchmarks import cam_programs
from cnc.cli.work import NEW_OBJECTS
from cnc.gcode.core import line_steps
from cnc.gcode.core.program import interpret
from cnc.gcode.core.tool_table import ToolTable
from cnc.gcode.reader.source_text import Text
from cnc.model.blocks import Polyline
from cnc.session.kernel_cache import ensure_compiled
from cnc.session.kernel_jobs import READING

PLAIN_LINES, LONG_LINES = 1_000_000, 10_000_000
FEWER = 20
"""The baseline with the grammar reads this fraction of a program's lines, if it has many."""
SHORT = 1000
"""Lines. A shorter program is a loop, and is read wholly."""
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
"""Attempts to run rs274. It sometimes fails if two run at once."""
EXECUTED = 15
"""Lines of BODY that are executed in each round."""


@dataclass(frozen=True)
class Speed:
    """Executed lines in a CPU second, and the name of the interpreter."""

    name: str
    lines_per_s: float


def write_plain(path: Path, lines: int) -> int:
    """Write a finishing program: short moves over a wavy surface, 26 bytes a line.

    Returns:
        The number of its lines.
    """
    rng = random.Random(1)
    with path.open("w", newline="") as file:
        file.write("G21 G90 G1 F1200\n")
        for n in range(lines - 2):
            x, y = 0.05 * (n % 2000), 0.1 * (n // 2000)
            z = 3 * math.sin(0.01 * n) + 0.01 * rng.random()
            line = f"X{x:.3f} Y{y:.3f} Z{z:.4f}"
            file.write(f"{line:25.25}\n")
        file.write("M2\n")
    return lines


def write_mixed(path: Path, lines: int) -> int:
    """Write a loop of parameters, expressions, arcs, comments and control flow.

    Returns:
        The number of lines that are executed.
    """
    turns = lines // (EXECUTED + 1)
    path.write_text(
        f"G21 G90 G17 G64\n#<count> = 0\no100 while [#<count> LT {turns}]\n"
        f"{BODY}o100 endwhile\nM2\n",
        newline="",
    )
    return turns * (EXECUTED + 1) + 5


def write_expressions(path: Path, lines: int) -> int:
    """Write lines with expressions, none like another: numbers, forms and parameters differ.

    Returns:
        The number of its lines.
    """
    rng = random.Random(2)

    def value(depth: int) -> str:
        kind = rng.random()
        if depth == 0 or kind < 0.2:
            return rng.choice([f"{rng.uniform(0, 9):.3f}", f"#{rng.randint(1, 60)}", "#<width>"])
        if kind < 0.4:
            return f"{rng.choice(['SIN', 'COS', 'ABS', 'ROUND', 'FIX'])}[{value(depth - 1)}]"
        return f"[{value(depth - 1)}{rng.choice('+-*')}{value(depth - 1)}]"

    with path.open("w", newline="") as file:
        file.write("G21 G90 G17 G1 F500\n#<width> = 3\n")
        for _ in range(lines - 3):
            if rng.random() < 0.3:
                file.write(f"#{rng.randint(1, 60)} = [{value(2)} MOD 10]\n")
            else:
                file.write(f"X[{value(2)}] Y[{value(2)}]\n")
        file.write("M2\n")
    return lines


def write_names(path: Path, lines: int) -> int:
    """Write assignments to as many named parameters; return the number of lines."""
    names = "".join(f"#<part{n}> = {n % 97}.5\n" for n in range(lines - 1))
    path.write_text(names + "M2\n", newline="")
    return lines


def write_calls(path: Path, lines: int) -> int:
    """Write calls of a subroutine with arguments; return the number of executed lines."""
    rng = random.Random(3)
    calls = "".join(
        f"o100 call [{rng.uniform(0, 9):.3f}] [{rng.uniform(0, 9):.2f}]\n" for _ in range(lines)
    )
    body = "o100 sub\nX#1 Y#2\nZ[#1 + #2]\no100 endsub\n"
    path.write_text(f"G21 G90 G1 F500\n{body}{calls}M2\n", newline="")
    return 4 * lines + 3


def write_cycles(path: Path, lines: int) -> int:
    """Write a pattern of holes; return the number of lines."""
    rng = random.Random(4)
    holes = "".join(
        f"X{rng.uniform(0, 99):.3f} Y{rng.uniform(0, 99):.3f}\n" for _ in range(lines - 4)
    )
    path.write_text(f"G21 G90 G0 Z5\nG81 X1 Y1 Z-1 R1 F100\n{holes}G80\nM2\n", newline="")
    return lines


def write_arcs(path: Path, lines: int) -> int:
    """Write half circles in a row; return the number of lines."""
    rng = random.Random(5)
    with path.open("w", newline="") as file:
        file.write("G21 G17 G91 G1 F500 X0\n")
        for _ in range(lines - 2):
            radius = rng.randint(100, 3000) / 1000
            file.write(f"G{rng.choice('23')} X{2 * radius:.3f} I{radius:.3f}\n")
        file.write("M2\n")
    return lines


PROGRAMS: dict[str, tuple[Callable[[Path, int], int], int]] = {
    "mixed loop": (write_mixed, 200_000),
    "expressions": (write_expressions, 200_000),
    "names": (write_names, 200_000),
    "calls": (write_calls, 100_000),
    "cycles": (write_cycles, 100_000),
    "arcs": (write_arcs, 100_000),
}
"""Writers and numbers of lines by shape, beside the plain program and those of CAM systems."""


def write_tools(path: Path) -> None:
    """Write LinuxCNC's tool table with the tools of all programs."""
    path.write_text("".join(f"T{n} P{n} Z0 D3\n" for n in range(1, 100)), newline="")


def moves_of(path: Path) -> int:
    """Read a program; return the number of its moves."""
    moves = 0
    table = path.with_name("tools.tbl")
    tools = ToolTable.load(table) if table.exists() else None
    for block in interpret(Text.of_file(path), tools=tools):
        moves += len(block.points) if isinstance(block, Polyline) else 1
    return moves


def seconds(work: Callable[[], object], process: int = resource.RUSAGE_SELF) -> float:
    """Return the CPU seconds of some work, in this process or its children."""
    before = resource.getrusage(process)
    work()
    after = resource.getrusage(process)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measured(path: Path, lines: int, repeat: int) -> Speed:
    """Measure this interpreter; return the fastest of some runs."""
    return Speed("cnc", lines / min(seconds(lambda: moves_of(path)) for _ in range(repeat)))


def baseline(path: Path, lines: int) -> Speed:
    """Measure LinuxCNC's interpreter, or this one line by line."""
    if rs274 := shutil.which("rs274"):
        command = [rs274, "-t", str(path.with_name("tools.tbl")), "-g", str(path)]

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
    text = path.read_text().splitlines()
    kept = text if len(text) < SHORT else [*text[: len(text) // FEWER], "M2"]
    few.write_text("\n".join(kept), newline="")
    fewer = lines * len(kept) / len(text)
    with (
        patch.object(line_steps, "SHORTEST", sys.maxsize),
        patch.object(line_steps, "MANY_LINES", sys.maxsize),
    ):
        return Speed("interpreter", fewer / seconds(lambda: moves_of(few)))


def peak_mb(path: Path) -> float:
    """Return the peak memory, in MB, of a process that reads a program."""
    command = [sys.executable, "-m", "benchmarks.language", "--read", str(path)]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def largest_memory_mb() -> float:
    """Return the peak memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (
        1e6 if sys.platform == "darwin" else 1e3
    )


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(
        description="Speed and memory of the interpreter, with a baseline."
    )
    parser.add_argument("--lines", type=int, default=PLAIN_LINES, help="lines of the plain program")
    parser.add_argument(
        "--long",
        type=int,
        default=LONG_LINES,
        help="lines of the program for the peak memory; 0 for none",
    )
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument(
        "--read", type=Path, help="only read this program, and print the peak memory"
    )
    arguments = parser.parse_args()
    if arguments.read:
        moves_of(arguments.read)
        print(largest_memory_mb())
        return
    ensure_compiled(jobs=READING)
    with tempfile.TemporaryDirectory(prefix="cnc-") as folder:
        plain = Path(folder) / "plain.ngc"
        write_tools(plain.with_name("tools.tbl"))
        programs = [(plain, write_plain(plain, arguments.lines))]
        for name, (writer, lines) in PROGRAMS.items():
            path = plain.with_name(f"{name}.ngc")
            programs.append((path, writer(path, lines)))
        for style in cam_programs.STYLES:
            path = plain.with_name(f"{style}.ngc")
            programs.append((path, cam_programs.write(path, style)))
        print(
            f"{'program':12} {'lines':>10} {'lines/s':>12} {'baseline':>10} {'lines/s':>12} "
            f"{'ratio':>8}"
        )
        for path, lines in programs:
            moves_of(path)
            gc.collect()
            gc.freeze()
            gc.set_threshold(NEW_OBJECTS)
            own, other = measured(path, lines, arguments.repeat), baseline(path, lines)
            ratio = own.lines_per_s / other.lines_per_s
            print(
                f"{path.stem:12} {lines:10d} {own.lines_per_s:12.0f} "
                f"{other.name:>10} {other.lines_per_s:12.0f} {ratio:8.1f}"
            )
        if arguments.long:
            lines = write_plain(plain, arguments.long)
            size = plain.stat().st_size / 1e6
            print(
                f"peak memory, {lines} plain lines ({size:.0f} MB of text): {peak_mb(plain):.0f} MB"
            )


if __name__ == "__main__":
    main()
