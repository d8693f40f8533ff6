"""The summary on the terminal, and the JSON of a report."""

import io
import json

import pytest

from cnc.machine.load import load_machine
from cnc.model.diagnostics import BoardError, Diagnostic, GcodeError, UsageError
from cnc.report.result import Extremes, Report, Timing, clock, number, position
from cnc.report.summary import one_line, print_summary

MACHINE = load_machine("default")
FAULT = GcodeError(Diagnostic("no-feed", "no feed", "p.nc", 4, 2))


def report(**more) -> Report:
    return Report("[p].nc", MACHINE, limits=Extremes.limits(MACHINE), **more)


def text(one: Report, **options) -> str:
    stream = io.StringIO()
    print_summary(one, stream, **options)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("seconds", "shown"),
    [
        (0, "0.000 s"),
        (59.9994, "59.999 s"),
        (59.9999, "0:01:00"),
        (60, "0:01:00"),
        (3599.6, "1:00:00"),
        (3661, "1:01:01"),
        (360000, "100:00:00"),
    ],
)
def test_times(seconds, shown):
    assert clock(seconds) == shown


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (None, "-"),
        (0.0, "0"),
        (2400.0, "2400"),
        (48000.0, "48 000"),
        (0.000613, "0.000613"),
        (0.02, "0.02"),
        (123456789.0, "123 456 789"),
    ],
)
def test_numbers(value, shown):
    assert number(value) == shown


def test_a_tiny_negative_coordinate_is_zero():
    assert position(-1e-9) == "0"
    assert position(-0.00049) == "-0.0005"


def test_the_summary_has_time_extent_steps_and_limits():
    axes = {axis: {"velocity": 10.0, "acceleration": 750.0, "jerk": 1.0} for axis in "xyz"}
    one = report(
        board="loopback",
        lines=12,
        blocks=20001,
        duration_s=3725.0,
        path_length_mm=1234.5,
        bounding_box={"x": (0.0, 16.4518), "y": (-1.0, 2.0), "z": (0.0, 0.0)},
        end_position={"x": 10.0, "y": 0.0, "z": 0.0},
        largest=Extremes(90.0, 1200.0, 39000.0, 1100.0, 0.001, 0.0005, axes),
        steps={"x": 35836, "y": 39104, "z": 0},
        pulse_error_blu=0.49996,
        timing=Timing(0.1, 0.2, 0.3, 0.7),
    )
    shown = text(one)
    for piece in (
        "[p].nc",
        "benchtop mill",
        "12 lines, 20 001 blocks",
        "1:02:05",
        "1234.5 mm",
        "16.4518",
        "-10 .. 410",
        "35 836",
    ):
        assert piece in shown
    rows = [line.split() for line in shown.splitlines()]
    assert ["feed", "90", "100", "mm/s", "90", "%"] in rows
    assert ["acceleration", "of", "Z", "750", "1000", "mm/s²", "75", "%"] in rows
    assert "computed in" not in shown
    assert "computed in 0.700 s: reading 0.100, planning 0.200, interpolating 0.300" in text(
        one, verbose=True
    )


def test_a_report_in_one_line():
    assert one_line(report(duration_s=61, path_length_mm=5)) == "[p].nc: ok, 0:01:01, 5 mm"
    assert one_line(report(faults=[FAULT], hidden_faults=3)) == "[p].nc: 4 errors"
    assert one_line(report(faults=[FAULT])) == "[p].nc: 1 error"


def test_json_has_every_key_and_valid_numbers():
    found = json.loads(json.dumps(report().as_json(), allow_nan=False))
    keys = (
        "program lines blocks errors duration_s path_length_mm bounding_box max limits violations "
        "steps pulse_error_blu timing lines_per_s steps_per_s"
    )
    assert set(keys.split()) <= set(found)
    for part in ("max", "limits"):
        assert {"feed", "accel", "jerk", "chord_error", "step_deviation", "axes"} <= set(
            found[part]
        )
    assert found["limits"]["axes"]["x"] == {
        "velocity": 100.0,
        "acceleration": 1500.0,
        "jerk": 40000.0,
    }
    assert set(found["timing"]) == {"parse_s", "plan_s", "interpolate_s", "total_s"}
    assert found["violations"]["feed"] == found["violations"]["jerk_z"] == 0


def test_json_lists_errors_and_warnings():
    warning = Diagnostic("odd", "odd", "p.nc", 1, severity="warning")
    found = report(faults=[FAULT], warnings=[warning]).as_json()
    assert not found["ok"]
    assert [
        (each["code"], each["line"], each["column"], each["severity"]) for each in found["errors"]
    ] == [
        ("no-feed", 4, 2, "error"),
        ("odd", 1, 0, "warning"),
    ]


@pytest.mark.parametrize(
    ("faults", "code"),
    [
        ([], 0),
        ([FAULT], 1),
        ([FAULT, UsageError(Diagnostic("u", "u"))], 2),
        ([BoardError(Diagnostic("b", "b"))], 3),
    ],
)
def test_exit_codes(faults, code):
    one = report(faults=faults)
    assert one.exit_code == code
    if faults:
        with pytest.raises(type(faults[0])):
            one.raise_if_faulty()
    else:
        one.raise_if_faulty()
