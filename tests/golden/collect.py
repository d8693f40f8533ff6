"""Collect the programs of the record: ``programs/``, random programs, and tables of the tests.

The generators and tables are those of the tests. ``golden.py record`` does not need them: it runs
the files that are written here.
"""

from __future__ import annotations

import ast
import importlib
import json
import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

from tests.gcode import test_language_programs
from tests.gcode.syntax import test_malformed
from tests.golden.golden import MANIFEST, Case
from tests.support.gcode import flow_author, flow_writers, fuzzing
from tests.support.paths import ROOT
from tests.support.planner.random_jobs import random_job
from tests.support.programs.geometry_programs import geometry
from tests.support.programs.random_programs import random_program

TESTS = ROOT / "tests"
MACHINES = ("default", "paper-nurbs", "grbl-uno", "stepper-uno")
ALGORITHMS = ("enclosing-line", "half-step", "point-by-point", "kiritsis", "crossings")
DIALECTS = ("auto", "linuxcnc", "grbl", "fanuc", "paper")
EVERY_FILE = ("blocks", "trace", "pulses", "lines")
FUZZED, FLOWS, MOVES, GEOMETRIES, JOBS = 400, 20, 60, 50, 50
"""Numbers of random programs: of the grammar, of each kind of control flow, of moves, for GRBL
boards, and with a machine of their own."""
FEWEST_ERRORS = 1000
"""Fewer marked programs mean that tables were not found."""
MARK = "\N{BROKEN BAR}"
"""Marks the column of an error in the tables."""

TEXT = (ast.Constant, ast.BinOp, ast.JoinedStr)
"""Syntax nodes of expressions that are text."""

TOOLS = "T1 P1 X0.5 Z40 D6\nT2 P2 Z100\nT3 P3 D4\nT11 P11 X0.5 Z110 D5.5\n"
AXIS = """[axes.{}]
steps_per_mm = 10
max_velocity = 100
max_acceleration = 1000
max_jerk = 20000
travel = [-3000, 3000]
"""
PROGRAM = 'subroutines = ["../subroutines"]\nmax_repeated_lines = 5000\nmax_call_depth = 20\n'


class Collection:
    """A folder of files and the list of cases."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.cases: dict[str, Case] = {}

    def write(self, name: str, text: str) -> str:
        """Write a file without changing its line ends. Return its name within the folder."""
        file = self.folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8", newline="")
        return name

    def add(self, name: str, arguments: list[str], outputs: tuple[str, ...]) -> None:
        """Add a case: the arguments of ``cncrun``, and the output files to hash."""
        if name in self.cases:
            raise ValueError(f"two cases have the name {name}")
        self.cases[name] = {"name": name, "arguments": arguments, "outputs": list(outputs)}

    def check(self, program: str, options: str, outputs: tuple[str, ...]) -> None:
        """Add a check of a program."""
        self.add(
            f"{program} {options}",
            ["check", program, "--format", "json", "--quiet", *options.split()],
            outputs,
        )


def collect(folder: Path) -> int:
    """Write all programs, machine files and the manifest into a new or empty folder.

    Returns:
        The number of cases.
    """
    if folder.exists() and any(folder.iterdir()):
        sys.exit(f"{folder} is not empty")
    to = Collection(folder)
    shutil.copytree(TESTS / "support" / "gcode" / "subroutines", folder / "subroutines")
    _language_machines(to)
    _errors(to)
    _shipped(to)
    _random(to)
    _language(to)
    to.write(MANIFEST, json.dumps({"cases": list(to.cases.values())}, indent=1))
    return len(to.cases)


def _language_machines(to: Collection) -> None:
    """Add machines for the language: large travel, coarse steps, a tool table, low loop limits."""
    to.write("machines/tools.tbl", TOOLS)
    for axes in ("xyz", "xyza", "xyzabcuvw", "xz"):
        text = "\n".join(AXIS.format(axis) for axis in axes)
        to.write(f"machines/{axes}.toml", f'{text}\n[program]\ntool_table = "tools.tbl"\n{PROGRAM}')
    text = "\n".join(AXIS.format(axis) for axis in "xyz")
    to.write("machines/no-tools.toml", f"{text}\n[program]\n{PROGRAM}")


def _shipped(to: Collection) -> None:
    """Add the programs in ``programs/`` for each machine, algorithm and dialect.

    Most programs leave the travel of the small machines, which are added with a large travel, too.
    """
    for machine in MACHINES[1:]:
        text = (ROOT / "config" / f"{machine}.toml").read_text(encoding="utf-8")
        text = re.sub(r"^travel = .*", "travel = [-3000, 3000]", text, flags=re.M)
        to.write(f"machines/{machine}-large.toml", text)
    names = []
    for file in sorted((ROOT / "programs").glob("*.nc")):
        name = to.write(f"programs/{file.name}", file.read_bytes().decode())
        names.append(name)
        for machine in MACHINES:
            to.check(name, f"--machine {machine}", EVERY_FILE)
        for machine in MACHINES[1:]:
            to.check(name, f"--machine machines/{machine}-large.toml", EVERY_FILE)
        for algorithm in ALGORITHMS:
            to.check(name, f"--algorithm {algorithm}", ("pulses",))
        paper = "machines/paper-nurbs-large.toml"
        to.check(name, f"--machine {paper} --algorithm half-step", ("pulses",))
        for machine in ("default", paper):
            to.check(name, f"--machine {machine} --interpolator sampled", ("trace", "pulses"))
        for dialect in DIALECTS:
            to.check(name, f"--dialect {dialect}", ("blocks",))
        to.check(name, "--feed-override 50", ("trace", "pulses", "lines"))
        to.check(name, "--stock X0:100,Y0:60,Z-12:0 --portable grbl,linuxcnc,fanuc", ())
        to.add(f"{name} run", [name, "--yes", "--quiet", "--json", "-"], EVERY_FILE)
        to.add(
            f"{name} run --board file",
            [name, "--yes", "--quiet", "--json", "-", "--board", "file"],
            ("port",),
        )
    for first, second in pairwise(names):
        to.add(f"diff {first} {second}", ["diff", first, second, "--json", "-", "--quiet"], ())


# Random programs


def _random(to: Collection) -> None:
    """Add programs of the generators; most of those of the grammar are rejected."""
    for seed in range(FUZZED):
        made = fuzzing.Author(seed).program()
        name = to.write(f"random/language-{seed}.nc", "\n".join(made.lines))
        to.check(
            name,
            f"--machine machines/{''.join(made.axes)}.toml --dialect {made.dialect}",
            ("blocks",),
        )
    for seed in range(FLOWS):
        words = flow_writers.OWords(flow_author.Author(seed).program(), seed).text()
        name = to.write(f"random/o-words-{seed}.nc", "\n".join(words))
        to.check(name, "--machine machines/xyz.toml --dialect linuxcnc", EVERY_FILE)
        macros = flow_writers.MacroB(
            flow_author.Author(seed, most_loops=3, repeats=False).program(), seed
        ).text()
        name = to.write(f"random/macro-b-{seed}.nc", "\n".join(macros))
        to.check(name, "--machine machines/xyz.toml --dialect fanuc", EVERY_FILE)
    for seed in range(MOVES):
        name = to.write(f"random/moves-{seed}.nc", random_program(seed))
        to.check(name, "--machine default", EVERY_FILE)
    for seed in range(GEOMETRIES):
        name = to.write(f"random/geometry-{seed}.nc", "\n".join(geometry(seed).lines) + "\n")
        to.check(name, "--machine machines/xyz.toml", ("blocks", "pulses", "lines"))
    for seed in range(JOBS):
        text, machine = random_job(seed)
        name = to.write(f"random/job-{seed}.nc", text)
        to.write(
            f"random/job-{seed}.toml",
            _toml(machine.model_dump(exclude_none=True, exclude_defaults=True)),
        )
        to.check(name, f"--machine random/job-{seed}.toml", EVERY_FILE)


def _toml(table: dict[str, Any], above: str = "") -> str:
    """Return a nested dict of numbers as TOML."""
    lines = [f"{key} = {value!r}" for key, value in table.items() if not isinstance(value, dict)]
    for key, value in table.items():
        if isinstance(value, dict):
            lines.append(f"[{above}{key}]\n{_toml(value, f'{above}{key}.')}")
    return "\n".join(lines)


# The tables of the language


def _errors(to: Collection) -> None:
    """Add all programs with a marked column, from test modules and errors.txt, in each dialect."""
    marked = {text: False for file in sorted(TESTS.rglob("test_*.py")) for text in _marked_of(file)}
    for _, _, code, text in test_malformed.ERRORS:
        marked[text] = code == "tool-table-missing"
    if len(marked) < FEWEST_ERRORS:
        raise ValueError(f"only {len(marked)} marked programs were found")
    for number, (text, without_tools) in enumerate(sorted(marked.items())):
        folder = "errors-without-tools" if without_tools else "errors"
        to.write(f"{folder}/{number:04}.nc", text.replace(MARK, ""))
    # One command line for many programs: reading its options takes longer than a short program.
    for dialect in DIALECTS:
        to.check("errors", f"--machine machines/xyz.toml --jobs 1 --dialect {dialect}", ())
    to.check("errors-without-tools", "--machine machines/no-tools.toml --jobs 1", ())


def _marked_of(file: Path) -> Iterator[str]:
    """Yield the marked programs of a test module: of its tables, parameters and test functions."""
    source = file.read_text(encoding="utf-8")
    if MARK not in source:
        return
    module = importlib.import_module(".".join(file.relative_to(ROOT).with_suffix("").parts))
    yield from _marked_in([value for key, value in vars(module).items() if key[:2] != "__"])
    for test in _tests_of(module):
        yield from _marked_in([mark.args for mark in getattr(test, "pytestmark", ())])
    # Text inside test functions. A part of a longer expression is not a whole program.
    nodes = [node for node in ast.walk(ast.parse(source)) if isinstance(node, TEXT)]
    parts = {id(part) for node in nodes for part in ast.walk(node) if part is not node}
    for node in nodes:
        if id(node) not in parts and MARK in ast.unparse(node):
            # An expression with local variables has no value here.
            with suppress(NameError):
                yield from _marked_in(eval(ast.unparse(node), vars(module)))


def _tests_of(module: ModuleType) -> list[Any]:
    """Return the test functions of a module."""
    return [value for key, value in vars(module).items() if key.startswith("test_")]


def _marked_in(value: Any) -> Iterator[str]:
    """Yield the marked programs in a value; a mark alone is none."""
    if isinstance(value, str):
        if MARK in value.strip() and value.strip() != MARK:
            yield value
    elif isinstance(value, dict):
        yield from _marked_in(list(value.values()))
    elif isinstance(value, list | tuple):
        for each in value:
            yield from _marked_in(each)


def _language(to: Collection) -> None:
    """Add the programs of language.txt in their dialects."""
    pairs = [(case, each) for case in test_language_programs.CASES for each in case.in_dialects()]
    for case, dialect in pairs:
        source = f"%\n{case.source}\n%"
        name = f"language/{case.line}.nc"
        if not (to.folder / name).exists():
            to.write(name, source)
        to.check(name, f"--machine machines/xyz.toml --dialect {dialect}", EVERY_FILE)
