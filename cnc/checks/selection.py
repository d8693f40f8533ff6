"""Selection of findings: by code on the command line, and by comments in the program.

    G1 X5 F99999 (cnc: ignore feed-unreachable)

Errors are always reported, because nothing turns a rejected program into a good one. An unknown
code is a fault itself: the user expects a finding to be ignored or shown, and it would not be.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from cnc.checks.catalogue import check_codes, ignorable_codes, similar_codes
from cnc.model.diagnostics import Diagnostic

READ_BYTES = 1 << 20
"""Bytes of a program that are searched at a time. No line is longer."""
_COMMENT = re.compile(r"[(;]\s*cnc:\s*ignore\s+([a-z0-9][a-z0-9, -]*)", re.IGNORECASE)
_CODE = re.compile(r"[a-z0-9]+(?:-[a-z0-9]+)*", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Selection:
    """The findings that a user wants to see.

    Attributes:
        select: codes to report alone; empty for all.
        ignore: codes that are not reported.

    Raises:
        UsageError: ``unknown-finding`` for a code that no warning or note has.
    """

    select: frozenset[str] = field(default_factory=frozenset)
    ignore: frozenset[str] = field(default_factory=frozenset)

    def __post_init__(self) -> None:
        check_codes(self.select | self.ignore)

    def wants(self, finding: Diagnostic) -> bool:
        """Return whether ``finding`` is reported. A comment in ``finding.text`` may ignore it."""
        if finding.severity == "error":
            return True
        if finding.code in self.ignore or (self.select and finding.code not in self.select):
            return False
        return finding.code not in ignored_in(finding.text)


def ignored_in(line: str) -> frozenset[str]:
    """Return the codes in the comments ``(cnc: ignore CODE, CODE)`` of a source line."""
    return frozenset(
        code for listed in _COMMENT.findall(line) for code in _CODE.findall(listed.lower())
    )


def unknown_codes(program: Path, name: str) -> Iterator[Diagnostic]:
    """Yield an ``ignored-code-unknown`` for each unknown code in a comment of the program.

    Args:
        program: the file with the text.
        name: its name in messages.
    """
    line, rest = 1, b""
    with program.open("rb") as file:
        while piece := file.read(READ_BYTES):
            whole, end, rest = (rest + piece).rpartition(b"\n")
            yield from _unknown_in((whole + end).decode("latin-1"), line, name)
            line += _lines(whole + end)
            rest = rest[-READ_BYTES:]
    yield from _unknown_in(rest.decode("latin-1"), line, name)


def _unknown_in(text: str, first_line: int, name: str) -> Iterator[Diagnostic]:
    if ":" not in text:  # most programs have none, and the search for comments takes longer
        return
    for comment in _COMMENT.finditer(text):
        for code in _CODE.finditer(text, comment.start(1), comment.end(1)):
            if code[0].lower() in ignorable_codes():
                continue
            begin = max(text.rfind("\n", 0, code.start()), text.rfind("\r", 0, code.start())) + 1
            yield Diagnostic(
                "ignored-code-unknown",
                f"no warning or note has the code {code[0]!r}; nothing is ignored",
                name,
                first_line + _lines(text[:begin].encode("latin-1")),
                column=code.start() - begin + 1,
                length=len(code[0]),
                text=re.split("[\r\n]", text[begin:], maxsplit=1)[0],
                hint=similar_codes(code[0]),
                severity="warning",
            )


def _lines(text: bytes) -> int:
    r"""Return the number of line ends (``\n``, ``\r`` or ``\r\n``) in a text."""
    return text.count(b"\n") + text.count(b"\r") - text.count(b"\r\n")
