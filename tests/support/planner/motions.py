"""Random motions and machines, and sampled plans, for the planner's tests."""

import math

import numpy as np

from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import ArcFeed, Block, Dwell, NurbsFeed, PathMode, Polyline
from cnc.path.build import build
from cnc.path.kernels.arclength import curve_inv_arclen
from cnc.path.kernels.curve import curve_eval
from cnc.planner.plan import PlanChunk

AXES = ("x", "y", "z")


def machine(
    *,
    axis=None,
    tangential=2400.0,
    normal=4903.3,
    jerk=48000.0,
    period=0.001,
    velocity=400.0,
    max_feed=300.0,
    chord_error=0.001,
    deviation=None,
):
    """Return a three-axis machine.

    ``axis`` is (acceleration, jerk) of each axis, or None for limits along the path only.
    """
    a, j = axis if axis else (None, None)
    each = Axis(steps_per_mm=100.0, max_velocity=velocity, max_acceleration=a, max_jerk=j)
    return Machine(
        axes=dict.fromkeys(AXES, each),
        path=PathLimits(
            max_feed=max_feed,
            max_tangential_acceleration=tangential,
            max_normal_acceleration=normal,
            max_jerk=jerk,
            period=period,
            chord_error=chord_error,
            step_deviation=deviation,
        ),
    )


def lines(points, feed=100.0, first=1):
    points = np.atleast_2d(np.asarray(points, float))
    n = len(points)
    return Polyline(
        "t.nc", first, points, np.full(n, feed), np.arange(first, first + n, dtype=np.int32)
    )


def arc(start, center, turns, feed=100.0, rise=0.0, line=1):
    """Return an arc in the XY plane."""
    start, center = np.asarray(start, float), np.asarray(center, float)
    radius = math.dist(start[:2], center)
    angle = math.atan2(start[1] - center[1], start[0] - center[0]) + 2 * math.pi * turns
    end = np.array(
        [
            center[0] + radius * math.cos(angle),
            center[1] + radius * math.sin(angle),
            start[2] + rise,
        ]
    )
    if turns == round(turns):
        end[:2] = start[:2]
    return ArcFeed(
        "t.nc", line, "XY", (float(center[0]), float(center[1])), end, radius, turns, feed
    )


def nurbs(points, weights=None, degree=3, feed=100.0, line=1):
    """Return a clamped uniform NURBS."""
    points = np.asarray(points, float)
    n = len(points)
    inner = np.arange(1, n - degree) / (n - degree)
    knots = np.concatenate((np.zeros(degree + 1), inner, np.ones(degree + 1)))
    return NurbsFeed(
        "t.nc",
        line,
        degree,
        knots,
        points,
        np.ones(n) if weights is None else np.asarray(weights, float),
        feed,
    )


def random_blocks(rng: np.random.Generator, count: int = 8) -> list[Block]:
    """Return random moves of all kinds, dwells and changes of the path mode."""
    blocks: list[Block] = []
    here = np.zeros(3)
    size = 10 ** rng.uniform(-1, 1.3)
    for line in range(1, count + 1):
        feed = math.nan if rng.random() < 0.1 else 10 ** rng.uniform(0, 2.6)
        match rng.integers(6):
            case 0:
                points = here + np.cumsum(rng.normal(0, size, (int(rng.integers(1, 6)), 3)), axis=0)
                blocks.append(lines(points, feed, line))
                here = points[-1]
            case 1:
                # Nearly straight, with the small turns that CAM programs have by the thousand.
                turn = np.cumsum(rng.normal(0, 10 ** rng.uniform(-6, -1.5), 20))
                step = size * 0.1 * np.stack((np.cos(turn), np.sin(turn), np.zeros(20)), axis=1)
                points = here + np.cumsum(step, axis=0)
                blocks.append(lines(points, feed, line))
                here = points[-1]
            case 2:
                # A line, the arc tangent to it, and the line tangent to that.
                heading, radius = rng.uniform(0, 2 * math.pi), size * 10 ** rng.uniform(-1, 0.5)
                along = np.array([math.cos(heading), math.sin(heading), 0.0])
                left = np.array([-along[1], along[0], 0.0])
                sense, turns = rng.choice((-1, 1)), rng.uniform(0.05, 0.9)
                corner = here + size * along
                bow = arc(
                    corner,
                    (corner + sense * radius * left)[:2],
                    sense * turns,
                    feed if feed == feed else 100.0,
                    line=line,
                )
                out = heading + sense * turns * 2 * math.pi
                end = bow.end + size * np.array([math.cos(out), math.sin(out), 0.0])
                blocks += [lines(corner, feed, line), bow, lines(end, feed, line)]
                here = end
            case 3:
                center = here[:2] + rng.normal(0, size, 2)
                turns = rng.choice((-1, 1)) * (
                    rng.uniform(0.02, 1.0) if rng.random() < 0.8 else rng.integers(1, 4)
                )
                bow = arc(
                    here,
                    center,
                    float(turns),
                    feed if feed == feed else 50.0,
                    rise=rng.normal(0, size),
                    line=line,
                )
                blocks.append(bow)
                here = bow.end
            case 4:
                degree = int(rng.integers(2, 6))
                n = int(rng.integers(degree + 1, degree + 9))
                points = here + np.concatenate(
                    ([np.zeros(3)], np.cumsum(rng.normal(0, size, (n - 1, 3)), axis=0))
                )
                blocks.append(
                    nurbs(
                        points,
                        10 ** rng.uniform(-1, 1, n),
                        degree,
                        feed if feed == feed else 80.0,
                        line,
                    )
                )
                here = points[-1]
            case _:
                blocks.append(
                    Dwell("t.nc", line, rng.uniform(0, 0.02))
                    if rng.random() < 0.5
                    else PathMode("t.nc", line, str(rng.choice(("exact-stop", "exact-path"))))
                )
    return blocks


def path_of(blocks):
    return build(blocks, axes=AXES, start=np.zeros(3))


def sampled(chunks: list[PlanChunk], period: float):
    """Positions at multiples of the period, by evaluating phases and curves."""
    rows = []
    done = 0
    q = np.zeros((4, 3))
    for chunk in chunks:
        end, path = chunk.t0 + chunk.duration, chunk.path
        times = np.arange(done, int(end / period) + 2) * period
        times = times[times <= end]
        done += len(times)
        t = np.maximum(times - chunk.t0, 0.0)
        i = np.searchsorted(chunk.phase_t, t, side="right") - 1
        i = np.minimum(i, len(chunk.phase_j) - 1)
        dt = t - chunk.phase_t[i]
        s = chunk.phase_s[i] + dt * (
            chunk.phase_v[i] + dt * (chunk.phase_a[i] / 2 + dt * chunk.phase_j[i] / 6)
        )
        m = np.searchsorted(chunk.piece_s, s, side="right") - 1
        m = np.clip(m, 0, len(path) - 1)
        local = np.clip(s - chunk.piece_s[m], 0.0, path.length[m])
        pieces = path.kind[m].tolist(), path.at[m].tolist(), local.tolist()
        for kind, at, along in zip(*pieces, strict=True):
            curve_eval(kind, path.data, at, curve_inv_arclen(kind, path.data, at, along), q)
            rows.append(q[0].copy())
    return np.array(rows)
