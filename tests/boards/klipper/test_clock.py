"""Estimate of the board's clock from answers with random delays."""

from __future__ import annotations

import random

import pytest

from cnc.boards.klipper.connection import MAX_DRIFT, BoardClock
from tests.support.soak import share

WRAP = 2**32


def estimated(
    drift: float, delays: tuple[float, float], seed: int, frequency: float = 180e6
) -> tuple[BoardClock, float]:
    """Return a clock after 60 s, and its error then in s. The board's clock starts near a wrap."""
    draw = random.Random(seed)
    start = WRAP - 3 * int(frequency)

    def truth(now: float) -> int:
        return start + int(now * frequency * (1 + drift))

    clock, now = BoardClock(frequency), 100.0
    for k in range(240):
        there, back = (delays[0] + draw.expovariate(1.0) * delays[1] for _ in range(2))
        answer = truth(now + there)
        received = now + there + back
        if k == 0:
            clock.set(answer, now, received)
        else:
            clock.add(answer % WRAP, now, received)
        now += 0.25
    return clock, (clock.at(now) - truth(now)) / frequency


@pytest.mark.parametrize("seed", range(5)[:: share(1, 3)])
@pytest.mark.parametrize("drift", [-1e-4, 0.0, 5e-5, 3e-3])
def test_clock_follows_the_board(drift: float, seed: int) -> None:
    """Round trips of 2 ms and more, up to 20 ms: the clock is known within a millisecond."""
    clock, error = estimated(drift, (0.001, 0.002), seed)
    assert abs(error) < 1e-3
    assert clock.drift == pytest.approx(drift, abs=5e-5)
    assert clock.half_trip_s < 0.003


def test_drift_is_limited() -> None:
    clock, _ = estimated(0.2, (0.001, 0.0), 1)
    assert abs(clock.drift) <= MAX_DRIFT * 1.0001


@pytest.mark.parametrize("seed", range(5)[:: share(1, 3)])
@pytest.mark.parametrize("drift", [-0.095, 0.0, 0.095])
def test_drift_within_its_bound_is_believed(drift: float, seed: int) -> None:
    """No delay makes a clock look wrong, for it counts as what it is: an uncertain time."""
    clock, _ = estimated(drift, (0.001, 0.02), seed)
    assert clock.wrong == 0.0


def test_jump_of_a_time_makes_no_clock_wrong() -> None:
    """A virtual machine that was held up: 15 ms without a tick, which come later."""
    clock = BoardClock(1e6)
    clock.set(0, 0.0, 0.0)
    for k in range(1, 40):
        now = 0.25 * k
        held = 0.015 if k % 4 == 0 else 0.0
        clock.add(round(1e6 * (now - held)) % WRAP, now - 1e-4, now)
    assert clock.wrong == 0.0


def test_clock_that_stood_still_and_catches_up_is_not_wrong() -> None:
    """A simulator on a busy computer: 0.2 s without a tick, then twice as fast, again and again."""
    clock = BoardClock(1e6)
    clock.set(0, 0.0, 0.0)
    for k in range(1, 100):
        now = 0.05 * k
        whole, part = divmod(now, 1.0)
        ticked = whole + (part if part < 0.4 else max(0.4, min(2 * part - 0.8, part)))
        clock.add(round(1e6 * ticked) % WRAP, now - 1e-4, now)
        assert clock.wrong == 0.0


@pytest.mark.parametrize("drift", [-2 / 3, -0.15, 0.12, 0.5])
def test_wrong_rate_is_found(drift: float) -> None:
    clock, _ = estimated(drift, (0.001, 0.002), 3)
    assert clock.wrong == pytest.approx(180e6 * (1 + drift), rel=0.03)


def test_time_and_clock_are_inverse() -> None:
    clock, _ = estimated(1e-5, (0.001, 0.001), 2)
    assert clock.at(clock.time_of(10**11)) == 10**11


def test_lower_bits_give_the_nearest_clock() -> None:
    clock = BoardClock(1000.0)
    clock.set(5 * WRAP - 10, 0.0, 0.0)
    assert clock.extend(5, 0.0) == 5 * WRAP + 5
    assert clock.extend(WRAP - 20, 0.0) == 5 * WRAP - 20
