"""G6.2 in both forms: equal curves, and the effect of modes and units on control points."""

from __future__ import annotations

import numpy as np
import pytest

from cnc.gcode.reader.parameters import Parameters
from cnc.model.blocks import NurbsFeed
from cnc.model.diagnostics import Diagnostic
from tests.support.gcode.gcode_cases import assert_rows_equal, error_of, rows, run

POINTS = [(10, 0), (20, 20), (12, 8), (10, 20), (8, 8), (0, 20), (10, 0)]
WEIGHTS = [1, 1, 2.5, 1, 0.5, 1, 1]
KNOTS = [0, 0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1, 1]


def paper(points=POINTS, weights=WEIGHTS, knots=KNOTS, degree: int = 3) -> str:  # type: ignore[no-untyped-def]
    lines = [f"U{u} X{x} Y{y} W{w}" for u, (x, y), w in zip(knots, points, weights, strict=False)]
    lines += [f"U{u}" for u in knots[len(points) :]]
    return "\n".join([f"G06.2 K{degree} {lines[0]} F18000", *lines[1:]])


def fanuc(points=POINTS, weights=WEIGHTS, knots=KNOTS, order: int = 4) -> str:  # type: ignore[no-untyped-def]
    lines = [f"K{u} X{x} Y{y} R{w}" for u, (x, y), w in zip(knots, points, weights, strict=False)]
    lines += [f"K{u}" for u in knots[len(points) :]]
    return "\n".join([f"G06.2 P{order} {lines[0]} F18000", *lines[1:]])


def curve(source: str, **options: object) -> NurbsFeed:
    """The only NURBS of a program."""
    (found,) = (block for block in run(source, **options) if isinstance(block, NurbsFeed))
    return found


def test_the_paper_form() -> None:
    block = curve("G0 X10\n" + paper())
    assert block.line == 2
    assert block.degree == 3
    assert block.feed == 300.0
    assert block.knots.tolist() == KNOTS
    assert block.weights.tolist() == WEIGHTS
    assert block.control_points.tolist() == [[x, y, 0] for x, y in POINTS]


@pytest.mark.parametrize("dialect", ["auto", "fanuc"])
def test_both_forms_make_the_same_blocks(dialect: str) -> None:
    assert_rows_equal(
        list(rows(run("G0 X10\n" + fanuc(), dialect=dialect))),
        list(rows(run("G0 X10\n" + paper(), dialect="paper"))),
        abs=0,
    )


@pytest.mark.parametrize("degree", range(1, 10))
def test_every_degree(degree: int) -> None:
    points = [(n, n * n) for n in range(degree + 1)]
    knots = [0] * (degree + 1) + [1] * (degree + 1)
    a = curve(paper(points, [1] * len(points), knots, degree))
    b = curve(fanuc(points, [1] * len(points), knots, degree + 1))
    assert a.degree == b.degree == degree
    assert a.control_points.tolist() == b.control_points.tolist()


def test_defaults_are_cubic_with_weights_of_one() -> None:
    short = "G06.2 U0 X0 F60\nU0 X1\nU0 X2\nU0 X3\nU1\nU1\nU1\nU1"
    block = curve(short)
    assert block.degree == 3
    assert block.weights.tolist() == [1.0] * 4
    assert_rows_equal(list(rows(run(short.replace("U", "K")))), list(rows(run(short))), abs=0)


def test_fanuc_without_the_first_point_and_knot() -> None:
    full = "G0 X10\n" + fanuc(weights=[1] * 7)
    short = full.replace("G06.2 P4 K0 X10 Y0 R1 F18000", "G06.2 P4 F18000")
    knot_only = full.replace("G06.2 P4 K0 X10 Y0 R1 F18000", "G06.2 P4 X10 Y0 F18000")
    point_only = full.replace("G06.2 P4 K0 X10 Y0 R1 F18000", "G06.2 P4 K0 F18000")
    for other in (short, knot_only, point_only):
        assert_rows_equal(list(rows(run(other))), list(rows(run(full))), abs=0)


def test_the_feed_may_be_modal() -> None:
    assert curve("G0 X10 F600\n" + paper().replace(" F18000", "")).feed == 10.0


def test_comments_blank_lines_numbers_and_block_delete_inside() -> None:
    lines = paper().split("\n")
    source = "\n".join(
        [
            "G0 X10",
            *(
                f"N{n} {line} (note) ; and more\n\n/U9 G0 X99\n(plain)"
                for n, line in enumerate(lines)
            ),
        ]
    )
    a, b = curve(source, block_delete=True), curve("G0 X10\n" + paper())
    assert a.control_points.tolist() == b.control_points.tolist()


def test_a_missing_coordinate_is_that_of_the_point_before() -> None:
    block = curve("G06.2 K2 U0 X0 Y0 F60\nU0 X5\nU0 Y7\nU1\nU1\nU1")
    assert block.control_points.tolist() == [[0, 0, 0], [5, 0, 0], [5, 7, 0]]


def test_missing_axes_do_not_move() -> None:
    block = curve("G0 Z4\nG06.2 K1 U0 X0 F60\nU0 X5\nU1\nU1")
    assert block.control_points.tolist() == [[0, 0, 4], [5, 0, 4]]


def test_incremental_points_count_from_the_point_before() -> None:
    steps = np.diff(np.array([(10, 0), *POINTS]), axis=0).tolist()
    a, b = curve("G0 X10\nG91\n" + paper(points=steps)), curve("G0 X10\n" + paper())
    assert a.control_points.tolist() == b.control_points.tolist()


def test_units_offsets_and_a_modal_code_in_the_first_line() -> None:
    source = "G10 L2 P2 X100\nG20\nG0 G55 X1\nG90 G06.2 K1 U0 X1 F60\nU0 X2\nU3\nU3"
    block = curve(source)
    assert block.control_points[:, 0].tolist() == [125.4, 150.8]
    assert block.feed == 60 * 25.4 / 60
    assert block.knots.tolist() == [0, 0, 3, 3], "knots have no unit"


def test_the_next_move_starts_where_the_curve_ends() -> None:
    blocks = list(rows(run("G0 X10\n" + paper() + "\nG91 G1 X5")))
    assert blocks[-1] == ("line", 15.0, 0.0, 0.0, 18000.0)


def test_two_curves_in_a_row_and_other_codes_between() -> None:
    blocks = list(rows(run("G0 X10\n" + fanuc() + "\nM3 S1\n" + fanuc() + "\nG0 X1\nM2")))
    assert [row[0] for row in blocks] == [
        "rapid",
        "nurbs",
        "spindle",
        "nurbs",
        "rapid",
        "spindle",
        "end",
    ]


def test_the_curve_starts_exactly_at_the_position() -> None:
    block = curve("G0 X10.00005\n" + paper())
    assert block.control_points[0, 0] == 10.00005


def test_inner_knots_have_a_multiplicity_up_to_the_degree() -> None:
    block = curve(paper([(n, 0) for n in range(5)], [1] * 5, [0, 0, 0, 1, 1, 2, 2, 2], 2))
    assert block.knots.tolist() == [0, 0, 0, 1, 1, 2, 2, 2]


@pytest.mark.parametrize("code", ["G41.1 D1", "G42.1 D1"])
def test_no_curve_under_cutter_compensation(code: str) -> None:
    assert error_of(f"{code}\n{paper()}").code == "nurbs-wrong-mode"


def test_axes_with_the_letters_of_knots_do_not_move() -> None:
    """U, V, W are knots and weights inside the mode, and axes outside."""
    axes = ("x", "y", "z", "u", "w")
    block = curve("G0 X10 U7 W8\n" + paper(), axes=axes)
    assert block.control_points[:, 3:].tolist() == [[7.0, 8.0]] * 7


def test_knots_and_weights_are_no_distances_without_a_decimal_point() -> None:
    """In FANUC's dialect a distance without a point is worth a warning, the first of them."""
    found: list[Diagnostic] = []
    source = (
        "G00 X10.\nG06.2 P4 K0 X10. Y0. R1 F600.\nK0 X20. R2\nK0 X30.\nK0 X40.\nK1\nK1\nK1\nK1\n"
        "G00 {}"
    )
    run(source.format("X5."), dialect="fanuc", warn=found.append)
    assert not found
    run(source.format("X5."), dialect="fanuc", warn=found.append)
    run(source.replace("X20.", "X20").format("X5"), dialect="fanuc", warn=found.append)
    assert [(each.code, each.line, each.column) for each in found] == [
        ("decimal-point-missing", 3, 4)
    ]


@pytest.mark.parametrize("plane", ["G17", "G18", "G19"])
@pytest.mark.parametrize("mode", ["G90", "G91"])
def test_rotation_and_plane(plane: str, mode: str) -> None:
    source = f"F60\nG0 X1 Y2 Z3\n{mode} {plane}\nG6.2 P3 K0\nK0 X4 Y5 Z6\nK0 X7 Y-8 Z9\nK1\nK1\nK1"
    plain, turned = curve(source), curve(source, parameters=Parameters({5230: 90.0}))
    assert turned.control_points == pytest.approx(
        plain.control_points @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]), abs=1e-12
    )
    last = [7, -8, 9] if mode == "G90" else [12, -1, 18]
    assert plain.control_points.tolist() == [
        [1, 2, 3],
        [4, 5, 6] if mode == "G90" else [5, 7, 9],
        last,
    ]
