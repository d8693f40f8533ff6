"""Loading of machine files, with errors that name file, key and line."""

from __future__ import annotations

import difflib
import re
import tomllib
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from cnc.machine.board import Board
from cnc.machine.consistency import inconsistencies
from cnc.machine.kinematics import KINEMATICS, OF_TIP
from cnc.machine.klipper import KlipperAxis, KlipperBoard, KlipperSpindle, TrinamicDriver
from cnc.machine.locate import locate
from cnc.machine.models import (
    Axis,
    Header,
    Homing,
    HomingOrder,
    Machine,
    PathLimits,
    Stock,
)
from cnc.machine.motors import Motor
from cnc.machine.program import Program
from cnc.machine.program_codes import with_absolute_files
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.diagnostics import Diagnostic, MachineFileError
from cnc.model.section import Section

DEFAULT = "default"

_MESSAGES: dict[str, str] = {
    "missing": "is missing",
    "greater_than": "must be greater than {gt:g}",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than_equal": "must be at most {le:g}",
    "finite_number": "must be a finite number",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "bool_type": "must be true or false",
    "string_type": "must be text in quotes",
    "string_too_short": "must not be empty",
    "tuple_type": "must be a list",
    "dict_type": "must be a table",
    "model_type": "must be a table",
    "literal_error": "must be one of {expected}",
    "path_type": "must be the name of a file in quotes",
    "is_instance_of": "must be the name of a file in quotes",
    "too_long": "must have at most {max_length} values",
    "too_short": "must have at least {min_length} value(s)",
}
"""Messages for the error types of pydantic, without its terms."""

_SECTIONS: dict[str, type[Section]] = {
    "machine": Header,
    "path": PathLimits,
    "board": Board,
    "program": Program,
    "homing": HomingOrder,
    "stock": Stock,
}


def shipped_folder() -> Traversable:
    """Return the folder of the shipped machine files.

    An installed package contains it, also inside a zip file. In a checkout it is next to the
    package.
    """
    package = resources.files("cnc")
    inside = package / "config"
    return inside if inside.is_dir() else Path(str(package)).parent / "config"


def shipped_machines() -> dict[str, Traversable]:
    """Return the name and the file of each shipped machine."""
    files = sorted(shipped_folder().iterdir(), key=lambda file: file.name)
    return {file.name.removesuffix(".toml"): file for file in files if file.name.endswith(".toml")}


def load_machine(path: Path | str | None = None) -> Machine:
    """Load a machine.

    Args:
        path: Machine file, or the name of a shipped one such as ``paper-nurbs``. None is the
            shipped default.

    Raises:
        MachineFileError: The file is not readable, is not TOML, or does not describe a machine. The
            message names file, key and line.
    """
    file = _resolve(path)
    text = _read(file)
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _toml_error(file, text, str(error)) from None
    except RecursionError:
        depths = [line.count("[") + line.count("{") for line in text.splitlines()]
        place = f"(at line {depths.index(max(depths)) + 1}, column 1)"
        raise _toml_error(file, text, f"lists or tables are nested too deeply {place}") from None
    try:
        header = Header.model_validate(tables.pop("machine", {}))
    except ValidationError as error:
        raise _validation_error(file, text, error, ("machine",)) from None
    for key in (*Header.model_fields, "file"):
        if key in tables:
            hint = "remove it" if key == "file" else f"put the {key} into [machine]"
            raise _error(file, text, (key,), "there is no such key", hint)
    _complete_axes(file, text, tables)
    try:
        machine = Machine.model_validate({**header.model_dump(), "file": str(file), **tables})
    except ValidationError as error:
        raise _validation_error(file, text, error) from None
    for wrong in inconsistencies(machine):
        raise _error(file, text, wrong.key, wrong.message, wrong.hint)
    return _with_absolute_files(machine, file, text)


def _complete_axes(file: Traversable, text: str, tables: dict[str, Any]) -> None:
    """Give the axes that joints move the scale and the speed of the fastest of these joints.

    Tables of a wrong form are left for the validation.
    """
    kinematics, axes, joints = (tables.get(name) for name in ("kinematics", "axes", "joints"))
    if not isinstance(kinematics, dict) or not isinstance(axes, dict):
        return
    kinds = {kind: model for model in KINEMATICS for kind in model.kinds()}
    if "type" in kinematics and kinematics["type"] not in kinds:
        message = f"must be one of {', '.join(kinds)}, not {_toml(kinematics['type'])}"
        raise _error(file, text, ("kinematics", "type"), message)
    model = kinds.get(kinematics.get("type", "cartesian"))
    given = [joint for joint in (joints or {}).values() if isinstance(joint, dict)]
    moved, movers = model.moved_in(kinematics) if model is not None else ((), ())
    for letter in moved:
        table = axes.get(letter)
        if not isinstance(table, dict):
            continue
        for key in table:
            if key in Axis.model_fields and key not in OF_TIP:
                hint = f"write it into [joints.{movers[0]}] and its fellows" if movers else ""
                message = "belongs to the joints that move this axis"
                raise _error(file, text, ("axes", letter, key), message, hint)
        for key in ("steps_per_mm", "max_velocity"):
            values = [joint.get(key) for joint in given]
            numbers = [float(value) for value in values if isinstance(value, int | float)]
            table[key] = max(numbers, default=1.0)


def is_default(machine: Machine) -> bool:
    """Return whether a machine is the shipped default, so perhaps not the user's own."""
    return machine.file == str(shipped_machines()[DEFAULT])


def _resolve(path: Path | str | None) -> Traversable:
    """Return the file at ``path`` if it exists, else the shipped machine of that name."""
    machines = shipped_machines()
    if path is None:
        return machines[DEFAULT]
    file = Path(path)
    if not file.exists() and str(path) in machines:
        return machines[str(path)]
    return file


def _read(file: Traversable) -> str:
    try:
        return file.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        code, message = "no-such-file", "there is no such machine file"
    except UnicodeDecodeError:
        code, message = "machine-file-encoding", "the machine file is not UTF-8 text"
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        code, message = "machine-file-unreadable", f"the machine file is not readable: {reason}"
    hint = f"shipped machines: {', '.join(shipped_machines())}" if code == "no-such-file" else ""
    raise MachineFileError(Diagnostic(code, message, file=str(file), hint=hint))


def error_in(machine: Machine, key: tuple[str, ...], message: str, hint: str) -> MachineFileError:
    """Return an error in the file of a machine, such as one that only the board can tell.

    Args:
        machine: The machine.
        key: Full path of the key.
        message: The problem.
        hint: The remedy.
    """
    file = Path(machine.file)
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, ValueError):
        text = ""
    return _error(file, text, key, message, hint)


def _toml_error(file: Traversable, text: str, message: str) -> MachineFileError:
    """Return the TOML parser's message, with the location as line and column instead of words."""
    match = re.search(r" \(at (?:line (\d+), column (\d+)|end of document)\)", message)
    lines = text.splitlines()
    line, column = (int(match[1]), int(match[2])) if match and match[1] else (max(len(lines), 1), 0)
    return MachineFileError(
        Diagnostic(
            "machine-file-syntax",
            message[: match.start()] if match else message,
            file=str(file),
            line=line,
            column=column,
            text=lines[line - 1] if line <= len(lines) else "",
            hint="the machine file is TOML: [table] lines, and key = value with text in quotes",
        )
    )


def _error(
    file: Traversable,
    text: str,
    key: tuple[str, ...],
    message: str,
    hint: str = "",
    code: str = "machine-file",
) -> MachineFileError:
    place = locate(text, key)
    return MachineFileError(
        Diagnostic(
            code,
            f"{'.'.join(key)}: {message}",
            file=str(file),
            line=place.line if place else 0,
            column=place.column if place else 0,
            length=place.length if place else 1,
            text=place.text if place else "",
            hint=hint,
        )
    )


def _validation_error(
    file: Traversable, text: str, error: ValidationError, table: tuple[str, ...] = ()
) -> MachineFileError:
    """Return the first of pydantic's errors with a message in plain terms.

    Unknown keys come first, because a misspelt key is reported as a missing key, too.
    """
    found = sorted(error.errors(include_url=False), key=lambda e: not _is_unknown_key(e))[0]
    # pydantic appends its own locations to the key (an index, "[key]"); users see the keys only.
    key = table + tuple(part for part in found["loc"] if isinstance(part, str) and part != "[key]")
    if key[0] == "kinematics" and len(key) > 2:
        key = ("kinematics", *key[2:])  # pydantic names the type of the kinematics, too
    if _is_unknown_key(found):
        return _unknown_key(file, text, key)
    kind = found["type"]
    context = found.get("ctx", {})
    if kind == "union_tag_not_found":
        kinds = ", ".join(kind for model in KINEMATICS for kind in model.kinds())
        return _error(file, text, ("kinematics",), f"type is missing: {kinds}")
    if kind == "value_error":
        message = str(context["error"])
    elif kind == "missing" and isinstance(found["loc"][-1], int):
        pair = "must be [lowest, highest]"
        message = "has too few numbers" if key[0] == "kinematics" else pair
    elif kind in _MESSAGES:
        message = _MESSAGES[kind].format(**context)
    else:
        message = found["msg"]
    if kind != "missing" and isinstance(found["input"], str | int | float):
        message += f", not {_toml(found['input'])}"
    return _error(file, text, key, message)


def _is_unknown_key(error: Any) -> bool:
    return bool(error["type"] == "extra_forbidden" or error["loc"][-1:] == ("[key]",))


def _toml(value: str | int | float) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else str(value)


def _unknown_key(file: Traversable, text: str, key: tuple[str, ...]) -> MachineFileError:
    known: list[str]
    if len(key) == 1:
        known = [
            "machine",
            *(each for each in Machine.model_fields if each not in (*Header.model_fields, "file")),
        ]
    elif key[0] == "kinematics":
        fields = [*dict.fromkeys(field for model in KINEMATICS for field in model.model_fields)]
        known = fields
    elif key[0] in ("axes", "joints"):
        if len(key) > 3:
            known = list((Motor if key[2] == "motors" else Homing).model_fields)
        else:
            known = list(Axis.model_fields if len(key) > 2 else AXIS_LETTERS)
    else:
        known = list(_section(key).model_fields)
    close = difflib.get_close_matches(key[-1].lower(), known, n=1, cutoff=0.6)
    hint = f"did you mean {close[0]}?" if close else f"known keys: {', '.join(known)}"
    return _error(file, text, key, "there is no such key", hint)


def _section(key: tuple[str, ...]) -> type[Section]:
    """Return the model of the table in which a key stands."""
    if key[:2] != ("board", "klipper") or len(key) == 2:
        return _SECTIONS[key[0]]
    if len(key) == 3:
        return KlipperBoard
    if key[2] == "spindle":
        return KlipperSpindle
    return TrinamicDriver if key[3] == "driver" and len(key) > 4 else KlipperAxis


def _with_absolute_files(machine: Machine, file: Traversable, text: str) -> Machine:
    """Return the machine with absolute file names in [program]; the files must exist."""
    program = machine.program
    if not isinstance(file, Path):
        return machine  # A machine file in a zip file names no other files.
    folder = file.resolve().parent
    for key, path in program.files():
        if not (folder / path).exists():
            raise _error(file, text, ("program", key), f"there is no {folder / path}")
    absolute = program.model_copy(
        update={
            "tool_table": program.tool_table and folder / program.tool_table,
            "parameters": program.parameters and folder / program.parameters,
            "subroutines": tuple(folder / path for path in program.subroutines),
            "codes": with_absolute_files(program.codes, folder),
        }
    )
    return machine.model_copy(update={"program": absolute})
