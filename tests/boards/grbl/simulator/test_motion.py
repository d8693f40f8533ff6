"""The simulator's motion against theory: trapezoids, and corners by the junction deviation."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.simulators.grbl.planner import junction_speed_sq
from tests.support.boards.simulator_bench import HOMING, Bench
from tests.support.soak import share

FAST = {100 + axis: 1000.0 for axis in range(3)} | {
    110: 6000.0,
    111: 6000.0,
    112: 3000.0,
    120: 500.0,
    121: 500.0,
    122: 200.0,
}


def trapezoid(length: float, speed: float, acceleration: float) -> float:
    """Time from rest to rest, s: the ramps take v/a each, or the motion is a triangle."""
    if length < speed * speed / acceleration:
        return 2.0 * math.sqrt(length / acceleration)
    return length / speed + speed / acceleration


def duration(bench):
    return bench.simulator.moves[-1].end_time - bench.simulator.moves[0].begin_time


@given(
    length=st.floats(0.01, 150.0),
    feed=st.floats(10.0, 6000.0),
    acceleration=st.floats(10.0, 3000.0),
)
@settings(max_examples=40)
def test_one_line_takes_the_time_of_its_trapezoid(length, feed, acceleration):
    bench = Bench(settings=FAST | {120: acceleration})
    bench.send(f"G1X{length:.4f}F{feed:.2f}\n")
    bench.finish()
    way = round(length, 4)
    way = math.floor(way * 1000 + 0.5) / 1000
    if way:
        assert duration(bench) == pytest.approx(
            trapezoid(way, round(feed, 2) / 60.0, acceleration), rel=1e-9
        )
        assert bench.simulator.position == (way, 0.0, 0.0)


@pytest.mark.parametrize(
    ("line", "length", "speed", "acceleration"),
    [
        ("G0X60", 60.0, 100.0, 500.0),
        ("G0Z60", 60.0, 50.0, 200.0),
        ("G0X60Z60", math.hypot(60, 60), math.sqrt(2) * 50.0, math.sqrt(2) * 200.0),
        ("G0X80Y60", 100.0, 125.0, 625.0),
        ("G1X80Y60F60000", 100.0, 125.0, 625.0),
        ("G93G1X30F10", 30.0, 5.0, 500.0),
    ],
)
def test_the_slowest_axis_sets_speed_and_acceleration(line, length, speed, acceleration):
    bench = Bench(settings=FAST)
    bench.send(line + "\n")
    bench.finish()
    assert duration(bench) == pytest.approx(trapezoid(length, speed, acceleration), rel=1e-9)


@pytest.mark.parametrize("turn", [10.0, 30.0, 60.0, 90.0, 120.0, 170.0])
@pytest.mark.parametrize("deviation", [0.01, 0.05])
def test_a_corner_is_passed_at_the_speed_of_its_circle(turn, deviation):
    """v^2 = a R with R = d sin(b) / (1 - sin(b)), b half the angle between the two lines."""
    half = math.radians(180.0 - turn) / 2.0
    radius = deviation * math.sin(half) / (1.0 - math.sin(half))
    change = np.array([math.cos(math.radians(turn)) - 1.0, math.sin(math.radians(turn))])
    acceleration = 500.0 / max(abs(change / np.hypot(*change)))
    before, after = (
        (1.0, 0.0, 0.0),
        (math.cos(math.radians(turn)), math.sin(math.radians(turn)), 0.0),
    )
    assert junction_speed_sq(before, after, (500.0, 500.0, 200.0), deviation) == pytest.approx(
        acceleration * radius
    )
    bench = Bench(settings=FAST | {11: deviation})
    bench.send(f"G1X40F3000\nG91X{40 * after[0]:.6f}Y{40 * after[1]:.6f}\n")
    bench.finish()
    first, second = bench.simulator.moves
    assert second.phases[0].v == pytest.approx(
        min(math.sqrt(acceleration * radius), 50.0), rel=1e-3
    )
    last = first.phases[-1]
    assert last.at(last.time + last.duration)[1] == pytest.approx(second.phases[0].v, rel=1e-6)


def test_a_straight_run_in_pieces_is_one_trapezoid():
    whole, cut = Bench(settings=FAST), Bench(settings=FAST)
    whole.send("G1X60F3000\n")
    cut.send("".join(f"G1X{x}F3000\n" for x in range(5, 65, 5)))
    for bench in (whole, cut):
        bench.finish()
    assert duration(cut) == pytest.approx(duration(whole), rel=1e-6)


@pytest.mark.parametrize(
    ("line", "center", "radius"),
    [
        ("G2X10Y0I5J0", (5.0, 0.0), 5.0),
        ("G3X10Y0I5J0", (5.0, 0.0), 5.0),
        ("G2X0Y0I-7J3", (-7.0, 3.0), math.hypot(7, 3)),
        ("G3X10Y10R10", (0.0, 10.0), 10.0),
        ("G2X10Y10R10", (10.0, 0.0), 10.0),
        ("G3X10Y10R-10", (10.0, 0.0), 10.0),
    ],
)
def test_arcs_stay_within_their_tolerance(line, center, radius):
    bench = Bench(settings=FAST)
    bench.send(line + "F3000\n", 5.0)
    bench.finish()
    points = np.array(
        [
            move.point(share * move.length)[:2]
            for move in bench.simulator.moves
            for share in np.linspace(0, 1, 9)
        ]
    )
    off = np.hypot(*(points - center).T) - radius
    assert np.abs(off).max() <= 0.002 + 0.001
    angle = np.unwrap(np.arctan2(points[:, 1] - center[1], points[:, 0] - center[0]))
    turn = angle[-1] - angle[0]
    assert (turn < 0) == line.startswith("G2")
    expected = {
        "G2X0": 2 * math.pi,
        "G2X10Y0": math.pi,
        "G3X10Y0": math.pi,
        "G3X10Y10R-": 1.5 * math.pi,
    }
    assert abs(turn) == pytest.approx(
        next((v for k, v in expected.items() if line.startswith(k)), math.pi / 2), abs=0.01
    )


def test_the_sixteenth_ok_waits_for_planner_space():
    bench = Bench(settings=FAST | {10: 3})
    bench.send("".join(f"G1X{10 * (n % 2)}F1000\n" for n in range(1, 6)), 0.3)
    assert bench.status()["Bf"] == "10,128"
    heard = bench.send("".join(f"G1X{10 * (n % 2)}F1000\n" for n in range(6, 14)), 0.1)
    heard += bench.send("".join(f"G1X{10 * (n % 2)}F1000\n" for n in range(14, 20)), 0.1)
    assert bench.status()["Bf"].startswith("0,")
    assert heard.count("ok") < 14
    bench.finish()
    assert bench.status()["Bf"] == "15,128"
    assert len(bench.simulator.moves) == 19


def test_speed_never_jumps_and_position_follows_it():
    """Every phase begins with the time, position and speed at which the phase before ended."""
    bench = Bench(settings=FAST)
    bench.send("G1X20F3000\nY15\nG2X0Y15I-10J4\nG1X-5\n", 0.4)
    bench.send(b"\x91\x91!", 0.3)
    bench.send(b"~\x96", 0.2)
    bench.send(b"\x92\x92\x92\x92", 0.1)
    bench.send("G0X0Y0\n")
    bench.finish()
    for move in bench.simulator.moves:
        s = move.phases[0].s
        assert s == 0.0
        for phase in move.phases:
            assert phase.s == pytest.approx(s, abs=1e-9)
            s = phase.at(phase.time + phase.duration)[0]
            assert abs(phase.a) <= move.acceleration * (1 + 1e-9)
        assert s == pytest.approx(move.length, abs=1e-9)
    phases = [phase for move in bench.simulator.moves for phase in move.phases]
    for one, other in itertools.pairwise(phases):
        assert other.time >= one.time + one.duration - 1e-9
        assert other.v == pytest.approx(one.at(one.time + one.duration)[1], abs=1e-6)


CORNERS = st.lists(
    st.tuples(*[st.floats(-20.0, 20.0)] * 3, st.floats(100.0, 6000.0)), min_size=2, max_size=25
)
NUDGES = st.lists(
    st.sampled_from([b"\x91", b"\x92", b"\x96", b"\x95", b"!", b"~", b""]), min_size=6, max_size=6
)


@given(CORNERS, NUDGES)
@settings(max_examples=share(400, 7))
def test_no_run_of_lines_breaks_a_limit(corners, nudges):
    """Limits of axes and corners hold under all overrides and holds."""
    bench = Bench(settings=FAST)
    budget = "".join(
        f"G1X{x:.3f}Y{y:.3f}Z{z:.3f}F{feed:.0f}\n" for x, y, z, feed in corners
    ).encode()
    for nudge in nudges:
        bench.port.write(budget[:100] + nudge)
        budget = budget[100:]
        bench.hear(0.4)
    while budget or bench.simulator.core.planner.blocks or bench.simulator.core.receiver.ring:
        bench.port.write(b"~" + budget[:100])
        budget = budget[100:]
        bench.hear(3.0)
    rates, accelerations = (6000.0 / 60, 6000.0 / 60, 3000.0 / 60), (500.0, 500.0, 200.0)
    moves = bench.simulator.moves
    for before, move in itertools.pairwise(moves):
        assert move.start == before.end
        limit = junction_speed_sq(before.unit, move.unit, accelerations, 0.01)
        assert move.phases[0].v ** 2 <= limit * (1 + 1e-9) + 1e-9
    for move in moves:
        for phase in move.phases:
            fastest = max(phase.v, phase.at(phase.time + phase.duration)[1])
            for part, rate, acceleration in zip(move.unit, rates, accelerations, strict=True):
                assert abs(part) * fastest <= rate * (1 + 1e-9)
                # Of a phase shorter than 1 ns nothing but rounding is left.
                assert phase.duration < 1e-9 or abs(part * phase.a) <= acceleration * (1 + 1e-6)
    if moves:
        last = moves[-1].phases[-1]
        assert last.at(last.time + last.duration)[1] <= 1e-4
        assert bench.simulator.position == moves[-1].end


def time_by_small_steps(moves, accelerations, deviation, pieces=400):
    """Return the time of a known run by another method: v^2 on a fine grid, limited backwards
    and forwards.
    """
    most, reach, ways = [], [], []
    for number, move in enumerate(moves):
        corner = (
            junction_speed_sq(moves[number - 1].unit, move.unit, accelerations, deviation)
            if number
            else 0.0
        )
        most += [min(corner, move.programmed**2, moves[number - 1].programmed ** 2)] + [
            move.programmed**2
        ] * (pieces - 1)
        reach += [2.0 * move.acceleration * move.length / pieces] * pieces
        ways += [move.length / pieces] * pieces
    speeds = np.array([*most, 0.0])
    for node in range(len(reach) - 1, -1, -1):
        speeds[node] = min(speeds[node], speeds[node + 1] + reach[node])
    for node, most_gain in enumerate(reach):
        speeds[node + 1] = min(speeds[node + 1], speeds[node] + most_gain)
    roots = np.sqrt(speeds)
    return float(np.sum(2.0 * np.array(ways) / (roots[:-1] + roots[1:])))


@given(
    st.lists(
        st.tuples(*[st.floats(-30.0, 30.0)] * 2, st.floats(300.0, 5000.0)), min_size=2, max_size=6
    )
)
@settings(max_examples=share(200, 6))
def test_a_run_that_fits_the_planner_is_time_optimal(corners):
    bench = Bench(settings=FAST | {120: 50.0, 121: 50.0})
    bench.send("".join(f"G1X{x:.2f}Y{y:.2f}F{feed:.0f}\n" for x, y, feed in corners))
    bench.finish()
    moves = bench.simulator.moves
    # Lines come faster than the first of them can be braked for, if it is long enough.
    if moves and min(move.length for move in moves) > 1.0:
        assert duration(bench) == pytest.approx(
            time_by_small_steps(moves, (50.0, 50.0, 200.0), 0.01), rel=2e-3
        )


def test_holds_and_switches_stop_the_machine_after_days_of_uptime():
    """A clock of 10 days has a resolution of 1e-10 s, in which a fast axis moves 1e-8 mm."""
    bench = Bench(settings=HOMING)
    bench.simulator.advance(864_000.7)
    bench.hear(0.1)
    assert bench.reply("$H", 120.0) == "ok"
    assert bench.simulator.position == pytest.approx((-1.0, -1.0, -1.0), abs=0.01)
    for number in range(20):
        bench.send(f"G1 X{-100 + 60 * (number % 2)} F4000\n", 0.2 + 0.013 * number)
        bench.send("!", 1.0)
        assert bench.status()["state"] == "Hold:0"
        assert -99.9 < bench.simulator.position[0] < -1.1
        bench.send("~", 5.0)
        assert bench.status()["state"] == "Idle"
