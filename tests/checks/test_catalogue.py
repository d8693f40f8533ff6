"""The catalogue of findings describes every code that cncrun reports, and no other."""

import ast
import re
import tomllib
from collections.abc import Iterator

import pytest

from cnc.boards.stepper.connection import ALARMS
from cnc.checks.catalogue import findings, groups, ignorable_codes, markdown
from tests.support.paths import ROOT

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
    "Form",
}
"""Functions and classes with a code among their arguments."""
CODE = re.compile(r"[a-z]+(-[a-z0-9]+)+|usage")
COMPUTED = {"probe-contact", "switch-contact"}
"""Codes that the source does not contain as a whole."""


def calls() -> Iterator[ast.AST]:
    for file in (ROOT / "cnc").rglob("*.py"):
        yield from ast.walk(ast.parse(file.read_text(encoding="utf-8")))


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
    """Return the codes in arguments, in ``code = ...`` and in ``code, message = ...``."""
    found = {code for code, _, _ in ALARMS.values()} | COMPUTED
    for node in calls():
        if isinstance(node, ast.Call):
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            if name.lstrip("_") in MAKERS:
                found |= strings(node.args)
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
    """Compare with ``caution`` calls and with diagnostics that have a severity in the source."""
    found = set()
    for node in calls():
        if isinstance(node, ast.Call):
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            severities = [
                each.value.value
                for each in node.keywords
                if each.arg == "severity" and isinstance(each.value, ast.Constant)
            ]
            if name in ("caution", "_tell") or severities in (["warning"], ["note"]):
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
