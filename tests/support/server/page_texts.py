"""The texts of the console's page: in its files, from the server, and in the catalogues."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import NamedTuple

from tests.support.paths import ROOT

PAGE = ROOT / "cnc/server/page"
SILENT = ("script", "style")
ATTRIBUTES = ("aria-label", "title", "placeholder")
ESCAPE = re.compile(r"\\(u[0-9a-fA-F]{4}|.)", re.DOTALL)


class _Texts(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self._within: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag in SILENT:
            self._within.append(tag)
        self.found += [value for name, value in attrs if name in ATTRIBUTES and value]

    def handle_endtag(self, tag: str) -> None:
        if tag in SILENT:
            self._within.pop()

    def handle_data(self, data: str) -> None:
        if not self._within:
            self.found.append(data.strip())


def _letter(match: re.Match[str]) -> str:
    code = match[1]
    return chr(int(code[1:], 16)) if len(code) == 5 else {"n": "\n"}.get(code, code)


def templates(text: str) -> list[str]:
    """Return the keys of the templates t`...` of a module, and of those inside their values."""
    keys = []
    for begin in re.finditer(r"(?<![\w$])t`", text):
        key, values, at = "", 0, begin.end()
        while text[at] != "`":
            if text.startswith("${", at):
                key += f"{{{values}}}"
                values += 1
                at = _end_of_value(text, at + 2)
            elif text[at] == "\\":
                match = ESCAPE.match(text, at)
                assert match is not None
                key += _letter(match)
                at = match.end()
            else:
                key += text[at]
                at += 1
        keys.append(key)
    return keys


def _end_of_value(text: str, at: int) -> int:
    """Return the place behind the brace that closes a value; it may hold templates itself."""
    depth, within = 1, 0
    while depth:
        if text[at] == "`":
            within ^= 1
        elif text[at] == "{":
            depth += 1
        elif text[at] == "}":
            depth -= 1
        at += 1
    return at


def texts_of_files() -> set[str]:
    """Return the texts that the files of the page have: those with letters."""
    page = _Texts()
    page.feed((PAGE / "index.html").read_text(encoding="utf-8"))
    found = set(page.found)
    for module in PAGE.glob("*.js"):
        text = re.sub(r"^\s*//.*$|^\s*/?\*.*$", "", module.read_text(encoding="utf-8"), flags=re.M)
        found |= set(templates(text))
        found |= {ast.literal_eval(each) for each in re.findall(r'(?<!\w)word\(("[^"]*")\)', text)}
    return {each for each in found if re.search(r"[A-Za-z]{2}", each)}


def catalogue(language: str, context: str = "") -> dict[str, str]:
    """Return the texts of the page, or those of a context: ``server``."""
    return entries(PAGE / f"{language}.po", context)


def entries(file: Path, context: str = "") -> dict[str, str]:
    """Return the entries of a gettext file that have a context."""
    found: dict[str, str] = {}
    for block in file.read_text(encoding="utf-8").split("\n\n"):
        lines = [line for line in block.splitlines() if line and not line.startswith("#")]
        parts = {"msgctxt": "", "msgid": "", "msgstr": ""}
        kind = ""
        for line in lines:
            match = re.fullmatch(r'(?:(msgctxt|msgid|msgstr) )?(".*")', line)
            assert match is not None, line
            kind = match[1] or kind
            parts[kind] += json.loads(match[2])
        if parts["msgid"] and parts["msgctxt"] == context:
            assert parts["msgid"] not in found, parts["msgid"]
            found[parts["msgid"]] = parts["msgstr"]
    return found


# Sentences that the server makes, in the source of these functions.

SITES = {
    "cnc/model/blocks.py": ["pause_reason"],
    "cnc/session/required_capabilities.py": ["pause_text"],
    "cnc/boards/grbl/messages.py": ["door"],
    "cnc/operate/machines.py": ["readings"],
    "cnc/session/resume.py": ["_approach", "_restore"],
    "cnc/measure/procedures.py": [
        *("backlash", "backlash_of", "pitch", "pitch_of", "_pitch_rows", "square", "square_of"),
    ],
    "cnc/measure/probing.py": ["backlash", "pitch", "square"],
    "cnc/measure/limits.py": ["limits"],
    "cnc/measure/ringing.py": ["shaken", "of_record", "of_columns"],
    "cnc/measure/machine_file.py": ["of", "steps"],
    "cnc/view/page.py": ["_facts"],
    "cnc/view/sketch.py": ["data"],
    "cnc/server/library.py": ["fault_of_name", "_files"],
    "cnc/gcode/reader/parser.py": ["_fix"],
}
FINDINGS = {"Diagnostic", "wrong_option", "disagree", "check_count", "checked", "_form"}
"""Functions that are given the texts of findings."""


def sentences_of_server() -> set[str]:
    """Return the sentences of the server, with {0}, {1} in the places of values."""
    found: set[str] = set()
    for name, functions in SITES.items():
        tree = ast.parse((ROOT / name).read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef) and node.name in functions:
                found |= set(_strings(node))
    return {each for each in found if re.search(r"[A-Za-z]{2}", each)}


def _strings(node: ast.AST) -> Iterator[str]:
    """Yield the texts of a function: its strings with blanks, and the names of rows."""
    if isinstance(node, ast.Constant | ast.JoinedStr):
        text = template(node)
        if text is not None and " " in text:
            yield text
        return
    if isinstance(node, ast.Raise | ast.arguments):
        return
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return  # a docstring
    if isinstance(node, ast.Assign) and {
        each.id for each in ast.walk(node.targets[0]) if isinstance(each, ast.Name)
    } & {"message", "hint"}:
        return
    # The comment of a machine file is English.
    if isinstance(node, ast.Assign) and "date.today" in ast.unparse(node.value):
        return
    if isinstance(node, ast.Call):
        name = getattr(node.func, "id", getattr(node.func, "attr", ""))
        if name in FINDINGS:
            return
        if name == "Row" and isinstance(node.args[0], ast.Constant):
            yield str(node.args[0].value)
    for child in ast.iter_child_nodes(node):
        yield from _strings(child)


def template(node: ast.AST) -> str | None:
    """Return a string with {0}, {1} in the places of values; None for another expression."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if not isinstance(node, ast.JoinedStr):
        return None
    values, text = 0, ""
    for part in node.values:
        if isinstance(part, ast.Constant):
            text += str(part.value)
        else:
            text += f"{{{values}}}"
            values += 1
    return text


def titles_of_repairs() -> set[str]:
    """Return the titles in the source, and the names of variables in their place."""
    found: set[str] = set()
    for folder in ("cnc/gcode", "cnc/session"):
        for file in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                found |= {template(each) or ast.unparse(each) for each in _titles(node)}
    return found


def _titles(node: ast.AST) -> Iterator[ast.expr]:
    """Yield the titles of ``Fix(title, ...)``, ``fix=(title, text)`` and ``fix = title, text``."""
    values: list[ast.expr] = []
    if isinstance(node, ast.Call):
        name = ast.unparse(node.func)
        if name in ("Fix", "Fix.replace"):
            yield node.args[0]
        values = [each.value for each in node.keywords if each.arg == "fix"]
        if name == "replace":
            yield from (each.value for each in node.keywords if each.arg == "title")
    elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "fix":
        values = [node.value]
    for value in values:
        for each in [value.body, value.orelse] if isinstance(value, ast.IfExp) else [value]:
            if isinstance(each, ast.Tuple):
                yield each.elts[0]


# The translation of a sentence, as the page makes it.

SEPARATORS = (" · ", "; ", ", ", ": ")


class Said(NamedTuple):
    """A translated sentence, the texts that were used for it, and the parts that have none."""

    text: str
    used: frozenset[str]
    rest: tuple[str, ...]


def said(text: str, sentences: dict[str, str], texts: dict[str, str]) -> Said:
    """Translate a line of the server."""
    if text in sentences or text in texts:
        used = frozenset({text} if text in sentences else ())
        return Said(sentences.get(text) or texts[text], used, ())
    for key in sorted(sentences, key=lambda each: -len(re.sub(r"\{\d+\}", "", each))):
        parts = re.split(r"\{\d+\}", key)
        pattern = f"((?:(?!{'|'.join(SEPARATORS)}).)+)".join(map(re.escape, parts))
        if match := re.fullmatch(pattern, text):
            values = [said(each, sentences, texts) for each in match.groups()]
            made = sentences[key]
            for k, value in enumerate(values):
                made = made.replace(f"{{{k}}}", value.text)
            used = frozenset({key}).union(*(each.used for each in values))
            return Said(made, used, tuple(part for each in values for part in each.rest))
    separator = next((each for each in SEPARATORS if each in text), None)
    if separator is None:
        return Said(text, frozenset(), (text,) if re.search("[A-Za-z]{2}", text) else ())
    made_parts = [said(each, sentences, texts) for each in text.split(separator)]
    return Said(
        separator.join(each.text for each in made_parts),
        frozenset().union(*(each.used for each in made_parts)),
        tuple(part for each in made_parts for part in each.rest),
    )
