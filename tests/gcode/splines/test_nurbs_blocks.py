"""G5.2 to G5.3: control points and weights as a NURBS with clamped uniform knots."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from geomdl import NURBS

from cnc.gcode.reader.parameters import Parameters
from tests.support.gcode.gcode_cases import assert_blocks, assert_error_at, rows, run
from tests.support.gcode.spline_cases import curve, curves_of, points_on

ALONG = np.linspace(0.0, 1.0, 41)


def test_the_documented_example() -> None:
    block = curve(
        "G0 X0 Y0 (rapid move)\nF10 (set feed rate)\nG5.2 P1 L3\n X0 Y1 P1\n X2 Y2 P1\n X2 Y0 P1\n"
        " X0 Y0 P2\nG5.3\nM2"
    )
    assert (block.degree, block.line) == (2, 3)
    assert block.knots.tolist() == [0, 0, 0, 1, 2, 3, 3, 3]
    assert block.control_points.tolist() == [[0, 0, 0], [0, 1, 0], [2, 2, 0], [2, 0, 0], [0, 0, 0]]
    assert block.weights.tolist() == [1, 1, 1, 1, 2]
    assert block.feed == 10 / 60


def test_points_of_the_documented_example_as_linuxcnc_moves_through_them() -> None:
    """Ends of its straight moves, to the digits that it rounds knots and basis functions to: u = 1
    and u = 2 are knots.
    """
    block = curve("F10\nG5.2 P1 L3\nX0 Y1 P1\nX2 Y2 P1\nX2 Y0 P1\nX0 Y0 P2\nG5.3")
    assert points_on(block, np.array([0, 1 / 3, 2 / 3, 1]))[:, :2].tolist() == [
        [0, 0],
        [1, 1.5],
        [2, 1],
        [0, 0],
    ]


def test_optional_words() -> None:
    full = curve("F60\nG5.2 P1 L3\nX0 Y1 P1\nX1 Y1 P1\nG5.3")
    for short in (
        "F60\nG5.2\nX0 Y1\nX1 Y1\nG5.3",
        "F60\nG5.2 X0 Y1\nX1 Y1\nG5.3",
        "G5.2 L3\nX0 Y1\nX1 Y1 F60\nG5.3",
    ):
        other = curve(short)
        assert other.weights.tolist() == full.weights.tolist() == [1, 1, 1]
        assert other.knots.tolist() == full.knots.tolist() == [0, 0, 0, 1, 1, 1]
        assert other.control_points.tolist() == full.control_points.tolist()
        assert other.feed == full.feed


def test_the_point_of_the_first_weight() -> None:
    assert curve("F60\nG5.2 P5\nX0 Y1 P2\nX1 Y1\nG5.3").weights.tolist() == [5, 2, 1]
    assert curve("F60\nG5.2 X0 Y1 P2\nX1 Y1 P3\nG5.3").weights.tolist() == [1, 2, 3]


@pytest.mark.parametrize("order", range(2, 11))
def test_every_order(order: int) -> None:
    points = "\n".join(f"X{n} Y{n * n}" for n in range(1, order + 3))
    block = curve(f"F60\nG5.2 L{order}\n{points}\nG5.3")
    assert block.degree == order - 1
    inner = list(range(1, len(block.control_points) - order + 1))
    assert block.knots.tolist() == [0] * order + inner + [4] * order


@pytest.mark.parametrize("seed", range(12))
def test_against_geomdl(seed: int) -> None:
    random = np.random.default_rng(seed)
    order = int(random.integers(2, 7))
    count = order + int(random.integers(0, 6))
    points = random.uniform(-50, 50, (count, 3)).round(3)
    weights = random.uniform(0.2, 4, count).round(3)
    lines = [
        f"X{x} Y{y} Z{z} P{w}"
        for (x, y, z), w in zip(points.tolist(), weights.tolist(), strict=True)
    ]
    start = lines[0].split(" P")
    block = curve(
        "\n".join([f"G0 {start[0]}", f"F60 G5.2 P{start[1]} L{order}", *lines[1:], "G5.3"])
    )
    oracle = NURBS.Curve()
    oracle.degree = order - 1
    oracle.ctrlpts = points.tolist()
    oracle.weights = weights.tolist()
    inner = np.arange(1, count - order + 1) / (count - order + 1)
    oracle.knotvector = [0.0] * order + inner.tolist() + [1.0] * order
    expected = [oracle.evaluate_single(float(u)) for u in ALONG]
    assert points_on(block, ALONG) == pytest.approx(np.array(expected), abs=1e-9)


@pytest.mark.parametrize("plane", ["G17", "G18", "G19"])
def test_points_in_space_whatever_the_plane(plane: str) -> None:
    block = curve(f"F60\n{plane}\nG0 X1 Y2 Z3\nG5.2\nX4 Y5 Z6\nX7 Y8 Z9\nG5.3")
    assert block.control_points.tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 9]]


@pytest.mark.parametrize("letters", [f"{a}{b}" for a, b in itertools.permutations("XYZ", 2)])
def test_two_axes_without_the_third(letters: str) -> None:
    a, b = letters
    block = curve(f"F60\nG0 X1 Y2 Z3\nG5.2\n{a}4 {b}5\n{a}7 {b}8\nG5.3")
    expected = np.array([[1.0, 2, 3]] * 3)
    for letter, values in ((a, (4, 7)), (b, (5, 8))):
        expected[1:, "XYZ".index(letter)] = values
    assert block.control_points.tolist() == expected.tolist()


def test_incremental_points_count_from_the_start_of_the_curve() -> None:
    blocks = list(rows(run("F60\nG91 G0 X5 Y5\nG5.2 P1 L3\nX0 Y1 P1\nX1 Y1 P1\nG5.3\nG0 X1")))
    assert blocks[1][3] == [[5, 5, 0], [5, 6, 0], [6, 6, 0]]
    assert blocks[2] == ("rapid", 7.0, 6.0, 0.0)


def test_inches_and_rotation() -> None:
    source = "F60\nG20\nG0 X1 Y1\nG5.2\nX2 Y1\nX2 Y3\nG5.3"
    block = curve(source)
    assert block.control_points.tolist() == [
        [25.4, 25.4, 0],
        [50.8, 25.4, 0],
        [50.8, pytest.approx(76.2), 0],
    ]
    assert block.knots.tolist() == [0, 0, 0, 1, 1, 1]
    turned = curve(source, parameters=Parameters({5230: 90.0}))
    assert turned.control_points == pytest.approx(
        block.control_points @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]), abs=1e-12
    )


def test_the_last_feed_holds_for_the_whole_curve() -> None:
    assert curve("F60\nG5.2 F90\nX0 Y1 F120\nX1 Y1 F180\nG5.3").feed == 3.0
    blocks = list(rows(run("F60\nG5.2\nX0 Y1\nX1 Y1 F180\nG5.3\nG1 X5")))
    assert [row[-1] for row in blocks] == [180, 180]


def test_inverse_time_uses_the_length_of_the_curve() -> None:
    block = curve("G93\nG5.2 L2 F2\nX3 Y4\nX3 Y16\nG5.3")
    assert block.feed == pytest.approx(17 * 2 / 60, rel=1e-13)


def test_g5_2_may_be_repeated() -> None:
    plain = curve("F60\nG5.2 P2 L3\nX0 Y1 P1\nX1 Y1 P1\nG5.3")
    again = curve("F60\nG5.2 P2 L3\nG5.2 X0 Y1 P1\nG5.2 X1 Y1 P1\nG5.3")
    assert (again.control_points.tolist(), again.weights.tolist()) == (
        plain.control_points.tolist(),
        plain.weights.tolist(),
    )


def test_modes_in_the_first_line() -> None:
    block = curve("G91\nF60 G90 G21 G18 G94 G5.2 X1 Y2\nX3 Y4\nG5.3")
    assert block.control_points.tolist() == [[0, 0, 0], [1, 2, 0], [3, 4, 0]]


def test_comments_numbers_and_parameters_inside() -> None:
    plain = curve("F60\nG5.2\nX0 Y1\nX1 Y1\nG5.3")
    other = curve("N1 F60\nN2 G5.2 (open)\n\nN3 X0 Y1 ; first\n(between)\n/N4 X1 Y1\nN5 G5.3")
    assert other.control_points.tolist() == plain.control_points.tolist()


def test_after_the_curve_a_new_motion_code_is_needed() -> None:
    assert_blocks(
        "F60\nG5.2 L2\nX3 Y4\nG5.3\nG1 X5",
        ("nurbs", 1, [0, 0, 1, 1], [[0, 0, 0], [3, 4, 0]], [1, 1], 60),
        ("line", 5, 4, 0, 60),
    )
    assert_error_at("motion-missing", "F60\nG5.2 L2\nX3 Y4\nG5.3\n¦X5")


def test_two_curves() -> None:
    one, two = curves_of("F60\nG5.2 L2\nX3 Y4\nG5.3\nG5.2 P2\nX3 Y5\nX4 Y5\nG5.3")
    assert one.control_points[-1].tolist() == two.control_points[0].tolist()
    assert two.weights.tolist() == [2, 1, 1]


@pytest.mark.parametrize("dialect", ["auto", "linuxcnc", "paper"])
def test_dialects_with_g5_2(dialect: str) -> None:
    assert curve("F60\nG05.2 L2\nX3 Y4\nG05.3\nM2", dialect=dialect).degree == 1


def test_control_points_from_a_loop_and_a_subroutine() -> None:
    block = curve(
        "F60\no<point> sub\nX#1 Y#2 P#3\no<point> endsub\nG5.2 L3\n#5 = 0\n"
        "o1 while [#5 LT 3]\n#5 = [#5 + 1]\nX#5 Y[#5 * #5]\n"
        "o1 endwhile\no<point> call [9] [8] [7]\nG5.3"
    )
    assert block.control_points.tolist() == [[0, 0, 0], [1, 1, 0], [2, 4, 0], [3, 9, 0], [9, 8, 0]]
    assert block.weights.tolist() == [1, 1, 1, 1, 7]
    assert block.line == 5


def test_places_of_errors_in_a_subroutine() -> None:
    assert_error_at("nurbs-foreign-word", "F60\no1 sub\n¦M8\no1 endsub\nG5.2\no1 call\nG5.3")
    assert_error_at("nurbs-left-early", "F60\no1 sub\n¦G5.2\nX1 Y1\no1 endsub\no1 call")


def test_the_position_stays_until_the_curve_is_complete() -> None:
    blocks = list(rows(run("F60\nG0 X4\nG5.2 L2\nX5 Y#5420\nX6 Y#5420\nG5.3\nG0 X#5421")))
    assert blocks[1][3] == [[4, 0, 0], [5, 4, 0], [6, 4, 0]]
    assert blocks[2] == ("rapid", 4, 4, 0)
