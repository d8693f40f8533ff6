"""Shapers: what remains of a ringing, and how long they take."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.planner.shaper import NO_SHAPER, Mode, shortest_shaper
from tests.support.soak import share

modes = st.builds(Mode, st.floats(15.0, 80.0), st.floats(0.0, 0.1))
several = st.lists(modes, min_size=1, max_size=3).map(tuple)


def amplitude(times: np.ndarray, parts: np.ndarray, frequency: float, damping: float) -> float:
    """Return the amplitude after impulses at ``times``, by the motion of an oscillator.

    Its place after an impulse is exp(-d w t) sin(w_d t) / w_d, that of 1 alone has the amplitude 1.
    """
    w = 2.0 * np.pi * frequency
    damped = w * np.sqrt(1.0 - damping**2)
    place = slope = 0.0
    for time, part in zip(times[-1] - times, parts, strict=True):
        decay = part * np.exp(-damping * w * time)
        place += decay * np.sin(damped * time)
        slope += decay * (damped * np.cos(damped * time) - damping * w * np.sin(damped * time))
    # The amplitude of the decaying oscillation that has this place and speed.
    return float(np.hypot(place, (slope + damping * w * place) / damped))


@settings(deadline=None, max_examples=share(200, 5))
@given(several, st.floats(-0.2, 0.2))
def test_little_remains_of_each_mode(ringing: tuple[Mode, ...], off: float) -> None:
    """5 % within 10 % of the frequency, 10 % at 20 % off, and in between on a line."""
    shaper = shortest_shaper(ringing)
    allowed = max(0.05, 0.05 + 0.05 * (abs(off) - 0.1) / 0.1)
    for mode in ringing:
        left = amplitude(shaper.times, shaper.parts, mode.frequency * (1.0 + off), mode.damping)
        assert left <= 1.01 * allowed


@settings(deadline=None, max_examples=share(200, 5))
@given(several)
def test_a_shaper_keeps_the_limits_of_the_motion(ringing: tuple[Mode, ...]) -> None:
    """A mean of motions with positive weights has no larger speed, acceleration or jerk."""
    shaper = shortest_shaper(ringing)
    assert (shaper.parts > 0.0).all()
    assert abs(shaper.parts.sum() - 1.0) < 1e-12
    assert shaper.times[0] == 0.0
    assert (np.diff(shaper.times) > 0.0).all()


@settings(deadline=None, max_examples=share(200, 5))
@given(modes)
def test_one_mode_costs_less_than_a_period(mode: Mode) -> None:
    """The EI shaper with the same bound at the frequency takes a period (Singhose, 1994)."""
    periods = shortest_shaper((mode,)).length * mode.frequency
    assert 0.85 < periods < 0.96


@settings(deadline=None, max_examples=share(200, 5))
@given(modes, modes)
def test_two_modes_cost_less_than_one_after_the_other(a: Mode, b: Mode) -> None:
    alone = [shortest_shaper((mode,)).length for mode in (a, b)]
    together = shortest_shaper((a, b)).length
    assert 0.95 * max(alone) < together < 0.99 * sum(alone)


def test_without_modes_there_is_no_shaper() -> None:
    assert shortest_shaper(()) is NO_SHAPER
    assert NO_SHAPER.length == 0.0
