"""Canonical blocks as JSON Lines: kinds, names and units."""

import json

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
from cnc.report.blocks import BlockWriter, block_objects

AXES = load_machine("paper-nurbs").axis_names
AT = ("p.nc", 7)


def objects(block) -> list[dict]:
    return list(block_objects(block, AXES))


def test_a_polyline_gives_one_object_for_each_move_with_feeds_per_minute():
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


def test_an_arc_has_the_axes_of_its_centre():
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


def test_a_nurbs_has_its_full_definition():
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
        (SpindleSync(*AT, 2.0, 90.0), {"kind": "spindle-sync", "pitch": 2.0, "angle": 90.0}),
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


def test_each_line_of_the_file_is_one_object(tmp_path):
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
