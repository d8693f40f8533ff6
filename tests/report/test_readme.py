"""The README names every error code, and every key of the machine file with its default."""

import ast
import re

import pytest
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from cnc.checks.catalogue import LESSER
from cnc.machine.models import Axis, Board, PathLimits, Program
from tests.support.paths import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
MAKERS = {
    "fault",
    "Diagnostic",
    "board_error",
    "error",
    "wrong",
    "caution",
    "Undefined",
    "file_error",
    "failed",
}
"""Functions and classes of which an argument is a code."""


def codes(folders: tuple[str, ...] = ("",)) -> set[str]:
    found = set()
    for file in (file for folder in folders for file in (ROOT / "cnc" / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or not isinstance(
                node.func, ast.Name | ast.Attribute
            ):
                continue
            name = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
            if name.lstrip("_") in MAKERS:
                strings = [
                    arg.value
                    for arg in node.args
                    if isinstance(arg, ast.Constant) and isinstance(arg.value, str)
                ]
                found |= {text for text in strings if re.fullmatch(r"[a-z]+(-[a-z0-9]+)+", text)}
    return found


def test_every_code_is_listed():
    found = codes()
    assert len(found) > 60
    assert sorted(code for code in found if f"`{code}`" not in README) == []


def test_every_warning_and_note_is_explained():
    """In the table of its own or, for those of the language, in the list below it."""
    part = README[
        README.index("### Warnings and notes") : README.index("### Programs for many controllers")
    ]
    assert [code for code in LESSER if f"`{code}`" not in part] == []


def test_every_finding_of_a_check_is_explained():
    """Each has a heading of its own, and so an address, and something below it."""
    page = (ROOT / "docs" / "findings.md").read_text(encoding="utf-8")
    explained = re.findall(r"^### ([a-z0-9-]+)\n\n(?!#)\S", page, re.MULTILINE)
    assert len(explained) == len(set(explained)) == page.count("\n### ")
    possible = codes(("gcode", "path", "planner", "report", "machine", "batch", "compare")) | set(
        LESSER
    )
    assert sorted(possible - set(explained)) == []
    # nothing is explained that there is not
    assert sorted(code for code in explained if f"`{code}`" not in README) == []


@pytest.mark.parametrize("section", [Axis, PathLimits, Board, Program])
def test_every_key_is_listed_with_its_default(section: type[BaseModel]):
    rows = [line for line in README.splitlines() if line.startswith("|")]
    for key, field in section.model_fields.items():
        default = field.default
        if default is PydanticUndefined:
            shown = {"needed"}
        elif default is None or default == ():
            shown = {"none"}
        else:
            shown = {
                f"`{text}`"
                for text in (
                    str(default).lower(),
                    f"{default:.10g}" if isinstance(default, float) else "",
                    f'"{default}"',
                )
            }
        defaults = [row.split("|")[2] for row in rows if f"`{key}`" in row.split("|")[1]]
        assert any(text in each for each in defaults for text in shown), key
