"""Which findings a user wants to see: by code, and by comments in the program.

    G1 X5 F99999 (cnc: ignore feed-unreachable)

Errors are always shown: nothing makes a rejected program a good one. A code that there is not is a
fault: a finding that was meant to be silenced, or looked for, would not be.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from cnc.checks.catalogue import LESSER, check_codes, meant
from cnc.model.diagnostics import Diagnostic

READ = 1 << 20
"""Bytes of a program that are looked through at a time."""
_COMMENT = re.compile(r"[(;]\s*cnc:\s*ignore\s+([a-z0-9][a-z0-9, -]*)", re.IGNORECASE)
_CODE = re.compile(r"[a-z0-9]+(?:-[a-z0-9]+)*", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Selection:
    """Codes to show alone (none: all), and codes not to show."""

    select: frozenset[str] = field(default_factory=frozenset)
    ignore: frozenset[str] = field(default_factory=frozenset)

    def __post_init__(self) -> None:
        """UsageError ``unknown-finding`` for a code that no warning or note has."""
        check_codes(self.select | self.ignore)

    def wants(self, finding: Diagnostic) -> bool:
        """Whether to show it; ``finding.text`` is its source line, whose comments count."""
        if finding.severity == "error":
            return True
        if finding.code in self.ignore or (self.select and finding.code not in self.select):
            return False
        return finding.code not in ignored_in(finding.text)


def ignored_in(line: str) -> frozenset[str]:
    """The codes that a source line's comments name: ``(cnc: ignore CODE, CODE)``."""
    return frozenset(
        code for listed in _COMMENT.findall(line) for code in _CODE.findall(listed.lower())
    )


def unknown_codes(program: Path, name: str) -> Iterator[Diagnostic]:
    """An ``ignored-code-unknown`` for each code in a comment of the program that no warning or note
    has.
    """
    line, rest = 1, b""
    with program.open("rb") as file:
        while piece := file.read(READ):
            whole, end, rest = (rest + piece).rpartition(b"\n")
            yield from _unknown_in((whole + end).decode("latin-1"), line, name)
            line += _lines(whole + end)
            # no line is as long as this
            rest = rest[-READ:]
    yield from _unknown_in(rest.decode("latin-1"), line, name)


def _unknown_in(text: str, first: int, name: str) -> Iterator[Diagnostic]:
    for comment in _COMMENT.finditer(text):
        for code in _CODE.finditer(text, comment.start(1), comment.end(1)):
            if code[0].lower() not in LESSER:
                begin = (
                    max(text.rfind("\n", 0, code.start()), text.rfind("\r", 0, code.start())) + 1
                )
                line = first + _lines(text[:begin].encode("latin-1"))
                shown = re.split("[\r\n]", text[begin:], maxsplit=1)[0]
                message = f"no warning or note is called {code[0]!r}: nothing is ignored"
                column, length = code.start() - begin + 1, len(code[0])
                yield Diagnostic(
                    "ignored-code-unknown",
                    message,
                    name,
                    line,
                    column,
                    length,
                    shown,
                    meant(code[0]),
                    severity="warning",
                )


def _lines(text: bytes) -> int:
    r"""How many lines end in a text, be it by ``\n``, ``\r`` or both."""
    return text.count(b"\n") + text.count(b"\r") - text.count(b"\r\n")
