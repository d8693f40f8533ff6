"""G5 and G5.1: Bezier curves in every plane, and their continuation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cnc.gcode.reader.parameters import Parameters
from tests.support.gcode.gcode_cases import assert_blocks, assert_error_at, rows, run
from tests.support.gcode.spline_cases import curve, curves_of, points_on

CUBIC = [0, 0, 0, 0, 1, 1, 1, 1]
ALONG = np.linspace(0.0, 1.0, 33)


def test_the_documented_curvy_n() -> None:
    one, two = curves_of("F60\nG0 X0 Y0\nG5 I0 J3 P0 Q-3 X1 Y1\nG5 P0 Q-3 X2 Y2")
    assert one.control_points.tolist() == [[0, 0, 0], [0, 3, 0], [1, -2, 0], [1, 1, 0]]
    assert two.control_points.tolist() == [[1, 1, 0], [1, 4, 0], [2, -1, 0], [2, 2, 0]]
    for block, line in ((one, 3), (two, 4)):
        assert (block.degree, block.knots.tolist(), block.weights.tolist()) == (
            3,
            CUBIC,
            [1, 1, 1, 1],
        )
        assert (block.line, block.feed) == (line, 1.0)


def test_the_documented_parabola() -> None:
    block = curve("G0 X-2 Y4\nG5.1 X2 I2 J-8 F90")
    assert block.control_points.tolist() == [[-2, 4, 0], [0, -4, 0], [2, 4, 0]]
    assert (block.degree, block.knots.tolist(), block.feed) == (2, [0, 0, 0, 1, 1, 1], 1.5)
    points = points_on(block, ALONG)
    assert points[:, 1] == pytest.approx(points[:, 0] ** 2, abs=1e-14)


@pytest.mark.parametrize("seed", range(10))
def test_a_cubic_is_the_bezier_formula(seed: int) -> None:
    random = np.random.default_rng(seed)
    x0, y0, x, y, i, j, p, q = (round(value, 4) for value in random.uniform(-80, 80, 8).tolist())
    block = curve(f"G0 X{x0} Y{y0}\nG5 X{x} Y{y} I{i} J{j} P{p} Q{q} F60")
    t = ALONG[:, None]
    a, b, c, d = (np.array(pair) for pair in ((x0, y0), (x0 + i, y0 + j), (x + p, y + q), (x, y)))
    expected = (1 - t) ** 3 * a + 3 * t * (1 - t) ** 2 * b + 3 * t**2 * (1 - t) * c + t**3 * d
    assert points_on(block, ALONG)[:, :2] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("seed", range(10))
def test_a_quadratic_is_the_bezier_formula(seed: int) -> None:
    random = np.random.default_rng(seed)
    x0, y0, x, y, i, j = (round(value, 4) for value in random.uniform(-80, 80, 6).tolist())
    block = curve(f"G0 X{x0} Y{y0}\nG5.1 X{x} Y{y} I{i} J{j} F60")
    t = ALONG[:, None]
    expected = (
        (1 - t) ** 2 * np.array((x0, y0))
        + 2 * t * (1 - t) * np.array((x0 + i, y0 + j))
        + t**2 * np.array((x, y))
    )
    assert points_on(block, ALONG)[:, :2] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("plane", "words", "control"),
    [
        ("G17", "X5 Y7 I1 J2 P3 Q4", [[0, 0, 0], [1, 2, 0], [8, 11, 0], [5, 7, 0]]),
        ("G18", "Z5 X7 K1 I2 P3 Q4", [[0, 0, 0], [2, 0, 1], [11, 0, 8], [7, 0, 5]]),
        ("G19", "Y5 Z7 J1 K2 P3 Q4", [[0, 0, 0], [0, 1, 2], [0, 8, 11], [0, 5, 7]]),
    ],
)
def test_every_plane(plane: str, words: str, control: list[list[float]]) -> None:
    assert curve(f"{plane} G5 {words} F60").control_points.tolist() == control
    quadratic = " ".join(words.split()[:4])
    assert curve(f"{plane} G5.1 {quadratic} F60").control_points.tolist() == [
        control[0],
        control[1],
        control[3],
    ]


def test_missing_coordinates_and_offsets() -> None:
    assert curve("G0 X1 Y2 Z3\nG5 X5 I1 J1 P0 Q0 F60").control_points[-1].tolist() == [5, 2, 3]
    assert curve("G5.1 X5 J3 F60").control_points[1].tolist() == [0, 3, 0]
    assert curve("G5.1 Y5 I3 F60").control_points[1].tolist() == [3, 0, 0]


def test_inches_incremental_and_absolute_centres() -> None:
    inches = curve("G20\nG5 X1 Y1 I0 J.5 P0 Q-.5 F60")
    assert inches.control_points.tolist() == [
        [0, 0, 0],
        [0, 12.7, 0],
        [25.4, 12.7, 0],
        [25.4, 25.4, 0],
    ]
    assert inches.feed == pytest.approx(25.4, rel=1e-15)
    steps = curve("G0 X10 Y20\nG91 G5 X1 Y1 I0 J3 P0 Q-3 F60")
    assert steps.control_points.tolist() == [[10, 20, 0], [10, 23, 0], [11, 18, 0], [11, 21, 0]]
    offsets = "G0 X10 Y20\nG5 X1 Y1 I0 J3 P0 Q-3 F60"
    assert (
        curve(f"G90.1\n{offsets}").control_points.tolist() == curve(offsets).control_points.tolist()
    )


def test_a_g92_shift_moves_the_points_and_not_the_offsets() -> None:
    block = curve("G0 X10 Y20\nG92 X0 Y0\nG5 X1 Y1 I0 J3 P0 Q-3 F60")
    assert block.control_points.tolist() == [[10, 20, 0], [10, 23, 0], [11, 18, 0], [11, 21, 0]]


@pytest.mark.parametrize("plane", ["G17", "G18", "G19"])
def test_rotation_rotates_the_whole_curve(plane: str) -> None:
    letters = {"G17": "XY", "G18": "ZX", "G19": "YZ"}[plane]
    offsets = "".join({"X": "I", "Y": "J", "Z": "K"}[letter] for letter in letters)
    source = (
        f"G0 X3 Y4 Z5\n{plane} G5 {letters[0]}9 {letters[1]}-7 {offsets[0]}1 {offsets[1]}2 "
        f"P3 Q4 F60\nG5 {letters[0]}1 P1 Q1"
    )
    angle = math.radians(30.0)
    turn = np.array(
        [[math.cos(angle), math.sin(angle), 0], [-math.sin(angle), math.cos(angle), 0], [0, 0, 1]]
    )
    plain = curves_of(source)
    turned = curves_of(source, parameters=Parameters({5230: 30.0}))
    for a, b in zip(plain, turned, strict=True):
        assert b.control_points == pytest.approx(a.control_points @ turn, abs=1e-12)


def test_it_is_modal() -> None:
    same = "G5 X1 Y1 I0 J3 P0 Q-3 F60\n{}X2 Y2 P0 Q-3\n{}X3 Y3 I1 J1 P0 Q-3"
    assert list(rows(run(same.format("", "")))) == list(rows(run(same.format("G5 ", "G5 "))))
    again = "G5.1 X1 Y1 I0 J3 F60\n{}X2 Y2 J-3"
    assert list(rows(run(again.format("")))) == list(rows(run(again.format("G5.1 "))))


def test_two_cubics_join_with_equal_derivatives() -> None:
    one, two = curves_of("G5 X10 Y5 I4 J6 P-3 Q2 F60\n(note)\nM8\nG21 G94 G90\nG5 X20 Y0 P-1 Q-1")
    left = one.control_points[3] - one.control_points[2]
    assert (two.control_points[1] - two.control_points[0]).tolist() == left.tolist() == [3, -2, 0]


def test_the_stored_tangent_is_in_machine_directions() -> None:
    units, shift = curves_of("G5 X10 Y5 I4 J6 P-3 Q2 F60\nG20\nG92 X0\nG5 X1 Y0 P-1 Q-1")
    assert (shift.control_points[1] - shift.control_points[0]).tolist() == [3, -2, 0]
    assert shift.control_points[-1].tolist() == [35.4, 0.0, 0.0]
    assert units.control_points[-1].tolist() == shift.control_points[0].tolist()


@pytest.mark.parametrize(
    ("code", "words"), [("G5", "X1 Y1 ¦J3 P0 Q-3"), ("G5", "X1 Y1 ¦I3 P0 Q-3")]
)
def test_one_offset_is_not_enough(code: str, words: str) -> None:
    assert_error_at("spline-control-point-missing", f"{code} {words} F60")


@pytest.mark.parametrize(
    "between", ["G0 X1 Y1", "G1 X2", "G2 X2 Y1 I.5", "G0 X1", "G5.1 X2 I1", "G18", "G53 G0 X1 Y1"]
)
def test_no_offset_only_directly_after_another_cubic(between: str) -> None:
    back = "\nG17" if between != "G18" else ""
    end = "Z2" if between == "G18" else "X2"
    assert_error_at(
        "spline-tangent-missing", f"G5 X1 Y1 I0 J3 P0 Q-3 F60\n{between}{back}\n¦G5 {end} P0 Q-3"
    )


def test_a_plane_change_and_back_keeps_the_tangent() -> None:
    assert len(curves_of("G5 X1 Y1 I0 J3 P0 Q-3 F60\nG18\nG17\nG5 X2 P0 Q-3")) == 2


def test_inverse_time_uses_the_length_of_the_curve() -> None:
    length = 2 * math.sqrt(17) + math.asinh(4) / 2
    assert curve("G0 X-2 Y4\nG93 G5.1 X2 I2 J-8 F3").feed == pytest.approx(
        length * 3 / 60, rel=1e-12
    )
    # A straight line as a cubic of even pace.
    assert curve("G93 G5 X9 I3 J0 P-3 Q0 F4").feed == pytest.approx(9 * 4 / 60, rel=1e-13)


def test_feed_per_revolution() -> None:
    assert curve("G95 M3 S600 F.1\nG5 X9 I3 J3 P-3 Q0").feed == pytest.approx(1.0, rel=1e-15)


def test_between_other_moves() -> None:
    assert_blocks(
        "F60 G1 X1\nG5.1 X2 J1\nG1 X3",
        ("line", 1, 0, 0, 60),
        ("nurbs", 2, [0, 0, 0, 1, 1, 1], [[1, 0, 0], [1, 1, 0], [2, 0, 0]], [1, 1, 1], 60),
        ("line", 3, 0, 0, 60),
    )


def test_other_axes_do_not_move() -> None:
    block = curve("G0 X1 A30 U4\nG5 X5 I1 J1 P0 Q0 F60", axes=("x", "y", "z", "a", "u"))
    assert block.control_points[:, 3:].tolist() == [[30, 4]] * 4


@pytest.mark.parametrize("dialect", ["auto", "linuxcnc", "paper"])
@pytest.mark.parametrize("code", ["G5 X1 I1 J0 P0 Q1", "G5.1 X1 I1", "G05.1 X1 I1"])
def test_dialects_with_bezier_curves(dialect: str, code: str) -> None:
    assert len(curves_of(f"F60\n{code}\nM2", dialect=dialect)) == 1


@pytest.mark.parametrize("dialect", ["grbl", "fanuc"])
@pytest.mark.parametrize("code", ["G5 X1 I1 J0 P0 Q1", "G5.1 X1 I1", "G5.2", "G5.3"])
def test_dialects_without_bezier_curves(dialect: str, code: str) -> None:
    assert_error_at("code-not-in-dialect", f"F60\n¦{code}\nM2", dialect=dialect)
