"""The audit's maxima, compared with those of every point of every phase and every sample."""

import math

import numpy as np
import pytest

from cnc.machine.models import PathLimits
from cnc.model.blocks import PathMode
from cnc.path.build import build
from cnc.path.kernels.arclength import curve_inv_arclen
from cnc.path.kernels.curve import METRIC, METRICS, curve_eval, curve_eval_s, curve_range
from cnc.planner.audit import Audit
from cnc.planner.kernels.audit import TIMED_POINTS, derivative_bounds
from cnc.planner.kernels.audit_samples import span_point
from cnc.planner.kernels.timed import is_timed
from cnc.planner.limits import Limits
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from tests.support.planner.motions import arc, lines, machine, nurbs, path_of, random_blocks
from tests.support.soak import share


class Reference:
    """What the audit says, in plain numpy: largest values along the path (dict) and of the axes (3,
    n).
    """

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.along = dict.fromkeys(
            ("feed", "accel", "jerk", "normal_accel", "chord_error", "step_deviation"), 0.0
        )
        self.axes = np.zeros((3, len(limits.axis_velocity)))
        self.samples: list[tuple[float, np.ndarray, int, float, float]] = []
        self.index = 0
        self.jumps: list[int] = []

    def note(self, name: str, value: float) -> None:
        self.along[name] = max(self.along[name], abs(value))

    def phases(self, chunk: PlanChunk) -> None:
        path, n = chunk.path, len(chunk.path.axes)
        for k, j in enumerate(chunk.phase_j):
            dt = chunk.phase_t[k + 1] - chunk.phase_t[k]
            begins = int(np.searchsorted(chunk.piece_s[1:], chunk.phase_s[k] + 1e-9, side="left"))
            begins = min(begins, len(path) - 1)
            timed = is_timed(int(path.kind[begins]), path.data, int(path.at[begins]))
            points = max(
                TIMED_POINTS if timed else 8,
                int(min(dt / self.limits.period, (chunk.phase_s[k + 1] - chunk.phase_s[k]) / 1e-3)),
            )
            for m in range(points + 1):
                t = dt * m / points
                v = chunk.phase_v[k] + t * (chunk.phase_a[k] + t * j / 2)
                a = chunk.phase_a[k] + t * j
                s = chunk.phase_s[k] + t * (
                    chunk.phase_v[k] + t * (chunk.phase_a[k] / 2 + t * j / 6)
                )
                ahead = 1e-9 if m == 0 else -1e-9
                piece = min(
                    int(np.searchsorted(chunk.piece_s[1:], s + ahead, side="left")), len(path) - 1
                )
                at, kind = int(path.at[piece]), int(path.kind[piece])
                local = min(
                    max(s - chunk.piece_s[piece], 0.0),
                    chunk.piece_s[piece + 1] - chunk.piece_s[piece],
                )
                q = np.zeros((4, n))
                curve_eval_s(kind, path.data, at, curve_inv_arclen(kind, path.data, at, local), q)
                metric = path.data[at + METRIC : at + METRIC + int(path.data[at + METRICS])].astype(
                    int
                )
                velocity, acceleration = q[1] * v, q[2] * v * v + q[1] * a
                jerk = q[3] * v**3 + 3 * q[2] * v * a + q[1] * j
                speed, along, change, normal = v, a, j, v * v * float(np.linalg.norm(q[2, metric]))
                if is_timed(kind, path.data, at):
                    speed = float(np.linalg.norm(velocity[metric]))
                    tangent = velocity[metric] / speed if speed else np.zeros(len(metric))
                    along = (
                        float(acceleration[metric] @ tangent)
                        if speed
                        else float(np.linalg.norm(acceleration[metric]))
                    )
                    normal = (
                        math.sqrt(
                            max(
                                float(acceleration[metric] @ acceleration[metric]) - along * along,
                                0.0,
                            )
                        )
                        if speed
                        else 0.0
                    )
                    change = (normal**2 / speed + float(jerk[metric] @ tangent)) if speed else 0.0
                for name, value in (
                    ("feed", speed),
                    ("accel", along),
                    ("jerk", change),
                    ("normal_accel", normal),
                ):
                    self.note(name, value)
                self.axes = np.maximum(self.axes, np.abs([velocity, acceleration, jerk]))

    def sample(self, chunk: PlanChunk) -> None:
        """Positions at the period, with piece, s and whether the motion stopped since the one
        before.
        """
        path, period = chunk.path, self.limits.period
        standing = math.ceil(chunk.t0 / period) - 3
        if standing > self.index:
            self.index = standing
            self.samples = []
        before = None
        while self.index * period <= chunk.t0 + chunk.duration:
            t = max(self.index * period - chunk.t0, 0.0)
            phase = min(
                int(np.searchsorted(chunk.phase_t[1:], t, side="left")), len(chunk.phase_j) - 1
            )
            dt = t - chunk.phase_t[phase]
            s = chunk.phase_s[phase] + dt * (
                chunk.phase_v[phase]
                + dt * (chunk.phase_a[phase] / 2 + dt * chunk.phase_j[phase] / 6)
            )
            piece = min(int(np.searchsorted(chunk.piece_s[1:], s, side="left")), len(path) - 1)
            position = self.point(chunk, piece, s)
            self.samples = [*self.samples[-3:], position]
            for order in range(1, len(self.samples)):
                difference = np.diff(np.array(self.samples[-order - 1 :]), n=order, axis=0)[0]
                self.axes[order - 1] = np.maximum(
                    self.axes[order - 1], np.abs(difference) / period**order
                )
            if before is not None:
                stopped = (chunk.phase_v[before[2] + 1 : phase + 1] == 0.0).any()
                if not stopped and s - before[1] > self.limits.chord_error:
                    self.step(chunk, before, (position, s, phase, piece))
            before = position, s, phase, piece
            self.index += 1

    def point(self, chunk: PlanChunk, piece: int, s: float) -> np.ndarray:
        at, kind, data = int(chunk.path.at[piece]), int(chunk.path.kind[piece]), chunk.path.data
        q = np.zeros((4, len(chunk.path.axes)))
        local = min(
            max(s - chunk.piece_s[piece], 0.0), chunk.piece_s[piece + 1] - chunk.piece_s[piece]
        )
        curve_eval(kind, data, at, curve_inv_arclen(kind, data, at, local), q)
        return q[0]

    def step(self, chunk: PlanChunk, before: tuple, after: tuple) -> None:
        first, last = before[3], after[3]
        corners = [before[0]]
        middles = []
        for piece in range(first, last + 1):
            begin, end = (
                max(before[1], chunk.piece_s[piece]),
                min(after[1], chunk.piece_s[piece + 1]),
            )
            middles.append(self.point(chunk, piece, 0.5 * (begin + end)))
            corners.append(self.point(chunk, piece, end))
        length = float(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum())
        timed = any(
            is_timed(int(chunk.path.kind[k]), chunk.path.data, int(chunk.path.at[k]))
            for k in range(first, last + 1)
        )
        if not timed:
            self.note("step_deviation", (length - (after[1] - before[1])) / (after[1] - before[1]))
        chord = after[0] - before[0]
        unit = chord / (np.linalg.norm(chord) or 1.0)
        for p in middles + corners:
            across = (p - before[0]) - float((p - before[0]) @ unit) * unit
            self.note("chord_error", float(np.linalg.norm(across)))


PLANS = [
    ([lines([(100, 0, 0)], feed=200.0)], {}),
    (
        [
            lines(
                np.cumsum(
                    np.tile([(0.15, 0.01, 0.0), (0.15, -0.01, 0.02)], (share(60, 15), 1)), axis=0
                ),
                feed=25.0,
            )
        ],
        {},
    ),
    ([arc((0, 0, 0), (10, 0), 1.0, feed=300.0, rise=2.0)], {"axis": (1500.0, 40000.0)}),
    (
        [
            lines([(10, 0, 0)]),
            nurbs(
                [
                    (10, 0, 0),
                    (20, 20, 0),
                    (12, 8, 0),
                    (10, 20, 0),
                    (8, 8, 0),
                    (0, 20, 0),
                    (10, 0, 0),
                ],
                feed=300.0,
            ),
        ],
        {},
    ),
    (
        [nurbs([(0, 0, 0), (40, 1, 0), (80, -1, 3), (120, 0, 0), (160, 2, 0)], feed=50.0)],
        {"axis": (1000.0, 50000.0)},
    ),
    (
        [nurbs([(0, 0, 0), (40, 1, 0), (80, -1, 3), (120, 0, 0)], [1.0, 2.0, 0.5, 1.0], feed=50.0)],
        {},
    ),
    (
        [nurbs([(0, 0, 0), (4, 1, 0), (8, -1, 3), (12, 0, 0), (20, 3, 1)], degree=4, feed=80.0)],
        {"axis": (1000.0, 50000.0)},
    ),
    (
        [
            PathMode("t.nc", 1, "blend", 0.02),
            lines([(10, 0, 0), (10, 10, 0), (0, 10, 4)], feed=150.0),
        ],
        {"axis": (2400.0, 48000.0)},
    ),
    *(
        ([*random_blocks(np.random.default_rng(seed), share(4, 2))], {})
        for seed in range(share(30, 1))
    ),
]


@pytest.mark.parametrize(("blocks", "limits"), PLANS[:: share(1, 2)])
def test_maxima_equal_those_of_all_points(blocks, limits):
    mill = machine(**limits)
    ahead = LookAhead(mill)
    start = np.zeros(3) if not hasattr(blocks[0], "control_points") else blocks[0].control_points[0]
    chunks = [
        c
        for c in ahead.plan(build(blocks, axes=("x", "y", "z"), start=start))
        if isinstance(c, PlanChunk)
    ]
    reference, audit = Reference(ahead.limits), Audit(ahead.limits)
    if max(c.t0 + c.duration for c in chunks) > 20.0:
        pytest.skip("a crawl is not looked at in full")
    for chunk in chunks:
        reference.phases(chunk)
        reference.sample(chunk)
        audit.check(chunk)
    reach = max(float(np.abs(c.path.data).max()) for c in chunks)
    for name, value in reference.along.items():
        assert getattr(audit, name) == pytest.approx(value, rel=1e-9, abs=1e-12), name
    for order, found in enumerate((audit.axis_velocity, audit.axis_acceleration, audit.axis_jerk)):
        noise = 2.0**order * 4e-16 * max(reach, 1.0) * 8.0 / mill.path.period ** (order + 1)
        np.testing.assert_allclose(found, reference.axes[order], rtol=1e-9, atol=noise)


@pytest.mark.parametrize("seed", range(share(200, 11)))
def test_derivative_bounds_hold_everywhere(seed):
    """Random spans, bent much and little: no derivative by arc length, and no curvature, passes its
    bound.
    """
    rng = np.random.default_rng(seed)
    degree = int(rng.integers(3, 7))
    along = np.cumsum(rng.uniform(0.5, 1.5, degree + 3))
    points = np.stack(
        (along, *(10 ** rng.uniform(-3, 0.5) * rng.normal(size=(2, degree + 3)))), axis=1
    )
    if seed % 5 == 0:
        points = np.stack((along, 0.2 * along, np.zeros(degree + 3)), axis=1)
    seen = 0
    for path in path_of([lines(points[:1]), nurbs(points, degree=degree)]):
        for kind, at in zip(path.kind.tolist(), path.at.tolist(), strict=True):
            bounds = np.zeros((4, 3))
            derivative_bounds(kind, path.data, at, bounds)
            u0, u1 = curve_range(kind, path.data, at)
            q = np.zeros((4, 3))
            for u in np.linspace(u0, u1, 101):
                curve_eval_s(kind, path.data, at, float(u), q)
                found = np.abs(q[1:]).T
                assert (found - 1e-9 <= bounds[:3] * (1 + 1e-9)).all()
                assert np.linalg.norm(q[2]) <= bounds[3, 1] * (1 + 1e-9) + 1e-9
            seen += np.isfinite(bounds[:3]).all()
    assert seen


def test_derivative_bounds_are_sharp_on_straight_spans():
    """A span of a circle of radius 50 mm that turns by 2 degrees: the curvature's bound is a few
    percent above it.
    """
    turn = math.radians(2.0)
    k = 4.0 / 3.0 * math.tan(turn / 4.0)
    a, b = np.array([1.0, 0.0, 0.0]), np.array([math.cos(turn), math.sin(turn), 0.0])
    points = 50.0 * np.array(
        [a, a + k * np.array([0.0, 1.0, 0.0]), b - k * np.array([-b[1], b[0], 0.0]), b]
    )
    (path,) = list(build([nurbs(points)], axes=("x", "y", "z"), start=points[0]))
    bounds = np.zeros((4, 3))
    derivative_bounds(int(path.kind[0]), path.data, int(path.at[0]), bounds)
    assert 0.02 <= bounds[3, 1] <= 0.0205


def test_limits_that_a_machine_leaves_out_are_infinite():
    """A machine without limits along its path is not compared with them."""
    limits = Limits.of(
        machine(axis=(1000.0, 50000.0)).model_copy(update={"path": PathLimits(max_feed=50.0)})
    )
    audit = Audit(limits)
    assert math.isinf(audit.limits.tangential_acceleration)
    ahead = LookAhead(machine(axis=(1000.0, 50000.0)))
    for chunk in ahead.plan(path_of([lines([(5, 5, 0)], feed=50.0)])):
        audit.check(chunk)
    assert not audit.violations


@pytest.mark.parametrize("degree", range(1, 10))
def test_sampled_points_of_a_spline_are_those_of_the_curve(degree):
    rng = np.random.default_rng(degree)
    points = np.cumsum(rng.normal(0.0, 5.0, (degree + 4, 3)), axis=0)
    weights = rng.uniform(0.3, 3.0, len(points))
    spline = nurbs(points - points[0], weights=weights, degree=degree)
    (path,) = path_of([PathMode("", 1, "exact-path"), spline])
    exact, sampled, scratch = np.zeros((4, 3)), np.zeros((5, 3)), np.zeros(10)
    for kind, at in zip(path.kind, path.at, strict=True):
        for u in np.linspace(*curve_range(kind, path.data, at), 31):
            curve_eval(kind, path.data, at, u, exact)
            span_point(path.data, at, u, scratch, sampled)
            assert sampled[4] == pytest.approx(exact[0], abs=1e-12)
