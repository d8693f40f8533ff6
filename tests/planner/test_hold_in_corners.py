"""A hold inside a motion past corners: it comes to rest there, on the curve of that motion."""

import numpy as np
import pytest
from scipy.integrate import quad

from benchmarks import corners, holds
from cnc.kernels.path.curve import SPAN, curve_eval
from cnc.kernels.planner.phases import PHASE, phase_at
from cnc.kernels.planner.timed import is_timed
from cnc.model.blocks import Held, PathMode
from cnc.model.operator_control import Control
from cnc.path.build import build
from cnc.planner import slowing
from cnc.planner.audit import Audit
from cnc.planner.detour import detour
from cnc.planner.finished import Finished, FinishedPart
from cnc.planner.limits import Limits
from cnc.planner.lookahead import LookAhead
from cnc.planner.phases import slice_end
from cnc.planner.plan import PlanChunk
from cnc.planner.requests import SEARCH_AGAIN
from tests.support.planner.corners import PER_AXIS, duration
from tests.support.planner.motions import AXES, lines, sampled
from tests.support.soak import share

SLICE = 0.02
ZIGZAG = np.cumsum([(3.0, 0.0, 0.0), (1.0, 3.0, 0.0), (3.0, -1.0, 0.0), (0.0, -3.0, 1.0)], axis=0)
"""Corners that are passed together."""


def planning(points, tolerance=0.05, slice_s=SLICE):
    """Return a planner, its plans of a path within a tolerance, and the operator's control."""
    control = Control()
    ahead = LookAhead(PER_AXIS, control, slice_s=slice_s)
    blocks = [PathMode("t.nc", 1, "blend", tolerance), lines(points, 60.0)]
    path = build(blocks, axes=AXES, start=np.zeros(3), passes=True)
    return ahead, ahead.plan(path), control


def past_corners(plan):
    """Return whether all of a plan is a motion past corners."""
    path = plan.path
    return all(
        is_timed(int(kind), path.data, int(at)) for kind, at in zip(path.kind, path.at, strict=True)
    )


def motions():
    """Return the slices that pass corners."""
    return [plan for plan in planning(ZIGZAG)[1] if past_corners(plan)]


def derivatives(path, at, u):
    """Return position and three derivatives of a span, rows (4, 3)."""
    found = np.empty((4, 3))
    curve_eval(SPAN, path.data, at, u, found)
    return found


def speed(u, path, at):
    return float(np.linalg.norm(derivatives(path, at, u)[1]))


def test_a_finished_motion_is_handed_out_in_slices():
    whole = [plan.duration for plan in planning(ZIGZAG)[1]]
    assert len(whole) > 10
    assert max(whole) <= SLICE + 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_the_last_slice_ends_at_rest_exactly(seed):
    points = np.cumsum(np.random.default_rng([seed, 44]).uniform(-3.0, 3.0, (6, 3)), axis=0)
    last = list(planning(points)[1])[-1]
    assert (last.phase_v[-1], last.phase_a[-1]) == (0.0, 0.0)


def test_slices_are_the_motion_without_an_operator():
    sliced = list(planning(ZIGZAG)[1])
    blocks = [PathMode("t.nc", 1, "blend", 0.05), lines(ZIGZAG, 60.0)]
    path = build(blocks, axes=AXES, start=np.zeros(3), passes=True)
    whole = list(LookAhead(PER_AXIS).plan(path))
    assert duration(sliced) == pytest.approx(duration(whole), abs=1e-9)
    # States at the ends of a motion are rounded, and the plan is cut at other times.
    assert sampled(sliced, 1e-3) == pytest.approx(sampled(whole, 1e-3), abs=1e-7)


def test_a_search_without_a_stop_is_not_repeated_at_once(monkeypatch):
    """A board has about 0.1 s of motion. In that time a search must be over."""
    _, plans, control = planning(ZIGZAG, slice_s=0.01)
    searches, sent = [], 0.0
    real = slowing._shortest_stop

    def without_stop(request):
        if not request.soon:
            return real(request)
        searches.append(sent)
        return None

    class NoSearch(slowing._Search):
        def run(self):
            assert not self.request.soon
            return super().run()

    monkeypatch.setattr(slowing, "_shortest_stop", without_stop)
    monkeypatch.setattr(slowing, "_Search", NoSearch)
    for item in plans:
        if isinstance(item, Held):
            break
        sent = item.t0 + item.duration
        if past_corners(item):
            control.hold()
    assert len(searches) >= 2
    assert np.diff(searches[:-1]).min() > SEARCH_AGAIN - 1e-9


def test_the_path_of_a_motion_past_corners_is_the_same_curve():
    for motion in motions():
        curve, _ = detour(motion, Limits.of(PER_AXIS))
        assert (curve.kind == SPAN).all()
        for k in range(len(curve)):
            at, like = int(curve.at[k]), int(motion.path.at[k])
            extent = float(motion.path.length[k])
            for u in (0.0, 0.3 * extent, extent):
                here = derivatives(curve, at, u)
                assert here == pytest.approx(derivatives(motion.path, like, u), abs=1e-12)
            measured, _ = quad(speed, 0.0, extent, (motion.path, like), epsabs=1e-13, epsrel=1e-13)
            assert curve.length[k] == pytest.approx(measured, abs=1e-10)


def test_the_phases_of_a_motion_past_corners_follow_it():
    """Beside the motion by time: places, speeds and accelerations at 200 times."""
    limits = Limits.of(PER_AXIS)
    for motion in motions():
        curve, phases = detour(motion, limits)
        assert phases.dtype == PHASE
        assert phases["duration"].sum() == pytest.approx(motion.duration, abs=1e-12)
        begins = np.concatenate(([0.0], np.cumsum(phases["duration"])))
        for t in np.linspace(0.0, motion.duration, 200):
            k = min(int(np.searchsorted(begins, t, side="right")) - 1, len(phases) - 1)
            row = phases[k]
            s, v, a = phase_at(t - begins[k], *(float(row[name]) for name in ("s", "v", "a", "j")))
            velocity, acceleration, _ = holds.state(motion, motion.t0 + t)
            speed = float(np.linalg.norm(velocity))
            assert v == pytest.approx(speed, rel=1e-4)
            along = float(velocity @ acceleration) / speed
            assert a == pytest.approx(along, abs=1e-3 * limits.axis_acceleration[0])
            assert 0.0 <= s <= float(curve.length.sum()) + 1e-9


def rests(seed):
    """Return the time from a hold inside a motion past corners to rest, less that to its end."""
    rng = np.random.default_rng(seed)
    polygon = corners.random_case(corners.FAMILIES[seed % len(corners.FAMILIES)], rng)
    program = holds.Program(holds.POLYGONS, corners.blocks_of(polygon), polygon.machine)
    plain = [item for item in holds.motion(program, Control()) if isinstance(item, PlanChunk)]
    inside = [k for k, plan in enumerate(plain) if past_corners(plan)]
    if not inside:
        return None
    first = inside[int(rng.integers(len(inside)))]
    last = first
    while last + 1 < len(plain) and past_corners(plain[last + 1]):
        last += 1
    control, end = Control(), 0.0
    for number, item in enumerate(holds.motion(program, control)):
        if isinstance(item, Held):
            break
        end = item.t0 + item.duration
        if number == first:
            control.hold()
    asked = plain[first].t0 + plain[first].duration
    return end - asked, duration(plain[: last + 1]) - asked


def test_a_hold_does_not_wait_for_the_end_of_the_motion():
    """But where several axes are at their limits, so that there is no other motion."""
    found = [each for seed in range(share(200, 18)) if (each := rests(seed)) is not None]
    took, left = np.array(found).T
    long = left > 0.15
    assert long.sum() >= 5
    assert (took[long] < left[long]).mean() >= 0.8


def test_a_slice_ends_inside_the_last_phase_that_may_be_sent():
    phases = np.array([(0.5, 0.0, 2.0, 0.0, 0.0), (10.0, 1.0, 2.0, 0.0, 0.0)], PHASE)
    assert slice_end(phases, 0.7, 0.0) == (1, pytest.approx(0.2))
    assert slice_end(phases, 0.3, 3.0) == (1, pytest.approx(1.0))
    assert slice_end(phases, 11.0, 0.0) == (2, 0.0)


def test_a_slice_that_is_left_at_the_end_of_the_path_has_a_piece():
    """Within the rounding error of a length, the end of the path is behind its last piece."""
    (whole,) = LookAhead(PER_AXIS).plan(
        build([lines([(3.0, 0.0, 0.0)], 60.0)], axes=AXES, start=np.zeros(3))
    )
    finished = Finished()
    finished.add([FinishedPart(whole, (), 0.0, False, Audit(Limits.of(PER_AXIS)))])
    finished.take(whole.duration - 5e-6)
    rest = finished.take(1.0)
    assert not finished
    assert len(rest.path) == 1
    assert whole.phase_s[-1] - rest.phase_s[0] < 1e-9
