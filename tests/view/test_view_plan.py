"""The picture against samples of the plan: it keeps to its stated tolerance at any time."""

import functools

import numpy as np
import pytest

from cnc.view import collect
from cnc.view.collect import Sizes
from tests.support.paths import ROOT
from tests.support.soak import share
from tests.support.view.drawn import EVERYTHING, Drawn, drawn, write

SMALL = Sizes(strokes=300, curves=100, origins=8)
PROGRAMS = {
    "trident.nc": "paper-nurbs",
    "compensation.nc": "default",
    "thread-mill.nc": "default",
    "engraving.nc": "default",
    "bezier.nc": "default",
    **share(
        {
            "pocket.nc": "default",
            "drilling.nc": "default",
            "finishing.nc": "default",
            "siemens-bspline.nc": "default",
            "fanuc-nurbs.nc": "default",
        },
        {},
    ),
}
CASES = [(name, sizes) for name in PROGRAMS for sizes in (EVERYTHING, SMALL)]
BESIDE_ROWS = np.array([1e-4, 1e-2, 0.5])
"""Feed, acceleration and jerk past a corner, relative to the largest value. There the jerk changes
between the rows, and has peaks where the motion is slow.
"""
NEAR = 1e-7
"""mm, and relative to the largest value: rounding of two computations."""


@functools.cache
def case(name: str, sizes: Sizes) -> Drawn:
    return drawn(ROOT / "programs" / name, PROGRAMS[name], sizes)


def farthest(made: Drawn) -> float:
    """Return the largest distance in mm of the drawn tool from the samples of the plan."""
    strokes = made.picture.strokes
    shown = np.stack([np.interp(made.t, strokes.t, axis) for axis in strokes.position.T], axis=1)
    return float(np.linalg.norm(shown - made.position, axis=1).max())


@pytest.mark.parametrize(("name", "sizes"), CASES[:: share(1, 2)])
def test_the_tool_is_drawn_within_the_tolerance_at_any_time(name, sizes):
    made = case(name, sizes)
    strokes = made.picture.strokes
    assert len(strokes.t) <= sizes.strokes
    assert (np.diff(strokes.t) > 0.0).all()
    assert farthest(made) <= strokes.tolerance + NEAR


def test_a_small_picture_is_not_coarser_than_necessary():
    """A table that drops everything would keep to some tolerance as well."""
    strokes = drawn(ROOT / "programs" / "pocket.nc", sizes=Sizes(3000, 100, 100)).picture.strokes
    assert len(strokes.t) > 1000
    assert strokes.tolerance <= 0.1


@pytest.mark.parametrize(("name", "sizes"), CASES)
def test_the_curves_equal_or_contain_those_of_the_plan(name, sizes):
    made = case(name, sizes)
    curves = made.picture.curves
    assert len(curves.t) <= sizes.curves + 1
    row = np.clip(np.searchsorted(curves.t, made.t, side="right") - 1, 0, len(curves.t) - 2)
    # The jerk is discontinuous, and times are sums of floats: skip samples at the edges of phases.
    clear = np.minimum(np.abs(made.t - curves.t[row]), np.abs(made.t - curves.t[row + 1])) > 1e-7
    scale = np.abs(made.values).max(axis=1)
    if curves.within:
        assert sizes is SMALL
        low, high = curves.low[:, row] - made.values, made.values - curves.high[:, row]
        off = np.maximum(low, high) / scale[:, None]
        assert off[:, clear & ~made.timed].max() <= 1e-6
        assert (off[:, clear & made.timed].max(axis=1, initial=0.0) <= 0.1 * BESIDE_ROWS).all()
        return
    v, a, j = curves.start[:, row]
    h = made.t - curves.t[row]
    shown = np.stack((v + h * (a + 0.5 * h * j), a + h * j, j))
    off = np.abs(shown - made.values) / scale[:, None]
    assert off[:, clear & ~made.timed].max() <= 1e-6
    assert (off[:, clear & made.timed].max(axis=1, initial=0.0) <= BESIDE_ROWS).all()


@pytest.mark.parametrize(("name", "sizes"), CASES)
def test_the_source_lines_equal_those_of_the_plan(name, sizes):
    made = case(name, sizes)
    origins = made.picture.origins
    assert len(origins.t) <= sizes.origins
    row = np.clip(np.searchsorted(origins.t, made.t, side="right") - 1, 0, len(origins.t) - 1)
    edges = np.concatenate(([-np.inf], origins.t, [np.inf]))
    # At a jerk of 1e5 mm/s^3 the motion is a rounding error from a rest for 1e-6 s.
    clear = np.minimum(made.t - edges[row + 1], edges[row + 2] - made.t) > 1e-6
    resting = np.concatenate(([True], (np.diff(made.position, axis=0) == 0.0).all(axis=1)))
    compared = clear & ~resting
    assert (origins.first[row] <= made.line)[compared].all()
    assert (made.line <= origins.last[row])[compared].all()


def test_traverses_are_marked(tmp_path):
    program = write(tmp_path, "G21 G90 G0 X10\nG1 X20 F600\nG0 X30\nG0 X40\nG1 X50\nM2\n")
    strokes = drawn(program).picture.strokes
    middle = 0.5 * (strokes.position[:-1, 0] + strokes.position[1:, 0])
    expected = (middle < 10.0) | ((middle > 20.0) & (middle < 40.0))
    assert (strokes.rapid[:-1] == expected).all()
    for border in (10.0, 20.0, 40.0):
        assert np.abs(strokes.position[:, 0] - border).min() < 1e-9


def test_dwells_and_a_program_without_motion(tmp_path):
    made = drawn(write(tmp_path, "G21 G90 G4 P2\nG1 X10 F600\nG4 P3\nM2\n")).picture
    assert made.duration == pytest.approx(5.0 + made.strokes.t[-1] - made.strokes.t[0], abs=1e-9)
    assert made.origins.first.tolist() == [1, 2, 3]
    assert made.origins.t.tolist() == pytest.approx([0.0, 2.0, made.strokes.t[-1]])
    still = drawn(write(tmp_path, "G21\nM2\n")).picture
    assert still.duration == 0.0
    assert still.strokes.position.tolist() == [[0.0, 0.0, 0.0]]


def test_lines_of_a_spline_over_short_moves_are_a_range(tmp_path):
    moves = [f"X{0.1 * k:.3f} Y{0.01 * k * k:.4f}" for k in range(1, 60)]
    program = write(
        tmp_path, "G21 G90 G64 P0.01 F2000\nG1 X0 Y0\n" + "\n".join(moves) + "\nG0 Z5\nM2\n"
    )
    origins = drawn(program).picture.origins
    covered = [
        line
        for first, last in zip(origins.first, origins.last, strict=True)
        for line in range(first, last + 1)
    ]
    assert covered == list(range(3, 63))
    assert len(origins.t) < 40


@pytest.mark.parametrize("name", ["thread-mill.nc", "compensation.nc"])
def test_few_points_at_a_time_keep_the_tolerance(name, monkeypatch):
    monkeypatch.setattr(collect, "ROWS", 5)
    made = drawn(ROOT / "programs" / name, PROGRAMS[name])
    assert farthest(made) <= made.picture.strokes.tolerance + NEAR
