"""The catalogue of findings: meaning, remedy and severity of every code, from findings.toml.

The reference page of the findings is generated from it. Warnings and notes are the findings that
a user may select or ignore; errors are always reported.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from importlib import resources

from cnc.model.diagnostics import Diagnostic, Severity, UsageError

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
    return {each.code: each for group in groups().values() for each in group}


@cache
def ignorable_codes() -> tuple[str, ...]:
    """Return the codes of warnings and notes in alphabetical order."""
    return tuple(sorted(each.code for each in findings().values() if each.severity != "error"))


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
        for each in group:
            kind = "" if each.severity == "error" else f"*{each.severity.capitalize()}.* "
            lines += [f"### {each.code}", "", f"{kind}{each.meaning} {each.remedy}", ""]
    return "\n".join(lines)
