"""The material that a tool leaves is that of the tool at all places along its path."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cnc.machine.models import Stock
from cnc.model.blocks import ArcFeed, Polyline
from cnc.path.build import build
from cnc.stock import simulation as module
from cnc.stock.kernels.sweep import BALL, BULL, CONE, FLAT, Assembly, Cutter
from cnc.stock.simulation import Material, default_resolution
from tests.support.soak import share

AXES = ("x", "y", "z")
STOCK = Stock(x=(0.0, 12.0), y=(0.0, 10.0), z=(-8.0, 0.0))
CUTTERS = {
    "flat": Cutter(FLAT, 2.0, 2.0, 0.0),
    "ball": Cutter(BALL, 2.0, 0.0, 2.0),
    "bull": Cutter(BULL, 2.0, 1.2, 0.8),
    "cone": Cutter(CONE, 2.0, 0.0, 1.0 / math.tan(math.radians(30.0))),
    "cone with a tip": Cutter(CONE, 2.0, 0.5, 1.0),
    "drill": Cutter(CONE, 2.0, 0.0, 1.0 / math.tan(math.radians(59.0))),
}


def path_of(points, start, feed=10.0):
    ends = np.array(points, np.float64)
    lines = np.arange(1, len(ends) + 1, dtype=np.int32)
    block = Polyline("", 1, ends, np.full(len(ends), feed), lines)
    (chunk,) = build([block], axes=AXES, start=np.array(start, np.float64))
    return chunk


def tool_of(cutter):
    return Assembly(cutter, math.inf, math.inf, 0.0)


def cut(material, path, cutter):
    return material.cut(path, np.arange(3), np.zeros(3), tool_of(cutter))


def profile(name, r):
    """The height of a cutting surface above the tip, written from the drawings of the tools."""
    if name == "flat":
        return np.zeros_like(r)
    if name == "ball":
        return 2.0 - np.sqrt(4.0 - r**2)
    if name == "bull":
        return np.where(r < 1.2, 0.0, 0.8 - np.sqrt(0.64 - np.maximum(r - 1.2, 0.0) ** 2))
    if name == "cone":
        return r * math.sqrt(3.0)
    if name == "cone with a tip":
        return np.maximum(0.0, r - 0.5)
    return r / math.tan(math.radians(59.0))


def by_stamps(material, start, points, name, stamps):
    """The heights after the tool has stood at ``stamps`` places of each move."""
    x = material.low[0] + (np.arange(material.heights.shape[0]) + 0.5) * material.cell
    y = material.low[1] + (np.arange(material.heights.shape[1]) + 0.5) * material.cell
    left = np.full(material.heights.shape, material.high[2])
    here = np.array(start)
    for end in np.array(points):
        for share_done in np.linspace(0.0, 1.0, stamps):
            tip = here + share_done * (end - here)
            r = np.hypot(x[:, None] - tip[0], y[None, :] - tip[1])
            inside = r < 2.0 - 1e-9
            z = np.where(inside, tip[2] + profile(name, np.minimum(r, 2.0 - 1e-9)), np.inf)
            left = np.minimum(left, z)
        here = end
    return left


PLACES = st.tuples(st.floats(-3, 15), st.floats(-3, 13), st.floats(-7, 2))


@settings(max_examples=share(300, 4), deadline=None)
@given(st.sampled_from(sorted(CUTTERS)), st.lists(PLACES, min_size=2, max_size=4))
@example("bull", [(0.0, 0.0, 0.0), (0.0, 2.0, -1.0)])
def test_the_cut_is_that_of_the_tool_at_all_places(name, places):
    start, *points = [tuple(round(each, 3) for each in place) for place in places]
    points = [end for here, end in zip([start, *points], points, strict=False) if end != here]
    if not points:
        return
    material = Material(STOCK, 0.5)
    cut(material, path_of(points, start), CUTTERS[name])
    stamps = 3001
    stamped = by_stamps(material, start, points, name, stamps)
    longest = max(math.dist(a, b) for a, b in zip([start, *points], points, strict=False))
    # Between two stamps the tip is at most half their distance away. At the rim a cell may be
    # reached between them alone; such cells are left out.
    step = longest / (stamps - 1)
    reached_later = (stamped == material.high[2]) & (material.heights < material.high[2])
    assert reached_later.mean() < 0.02
    below = stamped - material.heights
    steep = 2.0 if name in ("flat", "cone", "cone with a tip", "drill") else 60.0
    allowed = 1e-9 + steep * step * (1.0 + 7.0)
    assert below[~reached_later].max() <= allowed
    # Nothing is left that a stamp has removed, but for the iteration of a bull nose.
    assert (-below).max() <= (2e-5 if name == "bull" else 1e-9)


def test_volumes_of_a_slot_and_a_groove():
    start, end = (-5.0, 5.0, -1.5), (17.0, 5.0, -1.5)
    material = Material(STOCK, 0.02)
    cut(material, path_of([end], start), CUTTERS["flat"])
    assert material.removed_volume() == pytest.approx(12.0 * 4.0 * 1.5, rel=5e-3)
    material = Material(STOCK, 0.02)
    cut(material, path_of([end], start), CUTTERS["ball"])
    angle = 2.0 * math.acos(0.5 / 2.0)
    segment = 2.0**2 / 2.0 * (angle - math.sin(angle))
    assert material.removed_volume() == pytest.approx(12.0 * segment, rel=5e-3)
    material = Material(STOCK, 0.02)
    cut(material, path_of([end], start), CUTTERS["cone"])
    assert material.removed_volume() == pytest.approx(12.0 * 1.5 * 1.5 / math.sqrt(3.0), rel=5e-3)


def test_a_helix_leaves_a_ring():
    block = ArcFeed("", 1, "XY", (6.0, 5.0), np.array([6.0, 8.0, -2.0]), 3.0, 2.0, 10.0)
    (path,) = build([block], axes=AXES, start=np.array([6.0, 8.0, 0.0]))
    material = Material(STOCK, 0.05)
    cut(material, path, Cutter(FLAT, 0.5, 0.5, 0.0))
    x = (np.arange(material.heights.shape[0]) + 0.5) * 0.05 - 6.0
    y = (np.arange(material.heights.shape[1]) + 0.5) * 0.05 - 5.0
    r = np.hypot(x[:, None], y[None, :])
    assert (material.heights[np.abs(r - 3.0) < 0.45] < 0.0).all()
    assert (material.heights[np.abs(r - 3.0) > 0.55] == 0.0).all()
    assert material.heights.min() == -2.0


def test_chords_replace_short_moves_within_their_tolerance():
    angle = np.linspace(0.0, 1.0, 400)
    points = np.stack((1.0 + 10.0 * np.sin(angle), 10.0 * np.cos(angle), -2.0 - angle), axis=1)
    exact, quick = Material(STOCK, 0.1), Material(STOCK, 0.1)
    for here, end in itertools.pairwise(points):
        cut(exact, path_of([end], here), CUTTERS["ball"])
    cut(quick, path_of(points[1:], points[0]), CUTTERS["ball"])
    x, y = ((np.arange(count) + 0.5) * 0.1 for count in exact.heights.shape)
    apart = np.hypot(x[:, None, None] - points[:, 0], y[None, :, None] - points[:, 1]).min(axis=2)
    # Up to half its radius a ball rises by 0.58 mm for each mm; the path itself by 0.1.
    near = apart < 1.0
    assert np.abs(exact.heights - quick.heights)[near].max() < 0.05 * 0.1 * 1.7
    assert quick.removed_volume() == pytest.approx(exact.removed_volume(), rel=1e-3)


def test_processors_share_the_work_without_a_difference(monkeypatch):
    rng = np.random.default_rng()
    points = rng.uniform((-2, -2, -6), (14, 12, 1), (60, 3))
    monkeypatch.setattr(module, "BAND", 8)
    monkeypatch.setattr(module, "WORTH_THREADS", 1)
    found = []
    for processors in (1, 3):
        monkeypatch.setattr(module.os, "cpu_count", lambda count=processors: count)
        material = Material(STOCK, 0.2)
        path = path_of(points[1:], points[0], np.nan)
        depths = cut(material, path, CUTTERS["bull"])
        found.append((material.heights, depths.depth))
    assert np.array_equal(found[0][0], found[1][0])
    assert np.array_equal(found[0][1], found[1][1])
    assert found[0][1].max() > 1.0


def test_the_default_resolution_bounds_the_cells():
    assert default_resolution(STOCK) == 0.1
    large = Stock(x=(0.0, 2000.0), y=(0.0, 1000.0), z=(-10.0, 0.0))
    assert Material(large).heights.size <= module.MOST_CELLS * 1.01
