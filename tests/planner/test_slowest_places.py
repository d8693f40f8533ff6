"""The jerk along the path where a motion past a corner is slowest.

A motion that turns back passes a place at which its speed is small. With the velocity
(A (t - t0), e) the speed there is e, and the jerk along the path is A^2 / e. The peak lasts e / A,
which is much shorter than a step of the motion, and it may be anywhere in the step.
"""

import numpy as np
import pytest

from cnc.machine.models import Axis, Board, Machine, PathLimits
from cnc.path.kernels.curve import METRIC, METRICS, SPAN, Pieces
from cnc.planner.audit import largest_values
from cnc.planner.kernels.arrays import PlanArrays
from cnc.planner.kernels.audit import JERK, audit_phases
from cnc.planner.kernels.corner_along import ALONG_JERK, peak_in
from cnc.planner.kernels.timed import TIMED_SIZE, TIMED_SIZE_PER_AXIS, write_timed
from tests.support.planner.legality import examine

SECONDS = 1e-3
ACCELERATION = 240.0
SLOWEST = 1e-4
PLACES = (0.3141, 0.9991, 0.99995, 0.00004)
"""Places of the least speed, as parts of the step: some are beside its ends."""


@pytest.mark.parametrize("place", PLACES)
def test_audit_finds_the_jerk_where_a_motion_is_slowest(place):
    velocity = ACCELERATION * SECONDS * np.array([-place, 0.5 - place, 1.0 - place])
    ends = np.cumsum(velocity) * SECONDS / 3.0
    points = np.stack((ends, SLOWEST * SECONDS * np.arange(1, 4) / 3.0), axis=1)
    data = np.zeros(2 * (TIMED_SIZE + 2 * TIMED_SIZE_PER_AXIS))
    data[:9] = 2.0
    data[METRICS], data[METRIC], data[METRIC + 1] = 2.0, 0.0, 1.0
    write_timed(data, 0, 0, np.zeros(2), points[0], points[1], points[2], np.zeros((4, 2)))
    length = data[3]
    plan = PlanArrays(
        piece_s=np.array([0.0, length]),
        t=np.array([0.0, SECONDS]),
        s=np.array([0.0, length]),
        v=np.full(2, length / SECONDS),
        a=np.zeros(2),
        j=np.zeros(1),
    )
    largest = largest_values(np.zeros(7 + 3 * 2))
    pieces = Pieces(np.array([SPAN]), np.array([0]), data)
    audit_phases(pieces, plan, np.full(1, np.inf), SECONDS, largest)
    assert largest.along[JERK] == pytest.approx(ACCELERATION**2 / SLOWEST, rel=1e-6)


@pytest.mark.parametrize("parts", [16, 64])
@pytest.mark.parametrize("place", PLACES)
def test_search_finds_the_place_where_a_motion_is_slowest(place, parts):
    first = place * SECONDS * ACCELERATION
    square = [first**2 + SLOWEST**2, -2.0 * first * ACCELERATION, ACCELERATION**2, 0.0, 0.0]
    polynomials = np.array([*square, ACCELERATION**2, 0.0, 0.0])
    assert peak_in(ALONG_JERK, polynomials, SECONDS, parts) == pytest.approx(place, abs=1e-9)


def test_a_rounding_error_at_a_rest_is_no_peak():
    # r = j t^3 / 6, whose jerk is j everywhere; the velocity has a rounding error at the rest.
    jerk = 1e5
    f = np.polynomial.Polynomial([1e-26, -1e-24, 1e-22, 0.0, 0.25 * jerk**2])
    polynomials = np.array([*f.coef, 0.0, 0.0, jerk**2])
    at = peak_in(ALONG_JERK, polynomials, SECONDS, 64) * SECONDS
    found = (f.deriv(2)(at) / 2.0 - (f.deriv()(at) / 2.0) ** 2 / f(at)) / np.sqrt(f(at))
    assert found == pytest.approx(jerk, rel=1e-6)


def test_a_motion_that_turns_back_at_a_corner_keeps_its_jerk(tmp_path):
    velocity = {"x": 46.67983802090411, "y": 40.23497235057796, "z": 35.969279789417264}
    machine = Machine(
        axes={
            letter: Axis(steps_per_mm=100.0, max_velocity=each) for letter, each in velocity.items()
        },
        path=PathLimits(
            max_feed=67.42482524899832,
            max_tangential_acceleration=11951.657004358625,
            max_normal_acceleration=11940.214922338911,
            max_jerk=1764029.8220270786,
            chord_error=0.0005435676799358959,
            period=1e-4,
        ),
        board=Board(max_step_rate=1e9),
    )
    text = (
        "G21 G90 G94 G17\nG64 P0.46347\n"
        "G06.2 K3 U0 F3032.4022 X0 Y0 Z0 W1\n"
        "U0 X-0.271857028 Y0 Z0 W1\n"
        "U0 X-0.544752454 Y0.003074159 Z-0.000032255 W1\n"
        "U0 X-0.817581114 Y-0.001863276 Z-0.001737166 W1\n"
        "U0.5 X-1.085549218 Y-0.002616683 Z0.000390504 W1\n"
        "U1\nU1\nU1\nU1\n"
        "G0 X-0.861508485 Y-0.001986780 Z-0.001388382\n"
        "G1 F7.5913 X-0.429940634 Y0.244841581 Z-0.154934547\nM2\n"
    )
    assert not examine(text, machine, tmp_path).wrong
