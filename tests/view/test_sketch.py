"""The coarse picture of a program: its points, their number, its curves."""

from __future__ import annotations

import base64
import json
import math
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.machine.load import load_machine
from cnc.model.blocks import ArcFeed, Dwell, NurbsFeed, Polyline
from cnc.view.sketch import SAGITTA, Sketch

MACHINE = load_machine(None)
START = np.zeros(3)


def moves(points, feed=10.0):
    count = len(points)
    return Polyline(
        "p", 1, np.asarray(points, np.float64), np.full(count, feed), np.ones(count, np.int32)
    )


def points_of(sketch):
    """Return the points (n, 3) that the page decodes, and what it knows about them."""
    found = json.loads(sketch.data())
    about, columns = found["about"], []
    for axis, middle in zip("xyz", about["middle"], strict=True):
        packed = zlib.decompress(base64.b64decode(found["columns"][axis]))
        zigzag = np.frombuffer(packed, np.uint8).reshape(4, -1).T.copy().view("<u4").ravel()
        steps = (zigzag >> 1).astype(np.int64) ^ -(zigzag & 1).astype(np.int64)
        columns.append(np.cumsum(steps) * about["quantum"] + middle)
    return np.column_stack(columns), about


@given(st.lists(st.integers(1, 400), min_size=1, max_size=20), st.integers(16, 200))
def test_every_kth_point_is_kept_whatever_the_blocks(sizes, most):
    sketch, first = Sketch(MACHINE, "p", START, most), 1
    for size in sizes:
        x = np.arange(first, first + size, dtype=np.float64)
        sketch.add(moves(np.column_stack((x, np.zeros(size), np.zeros(size)))))
        first += size
    points, about = points_of(sketch)
    x = np.rint(points[:, 0]).astype(int)
    assert points[:, 0] == pytest.approx(x, abs=1e-3)
    assert (x[0], x[-1]) == (0, first - 1)
    steps = np.diff(x[:-1])
    stride = 1 if not len(steps) else int(steps.max())
    assert (steps == stride).all()
    assert 0 <= x[-1] - x[-2] <= stride
    assert len(x) <= most + 1
    assert len(x) >= min(first, most // 2)
    assert about["extent"][0] == pytest.approx([0.0, first - 1.0], abs=1e-3)


def test_arcs_and_splines_are_drawn_within_the_sagitta():
    arc = ArcFeed("p", 1, "XY", (0.0, 10.0), np.array([0.0, 20.0, 0.0]), 10.0, 0.5, 10.0)
    knots = np.array([0.0, 0, 0, 1, 1, 1])
    control = np.array([[0.0, 20, 0], [30.0, 20, 0], [30.0, 50, 0]])
    sketch = Sketch(MACHINE, "p", START)
    sketch.add(arc)
    sketch.add(NurbsFeed("p", 2, 2, knots, control, np.ones(3), 10.0))
    sketch.add(Dwell("p", 3, 1.0))
    points, _ = points_of(sketch)
    middles = np.vstack((points, 0.5 * (points[1:] + points[:-1])))
    u = np.linspace(0.0, 1.0, 4001)[:, None]
    spline = (1 - u) ** 2 * control[0] + 2 * u * (1 - u) * control[1] + u**2 * control[2]
    angle = math.pi * (u - 0.5)
    circle = np.hstack((10.0 * np.cos(angle), 10.0 + 10.0 * np.sin(angle), 0.0 * u))
    curve = np.vstack((circle, spline))
    off = np.linalg.norm(middles[:, None] - curve[None, ::4], axis=2).min(axis=1)
    assert off.max() <= SAGITTA + 0.02
    assert points[-1] == pytest.approx([30.0, 50.0, 0.0], abs=1e-3)
