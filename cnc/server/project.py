"""The project file around the library: how its jobs are read, and which findings count.

The machine and the tool table are those of the console, which shows them. Where the project file
names others for a job, its check says so.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from cnc.checks.selection import Selection
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.machine.project import Held, forget_projects, project_of
from cnc.model.diagnostics import Diagnostic
from cnc.session.options import RunOptions

READING = ("dialect", "tool_lengths", "unknown_codes", "default_feed")
"""Settings of the project file that are options of a run."""


class JobSettings(NamedTuple):
    """What holds for a job.

    Attributes:
        options: how it is read, and the findings that count.
        stock: its raw part, such as ``X0:100,Y0:60,Z-12:0``; empty for that of the machine file.
        findings: what the project file names, and the console does not follow.
    """

    options: RunOptions
    stock: str
    findings: tuple[Diagnostic, ...]


def settings_of(file: Path, machine: Machine, options: RunOptions | None = None) -> JobSettings:
    """Return what holds for a job by the project file as it is now.

    Args:
        file: the job.
        machine: that of the console.
        options: further options; the project file does not change them.

    Raises:
        MachineFileError: the project file is damaged.
        UsageError: ``unknown-finding``.
    """
    options = options or RunOptions()
    forget_projects()
    project = project_of(file)
    if project is None:
        return JobSettings(options, "", ())
    held = project.settings(file)
    selected = {
        key: frozenset(held[key].value) for key in ("select", "ignore", "errors") if key in held
    }
    read = {key: held[key].value for key in READING if key in held}
    stock = held["stock"].value if "stock" in held else ""
    options = replace(options, selection=Selection(**selected), **read)
    return JobSettings(options, stock, tuple(_not_followed(file.name, machine, held)))


def _not_followed(job: str, machine: Machine, held: dict[str, Held]) -> list[Diagnostic]:
    """Return a warning for the machine or the tool table, if the console has another one."""
    table = machine.program.tool_table
    own: dict[str, tuple[str, Callable[[str], str]]] = {
        "machine": (machine.file, lambda name: load_machine(name).file),
        "tool_table": (str(table or ""), str),
    }
    findings = []
    for key, (used, file_of) in own.items():
        if key in held and _place(file_of(held[key].value)) != _place(used):
            what = key.replace("_", " ")
            message = (
                f"{held[key].origin} has the {what} {held[key].value} for {job}; "
                f"this console has {used or f'no {what}'}"
            )
            hint = "start the console with that machine file, or change the project file"
            warning = Diagnostic("project-machine", message, job, hint=hint, severity="warning")
            findings.append(warning)
    return findings


def _place(name: str) -> Any:
    return Path(name).resolve() if name else None
