"""Measurements through the API, on a machine whose motors move a tool with errors."""

import math

import numpy as np
import pytest

from cnc.boards.loopback import SwitchedLoopback, switch_places
from cnc.machine.load import load_machine
from cnc.operate.operator_session import OperatorSession
from cnc.server.console import Console
from cnc.server.library import Library
from tests.server.conftest import Client
from tests.support.boards.probe_bench import Part, ProbeBench, Slab
from tests.support.faulty_machine import FaultyMachine
from tests.support.waiting import wait_until

STEP = 1.0 / 400.0
PLAY, STATED = 0.05, 0.2
"""Play of the nuts, and that of the machine file before, mm."""
AXIS = """\
[axes.{letter}]
steps_per_mm = 400.0
max_velocity = 400.0
max_acceleration = 8000.0
max_jerk = 400000.0
travel = [-60, 60]
backlash = 0.2

"""


class Shop:
    """A machine file, a console, and the board behind it."""

    def __init__(self, folder, part):
        self.file, self.part = folder / "mill.toml", part
        tables = "".join(AXIS.format(letter=letter) for letter in "xyz")
        self.file.write_text(f'[machine]\nname = "Mill"\n\n{tables}[board]\nkind = "loopback"\n')
        self.before = self.file.read_text()
        library = Library(folder / "jobs")
        self.console = Console(OperatorSession(load_machine(self.file)), library)
        self.session = self.console.session

    @property
    def tool(self):
        return self.session._worker.machine.board.tool

    def idle(self):
        wait_until(lambda: not self.session._worker._busy)


@pytest.fixture
def shop(tmp_path, monkeypatch):
    part = Part([], noise=0.002, seed=11)

    class Bench(ProbeBench):
        @classmethod
        def for_operator(cls, machine, _):
            faulty = FaultyMachine(xy=0.2, backlash={"x": PLAY, "y": 0.03})
            return cls(machine, (0.0, 0.0, 0.0), faulty, part)

    monkeypatch.setattr("cnc.boards.registry.board_factory", lambda _: Bench)
    shop = Shop(tmp_path, part)
    yield shop
    shop.console.close()


@pytest.fixture
def client(shop, client_of_console):
    client = client_of_console(shop.console)
    client.take_control()
    assert client("POST", "/api/connect", {}).status_code == 200
    return client


def answered(shop, client, read):
    """Answer each question by a request until the measurement ends; return it."""
    number = 0

    def asked():
        return shop.session.dialog is not None and shop.session.dialog.id != number

    def running():
        return client("GET", "/api/measurement").json()["running"]

    while running():
        wait_until(lambda: asked() or not running())
        if not asked():
            continue
        dialog = shop.session.dialog
        number = dialog.id
        body = {"dialog": number, "yes": True, "value": read(dialog.text)}
        assert client("POST", "/api/answer", body).status_code == 200
    return client("GET", "/api/measurement").json()


def test_backlash_is_found_to_a_step_with_a_gauge_and_written_when_it_is_confirmed(shop, client):
    assert client("POST", "/api/measure/backlash", {"axis": "x"}).status_code == 200
    measured = answered(shop, client, lambda _: float(shop.tool[0]))
    result = measured["result"]
    assert result["title"].startswith("backlash of X: 0.0")
    assert [bar["before"] for bar in result["bars"]] == pytest.approx([PLAY] * 3, abs=STEP)
    assert max(abs(bar["after"]) for bar in result["bars"]) <= STEP
    assert max(abs(bar["before_part"]) for bar in result["bars"]) == 1.0
    assert (result["file"], result["refusal"]) == (str(shop.file), "")
    assert result["steps"][0].startswith("axes.x.backlash = 0.0")
    # Nothing is written yet, and the machine is the compensated one again.
    assert shop.file.read_text() == shop.before
    assert shop.session._programs.machine.axes["x"].backlash == STATED
    wrong = client("POST", "/api/measurement/write", {"number": measured["number"] + 1})
    assert (wrong.status_code, wrong.json()["code"]) == (409, "measurement-gone")
    assert shop.file.read_text() == shop.before
    watching = Client(client.app)
    refused = watching("POST", "/api/measurement/write", {"number": measured["number"]})
    assert (refused.status_code, refused.json()["code"]) == (409, "no-control")
    assert shop.file.read_text() == shop.before
    written = client("POST", "/api/measurement/write", {"number": measured["number"]}).json()
    assert written["result"]["written"]
    assert load_machine(shop.file).axes["x"].backlash == pytest.approx(PLAY, abs=STEP)
    assert load_machine(shop.file).axes["y"].backlash == STATED


def test_backlash_is_found_to_a_step_with_the_probe(shop, client):
    """A face of 45 degrees stands in front of the probe along Y."""
    away = 6.0 * math.cos(math.radians(45.0))
    shop.part.slabs.append(Slab((-90.0, away, -90.0), (90.0, away + 30.0, 90.0), 45.0))
    body = {"axis": "x", "probe": {"touch": "Y+", "contact_feed": 400}}
    assert client("POST", "/api/measure/backlash", body).status_code == 200
    measured = answered(shop, client, None)
    value = float(measured["result"]["steps"][0].split(" = ")[1])
    assert value == pytest.approx(PLAY, abs=STEP)
    assert "at a slanted face" in measured["result"]["remark"]


def test_errors_of_a_screw_are_written_with_their_table(shop, client):
    body = {"axis": "x", "first": -50, "last": 50, "places": 11, "both": True}
    assert client("POST", "/api/measure/pitch", body).status_code == 200
    measured = answered(shop, client, lambda _: float(1.0002 * shop.tool[0]))
    table = shop.file.with_name("mill-x-errors.csv")
    assert measured["result"]["steps"] == [
        "axes.x.error_table = mill-x-errors.csv",
        "no axes.x.backlash",
        f"{table} with 13 rows",
    ]
    assert not table.exists()
    body = {"number": measured["number"]}
    assert client("POST", "/api/measurement/write", body).status_code == 200
    rows = load_machine(shop.file).axes["x"].error_table
    assert [row.forward for row in rows[1:-1]] == pytest.approx(
        [0.002 * k for k in range(11)], abs=STEP
    )


def test_the_angle_of_two_axes_is_found(shop, client):
    """A true square lies along X. A plunger towards plus goes in as the tool goes to plus."""
    across = [1]

    def read(text):
        if "touch the leg along" in text:
            across[0] = 0 if "touch the leg along Y" in text else 1
        return float(5.0 + shop.tool[across[0]])

    body = {"axes": "xy", "lengths": [50, 50]}
    assert client("POST", "/api/measure/square", body).status_code == 200
    measured = answered(shop, client, read)
    (step,) = measured["result"]["steps"]
    angle = float(step.removeprefix("machine.squareness.xy = ").removesuffix(" deg"))
    assert angle == pytest.approx(0.2, abs=0.005)


def test_a_question_is_there_for_a_second_client_and_a_stop_ends_it(shop, client):
    assert client("POST", "/api/measure/backlash", {"axis": "x"}).status_code == 200
    wait_until(lambda: shop.session.dialog is not None)
    second = Client(client.app)
    assert second("GET", "/api/measurement").json()["running"]
    assert second("GET", "/api/state").json()["activity"] == "measure"
    dialog = shop.session.dialog
    body = {"dialog": dialog.id, "yes": True, "value": 1.0}
    assert second("POST", "/api/answer", body).json()["code"] == "no-control"
    missing = client("POST", "/api/answer", {"dialog": dialog.id, "yes": True})
    assert (missing.status_code, missing.json()["code"]) == (400, "reading-missing")
    for path, body in (
        ("/api/jog/step", {"distances": {"x": 1}}),
        ("/api/measure/pitch", {"axis": "x", "first": -50, "last": 50}),
        ("/api/disconnect", {}),
    ):
        busy = client("POST", path, body)
        assert (busy.status_code, busy.json()["code"]) == (409, "machine-busy")
    # The one who watches may stop the machine, and take control to go on.
    assert second("POST", "/api/stop").status_code == 200
    shop.idle()
    wait_until(lambda: not client("GET", "/api/measurement").json()["running"])
    assert client("GET", "/api/measurement").json()["result"] is None
    assert shop.session.dialog is None
    assert shop.session._programs.machine.axes["x"].backlash == STATED
    number = client("GET", "/api/measurement").json()["number"]
    assert client("POST", "/api/measurement/write", {"number": number}).status_code == 409
    assert shop.file.read_text() == shop.before


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        ("backlash", {"axis": "x", "reverse": 0}),
        ("backlash", {"axis": "x", "probe": {"touch": "YY"}}),
        ("backlash", {"axis": "q"}),
        ("pitch", {"axis": "x"}),
        ("square", {"axes": "xx", "lengths": [50, 50]}),
        ("square", {"axes": "xy", "lengths": [50]}),
        ("limits", {"axis": "q"}),
        ("limits", {"axis": "x", "most": 0.2}),
        ("ringing", {"text": "no record"}),
        ("ringing", {"axis": "q"}),
    ],
)
def test_a_wrong_order_is_refused_and_begins_nothing(shop, client, kind, body):
    assert client("POST", f"/api/measure/{kind}", body).status_code == 400
    shop.idle()
    assert not client("GET", "/api/measurement").json()["running"]
    assert client("GET", "/api/measurement").json()["result"] is None


def test_a_board_without_an_accelerometer_records_nothing(shop, client):
    refused = client("POST", "/api/measure/ringing", {"axis": "x"})
    assert (refused.status_code, refused.json()["code"]) == (400, "no-accelerometer")
    assert shop.session._worker.machine.board.rows == 0


def test_limits_on_a_simulated_board_are_shown_and_not_written(
    tmp_path, monkeypatch, client_of_console
):
    class Switched(SwitchedLoopback):
        @classmethod
        def for_operator(cls, machine, _):
            return cls(machine, switch_places(machine))

    monkeypatch.setattr("cnc.boards.registry.board_factory", lambda _: Switched)
    monkeypatch.setattr("cnc.server.measuring.board_factory", lambda _: Switched)
    shop = Shop(tmp_path, None)
    client = client_of_console(shop.console)
    client.take_control()
    client("POST", "/api/connect", {})
    try:
        body = {"axis": "y", "most": 0.6}
        assert client("POST", "/api/measure/limits", body).status_code == 200
        shop.idle()
        wait_until(lambda: not client("GET", "/api/measurement").json()["running"])
        measured = client("GET", "/api/measurement").json()
        first = measured["result"]["trials"][0]
        assert (first["name"], first["value"], first["lost"]) == ("velocity", 200.0, False)
        assert measured["result"]["refusal"].startswith("the board is simulated")
        body = {"number": measured["number"]}
        assert client("POST", "/api/measurement/write", body).status_code == 409
        assert shop.file.read_text() == shop.before
    finally:
        shop.console.close()


def test_modes_of_a_record_are_shown_until_they_are_forgotten(shop, client):
    t = np.arange(0.0, 4.0, 0.001)
    after = t % 1.0
    waves = [
        weight
        * np.exp(-d * 2 * np.pi * f * after)
        * np.sin(2 * np.pi * f * (1 - d * d) ** 0.5 * after)
        for f, d, weight in ((38.0, 0.05, 1.0), (61.0, 0.04, 0.7))
    ]
    pairs = zip(t, waves[0] + waves[1], strict=True)
    text = "time,ax\n" + "".join(f"{time:.4f},{value:.6f}\n" for time, value in pairs)
    body = {"text": text, "name": "taps.csv"}
    assert client("POST", "/api/measure/ringing", body).status_code == 200
    result = client("GET", "/api/measurement").json()["result"]
    frequencies = [mode["frequency"] for mode in result["modes"]]
    assert frequencies == pytest.approx([38.0, 61.0], rel=0.01)
    assert {mode["axis"] for mode in result["modes"]} == {"x"}
    assert client("DELETE", "/api/measurement").status_code == 200
    assert client("GET", "/api/measurement").json()["result"] is None
