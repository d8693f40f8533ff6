"""Requests of a client that has control, and of one that has not."""

from __future__ import annotations

import json
import subprocess
from concurrent.futures import Future
from pathlib import Path
from urllib.parse import quote

import pytest

from cnc.machine.load import load_machine
from cnc.server.checking import MOST_CHANGED
from cnc.server.console import _Run
from cnc.session.options import RunOptions
from tests.support.waiting import wait_until

PROGRAM = "G21 G90\nG0 X5 Y5\nG1 X20 F3000\nG2 X30 I5\nG1 X5\nM2\n"


def idle(console):
    wait_until(lambda: not console.session._worker._busy)


def x_of(console):
    return console.session.state.machine["x"]


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("POST", "/api/connect", {}),
        ("POST", "/api/disconnect", {}),
        ("POST", "/api/home", {}),
        ("POST", "/api/unlock", {}),
        ("POST", "/api/jog/step", {"distances": {"x": 1}}),
        ("POST", "/api/jog/start", {"directions": {"x": 1}}),
        ("POST", "/api/zero", {"axes": {"x": 0}}),
        ("POST", "/api/mdi", {"line": "G0 X1"}),
        ("POST", "/api/macros/a.ngc/run", {}),
        ("PUT", "/api/macros/a.ngc", {"text": "G0 X1\nM2\n"}),
        ("DELETE", "/api/macros/a.ngc", None),
        ("POST", "/api/probing/probe_z/run", {}),
        ("POST", "/api/height-maps/plate/probe", {"x": [0, 9], "y": [0, 9]}),
        ("POST", "/api/height-maps/plate/again", {"points": [[0, 0]]}),
        ("DELETE", "/api/height-maps/plate", None),
        ("POST", "/api/measure/backlash", {"axis": "x"}),
        ("POST", "/api/measure/pitch", {"axis": "x", "first": 0, "last": 9}),
        ("POST", "/api/measure/square", {"axes": "xy", "lengths": [50, 50]}),
        ("POST", "/api/measure/limits", {"axis": "x"}),
        ("POST", "/api/measure/ringing", {"text": ""}),
        ("POST", "/api/measurement/write", {"number": 1}),
        ("DELETE", "/api/measurement", None),
        ("POST", "/api/hold", {}),
        ("POST", "/api/resume", {}),
        ("POST", "/api/override", {"feed": 50}),
        ("POST", "/api/answer", {"dialog": 1, "yes": True}),
        ("PUT", "/api/settings/110", {"value": "1"}),
        ("POST", "/api/jobs/a.nc/run", {}),
        ("POST", "/api/jobs/a.nc/repair", {"code": "a", "line": 1, "column": 1, "version": ""}),
        ("DELETE", "/api/jobs/a.nc", None),
        ("DELETE", "/api/control", None),
    ],
)
def test_a_command_needs_control(client, method, path, body):
    for key in (None, "wrong"):
        headers = {} if key is None else {"x-control": key}
        answer = client(method, path, body, headers=headers)
        assert (answer.status_code, answer.json()["code"]) == (409, "no-control")


def test_a_long_job_has_a_coarse_picture_while_another_is_checked(
    controller, console, monkeypatch, tmp_path
):
    """The picture goes when the check ends, so the check waits here."""
    monkeypatch.setattr("cnc.server.console.SKETCHED", 10)
    controller("PUT", "/api/jobs/sketched.nc", {"text": PROGRAM})
    assert controller("GET", "/api/jobs/sketched.nc/sketch").status_code == 404
    over = tmp_path / "over"
    other = f"until [ -e '{over}' ]; do sleep 0.05; done"
    console._workers().pool.submit(subprocess.run, ["sh", "-c", other])
    try:
        assert controller("POST", "/api/jobs/sketched.nc/check").status_code == 200
        wait_until(lambda: controller("GET", "/api/jobs/sketched.nc/sketch").status_code == 200)
        about = controller("GET", "/api/jobs/sketched.nc/sketch").json()["about"]
    finally:
        over.touch()
    assert about["extent"][0] == pytest.approx([0.0, 30.0], abs=1e-3)
    assert about["extent"][1] == pytest.approx([0.0, 10.0], abs=0.06)


def test_control_that_is_taken_is_lost_by_the_one_before(controller, app):
    from tests.server.conftest import Client

    second = Client(app)
    second.take_control()
    refused = controller("POST", "/api/hold")
    assert (refused.status_code, refused.json()["message"]) == (409, "test has control")
    assert second("POST", "/api/hold").status_code == 200


def test_a_jog_a_zero_and_a_line(controller, console):
    idle(console)
    before = x_of(console)
    assert controller("POST", "/api/jog/step", {"distances": {"x": 3}}).status_code == 200
    idle(console)
    assert x_of(console) == pytest.approx(before + 3.0, abs=0.01)
    offsets = controller("POST", "/api/zero", {"axes": {"x": 1.0}}).json()
    assert offsets["G54"]["x"] == pytest.approx(before + 2.0, abs=0.01)
    assert controller("GET", "/api/offsets").json() == offsets
    assert controller("POST", "/api/mdi", {"line": "G0 X0"}).status_code == 200
    idle(console)
    assert controller("GET", "/api/state").json()["work"]["x"] == pytest.approx(0.0, abs=0.01)
    assert controller("GET", "/api/mdi").json()[-1] == "G0 X0"


def test_a_jog_ends_without_signs_of_life_and_by_its_release(controller, console):
    idle(console)
    started = controller("POST", "/api/jog/start", {"directions": {"y": 1}}).json()
    assert controller("POST", "/api/jog/keep", {"jog": started["jog"]}).json()["accepted"]
    assert started["feed"] > 0
    controller("POST", "/api/jog/stop")
    idle(console)
    assert not controller("POST", "/api/jog/keep", {"jog": started["jog"]}).json()["accepted"]
    controller("POST", "/api/jog/start", {"directions": {"y": -1}})
    idle(console)


def test_a_busy_machine_and_a_limit_are_errors_with_a_hint(controller, console):
    idle(console)
    answer = controller("POST", "/api/jog/step", {"distances": {"x": 9999}})
    assert (answer.status_code, answer.json()["code"]) == (400, "soft-limit")
    assert answer.json()["hint"]
    controller("POST", "/api/mdi", {"line": "G4 P0.5"})
    answer = controller("POST", "/api/mdi", {"line": "G0 X1"})
    assert (answer.status_code, answer.json()["code"]) == (409, "machine-busy")
    idle(console)


def test_a_job_from_its_upload_to_its_history(controller, console, library):
    idle(console)
    seen = []
    end = console.session.listen(seen.append)
    assert controller("PUT", "/api/jobs/part.nc", {"text": PROGRAM}).json()["size"] == len(PROGRAM)
    job = controller("GET", "/api/jobs/part.nc").json()
    assert (job["lines"], job["check"], job["history"]) == (6, None, [])
    text = controller("GET", "/api/jobs/part.nc/text?first=2&count=2").json()
    assert text == {"first": 2, "lines": ["G0 X5 Y5", "G1 X20 F3000"], "total": 6}
    assert controller("GET", "/api/jobs/part.nc/check").status_code == 404
    assert controller("GET", "/api/jobs/part.nc/toolpath").status_code == 404
    assert controller("POST", "/api/jobs/part.nc/run").status_code == 200
    assert controller("DELETE", "/api/jobs/part.nc").json()["code"] == "machine-busy"
    assert controller("PUT", "/api/jobs/part.nc", {"text": ""}).json()["code"] == "machine-busy"
    assert library.history()[0]["outcome"] == "running"
    wait_until(lambda: library.history()[0]["outcome"] != "running")
    end()
    run = controller("GET", "/api/history").json()[0]
    assert (run["job"], run["outcome"], run["findings"]) == ("part.nc", "done", [])
    assert "end: done" in controller("GET", "/api/jobs/part.nc/log").json()["text"]
    assert controller("GET", "/api/jobs").json()[0]["outcome"] == "done"
    assert controller("DELETE", "/api/jobs/part.nc").status_code == 200
    assert controller("GET", "/api/jobs/part.nc").status_code == 404


def test_a_run_is_in_the_history_before_its_end_is_told(controller, console, library, monkeypatch):
    """A client that learns of the end asks for the history at once."""
    (library.folder / "short.nc").write_text("G21 G90\nG0 X1\nM2\n")
    seen, before, publish = [], len(library.history()), console.hub.publish

    def published(event):
        if event.event == "job-ended":
            seen.append(library.history()[0] if len(library.history()) > before else None)
        publish(event)

    monkeypatch.setattr(console.hub, "publish", published)
    assert controller("POST", "/api/jobs/short.nc/run").status_code == 200
    wait_until(lambda: seen)
    wait_until(lambda: not console.session._worker._busy)
    assert [(each["job"], each["outcome"]) for each in seen] == [("short.nc", "done")]
    assert len(library.history()) == before + 1
    library.remove("short.nc")


def test_a_check_finds_errors_at_their_lines(client, console, library):
    from cnc.server.checking import CheckOrder, check_job

    client("PUT", "/api/jobs/wrong.nc", {"text": "G21 G90\nG0 X5\nG1 X9999 F600\n"})
    client("PUT", "/api/jobs/good.nc", {"text": PROGRAM})
    order = CheckOrder("wrong.nc", library.folder, console.session.limited_machine, {})
    folder = Path.cwd()
    found = check_job(order)["errors"]
    assert Path.cwd() == folder, "the check leaves the process in another folder"
    assert [(each["code"], each["file"], each["line"]) for each in found] == [
        ("soft-limit", "wrong.nc", 3)
    ]
    check_job(CheckOrder("good.nc", library.folder, console.session.limited_machine, {5221: 7.0}))
    summary = client("GET", "/api/jobs/good.nc/check").json()
    assert summary["bounding_box"]["x"] == pytest.approx([0.0, 37.0])
    picture = client("GET", "/api/jobs/good.nc/toolpath").json()
    assert picture["about"]["program"] == "good.nc"
    assert {"t", "x", "y", "z", "feed", "origin-t"} <= set(picture["columns"])
    client("PUT", "/api/jobs/good.nc", {"text": PROGRAM + "\n"})
    assert client("GET", "/api/jobs/good.nc/check").status_code == 404


REPAIR = "/api/jobs/{}/repair?code={}&line={}&column={}"
SAFE = ("motion-assumed", 2, 1)
UNSAFE = ("character-unknown", 2, 6)


def sent(place, version, **more):
    return dict(zip(("code", "line", "column"), place, strict=True)) | {"version": version} | more


@pytest.fixture
def faulty(controller, console, library):
    """A program with a finding whose repair is safe; it is checked."""
    idle(console)
    text = "G21 G90\r\nX1. Y2.\r\nG1 X2. F600\r\nM2\r\n"
    controller("PUT", "/api/jobs/faulty.nc", {"text": text})
    file = library.folder / "faulty.nc"
    file.chmod(0o640)
    console.check("faulty.nc").result()
    return file


def test_a_repair_is_shown_and_then_written(controller, faulty):
    found = controller("GET", "/api/jobs/faulty.nc/check").json()["errors"]
    place = next((each["code"], each["line"], each["column"]) for each in found if "fix" in each)
    assert place == SAFE
    before = faulty.read_bytes()
    shown = controller("GET", REPAIR.format("faulty.nc", *SAFE)).json()
    assert faulty.read_bytes() == before
    assert shown["safe"]
    assert shown["lines"] == [{"line": 2, "old": "X1. Y2.", "new": "G0 X1. Y2."}]
    assert (shown["count"], shown["title"]) == (1, "write G0")
    body = sent(SAFE, shown["version"])
    written = controller("POST", "/api/jobs/faulty.nc/repair", body)
    assert (written.status_code, written.json()) == (200, shown)
    assert faulty.read_bytes() == before.replace(b"X1.", b"G0 X1.")
    assert faulty.stat().st_mode & 0o777 == 0o640
    assert controller("GET", "/api/jobs/faulty.nc/check").status_code == 404
    # The finding is gone, and so is the text that was shown.
    assert controller("GET", REPAIR.format("faulty.nc", *SAFE)).json()["code"] == "no-repair"
    again = controller("POST", "/api/jobs/faulty.nc/repair", body)
    assert (again.status_code, again.json()["code"]) == (409, "job-changed")


def test_an_unsafe_repair_is_written_only_on_request(controller, library):
    controller("PUT", "/api/jobs/unsafe.nc", {"text": "G21\nG0 X1,5\nM2\n"})
    shown = controller("GET", REPAIR.format("unsafe.nc", *UNSAFE)).json()
    assert not shown["safe"]
    refused = controller("POST", "/api/jobs/unsafe.nc/repair", sent(UNSAFE, shown["version"]))
    assert (refused.status_code, refused.json()["code"]) == (409, "repair-unsafe")
    assert (library.folder / "unsafe.nc").read_bytes() == b"G21\nG0 X1,5\nM2\n"
    body = sent(UNSAFE, shown["version"], unsafe=True)
    assert controller("POST", "/api/jobs/unsafe.nc/repair", body).status_code == 200
    assert (library.folder / "unsafe.nc").read_bytes() == b"G21\nG0 X1.5\nM2\n"


def test_the_first_lines_of_a_long_repair_are_shown(controller):
    lines = "".join(f"G0 X{number} Y0\n" for number in range(1, 251))
    controller("PUT", "/api/jobs/long.nc", {"text": f"%\nO1234\nG21 G90 G17\n{lines}M30\n%\n"})
    shown = controller("GET", REPAIR.format("long.nc", "decimal-point-missing", 4, 4)).json()
    assert (len(shown["lines"]), shown["count"]) == (MOST_CHANGED, 250)
    assert shown["lines"][-1] == {"line": 203, "old": "G0 X200 Y0", "new": "G0 X200. Y0"}


def test_a_repair_that_is_not_proved_is_left_out(faulty, monkeypatch):
    """In the process of the test, so that the proof can be made to fail."""
    from cnc.session import repairs

    monkeypatch.setattr(repairs, "_is_proved", lambda *_: False)
    text = faulty.read_bytes()
    machine = load_machine(None)
    result = repairs.repaired_at("faulty.nc", text, machine, RunOptions(), SAFE)
    assert (result.new, result.applied) == (text, [])


@pytest.mark.parametrize("same_text", [False, True])
def test_a_file_that_changes_during_its_proof_is_left(
    controller, console, faulty, monkeypatch, same_text
):
    shown = controller("GET", REPAIR.format("faulty.nc", *SAFE)).json()
    other, repair = faulty.read_bytes() if same_text else b"G21\nM2\n", console._repair

    async def slow(order):
        made = await repair(order)
        draft = faulty.with_name("other.part")
        draft.write_bytes(other)
        draft.replace(faulty)
        return made

    monkeypatch.setattr(console, "_repair", slow)
    answer = controller("POST", "/api/jobs/faulty.nc/repair", sent(SAFE, shown["version"]))
    assert (answer.status_code, answer.json()["code"]) == (409, "job-changed")
    assert faulty.read_bytes() == other
    assert not list((faulty.parent / ".cncrun").glob("tmp*"))


@pytest.mark.parametrize("when", ["before", "during"])
def test_a_program_that_runs_is_not_repaired(controller, console, faulty, monkeypatch, when):
    shown = controller("GET", REPAIR.format("faulty.nc", *SAFE)).json()
    before, repair = faulty.read_bytes(), console._repair
    run = _Run("faulty.nc", 0.0)

    async def slow(order):
        made = await repair(order)
        console._asked = run
        return made

    if when == "before":
        monkeypatch.setattr(console, "_run", run)
    monkeypatch.setattr(console, "_asked", None)
    monkeypatch.setattr(console, "_repair", slow)
    answer = controller("POST", "/api/jobs/faulty.nc/repair", sent(SAFE, shown["version"]))
    assert (answer.status_code, answer.json()["code"]) == (409, "machine-busy")
    assert faulty.read_bytes() == before


def test_a_run_that_is_refused_leaves_its_program_free(controller, console, faulty):
    controller("POST", "/api/mdi", {"line": "G4 P0.5"})
    assert controller("POST", "/api/jobs/faulty.nc/run").json()["code"] == "machine-busy"
    wait_until(lambda: console._asked is None)
    idle(console)
    shown = controller("GET", REPAIR.format("faulty.nc", *SAFE)).json()
    body = sent(SAFE, shown["version"])
    assert controller("POST", "/api/jobs/faulty.nc/repair", body).status_code == 200


def test_the_machine_and_its_cycles_are_described(client):
    machine = client("GET", "/api/machine").json()
    assert machine["axes"]["x"]["travel"] == [-10, 410]
    assert "grbl-sim" in machine["boards"]
    cycles = {each["name"]: each for each in client("GET", "/api/probing").json()}
    assert cycles["probe_z"]["parameters"][0]["name"] == "thickness"


def test_the_meanings_of_the_findings_are_kept_by_a_browser(client):
    answer = client("GET", "/api/meanings/de")
    assert answer.json()["no-control"] == {
        "meaning": "Ein anderes Gerät bedient die Maschine, oder keines.",
        "remedy": "Zuerst die Bedienung übernehmen.",
    }
    assert answer.headers["cache-control"] == "private, max-age=3600"
    for language in ("xx", "findings", "..%2Fde", "d" * 500):
        missing = client("GET", f"/api/meanings/{language}")
        assert missing.status_code == 404
        assert missing.headers["cache-control"] == "no-store"


def test_unknown_cycles_macros_and_parameters_are_refused(controller, console):
    idle(console)
    run = "/api/probing/{}/run".format
    assert controller("POST", run("none")).json()["code"] == "no-such-cycle"
    wrong = {"parameters": {"width": 1.0}}
    assert controller("POST", run("probe_z"), wrong).json()["code"] == "cycle-parameter"
    assert controller("POST", "/api/macros/none.ngc/run").json()["code"] == "no-such-macro"


def test_a_board_without_settings_has_none(controller, console):
    idle(console)
    assert controller("GET", "/api/settings").json()["code"] == "no-settings"


def test_the_document_describes_every_request(client):
    paths = client("GET", "/api/openapi.json").json()["paths"]
    assert "/api/jog/start" in paths
    assert paths["/api/jobs/{name}"]["put"]["requestBody"]["required"]
    reference = (Path(__file__).parents[2] / "docs/reference/server.md").read_text()
    for path in paths:
        short = path.removeprefix("/api")
        assert short in reference, path
    assert json.dumps(paths)


NAMES = [
    "O0001.NC",
    "part (1).nc",
    "Geh\u00e4use.nc",
    "\U0001f6e0\ufe0f.nc",
    "a..nc",
    "#1 % & ?.tap",
    "x.H",
]


@pytest.mark.parametrize("name", NAMES)
def test_any_plain_name_is_a_job(controller, console, name):
    """The requests, too, take each name, whatever its letters mean in an address."""
    place = f"/api/jobs/{quote(name, safe='')}"
    assert controller("PUT", place, {"text": "G21 G90\nG0 X1\nM2\n"}).status_code == 200
    assert name in [job["name"] for job in controller("GET", "/api/jobs").json()]
    assert (console.library.folder / name).is_file()
    assert controller("POST", f"{place}/check").status_code == 200
    wait_until(lambda: controller("GET", f"{place}/check").status_code == 200)
    assert controller("DELETE", place).status_code == 200
    assert name not in console.library.names()


def test_a_stop_without_a_board_waits_for_nothing(client, console, monkeypatch):
    """The process of the session may be starting still."""
    monkeypatch.setattr(console.session._worker.view, "board", "")
    monkeypatch.setattr(console.session, "ask", lambda *_, **__: Future())
    assert client("POST", "/api/stop").json() == {"accepted": True}


def test_a_run_that_ends_at_once_is_not_under_way(controller, console, library, monkeypatch):
    """Its end may come before the answer to the request."""
    ask = console.session.ask

    def late(*words, **names):
        asked = ask(*words, **names)
        wait_until(asked.result().done)
        wait_until(lambda: [run for run in library.history() if run["job"] == "wrong.nc"])
        return asked

    idle(console)
    text = "G21 G90\nG1 X1\nM2\n"
    assert controller("PUT", "/api/jobs/wrong.nc", {"text": text}).status_code == 200
    monkeypatch.setattr(console.session, "ask", late)
    options = {"trust_position": True}
    assert controller("POST", "/api/jobs/wrong.nc/run", options).status_code == 200
    monkeypatch.undo()
    run = library.history()[0]
    assert (run["job"], run["outcome"]) == ("wrong.nc", "failed")
    assert controller("DELETE", "/api/jobs/wrong.nc").status_code == 200
