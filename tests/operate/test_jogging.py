"""End points and speeds of jogs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.machine.load import load_machine
from cnc.model.diagnostics import UsageError
from cnc.operate import jogging

MACHINE = load_machine(None)


def stop_time(speed: float, acceleration: float, jerk: float) -> float:
    """Return the duration of a stop, by integration of its three phases."""
    ramp = min(acceleration / jerk, math.sqrt(speed / jerk))
    constant = max(0.0, (speed - jerk * ramp * ramp) / acceleration)
    time = np.linspace(0.0, 2.0 * ramp + constant, 20001)
    deceleration = np.minimum(np.minimum(jerk * time, jerk * ramp), jerk * (time[-1] - time))
    assert np.trapezoid(deceleration, time) == pytest.approx(speed, rel=1e-4)
    return float(time[-1])


@given(st.floats(10.0, 10_000.0), st.floats(100.0, 1e6), st.floats(0.02, 0.5))
def test_a_stop_from_the_speed_takes_the_given_time(acceleration, jerk, seconds):
    speed = jogging.stopping_speed(acceleration, jerk, seconds)
    assert stop_time(speed, acceleration, jerk) == pytest.approx(seconds, rel=1e-6)


def test_a_stop_without_a_limit_of_jerk_takes_the_given_time():
    assert jogging.stopping_speed(250.0, math.inf, 0.15) == pytest.approx(37.5)


@given(
    st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda each: max(map(abs, each)) > 0.01),
    st.tuples(st.floats(-9.0, 409.0), st.floats(-9.0, 309.0), st.floats(-109.0, 59.0)),
)
def test_an_endless_jog_ends_where_the_first_axis_meets_its_travel(direction, place):
    position = dict(zip("xyz", place, strict=True))
    move = jogging.endless_move(
        MACHINE, position, dict(zip("xyz", direction, strict=True)), None, 0.1
    )
    at_limit = 0
    for letter, end in move.end.items():
        low, high = MACHINE.axes[letter].travel
        assert low - 1e-9 <= end <= high + 1e-9
        at_limit += min(abs(end - low), abs(end - high)) < 1e-6
        assert (end - position[letter]) * direction["xyz".index(letter)] >= 0.0
    assert at_limit >= 1


def test_a_jog_at_the_end_of_the_travel_is_refused():
    with pytest.raises(UsageError, match="soft-limit"):
        jogging.endless_move(MACHINE, {"x": 410.0, "y": 0.0, "z": 0.0}, {"x": 1.0}, None, 0.1)


@pytest.mark.parametrize(
    ("start", "distance", "allowed"),
    [(0.0, 410.0, True), (0.0, 411.0, False), (500.0, -1.0, True), (500.0, 1.0, False)],
)
def test_a_step_ends_within_the_travel_or_leads_back_to_it(start, distance, allowed):
    position = {"x": start, "y": 0.0, "z": 0.0}
    if allowed:
        move = jogging.step_move(MACHINE, position, {"x": distance}, None, 0.1)
        assert move.end == {"x": start + distance}
    else:
        with pytest.raises(UsageError, match="soft-limit"):
            jogging.step_move(MACHINE, position, {"x": distance}, None, 0.1)


@pytest.mark.parametrize(
    ("distances", "feed", "code"),
    [
        ({"x": 0.0}, None, "jog-nowhere"),
        ({}, None, "jog-nowhere"),
        ({"b": 1.0}, None, "jog-axis"),
        ({"x": math.nan}, None, "jog-axis"),
        ({"x": math.inf}, None, "jog-axis"),
        ({"x": 1.0}, 0.0, "jog-feed"),
        ({"x": 1.0}, math.nan, "jog-feed"),
    ],
)
def test_impossible_jogs_are_refused(distances, feed, code):
    position = dict.fromkeys("xyz", 0.0)
    for plan in (jogging.step_move, jogging.endless_move):
        with pytest.raises(UsageError) as caught:
            plan(MACHINE, position, distances, feed, 0.1)
        assert caught.value.diagnostic.code == code


def test_the_speed_of_a_jog_keeps_the_limits_of_every_axis():
    direction = {"x": 0.6, "z": 0.8}
    speed = jogging.jog_speed(MACHINE, direction, 10.0)
    assert speed == pytest.approx(min(100 / 0.6, 50 / 0.8, MACHINE.path.max_feed))
