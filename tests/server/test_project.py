"""The project file around the library holds for the jobs of the console."""

from __future__ import annotations

import pytest

from cnc.machine.load import shipped_machines
from cnc.machine.project import forget_projects
from tests.support.waiting import wait_until

FANUC_ALONE = "O0001\nG21 G90 G94 F100\n#100 = 5\nG65 P0002 A#100\nM30\nO0002\nG1 X#1\nM99\n"
"""A program that FANUC's control reads, and not GRBL."""


@pytest.fixture
def project(library):
    """Write the project file around the library; it is gone behind the test."""
    file = library.folder.parent / "cncrun.toml"
    yield file.write_text
    file.unlink(missing_ok=True)
    forget_projects()


def upload(client, name, text):
    assert client("PUT", f"/api/jobs/{name}", {"text": text}).status_code == 200


def checked(client, name):
    client("POST", f"/api/jobs/{name}/check")
    wait_until(lambda: client("GET", f"/api/jobs/{name}/check").status_code == 200)
    return client("GET", f"/api/jobs/{name}/check").json()


def codes(summary):
    return [finding["code"] for finding in summary["errors"]]


def test_jobs_are_read_and_judged_as_the_project_file_says(controller, project):
    project('[[programs]]\nfiles = ["jobs/f-*.nc"]\ndialect = "grbl"\n')
    for name in ("f-part.nc", "part.nc"):
        upload(controller, name, FANUC_ALONE)
    assert checked(controller, "part.nc")["ok"]
    assert not checked(controller, "f-part.nc")["ok"]
    assert checked(controller, "f-part.nc")["dialect"] == "grbl"
    # An edited project file holds from the next check on.
    project('dialect = "fanuc"\nerrors = ["feed-unreachable"]\n')
    fast = "G21 G90 G94 F999999\nG1 X5\nM30\n"
    upload(controller, "f-part.nc", fast)
    summary = checked(controller, "f-part.nc")
    assert not summary["ok"]
    assert "feed-unreachable" in codes(summary)
    project('ignore = ["feed-unreachable"]\n')
    upload(controller, "f-part.nc", fast)
    assert "feed-unreachable" not in codes(checked(controller, "f-part.nc"))


def test_a_text_has_the_same_findings_as_it_is_typed(controller, project):
    project('dialect = "grbl"\n')
    upload(controller, "typed.nc", "G1 X1 F100\n")
    typed = controller("POST", "/api/findings/typed.nc", {"text": FANUC_ALONE}).json()
    assert any(finding["severity"] == "error" for finding in typed)


def test_another_machine_of_the_project_file_is_told(controller, console, project):
    other = next(file for name, file in shipped_machines().items() if name != "trident")
    project(f'machine = "{other}"\n')
    upload(controller, "part.nc", "G21 G90 G94 F100\nG1 X5\nM30\n")
    summary = checked(controller, "part.nc")
    assert codes(summary).count("project-machine") == 1
    assert summary["ok"]
    project(f'machine = "{console.session.machine.file}"\n')
    upload(controller, "part.nc", "G21 G90 G94 F100\nG1 X6\nM30\n")
    assert "project-machine" not in codes(checked(controller, "part.nc"))


def test_a_run_is_read_as_the_project_file_says(controller, console, project):
    project('dialect = "grbl"\n')
    upload(controller, "part.nc", FANUC_ALONE)
    assert controller("POST", "/api/jobs/part.nc/run", {"trust_position": True}).status_code == 200
    wait_until(lambda: console.library.history()[0]["outcome"] == "failed")
    # The history is written before the machine is free again.
    wait_until(lambda: not console.session._worker._busy)
    project('dialect = "fanuc"\n')
    assert controller("POST", "/api/jobs/part.nc/run", {"trust_position": True}).status_code == 200
    wait_until(lambda: console.library.history()[0]["outcome"] == "done")
