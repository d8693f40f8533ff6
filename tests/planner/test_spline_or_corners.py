"""The faster of spline and corners, as the planner times them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.api import plan
from cnc.kinematics.delta import Delta
from cnc.machine.models import Axis, Machine
from cnc.model.blocks import PathMode
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.path.fit import Alternatives
from cnc.planner import phases
from cnc.planner.corner_choice import with_faster_paths
from cnc.planner.joints import Joints
from cnc.planner.kernels.refine import refine
from cnc.planner.plan import PlanChunk
from cnc.session.pipeline import path_of
from tests.planner.test_random_corners import random_chain, random_mill
from tests.support.planner.corners import duration, planned
from tests.support.planner.motions import AXES, lines, machine
from tests.support.soak import share


def times(seed):
    """Times of the spline wherever it can be, of the faster of both, and with stops at corners."""
    rng = np.random.default_rng(seed)
    points, mill = random_chain(rng), random_mill(rng)
    tolerance, feed = 10 ** rng.uniform(-3, -0.5), 10 ** rng.uniform(0.7, 2.5)
    made = [
        planned(points, tolerance, mill, feed)[0],
        planned(points, tolerance, mill, feed, chooses=True)[0],
        planned(points, 0.0, mill, feed)[0],
    ]
    return [duration(chunks) for chunks in made]


@pytest.mark.parametrize("seed", share([62000030, 83000058, 73000157], [62000030]))
def test_a_polygon_takes_no_longer_than_with_stops(seed):
    spline, faster, stops = times(seed)
    assert spline > 1.1 * stops
    assert faster <= stops


@settings(max_examples=share(1000, 3), deadline=None)
@given(seed=st.integers(0, 2**31))
def test_the_choice_makes_no_polygon_slower(seed):
    spline, faster, stops = times(seed)
    assert faster <= 1.01 * spline
    assert faster <= 1.1 * stops


def test_programs_are_planned_with_the_choice(tmp_path):
    rng = np.random.default_rng(83000058)
    points, mill = random_chain(rng), random_mill(rng)
    tolerance, feed = 10 ** rng.uniform(-3, -0.5), 60.0 * 10 ** rng.uniform(0.7, 2.5)
    points, tolerance, feed = np.round(points, 9), round(tolerance, 9), round(feed, 9)
    file = tmp_path / "t.nc"
    moves = [f"G1 X{x:.9f} Y{y:.9f} Z{z:.9f}" for x, y, z in points]
    file.write_text(f"G21 G90 G94 G64 P{tolerance:.9f} F{feed:.9f}\n" + "\n".join(moves))
    chunks = [item for item in plan(file, mill) if isinstance(item, PlanChunk)]
    faster = duration(planned(points, tolerance, mill, feed / 60.0, chooses=True)[0])
    assert duration(chunks) == pytest.approx(faster, rel=1e-6)


@pytest.mark.parametrize(("limits", "refined"), [("path", False), ("axis", True)])
def test_trials_are_refined_only_where_it_changes_the_choice(limits, refined, monkeypatch):
    """Along the path a refinement saves about as much on both paths, and takes most of the time."""
    mill = (
        machine(tangential=1000.0, normal=1000.0, jerk=20_000.0)
        if limits == "path"
        else machine(axis=(1000.0, 20_000.0), tangential=None, normal=None, jerk=None)
    )
    heading = np.radians(np.cumsum([0.0, 70.0, -50.0, 80.0, -60.0, 40.0]))
    steps = np.stack((np.cos(heading), np.sin(heading), 0.0 * heading), axis=1)
    moves = [PathMode("t.nc", 1, "blend", 0.1), lines(np.cumsum(steps, axis=0), 50.0)]
    offered = build(moves, axes=AXES, start=np.zeros(3), offers_corners=True)
    refinements = []

    def counted(*arguments):
        refinements.append(arguments)
        return refine(*arguments)

    monkeypatch.setattr(phases, "refine", counted)
    assert any(isinstance(item, PathChunk) for item in with_faster_paths(offered, mill))
    assert bool(refinements) == refined


def test_no_choice_where_the_pose_sets_the_time():
    delta = Delta(type="delta", radius=150.0, rod=310.0)
    axis = Axis(steps_per_mm=100.0, max_velocity=100.0)
    joint = axis.model_copy(update={"max_acceleration": 1000.0, "max_jerk": 2e4})
    machine = Machine(
        axes=dict.fromkeys("xyz", axis), joints=dict.fromkeys("abc", joint), kinematics=delta
    )
    start, zigzag = np.zeros(3), [(1, 0, 0), (1, 1, 0), (2, 1, 0), (2, 2, 0), (3, 2, 0)]
    blocks = [PathMode("t.nc", 1, "blend", 0.1), lines(zigzag, 20.0)]
    offered = build(blocks, axes=AXES, start=start, offers_corners=True)
    assert any(isinstance(item, Alternatives) for item in offered)
    (path,) = path_of(blocks, machine, start)
    (spline,) = Joints(machine).path(build(blocks, axes=AXES, start=start), start)
    assert path.data.tobytes() == spline.data.tobytes()
