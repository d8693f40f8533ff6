"""Options of a command for one program: those of the command line, then those of its project."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cnc.checks.selection import check_codes
from cnc.cli.options import CheckOptions, CommonOptions
from cnc.machine.load import load_machine, value_error, with_stock
from cnc.machine.models import Machine
from cnc.machine.project import Held, Project, project_of
from cnc.model.choices import TextStyle
from cnc.model.diagnostics import UsageError, printable

LISTED = ("select", "ignore", "errors")
"""Settings that are lists of codes."""


@dataclass(frozen=True)
class ProgramOptions:
    """The options that hold for a program.

    Attributes:
        machine: the machine, with tool table and raw part.
        common: the options of run, check and view.
        check: the options of a check.
        style: the form of the text.
    """

    machine: Machine
    common: CommonOptions
    check: CheckOptions
    style: TextStyle


def options_of(
    program: str, common: CommonOptions, check: CheckOptions | None = None
) -> ProgramOptions:
    """Return the options of a command for a program.

    Args:
        program: the program. Standard input belongs to the working folder.
        common: options of the command line.
        check: further ones.

    Raises:
        MachineFileError: the machine file or the project file is wrong.
        UsageError: ``stock-malformed``.
    """
    check = check or CheckOptions()
    held = _settings(program)

    def value(key: str, given: Any) -> Any:
        return held[key].value if given is None and key in held else given

    common = replace(
        common,
        **{
            key: value(key, getattr(common, key))
            for key in ("machine", "dialect", "tool_lengths", "unknown_codes", "default_feed")
        },
    )
    codes = {key: tuple(held[key].value) if key in held else () for key in LISTED}
    check = replace(
        check,
        select=check.select or codes["select"],
        ignore=(*check.ignore, *codes["ignore"]),
        errors=frozenset(codes["errors"]),
        stock=value("stock", check.stock),
    )
    machine = load_machine(common.machine)
    if "tool_table" in held:
        table = {"tool_table": Path(held["tool_table"].value)}
        machine = machine.model_copy(update={"program": machine.program.model_copy(update=table)})
    if check.stock is not None:
        machine = with_stock(machine, check.stock)
    return ProgramOptions(machine, common, check, value("style", None) or machine.program.style)


def _settings(program: str) -> dict[str, Held]:
    project = project_of(Path(program))
    if project is None:
        return {}
    held = project.settings(Path(program))
    for key in LISTED:
        if key in held:
            _check_codes(project, key, held[key].value)
    return held


def _check_codes(project: Project, key: str, codes: tuple[str, ...]) -> None:
    """Raise MachineFileError for a code that no warning or note has."""
    try:
        check_codes(codes)
    except UsageError as error:
        finding = error.diagnostic
        text = project.path.read_text(encoding="utf-8-sig")
        raise value_error(
            project.path, text, (key,), finding.message, finding.hint, "project-file"
        ) from None


def jobs_of(program: str) -> int | None:
    """Return the number of programs that the project of a program wants to check at once."""
    project = project_of(Path(program))
    return None if project is None else project.content.jobs


def described(program: str) -> list[str]:
    """Return the settings that hold for a program, a line each: key, value, and why."""
    held = _settings(program)
    options = options_of(program, CommonOptions())
    rows = [("machine", options.machine.file, "the shipped default machine")]
    own = options.machine.program
    rows += [
        (key, str(getattr(own, key)), "the machine file")
        for key in ("dialect", "style", "tool_table")
        if key in own.model_fields_set and getattr(own, key) is not None
    ]
    shown = {key: (value, origin) for key, value, origin in rows}
    for key, (value, origin) in held.items():
        text = ", ".join(value) if isinstance(value, tuple) else str(value)
        shown[key] = (text, origin)
    width = max(map(len, shown))
    longest = max(len(value) for value, _ in shown.values())
    return [
        printable(f"{key:<{width}}  {value:<{longest}}  {origin}")
        for key, (value, origin) in shown.items()
    ]


def machine_of(folder: Path) -> str | None:
    """Return the machine that a project file has for all programs of a folder; None for none.

    Raises:
        MachineFileError: as :func:`project_of`.
    """
    program = folder / "any program"
    project = project_of(program)
    held = {} if project is None else project.settings(program)
    return held["machine"].value if "machine" in held else None
