"""Compensated errors: formulas of leaning axes and of screws, against others' and back again."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from cnc.kinematics.compensation import Compensation, Screw, leaning_axes
from tests.support.faulty_machine import FaultyMachine
from tests.support.soak import share


def rng() -> np.random.Generator:
    """Return random numbers: the same in every run, new ones under soak."""
    return np.random.default_rng(share(None, 1))


def some_screw(dice: np.random.Generator) -> tuple[Screw, CubicSpline]:
    """Return a screw and its correction by scipy."""
    places = np.cumsum(dice.uniform(2.0, 30.0, int(dice.integers(3, 30)))) - 100.0
    errors = np.cumsum(dice.normal(0.0, 0.02, len(places)))
    return Screw(places.tolist(), errors.tolist(), [0.0] * len(places)), CubicSpline(
        places, errors, bc_type="natural"
    )


def test_the_correction_is_the_natural_spline() -> None:
    dice = rng()
    for _ in range(50):
        screw, spline = some_screw(dice)
        places = dice.uniform(screw.knots[0], screw.knots[-1], 200)
        assert np.abs(screw.correction(places) - spline(places)).max() < 1e-12
        for end, way in ((screw.knots[0], -7.0), (screw.knots[-1], 7.0)):
            beyond = screw.correction(np.array([end + way]))[0]
            assert beyond == pytest.approx(spline(end) + way * spline(end, 1), abs=1e-12)


def test_the_steepest_slope_is_that_of_the_spline() -> None:
    dice = rng()
    for _ in range(50):
        screw, spline = some_screw(dice)
        places = np.linspace(screw.knots[0], screw.knots[-1], 20_001)
        assert screw.steepest()[0] == pytest.approx(np.abs(spline(places, 1)).max(), rel=1e-4)


def test_axes_lean_by_their_angles() -> None:
    xy, xz, yz = (math.radians(angle) for angle in (0.4, -0.3, 0.2))
    x, y, z = leaning_axes(xy, xz, yz).T
    for first, second, lean in ((x, y, xy), (x, z, xz), (y, z, yz)):
        assert math.acos(first @ second) == pytest.approx(math.pi / 2 + lean, abs=1e-12)
    assert [float(v @ v) for v in (x, y, z)] == pytest.approx([1.0, 1.0, 1.0], abs=1e-15)
    assert x.tolist() == [1.0, 0.0, 0.0]
    assert y[2] == 0.0
    assert y[0] < 0.0, "above 90 degrees, Y leads the tool towards -X"


def test_the_motors_lead_the_tip_to_its_place_and_back() -> None:
    dice = rng()
    for _ in range(30):
        angles = dice.uniform(-0.5, 0.5, 3)
        screws = {0: some_screw(dice)[0], 2: some_screw(dice)[0]}
        compensation = Compensation(leaning_axes(*np.radians(angles).tolist()), screws)
        tips = dice.uniform(-90.0, 300.0, (100, 3))
        motors = compensation.motors_at(tips)
        assert np.abs(compensation.tips_at(motors) - tips).max() < 1e-10
        square = FaultyMachine(*angles.tolist())
        places = motors.copy()
        for axis, screw in screws.items():
            places[:, axis] = screw.place(motors[:, axis], 0.0)
        assert np.abs(square.tool(places) - tips).max() < 1e-10
