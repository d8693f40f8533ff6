"""Contours that can't be cut, and properties of all contours that can."""

from __future__ import annotations

import cmath
import contextlib
import math
from typing import Literal

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cnc.gcode.geometry.clearance import clearance
from cnc.gcode.geometry.compensation import Compensation
from cnc.gcode.geometry.offset_curves import MITRE, Curve, TrueArc, round_offset, straight_offset
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
    distance,
    headings,
    record,
    refused,
    sampled,
    send,
    turn,
)
from tests.support.soak import share

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


@st.composite
def contours(draw: st.DrawFn) -> list[Move]:
    """An entry along X and up to five lines and arcs that turn by up to 3.1 rad where they meet,
    and often not at all.
    """
    moves: list[Move] = [Line(30.0, 0.0)]
    here, heading = 30 + 0j, 1 + 0j
    for _ in range(draw(st.integers(1, 5))):
        heading *= cmath.exp(
            1j
            * draw(
                st.one_of(
                    st.just(0.0), st.floats(-1.6, 1.6), st.floats(-0.06, 0.06), st.floats(-3.1, 3.1)
                )
            )
        )
        if draw(st.booleans()):
            length = draw(st.floats(0.5, 40.0))
            here += length * heading
            moves.append(Line(here.real, here.imag))
        else:
            radius, spin, swept = (
                draw(st.floats(0.5, 30.0)),
                draw(st.sampled_from((1, -1))),
                draw(st.one_of(st.floats(0.05, 1.5), st.floats(0.05, 5.7))),
            )
            center = here + 1j * spin * radius * heading
            here = center + (here - center) * cmath.exp(1j * spin * swept)
            heading *= cmath.exp(1j * spin * swept)
            moves.append(
                Arc(here.real, here.imag, center.real, center.imag, spin * swept / math.tau)
            )
    return moves


def accepted(moves: list[Move], side: Literal["left", "right"], radius: float) -> Recorder:
    """The rows of a contour as far as it can be cut."""
    recorder = Recorder()
    compensation = Compensation(recorder, HERE)
    compensation.start(side, radius, "XY", (0, 1), [0.0, 0.0, 0.0])
    with contextlib.suppress(GcodeError):
        send(compensation, moves, [0.0, 0.0, 0.0])
        compensation.stop()
    return recorder


@settings(max_examples=share(20_000, 150))
@given(contours(), st.sampled_from(("left", "right")), st.floats(0.3, 6.0))
@example(
    [
        Line(30.0, 0.0),
        Arc(38.414709848078964, -4.596976941318602, 30.0, -10.0, -0.15915494309189535),
        Arc(
            27.893761225278475,
            -7.470176945308328,
            31.612151529531346,
            -0.38684626368416186,
            -0.238732414637843,
        ),
        Line(27.008344890075453, -7.005378157276719),
    ],
    "right",
    4.0,
)
@example(
    [
        Line(30.0, 0.0),
        Line(30.9372066360084, 0.0),
        Arc(
            23.282388255775004,
            -59.509578310208326,
            8787.036598955216,
            -1156.5590884587311,
            0.001081197062410264,
        ),
        Arc(
            48.643204279608014,
            -70.83361655818763,
            37.5289163983611,
            -61.66418394482548,
            0.4141027930517109,
        ),
        Line(41.091688472501104, -70.66121473798894),
    ],
    "left",
    2.083805241617081,
)
def test_the_tool_keeps_its_distance(
    moves: list[Move], side: Literal["left", "right"], radius: float
) -> None:
    found = accepted(moves, side, radius)
    starts = [0j]
    starts += [complex(move.x, move.y) for move in moves if not isinstance(move, str)]
    sign = 1.0 if side == "left" else -1.0
    here, before = 0j, None
    for row, line in zip(found.rows, found.lines, strict=True):
        end = complex(row[1], row[2])
        if row[0] == "arc":
            center = complex(row[4], row[5])
            assert abs(abs(here - center) - row[6]) < 1e-9
            assert abs(abs(end - center) - row[6]) < 1e-9
            assert abs(center + (here - center) * cmath.exp(1j * math.tau * row[7]) - end) < 1e-8
        first, last = headings(row, here)
        if before is not None and line > 2:
            # behind the entry joins are smooth, or inside corners, or slight
            assert sign * turn(before, first) > -3 * MITRE
        if line > 1:
            corner = row[0] == "arc" and row[4:7] == (
                starts[line - 1].real,
                starts[line - 1].imag,
                radius,
            )
            points = sampled(row, here)
            for near in range(max(line - 1, 2), min(line + 1, len(moves)) + (0 if corner else 1)):
                move = moves[near - 1]
                assert not isinstance(move, str)
                assert distance(points, move, starts[near - 1]).min() > radius - 1e-9
            own = moves[line - 1]
            assert not isinstance(own, str)
            assert (
                distance(points, own, starts[line - 1]).max()
                < math.hypot(radius, MITRE * radius) + 1e-9
            )
            if corner:
                assert np.abs(np.abs(points - starts[line - 1]) - radius).max() < 1e-9
        here, before = end, last


PLANE = st.complex_numbers(max_magnitude=20.0, allow_nan=False, allow_infinity=False)


@st.composite
def moves_apart(draw: st.DrawFn) -> tuple[complex, Line | Arc]:
    """A line or an arc of up to a turn, and where it starts."""
    start, other = draw(PLANE), draw(PLANE)
    if abs(other - start) < 0.1:
        other = start + 1
    if draw(st.booleans()):
        return start, Line(other.real, other.imag)
    turns = draw(st.floats(0.01, 1.0)) * draw(st.sampled_from((1, -1)))
    end = other + (start - other) * cmath.exp(1j * math.tau * turns)
    return start, Arc(end.real, end.imag, other.real, other.imag, turns)


@settings(max_examples=share(20_000, 150))
@given(moves_apart(), moves_apart(), st.floats(0.0, 0.45), st.floats(0.55, 1.0))
@example((0j, Arc(0.0, 0.0, 1.0, 0.0, 1.0)), (0j, Arc(0.0, 0.0, 1e-309, 3.0, 1.0)), 0.0, 1.0)
@example((0j, Arc(0.0, 0.0, 1.0, 0.0, 1.0)), (-2 + 0j, Arc(-2.0, 0.0, 1.0, 1e-309, 1.0)), 0.0, 1.0)
def test_clearance_is_the_least_of_many_distances(
    a: tuple[complex, Line | Arc], b: tuple[complex, Line | Arc], start: float, stop: float
) -> None:
    """Of the part of ``a`` from one share of its length to another."""
    path, move = offset(*a), offset(*b)
    row: tuple[object, ...] = ("line", a[1].x, a[1].y, 0.0)
    if isinstance(a[1], Arc):
        row = (
            "arc",
            a[1].x,
            a[1].y,
            0.0,
            a[1].cx,
            a[1].cy,
            abs(a[0] - complex(a[1].cx, a[1].cy)),
            a[1].turns,
        )
    points = sampled(row, a[0], 2001)[int(2000 * start) : int(2000 * stop) + 1]
    start, stop = int(2000 * start) / 2000, int(2000 * stop) / 2000
    found, near = (
        clearance(path, start * path.length, stop * path.length, move),
        distance(points, b[1], b[0]).min(),
    )
    # a place between two points is at most half their distance from one of them
    assert near - path.length * path.scale / 4000 - 1e-9 < found < near + 1e-9


def offset(start: complex, move: Line | Arc) -> Curve:
    """By a tool without a radius."""
    end = complex(move.x, move.y)
    if isinstance(move, Line):
        return straight_offset(start, end, 1, 0.0)
    curve = round_offset(start, TrueArc(end, complex(move.cx, move.cy), move.turns, 1.0), 1, 0.0)
    assert curve is not None
    return curve


@settings(max_examples=share(5_000, 36))
@given(contours(), st.floats(0.3, 6.0))
def test_the_mirror_image_has_the_other_side(moves: list[Move], radius: float) -> None:
    mirrored: list[Move] = []
    for move in moves:
        assert not isinstance(move, str)
        if isinstance(move, Line):
            mirrored.append(Line(move.x, -move.y))
        else:
            mirrored.append(Arc(move.x, -move.y, move.cx, -move.cy, -move.turns))
    left, right = accepted(moves, "left", radius), accepted(mirrored, "right", radius)
    assert len(left.rows) == len(right.rows)
    for a, b in zip(left.rows, right.rows, strict=True):
        flipped = [a[1], -a[2], *a[3:]]
        if a[0] == "arc":
            flipped = [a[1], -a[2], a[3], a[4], -a[5], a[6], -a[7]]
        assert list(b[1:]) == pytest.approx(flipped, abs=1e-9)


def test_memory_does_not_grow() -> None:
    """A thousand turns of a square spiral: never more than a move is held."""
    recorder = Recorder()
    compensation = Compensation(recorder, HERE)
    compensation.start("left", 1.0, "XY", (0, 1), [0.0, -5.0, 0.0])
    x = y = 0.0
    for step in range(4000):
        length = 4.0 + step
        x, y = x + (0.0, length, 0.0, -length)[step % 4], y + (length, 0.0, -length, 0.0)[step % 4]
        compensation.move([x, y, 0.0], FEED, step)
        assert len(recorder.rows) >= 2 * (step - 1)


def test_a_contour_closed_by_a_distant_entry() -> None:
    assert record([Line(500.0, 0.0), Line(1000.0, 0.0)], "right", 0.001).rows[0][1:3] == (
        500.0,
        -0.001,
    )
