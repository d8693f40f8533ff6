"""Changes of keys in the text of a machine file; everything else stays as it is.

The text is changed line by line, and the result is proved: read again, it has the old keys with the
changes, and nothing else.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from cnc.machine.compensation import ErrorPoint
from cnc.machine.load import machine_of_text, shipped_machines
from cnc.machine.models import Machine
from cnc.measure.procedures import KeyValue, Measured
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.session.required_capabilities import takes_lines

Path_ = tuple[str, ...]
Value = KeyValue
_HEADER = re.compile(r"\s*\[\s*([\w.\s\"'-]+?)\s*\]\s*(#.*)?")
_ANY_HEADER = re.compile(r"\s*\[")


@dataclass(frozen=True, slots=True)
class Change:
    """The change of a machine file by a measurement.

    Attributes:
        file: The machine file.
        keys: Values by the path of their keys; None takes a key away.
        remark: The comment behind the new values.
        table: The file of the error table that a key names; None without one.
        rows: Its text.
        refusal: Why nothing is written, with what to do; "" where it can be written.
    """

    file: Path
    keys: Mapping[Path_, Value]
    remark: str
    table: Path | None
    rows: str
    refusal: str

    @classmethod
    def of(cls, measured: Measured, machine: Machine) -> Change:
        """Return the change by a measurement of a machine."""
        file = Path(machine.file).resolve()  # a link stays one
        keys, table = dict(measured.keys), None
        remark = f"measured {date.today().isoformat()}: {measured.remark}"
        for path in keys:
            if path[-1] == "error_table":
                table = file.with_name(f"{file.stem}-{path[1]}-errors.csv")
                keys[path] = table.name
        shipped = map(str, shipped_machines().values())
        refusal = ""
        if not keys:
            refusal = "the machine file stays as it is"
        elif not machine.file or not file.is_file() or machine.file in shipped:
            refusal = "write into a machine file of your own:"
        elif takes_lines(machine.board.kind):
            refusal = (
                f"nothing was written: the board {machine.board.kind} plans by itself, so such "
                "keys\nhave no effect there. For a board that plays pulses it would be:"
            )
        return cls(file, keys, remark, table, _csv(measured.table, remark), refusal)

    @property
    def steps(self) -> list[str]:
        """What is changed."""
        steps = [
            f"{'.'.join(path)} = {_shown(value)}" if value is not None else f"no {'.'.join(path)}"
            for path, value in self.keys.items()
        ]
        if self.table is not None and not self.refusal:
            # Without the comment and the heading.
            steps.append(f"{self.table} with {self.rows.count(chr(10)) - 2} rows")
        return steps

    def new_text(self) -> str:
        """Return the new text of the machine file. UsageError ``machine-file-form``."""
        before = self.file.read_bytes().decode()  # with the ends of its lines
        return changed_text(before, self.keys, self.remark)

    def write(self) -> None:
        """Write the machine file and the table, see :func:`write`.

        Raises:
            UsageError: ``machine-file-form``, ``can-not-write``.
            MachineFileError: As :func:`cnc.machine.load.load_machine`, for the new text.
        """
        write(self.file, self.new_text(), {} if self.table is None else {self.table: self.rows})


def _csv(table: Sequence[ErrorPoint], remark: str) -> str:
    """Return the text of an error table."""
    rows = (f"{row.place:g},{row.forward:g},{row.reverse:g}" for row in table)
    return "\n".join([f"# {remark}", "position,forward_error,reverse_error", *rows, ""])


def changed_text(text: str, changes: Mapping[Path_, Value], remark: str) -> str:
    """Return the text of a machine file with other values.

    Args:
        text: The text.
        changes: Values by the path of their keys; None takes a key away.
        remark: A comment for each new value.

    Raises:
        UsageError: ``machine-file-form`` if the file has a form that is not changed here.
    """
    ending = "\r\n" if "\r\n" in text else "\n"
    lines = text.replace("\r\n", "\n").splitlines(keepends=True)
    wanted = tomllib.loads(text)
    for path, value in changes.items():
        _set(wanted, path, value)
        _change(lines, path, value, remark)
    new = "".join(lines).replace("\n", ending)
    with contextlib.suppress(tomllib.TOMLDecodeError):
        if tomllib.loads(new) == wanted:
            return new
    listed = [
        f"{path[-1]} = {_text(value)} in [{'.'.join(path[:-1])}]"
        if value is not None
        else f"no {path[-1]} in [{'.'.join(path[:-1])}]"
        for path, value in changes.items()
    ]
    message = "the machine file has a form that is not changed here"
    hint = f"write into it: {'; '.join(listed)}"
    raise UsageError(Diagnostic("machine-file-form", message, hint=hint))


def write(file: Path, text: str, tables: Mapping[Path, str] | None = None) -> None:
    """Write a machine file, whole or not at all, if it describes a machine.

    Args:
        file: The machine file.
        text: Its new text.
        tables: Texts of the files that it names; they are as before where it is not written.

    Raises:
        MachineFileError: As :func:`cnc.machine.load.load_machine`, for the new text.
        UsageError: ``can-not-write``.
    """
    before = {table: table.read_bytes() if table.is_file() else None for table in tables or {}}
    try:
        for table, rows in (tables or {}).items():
            _replace(table, rows.encode())
        machine_of_text(file, text)
        _replace(file, text.encode())
    except BaseException:
        for table, old in before.items():
            if old is None:
                table.unlink(missing_ok=True)
            else:
                _replace(table, old)
        raise


def _replace(file: Path, data: bytes) -> None:
    """Write a file beside its place, then rename it. UsageError ``can-not-write``."""
    try:
        handle, name = tempfile.mkstemp(dir=file.parent, prefix=f".{file.stem}-")
        new = Path(name)
        try:
            with open(handle, "wb") as opened:
                opened.write(data)
                opened.flush()
                os.fsync(opened.fileno())
            if file.exists():
                shutil.copymode(file, new)
            else:
                new.chmod(0o644)
            new.replace(file)
        finally:
            new.unlink(missing_ok=True)
    except OSError as error:
        message, hint = f"{file} is not writable: {error.strerror}", "check its permissions"
        raise UsageError(Diagnostic("can-not-write", message, hint=hint)) from error


def _set(tables: dict[str, Any], path: Path_, value: Value) -> None:
    for name in path[:-1]:
        tables = tables.setdefault(name, {})
    if value is None:
        tables.pop(path[-1], None)
    else:
        tables[path[-1]] = value


def _shown(value: Value) -> str:
    """Return a value for people: a text without quotes."""
    return value if isinstance(value, str) else _text(value)


def _text(value: Value) -> str:
    """Return a value as TOML."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        rows = (", ".join(f"{name} = {part!r}" for name, part in row.items()) for row in value)
        return f"[{', '.join(f'{{{row}}}' for row in rows)}]"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return f'"{escaped}"'
    return f"{value!r}"


def _change(lines: list[str], path: Path_, value: Value, remark: str) -> None:
    """Change the line of a key, add it behind the last key of its table, or take it away."""
    place = _table(lines, path[:-1])
    if place is None and len(path) > 2 and (outer := _table(lines, path[:-2])) is not None:
        _change_inside(lines, outer, path, value, remark)
        return
    if place is None:
        if value is not None:
            lines += [_ended(lines), f"[{'.'.join(path[:-1])}]\n", _line(path[-1], value, remark)]
        return
    at = _key(lines, place, path[-1])
    if value is None:
        if at is not None:
            del lines[at]
    elif at is not None:
        lines[at] = _line(path[-1], value, remark)
    else:
        lines.insert(_end(lines, place), _line(path[-1], value, remark))


def _change_inside(
    lines: list[str], place: tuple[int, int], path: Path_, value: Value, remark: str
) -> None:
    """Change a key of a table that is written in one line, such as ``squareness = {xy = ...}``."""
    at = _key(lines, place, path[-2])
    inner: dict[str, Any] = {}
    if at is not None:
        with contextlib.suppress(tomllib.TOMLDecodeError):
            inner = dict(tomllib.loads(lines[at])[path[-2]])
    _set(inner, path[-1:], value)
    text = ", ".join(f"{name} = {_text(each)}" for name, each in inner.items())
    line = f"{path[-2]} = {{{text}}}  # {remark}\n"
    if at is None:
        if value is not None:
            lines.insert(_end(lines, place), line)
    elif inner:
        lines[at] = line
    else:
        del lines[at]


def _line(key: str, value: Value, remark: str) -> str:
    return f"{key} = {_text(value)}  # {remark}\n"


def _table(lines: list[str], names: Path_) -> tuple[int, int] | None:
    """Return the first line behind the header of a table, and the line of the next header."""
    for number, line in enumerate(lines):
        match = _HEADER.fullmatch(line.rstrip("\r\n"))
        if match and tuple(part.strip(" \"'") for part in match[1].split(".")) == names:
            after = (k for k in range(number + 1, len(lines)) if _ANY_HEADER.match(lines[k]))
            return number + 1, next(after, len(lines))
    return None


def _key(lines: list[str], place: tuple[int, int], name: str) -> int | None:
    key = re.compile(rf"\s*[\"']?{re.escape(name)}[\"']?\s*=")
    return next((k for k in range(*place) if key.match(lines[k])), None)


def _end(lines: list[str], place: tuple[int, int]) -> int:
    """Return the line behind the last line of a table that has something in it."""
    end = place[1]
    while end > place[0] and not lines[end - 1].split("#")[0].strip():
        end -= 1
    _end_line(lines, end)
    return end


def _end_line(lines: list[str], end: int) -> None:
    if end and not lines[end - 1].endswith("\n"):
        lines[end - 1] += "\n"


def _ended(lines: list[str]) -> str:
    """End the last line, and return an empty one."""
    _end_line(lines, len(lines))
    return "\n"
