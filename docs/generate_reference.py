"""Pages of the reference that are generated from code, each time the site is built.

The command line comes from cyclopts, the machine file from its pydantic models, the findings from
the catalogue, the codes of the dialects from their data, and the diagrams of the languages from
their grammars. mkdocs-gen-files runs this file.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import mkdocs_gen_files

from cnc.checks.selection import markdown
from cnc.cli.commands import app
from cnc.machine.load import machine_schema
from docs import dialect_tables, grammar_diagrams


def command_line() -> str:
    """Return the page of commands and options."""
    return "# Command line\n\n" + app.generate_docs(output_format="markdown", heading_level=2)


def machine_file() -> str:
    """Return the page of tables and keys of the machine file."""
    schema = machine_schema()
    definitions = schema.get("$defs", {})
    lines = [
        "# Machine file",
        "",
        "TOML. Lengths are in mm (degrees for rotary axes), times in s. An unknown key, a wrong",
        "type or a wrong sign is an error that names file, line and key. Each axis needs a limit",
        "of acceleration and of jerk, of its own or along the path. Without a limit nothing is",
        "limited.",
        "",
    ]
    for name, table in schema["properties"].items():
        lines += [f"## `[{name}]`", "", str(table.get("description", "")), ""]
        lines += _table(_resolved(table, definitions), definitions)
    return "\n".join(lines) + "\n"


def _resolved(part: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the definition that a part of a schema refers to, or the part itself."""
    for candidate in (part, *part.get("allOf", []), *part.get("anyOf", [])):
        if "$ref" in candidate:
            found: dict[str, Any] = definitions[candidate["$ref"].rpartition("/")[2]]
            return found
    values = part.get("additionalProperties")
    return _resolved(values, definitions) if isinstance(values, dict) else part


def _table(model: dict[str, Any], definitions: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of a table of keys; tables within it follow behind."""
    required = model.get("required", [])
    nested: list[tuple[str, dict[str, Any]]] = []
    yield "| key | default | meaning |"
    yield "| --- | --- | --- |"
    for key, value in model.get("properties", {}).items():
        inner = _resolved(value, definitions)
        if inner is not value and "properties" in inner:
            nested.append((key, inner))
        given = value.get("default")
        default = "none" if given is None else f"`{json.dumps(given)}`"
        default = "needed" if key in required else default
        meaning = str(value.get("description", "")).replace("\n", " ").replace("|", "\\|")
        yield f"| `{key}` | {default} | {meaning} |"
    yield ""
    for choice in model.get("oneOf", []):
        inner = _resolved(choice, definitions)
        kinds = inner["properties"]["type"]
        yield f"### `type = {json.dumps(kinds.get('const') or kinds['enum'][0])}`"
        yield ""
        yield from _table(inner, definitions)
    for key, inner in nested:
        yield f"### `{key}`"
        yield ""
        yield from _table(inner, definitions)


for page, content in (
    ("reference/cli.md", command_line()),
    ("reference/machine-file.md", machine_file()),
    ("reference/findings.md", markdown()),
    ("reference/dialects.md", dialect_tables.page()),
    ("reference/grammars.md", grammar_diagrams.page()),
):
    with mkdocs_gen_files.open(page, "w") as file:
        file.write(content)
