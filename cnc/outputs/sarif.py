"""Findings as SARIF, for code scanning tools.

Source: OASIS, "Static Analysis Results Interchange Format (SARIF) Version 2.1.0".
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from cnc.model.diagnostics import EXIT_REJECTED, Diagnostic
from cnc.model.shown_text import shown_json
from cnc.report.result import Report
from cnc.version import __version__

SARIF_SCHEMA = (
    "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"
)


def sarif(reports: Sequence[Report]) -> str:
    """Return the findings of all programs as a SARIF log of one run. Columns count characters."""
    codes: dict[str, int] = {}
    results = [
        _result(finding, codes) | state
        for report in reports
        for finding, state in _with_states(report)
    ]
    driver = {"name": "cncrun", "version": __version__, "rules": [{"id": code} for code in codes]}
    exit_code = max((report.exit_code for report in reports), default=0)
    run = {
        "tool": {"driver": driver},
        "columnKind": "unicodeCodePoints",
        "invocations": [{"executionSuccessful": exit_code <= EXIT_REJECTED, "exitCode": exit_code}],
        "artifacts": [
            {"location": {"uri": _uri(name)}}
            for name in dict.fromkeys(report.program for report in reports)
        ],
        "results": results,
    }
    log = {"$schema": SARIF_SCHEMA, "version": "2.1.0", "runs": [run]}
    return shown_json(json.dumps(log, indent=2)) + "\n"


def _with_states(report: Report) -> Iterator[tuple[Diagnostic, dict[str, str]]]:
    """Yield each finding and, with a baseline, its SARIF property ``baselineState``.

    With a baseline the findings that have disappeared are included.
    """
    changes = report.changes
    if changes is None:
        yield from ((finding, {}) for finding in report.findings)
        return
    for state, findings in (
        ("new", changes.new),
        ("unchanged", changes.kept),
        ("absent", changes.gone),
    ):
        yield from ((finding, {"baselineState": state}) for finding in findings)


def _result(finding: Diagnostic, codes: dict[str, int]) -> dict[str, Any]:
    text = f"{finding.message}\nhelp: {finding.hint}" if finding.hint else finding.message
    result: dict[str, Any] = {
        "ruleId": finding.code,
        "ruleIndex": codes.setdefault(finding.code, len(codes)),
        "level": finding.severity,
        "message": {"text": text},
    }
    if finding.file:
        location: dict[str, Any] = {"artifactLocation": {"uri": _uri(finding.file)}}
        if finding.line:
            location["region"] = _region(finding)
        result["locations"] = [{"physicalLocation": location}]
    return result


def _region(finding: Diagnostic) -> dict[str, Any]:
    region: dict[str, Any] = {"startLine": finding.line}
    if finding.column:
        region |= {
            "startColumn": finding.column,
            "endColumn": finding.column + max(1, finding.length),
        }
    if finding.text:
        region["snippet"] = {"text": finding.text}
    return region


def _uri(name: str) -> str:
    """Return a file name as a URI. A relative name stays relative to the checkout."""
    path = Path(name)
    # fsencode keeps the bytes of a name that is not UTF-8.
    escaped = quote(os.fsencode(path.as_posix()), safe="/")
    if path.is_absolute():
        return f"file://{escaped}" if escaped.startswith("/") else f"file:///{escaped}"
    return escaped
