"""Formulas of the kinematics: both directions, derivatives, and bounds on them."""

from __future__ import annotations

import itertools
import math

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.kinematics.interval import Interval, atan2, cosine
from cnc.kinematics.series import Series
from cnc.planner.joint_map import JointMap
from tests.support.kinematics import MIDDLE, TABLES, machine_of, misfit

ORDER = 8
NAMES = list(TABLES)


def joints_of(name: str) -> JointMap:
    found = JointMap.of(machine_of(name))
    assert found is not None
    return found


def tips(name: str, count: int, reach: float = 30.0) -> np.ndarray:
    """Return random tips (count, 3) about the middle of the reach."""
    away = np.random.default_rng().uniform(-1.0, 1.0, (count, 3)) * reach / math.sqrt(3.0)
    return np.array(MIDDLE[name]) + away


@pytest.mark.parametrize("name", NAMES)
def test_joints_fit_the_geometry_of_the_machine(name: str) -> None:
    tip = tips(name, 200)
    assert misfit(name, joints_of(name).inverse(tip), tip) < 1e-10


@pytest.mark.parametrize("name", NAMES)
def test_forward_is_the_inverse_of_inverse(name: str) -> None:
    joints, tip = joints_of(name), tips(name, 200)
    assert np.abs(joints.forward(joints.inverse(tip)) - tip).max() < 1e-9


@pytest.mark.parametrize(
    ("name", "tip"),
    [
        ("scara", (300.0, 0.0, 0.0)),
        ("scara", (5.0, 0.0, 0.0)),
        ("delta", (400.0, 0.0, 0.0)),
        ("rotary-delta", (0.0, 0.0, -500.0)),
    ],
)
def test_tips_out_of_reach_are_not_numbers(name: str, tip: tuple[float, float, float]) -> None:
    assert np.isnan(joints_of(name).inverse(np.array([tip]))).any()


def by_mpmath(name: str, at, k: int):
    """Return joint k on a path, as a function of the parameter with 40 digits."""
    table = TABLES[name]

    def joint(u):
        x, y, z = at(u)
        degrees = 180 / mpmath.pi
        if name == "corexy":
            return [x + y, x - y, z][k]
        if name == "corexz":
            return [x + z, x - z, y][k]
        if name == "polar":
            return [mpmath.hypot(x, y), mpmath.arg(mpmath.mpc(x, y)) * degrees, z][k]
        if name.startswith("scara"):
            first, second = table.arms
            far = mpmath.hypot(x, y)
            # the law of cosines at the elbow and at the shoulder
            inner = mpmath.acos((first**2 + second**2 - far**2) / (2 * first * second))
            lean = mpmath.acos((first**2 + far**2 - second**2) / (2 * first * far))
            side = 1 if table.elbow == "left" else -1
            shoulder = mpmath.arg(mpmath.mpc(x, y)) - side * lean
            return [shoulder * degrees, side * (mpmath.pi - inner) * degrees, z][k]
        angle = mpmath.radians([210, 330, 90][k])
        cos, sin = mpmath.cos(angle), mpmath.sin(angle)
        if name == "delta":
            square = (x - table.radius * cos) ** 2 + (y - table.radius * sin) ** 2
            return z + mpmath.sqrt(table.rod**2 - square)
        # the two circles in the plane of the arm: about its axis, and about the rod's end
        along = x * cos + y * sin + table.platform - table.base
        across = y * cos - x * sin
        far = mpmath.hypot(along, z)
        rod = table.rod**2 - across**2
        lean = mpmath.acos((table.arm**2 + far**2 - rod) / (2 * table.arm * far))
        return (mpmath.arg(mpmath.mpc(along, -z)) - lean) * degrees

    return joint


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_equal_those_of_high_precision(name: str) -> None:
    rng, joints = np.random.default_rng(), joints_of(name)
    place = tips(name, 1)[0]
    terms = rng.uniform(-1.0, 1.0, (4, 3)) * np.array([[0.0], [3.0], [0.5], [0.1]])
    terms[0] = place
    tip = [
        Series([np.array([value]) for value in (*terms[:, c], *[0.0] * (ORDER - 3))])
        for c in range(3)
    ]

    def at(u):
        return [sum(mpmath.mpf(terms[i, c]) * u**i for i in range(4)) for c in range(3)]

    with mpmath.workdps(40):
        for k, series in enumerate(joints.series(tip)):
            exact = mpmath.taylor(by_mpmath(name, at, k), 0, 4)
            for term, value in zip(series.terms, exact, strict=False):
                scale = max(1.0, abs(float(value)))
                assert abs(float(np.asarray(term)[0]) - float(value)) < 1e-9 * scale, (k, value)


@pytest.mark.parametrize("moving", list(itertools.product([False, True], repeat=3)))
@pytest.mark.parametrize("name", NAMES)
def test_bounds_hold_every_term_on_the_path(name: str, moving: tuple[bool, bool, bool]) -> None:
    rng, joints = np.random.default_rng(), joints_of(name)
    start, rate = tips(name, 1, 20.0)[0], np.where(moving, rng.uniform(-1.0, 1.0, 3), 0.0)
    width = 4.0
    ends = start + width * rate
    # A term that is 0 everywhere is the number 0, as in the series of a path.
    whole = [
        Series(
            [
                Interval(np.array([min(a, b)]), np.array([max(a, b)])),
                Interval(np.array([r]), np.array([r])) if r else 0.0,
                *[0.0] * (ORDER - 1),
            ]
        )
        for a, b, r in zip(start, ends, rate, strict=True)
    ]
    bounds = joints.series(whole)
    u = np.linspace(0.0, width, 33)
    places = [
        Series([a + r * u, np.full(33, r), *[np.zeros(33)] * (ORDER - 1)])
        for a, r in zip(start, rate, strict=True)
    ]
    for series, bound in zip(joints.series(places), bounds, strict=True):
        for term, limits in zip(series.terms, bound.terms, strict=True):
            slack = 1e-9 * (1.0 + np.abs(term).max())
            low = limits.lo if isinstance(limits, Interval) else limits
            high = limits.hi if isinstance(limits, Interval) else limits
            assert (np.asarray(term) >= low - slack).all()
            assert (np.asarray(term) <= high + slack).all()


FINITE = st.floats(-50.0, 50.0)


@given(a=FINITE, b=FINITE, c=FINITE, d=FINITE, p=st.floats(0, 1), q=st.floats(0, 1))
def test_intervals_hold_the_results_of_their_numbers(
    a: float, b: float, c: float, d: float, p: float, q: float
) -> None:
    first = Interval(np.array([min(a, b)]), np.array([max(a, b)]))
    second = Interval(np.array([min(c, d)]), np.array([max(c, d)]))
    x = float(np.clip(a + p * (b - a), min(a, b), max(a, b)))
    y = float(np.clip(c + q * (d - c), min(c, d), max(c, d)))
    results = [
        (first + second, x + y),
        (first - second, x - y),
        (first * second, x * y),
        (2.0 - first, 2.0 - x),
        (first.square(), x * x),
        (cosine(first), math.cos(x)),
        (atan2(first, second), math.atan2(x, y)),
    ]
    if abs(y) > 1e-9:
        results.append((first / second, x / y))
    if x >= 0.0:
        results.append((first.sqrt(), math.sqrt(x)))
    for found, value in results:
        slack = 1e-9 * (1.0 + abs(value))
        assert found.lo[0] - slack <= value <= found.hi[0] + slack


def test_undefined_operations_are_unbounded() -> None:
    one = Interval(np.array([1.0]), np.array([1.0]))
    across = Interval(np.array([-1.0]), np.array([2.0]))
    for found in (one / across, across.sqrt()):
        assert found.hi[0] == math.inf
        assert found.lo[0] == -math.inf
