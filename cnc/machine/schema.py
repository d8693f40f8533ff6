"""JSON Schema of the machine file, for editors and for the reference."""

from __future__ import annotations

import json
from typing import Any

from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from cnc.machine.kinematics import OF_TIP
from cnc.machine.models import Header, Machine

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
        found = super().default_schema(schema)
        if isinstance(found.get("default"), dict | None):
            found.pop("default", None)
        return found


def machine_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a machine file.

    The properties are the tables of the file. Every key has a description with its unit, and its
    default where it has one. The schema does not cover contradictions between keys
    (:func:`cnc.machine.consistency.inconsistencies`).
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
