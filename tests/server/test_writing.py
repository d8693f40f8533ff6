"""Requests that write: simple jobs, macros, and texts that are typed."""

from __future__ import annotations

from urllib.parse import quote

import pytest

from cnc.server.library import MOST_LOGS, Library, Run
from cnc.simple_jobs.programs import written

POCKET = "/api/simple-jobs/round-pocket"


def code(answer):
    return answer.status_code, answer.json()["code"]


def test_a_simple_job_is_written_into_the_library(client, library):
    kinds = {job["kind"] for job in client("GET", "/api/simple-jobs").json()}
    assert {"surfacing", "round-pocket", "text"} <= kinds
    body = {"name": "Bohrung \u2300 20.nc", "parameters": {"bore": 20, "depth": 3}}
    assert client("POST", POCKET, body).status_code == 200
    text = (library.folder / body["name"]).read_text(encoding="utf-8")
    assert text == written("round-pocket", body["parameters"])
    # A program of this name is replaced only on request.
    other = body | {"parameters": {"bore": 30}}
    assert code(client("POST", POCKET, other)) == (409, "job-exists")
    assert (library.folder / body["name"]).read_text(encoding="utf-8") == text
    assert client("POST", POCKET, other | {"replace": True}).status_code == 200
    assert (library.folder / body["name"]).read_text(encoding="utf-8") != text
    assert list(library.folder.glob(".cncrun/tmp*")) == []


@pytest.mark.parametrize(
    ("kind", "body", "refused"),
    [
        ("dovetail", {"name": "a.nc"}, (404, "job-kind")),
        ("slot", {"name": "../a.nc"}, (400, "job-name")),
        ("slot", {"name": "a.exe"}, (400, "job-name")),
        ("slot", {"name": "a.nc", "parameters": {"width": -1}}, (400, "job-parameter")),
        ("slot", {"name": "a.nc", "parameters": {"width": "wide"}}, (400, "job-parameter")),
        ("slot", {"name": "a.nc", "parameters": {"width": [1]}}, (400, "wrong-body")),
        ("text", {"name": "a.nc", "parameters": {"text": "(M3)\nM3"}}, (400, "job-parameter")),
        ("slot", {"name": "a.nc", "more": 1}, (400, "wrong-body")),
    ],
)
def test_a_wrong_simple_job_is_refused(client, library, kind, body, refused):
    assert code(client("POST", f"/api/simple-jobs/{kind}", body)) == refused
    assert not (library.folder / "a.nc").exists()


def test_the_findings_of_a_typed_text_are_those_of_a_check(client, library):
    (library.folder / "o7.nc").write_text("O7\nG0 X1\nM99\n")
    answer = client("POST", "/api/findings/new.nc", {"text": "G21 G90\nG0 X\nM2\n"})
    assert answer.status_code == 200
    (found,) = answer.json()
    assert (found["code"], found["line"], found["severity"]) == ("number-missing", 2, "error")
    assert (found["file"], found["column"]) == ("new.nc", 4)
    assert client("POST", "/api/findings/new.nc", {"text": "G21 G90\nG0 X1\nM2\n"}).json() == []
    assert not (library.folder / "new.nc").exists()
    assert code(client("POST", "/api/findings/..%2Fa.nc", {"text": ""}))[0] in (400, 404)
    assert code(client("POST", "/api/findings/a.exe", {"text": ""})) == (400, "job-name")
    long = {"text": "x" * 500_001}
    assert code(client("POST", "/api/findings/a.nc", long)) == (400, "wrong-body")


def test_a_text_that_another_client_has_changed_is_not_replaced(client, library):
    first = client("PUT", "/api/jobs/mine.nc", {"text": "G0 X1\n"}).json()
    path = "/api/jobs/mine.nc?changed={!r}"
    second = client("PUT", path.format(first["changed"]), {"text": "G0 X2\n"})
    assert second.status_code == 200
    (library.folder / "mine.nc").write_text("G0 X3\n")
    again = client("PUT", path.format(second.json()["changed"]), {"text": "G0 X4\n"})
    assert code(again) == (409, "job-changed")
    assert (library.folder / "mine.nc").read_text() == "G0 X3\n"
    assert code(client("PUT", "/api/jobs/no.nc?changed=1", {"text": ""})) == (404, "no-such-job")


def test_a_macro_is_written_read_and_removed(controller, library):
    text = "(up)\nG53 G0 Z0\nM2\n"
    assert controller("PUT", "/api/macros/lift up.ngc", {"text": text}).status_code == 200
    assert controller("GET", "/api/macros").json() == ["lift up.ngc"]
    assert controller("GET", "/api/macros/lift up.ngc").json() == {"text": text}
    for name in ("..ngc", "a/b.ngc", "con.ngc", "a.txt", "x" * 90 + ".ngc", "<b>.ngc"):
        answer = controller("PUT", f"/api/macros/{quote(name, safe='')}", {"text": text})
        assert answer.status_code in (400, 404)
    outside = library.folder / "outside"
    outside.write_text("G0 X1\n")
    (library.macros / "link.ngc").symlink_to(outside)
    answer = controller("PUT", "/api/macros/link.ngc", {"text": text})
    assert code(answer) == (400, "macro-unfit")
    assert outside.read_text() == "G0 X1\n"
    (library.macros / "link.ngc").unlink()
    (library.macros / "long.ngc").write_text(" " * 100_001)
    assert code(controller("GET", "/api/macros/long.ngc")) == (400, "macro-unfit")
    for name in ("lift up.ngc", "long.ngc"):
        assert controller("DELETE", f"/api/macros/{name}").status_code == 200
    assert code(controller("GET", "/api/macros/lift up.ngc")) == (404, "no-such-macro")
    assert code(controller("DELETE", "/api/macros/..%2Foutside")) in (
        (404, "http-error"),
        (404, "no-such-macro"),
    )
    assert outside.exists()


def test_each_run_keeps_its_log(tmp_path, client, library):
    own = Library(tmp_path)
    (own.folder / "a.nc").write_text("M2\n")
    for k in range(MOST_LOGS + 5):
        own.add_run(Run(job="a.nc", began=1000.0 + k, outcome="done"), f"run {k}\n")
    assert own.log("a.nc") == f"run {MOST_LOGS + 4}\n"
    assert own.log("a.nc", 1000.0 + 5) == "run 5\n"
    assert own.log("a.nc", 1000.0 + 4) == ""  # The oldest are removed.
    own.remove("a.nc")
    assert list((tmp_path / ".cncrun" / "logs").iterdir()) == []
    (library.folder / "b.nc").write_text("M2\n")
    library.add_run(Run(job="b.nc", began=7.25, outcome="done"), "first\n")
    library.add_run(Run(job="b.nc", began=8.5, outcome="done"), "second\n")
    assert client("GET", "/api/jobs/b.nc/log").json() == {"text": "second\n"}
    assert client("GET", "/api/jobs/b.nc/log?began=7.25").json() == {"text": "first\n"}
    assert client("GET", "/api/jobs/b.nc/log?began=nan").status_code == 400
