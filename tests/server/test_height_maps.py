"""Height maps of the library: probed, listed, used by checks and runs, removed."""

from __future__ import annotations

import pytest

from cnc.machine.height_map import HeightMap, save_height_map
from tests.support.waiting import wait_until

PROGRAM = "G21 G90\nG0 X5 Y5 Z0\nG1 X20 F3000\nM2\n"


def checked(controller, name, height_map):
    """Check a job and return the summary."""
    started = controller("POST", f"/api/jobs/{name}/check", {"height_map": height_map})
    assert started.status_code == 200

    def found():
        answer = controller("GET", f"/api/jobs/{name}/check")
        return answer.status_code == 200 and ("height_map" in answer.json()) == bool(height_map)

    wait_until(found)
    return controller("GET", f"/api/jobs/{name}/check").json()


def test_a_grid_is_probed_into_the_library(controller, console):
    """The loopback board reports each contact at the end of its move: at Z -1.5."""
    grid = {"x": [0, 4], "y": [0, 2], "step": 2, "clear": 1, "depth": 1.5, "feed": 6000}
    assert controller("POST", "/api/height-maps/plate/probe", grid).status_code == 200
    wait_until(lambda: not console.session._worker._busy)
    wait_until(lambda: "plate" in controller("GET", "/api/height-maps").json())
    found = controller("GET", "/api/height-maps/plate").json()
    assert (found["x"], found["y"]) == ([0.0, 2.0, 4.0], [0.0, 2.0])
    assert found["heights"] == [[pytest.approx(-1.5)] * 3] * 2
    again = {"points": [[2, 1]], "clear": 1, "depth": 1.25, "feed": 6000}
    path = "/api/height-maps/plate/again"
    assert controller("POST", path, again).status_code == 200
    wait_until(lambda: not console.session._worker._busy)
    wait_until(
        lambda: (
            controller("GET", "/api/height-maps/plate").json()["heights"]
            == [[pytest.approx(-1.5)] * 3, [pytest.approx(-1.5)] * 2 + [pytest.approx(-1.25)]]
        )
    )
    for wrong in ({"points": []}, {"points": [[1]]}, {"points": [[9, 0]]}):
        assert controller("POST", path, again | wrong).status_code == 400
    assert controller("POST", "/api/height-maps/none/again", again).status_code == 404
    assert controller("DELETE", "/api/height-maps/plate").status_code == 200
    assert "plate" not in controller("GET", "/api/height-maps").json()


def test_a_check_and_a_run_use_a_height_map(controller, console, library):
    slope = HeightMap(x=(0.0, 40.0), y=(0.0, 40.0), heights=((0.0, 0.8), (0.0, 0.8)))
    save_height_map(slope, library.new_height_map("slope"))
    assert controller("PUT", "/api/jobs/sloped.nc", {"text": PROGRAM}).status_code == 200
    found = checked(controller, "sloped.nc", "slope")
    assert found["height_map"]["highest_mm"] == 0.8
    assert found["bounding_box"]["z"][1] == pytest.approx(0.4, abs=0.005)
    assert found["ok"]
    answer = controller("POST", "/api/jobs/sloped.nc/run", {"height_map": "slope"})
    assert answer.status_code == 200
    wait_until(lambda: not console.session._worker._busy)
    assert console.session.state.machine["z"] == pytest.approx(0.4, abs=0.01)


@pytest.mark.parametrize("name", ["none", "..%2Fplate", "a.b", "con"])
def test_an_unknown_height_map_is_refused(controller, name):
    controller("PUT", "/api/jobs/flat.nc", {"text": PROGRAM})
    name = name.replace("%2F", "/")
    for path in ("/api/jobs/flat.nc/check", "/api/jobs/flat.nc/run"):
        answer = controller("POST", path, {"height_map": name})
        assert (answer.status_code, answer.json()["code"]) == (404, "height-map-name")
    assert controller("GET", "/api/height-maps/a.b").status_code == 404


@pytest.mark.parametrize(
    "grid", [{"x": [4, 0], "y": [0, 2]}, {"x": [0, 4], "y": [0, 2], "step": 0}]
)
def test_a_wrong_grid_is_refused(controller, grid):
    assert controller("POST", "/api/height-maps/plate/probe", grid).status_code == 400
