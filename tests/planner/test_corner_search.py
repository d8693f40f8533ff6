"""Which motions past corners are sought at all: the cost of searches that would gain nothing."""

import numpy as np
import pytest

from benchmarks import finishing
from cnc.model.blocks import PathMode
from cnc.path.build import build
from cnc.planner.audit import Audit
from cnc.planner.corner_motions import CornerMotions
from cnc.planner.kernels.arrays import PlanArrays
from cnc.planner.kernels.corner_search import (
    OPEN,
    goes_on,
)
from cnc.planner.kernels.corner_stops import WORTH
from cnc.planner.limits import Limits
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.planner.work import Work
from tests.support.planner.corners import planned
from tests.support.planner.motions import lines, machine, sampled

ACCELERATION, JERK = 1000.0, 50_000.0


def ramp(speed: float) -> PlanArrays:
    """Return the ramp from a speed to rest and back: the textbook phases of both limits."""
    jerk = np.array([-JERK, 0.0, JERK, JERK, 0.0, -JERK])
    part = ACCELERATION / JERK
    time = np.array([part, speed / ACCELERATION - part, part])
    time = np.concatenate((time, time[::-1]))
    t, s, v, a = (np.zeros(7) for _ in range(4))
    v[0] = speed
    for k, (dt, j) in enumerate(zip(time, jerk, strict=True)):
        t[k + 1] = t[k] + dt
        s[k + 1] = s[k] + dt * (v[k] + dt * (a[k] / 2.0 + dt * j / 6.0))
        v[k + 1] = v[k] + dt * (a[k] + dt * j / 2.0)
        a[k + 1] = a[k] + dt * j
    v[3] = a[3] = 0.0
    return PlanArrays(s[[0, 3, 6]].copy(), t, s, v, a, jerk)


@pytest.mark.parametrize("speed", [30.0, 60.0])
def test_the_motion_goes_on_only_where_the_jerk_lets_it(speed):
    """By the lowest speed that the largest jerk along the path leaves, on a fine grid."""
    both = Limits.of(machine(axis=(ACCELERATION, JERK), tangential=ACCELERATION, jerk=JERK)).arrays
    axes = Limits.of(machine(axis=(ACCELERATION, JERK), tangential=None, jerk=None)).arrays
    plan = ramp(speed)
    seen = set()
    for part in np.linspace(0.02, 0.98, 49):
        before, behind = part * plan.t[3], plan.t[6] - part * plan.t[3]
        k = int(np.searchsorted(plan.t, before, side="right")) - 1
        dt = before - plan.t[k]
        v = plan.v[k] + dt * (plan.a[k] + dt * plan.j[k] / 2.0)
        a = plan.a[k] + dt * plan.j[k]
        later = np.linspace(0.0, 2.0 * ACCELERATION / JERK, 20_001)
        lowest = (v + a * later + JERK * later**2 / 2.0).min() / v
        if abs(lowest - OPEN) > 1e-3:
            expected = bool(lowest > OPEN)
            assert goes_on((before, behind), plan, both) == (expected, expected)
            seen.add(expected)
        assert goes_on((before, behind), plan, axes) == (True, True)
    assert seen == {True, False}


def test_the_ends_of_rows_that_cannot_be_passed_faster_are_not_sought():
    """Their legs lie inside the last part of the ramp to rest; beside them the path is curved."""
    points = finishing.points(6 * finishing.MOVES_IN_ROW)
    points = points[np.arange(len(points)) % finishing.MOVES_IN_ROW < 40]

    def planned_rows(mill):
        ahead = LookAhead(mill)
        blocks = [
            PathMode("t.nc", 1, "blend", finishing.TOLERANCE),
            lines(points[1:], finishing.FEED),
        ]
        path = build(blocks, axes=finishing.AXES, start=points[0], short_legs=4)
        chunks = [item for item in ahead.plan(path) if isinstance(item, PlanChunk)]
        return int(ahead._corners._solutions.next[0]), chunks[-1].t0 + chunks[-1].duration

    sought, time = planned_rows(finishing.machine(tangential=False, per_axis=True))
    assert sought > 0
    few, slower = planned_rows(finishing.machine(tangential=True, per_axis=True))
    # Five ends of rows, with two corners each and up to three searches: one of them is near OPEN.
    assert few <= 1
    assert slower > time


def test_the_corners_before_one_that_stays_a_stop_are_passed():
    """The last leg is a short line that a curve of short moves follows."""
    mill = machine(axis=(ACCELERATION, JERK), tangential=ACCELERATION, jerk=JERK)
    turn = 0.003 * np.arange(1, 30)
    curve = np.stack((1.0 - np.cos(turn), np.sin(turn), 0.0 * turn), axis=1) * 80.0
    points = np.concatenate((np.array([(2, 0, 0), (2, 2, 0), (4, 2, 0)]), (4, 2, 0) + curve))
    passed, ahead = planned(points, 0.01, mill, 30.0)
    positions = sampled(passed, 1e-4)
    near = [np.linalg.norm(positions - corner, axis=1).min() for corner in points[:3]]
    assert near[2] < 1e-6
    assert 1e-3 < min(near[:2]) < max(near[:2]) <= 0.01
    # Both are passed by one motion, which is sought at once.
    assert int(ahead._corners._solutions.next[0]) == 1


def corner(tilt, feed=40.0, row=20.0):
    """Return the legs of two corners, as the end of a row over a surface has them."""
    along = np.array([(1.0, 0.0, tilt), (0.0, 1.0, 0.5 * tilt), (-1.0, 0.0, -tilt)])
    return np.cumsum([row * along[0], 0.4 * along[1], row * along[2]], axis=0), feed


def row_ends(tilts, work, *, row=20.0):
    """Return the time past the ends of rows, each on its own, and the work for each, s."""
    mill = machine(axis=(ACCELERATION, JERK), tangential=ACCELERATION, jerk=JERK)
    times, taken = [], []
    for tilt in tilts:
        points, feed = corner(tilt, row=row)
        stops, ahead = planned(points, 0.0, mill, feed)
        for chunk in stops:
            chunk.path.tolerance[:] = 0.01
        motions = CornerMotions(ahead.limits, Audit(ahead.limits), work)
        before = float(work.left[0])
        parts = [part.plan for part in (*motions.passed(stops), *motions.flush())]
        assert not ahead.audit.violations
        times.append(sum(part.duration for part in parts))
        taken.append(before - float(work.left[0]))
    return np.array(times), np.array(taken)


def test_nothing_is_sought_where_the_work_is_used_up():
    """The corner stays a stop."""
    work = Work(-10.0)
    stop, taken = row_ends([0.1], work)
    assert taken[0] == pytest.approx(0.0, abs=1e-12)
    work.left[0] = 1.0
    times, taken = row_ends([0.1], work)
    assert taken[0] > 1e-3
    assert times[0] < stop[0]


def zigzag(rows: list[float]) -> np.ndarray:
    """Return the corners of rows of a surface, with the length of each row, mm."""
    steps = []
    for k, row in enumerate(rows):
        tilt = 0.1 + 0.001 * k
        steps += [(-1.0) ** k * row * np.array([1.0, 0.0, tilt]), np.array([0.0, 0.4, 0.02])]
    return np.cumsum(steps, axis=0)


def passed_rows(points: np.ndarray, promised: float = 1.0) -> tuple[list[PlanChunk], int]:
    """Return the motion past the ends of rows, and the number of searches.

    ``promised``: the part of their time that motions are expected to save at first.
    """
    mill = machine(axis=(ACCELERATION, JERK), tangential=ACCELERATION, jerk=JERK)
    stops, ahead = planned(points, 0.0, mill, 40.0)
    for chunk in stops:
        chunk.path.tolerance[:] = 0.01
    motions = CornerMotions(ahead.limits, Audit(ahead.limits), Work(1e3))
    motions._solutions.promised[0] = promised
    parts = [part.plan for part in (*motions.passed(stops), *motions.flush())]
    assert not ahead.audit.violations
    return parts, int(motions._solutions.next[0])


def duration(parts: list[PlanChunk]) -> float:
    return sum(part.duration for part in parts)


@pytest.mark.parametrize("row", [1000.0, 4000.0])
def test_corners_far_apart_stay_stops_where_the_last_ones_gained_too_little(row):
    """One of about ten is sought, and what the others cost is below WORTH of the time."""
    points = zigzag([row] * 40)
    all_sought, searches = passed_rows(points, promised=np.inf)
    assert searches >= 40
    some, few = passed_rows(points)
    assert 2 <= few <= searches / 4
    assert duration(all_sought) < duration(some) < duration(all_sought) * (1.0 + WORTH)


def test_corners_close_together_are_all_sought_also_behind_those_far_apart():
    far, near = [2000.0] * 20, [4.0] * 30
    (alone, searches), (_, before) = passed_rows(zigzag(near)), passed_rows(zigzag(far))
    assert passed_rows(zigzag(near), promised=np.inf)[1] == searches
    both, sought = passed_rows(zigzag(far + near))
    assert sought >= before + searches - 2
    gained = duration(passed_rows(zigzag(far + near), promised=0.0)[0]) - duration(both)
    assert gained > 0.9 * (duration(passed_rows(zigzag(near), promised=0.0)[0]) - duration(alone))


def test_a_chain_that_is_left_out_stays_a_row_of_stops():
    """Its second corner is not sought on its own."""
    parts, searches = passed_rows(zigzag([2000.0] * 4), promised=0.0)
    assert searches == 0
    rests = sum(int(np.count_nonzero(part.phase_v[1:] == 0.0)) for part in parts)
    assert rests == 8
