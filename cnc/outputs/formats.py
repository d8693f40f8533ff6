"""Findings of many programs in the forms that other tools read: SARIF, JUnit, GitHub's workflow
commands.

Sources: OASIS, "Static Analysis Results Interchange Format (SARIF) Version 2.1.0"; the JUnit XML
that GitLab and Jenkins document; GitHub, "Workflow commands for GitHub Actions".
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote
from xml.etree import ElementTree

from cnc import __version__
from cnc.model.diagnostics import EXIT_REJECTED, Diagnostic
from cnc.outputs.targets import STANDARD_OUTPUT, TextTarget
from cnc.report.result import Report

Format = Literal["sarif", "junit", "github"]
SARIF_SCHEMA = (
    "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"
)


def write_format(form: Format, reports: Sequence[Report]) -> None:
    """Write ``reports`` to standard output."""
    target = TextTarget(STANDARD_OUTPUT)
    target.write(_WRITERS[form](reports))
    target.close()


def sarif(reports: Sequence[Report]) -> str:
    """A SARIF log of one run. Columns count characters; a program that was not checked to its end
    is told by its error.
    """
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
    return json.dumps({"$schema": SARIF_SCHEMA, "version": "2.1.0", "runs": [run]}, indent=2) + "\n"


def _with_states(report: Report) -> Iterator[tuple[Diagnostic, dict[str, str]]]:
    """The findings, and beside an earlier check what SARIF calls their baseline state; those that
    are gone, too.
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
        place: dict[str, Any] = {"artifactLocation": {"uri": _uri(finding.file)}}
        if finding.line:
            place["region"] = _region(finding)
        result["locations"] = [{"physicalLocation": place}]
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
    """A file as a URI: relative if its name is, so that it is found in a checkout."""
    path = Path(name)
    # the bytes of a name that is no UTF-8 are kept
    escaped = quote(os.fsencode(path.as_posix()), safe="/")
    if path.is_absolute():
        return f"file://{escaped}" if escaped.startswith("/") else f"file:///{escaped}"
    return escaped


def junit(reports: Sequence[Report]) -> str:
    """A JUnit test suite: a test case a program, which fails by its errors; warnings are its
    output.
    """
    suite = ElementTree.Element("testsuite", name="cncrun check")
    failures = errors = 0
    for report in reports:
        case = ElementTree.SubElement(
            suite,
            "testcase",
            classname="cncrun",
            name=_clean(report.program),
            time=f"{report.timing.total_s:.3f}",
        )
        faults = report.counting_faults
        if faults:
            rejected = report.exit_code == EXIT_REJECTED
            failures, errors = failures + rejected, errors + (not rejected)
            first = faults[0].diagnostic
            told = [_clean(fault.diagnostic.render()) for fault in faults]
            if report.hidden_faults:
                told.append(f"{report.hidden_faults} more places outside the travel are not shown")
            wrong = ElementTree.SubElement(
                case,
                "failure" if rejected else "error",
                type=first.code,
                message=_clean(first.message),
            )
            wrong.text = "\n".join(told)
        warnings = [each for each in report.counting if each.severity != "error"]
        if warnings:
            ElementTree.SubElement(case, "system-out").text = _clean(
                "\n".join(each.render() for each in warnings)
            )
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


def _clean(text: str) -> str:
    """Text that XML 1.0 can hold: no control characters, no halves of characters."""
    return re.sub(
        "[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]",
        "\N{REPLACEMENT CHARACTER}",
        text,
    )


def github(reports: Sequence[Report]) -> str:
    """A workflow command a finding that counts: GitHub shows it at its line in the changes. Of each
    severity it shows ten a step.
    """
    return "".join(_command(finding) for report in reports for finding in report.counting)


def _command(finding: Diagnostic) -> str:
    places: list[tuple[str, str | int]] = [("file", finding.file)] if finding.file else []
    if finding.file and finding.line:
        places += [("line", finding.line), ("endLine", finding.line)]
        if finding.column:
            places += [
                ("col", finding.column),
                ("endColumn", finding.column + max(1, finding.length)),
            ]
    places.append(("title", finding.code))
    level = "notice" if finding.severity == "note" else finding.severity
    message = f"{finding.message}\nhelp: {finding.hint}" if finding.hint else finding.message
    properties = ",".join(f"{key}={_escaped(str(value), ':,')}" for key, value in places)
    return f"::{level} {properties}::{_escaped(message)}\n"


def _escaped(text: str, more: Iterable[str] = ()) -> str:
    """Text that neither ends a workflow command nor begins one."""
    for each in ("%", "\r", "\n", *more):
        text = text.replace(each, f"%{ord(each):02X}")
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


_WRITERS: dict[Format, Callable[[Sequence[Report]], str]] = {
    "sarif": sarif,
    "junit": junit,
    "github": github,
}
