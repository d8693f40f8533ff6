"""The commands jog, zero and mdi."""

from __future__ import annotations

import pytest

SIMULATED = ("--board", "grbl-sim", "--machine", "grbl-uno")


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


def test_mdi_keeps_the_modes_of_the_lines_before(cncrun):
    code, out, _ = cncrun("mdi", "G91 G0 X2", "X3", *SIMULATED)
    assert code == 0
    assert "X5.000" in out


def test_mdi_ends_with_the_first_wrong_line(cncrun):
    code, _, err = cncrun("mdi", "G0 X1", "G1 Y3", "G0 X9")
    assert code == 1
    assert err.startswith("MDI:1:1: feed-missing: ")
