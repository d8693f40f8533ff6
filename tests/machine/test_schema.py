"""The JSON Schema of the machine file, its shipped copy, and its use by the shipped machines."""

import json
import tomllib
from collections.abc import Iterator
from typing import Any

import jsonschema
import pytest

from cnc.machine.load import load_machine, machine_schema, schema_text, shipped_machines
from cnc.machine.models import Header, Machine
from cnc.model.diagnostics import MachineFileError
from tests.support.paths import ROOT

SHIPPED = ROOT / "docs" / "schemas" / "machine.schema.json"
AXIS = {"steps_per_mm": 100, "max_velocity": 50, "max_acceleration": 500, "max_jerk": 9000}
VALIDATOR = jsonschema.Draft202012Validator(machine_schema())

REJECTED = [
    {"axes": {"q": AXIS}},
    {"axes": {}},
    {"axes": {"x": AXIS | {"max_velocity": -1}}},
    {"axes": {"x": AXIS | {"max_velocity": "fast"}}},
    {"axes": {"x": AXIS | {"max_velocty": 1}}},
    {"axes": {"x": AXIS | {"travel": [1]}}},
    {"axes": {"x": AXIS}, "name": "mill"},
    {"axes": {"x": AXIS}, "borad": {}},
    {"axes": {"x": AXIS}, "machine": {"name": 3}},
    {"axes": {"x": AXIS}, "program": {"dialect": "okuma"}},
    {"axes": {"x": AXIS}, "board": {"step_pulse": 1e-3}},
    {"axes": {"x": AXIS}, "board": {"normally_closed": ["door"]}},
    {},
]


def keys(schema: dict[str, Any], *path: str) -> Iterator[tuple[tuple[str, ...], dict[str, Any]]]:
    """Yield path and schema of each key of a table, and of the tables in it."""
    for key, value in schema.get("properties", {}).items():
        yield (*path, key), value
        inner = value.get("additionalProperties", value)
        if isinstance(inner, dict) and "$ref" not in inner:
            inner = inner.get("anyOf", [{}])[0]
        reference = inner.get("$ref", "") if isinstance(inner, dict) else ""
        name = reference.rpartition("/")[2]
        yield from keys(machine_schema()["$defs"][name] if name else value, *path, key)


def test_shipped_schema_is_that_of_the_models() -> None:
    assert SHIPPED.read_text(encoding="utf-8") == schema_text(), (
        "write it anew: python -c 'from cnc.machine.load import schema_text; "
        'print(schema_text(), end="")\' > docs/schemas/machine.schema.json'
    )


def test_schema_is_valid() -> None:
    jsonschema.Draft202012Validator.check_schema(machine_schema())


def test_each_key_has_a_description() -> None:
    found = dict(keys(machine_schema()))
    assert ("axes", "homing", "seek") in found
    assert ("board", "step_pulse") in found
    assert len(found) > 45
    for path, value in found.items():
        if path in (("machine",), ("path",)):
            continue  # The table itself has one.
        assert value.get("description"), path


def test_tables_are_those_of_the_models() -> None:
    tables = set(machine_schema()["properties"])
    assert tables == {"machine", *Machine.model_fields} - {*Header.model_fields, "file"}


@pytest.mark.parametrize("name", sorted(shipped_machines()))
def test_shipped_machines_name_the_schema_and_comply(name: str) -> None:
    file = ROOT / "config" / f"{name}.toml"
    text = file.read_text(encoding="utf-8")
    mark, _, path = text.splitlines()[0].partition(" ")
    assert mark == "#:schema"
    assert (file.parent / path).resolve() == SHIPPED
    VALIDATOR.validate(tomllib.loads(text))


@pytest.mark.parametrize("tables", REJECTED, ids=json.dumps)
def test_schema_rejects_what_the_models_reject(tables: dict[str, Any], tmp_path) -> None:
    with pytest.raises(jsonschema.ValidationError):
        VALIDATOR.validate(tables)
    with pytest.raises(MachineFileError):
        load_machine(write(tmp_path, tables))


def test_schema_accepts_all_keys_with_their_defaults() -> None:
    defaults: dict[str, Any] = {"axes": {"x": AXIS}}
    for path, value in keys(machine_schema()):
        if "default" in value and path[0] not in ("axes", "joints", "vibration") and len(path) == 2:
            defaults.setdefault(path[0], {})[path[1]] = value["default"]
    assert defaults["path"]["chord_error"] == 0.001
    VALIDATOR.validate(defaults)


def write(folder, tables: dict[str, Any]):
    """Write tables as a TOML file and return it."""
    file = folder / "m.toml"
    file.write_text(
        "\n".join(f"{key} = {inline(value)}" for key, value in tables.items()), encoding="utf-8"
    )
    return file


def inline(value: Any) -> str:
    """Return a value as inline TOML."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {inline(inner)}" for key, inner in value.items()) + "}"
    return json.dumps(value)
