"""The commands jog, zero and mdi."""

from __future__ import annotations

import functools
import math
import re

import pytest

from cnc.simulators.grbl import board as grbl_board
from cnc.simulators.grbl.ports import ScaledTime
from cnc.simulators.grbl.workpiece import Environment, HalfSpace, Workpiece

SIMULATED = ("--board", "grbl-sim", "--machine", "grbl-uno")


@pytest.fixture(autouse=True)
def quick_board(monkeypatch):
    """Let the GRBL simulator run sixteen times as fast as a board."""
    monkeypatch.setattr(grbl_board, "ScaledTime", functools.partial(ScaledTime, factor=16.0))


@pytest.mark.parametrize("options", [(), SIMULATED])
def test_jog_ends_at_its_distance(cncrun, options):
    code, out, err = cncrun("jog", "X2.5", "y1", *options)
    assert (code, err) == (0, "")
    assert "X2.500 Y1.000 Z0.000" in out


@pytest.mark.parametrize(
    ("words", "code", "exit_code"),
    [
        (("X1000",), "soft-limit", 2),
        ((), "usage", 2),
        (("X",), "usage", 2),
        (("X1", "X2"), "usage", 2),
        (("10",), "usage", 2),
        (("B1",), "jog-axis", 2),
        (("X0",), "jog-nowhere", 2),
        (("X1", "--feed", "0"), "jog-feed", 2),
    ],
)
def test_a_wrong_jog_is_refused(cncrun, words, code, exit_code):
    found, _, err = cncrun("jog", *words)
    assert found == exit_code
    assert err.startswith(f"{code}: ")


def test_zero_sets_the_present_position(cncrun):
    code, out, _ = cncrun("zero", "X", "Y5", *SIMULATED)
    assert (code, out) == (0, "G54 X0.000 Y-5.000 Z0.000\n")


def test_zero_keeps_the_offset_in_the_parameter_file(cncrun, tmp_path):
    machine = tmp_path / "machine.toml"
    machine.write_text(
        "[axes.x]\nsteps_per_mm = 100\nmax_velocity = 50\nmax_acceleration = 500\n"
        'max_jerk = 9000\ntravel = [0, 100]\n[program]\nparameters = "machine.var"\n'
    )
    code, out, _ = cncrun("zero", "X-7", "--system", "g55", "--machine", str(machine))
    assert (code, out) == (0, "G55 X7.000\n")
    assert "5241\t7.0" in (tmp_path / "machine.var").read_text()


def test_a_height_map_is_probed_and_used(cncrun, tmp_path, monkeypatch):
    """The surface rises by 0.1 mm a mm along X."""
    normal = (-0.1 / math.hypot(0.1, 1.0), 0.0, 1.0 / math.hypot(0.1, 1.0))
    workpiece = Workpiece((HalfSpace(normal, -0.5 * normal[2]),))
    monkeypatch.setattr(Environment, "contact", lambda _, *wanted: workpiece.contact(*wanted))
    found, program = str(tmp_path / "map.json"), tmp_path / "p.nc"
    code, out, err = cncrun(
        "height-map", "X0:4", "Y0:2", "-o", found, "--step", "2", "--clear", "1", "--feed",
        "1500", *SIMULATED,
    )  # fmt: skip
    assert (code, err) == (0, "")
    assert out.endswith("map.json: 3 x 2 points, -0.500 to -0.100 mm\n")
    program.write_text("G21 G90\nG0 X1 Y1 Z1\nG1 X3 F900\nM2\n")
    code, out, _ = cncrun("check", str(program), "--height-map", found)
    assert code == 0
    facts = r"3 x 2 points, -0\.5 to -0\.1 mm, bilinear; \d+ pieces within 0\.005"
    assert re.search(facts, " ".join(out.split()))
    program.write_text("G21 G90\nG0 X1 Y1 Z1\nG1 X30 F900\nM2\n")
    code, _, err = cncrun("check", str(program), "--height-map", found)
    assert (code, err.split(": ")[1]) == (1, "height-map-outside")
    assert ":3:" in err.splitlines()[0]


@pytest.mark.parametrize("content", [None, "{", "[1]", '{"x": [0, 1]}'])
def test_a_file_that_is_no_height_map_is_refused(cncrun, tmp_path, content):
    program, found = tmp_path / "p.nc", tmp_path / "map.json"
    program.write_text("G0 X1\n")
    if content is not None:
        found.write_text(content)
    code, _, err = cncrun("check", str(program), "--height-map", str(found))
    assert (code, err.split(": ")[0]) == (2, "height-map-file")


@pytest.mark.parametrize("area", [("X0:4",), ("X0:4", "X0:4"), ("X0:4", "Y1"), ("X4:0", "Y0:2")])
def test_a_wrong_area_is_refused(cncrun, tmp_path, area):
    code, _, err = cncrun("height-map", *area, "-o", str(tmp_path / "map.json"))
    assert code == 2
    assert err.startswith(("usage: ", "height-map-grid: "))


def test_mdi_keeps_the_modes_of_the_lines_before(cncrun):
    code, out, _ = cncrun("mdi", "G91 G0 X2", "X3", *SIMULATED)
    assert code == 0
    assert "X5.000" in out


def test_mdi_ends_with_the_first_wrong_line(cncrun):
    code, _, err = cncrun("mdi", "G0 X1", "G1 Y3", "G0 X9")
    assert code == 1
    assert err.startswith("MDI:1:1: feed-missing: ")
