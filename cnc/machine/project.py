"""The project file ``cncrun.toml``: which machine, dialect, findings and style hold for a program.

    machine = "machines/mill.toml"

    [[programs]]
    files = ["lathe/**/*.nc"]
    machine = "machines/lathe.toml"
    ignore = ["feed-unreachable"]

It is found upwards from the program: the first folder with a ``cncrun.toml``, or with a
``pyproject.toml`` that has ``[tool.cncrun]``. Keys at the top hold for all programs. Of the tables
``[[programs]]`` each holds for the files that it names, and the last one with a key counts. Codes
to ignore add up. An option on the command line counts more than the file.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import BeforeValidator, Field, ValidationError

from cnc.machine.load import (
    section_schema,
    shipped_machines,
    toml_error,
    validation_error,
    value_error,
)
from cnc.model.choices import DialectName, TextStyle, ToolLengths, UnknownCodes
from cnc.model.diagnostics import Diagnostic, MachineFileError
from cnc.model.section import Positive, Section, as_tuple

FILE, SHARED_FILE = "cncrun.toml", "pyproject.toml"
Names = Annotated[tuple[str, ...], BeforeValidator(as_tuple)]


class Settings(Section):
    """What holds for some programs. A key that is left out stays as it is."""

    machine: str | None = Field(
        default=None,
        description="Machine file, relative to the project file, or the name of a shipped one.",
    )
    dialect: DialectName | None = Field(default=None, description="How to read the programs.")
    tool_table: str | None = Field(
        default=None, description="File with the tool table, in place of the machine file's."
    )
    stock: str | None = Field(
        default=None, description="The raw part, as for --stock: X0:100,Y0:60,Z-12:0."
    )
    tool_lengths: ToolLengths | None = Field(
        default=None, description="Without a tool table: table refuses, zero takes 0."
    )
    unknown_codes: UnknownCodes | None = Field(
        default=None, description="M-codes that no dialect knows: error or warn."
    )
    default_feed: Positive | None = Field(
        default=None, description="Feed before the first F word, mm/min."
    )
    select: Names | None = Field(
        default=None, description="Of the warnings and notes, report only these codes."
    )
    ignore: Names | None = Field(default=None, description="Codes that are not reported.")
    errors: Names | None = Field(
        default=None, description="Codes of warnings and notes that count as errors."
    )
    style: TextStyle | None = Field(
        default=None, description="Form that cncrun format writes: readable or compact."
    )


class Programs(Settings):
    """A table ``[[programs]]``."""

    files: Names = Field(
        description="Patterns of files below the folder of the project file: lathe/*.nc, **/*.tap."
    )


class ProjectFile(Settings):
    """The whole file."""

    jobs: Annotated[int, Field(ge=1)] | None = Field(
        default=None, description="Number of programs to check at once."
    )
    programs: Annotated[tuple[Programs, ...], BeforeValidator(as_tuple)] = Field(
        default=(), description="What holds for some of the programs."
    )


class Held(NamedTuple):
    """A setting that holds for a program.

    Attributes:
        value: its value; names of files are absolute.
        origin: where it comes from, for people.
    """

    value: Any
    origin: str


@dataclass(frozen=True)
class Project:
    """A project file.

    Attributes:
        path: the file.
        content: its keys.
    """

    path: Path
    content: ProjectFile

    def settings(self, program: Path) -> dict[str, Held]:
        """Return the settings that hold for a program, by their keys."""
        held: dict[str, Held] = {}
        for table, origin in self._tables(program):
            for key in Settings.model_fields:
                value = getattr(table, key)
                if value is None:
                    continue
                if key in ("machine", "tool_table"):
                    value = self._file(value)
                if key in ("ignore", "errors") and key in held:
                    value = tuple(dict.fromkeys((*held[key].value, *value)))
                    held[key] = Held(value, f"{held[key].origin}; {origin}")
                else:
                    held[key] = Held(value, origin)
        return held

    def _tables(self, program: Path) -> Iterator[tuple[Settings, str]]:
        """Yield the tables that hold for a program, and their origins; the last one counts."""
        yield self.content, str(self.path)
        name = program.resolve().relative_to(self.path.parent).as_posix()
        for table in self.content.programs:
            pattern = next((text for text in table.files if _expression(text).fullmatch(name)), "")
            if pattern:
                yield table, f"{self.path}, [[programs]] with {pattern}"

    def _file(self, name: str) -> str:
        """Return a file beside the project file; the name itself where there is none."""
        beside = self.path.parent / name
        return str(beside) if beside.exists() else name


def project_of(program: Path) -> Project | None:
    """Return the project of a program; None if no folder around it has a project file.

    Raises:
        MachineFileError: The project file is not readable, is not TOML, or has a wrong key.
    """
    return _project_in(program.resolve().parent)


def forget_projects() -> None:
    """Read the project files again when they are needed next: one of them has changed."""
    _project_in.cache_clear()


@cache
def _project_in(folder: Path) -> Project | None:
    for place in (folder, *folder.parents):
        for file in (place / FILE, place / SHARED_FILE):
            if file.is_file() and (project := _loaded(file)) is not None:
                return project
    return None


def _loaded(file: Path) -> Project | None:
    """Return a project file; None for a ``pyproject.toml`` without ``[tool.cncrun]``."""
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        message = f"the project file is not readable: {error}"
        finding = Diagnostic("project-file-unreadable", message, file=str(file))
        raise MachineFileError(finding) from None
    try:
        tables = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        if file.name == SHARED_FILE:
            return None  # other tools say so
        raise toml_error(file, text, str(error), "project-file-syntax") from None
    table: tuple[str, ...] = ()
    if file.name == SHARED_FILE:
        tables, table = tables.get("tool", {}).get("cncrun"), ("tool", "cncrun")
        if tables is None:
            return None
    try:
        content = ProjectFile.model_validate(tables)
    except ValidationError as error:
        names = (*ProjectFile.model_fields, "files")
        raise validation_error(file, text, error, table, names=names, code="project-file") from None
    _check_files(file, text, content, table)
    for number, programs in enumerate(content.programs):
        _check_files(file, _from_table(text, number), programs, (*table, "programs"))
    return Project(file, content)


def _from_table(text: str, number: int) -> str:
    """Return a text with its lines before a table ``[[programs]]`` empty; the first is 0."""
    lines = text.splitlines()
    heads = [k for k, line in enumerate(lines) if re.match(r"\s*\[\[[^\]]*programs\s*\]\]", line)]
    before = heads[number] if number < len(heads) else 0
    return "\n" * before + "\n".join(lines[before:])


def _check_files(file: Path, text: str, settings: Settings, table: tuple[str, ...]) -> None:
    for key in ("machine", "tool_table"):
        _check_file(file, text, (*table, key), getattr(settings, key))


def _check_file(file: Path, text: str, key: tuple[str, ...], name: str | None) -> None:
    """Raise MachineFileError if a key names a file that is not there."""
    is_shipped = key[-1] == "machine" and name in shipped_machines()
    if name is not None and not is_shipped and not (file.parent / name).is_file():
        message = f"there is no {file.parent / name}"
        raise value_error(file, text, key, message, code="project-file")


@cache
def _expression(pattern: str) -> re.Pattern[str]:
    """Return a pattern of files as a regular expression: ``**/`` stands for any folders."""
    pattern = pattern.removeprefix("./")
    if pattern.endswith("/"):
        pattern += "**"
    parts = re.split(r"(\*\*/|\*\*|\*|\?)", pattern)
    meanings = {"**/": "(?:.*/)?", "**": ".*", "*": "[^/]*", "?": "[^/]"}
    return re.compile("".join(meanings.get(part, re.escape(part)) for part in parts))


def project_schema() -> dict[str, Any]:
    """Return the JSON Schema of a project file."""
    return section_schema(ProjectFile, "The project file of cncrun")
