"""Calls of missing programs on the command line: a check passes with a warning, a run refuses."""

from __future__ import annotations

import json


def test_a_missing_program_is_a_warning_of_a_check_and_an_error_of_a_run(cncrun, tmp_path):
    path = tmp_path / "part.nc"
    path.write_text("G0 X1\nM98 P9004\nG0 X2\nM30\n")
    ended, out, _ = cncrun("check", str(path), "--format", "json", "--quiet")
    report = json.loads(out)
    assert (ended, [each["code"] for each in report["errors"]]) == (0, ["subprogram-missing"])
    ended, _, err = cncrun(str(path), "--quiet")
    assert ended == 1
    assert err.startswith(f"{path}:2:5: program-unknown: there is no program O9004\n")
