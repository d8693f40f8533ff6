"""The texts of the page of the console: those in its files, and those of its catalogues."""

from __future__ import annotations

import ast
import json
import re
from html.parser import HTMLParser

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


def catalogue(language: str) -> dict[str, str]:
    """Return the entries of a gettext file."""
    entries: dict[str, str] = {}
    for block in (PAGE / f"{language}.po").read_text(encoding="utf-8").split("\n\n"):
        lines = [line for line in block.splitlines() if line and not line.startswith("#")]
        parts = {"msgid": "", "msgstr": ""}
        kind = ""
        for line in lines:
            match = re.fullmatch(r'(?:(msgid|msgstr) )?(".*")', line)
            assert match is not None, line
            kind = match[1] or kind
            parts[kind] += json.loads(match[2])
        if parts["msgid"]:
            assert parts["msgid"] not in entries, parts["msgid"]
            entries[parts["msgid"]] = parts["msgstr"]
    return entries
