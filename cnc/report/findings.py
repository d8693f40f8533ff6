"""Findings of many programs in the format of another tool: SARIF, JUnit or GitHub."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote
from xml.etree import ElementTree

from cnc.model.diagnostics import EXIT_REJECTED, Diagnostic, Fix, printable, shown_json
from cnc.report.result import Report
from cnc.report.targets import STANDARD_OUTPUT, TextTarget
from cnc.version import __version__

# Findings as workflow commands of GitHub Actions.
#
# Source: GitHub, "Workflow commands for GitHub Actions".


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
    for character in ("%", "\r", "\n", *more):
        text = text.replace(character, f"%{ord(character):02X}")
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


# Results as JUnit XML, in the form that GitLab and Jenkins document.


def junit(reports: Sequence[Report]) -> str:
    """Return a JUnit test suite with one test case for each program.

    A rejected program is a failure; a fault of the machine file, the command line or the board is
    an error. Warnings and notes are the output of the test case.
    """
    suite = ElementTree.Element("testsuite", name="cncrun check")
    failures = errors = 0
    for report in reports:
        case = _add_case(suite, report)
        failures += case.find("failure") is not None
        errors += case.find("error") is not None
    for key, value in (
        ("tests", len(reports)),
        ("failures", failures),
        ("errors", errors),
        ("skipped", 0),
    ):
        suite.set(key, str(value))
    suite.set("time", f"{sum(report.timing.total_s for report in reports):.3f}")
    suites = ElementTree.Element("testsuites")
    suites.append(suite)
    ElementTree.indent(suites)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        + ElementTree.tostring(suites, encoding="unicode")
        + "\n"
    )


def _add_case(suite: ElementTree.Element, report: Report) -> ElementTree.Element:
    """Append the test case of one program to ``suite`` and return it."""
    case = ElementTree.SubElement(
        suite,
        "testcase",
        classname="cncrun",
        name=printable(report.program),
        time=f"{report.timing.total_s:.3f}",
    )
    faults = report.counting_faults
    if faults:
        first = faults[0].diagnostic
        messages = [_clean(fault.diagnostic.render()) for fault in faults]
        if report.hidden_faults:
            messages.append(f"{report.hidden_faults} more places outside the travel are not shown")
        result = ElementTree.SubElement(
            case,
            "failure" if report.exit_code == EXIT_REJECTED else "error",
            type=first.code,
            message=_clean(first.message),
        )
        result.text = "\n".join(messages)
    warnings = [finding for finding in report.counting if finding.severity != "error"]
    if warnings:
        ElementTree.SubElement(case, "system-out").text = _clean(
            "\n".join(finding.render() for finding in warnings)
        )
    return case


def _clean(text: str) -> str:
    """Replace characters that XML 1.0 does not allow: control characters and lone surrogates."""
    return re.sub(
        "[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]",
        "\N{REPLACEMENT CHARACTER}",
        text,
    )


# Findings as SARIF, for code scanning tools.
#
# Source: OASIS, "Static Analysis Results Interchange Format (SARIF) Version 2.1.0".

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
        if finding.fix is not None:
            result["fixes"] = [_fix(finding, finding.fix)]
    return result


def _fix(finding: Diagnostic, fix: Fix) -> dict[str, Any]:
    replacements = [
        {
            "deletedRegion": {
                "startLine": edit.line or finding.line,
                "startColumn": edit.column,
                "endColumn": edit.column + edit.length,
            },
            "insertedContent": {"text": edit.text},
        }
        for edit in fix.edits
    ]
    change = {"artifactLocation": {"uri": _uri(finding.file)}, "replacements": replacements}
    return {
        "description": {"text": fix.title},
        "artifactChanges": [change],
        "properties": {"safe": fix.safe},
    }


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


Format = Literal["sarif", "junit", "github"]

_FORMATS: dict[Format, Callable[[Sequence[Report]], str]] = {
    "sarif": sarif,
    "junit": junit,
    "github": github,
}


def write_findings(form: Format, reports: Sequence[Report]) -> None:
    """Write the findings of ``reports`` to standard output."""
    target = TextTarget(STANDARD_OUTPUT)
    target.write(_FORMATS[form](reports))
    target.close()
