"""Contours that can't be cut."""

from __future__ import annotations

import cmath
import math
from typing import Literal

import numpy as np
import pytest

from cnc.gcode.core.compensation import Compensation
from cnc.model.blocks import ArcFeed
from cnc.model.diagnostics import GcodeError
from tests.support.gcode.compensation_cases import (
    FEED,
    HERE,
    WORD,
    Arc,
    Line,
    Move,
    Recorder,
    refused,
    send,
)

E = 1e-6
GOUGE, ENTRY, ROUND = "compensation-gouge", "compensation-entry", "compensation-arc-radius"


# From 15, 0, tangent to X: its floor has radius 4, and at 13.95, -3.74 comes back to within 3.88 of
# 15, 0.
POCKET = [
    Arc(19.207354924039482, -2.298488470659301, 15.0, -5.0, -0.15915494309189535),
    Arc(
        13.946880612639237,
        -3.735088472654164,
        15.806075764765673,
        -0.19342313184208093,
        -0.238732414637843,
    ),
]

BACK = [
    Arc(POCKET[0].x, POCKET[0].y, POCKET[1].cx, POCKET[1].cy, -POCKET[1].turns),
    Arc(15.0, 0.0, POCKET[0].cx, POCKET[0].cy, -POCKET[0].turns),
]

TO = 40 + cmath.rect(24.0, math.radians(130)) + cmath.rect(24.0, math.radians(-115))

FLOOR = Arc(
    TO.real,
    TO.imag,
    40 + 24 * math.cos(math.radians(130)),
    24 * math.sin(math.radians(130)),
    -65 / 360,
)
"""From 40, 0, at 40 degrees below the way there; it is 5.6 deep and 3.36 at its end."""
GAP = math.asin(0.3)
TIP = Arc(10 - 5 * math.sin(2 * GAP), 5 - 5 * math.cos(2 * GAP), 10, 5, 1.0 - GAP / math.pi)
"""From 10, 0, tangent to X, nearly around a circle: its ends are 3 apart."""


# the tool has radius 2 and starts at 0, 0; the line is that of the move that can't be made
@pytest.mark.parametrize(
    ("side", "moves", "code", "line"),
    [
        # entries: not longer than the radius, no arc to lead in
        ("left", [Line(2, 0)], ENTRY, 1),
        ("left", [Line(1.2, 1.6)], ENTRY, 1),
        ("left", [Line(0, 0, 5), Line(0, 1, 4)], ENTRY, 2),
        ("right", [Line(0, 0, 5), "dwell", Line(0, -1.999, rapid=True)], ENTRY, 3),
        ("right", [Arc(0, 0, 0, 10, 1.0)], ENTRY, 1),
        ("left", [Arc(10, 0, 5, 0, 1.5)], ENTRY, 1),
        ("left", [Arc(0.1, 0.0001, 0.05, -50, -0.0003)], ENTRY, 1),
        # an entry into a corner so sharp that the tool would have to begin behind its start
        ("left", [Line(10, 0), Line(1, 2)], GOUGE, 1),
        ("right", [Line(10, 0), Line(1, -2)], GOUGE, 1),
        ("left", [Line(4, 0), Line(4 - 9 * math.cos(0.5), 9 * math.sin(0.5))], GOUGE, 1),
        # arcs that the tool does not fit into
        ("left", [Arc(1, 1, 0, 1, 0.25)], ROUND, 1),
        ("left", [Line(10, 0), Arc(12, 2, 10, 2, 0.25)], ROUND, 2),
        ("left", [Line(10, 0), Arc(11, 1, 10, 1, 0.25)], ROUND, 2),
        ("right", [Line(10, 0), "dwell", Arc(11, -1, 10, -1, -0.25)], ROUND, 3),
        ("left", [Line(10, 0), Arc(10, 0, 10, 1.9, 1.0)], ROUND, 2),
        ("left", [Line(10, 0), Arc(10, 0, 10, 2 + 1e-10, 4.0)], ROUND, 2),
        # a slot narrower than the tool: its end is the move that vanishes
        ("left", [Line(10, 0), Line(10, 4 - E), Line(-10, 4 - E)], GOUGE, 2),
        ("right", [Line(10, 0), Line(10, -3), Line(-10, -3)], GOUGE, 2),
        ("left", [Line(10, 0), Line(10, 3), "dwell", Line(10, 3, 1), Line(-10, 3)], GOUGE, 2),
        # a step that is lower than the tool's radius, inside corner first or last
        ("left", [Line(10, 0), Line(10, 1), Line(20, 1)], GOUGE, 2),
        ("left", [Line(5, 0), Line(10, 0), Line(10, -1), Line(20, -1)], GOUGE, 3),
        ("left", [Line(10, 0), Line(10.5, 0.5), Line(10.5, 10)], GOUGE, 2),
        # a short move behind a corner that takes more than all of it: the corner itself can't be
        # reached
        ("left", [Line(10, 0), Line(10, 1), Line(10, 0.5)], GOUGE, 2),
        ("left", [Line(10, 0), Line(9.5, 0.5), Line(0, 0.6)], GOUGE, 2),
        # arcs: a line through a circle, a notch of two circles, a hollow between two others, a step
        # down behind a bump
        ("left", [Line(10, 0), Line(20, 0), Arc(20, 20, 20, 10, 0.5), Line(25, -5)], GOUGE, 4),
        (
            "left",
            [Line(10, 0), Line(20, 0), Arc(20, 6, 20, 3, 0.5), Arc(22.5, 3.5, 22.5, 6, 0.25)],
            GOUGE,
            4,
        ),
        (
            "right",
            [Line(10, 0), Line(11, 0), Arc(17, 0, 14, 0, 0.5), Arc(23, 0, 20, 0, 0.5)],
            GOUGE,
            2,
        ),
        (
            "left",
            [Line(10, 0), Arc(16, 0, 13, 0, -0.5), Arc(16.5, 0.5, 16.5, 0, -0.25), Line(30, 0.5)],
            GOUGE,
            3,
        ),
        ("left", [Line(10, 0), Arc(30, 0, 20, 0, -0.5), Line(30, 10), Line(10, 10.5)], GOUGE, 3),
        # a move that crosses the one before it: the tool has gone there
        (
            "left",
            [
                Line(9, 0),
                Line(10, 0),
                Line(30, 0),
                Arc(25 - math.sqrt(26), 1, 25, 1, math.atan(0.2) / math.tau - 0.5),
            ],
            GOUGE,
            4,
        ),
        # a pocket that closes at its mouth, where the tool, beside the floor all the way out, cuts
        # the corner at which the roof began; the same from the other end; and one under a straight
        # roof
        (
            "right",
            [Line(15, 0), POCKET[0], POCKET[1], Line(13.504172445037726, -3.5026890786383595)],
            GOUGE,
            3,
        ),
        ("left", [Line(POCKET[1].x, POCKET[1].y), *BACK, Line(5, 0)], GOUGE, 2),
        ("right", [Line(10, 0), Line(40, 0), FLOOR, Line(13, -3)], GOUGE, 2),
        # around the tip of a C and into it, through a gap of 3
        ("right", [Line(10, 0), TIP, Line(TIP.x + math.cos(2.3), TIP.y + math.sin(2.3))], GOUGE, 3),
        (
            "right",
            [Line(10, 0), TIP, Line(TIP.x + math.cos(2.3), TIP.y + math.sin(2.3), rapid=True)],
            GOUGE,
            3,
        ),
        # from outside around a corner into a circle
        ("left", [Line(10, 0), Arc(10, 0, 15, 0, 1.0)], GOUGE, 2),
        # around an outside corner into a circle that closes there; on a line that touches a circle
        # from outside, into it and out of it
        (
            "left",
            [Line(5, 0), Line(10, 0), Arc(10, 0, 10 + 5 * math.sin(1), -5 * math.cos(1), 1.0)],
            GOUGE,
            2,
        ),
        (
            "left",
            [Line(10, 5), Line(10, 0), Arc(10, 0, 10 - 5 * math.sin(1), 5 * math.cos(1), 1.0)],
            GOUGE,
            3,
        ),
        ("left", [Line(3, 0), Line(10, 0), Arc(10, 0, 10, 5, 1.0)], GOUGE, 2),
        ("left", [Line(10, 0), Arc(10, 0, 10, 5, 1.0), Line(20, 0)], GOUGE, 3),
    ],
)
def test_refused(side: Literal["left", "right"], moves: list[Move], code: str, line: int) -> None:
    found = refused(moves, side, 2.0)
    assert (found.code, found.line, found.column) == (code, line, WORD.column)
    assert found.hint


@pytest.mark.parametrize("move", [Arc(30, 0, 25, 0, 0.5), Arc(20, 0, 25, 0, 1.0)])
def test_an_arc_does_not_lead_out(move: Arc) -> None:
    compensation = Compensation(Recorder(), HERE)
    compensation.start("left", 2.0, "XY", (0, 1), [0.0, 0.0, 0.0])
    send(compensation, [Line(20, 0)], [0.0, 0.0, 0.0])
    compensation.stop()
    with pytest.raises(GcodeError) as caught:
        compensation.arc(
            ArcFeed(
                "test.nc",
                7,
                "XY",
                (move.cx, move.cy),
                np.array([move.x, move.y, 0.0]),
                5.0,
                move.turns,
                FEED,
            )
        )
    found = caught.value.diagnostic
    assert (found.code, found.column) == ("compensation-exit", WORD.column)


def test_start_while_on() -> None:
    compensation = Compensation(Recorder(), HERE)
    compensation.start("left", 2.0, "XY", (0, 1), [0.0, 0.0, 0.0])
    with pytest.raises(GcodeError, match="compensation-already-on"):
        compensation.start("right", 2.0, "XY", (0, 1), [0.0, 0.0, 0.0], WORD)
