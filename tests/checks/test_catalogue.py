"""The catalogue of findings describes every code that cncrun reports, and no other."""

import ast
import re
import tomllib
from functools import cache

import pytest

from cnc.boards.stepper.connection import ALARMS
from cnc.checks.selection import findings, groups, ignorable_codes, markdown
from tests.support.paths import ROOT

CODE = re.compile(r"[a-z]+(-[a-z0-9]+)+|usage")
COMPUTED = {"probe-contact", "switch-contact"}
"""Codes that the source does not contain as a whole."""


@cache
def nodes() -> list[ast.AST]:
    """Return calls, assignments, functions and dicts of the source. Kernels report no findings."""
    files = [file for file in (ROOT / "cnc").rglob("*.py") if "kernels" not in file.parts]
    trees = [ast.parse(file.read_text(encoding="utf-8")) for file in files]
    read = ast.Call | ast.Assign | ast.AnnAssign | ast.FunctionDef | ast.Dict
    return [node for tree in trees for node in ast.walk(tree) if isinstance(node, read)]


@cache
def functions() -> list[tuple[str, list[ast.Call]]]:
    """Return name and calls of each function of the source."""
    return [
        (node.name, [each for each in ast.walk(node) if isinstance(each, ast.Call)])
        for node in nodes()
        if isinstance(node, ast.FunctionDef)
    ]


def name_of(call: ast.Call) -> str:
    return getattr(call.func, "attr", getattr(call.func, "id", "")).lstrip("_")


def is_lesser(call: ast.Call) -> bool:
    """Return whether a call creates a warning or a note."""
    return any(
        each.arg == "severity"
        and isinstance(each.value, ast.Constant)
        and each.value.value in ("warning", "note")
        for each in call.keywords
    )


@cache
def makers(*, lesser: bool) -> frozenset[str]:
    """Return names of functions that pass a code on to a Diagnostic, through other functions.

    Args:
        lesser: only those that create warnings and notes.
    """
    passed_on = [
        (name.lstrip("_"), call)
        for name, calls in functions()
        for call in calls
        if any(isinstance(each, ast.Name) and "code" in each.id for each in call.args)
    ]
    found: set[str] = set()
    while True:
        more = {
            name
            for name, call in passed_on
            if (
                name_of(call) in found
                or (name_of(call) == "Diagnostic" and (is_lesser(call) or not lesser))
            )
        }
        if more <= found:
            return frozenset(found)
        found |= more


def strings(nodes: list[ast.expr]) -> set[str]:
    """Return the codes among expressions, those in conditional expressions included."""
    return {
        each.value
        for node in nodes
        for each in ([node, node.body, node.orelse] if isinstance(node, ast.IfExp) else [node])
        if isinstance(each, ast.Constant)
        and isinstance(each.value, str)
        and CODE.fullmatch(each.value)
    }


def codes_in_source() -> set[str]:
    """Return the codes in arguments, ``code = ...``, ``code, message = ...``, ``{"code": ...}``."""
    found = {code for code, _, _ in ALARMS.values()} | COMPUTED
    # The table of forms of G6.2 has the codes of each form.
    names = makers(lesser=False) | {"Diagnostic", "Form", "Refusal"}
    for node in nodes():
        if isinstance(node, ast.Call):
            if name_of(node) in names:
                found |= strings(node.args)
            found |= strings([each.value for each in node.keywords if each.arg == "code"])
        elif isinstance(node, ast.Dict):
            parts = zip(node.keys, node.values, strict=True)
            found |= strings([each for key, each in parts if getattr(key, "value", "") == "code"])
        elif isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for target in targets:
                if isinstance(target, ast.Name) and target.id == "code":
                    found |= strings([node.value])
                elif isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                    found |= strings(
                        [
                            value
                            for name, value in zip(target.elts, node.value.elts, strict=True)
                            if isinstance(name, ast.Name) and name.id == "code"
                        ]
                    )
    return found


def test_every_code_has_an_entry():
    found = codes_in_source()
    assert len(found) > 290
    assert sorted(found - set(findings())) == []


def test_no_entry_is_left_over():
    text = "\n".join(file.read_text(encoding="utf-8") for file in (ROOT / "cnc").rglob("*.py"))
    known = set(re.findall(r'"([a-z0-9-]+)"', text)) | COMPUTED
    assert sorted(set(findings()) - known) == []


def test_a_code_stands_in_one_group():
    listed = [each.code for group in groups().values() for each in group]
    assert len(listed) == len(set(listed)) == len(findings())


@pytest.mark.parametrize("part", ["meaning", "remedy"])
def test_entries_are_sentences(part):
    texts = {code: getattr(finding, part) for code, finding in findings().items()}
    assert [code for code, text in texts.items() if not re.fullmatch(r"[A-Z`].*[.]", text)] == []


def test_warnings_and_notes_can_be_ignored_and_errors_can_not():
    """Compare with the calls that create warnings and notes in the source."""
    names = makers(lesser=True)
    found = set()
    for node in nodes():
        if isinstance(node, ast.Call) and (is_lesser(node) or name_of(node) in names):
            found |= strings(node.args[:1])
    assert found == set(ignorable_codes())


def test_an_entry_with_an_unknown_key_is_refused():
    entry = tomllib.loads('meaning = "A."\nremdy = "B."')
    with pytest.raises(TypeError):
        type(findings()["soft-limit"])("soft-limit", **entry)


def test_the_reference_page_has_a_heading_for_each_code():
    headings = re.findall(r"^### (\S+)\n\n\S", markdown(), re.MULTILINE)
    assert headings == list(findings())
    assert "### step-rate\n\n*Warning.* An axis steps" in markdown()
