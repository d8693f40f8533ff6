"""Loading of machine files: errors by file, key and line, contradictions, the JSON Schema."""

from __future__ import annotations

import difflib
import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, get_args

from pydantic import ValidationError
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from cnc.kinematics.five_axis import FiveAxis
from cnc.machine.compensation import TableError, read_error_table, screw
from cnc.machine.error_map import ErrorMap, read_error_map
from cnc.machine.kinematics import KINEMATICS, OF_TIP, Cartesian
from cnc.machine.models import (
    Axis,
    Header,
    Homing,
    Machine,
    Stock,
    gantry_inconsistencies,
    switch_end,
)
from cnc.machine.program_codes import with_absolute_files
from cnc.model.blocks import AXIS_LETTERS, ROTARY_LETTERS, AxisLetter
from cnc.model.diagnostics import Diagnostic, MachineFileError, UsageError
from cnc.model.section import Inconsistency, Section

# Line and column of a key in a TOML file, for messages.
#
# The TOML parser of the standard library does not give locations. This search reads tables, dotted
# and quoted keys, arrays over several lines and the first level of inline tables. For other keys it
# gives the nearest enclosing table.

_PART = r"""(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')"""
_DOTTED = rf"{_PART}(?:\s*\.\s*{_PART})*"
_TABLE = re.compile(rf"\s*\[{{1,2}}\s*({_DOTTED})\s*\]")
_PAIR = re.compile(rf"\s*({_DOTTED})\s*=")
_INLINE_PAIR = re.compile(rf"[{{,]\s*({_DOTTED})\s*=")
_STRING = re.compile(r'"(?:[^"\\]|\\.)*"|' + r"'[^']*'")


@dataclass(frozen=True, slots=True)
class KeyLocation:
    """Line and column of a key from 1, its length, and the text of the line."""

    line: int
    column: int
    length: int
    text: str


def _parts(dotted: str) -> tuple[str, ...]:
    return tuple(part.strip("\"'") for part in re.findall(_PART, dotted))


def _depth(text: str) -> int:
    """Return the number of unclosed brackets in a value, outside strings and comments."""
    bare = _STRING.sub("", text).split("#", 1)[0]
    return sum((c in "[{") - (c in "]}") for c in bare)


def key_locations(text: str) -> dict[tuple[str, ...], KeyLocation]:
    """Return the location of every key and table of a TOML text, by its full path."""
    locations: dict[tuple[str, ...], KeyLocation] = {}
    table: tuple[str, ...] = ()
    open_brackets = 0
    for number, line in enumerate(text.splitlines(), start=1):
        if open_brackets > 0:
            open_brackets += _depth(line)
            continue
        if heading := _TABLE.match(line):
            table = _parts(heading[1])
            for depth in range(1, len(table) + 1):
                locations.setdefault(
                    table[:depth], KeyLocation(number, heading.start(1) + 1, len(heading[1]), line)
                )
        elif pair := _PAIR.match(line):
            key = table + _parts(pair[1])
            for depth in range(len(table) + 1, len(key) + 1):
                locations.setdefault(
                    key[:depth], KeyLocation(number, pair.start(1) + 1, len(pair[1]), line)
                )
            value = line[pair.end() :]
            if value.lstrip().startswith("{"):
                for inner in _INLINE_PAIR.finditer(line, pair.end()):
                    locations.setdefault(
                        key + _parts(inner[1]),
                        KeyLocation(number, inner.start(1) + 1, len(inner[1]), line),
                    )
            open_brackets = _depth(value)
    return locations


def locate(text: str, key: tuple[str, ...]) -> KeyLocation | None:
    """Return the location of ``key`` or of its nearest enclosing table; None without either."""
    locations = key_locations(text)
    while key:
        if key in locations:
            return locations[key]
        key = key[:-1]
    return None


# Contradictions between keys of a machine file, which each table alone does not show.

ROUNDING = 0.05
"""Distance by which a travel may go beyond the last row of an error table, mm: the errors there."""
RATE_ROUNDING = 1e-12
"""Relative rounding error that the product of a speed and a resolution may have."""


def inconsistencies(machine: Machine) -> Iterator[Inconsistency]:
    """Yield the contradictions between keys; none for a machine that can run."""
    yield from _joint_names(machine)
    yield from _start(machine)
    yield from _compensation(machine)
    for table, name, joint in _motors(machine):
        yield from _axis_limits(machine, table, name, joint)
        pull_off = (joint.homing or Homing()).pull_off
        towards = switch_end(name, joint.homing)
        yield from gantry_inconsistencies((table, name), joint.motors, towards * pull_off)
    if machine.diameters is not None and machine.kind != "lathe":
        yield Inconsistency(
            ("machine", "diameters"), f"the machine is a {machine.kind}", "remove the key"
        )
    for letter, axis in machine.axes.items():
        yield from _homing_position(machine, letter)
        if axis.wrap is not None and letter not in ROTARY_LETTERS:
            yield Inconsistency(
                ("axes", letter, "wrap"), f"{letter} is not a rotary axis", "remove the key"
            )
    for letter in (machine.homing.order or ()) if machine.homing is not None else ():
        if letter not in machine.axes:
            yield Inconsistency(
                ("homing", "order"),
                f"the machine has no axis {letter}",
                f"its axes are {', '.join(machine.axes)}",
            )
    if machine.board.klipper is not None:
        motors = {name: len(joint.motors) for name, joint in machine.joint_tables.items()}
        yield from machine.board.klipper.inconsistencies(motors)
    elif machine.board.kind == "klipper":
        yield Inconsistency(
            ("board", "kind"),
            "a Klipper board needs the pins of its motors",
            "write the tables [board.klipper.x], ...; cncrun boards lists the pins of a board",
        )
    yield from _vibration(machine)
    if machine.stock is not None and not {"x", "y", "z"} <= machine.axes.keys():
        yield Inconsistency(
            ("stock",),
            "the machine does not have the axes x, y and z",
            "remove the table",
        )


def _vibration(machine: Machine) -> Iterator[Inconsistency]:
    """Compare the modes with the axes and with the period of the samples."""
    highest = 0.5 / machine.path.period
    for name, modes in machine.vibration.items():
        if name != "tool" and name not in machine.axes:
            hint = f"there are {', '.join(machine.axes)}, and tool for all of them"
            yield Inconsistency(("vibration", name), "there is no such axis", hint)
        if any(mode.frequency > highest for mode in modes):
            message = f"a mode is above {highest:g} Hz, half the rate of the samples"
            hint = "shorten path.period, or leave the mode out"
            yield Inconsistency(("vibration", name), message, hint)


def _motors(machine: Machine) -> Iterator[tuple[str, str, Axis]]:
    """Yield table, name and limits of each joint."""
    for name, joint in machine.joint_tables.items():
        yield "joints" if name in machine.kinematics.joints else "axes", name, joint


def _joint_names(machine: Machine) -> Iterator[Inconsistency]:
    """Compare the tables of the joints, and the axes, with those of the kinematics."""
    wanted, kind = machine.kinematics.joints, machine.kinematics.type
    hint = f"the joints of {kind} are {', '.join(wanted)}" if wanted else f"{kind} has none"
    moved = machine.kinematics.axes
    if isinstance(machine.kinematics, FiveAxis):
        moved = machine.kinematics.tip_axes
        for reversed_axis in machine.kinematics.reverse:
            if reversed_axis not in moved:
                message = f"{kind} has no axis {reversed_axis}"
                yield Inconsistency(("kinematics", "reverse"), message, "remove it")
    for letter in moved:
        if letter not in machine.axes:
            message = f"{kind} moves the axis {letter}, which the machine does not have"
            yield Inconsistency(("kinematics", "type"), message, f"add [axes.{letter}]")
    for name in machine.joints:
        if name not in wanted:
            yield Inconsistency(("joints", name), "there is no such joint", hint)
    for name in wanted:
        if name not in machine.joints:
            yield Inconsistency(("kinematics", "type"), f"[joints.{name}] is missing", hint)
        if name in machine.axes and name not in machine.kinematics.axes:
            message = f"the kinematics has a joint {name}, too"
            yield Inconsistency(("axes", name), message, "choose another kinematics or axis")


def _start(machine: Machine) -> Iterator[Inconsistency]:
    """Compare the start with the axes and joints, and with their travel."""
    tables = machine.axes | machine.joint_tables
    moved = [name for name in machine.start if name in machine.kinematics.axes]
    joints = [name for name in machine.start if name in machine.kinematics.joints]
    for name, place in machine.start.items():
        key = ("machine", "start", name)
        if name not in tables:
            hint = f"there are {', '.join(tables)}"
            yield Inconsistency(key, "there is no such axis or joint", hint)
            continue
        travel = tables[name].travel
        if travel is not None and not travel[0] <= place <= travel[1]:
            message = f"{place:g} is outside the travel, {travel[0]:g} to {travel[1]:g}"
            yield Inconsistency(key, message, "give a place within the travel")
    if moved and joints:
        message = f"the joints {', '.join(joints)} move {', '.join(moved)}"
        hint = "give places of the axes or of the joints, not of both"
        yield Inconsistency(("machine", "start"), message, hint)


def _compensation(machine: Machine) -> Iterator[Inconsistency]:
    """Compare squareness and error tables with the axes."""
    for pair in () if machine.squareness is None else machine.squareness.given:
        missing = [letter for letter in pair if letter not in machine.axes]
        if missing:
            message = f"the machine has no axis {missing[0]}"
            yield Inconsistency(("machine", "squareness", pair), message, "remove it")
    for letter, axis in machine.axes.items():
        if axis.backlash is not None and axis.wrap is not None:
            key = ("axes", letter, "backlash")
            yield Inconsistency(key, "the axis repeats after a turn", "remove backlash or wrap")
        if axis.error_table is None:
            continue
        key = ("axes", letter, "error_table")
        try:
            knots = screw(axis.error_table, axis.backlash).knots
        except TableError as error:
            yield Inconsistency(key, str(error), "correct the table")
            continue
        if axis.wrap is not None:
            yield Inconsistency(key, "the axis repeats after a turn", "remove the table or wrap")
        if axis.travel is None:
            hint = f"write axes.{letter}.travel = [lowest, highest]"
            yield Inconsistency(key, "a table needs the travel that it is for", hint)
        elif not (knots[0] <= axis.travel[0] + ROUNDING and axis.travel[1] <= knots[-1] + ROUNDING):
            message = (
                f"the table is for {knots[0]:g} to {knots[-1]:g}, "
                f"the travel is {axis.travel[0]:g} to {axis.travel[1]:g}"
            )
            yield Inconsistency(key, message, "measure the whole travel, or shorten the travel")
    if isinstance(machine.error_map, ErrorMap):
        yield from _error_map(machine, machine.error_map)
    if machine.is_compensated and not isinstance(machine.kinematics, Cartesian):
        message = "the compensation of errors needs a motor for each axis"
        hint = f"{machine.kinematics.type} has none: remove squareness, error map and tables"
        yield Inconsistency(("kinematics", "type"), message, hint)


def _error_map(machine: Machine, error_map: ErrorMap) -> Iterator[Inconsistency]:
    """Compare the error map with the axes and their travel."""
    key = ("machine", "error_map")
    tables: dict[str, Axis] = {str(letter): axis for letter, axis in machine.axes.items()}
    for letter, places in zip("xyz", error_map.grid, strict=True):
        axis = tables.get(letter)
        if axis is None:
            yield Inconsistency(key, f"the machine has no axis {letter}", "remove the map")
        elif axis.wrap is not None:
            yield Inconsistency(key, f"the axis {letter} repeats after a turn", "remove the map")
        elif len(places) == 1:
            continue  # The same errors everywhere along the axis.
        elif axis.travel is None:
            hint = f"write axes.{letter}.travel = [lowest, highest]"
            yield Inconsistency(key, f"a map needs the travel of {letter} that it is for", hint)
        elif not (
            places[0] <= axis.travel[0] + ROUNDING and axis.travel[1] <= places[-1] + ROUNDING
        ):
            message = (
                f"the map is for {letter.upper()}{places[0]:g} to {places[-1]:g}, "
                f"the travel is {axis.travel[0]:g} to {axis.travel[1]:g}"
            )
            yield Inconsistency(key, message, "measure the whole travel, or shorten the travel")


def _axis_limits(machine: Machine, table: str, letter: str, axis: Axis) -> Iterator[Inconsistency]:
    most = machine.board.max_step_rate
    if axis.step_rate > most * (1 + RATE_ROUNDING):
        yield Inconsistency(
            (table, letter, "max_velocity"),
            f"{axis.max_velocity:g} mm/s at {axis.steps_per_mm:g} steps/mm is "
            f"{axis.step_rate:.7g} steps/s, but board.max_step_rate is {most:.7g}",
            f"lower it to {most / axis.steps_per_mm:g}, "
            "or raise board.max_step_rate if the board supports it",
        )
    path = machine.path
    if axis.max_acceleration is None and (
        path.max_tangential_acceleration is None or path.max_normal_acceleration is None
    ):
        yield Inconsistency(
            (table, letter, "max_acceleration"),
            "nothing limits the acceleration of this axis",
            f"set {table}.{letter}.max_acceleration, "
            "or path.max_tangential_acceleration and path.max_normal_acceleration",
        )
    if axis.max_jerk is None and path.max_jerk is None:
        yield Inconsistency(
            (table, letter, "max_jerk"),
            "nothing limits the jerk of this axis",
            f"set {table}.{letter}.max_jerk, or path.max_jerk",
        )


def _homing_position(machine: Machine, letter: AxisLetter) -> Iterator[Inconsistency]:
    axis = machine.axes[letter]
    position = None if axis.homing is None else axis.homing.position
    if position is None or axis.travel is None:
        return
    if not axis.travel[0] <= position <= axis.travel[1]:
        yield Inconsistency(
            ("axes", letter, "homing", "position"),
            f"{position:g} is outside the travel, {axis.travel[0]:g} to {axis.travel[1]:g} mm",
            f"give a coordinate within axes.{letter}.travel",
        )


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
    return machine_of_text(file, _read(file))


def machine_of_text(file: Traversable, text: str) -> Machine:
    """Return the machine that a file would describe with this text.

    Raises:
        MachineFileError: As :func:`load_machine`.
    """
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise toml_error(file, text, str(error)) from None
    except RecursionError:
        depths = [line.count("[") + line.count("{") for line in text.splitlines()]
        place = f"(at line {depths.index(max(depths)) + 1}, column 1)"
        raise toml_error(file, text, f"lists or tables are nested too deeply {place}") from None
    try:
        header = Header.model_validate(tables.pop("machine", {}))
    except ValidationError as error:
        raise validation_error(file, text, error, ("machine",)) from None
    for key in (*Header.model_fields, "file"):
        if key in tables:
            hint = "remove it" if key == "file" else f"put the {key} into [machine]"
            raise value_error(file, text, (key,), "there is no such key", hint)
    _complete_axes(file, text, tables)
    try:
        machine = Machine.model_validate({**header.model_dump(), "file": str(file), **tables})
    except ValidationError as error:
        raise validation_error(file, text, error) from None
    machine = _with_error_tables(machine, file, text)
    for wrong in inconsistencies(machine):
        raise value_error(file, text, wrong.key, wrong.message, wrong.hint)
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
        raise value_error(file, text, ("kinematics", "type"), message)
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
                raise value_error(file, text, ("axes", letter, key), message, hint)
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
    return value_error(file, text, key, message, hint)


def toml_error(
    file: Traversable, text: str, message: str, code: str = "machine-file-syntax"
) -> MachineFileError:
    """Return the TOML parser's message, with the location as line and column instead of words."""
    match = re.search(r" \(at (?:line (\d+), column (\d+)|end of document)\)", message)
    lines = text.splitlines()
    line, column = (int(match[1]), int(match[2])) if match and match[1] else (max(len(lines), 1), 0)
    file_kind = code.split("-")[0]
    return MachineFileError(
        Diagnostic(
            code,
            message[: match.start()] if match else message,
            file=str(file),
            line=line,
            column=column,
            text=lines[line - 1] if line <= len(lines) else "",
            hint=f"the {file_kind} file is TOML: [table] lines, "
            "and key = value with text in quotes",
        )
    )


def value_error(
    file: Traversable,
    text: str,
    key: tuple[str, ...],
    message: str,
    hint: str = "",
    code: str = "machine-file",
) -> MachineFileError:
    """Return an error at a key of a file."""
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


def validation_error(
    file: Traversable,
    text: str,
    error: ValidationError,
    table: tuple[str, ...] = (),
    *,
    names: Sequence[str] = (),
    code: str = "machine-file",
) -> MachineFileError:
    """Return the first of pydantic's errors with a message in plain terms.

    Unknown keys come first, because a misspelt key is reported as a missing key, too.

    Args:
        file: The file.
        text: Its text.
        error: The errors.
        table: The table that was validated.
        names: Keys of another kind of file; none for those of a machine file.
        code: Code of the error.
    """
    fault = sorted(error.errors(include_url=False), key=lambda e: not _is_unknown_key(e))[0]
    # pydantic appends its own locations to the key (an index, "[key]"); users see the keys only.
    key = table + tuple(part for part in fault["loc"] if isinstance(part, str) and part != "[key]")
    if key[0] == "kinematics" and len(key) > 2:
        key = ("kinematics", *key[2:])  # pydantic names the type of the kinematics, too
    if _is_unknown_key(fault):
        return _unknown_key(file, text, key, names or _names_beside(key), code)
    kind = fault["type"]
    context = fault.get("ctx", {})
    if kind == "union_tag_not_found":
        kinds = ", ".join(kind for model in KINEMATICS for kind in model.kinds())
        return value_error(file, text, ("kinematics",), f"type is missing: {kinds}")
    if kind == "value_error":
        message = str(context["error"])
    elif kind == "missing" and isinstance(fault["loc"][-1], int):
        pair = "must be [lowest, highest]"
        message = "has too few numbers" if key[0] == "kinematics" else pair
    elif kind in _MESSAGES:
        message = _MESSAGES[kind].format(**context)
    else:
        message = fault["msg"]
    if kind != "missing" and isinstance(fault["input"], str | int | float):
        message += f", not {_toml(fault['input'])}"
    return value_error(file, text, key, message, code=code)


def _is_unknown_key(error: Any) -> bool:
    return bool(error["type"] == "extra_forbidden" or error["loc"][-1:] == ("[key]",))


def _toml(value: str | int | float) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else str(value)


def _unknown_key(
    file: Traversable, text: str, key: tuple[str, ...], names: Sequence[str], code: str
) -> MachineFileError:
    close = difflib.get_close_matches(key[-1].lower(), names, n=1, cutoff=0.6)
    hint = f"did you mean {close[0]}?" if close else f"known keys: {', '.join(names)}"
    return value_error(file, text, key, "there is no such key", hint, code)


def _names_beside(key: tuple[str, ...]) -> list[str]:
    """Return the keys of the table of a machine file in which a key stands."""
    if len(key) == 1:
        names = (name for name in Machine.model_fields if name not in Header.model_fields)
        return ["machine", *(name for name in names if name != "file")]
    models: list[type[Section]] = [Header if key[0] == "machine" else Machine]
    parts = iter(key[1:-1] if key[0] == "machine" else key[:-1])
    for part in parts:
        fields = (model.model_fields[part] for model in models if part in model.model_fields)
        models = [table for field in fields for table in _tables(field.annotation)] or models
        if part in ("axes", "joints") and next(parts, None) is None:
            return list(AXIS_LETTERS)
    return [*dict.fromkeys(name for model in models for name in model.model_fields)]


def _tables(annotation: object) -> Iterator[type[Section]]:
    """Yield the models of the tables that a key may hold."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        yield annotation
    for part in get_args(annotation):
        yield from _tables(part)


def _with_error_tables(machine: Machine, file: Traversable, text: str) -> Machine:
    """Return the machine with the rows of the files that its error tables and map name."""
    axes, error_map = dict(machine.axes), machine.error_map
    if isinstance(error_map, Path):
        folder = file.resolve().parent if isinstance(file, Path) else Path()
        try:
            error_map = read_error_map(folder / error_map)
        except TableError as error:
            raise value_error(file, text, ("machine", "error_map"), str(error)) from None
    for letter, axis in machine.axes.items():
        table = axis.error_table
        if not isinstance(table, Path):
            continue
        folder = file.resolve().parent if isinstance(file, Path) else Path()
        try:
            points = read_error_table(folder / table)
        except TableError as error:
            key = ("axes", letter, "error_table")
            raise value_error(file, text, key, str(error)) from None
        axes[letter] = axis.model_copy(update={"error_table": points})
    return machine.model_copy(update={"axes": axes, "error_map": error_map})


def _with_absolute_files(machine: Machine, file: Traversable, text: str) -> Machine:
    """Return the machine with absolute file names in [program]; the files must exist."""
    program = machine.program
    if not isinstance(file, Path):
        return machine  # A machine file in a zip file names no other files.
    folder = file.resolve().parent
    for key, path in program.files():
        if not (folder / path).exists():
            raise value_error(file, text, ("program", key), f"there is no {folder / path}")
    absolute = program.model_copy(
        update={
            "tool_table": program.tool_table and folder / program.tool_table,
            "parameters": program.parameters and folder / program.parameters,
            "subroutines": tuple(folder / path for path in program.subroutines),
            "codes": with_absolute_files(program.codes, folder),
        }
    )
    return machine.model_copy(update={"program": absolute})


# JSON Schema of the machine file, for editors and for the reference.

DRAFT = "https://json-schema.org/draft/2020-12/schema"


class _TomlSchema(GenerateJsonSchema):
    """A generator for TOML, which has no null: an optional key is left out instead."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        """Return False: the keys are their own titles."""
        return False

    def nullable_schema(self, schema: core_schema.NullableSchema) -> JsonSchemaValue:
        """Return the schema of the value."""
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        """Return the schema of the value, with its default unless that is null or a table."""
        written = super().default_schema(schema)
        if isinstance(written.get("default"), dict | None):
            written.pop("default", None)
        return written


def machine_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a machine file.

    The properties are the tables of the file. Every key has a description with its unit, and its
    default where it has one. The schema does not cover contradictions between keys
    (:func:`cnc.machine.load.inconsistencies`).
    """
    tables = Machine.model_json_schema(schema_generator=_TomlSchema)
    header = Header.model_json_schema(schema_generator=_TomlSchema)
    keys = tables.pop("properties")
    for own in (*Header.model_fields, "file"):
        del keys[own]
    _allow_axes_of_joints(tables["$defs"], keys["axes"])
    return {
        "$schema": DRAFT,
        **tables,
        "title": "Machine file",
        "description": "A machine file of cncrun. Lengths in mm (degrees for rotary axes), "
        "times in s.",
        "properties": {"machine": header, **keys},
    }


def section_schema(model: type[Section], title: str) -> dict[str, Any]:
    """Return the JSON Schema of a file that a model describes."""
    schema = model.model_json_schema(schema_generator=_TomlSchema)
    return {"$schema": DRAFT, **schema, "title": title}


def _allow_axes_of_joints(models: dict[str, Any], axes: dict[str, Any]) -> None:
    """Let an axis that joints move have only the keys of its place."""
    place = {key: models["Axis"]["properties"][key] for key in OF_TIP}
    models["AxisOfJoints"] = {
        "description": "An axis that joints of the kinematics move.",
        "type": "object",
        "additionalProperties": False,
        "properties": place,
    }
    other = {"$ref": "#/$defs/AxisOfJoints"}
    axes["additionalProperties"] = {"anyOf": [axes["additionalProperties"], other]}


def schema_text() -> str:
    """Return the schema as the text of its shipped file, ``docs/schemas/machine.schema.json``."""
    return json.dumps(machine_schema(), indent=2) + "\n"


# The raw part as a command-line argument: ``X0:100,Y0:60,Z-12:0``.

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)"
_SPAN = re.compile(rf"\s*([xyz])\s*({_NUMBER})\s*:\s*({_NUMBER})\s*", re.IGNORECASE)


def with_stock(machine: Machine, text: str, zero: Mapping[str, float] | None = None) -> Machine:
    """Return the machine with the raw part that ``text`` describes.

    Args:
        machine: The machine.
        text: The raw part.
        zero: Machine position of the zero of its coordinates by axis, mm; None for machine zero.

    Raises:
        UsageError: ``stock-malformed``.
    """
    stock = _stock(text)
    if zero is not None:
        spans = {"x": stock.x, "y": stock.y, "z": stock.z}
        moved = {
            letter: (low + zero.get(letter, 0.0), high + zero.get(letter, 0.0))
            for letter, (low, high) in spans.items()
        }
        stock = stock.model_copy(update=moved)
    changed = machine.model_copy(update={"stock": stock})
    for wrong in inconsistencies(changed):
        raise UsageError(Diagnostic("stock-malformed", wrong.message, hint=wrong.hint))
    return changed


def _stock(text: str) -> Stock:
    spans = [_SPAN.fullmatch(part) for part in text.split(",")]
    named = {span[1].lower(): (float(span[2]), float(span[3])) for span in spans if span}
    if all(spans) and len(named) == len(spans):
        try:
            return Stock.model_validate(named)
        except ValidationError:
            pass
    hint = (
        "give the lowest and highest machine coordinate of each axis in mm, "
        "such as X0:100,Y0:60,Z-12:0"
    )
    raise UsageError(
        Diagnostic("stock-malformed", f"{text!r} does not describe a cuboid", hint=hint)
    )
