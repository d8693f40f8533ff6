"""Findings as SARIF, JUnit and GitHub commands: the output is valid for all names and messages."""

import json
import re
from urllib.parse import unquote_to_bytes
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.machine.load import load_machine
from cnc.model.diagnostics import CncError, Diagnostic, GcodeError, UsageError
from cnc.report.findings import github, junit, sarif
from cnc.report.result import Report, Timing

MACHINE = load_machine("default")
AWKWARD = st.text(
    st.characters(exclude_categories=()), max_size=30
)  # every code point, lone surrogates included
NAMES = (
    st.binary(min_size=1, max_size=20)
    .filter(lambda name: b"\0" not in name)
    .map(lambda name: name.decode("utf-8", "surrogateescape"))
)
DIAGNOSTICS = st.builds(
    Diagnostic,
    st.sampled_from(["arc-radius-mismatch", "soft-limit", "word-unused"]),
    AWKWARD,
    NAMES | st.just(""),
    st.integers(0, 10_000),
    st.integers(0, 300),
    st.integers(0, 300),
    AWKWARD,
    AWKWARD,
    st.sampled_from(["error", "warning", "note"]),
)
REPORTS = st.builds(
    lambda program, faults, warnings, kind: Report(
        program, MACHINE, faults=[kind(fault) for fault in faults], warnings=warnings
    ),
    NAMES,
    st.lists(DIAGNOSTICS, max_size=3),
    st.lists(DIAGNOSTICS, max_size=3),
    st.sampled_from([GcodeError, UsageError, CncError]),
)
FAULT = Diagnostic(
    "arc-radius-mismatch",
    "1.5 mm off, or 50% of it",
    "shop/a b,c:d.nc",
    4,
    12,
    4,
    "G2 X10 Y0 I5 J1.5",
    "give I\nand J",
)
WARNING = Diagnostic(
    "spindle-speed-missing", "M3 without S", "shop/a b,c:d.nc", 9, severity="warning"
)


def report(
    name: str = "shop/a b,c:d.nc", faults: tuple[CncError, ...] = (GcodeError(FAULT),), **more
) -> Report:
    return Report(
        name, MACHINE, faults=list(faults), warnings=[WARNING], timing=Timing(total_s=0.25), **more
    )


# SARIF

OBJECTS = {
    "log": ({"version", "runs"}, {"$schema": str, "version": str, "runs": ["run"]}),
    "run": (
        {"tool"},
        {
            "tool": "tool",
            "invocations": ["invocation"],
            "artifacts": ["artifact"],
            "results": ["result"],
            "columnKind": str,
        },
    ),
    "tool": ({"driver"}, {"driver": "component"}),
    "component": ({"name"}, {"name": str, "version": str, "rules": ["rule"]}),
    "rule": ({"id"}, {"id": str}),
    "invocation": ({"executionSuccessful"}, {"executionSuccessful": bool, "exitCode": int}),
    "artifact": (set(), {"location": "artifactLocation"}),
    "result": (
        {"message"},
        {
            "ruleId": str,
            "ruleIndex": int,
            "level": str,
            "message": "message",
            "locations": ["location"],
        },
    ),
    "message": ({"text"}, {"text": str}),
    "location": (set(), {"physicalLocation": "physicalLocation"}),
    "physicalLocation": (
        {"artifactLocation"},
        {"artifactLocation": "artifactLocation", "region": "region"},
    ),
    "artifactLocation": (set(), {"uri": str}),
    "region": (
        {"startLine"},
        {"startLine": int, "startColumn": int, "endColumn": int, "snippet": "content"},
    ),
    "content": (set(), {"text": str}),
}
"""The part of the SARIF 2.1.0 schema that is used: required properties and types of each object."""
URI_REFERENCE = re.compile(r"(file://)?(%[0-9A-F]{2}|[A-Za-z0-9._~/-])*")


def check_object(value: object, kind: object) -> None:
    """Compare with OBJECTS; every object of the schema forbids additional properties."""
    if isinstance(kind, list):
        assert isinstance(value, list)
        for each in value:
            check_object(each, kind[0])
    elif isinstance(kind, type):
        assert type(value) is kind
    else:
        required, allowed = OBJECTS[kind]
        assert isinstance(value, dict)
        assert required <= set(value) <= set(allowed)
        for key, each in value.items():
            check_object(each, allowed[key])
        if kind == "artifact":
            assert URI_REFERENCE.fullmatch(value["location"]["uri"])
        if kind == "region":
            assert all(value.get(key, 1) >= 1 for key in ("startLine", "startColumn", "endColumn"))
        if kind == "result":
            assert value["level"] in ("none", "note", "warning", "error")


def check_sarif(text: str) -> dict:
    log = json.loads(text)
    check_object(log, "log")
    assert log["version"] == "2.1.0"
    (run,) = log["runs"]
    assert run["columnKind"] in ("utf16CodeUnits", "unicodeCodePoints")
    rules = [rule["id"] for rule in run["tool"]["driver"]["rules"]]
    assert len(set(rules)) == len(rules)
    for result in run["results"]:
        assert rules[result["ruleIndex"]] == result["ruleId"]
    for unique in run["artifacts"], rules:
        assert len({json.dumps(each) for each in unique}) == len(unique)
    return run


@given(st.lists(REPORTS, max_size=3))
def test_sarif_follows_the_schema(reports):
    run = check_sarif(sarif(reports))
    assert len(run["results"]) == sum(len(each.findings) for each in reports)


def test_sarif_has_place_rule_level_and_help():
    run = check_sarif(sarif([report(), report("good.nc", ())]))
    first, warning, _ = run["results"]
    assert (first["ruleId"], first["level"]) == ("arc-radius-mismatch", "error")
    assert first["message"]["text"] == "1.5 mm off, or 50% of it\nhelp: give I\nand J"
    place = first["locations"][0]["physicalLocation"]
    assert place["artifactLocation"]["uri"] == "shop/a%20b%2Cc%3Ad.nc"
    assert place["region"] == {
        "startLine": 4,
        "startColumn": 12,
        "endColumn": 16,
        "snippet": {"text": "G2 X10 Y0 I5 J1.5"},
    }
    assert warning["level"] == "warning"
    assert warning["locations"][0]["physicalLocation"]["region"] == {"startLine": 9}
    assert [each["location"]["uri"] for each in run["artifacts"]] == [
        "shop/a%20b%2Cc%3Ad.nc",
        "good.nc",
    ]
    assert run["invocations"] == [{"executionSuccessful": True, "exitCode": 1}]


def test_sarif_of_an_unreadable_program_is_an_unsuccessful_run():
    run = check_sarif(
        sarif([report(faults=(UsageError(Diagnostic("no-such-file", "there is no file x.nc")),))])
    )
    assert run["invocations"] == [{"executionSuccessful": False, "exitCode": 2}]
    assert "locations" not in run["results"][0]


@pytest.mark.parametrize(
    ("name", "uri"), [("/srv/a b.nc", "file:///srv/a%20b.nc"), ("caf\udce9.nc", "caf%E9.nc")]
)
def test_sarif_keeps_the_bytes_of_file_names(name, uri):
    run = check_sarif(sarif([report(name, ())]))
    assert run["artifacts"][0]["location"]["uri"] == uri
    assert unquote_to_bytes(uri).endswith(name.encode("utf-8", "surrogateescape"))


# JUnit


@given(st.lists(REPORTS, max_size=3))
def test_junit_has_a_test_case_for_each_program(reports):
    text = junit(reports).encode()
    suite = ElementTree.fromstring(text).find("testsuite")
    assert len(suite.findall("testcase")) == int(suite.get("tests")) == len(reports)
    assert len(suite.findall("testcase/failure")) == int(suite.get("failures"))
    assert len(suite.findall("testcase/error")) == int(suite.get("errors"))
    assert int(suite.get("failures")) + int(suite.get("errors")) == sum(
        not each.ok for each in reports
    )


def test_junit_has_failures_errors_and_warnings():
    usage = UsageError(Diagnostic("no-such-file", "there is no file <x>"))
    reports = [report(hidden_faults=3), report("x", (usage,)), report("good.nc", ())]
    suite = ElementTree.fromstring(junit(reports).encode()).find("testsuite")
    assert {key: suite.get(key) for key in ("tests", "failures", "errors", "skipped", "time")} == {
        "tests": "3", "failures": "1", "errors": "1", "skipped": "0", "time": "0.750",
    }  # fmt: skip
    bad, missing, good = suite.findall("testcase")
    assert (bad.get("name"), bad.get("time")) == ("shop/a b,c:d.nc", "0.250")
    failure = bad.find("failure")
    assert (failure.get("type"), failure.get("message")) == ("arc-radius-mismatch", FAULT.message)
    assert failure.text == FAULT.render() + "\n3 more places outside the travel are not shown"
    assert bad.find("system-out").text == WARNING.render()
    assert missing.find("error").get("message") == "there is no file <x>"
    assert good.find("failure") is good.find("error") is None


# GitHub


def read_command(line: str) -> tuple[str, dict[str, str], str]:
    """Parse a workflow command like the runner of GitHub: split first, then unescape."""
    found = re.fullmatch(r"::(\w+)(?: ([^:]*))?::(.*)", line)
    properties = dict(each.split("=", 1) for each in found[2].split(","))

    def plain(text: str, *more: str) -> str:
        for each in ("\r", "\n", *more, "%"):
            text = text.replace(f"%{ord(each):02X}", each)
        return text

    return (
        found[1],
        {key: plain(value, ":", ",") for key, value in properties.items()},
        plain(found[3]),
    )


@given(st.lists(REPORTS, max_size=3))
def test_github_reads_the_same_values(reports):
    findings = [finding for each in reports for finding in each.findings]
    lines = github(reports).split("\n")
    assert lines.pop() == ""
    for line, finding in zip(lines, findings, strict=True):
        level, properties, message = read_command(line)
        assert level == {"error": "error", "warning": "warning", "note": "notice"}[finding.severity]
        assert properties["title"] == finding.code
        expected = f"{finding.message}\nhelp: {finding.hint}" if finding.hint else finding.message
        assert message == expected.encode("utf-8", "backslashreplace").decode()
        assert ("line" in properties) == bool(finding.file and finding.line)


def test_github_commands_have_places():
    first, second = github([report()]).splitlines()
    assert first == (
        "::error file=shop/a b%2Cc%3Ad.nc,line=4,endLine=4,col=12,endColumn=16,"
        "title=arc-radius-mismatch::"
        "1.5 mm off, or 50%25 of it%0Ahelp: give I%0Aand J"
    )
    assert second.startswith(
        "::warning file=shop/a b%2Cc%3Ad.nc,line=9,endLine=9,title=spindle-speed-missing::"
    )
