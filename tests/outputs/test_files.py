"""The public files: names, units and meanings, whole files or none."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from cnc.machine.load import load_machine
from cnc.model.blocks import (
    AnalogOutput,
    ArcFeed,
    BoardCommand,
    Coolant,
    DigitalOutput,
    Dwell,
    End,
    Message,
    NurbsFeed,
    Orient,
    Overrides,
    PathMode,
    Polyline,
    Probe,
    Spindle,
    SpindleSync,
    Stop,
    Tool,
    WaitInput,
)
from cnc.model.diagnostics import UsageError
from cnc.model.streams import PulseChunk, SampleChunk
from cnc.outputs.blocks import BlockWriter, block_objects
from cnc.outputs.pulses import pulse_writer
from cnc.outputs.targets import NpzTarget, TextTarget, check_suffixes
from cnc.outputs.trace import trace_writer

MACHINE = load_machine("paper-nurbs")
AXES = MACHINE.axis_names
AT = ("p.nc", 7)


def objects(block) -> list[dict]:
    return list(block_objects(block, AXES))


def samples(first: int, count: int) -> SampleChunk:
    k = np.arange(first, first + count, dtype=np.float64)
    return SampleChunk(
        first,
        0.001,
        np.stack([k / 3, k / 7, k * 0], axis=1),
        k / 11,
        k / 13,
        k / 17,
        k / 19,
        k * 0,
        np.full(count, 4, np.int32),
    )


def pulses(times, steps, line=3) -> PulseChunk:
    return PulseChunk(
        np.array(times, np.int64),
        np.array(steps, np.int8).reshape(-1, 3),
        np.full(len(times), line, np.int32),
    )


def test_a_run_of_moves_is_one_object_a_move_with_feeds_a_minute():
    block = Polyline(
        *AT,
        np.array([[1.0, 2, 3], [4, 5, 6]]),
        np.array([np.nan, 20.0]),
        np.array([7, 9], np.int32),
    )
    assert objects(block) == [
        {"line": 7, "kind": "traverse", "end": {"x": 1.0, "y": 2.0, "z": 3.0}, "feed": None},
        {"line": 9, "kind": "line", "end": {"x": 4.0, "y": 5.0, "z": 6.0}, "feed": 1200.0},
    ]


def test_an_arc_names_the_axes_of_its_centre():
    block = ArcFeed(*AT, "ZX", (1.0, 2.0), np.array([3.0, 4, 5]), 6.0, -0.25, 10.0)
    assert objects(block) == [
        {
            "line": 7,
            "kind": "arc",
            "plane": "ZX",
            "center": {"z": 1.0, "x": 2.0},
            "end": {"x": 3.0, "y": 4.0, "z": 5.0},
            "radius": 6.0,
            "turns": -0.25,
            "feed": 600.0,
        }
    ]


def test_a_nurbs_has_everything_to_draw_it_again():
    block = NurbsFeed(
        *AT,
        1,
        np.array([0.0, 0, 1, 1]),
        np.array([[0.0, 0, 0], [1, 2, 3]]),
        np.array([1.0, 2.0]),
        5.0,
    )
    assert objects(block) == [
        {
            "line": 7,
            "kind": "nurbs",
            "degree": 1,
            "knots": [0.0, 0.0, 1.0, 1.0],
            "control_points": [[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]],
            "weights": [1.0, 2.0],
            "axes": ["x", "y", "z"],
            "feed": 300.0,
        }
    ]


@pytest.mark.parametrize(
    ("block", "fields"),
    [
        (
            PathMode(*AT, "blend", 0.02),
            {"kind": "path-mode", "control": "blend", "tolerance": 0.02},
        ),
        (Dwell(*AT, 1.5), {"kind": "dwell", "seconds": 1.5}),
        (Spindle(*AT, "ccw", 900.0), {"kind": "spindle", "state": "ccw", "rpm": 900.0}),
        (Coolant(*AT, True, False), {"kind": "coolant", "mist": True, "flood": False}),
        (Tool(*AT, 12), {"kind": "tool", "number": 12}),
        (Stop(*AT), {"kind": "stop"}),
        (Stop(*AT, optional=True), {"kind": "optional-stop"}),
        (Stop(*AT, pallet=True), {"kind": "pallet-stop"}),
        (Tool(*AT, 12, change=False), {"kind": "tool-in-spindle", "number": 12}),
        (
            Spindle(*AT, "cw", 2000.0, 1500.0),
            {"kind": "spindle", "state": "cw", "rpm": 2000.0, "surface_speed": 90_000.0},
        ),
        (
            Orient(*AT, 90.0, "ccw", 2.0),
            {"kind": "orient", "angle": 90.0, "direction": "ccw", "timeout": 2.0},
        ),
        (SpindleSync(*AT, 1.5), {"kind": "spindle-sync", "pitch": 1.5}),
        (
            Overrides(*AT, feed=True, spindle=False, adaptive_feed=False, feed_stop=True),
            {
                "kind": "overrides",
                "feed": True,
                "spindle": False,
                "adaptive_feed": False,
                "feed_stop": True,
            },
        ),
        (
            DigitalOutput(*AT, 3, True, False),
            {"kind": "digital-output", "number": 3, "on": True, "with_motion": False},
        ),
        (
            AnalogOutput(*AT, 3, 0.5, True),
            {"kind": "analog-output", "number": 3, "value": 0.5, "with_motion": True},
        ),
        (
            WaitInput(*AT, 2, False, "high", 5.0),
            {"kind": "wait-input", "number": 2, "input": "digital", "mode": "high", "timeout": 5.0},
        ),
        (
            Probe(*AT, np.array([1.0, 2.0, 3.0]), 5.0, towards=True, must=False),
            {
                "kind": "probe",
                "end": {"x": 1.0, "y": 2.0, "z": 3.0},
                "feed": 300.0,
                "towards": True,
                "must": False,
            },
        ),
        (BoardCommand(*AT, "$H"), {"kind": "board-command", "text": "$H"}),
        (End(*AT), {"kind": "end"}),
        (Message(*AT, 'mind the "clamp"'), {"kind": "message", "text": 'mind the "clamp"'}),
    ],
    ids=lambda value: value["kind"] if isinstance(value, dict) else "",
)
def test_other_blocks(block, fields):
    assert objects(block) == [{"line": 7, **fields}]


def test_blocks_are_one_object_a_line(tmp_path):
    file = tmp_path / "b.jsonl"
    writer = BlockWriter(str(file), AXES, "p.nc")
    writer.write(Tool(*AT, 1))
    writer.write(End("p.nc", 8))
    writer.write(Dwell("subs/other.ngc", 2, 1.0))
    assert not file.exists()
    writer.close()
    found = [json.loads(line) for line in file.read_text().splitlines()]
    assert [(each["line"], each.get("file")) for each in found] == [
        (7, None),
        (8, None),
        (2, "subs/other.ngc"),
    ]


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_a_trace_keeps_every_bit(tmp_path, suffix):
    file = tmp_path / f"t{suffix}"
    writer = trace_writer(str(file), MACHINE)
    writer.write(samples(0, 5))
    writer.write(samples(5, 3))
    writer.close()
    k = np.arange(8.0)
    if suffix == ".npz":
        with np.load(file) as found:
            assert set(found) == {
                "t",
                "position",
                "s",
                "feed",
                "accel",
                "jerk",
                "line",
                "period",
                "axes",
            }
            assert found["period"] == MACHINE.path.period
            assert found["axes"].tolist() == list(AXES)
            assert found["line"].dtype == np.int32
            columns = [
                found["t"],
                *found["position"].T,
                found["s"],
                found["feed"],
                found["accel"],
                found["jerk"],
            ]
            assert all(column.dtype == np.float64 for column in columns)
    else:
        assert file.read_text().splitlines()[0] == "t,x,y,z,s,feed,accel,jerk,line"
        columns = list(np.loadtxt(file, delimiter=",", skiprows=1).T[:-1])
    for column, expected in zip(
        columns, (k * 0.001, k / 3, k / 7, k * 0, k / 11, k / 13, k / 17, k / 19), strict=True
    ):
        assert np.array_equal(column, expected)


def test_a_trace_without_motion_has_its_arrays(tmp_path):
    trace_writer(str(tmp_path / "t.npz"), MACHINE).close()
    with np.load(tmp_path / "t.npz") as found:
        assert found["position"].shape == (0, 3)
        assert found["t"].shape == (0,)


def test_pulses_as_arrays(tmp_path):
    file = tmp_path / "p.npz"
    writer = pulse_writer(str(file), MACHINE, np.array([5, 6, 7]))
    writer.write(pulses([10, 20], [[1, 0, 0], [0, -1, 1]]))
    writer.write(pulses([30], [[1, 1, 1]], line=4))
    writer.close()
    with np.load(file) as found:
        assert set(found) == {"time_ns", "step", "line", "axes", "steps_per_mm", "origin_steps"}
        assert found["time_ns"].tolist() == [10, 20, 30]
        assert found["time_ns"].dtype == np.int64
        assert found["step"].tolist() == [[1, 0, 0], [0, -1, 1], [1, 1, 1]]
        assert found["step"].dtype == np.int8
        assert found["line"].tolist() == [3, 3, 4]
        assert found["line"].dtype == np.int32
        assert found["steps_per_mm"].tolist() == [1000.0] * 3
        assert found["origin_steps"].tolist() == [5, 6, 7]


def read_vcd(text: str) -> tuple[dict[str, str], list[tuple[int, str, str]]]:
    """Names by identifier, and (time, identifier, value) of every change after the initial dump."""
    names = {
        match[2]: match[3]
        for match in re.finditer(r"\$var (?:wire 1|integer (32)) (\S+) (\S+) \$end", text)
    }
    changes, time = [], 0
    for line in text.split("$end\n")[-1].splitlines():
        if line.startswith("#"):
            assert int(line[1:]) > time
            time = int(line[1:])
        elif line.startswith("b"):
            changes.append((time, line.split()[1], line.split()[0][1:]))
        else:
            changes.append((time, line[1:], line[0]))
    return names, changes


def test_pulses_for_a_logic_analyser(tmp_path):
    file = tmp_path / "p.vcd"
    writer = pulse_writer(str(file), MACHINE, np.zeros(3, np.int64))
    writer.write(pulses([5000, 5500], [[1, 0, 0], [0, -1, 0]]))
    writer.write(pulses([9000, 9000], [[1, 0, 0], [0, 0, 1]], line=4))
    writer.close()
    names, changes = read_vcd(file.read_text())
    assert names == {
        "s0": "x_step",
        "d0": "x_dir",
        "s1": "y_step",
        "d1": "y_dir",
        "s2": "z_step",
        "d2": "z_dir",
        "l": "line",
    }
    assert changes == [
        (5000, "l", "11"),
        (5000, "d0", "1"),
        (5000, "s0", "1"),
        (5500, "s1", "1"),
        (6000, "s0", "0"),
        (6500, "s1", "0"),
        (9000, "l", "100"),
        (9000, "s0", "1"),
        (9000, "d2", "1"),
        (9000, "s2", "1"),
        (10000, "s0", "0"),
        (10000, "s2", "0"),
    ]


def test_a_pulse_falls_before_the_next_at_the_board_s_highest_rate(tmp_path):
    board = MACHINE.board.model_copy(update={"max_step_rate": 2e6})
    writer = pulse_writer(
        str(tmp_path / "p.vcd"), MACHINE.model_copy(update={"board": board}), np.zeros(3, np.int64)
    )
    writer.write(pulses([500, 1000], [[1, 0, 0], [1, 0, 0]]))
    writer.close()
    edges = [
        (time, value)
        for time, name, value in read_vcd((tmp_path / "p.vcd").read_text())[1]
        if name == "s0"
    ]
    assert edges == [(500, "1"), (750, "0"), (1000, "1"), (1250, "0")]


@pytest.mark.parametrize(
    ("trace", "made"), [("t.txt", None), ("trace", None), (None, "p.csv"), (None, "p")]
)
def test_an_unknown_suffix_is_refused(trace, made):
    with pytest.raises(UsageError, match="output-format"):
        check_suffixes(trace, made, None)


@pytest.mark.parametrize("target", [TextTarget, NpzTarget])
def test_a_file_is_replaced_as_a_whole_or_not_at_all(tmp_path, target):
    file = tmp_path / "f.npz"
    file.write_text("old")
    one = target(str(file))
    one.discard()
    assert file.read_text() == "old"
    other = target(str(file))
    assert file.read_text() == "old"
    other.close()
    other.discard()
    assert file.read_bytes() != b"old"
    assert os.listdir(tmp_path) == ["f.npz"]


def test_a_text_file_has_the_usual_permissions(tmp_path):
    target = TextTarget(str(tmp_path / "f"))
    target.close()
    (tmp_path / "g").touch()
    assert (tmp_path / "f").stat().st_mode == (tmp_path / "g").stat().st_mode


@pytest.mark.parametrize("target", [TextTarget, NpzTarget])
@pytest.mark.parametrize("name", ["no/such/folder.npz", "."])
def test_what_can_not_be_written_is_refused_at_once(tmp_path, monkeypatch, target, name):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match="can-not-write"):
        target(name)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_is_a_message():
    target = TextTarget("/dev/full")
    with pytest.raises(UsageError, match="can-not-write"):
        target.write("x" * 10_000_000)
    target.discard()


@pytest.mark.skipif(not Path("/dev/null").exists(), reason="no /dev/null here")
@pytest.mark.parametrize("target", [TextTarget, NpzTarget])
def test_a_device_is_written_to_and_not_replaced(target):
    one = target("/dev/null")
    one.close()
    assert not Path("/dev/null").is_file()
