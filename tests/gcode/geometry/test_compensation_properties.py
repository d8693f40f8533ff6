"""Properties of all compensated contours: distance, mirror image, memory."""

from __future__ import annotations

import cmath
import contextlib
import math
from typing import Literal

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cnc.gcode.core.compensation import Compensation, clearance
from cnc.gcode.core.offset_curves import MITRE, Curve, TrueArc, round_offset, straight_offset
from cnc.model.diagnostics import GcodeError
from tests.support.gcode.compensation_cases import (
    FEED,
    HERE,
    Arc,
    Line,
    Move,
    Recorder,
    distance,
    headings,
    record,
    sampled,
    send,
    turn,
)
from tests.support.soak import share


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


@settings(max_examples=share(20_000, 40))
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


@settings(max_examples=share(20_000, 40))
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


@settings(max_examples=share(5_000, 10))
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
