"""The time from a hold to rest, compared with the shortest ramp that ruckig finds.

The paths are straight, so that the shortest ramp is known. Machines have limits over three decades,
feeds differ by up to 1 : 100, and holds come at random moments.
"""

from itertools import pairwise

import numpy as np
import pytest
from ruckig import ControlInterface, InputParameter, Result, Ruckig, Trajectory

from cnc.machine.models import Machine
from cnc.model.blocks import Held, Polyline
from cnc.model.operator_control import Control
from cnc.planner.limits import Limits
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.planner.slowing import ramp_to_rest
from tests.planner.test_random_programs import random_feeds, random_machine
from tests.support.planner.motions import lines, machine, path_of
from tests.support.soak import share

LONGER = 1.1
"""The motion rests within a slice and this times the shortest ramp."""


def shortest_ramp(v: float, a: float, acceleration: float, jerk: float) -> float:
    """Return the time of the fastest motion to rest, s."""
    given, found = InputParameter(1), Trajectory(1)
    given.control_interface = ControlInterface.Velocity
    given.current_position, given.current_velocity, given.current_acceleration = [0.0], [v], [a]
    given.target_velocity, given.target_acceleration = [0.0], [0.0]
    given.max_velocity, given.max_acceleration, given.max_jerk = [1e9], [acceleration], [jerk]
    assert Ruckig(1).calculate(given, found) in (Result.Working, Result.Finished)
    return float(found.duration)


def straight_program(rng: np.random.Generator, mill: Machine) -> tuple[Polyline, float, float]:
    """Return moves along one line, and the acceleration and jerk that the machine has there."""
    limits = Limits.of(mill)
    along = rng.normal(0.0, 1.0, 3)
    along /= np.linalg.norm(along)
    acceleration = min(
        limits.tangential_acceleration, (limits.axis_acceleration / abs(along)).min()
    )
    jerk = min(limits.tangential_jerk, (limits.axis_jerk / abs(along)).min())
    fastest = min(limits.max_feed, (limits.axis_velocity / abs(along)).min())
    count = int(rng.integers(1, 40))
    feeds = np.full(count, fastest * 10 ** rng.uniform(-1.0, 0.0))
    if rng.random() < 0.6:
        feeds = np.clip(random_feeds(rng, count, fastest), 0.01 * fastest, fastest)
    lengths = feeds * 10 ** rng.uniform(-1.5, 0.3, count)
    return lines(np.cumsum(lengths)[:, None] * along, feeds), acceleration, jerk


@pytest.mark.parametrize("seed", range(share(500, 3)))
def test_a_hold_takes_about_as_long_as_the_shortest_ramp(seed):
    rng = np.random.default_rng([seed, 61])
    mill = random_machine(rng)
    moves, acceleration, jerk = straight_program(rng, mill)
    whole = sum(plan.duration for plan in LookAhead(mill).plan(path_of([moves])))
    moment = rng.uniform(0.0, whole)
    control, end, held, slowest = Control(), 0.0, False, 0.0
    for item in LookAhead(mill, control).plan(path_of([moves])):
        if isinstance(item, PlanChunk):
            end = item.t0 + item.duration
            if end >= moment and not control.held and not held:
                control.hold()
                ramp = shortest_ramp(
                    float(item.phase_v[-1]), float(item.phase_a[-1]), acceleration, jerk
                )
                slowest = end + LONGER * ramp + 1e-9
        elif isinstance(item, Held):
            held = True
            assert end <= slowest
            control.resume()


@pytest.mark.parametrize("part", [0.2, 0.4, 0.6, 0.8][:: share(1, 2)])
def test_a_hold_during_a_lower_feed_goes_on_slowing(part):
    """The motion slows from 120 to 40 mm/s, and is held in the middle of that."""
    mill = machine(axis=(1000.0, 8000.0), tangential=None, normal=None, jerk=None)
    moves = lines([(60, 0, 0), (300, 0, 0)], [120.0, 40.0])
    control, ramp, requested, end = Control(), 0.0, 0.0, 0.0
    for item in LookAhead(mill, control, slice_s=0.002).plan(path_of([moves])):
        if isinstance(item, Held):
            assert end - requested <= 1.01 * ramp
            return
        v, a = float(item.phase_v[-1]), float(item.phase_a[-1])
        end = item.t0 + item.duration
        if a < 0.0 and v < 120.0 - 80.0 * part and not control.held:
            control.hold()
            requested, ramp = end, shortest_ramp(v, a, 1000.0, 8000.0)
    pytest.fail("the motion was not held")


@pytest.mark.parametrize("a", [-900.0, -400.0, 0.0, 700.0, 1000.0])
@pytest.mark.parametrize("v", [9.0, 50.0, 300.0])
def test_a_ramp_from_any_acceleration_is_the_shortest(v, a):
    phases = ramp_to_rest(5.0, v, a, 1000.0, 48_000.0)
    t, _, speed, acceleration, jerk = phases[-1].tolist()
    assert speed + t * (acceleration + 0.5 * t * jerk) == pytest.approx(0.0, abs=1e-9)
    assert acceleration + t * jerk == pytest.approx(0.0, abs=1e-9)
    assert phases["duration"].sum() == pytest.approx(
        shortest_ramp(v, a, 1000.0, 48_000.0), rel=1e-9
    )
    for before, after in pairwise(phases):
        assert before["a"] + before["duration"] * before["j"] == pytest.approx(after["a"], abs=1e-9)


def test_there_is_no_ramp_that_would_go_back():
    assert ramp_to_rest(0.0, 1.0, -900.0, 1000.0, 48_000.0) is None
    assert ramp_to_rest(0.0, 50.0, -1100.0, 1000.0, 48_000.0) is None
