"""Hold, resume and override during motion: legal, on the path, prompt, at the requested feeds."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import Block, Held, Overrides, PathMode, SpindleSync
from cnc.model.diagnostics import UsageError
from cnc.model.operator_control import Control
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.planner.window import SLICE
from tests.support.planner.corners import assert_legal, distances
from tests.support.planner.motions import arc, lines, machine, path_of, random_blocks, sampled
from tests.support.planner.operated import (
    Plans,
    assert_legal_by_positions,
    assert_on_the_path,
    driven,
    random_machine,
    speeds,
)
from tests.support.soak import share


@settings(max_examples=share(500, 3))
@given(seed=st.integers(0, 2**31))
def test_random_schedules_on_random_paths_are_legal(seed):
    rng = np.random.default_rng(seed)
    mill, blocks = (
        random_machine(rng),
        [block for block in random_blocks(rng, 4) if type(block).__name__ != "Dwell"],
    )
    plain = [item for item in LookAhead(mill).plan(path_of(blocks)) if isinstance(item, PlanChunk)]
    if not plain:
        return
    whole = plain[-1].t0 + plain[-1].duration
    requests = sorted(
        (rng.uniform(0.0, 1.2 * whole), float(rng.choice((0, 0, 1, 10, 30, 70, 100, 150, 200))))
        for _ in range(6)
    )

    def operator(control: Control, chunks: Plans, held: bool) -> None:
        if held:
            assert chunks == [] or chunks[-1].phase_v[-1] == 0.0
            control.resume()
        while requests and chunks and chunks[-1].t0 + chunks[-1].duration >= requests[0][0]:
            percent = requests.pop(0)[1]
            control.hold() if percent == 0.0 else control.override(percent)

    chunks, _ = driven(blocks, mill, operator)
    assert_on_the_path(chunks)
    assert chunks[-1].s0 + chunks[-1].phase_s[-1] == pytest.approx(
        plain[-1].s0 + plain[-1].phase_s[-1], rel=1e-12
    )
    assert_legal_by_positions(chunks, mill)


FEED, A, J = 100.0, 2400.0, 48000.0


def ramp(v0: float, v1: float) -> tuple[float, float]:
    """Time and length of the fastest ramp between two speeds."""
    change = abs(v1 - v0)
    t = change / A + A / J if change * J >= A * A else 2 * math.sqrt(change / J)
    return t, t * (v0 + v1) / 2


@pytest.mark.parametrize(
    "blocks",
    [
        [lines([(400, 0, 0)], FEED)],
        [lines([(x, 0, 0) for x in np.linspace(0.15, 400, 2667)], FEED)],
    ],
)
@pytest.mark.parametrize("at", [0.02, 0.05, 0.1, 0.3, 2.0])
def test_a_hold_comes_to_rest_in_the_theoretical_time(blocks, at):
    asked = []

    def operator(control: Control, chunks: Plans, held: bool) -> None:
        if held:
            control.resume()
        elif not asked and chunks[-1].t0 + chunks[-1].duration >= at:
            asked.append(len(chunks))
            control.hold()

    chunks, holds = driven(blocks, machine(), operator)
    assert_on_the_path(chunks)
    assert len(holds) == 1
    last = chunks[asked[0] - 1]
    assert last.duration <= 1.5 * SLICE
    # Acceleration is let go of at full jerk, then the shortest ramp to rest follows.
    v, a = float(last.phase_v[-1]), float(last.phase_a[-1])
    rise, top = (a / J, v + a * a / (2 * J)) if a > 0 else (0.0, v)
    took, length = ramp(top, 0.0)
    ramp_s = sum(c.duration for c in chunks[asked[0] : holds[0]])
    covered = sum(float(c.phase_s[-1] - c.phase_s[0]) for c in chunks[asked[0] : holds[0]])
    assert ramp_s <= (took + rise) * 1.05 + 1e-4
    assert covered <= (length + rise * top) * 1.05 + 1e-3
    # From rest it goes on as from any start.
    rest_of_it = ramp(FEED, 0.0)
    left = 400.0 - (chunks[holds[0] - 1].s0 + float(chunks[holds[0] - 1].phase_s[-1]))
    assert sum(c.duration for c in chunks[holds[0] :]) == pytest.approx(
        2 * rest_of_it[0] + (left - 2 * rest_of_it[1]) / FEED, rel=1e-4
    )


@pytest.mark.parametrize("percent", [1.0, 25.0, 70.0, 100.0, 130.0, 200.0][:: share(1, 2)])
def test_an_override_from_the_start_is_another_feed(percent):
    control = Control(percent)
    blocks = [
        lines([(30, 0, 0)], FEED),
        arc((30, 0, 0), (30, 10), 0.75, FEED),
        lines([(60, 60, 0)], math.nan),
    ]
    slower = [
        lines([(30, 0, 0)], FEED * percent / 100),
        arc((30, 0, 0), (30, 10), 0.75, FEED * percent / 100),
        blocks[2],
    ]
    seen = [
        item
        for item in LookAhead(machine(), control).plan(path_of(blocks))
        if isinstance(item, PlanChunk)
    ]
    programmed = [
        item for item in LookAhead(machine()).plan(path_of(slower)) if isinstance(item, PlanChunk)
    ]
    assert seen[-1].t0 + seen[-1].duration == pytest.approx(
        programmed[-1].t0 + programmed[-1].duration, rel=1e-9
    )


@pytest.mark.parametrize(
    ("before", "after"),
    [(100, 50), (50, 100), (100, 1), (1, 200), (200, 100), (100, 99)][:: share(1, 2)],
)
def test_an_override_takes_effect_at_once(before, after):
    control, chunks, changed = Control(before), [], 0
    for item in LookAhead(machine(), control).plan(
        path_of([lines([(x, 0, 0) for x in range(1, 200)], FEED)])
    ):
        chunks.append(item)
        if not changed and item.s0 + item.phase_s[-1] >= 30.0:
            changed = len(chunks)
            control.override(after)
    assert_on_the_path(chunks)
    start = chunks[changed].t0
    reached = next(
        chunk.t0
        + chunk.phase_t[np.argmax(np.isclose(chunk.phase_v, FEED * after / 100, rtol=1e-6))]
        for chunk in chunks[changed:]
        if np.isclose(chunk.phase_v, FEED * after / 100, rtol=1e-6).any()
    )
    assert reached - start <= 1.05 * ramp(FEED * before / 100, FEED * after / 100)[0] + 1e-4
    assert max(
        float(chunk.phase_v.max()) for chunk in chunks if chunk.t0 > reached
    ) <= FEED * after / 100 * (1 + 1e-6)


def test_only_requested_feeds_occur():
    """Speeds lie below the programmed feed times the factor but while the motion is slowed, and
    then no higher than it was.
    """
    rng = np.random.default_rng(5)
    state = {"factor": 1.0, "highest": 0.0, "slowing": 0.0}
    longest = ramp(2 * FEED, 0.0)[0]

    def operator(control: Control, chunks: Plans, held: bool) -> None:
        chunk = chunks[-1]
        v = speeds(chunk)
        feed = FEED * state["factor"]
        if (v > feed * (1 + 1e-6)).any():
            assert v.max() <= state["highest"] * (1 + 1e-6)
            state["slowing"] += chunk.duration
            assert state["slowing"] <= longest + 2 * SLICE
        else:
            state["slowing"] = 0.0
        if rng.random() < 0.2:
            state["factor"] = float(rng.choice((0.05, 0.3, 0.7, 1.0, 1.5, 2.0)))
            # Letting go of the acceleration raises the speed a little.
            state["highest"] = float(chunk.phase_v[-1]) + max(
                float(chunk.phase_a[-1]), 0.0
            ) ** 2 / (2 * 0.99 * J)
            state["slowing"] = 0.0
            control.override(100 * state["factor"])

    chunks, _ = driven(
        [lines([(x, 0, 0) for x in np.arange(1, 4000) * 0.2], FEED)], machine(), operator
    )
    assert_on_the_path(chunks)
    assert max(float(chunk.phase_v.max()) for chunk in chunks) > 1.9 * FEED


def test_traverses_are_held_but_not_scaled():
    blocks = [lines([(200, 0, 0)], math.nan)]
    one = sum(c.duration for c in driven(blocks, machine(), lambda *_: None)[0])
    held_at = []

    def operator(control: Control, chunks: Plans, held: bool) -> None:
        control.override(10.0)
        if held:
            control.resume()
        elif not held_at and chunks[-1].t0 > 0.2:
            held_at.append(chunks[-1].s0 + chunks[-1].phase_s[-1])
            control.hold()

    chunks, holds = driven(blocks, machine(), operator)
    assert len(holds) == 1
    slow = sum(
        item.duration
        for item in LookAhead(machine(), Control(10.0)).plan(path_of(blocks))
        if isinstance(item, PlanChunk)
    )
    assert slow == pytest.approx(one, rel=1e-9)
    assert sum(c.duration for c in chunks) > one


def test_requests_that_the_program_does_not_allow_have_no_effect():
    """M49: no override. M53 P0: no hold. Neither while the motion follows the spindle."""
    plain = [lines([(100, 0, 0)], FEED)]
    seconds = sum(c.duration for c in driven(plain, machine(), lambda *_: None)[0])
    fixed = Overrides("t.nc", 1, feed=False, spindle=True, adaptive_feed=False, feed_stop=True)
    unstoppable = Overrides(
        "t.nc", 1, feed=True, spindle=True, adaptive_feed=False, feed_stop=False
    )

    def slower(control: Control, chunks: Plans, held: bool) -> None:
        control.override(10.0)

    def hold(control: Control, chunks: Plans, held: bool) -> None:
        control.resume() if held else control.hold()

    for first, operator, allowed in (
        (fixed, slower, False),
        (fixed, hold, True),
        (unstoppable, hold, False),
        (unstoppable, slower, True),
        (SpindleSync("t.nc", 1, 1.0), slower, False),
        (SpindleSync("t.nc", 1, 1.0), hold, False),
        (SpindleSync("t.nc", 1, 0.0), slower, True),
    ):
        chunks, holds = driven([first, *plain], machine(), operator)
        if not allowed:
            assert holds == []
            assert sum(c.duration for c in chunks) == pytest.approx(seconds, rel=1e-9)
        else:
            assert holds or sum(c.duration for c in chunks) > 2 * seconds


@pytest.mark.parametrize("seed", range(share(40, 1)))
def test_a_hold_near_a_corner_keeps_to_the_tolerance(seed):
    """It rests within the time that the corner ahead may take besides the shortest ramp, and the
    motion that goes on is within the tolerance and ends where the program does.
    """
    rng = np.random.default_rng(seed)
    accel, jerk, feed, eps = 400.0, 15000.0, 40.0, 0.01
    mill = machine(axis=(accel, jerk), tangential=None, normal=None, jerk=None, max_feed=feed)
    along = (
        np.eye(3)[rng.permutation(np.arange(7) % 3)]
        * rng.uniform(1.5, 8.0, (7, 1))
        * rng.choice((-1.0, 1.0), (7, 1))
    )
    corners = np.cumsum(along, axis=0)
    blocks: list[Block] = [PathMode("t.nc", 1, "blend", eps), lines(corners, feed)]
    whole = sum(c.duration for c in driven(blocks, mill, lambda *_: None)[0])
    # What is held back at a turn by 90 degrees, and in case of one by 5 degrees before it is known.
    sharp, straight = (
        3.1 * (24.0 * eps / (jerk * math.sin(math.radians(turn) / 2.0))) ** (1.0 / 3.0)
        for turn in (90.0, 5.0)
    )
    slowest_stop = feed / accel + 2.0 * accel / jerk
    for moment in rng.uniform(0.0, whole, share(20, 1)):
        control, requested, rested = Control(), math.inf, math.inf
        chunks: list[PlanChunk] = []
        for item in LookAhead(mill, control, slice_s=0.035).plan(path_of(blocks)):
            end = chunks[-1].t0 + chunks[-1].duration if chunks else 0.0
            if isinstance(item, Held):
                rested = min(rested, end)
                control.resume()
            elif isinstance(item, PlanChunk):
                chunks.append(item)
                end = item.t0 + item.duration
                if end > moment and requested == math.inf:
                    control.hold()
                    requested = end
        assert min(rested, end) - requested <= slowest_stop + sharp + straight + 0.035
        polygon = np.concatenate((np.zeros((1, 3)), corners))
        off, missed = distances(sampled(chunks, 1e-3), polygon)
        assert off.max() <= eps * (1 + 1e-6)
        assert missed.max() <= 1.1 * eps
        assert_legal(chunks, mill, (1e-3,))


def test_a_hold_before_the_first_move_delays_it():
    control = Control()
    control.hold()
    made = LookAhead(machine(), control).plan(path_of([lines([(10, 0, 0)])]))
    for _ in range(3):
        assert isinstance(next(made), Held)
    control.override(50.0)
    assert isinstance(next(made), Held)
    control.resume()
    chunks = list(made)
    assert max(
        float(chunk.phase_v.max()) for chunk in chunks if isinstance(chunk, PlanChunk)
    ) == pytest.approx(50.0, rel=1e-6)


@pytest.mark.parametrize("percent", [0.0, 0.99, 200.1, math.nan, math.inf, -100.0])
def test_overrides_out_of_range_are_refused(percent):
    with pytest.raises(UsageError) as refusal:
        Control().override(percent)
    assert refusal.value.diagnostic.code == "feed-override"


def test_a_hold_and_an_override_along_a_slow_axis():
    """The way to slow down is looked for as far as the slow axis needs it."""
    fast = Axis(steps_per_mm=100.0, max_velocity=400.0, max_acceleration=A, max_jerk=J)
    slow = fast.model_copy(update={"max_acceleration": A / 1000.0, "max_jerk": J / 1000.0})
    mill = Machine(axes={"x": fast, "y": fast, "z": slow}, path=PathLimits(max_feed=300.0))
    asked: list[float] = []

    def operator(control: Control, chunks: Plans, held: bool) -> None:
        end = chunks[-1].t0 + chunks[-1].duration
        if held:
            control.resume()
        elif not asked and end > 5.0:
            asked.append(end)
            control.override(10.0)
        elif len(asked) == 1 and end > 15.0:
            asked.append(end)
            control.hold()

    chunks, holds = driven([lines([(0, 0, 8)], 1.0)], mill, operator)
    assert_on_the_path(chunks)
    assert len(holds) == 1
    slowed = next(chunk.t0 for chunk in chunks if chunk.phase_v.max() <= 0.1 * (1 + 1e-6))
    # From 1 to 0.1 mm/s, then to rest: in slices, each a crawl's.
    assert slowed - asked[0] < 2.0 * math.sqrt(0.9 / (J / 1000.0)) * 1.1 + 2.0 * SLICE
    rested = chunks[holds[0] - 1].t0 + chunks[holds[0] - 1].duration
    assert rested - asked[1] < 2.0 * math.sqrt(0.1 / (J / 1000.0)) * 1.1 + 2.0 * SLICE
