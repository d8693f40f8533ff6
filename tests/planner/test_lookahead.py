"""Plans of whole paths: legal, continuous, streamed, and with stops only where they are needed."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.machine.models import Axis, Machine
from cnc.model.blocks import Block, Dwell, PathMode
from cnc.model.diagnostics import MotionLimitError
from cnc.model.operator_control import Control
from cnc.path.build import build
from cnc.planner.limits import Limits
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from tests.support.planner.motions import (
    arc,
    lines,
    machine,
    nurbs,
    path_of,
    random_blocks,
    sampled,
)
from tests.support.soak import share

TRIDENT = [(10, 0, 0), (20, 20, 0), (12, 8, 0), (10, 20, 0), (8, 8, 0), (0, 20, 0), (10, 0, 0)]


def planned(blocks, mill=None):
    ahead = LookAhead(mill or machine())
    items = list(ahead.plan(path_of(blocks)))
    return [item for item in items if isinstance(item, PlanChunk)], items, ahead.audit


def speeds_at(chunks, s):
    """Speed where the path length is ``s``."""
    for chunk in chunks:
        local = s - chunk.s0
        if chunk.phase_s[0] - 1e-9 <= local <= chunk.phase_s[-1] + 1e-9:
            t = np.linspace(0, 1, 2001)
            for k in range(len(chunk.phase_j)):
                if chunk.phase_s[k] - 1e-9 <= local <= chunk.phase_s[k + 1] + 1e-9:
                    dt = t * (chunk.phase_t[k + 1] - chunk.phase_t[k])
                    here = chunk.phase_s[k] + dt * (
                        chunk.phase_v[k] + dt * (chunk.phase_a[k] / 2 + dt * chunk.phase_j[k] / 6)
                    )
                    v = chunk.phase_v[k] + dt * (chunk.phase_a[k] + dt * chunk.phase_j[k] / 2)
                    return float(v[np.argmin(np.abs(here - local))])
    raise AssertionError(f"no plan at {s}")


def assert_joined(chunks):
    """Chunks follow each other in time, place, speed and acceleration."""
    at_rest = (0.0, 0.0)
    clock, travelled = None, 0.0
    for chunk in chunks:
        assert (chunk.phase_v[0], chunk.phase_a[0]) == pytest.approx(at_rest, abs=1e-6)
        assert clock is None or chunk.t0 >= clock - 1e-9
        assert chunk.s0 + chunk.phase_s[0] == pytest.approx(travelled, abs=1e-9)
        at_rest = (chunk.phase_v[-1], chunk.phase_a[-1])
        clock, travelled = chunk.t0 + chunk.duration, chunk.s0 + chunk.phase_s[-1]
    assert at_rest == pytest.approx((0.0, 0.0), abs=1e-9)


@settings(max_examples=share(500, 2))
@given(seed=st.integers(0, 2**31))
def test_random_paths_are_legal_by_differences_of_positions(seed):
    rng = np.random.default_rng(seed)
    mill = machine(
        axis=(10 ** rng.uniform(1.5, 4.5), 10 ** rng.uniform(3, 7)) if rng.random() < 0.6 else None,
        tangential=10 ** rng.uniform(1.5, 4.5),
        normal=10 ** rng.uniform(1.5, 4.5),
        jerk=10 ** rng.uniform(3, 7),
        period=float(rng.choice((0.001, 0.0001, 0.002))),
        velocity=10 ** rng.uniform(1, 3),
        deviation=rng.choice((None, 1e-3)),
    )
    period = mill.path.period
    chunks, _, audit = planned(random_blocks(rng, 5), mill)
    assert_joined(chunks)
    assert not audit.violations
    if not chunks:
        return
    assert chunks[-1].s0 + chunks[-1].piece_s[-1] == pytest.approx(sum_of_lengths(chunks), rel=1e-9)
    points = sampled(chunks, period)
    limits = Limits.of(mill)
    # Rounding and the accuracy of the arc length (1e-9 mm) show in differences; 0.1 % is what
    # legality allows.
    for order, bound in (
        (1, limits.axis_velocity),
        (2, limits.axis_acceleration),
        (3, limits.axis_jerk),
    ):
        seen = np.abs(np.diff(points, order, axis=0)).max(axis=0, initial=0.0) / period**order
        assert (seen <= bound * 1.001 + 2**order * 2e-9 / period**order).all(), (order, seen, bound)


def sum_of_lengths(chunks):
    return chunks[-1].s0 + float(chunks[-1].piece_s[-1])


def sum_of_durations(chunks):
    return sum(chunk.duration for chunk in chunks)


def test_trident_at_the_limits_of_the_paper():
    way_there, path = [lines([(10, 0, 0)])], nurbs(TRIDENT, feed=300.0)
    chunks, _, audit = planned([*way_there, path], machine(velocity=300.0))
    assert audit.feed <= 300.0
    assert audit.accel <= 2400.0
    assert audit.jerk <= 48000.0
    assert audit.normal_accel <= 4903.3
    assert audit.chord_error <= 1e-3
    # Where the normal acceleration binds, the chord of a period is off by aN T^2 / 8.
    assert audit.chord_error == pytest.approx(4903.3e-6 / 8, rel=0.01)
    # The best legal motion known takes 0.7090 s.
    assert sum_of_durations(chunks) - sum_of_durations(planned(way_there)[0]) <= 0.723
    _, _, audit = planned([*way_there, path], machine(velocity=300.0, deviation=1e-3))
    assert audit.step_deviation == pytest.approx(1e-3, rel=0.02)
    assert audit.step_deviation <= 1e-3


def test_tangent_chains_do_not_stop():
    blocks = [lines([(20, 0, 0)]), arc((20, 0, 0), (20, 10), 0.25), lines([(30, 30, 0)])]
    chunks, _, _ = planned(blocks)
    corner = 20 + 2 * math.pi * 10 / 4
    assert speeds_at(chunks, 20.0) == pytest.approx(100.0, rel=1e-6)
    assert speeds_at(chunks, corner) == pytest.approx(100.0, rel=1e-6)


def test_a_jump_of_curvature_keeps_the_jerk_limit_of_the_axes():
    mill = machine(axis=(2400.0, 48000.0))
    blocks = [lines([(20, 0, 0)]), arc((20, 0, 0), (20, 10), 0.25), lines([(30, 30, 0)])]
    chunks, _, _ = planned(blocks, mill)
    assert 20.0 < speeds_at(chunks, 20.0) < 100.0
    third = np.abs(np.diff(sampled(chunks, 0.001), 3, axis=0)).max() / 1e-9
    assert 0.9 * 48000 < third <= 48000 * 1.001


def test_corners_stop_and_nearly_straight_joints_do_not():
    chunks, _, _ = planned([lines([(20, 0, 0), (20, 20, 0)])])
    assert speeds_at(chunks, 20.0) == pytest.approx(0.0, abs=1e-6)
    chunks, _, _ = planned([lines([(20, 0, 0), (40, 1e-4, 0)])])
    assert speeds_at(chunks, 20.0) > 50.0


def test_exact_stop_stops_at_every_end():
    blocks = [PathMode("t.nc", 1, "exact-stop"), lines([(20, 0, 0), (40, 0, 0)])]
    chunks, _, _ = planned(blocks)
    assert speeds_at(chunks, 20.0) == pytest.approx(0.0, abs=1e-6)
    one, _, _ = planned([lines([(20, 0, 0)])])
    assert sum(c.duration for c in chunks) == pytest.approx(
        2 * sum(c.duration for c in one), rel=1e-9
    )


def test_other_blocks_keep_their_order_and_the_motion_rests_before_them():
    dwell = Dwell("t.nc", 2, 0.5)
    _, items, _ = planned([lines([(10, 0, 0)]), dwell, lines([(20, 0, 0)], first=3)])
    where = items.index(dwell)
    before = [item for item in items[:where] if isinstance(item, PlanChunk)]
    after = [item for item in items[where:] if isinstance(item, PlanChunk)]
    assert before[-1].phase_v[-1] == 0.0
    assert after[0].t0 == pytest.approx(before[-1].t0 + before[-1].duration + 0.5, rel=1e-12)


def test_a_path_to_rest_is_planned_before_more_is_read():
    mill, read = machine(), []

    def stream():
        for number in range(3):
            read.append(number)
            yield from build(
                [lines([[20.0 * (number + 1), 0, 0]])],
                axes=("x", "y", "z"),
                start=np.array([20.0 * number, 0, 0]),
            )

    made = LookAhead(mill).plan(stream())
    for number in range(3):
        chunk = next(made)
        assert isinstance(chunk, PlanChunk)
        while chunk.phase_v[-1] > 0:
            chunk = next(made)
        assert read == list(range(number + 1))


def test_a_move_cut_into_pieces_takes_the_same_time():
    whole = sum(c.duration for c in planned([lines([(100, 0, 0)], 50.0)])[0])
    for pieces in (20, 100, 667, 2000, 10000):
        points = np.zeros((pieces, 3))
        points[:, 0] = np.linspace(0, 100, pieces + 1)[1:]
        cut = sum(c.duration for c in planned([lines(points, 50.0)])[0])
        assert cut == pytest.approx(whole, rel=0.005)


def test_the_window_streams():
    """The first plan comes long before the last of the path is read, and nothing is lost by
    planning in windows.
    """
    taken = 0

    def path():
        nonlocal taken
        for k in range(200):
            taken += 1
            turn = 0.2 * np.sin(np.linspace(k, k + 1, 200))
            yield lines(
                np.cumsum(np.stack((np.cos(turn), np.sin(turn), 0 * turn), axis=1) * 0.1, axis=0)
                + [20.0 * k, 0, 0],
                80.0,
                200 * k + 1,
            )

    ahead = LookAhead(machine())
    first_at = None
    chunks = []
    for item in ahead.plan(path_of(path())):
        first_at = taken if first_at is None else first_at
        chunks.append(item)
    assert first_at < 100
    assert_joined(chunks)


@pytest.mark.parametrize("count", share([12_000, 16_000, 20_000], [16_000]))
def test_a_path_longer_than_the_window_is_planned_to_its_end(count):
    angle = np.linspace(0, 200, count)
    points = np.stack((angle * np.cos(angle), angle * np.sin(angle), 0 * angle), axis=1)
    chunks, _, _ = planned([lines(points, 100.0)])
    assert_joined(chunks)
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    assert sum_of_lengths(chunks) == pytest.approx(length, rel=1e-9)


def test_the_machine_rests_in_a_short_dwell():
    # Less than a period and not on the grid of instants: differences of positions must not take it
    # for motion.
    mill = machine(axis=(2000.0, 2000.0), period=0.002)
    for dwell in (0.0003, 0.0009, 0.0021, 0.0049, 0.02):
        _, _, audit = planned(
            [lines([(1, 0, 0)]), Dwell("t.nc", 2, dwell), lines([(0, 0, 0)], first=3)], mill
        )
        assert audit.axis_jerk[0] <= 2000.0


def test_a_peak_of_curvature_between_samples_is_found():
    # A nearly sharp bend in the middle of a long, otherwise straight span.
    for width in (1.0, 0.1, 0.01, 0.001):
        points = [
            (0, 0, 0),
            (10, 0, 0),
            (10 + width, width, 0),
            (10, 2 * width, 0),
            (0, 2 * width, 0),
        ]
        for degree in (2, 3, 4):
            _, _, audit = planned([nurbs(points, degree=degree, feed=100.0)], machine(normal=500.0))
            assert audit.normal_accel <= 500.0


def test_ramp_down_comes_to_rest_soon():
    mill = machine()
    blocks: list[Block] = [lines([(x, 0, 0) for x in np.linspace(1, 2000, 2000)], 200.0)]
    ahead = LookAhead(mill, Control())
    chunks = []
    for item in ahead.plan(path_of(blocks)):
        chunks.append(item)
        if chunks[-1].t0 > 0.3:
            break
    moving_at = chunks[-1].s0 + chunks[-1].phase_s[-1]
    assert chunks[-1].phase_v[-1] > 100
    chunks += list(ahead.ramp_down())
    assert_joined(chunks)
    v = 200.0
    assert (
        chunks[-1].s0 + chunks[-1].phase_s[-1] - moving_at
        <= 1.2 * (v / 2 * (v / 2400 + 2400 / 48000)) + v * 0.001
    )


def test_an_illegal_plan_is_not_sent_on():
    chunks, _, _ = planned([lines([(100, 0, 0)], 100.0)])
    chunk = chunks[0]
    faster = PlanChunk(
        chunk.path,
        chunk.piece_s,
        0.0,
        0.0,
        chunk.phase_t * 0.5,
        chunk.phase_s,
        chunk.phase_v * 2,
        chunk.phase_a * 4,
        chunk.phase_j * 8,
    )
    ahead = LookAhead(machine())
    with pytest.raises(MotionLimitError) as refusal:
        ahead.audit.check(faster)
    assert refusal.value.diagnostic.code == "plan-illegal"
    for word in ("feed", "accel", "jerk"):
        assert word in refusal.value.diagnostic.message


@pytest.mark.parametrize(
    "blocks",
    [
        pytest.param([lines([(10, 0, 0)], 1e-6)], id="a feed of 60 nm a minute"),
        pytest.param([lines([(10, 0, 0), (10, 10, 0)], 1e6)], id="a feed beyond every machine"),
        pytest.param([arc((0, 0, 0), (5e-4, 0), 1.0)], id="a circle of 1 um"),
        pytest.param([arc((0, 0, 0), (0, 5e5), 0.01)], id="a circle of 1 km"),
        pytest.param(
            [lines([(k * 1e-5, 0, 0) for k in range(1, 200)])], id="pieces far below a step"
        ),
        pytest.param(
            [lines([(k, (k % 2) * 1e-7, 0) for k in range(1, 50)])], id="a saw of rounding errors"
        ),
        pytest.param([lines([(5, 0, 0), (0, 0, 0), (5, 0, 0)])], id="there and back"),
        pytest.param([nurbs([(0, 0, 0), (10, 10, 0), (0, 10, 0), (10, 0, 0)])], id="a cusp"),
        pytest.param(
            [nurbs([(0, 0, 0), (0, 0, 0), (5, 5, 0), (9, 0, 0), (9, 0, 0)])], id="double end points"
        ),
        pytest.param(
            [nurbs([(0, 0, 0), (5, 5, 0), (5, 5, 0), (5, 5, 0), (9, 0, 0), (12, 3, 0)])],
            id="a corner made of three points",
        ),
    ][:: share(1, 2)],
)
@pytest.mark.parametrize("axis", [None, (2400.0, 48000.0), (5e3, 1e7)])
def test_hard_inputs_are_planned_legally(blocks, axis):
    chunks, _, audit = planned(blocks, machine(axis=axis))
    assert_joined(chunks)
    assert not audit.violations
    assert all(np.isfinite(chunk.phase_t).all() and chunk.duration > 0 for chunk in chunks)


def test_axes_may_differ_a_thousand_times():
    slow = Axis(steps_per_mm=100.0, max_velocity=0.5, max_acceleration=2.0, max_jerk=50.0)
    fast = Axis(steps_per_mm=100.0, max_velocity=500.0, max_acceleration=2000.0, max_jerk=50000.0)
    mill = Machine(axes={"x": fast, "y": fast, "z": slow})
    blocks = [
        lines([(50, 0, 0), (100, 0, 1), (50, 50, 1)], math.nan),
        arc((50, 50, 1), (40, 50), 1.0, rise=-1.0),
    ]
    chunks, _, audit = planned(blocks, mill)
    assert_joined(chunks)
    assert not audit.violations
    # Along X alone nothing slows the fast axis; where the slow one moves along, it is the one that
    # binds.
    assert audit.axis_velocity[0] > 250.0
    assert audit.axis_velocity[2] == pytest.approx(0.5, rel=0.01)
