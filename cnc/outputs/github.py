"""Findings as workflow commands of GitHub Actions.

Source: GitHub, "Workflow commands for GitHub Actions".
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from cnc.model.diagnostics import Diagnostic
from cnc.model.shown_text import printable
from cnc.report.result import Report


def github(reports: Sequence[Report]) -> str:
    """Return one workflow command for each finding that counts.

    GitHub shows them at their lines in the changes, up to ten of each severity in a step.
    """
    return "".join(_command(finding) for report in reports for finding in report.counting)


def _command(finding: Diagnostic) -> str:
    properties: list[tuple[str, str | int]] = (
        [("file", printable(finding.file))] if finding.file else []
    )
    if finding.file and finding.line:
        properties += [("line", finding.line), ("endLine", finding.line)]
        if finding.column:
            properties += [
                ("col", finding.column),
                ("endColumn", finding.column + max(1, finding.length)),
            ]
    properties.append(("title", finding.code))
    level = "notice" if finding.severity == "note" else finding.severity
    message = f"{finding.message}\nhelp: {finding.hint}" if finding.hint else finding.message
    listed = ",".join(f"{key}={_escaped(str(value), ':,')}" for key, value in properties)
    return f"::{level} {listed}::{_escaped(message)}\n"


def _escaped(text: str, more: Iterable[str] = ()) -> str:
    """Escape the characters that would end a workflow command or begin another."""
    for each in ("%", "\r", "\n", *more):
        text = text.replace(each, f"%{ord(each):02X}")
    return text.encode("utf-8", "backslashreplace").decode("utf-8")
