"""Results as JUnit XML, in the form that GitLab and Jenkins document."""

from __future__ import annotations

import re
from collections.abc import Sequence
from xml.etree import ElementTree

from cnc.model.diagnostics import EXIT_REJECTED
from cnc.model.shown_text import printable
from cnc.report.result import Report


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
    warnings = [each for each in report.counting if each.severity != "error"]
    if warnings:
        ElementTree.SubElement(case, "system-out").text = _clean(
            "\n".join(each.render() for each in warnings)
        )
    return case


def _clean(text: str) -> str:
    """Replace characters that XML 1.0 does not allow: control characters and lone surrogates."""
    return re.sub(
        "[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]",
        "\N{REPLACEMENT CHARACTER}",
        text,
    )
