"""The command ``cncrun schema``."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from cnc import cli
from cnc.machine.load import shipped_machines
from tests.support.paths import ROOT


def printed(document: str, capsys: pytest.CaptureFixture[str]) -> Draft202012Validator:
    assert cli.exit_code(["schema", document]) == 0
    schema = json.loads(capsys.readouterr().out)
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


def test_shipped_machine_files_satisfy_the_machine_schema(
    capsys: pytest.CaptureFixture[str],
) -> None:
    validator = printed("machine", capsys)
    names = sorted(shipped_machines())
    assert names
    for name in names:
        validator.validate(tomllib.loads((ROOT / "config" / f"{name}.toml").read_text()))
    assert list(validator.iter_errors({"axes": {"x": {"steps": 1}}}))


def test_a_summary_satisfies_the_summary_schema(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program = tmp_path / "p.nc"
    program.write_text("G21 G90\nG1 X5 F600\nM2\n")
    summary = tmp_path / "s.json"
    assert cli.exit_code([str(program), "--json", str(summary), "--quiet"]) == 0
    validator = printed("summary", capsys)
    found = json.loads(summary.read_text())
    validator.validate(found)
    assert list(validator.iter_errors({**found, "duration_s": "long"}))


def test_an_unknown_document_is_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.exit_code(["schema", "trace"]) == 2
    assert "machine" in capsys.readouterr().err
