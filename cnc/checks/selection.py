"""The catalogue of findings, and their selection: on the command line, or by comments.

    G1 X5 F99999 (cnc: ignore feed-unreachable)

Errors are always reported, because nothing turns a rejected program into a good one. An unknown
code is a fault itself: the user expects a finding to be ignored or shown, and it would not be.
"""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path

from cnc.model.diagnostics import Diagnostic, Severity, UsageError

# The catalogue of findings: meaning, remedy and severity of every code, from findings.toml.
#
# The reference page of the findings is generated from it. Warnings and notes are the findings that
# a user may select or ignore; errors are always reported.

REPORTED_ONCE = frozenset(("arc-radius-drift", "feed-unreachable", "move-below-step"))
"""Codes that are reported at the first of many places, with the number of places."""

ASSUMPTIONS = frozenset((
    "abort-possible", "axis-idle", "code-replaced", "code-skipped", "comment-mended",
    "control-variable",
    "cycle-level-assumed",
    "decimal-point-missing", "dwell-long", "dwell-point", "machine-coordinates-absolute",
    "motion-assumed", "percent-code-behind", "percent-unopened", "retraction-left-out",
    "rotary-axis-place", "tool-length-zero", "units-doubtful", "word-replaced",
))  # fmt: skip
"""Codes of findings that say how a part of the program was read that other controllers read
differently. The summary names the first of each."""


@dataclass(frozen=True, slots=True)
class Finding:
    """The description of a code.

    Attributes:
        code: as in messages and in the summary.
        meaning: the cause, in one or a few sentences.
        remedy: the action of the user.
        severity: an error ends the program; a warning or a note does not.
    """

    code: str
    meaning: str
    remedy: str
    severity: Severity = "error"


@cache
def groups() -> dict[str, tuple[Finding, ...]]:
    """Return the findings by the titles of their groups, in the order of the reference page."""
    text = (resources.files(__package__) / "findings.toml").read_text(encoding="utf-8")
    return {
        group["title"]: tuple(Finding(code, **entry) for code, entry in group["finding"].items())
        for group in tomllib.loads(text)["group"]
    }


@cache
def findings() -> dict[str, Finding]:
    """Return all findings by their codes."""
    return {finding.code: finding for group in groups().values() for finding in group}


@cache
def ignorable_codes() -> tuple[str, ...]:
    """Return the codes of warnings and notes in alphabetical order."""
    return tuple(
        sorted(finding.code for finding in findings().values() if finding.severity != "error")
    )


def check_codes(codes: Iterable[str]) -> None:
    """Raise UsageError ``unknown-finding`` for the first code that no warning or note has."""
    for code in sorted(codes):
        if code not in ignorable_codes():
            message = f"no warning or note has the code {code!r}; errors are always reported"
            raise UsageError(Diagnostic("unknown-finding", message, hint=similar_codes(code)))


def similar_codes(code: str) -> str:
    """Return a hint for an unknown code: the codes of warnings and notes like it, or all."""
    close = difflib.get_close_matches(code.lower(), ignorable_codes(), n=3, cutoff=0.6)
    if close:
        return f"did you mean {' or '.join(close)}?"
    return f"the codes are {', '.join(ignorable_codes())}"


def markdown() -> str:
    """Return the reference page of all findings, one heading for each code."""
    lines = [
        "# Findings",
        "",
        "Errors, warnings and notes by their codes. The message of a finding names the place and",
        "the values; often a hint follows. Warnings and notes can be ignored with `--ignore CODE`",
        "or with the comment `(cnc: ignore CODE)` in the line. Errors are always reported.",
        "",
    ]
    for title, group in groups().items():
        lines += [f"## {title}", ""]
        for finding in group:
            kind = "" if finding.severity == "error" else f"*{finding.severity.capitalize()}.* "
            lines += [f"### {finding.code}", "", f"{kind}{finding.meaning} {finding.remedy}", ""]
    return "\n".join(lines)


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
        errors: codes that count as errors.

    Raises:
        UsageError: ``unknown-finding`` for a code that no warning or note has.
    """

    select: frozenset[str] = field(default_factory=frozenset)
    ignore: frozenset[str] = field(default_factory=frozenset)
    errors: frozenset[str] = field(default_factory=frozenset)

    def __post_init__(self) -> None:
        check_codes(self.select | self.ignore | self.errors)

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
