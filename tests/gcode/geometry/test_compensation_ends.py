"""Compensated contours: entry, exit, blocks between moves, other planes and axes."""

from __future__ import annotations

import cmath
import math
from typing import Literal

import numpy as np
import pytest

from cnc.gcode.core.compensation import MAX_WAITING, Compensation
from cnc.model.blocks import ArcFeed
from cnc.model.diagnostics import GcodeError
from tests.support.gcode.compensation_cases import (
    FEED,
    HERE,
    Arc,
    Line,
    Move,
    Recorder,
    Row,
    record,
    same,
    send,
)


def test_blocks_between_take_place_at_the_end_of_the_move() -> None:
    moves: list[Move] = [
        Line(10, 0),
        Line(20, 0),
        Line(20, 0, -3),
        "dwell",
        Line(20, 10),
        Line(20, 10, 5, rapid=True),
        Line(40, 10),
    ]
    found = record(moves, "left", 2.0)
    expected: list[Row] = [
        ("line", 10, 2, 0),
        ("line", 18, 2, 0),
        ("line", 18, 2, -3),
        ("dwell",),
        ("line", 18, 10, -3),
        ("rapid", 18, 10, 5),
        ("arc", 20, 12, 5, 20, 10, 2, -0.25),
        ("line", 40, 12, 5),
    ]
    same(found.rows, expected)
    assert found.lines == [1, 2, 3, 4, 5, 6, 7, 7]


def test_moves_across_the_plane_before_the_entry() -> None:
    found = record(
        [Line(0, 0, 5, rapid=True), "dwell", Line(0, 0, -1), Line(10, 0), Line(20, 0)], "right", 2.0
    )
    same(
        found.rows,
        [
            ("rapid", 0, 0, 5),
            ("dwell",),
            ("line", 0, 0, -1),
            ("line", 10, -2, -1),
            ("line", 20, -2, -1),
        ],
    )


# Circles of radius 10 about 0, 0 from 10, 0; the ways in and out are straight, quarters and halves
# of circles that touch it there.
@pytest.mark.parametrize(
    ("side", "turns", "way_in", "way_out", "start"),
    [
        ("right", 1.0, [Line(10, -30), Line(10, 0)], [Line(10, 30)], (10, -50)),
        (
            "right",
            1.0,
            [Line(15, -5), Arc(10, 0, 15, 0, -0.25)],
            [Arc(15, 5, 15, 0, -0.25), Line(20, 5)],
            (30, -5),
        ),
        ("right", 1.0, [Line(50, 0), Arc(10, 0, 30, 0, -0.5)], [Arc(50, 0, 30, 0, -0.5)], (50, 20)),
        (
            "left",
            1.0,
            [Line(5, -5), Arc(10, 0, 5, 0, 0.25)],
            [Arc(5, 5, 5, 0, 0.25), Line(4, 5)],
            (-5, -5),
        ),
        ("left", 1.0, [Line(0, 0), Arc(10, 0, 5, 0, 0.5)], [Arc(0, 0, 5, 0, 0.5)], (0, 8)),
        (
            "right",
            1.0 - 0.1 / math.tau,
            [Line(15, -5), Arc(10, 0, 15, 0, -0.25)],
            [Arc(10, 0, 0, 0, 0.1 / math.tau)],
            (30, -5),
        ),
    ],
)
def test_lead_in_and_lead_out_of_a_full_circle(
    side: Literal["left", "right"],
    turns: float,
    way_in: list[Move],
    way_out: list[Move],
    start: tuple[float, float],
) -> None:
    end = cmath.rect(10.0, math.tau * turns)
    found = record(
        [*way_in, Arc(end.real, end.imag, 0, 0, turns), *way_out], side, 3.0, start=(*start, 0.0)
    )
    circle = next(row for row in found.rows if row[0] == "arc" and row[4:6] == (0.0, 0.0))
    assert circle[6:] == pytest.approx((13.0 if side == "right" else 7.0, turns), abs=1e-9)


# An arc leads in on the circle through the start that touches the offset arc's end. Programmed: a
# quarter about 0, 10 from 0, 0 to 10, 10. Tool on the right: the end is 15, 10; the centre c, 10
# has c^2 + 100 = (15 - c)^2: c = 125 / 30. Tool on the left: the end is 5, 10; c^2 + 100 = (5 -
# c)^2: c = -7.5.
@pytest.mark.parametrize(("side", "x", "c"), [("right", 15.0, 125 / 30), ("left", 5.0, -7.5)])
def test_an_arc_leads_in(side: str, x: float, c: float) -> None:
    found = record([Arc(10, 10, 0, 10, 0.25), Line(10, 20)], side, 5.0)
    swept = math.atan2(10, -c) / math.tau
    same(found.rows, [("arc", x, 10, 0, c, 10, x - c, swept), ("line", x, 20, 0)])


def test_the_next_move_after_g40_leads_out() -> None:
    recorder = Recorder()
    compensation = Compensation(recorder, HERE)
    compensation.start("left", 2.0, "XY", (0, 1), [0.0, 0.0, 0.0])
    send(compensation, [Line(10, 0), Line(20, 0)], [0.0, 0.0, 0.0])
    compensation.stop()
    assert not compensation.on
    assert compensation.active
    compensation.move([30.0, -5.0, 0.0], FEED, 3)
    assert not compensation.active
    same(recorder.rows, [("line", 10, 2, 0), ("line", 20, 2, 0), ("line", 30, -5, 0)])


def test_restart_without_lead_out() -> None:
    recorder = Recorder()
    compensation = Compensation(recorder, HERE)
    for side in ("left", "right"):
        compensation.start(side, 2.0, "XY", (0, 1), [0.0 if side == "left" else 20.0, 0.0, 0.0])
        send(compensation, [Line(20, 0) if side == "left" else Line(40, 0)], [0.0, 0.0, 0.0])
        compensation.stop()
    same(recorder.rows, [("line", 20, 2, 0), ("line", 40, -2, 0)])


def test_g40_without_a_move() -> None:
    compensation = Compensation(Recorder(), HERE)
    compensation.start("left", 2.0, "XY", (0, 1), [1.0, 2.0, 3.0])
    compensation.stop()
    assert not compensation.active


# Z X plane, columns 2 and 0: left of +X is -Z.
def test_another_plane() -> None:
    recorder = Recorder()
    compensation = Compensation(recorder, HERE)
    compensation.start("left", 5.0, "ZX", (2, 0), [0.0, 1.0, 0.0])
    compensation.move([20.0, 1.0, 0.0], FEED, 1)
    compensation.move([20.0, 1.0, 20.0], FEED, 2)
    compensation.stop()
    arc = ("arc", 25, 1, 0, 0, 20, 5, -0.25)
    same(recorder.rows, [("line", 20, 1, -5), arc, ("line", 25, 1, 20)])


def test_the_control_point_of_a_lathe_tool() -> None:
    """The rows of the nose's centre, moved by the shift; the way in and out is that of the control
    point itself.
    """
    recorder = Recorder()
    compensation = Compensation(recorder, HERE)
    compensation.start("left", 5.0, "ZX", (2, 0), [0.0, 1.0, 0.0], shift=(-5.0, -5.0))
    compensation.move([20.0, 1.0, 0.0], FEED, 1)
    compensation.move([20.0, 1.0, 20.0], FEED, 2)
    compensation.stop()
    compensation.move([60.0, 1.0, 40.0], FEED, 3)
    arc = ("arc", 20, 1, -5, -5, 15, 5, -0.25)
    same(recorder.rows, [("line", 15, 1, -10), arc, ("line", 20, 1, 15), ("line", 60, 1, 40)])


def test_feeds_stay_those_of_the_program() -> None:
    found = record(
        [
            Line(10, 0, feed=1.0),
            Line(20, 0, feed=2.0),
            Line(20, -10, feed=3.0),
            Line(30, -10, feed=4.0),
        ],
        "left",
        2.0,
    )
    assert found.feeds == [1.0, 2.0, 3.0, 3.0, 4.0]


def test_other_axes_move_as_programmed() -> None:
    recorder = Recorder()
    compensation = Compensation(recorder, HERE)
    compensation.start("left", 2.0, "XY", (0, 1), [0.0, 0.0, 0.0, 0.0])
    compensation.move([10.0, 0.0, 0.0, 90.0], FEED, 1)
    compensation.move([10.0, 10.0, 0.0, 180.0], FEED, 2)
    compensation.arc(
        ArcFeed("test.nc", 3, "XY", (5.0, 10.0), np.array([0.0, 10.0, -1.0, 270.0]), 5.0, 0.5, FEED)
    )
    compensation.stop()
    assert [row[3:5] for row in recorder.rows] == [(0, 90), (0, 180), (-1, 270)]


def test_the_number_of_waiting_blocks_is_limited() -> None:
    compensation = Compensation(Recorder(), HERE)
    compensation.start("left", 2.0, "XY", (0, 1), [0.0, 0.0, 0.0])
    compensation.move([10.0, 0.0, 0.0], FEED, 1)
    for line in range(MAX_WAITING):
        compensation.move([10.0, 0.0, float(line % 2)], FEED, 2 + line)
    with pytest.raises(GcodeError) as caught:
        compensation.move([10.0, 0.0, 7.0], FEED, 5)
    assert (caught.value.diagnostic.code, caught.value.diagnostic.line) == (
        "compensation-look-ahead",
        1,
    )
