"""Probing cycles: subroutine files that the normal interpreter runs, with their parameters.

A cycle is a file ``NAME.ngc`` of a subroutine folder, whose head describes it:

    ( Z by a plate: sets Z of the present coordinate system )
    ( #1 thickness = 10 : thickness of the plate, mm )
    ( #2 side = 1 : side of the part; 1 = towards plus, -1 = towards minus )
    o<probe_z> sub

The files of this package are in ``programs/probing``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from cnc.machine.models import Machine
from cnc.model.diagnostics import Diagnostic, UsageError

_TITLE = re.compile(r"\(\s*(.*?)\s*\)\s*")
_PARAMETER = re.compile(r"\(\s*#(\d+)\s+(\w+)\s*=\s*([-+]?[0-9.]+)\s*:\s*(.*?)\s*\)\s*", re.ASCII)
_CHOICE = re.compile(r"([-+]?[0-9.]+) = ([^,;]+)", re.ASCII)
MOST_HEAD = 40
"""Lines in which the head of a file is searched."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of a cycle.

    Attributes:
        name: Its name.
        title: Its meaning and unit.
        default: Its value where none is given.
        choices: Its only values and their meanings; none if it may have any value.
    """

    name: str
    title: str
    default: float
    choices: tuple[tuple[float, str], ...] = ()


@dataclass(frozen=True, slots=True)
class Cycle:
    """A probing cycle.

    Attributes:
        name: Its name, that of the file and of the subroutine.
        title: What it does.
        parameters: In the order of the call.
    """

    name: str
    title: str
    parameters: tuple[Parameter, ...]


def shipped_cycles() -> Path:
    """Return the folder of the cycles of this package."""
    package = Path(str(resources.files("cnc")))
    inside = package / "probing"
    return inside if inside.is_dir() else package.parent / "programs" / "probing"


def cycles(machine: Machine) -> list[Cycle]:
    """Return the cycles of the machine's subroutine folders, by name; a first folder wins."""
    by_name: dict[str, Cycle] = {}
    for folder in machine.program.subroutines:
        for file in sorted(Path(folder).glob("*.ngc")):
            cycle = _read(file)
            if cycle is not None:
                by_name.setdefault(cycle.name, cycle)
    return [by_name[name] for name in sorted(by_name)]


def mdi_line(name: str, values: Mapping[str, float], machine: Machine) -> str:
    """Return the line that calls a cycle.

    Raises:
        UsageError: ``no-such-cycle``, ``cycle-parameter``.
    """
    by_name = {cycle.name: cycle for cycle in cycles(machine)}
    if name not in by_name:
        hint = f"cycles are {', '.join(by_name) or 'none'}"
        raise UsageError(
            Diagnostic("no-such-cycle", f"there is no probing cycle {name}", hint=hint)
        )
    cycle = by_name[name]
    names = [arguments.name for arguments in cycle.parameters]
    for given, value in values.items():
        if given not in names or not math.isfinite(value):
            message = f"the cycle {name} has no parameter {given}, or {value!r} is not a number"
            hint = f"its parameters are {', '.join(names) or 'none'}"
            raise UsageError(Diagnostic("cycle-parameter", message, hint=hint))
        choices = dict(cycle.parameters[names.index(given)].choices)
        if choices and value not in choices:
            message = f"{given} of the cycle {name} is not {value:g}"
            meanings = [f"{number:g} ({text})" for number, text in choices.items()]
            hint = f"give {' or '.join(meanings)}"
            raise UsageError(Diagnostic("cycle-parameter", message, hint=hint))
    arguments = (values.get(parameter.name, parameter.default) for parameter in cycle.parameters)
    return " ".join([f"o<{name}> call", *(f"[{value:.6f}]" for value in arguments)])


def _read(file: Path) -> Cycle | None:
    """Return the cycle of a file; None for a file without a head."""
    try:
        with file.open(encoding="utf-8") as source:
            head = [line.strip() for _, line in zip(range(MOST_HEAD), source, strict=False)]
    except (OSError, UnicodeDecodeError):
        return None
    title = _TITLE.fullmatch(head[0]) if head else None
    if title is None:
        return None
    parameters: dict[int, Parameter] = {}
    for line in head[1:]:
        if not (match := _PARAMETER.fullmatch(line)):
            break
        title_of, _, choices = match[4].partition("; ")
        values = tuple((float(value), text.strip()) for value, text in _CHOICE.findall(choices))
        parameters[int(match[1])] = Parameter(match[2], title_of, float(match[3]), values)
    return Cycle(file.stem, title[1], tuple(parameters[number] for number in sorted(parameters)))
