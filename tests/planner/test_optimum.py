"""The reference of the benchmark: times that theory or another method gives."""

import math

import numpy as np
import pytest

from benchmarks.corners import Case, run
from benchmarks.optimum import times_of
from benchmarks.optimum_cases import AXES, FAMILIES, cases, moves
from benchmarks.optimum_path import Route
from cnc.model.blocks import NurbsFeed, PathMode
from cnc.path.build import build
from cnc.planner.limits import Limits
from tests.support.planner import figures

EXACT = PathMode("", 1, "exact-path")


@pytest.mark.parametrize("length", [2.0, pytest.param(40.0, marks=pytest.mark.soak)])
def test_times_of_a_straight_line_are_those_of_theory(length):
    accel, jerk, feed = 2400.0, 48000.0, 150.0
    line = moves(np.array([[0.0, 0.0, 0.0], [length, 0.0, 0.0]]), feed)
    times = times_of([EXACT, line], AXES, figures.machine(accel, jerk, per_axis=True))
    # Half of the way up: with a plateau of acceleration or, on the short line, without.
    if length == 2.0:
        with_jerk = 4.0 * (length / (2.0 * jerk)) ** (1.0 / 3.0)
        without = 2.0 * math.sqrt(length / accel)
    else:
        with_jerk = feed / accel + accel / jerk + length / feed
        without = length / feed + feed / accel
    assert times.solved
    assert times.t3 == pytest.approx(with_jerk, rel=2e-3)
    assert times.t2 == pytest.approx(without, rel=5e-3)


@pytest.mark.soak
def test_t3_of_a_curve_is_the_best_known_time():
    (best,) = (case.best for case in figures.cases() if case.name == "trident, per axis")
    points = np.array([(*point, 0.0) for point in figures.TRIDENT], float)
    knots = np.array(figures.TRIDENT_KNOTS, float)
    curve = NurbsFeed("", 1, 3, knots, points - points[0], np.ones(len(points)), 300.0)
    times = times_of([EXACT, curve], AXES, figures.machine(per_axis=True))
    assert times.solved
    assert times.t3 == pytest.approx(best, rel=5e-3)
    assert times.t2 < times.t3


@pytest.mark.soak
def test_the_grid_has_points_in_bends_that_are_shorter_than_its_cells():
    """A spline back along its own line turns within micrometres; T3 passed there at any speed."""
    points = np.array(
        [(0, 0, 0), (10, 0, 0), (20, 0.1, 0), (4, 0.2, 0), (4, 9, 0), (9, 9, 0)], float
    )
    knots = np.concatenate((np.zeros(4), [1 / 3, 2 / 3], np.ones(4)))
    curve = NurbsFeed("", 1, 3, knots, points.astype(float), np.ones(len(points)), 300.0)
    chunks = [*build([EXACT, curve], axes=AXES, start=np.zeros(3))]
    route = Route(chunks, Limits.of(figures.machine()))
    length = float(route.ends[-1])
    s = route.points(0.0, length, np.linspace(0.0, length, 50)[1:-1])
    places = np.linspace(0.0, length, 20_001)

    def lowest(grid):
        last = len(route.ends) - 2
        pieces = np.clip(np.searchsorted(route.ends, grid) - 1, 0, last)
        pairs = zip(grid.tolist(), pieces.tolist(), strict=True)
        return min(route.at(place, piece)[1] for place, piece in pairs)

    assert lowest(s) < 1.2 * lowest(places)
    assert lowest(np.linspace(0.0, length, 50)) > 2.0 * lowest(places)


@pytest.mark.soak
@pytest.mark.parametrize(
    "corners", [[(0.4, 0.3, 0.0)], [(0.25, 0.2, 0.1), (0.5, -0.1, -0.2)]], ids=["plane", "space"]
)
def test_the_fastest_motion_past_corners_is_straight_where_the_tolerance_allows_it(corners):
    length, jerk = 0.8, 200_000.0
    points = np.array([(0.0, 0.0, 0.0), *corners, (length, 0.0, 0.0)])
    mill = figures.machine(50_000.0, jerk, 50_000.0, feed=300.0)
    found = run(Case("path", points, 0.4, 300.0, mill))
    # A motion from rest to rest that takes neither the acceleration nor the feed.
    assert found.best == pytest.approx(4.0 * (length / (2.0 * jerk)) ** (1.0 / 3.0), rel=0.01)
    assert found.best < found.ours


def test_cases_are_those_of_their_seed():
    first, again = cases(5, 12), cases(5, 12)
    other = cases(6, 12)
    assert {name for name, _, _ in first} == set(FAMILIES)
    assert [case.machine for *_, case in first] == [case.machine for *_, case in again]
    assert [case.machine for *_, case in first] != [case.machine for *_, case in other]


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(12))
def test_the_planner_is_near_the_optimum_in_hairpins(seed):
    rng = np.random.default_rng([seed, 3])
    step = rng.normal(0.0, 8.0, (8, 3))
    for k in range(2, 8, 3):
        step[k] = -rng.uniform(0.7, 1.0) * step[k - 1]
    points = np.concatenate((np.zeros((1, 3)), np.cumsum(step, axis=0)))
    knots = np.concatenate((np.zeros(4), np.arange(1, 6) / 6.0, np.ones(4)))
    curve = NurbsFeed("", 1, 3, knots, points, np.ones(len(points)), 250.0)
    accel = float(10 ** rng.uniform(2.7, 3.7))
    mill = figures.machine(accel, accel * 25.0, per_axis=True)
    times = times_of([EXACT, curve], AXES, mill)
    assert times.ours < 1.05 * times.t3
