"""BSPLINE: Siemens' control points, intervals and weights as a NURBS with clamped knots."""

from __future__ import annotations

import numpy as np
import pytest
from geomdl import NURBS

from cnc.gcode.reader.parameters import Parameters
from tests.support.gcode.gcode_cases import assert_error_at, error_of, rows, run
from tests.support.gcode.spline_cases import curve, curves_of, points_on

ALONG = np.linspace(0.0, 1.0, 41)
POLYGON = "X10 Y20\nX20 Y40\nX30 Y30\nX40 Y45\nX50 Y0"
POINTS = [[0, 0, 0], [10, 20, 0], [20, 40, 0], [30, 30, 0], [40, 45, 0], [50, 0, 0]]


def test_the_documented_example() -> None:
    block = curve(f"N10 G1 X0 Y0 F300 G64\nN20 BSPLINE\n{POLYGON}\nG0 X0")
    assert (block.degree, block.line, block.feed) == (3, 2, 5.0)
    assert block.control_points.tolist() == POINTS
    assert block.knots.tolist() == [0, 0, 0, 0, 1, 2, 3, 3, 3, 3]
    assert block.weights.tolist() == [1] * 6


def test_the_documented_example_with_weights() -> None:
    block = curve(
        "G1 X0 Y0 F300\nBSPLINE\nX10 Y20 PW=2\nX20 Y40\nX30 Y30 PW=0.5\nX40 Y45\nX50 Y0\nM30"
    )
    assert block.weights.tolist() == [1, 2, 1, 0.5, 1, 1]
    assert block.control_points.tolist() == POINTS


def test_degree_2() -> None:
    block = curve(f"F300\nBSPLINE SD=2\n{POLYGON}\nM2")
    assert block.knots.tolist() == [0, 0, 0, 1, 2, 3, 4, 4, 4]


def test_the_first_line_may_have_the_first_point() -> None:
    rest = POLYGON.split("\n", 1)[1]
    one, two = (
        curve(f"F300\nBSPLINE SD=2 X10 Y20 PW=3\n{rest}"),
        curve(f"BSPLINE SD=2 F300\nX10 Y20 PW=3\n{rest}"),
    )
    assert one.control_points.tolist() == two.control_points.tolist() == POINTS
    assert one.weights.tolist() == two.weights.tolist() == [1, 3, 1, 1, 1, 1]
    assert one.knots.tolist() == two.knots.tolist()


def test_an_interval_belongs_to_the_piece_that_its_point_completes() -> None:
    cubic = curve("F60\nBSPLINE\nX1 Y1 PL=0\nX2 Y0 PL=0\nX3 Y2 PL=.5\nX4 Y0 PL=.25\nX5 Y3 PL=2\nM2")
    assert cubic.knots.tolist() == [0, 0, 0, 0, 0.5, 0.75, 2.75, 2.75, 2.75, 2.75]
    square = curve("F60\nBSPLINE SD=2\nX1 Y1\nX2 Y0 PL=.5\nX3 Y2 PL=.25\nX4 Y0 PL=2\nM2")
    assert square.knots.tolist() == [0, 0, 0, 0.5, 0.75, 2.75, 2.75, 2.75]


def test_missing_intervals_are_1() -> None:
    block = curve("F60\nBSPLINE SD=2\nX1 Y1\nX2 Y0\nX3 Y2 PL=3\nX4 Y0\nM2")
    assert block.knots.tolist() == [0, 0, 0, 1, 4, 5, 5, 5]


def test_one_length_for_all_intervals_is_allowed_in_every_line() -> None:
    lines = [f"{line} PL=2.5" for line in POLYGON.split("\n")]
    block = curve("\n".join(["F60\nBSPLINE", *lines, "M2"]))
    assert block.knots.tolist() == [0, 0, 0, 0, 2.5, 5, 7.5, 7.5, 7.5, 7.5]


def test_an_interval_of_0_is_a_multiple_knot() -> None:
    block = curve("F60\nBSPLINE\nX1 Y1\nX2 Y0\nX3 Y2 PL=1\nX4 Y0 PL=0\nX5 Y0 PL=0\nX6 Y1 PL=1\nM2")
    assert block.knots.tolist() == [0, 0, 0, 0, 1, 1, 1, 2, 2, 2, 2]
    corner = points_on(block, np.array([0.5]))
    assert corner[0].tolist() == [3, 2, 0]


@pytest.mark.parametrize("seed", range(12))
def test_against_geomdl(seed: int) -> None:
    random = np.random.default_rng(seed)
    degree = int(random.integers(2, 4))
    count = degree + 1 + int(random.integers(0, 6))
    points = random.uniform(-50, 50, (count, 3)).round(3)
    weights = np.array([1.0, *random.uniform(0.2, 3, count - 1).round(4)])
    oracle = NURBS.Curve()
    oracle.degree = degree
    oracle.ctrlpts = points.tolist()
    oracle.weights = weights.tolist()
    inner = np.sort(random.uniform(0.05, 0.95, count - degree - 1)).round(6)
    knots = [0.0] * (degree + 1) + inner.tolist() + [1.0] * (degree + 1)
    oracle.knotvector = knots
    # PL as a CAM system writes it: from one knot to the next.
    lines = [
        f"X{x} Y{y} Z{z} PW={weights[i]} PL={knots[i + 1] - knots[i]:.6f}"
        for i, (x, y, z) in enumerate(points.tolist())
        if i
    ]
    x, y, z = points[0].tolist()
    block = curve("\n".join([f"G0 X{x} Y{y} Z{z}", f"BSPLINE SD={degree} F60", *lines, "G0 Z60"]))
    assert block.knots == pytest.approx(np.array(knots), abs=1e-9)
    expected = [oracle.evaluate_single(float(u)) for u in ALONG]
    assert points_on(block, ALONG) == pytest.approx(np.array(expected), abs=1e-6)


@pytest.mark.parametrize(
    "end",
    [
        "G1 X9",
        "G0 X9",
        "G2 X60 I5",
        "G80",
        "M2",
        "M30",
        "",
        "BSPLINE\nX1 Y1\nX2 Y0\nX3 Y3",
        "%",
        "G5.1 X9 I1",
    ],
)
def test_completion_of_a_curve(end: str) -> None:
    block = curves_of(f"%\nF300\nBSPLINE\n{POLYGON}\n{end}")[0]
    assert block.control_points.tolist() == POINTS


def test_the_line_that_completes_it_is_executed() -> None:
    blocks = list(rows(run(f"F300\nBSPLINE\n{POLYGON}\nM8 G1 X60 F90")))
    assert [row[0] for row in blocks] == ["nurbs", "coolant", "line"]
    assert (blocks[0][-1], blocks[2]) == (300, ("line", 60, 0, 0, 90))


def test_two_curves_in_a_row() -> None:
    one, two = curves_of(f"F300\nBSPLINE SD=2\n{POLYGON}\nBSPLINE\nX60 Y1\nX70 Y2\nX80 Y3\nM2")
    assert (one.degree, two.degree) == (2, 3)
    assert two.control_points.tolist() == [[50, 0, 0], [60, 1, 0], [70, 2, 0], [80, 3, 0]]


def test_increments_inches_rotation_and_missing_words() -> None:
    steps = "F60\nG91\nBSPLINE\nX10 Y20\nX10 Y20\nX10 Y-10\nX10 Y15\nX10 Y-45\nM2"
    assert curve(steps).control_points.tolist() == POINTS
    inches = curve(f"F60\nG20\nBSPLINE\n{POLYGON}\nM2")
    assert inches.control_points == pytest.approx(np.array(POINTS) * 25.4, rel=1e-15)
    turned = curve(f"F60\nBSPLINE\n{POLYGON}\nM2", parameters=Parameters({5230: 90.0}))
    assert turned.control_points == pytest.approx(
        np.array(POINTS) @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]), abs=1e-12
    )
    rests = curve("F60\nBSPLINE SD=2\nX1\nY1\nZ1\nM2")
    assert rests.control_points.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1]]


@pytest.mark.parametrize(
    "line",
    [
        "bspline sd = 2 x1 y1 f60",
        "BSPLINE SD=2 X1 Y1 F60",
        "N5 BSPLINE SD=[1+1] X[2-1] Y1 F60",
        "F60X1Y1SD=2BSPLINE",
    ],
)
def test_spellings(line: str) -> None:
    assert curve(f"{line}\nX2 Y0 PW=[1/2]\nM2").weights.tolist() == [1, 1, 0.5]


def test_the_feed_before_the_second_point_is_that_of_the_curve() -> None:
    for source in ("F90\nBSPLINE", "BSPLINE F90", "F5\nBSPLINE F90"):
        assert curve(f"{source}\n{POLYGON}").feed == 1.5
    assert curve(f"BSPLINE\n{POLYGON.replace('Y20', 'Y20 F90')}").feed == 1.5


CASES: dict[str, tuple[str, str]] = {
    "too few points": ("nurbs-too-few-points", "F60\n¦BSPLINE\nX1 Y1\nX2 Y2\nG0 X5"),
    "too few points at the end": ("nurbs-too-few-points", "F60\n¦BSPLINE\nX1 Y1\nX2 Y2\nM30"),
    "too few points at the end of the file": (
        "nurbs-too-few-points",
        "F60\nN5 ¦BSPLINE SD=2\nX1 Y1",
    ),
    "no points": ("nurbs-too-few-points", "F60\n¦BSPLINE\nG1 X1"),
    "degree 1": ("value-out-of-range", "F60\nBSPLINE ¦SD=1"),
    "degree 4": ("value-out-of-range", "F60\nBSPLINE ¦SD=4 X1"),
    "half a degree": ("value-out-of-range", "F60\nBSPLINE ¦SD=2.5"),
    "weight of nothing": ("nurbs-weight-not-positive", "F60\nBSPLINE\nX1 ¦PW=0"),
    "negative weight": ("nurbs-weight-not-positive", "F60\nBSPLINE X1 ¦PW=-1"),
    "weight without a point": ("nurbs-foreign-word", "F60\nBSPLINE ¦PW=2"),
    "interval without a point": ("nurbs-foreign-word", "F60\nBSPLINE\n¦PL=2"),
    "negative interval": ("value-out-of-range", "F60\nBSPLINE\nX1 ¦PL=-1"),
    "interval of a point that completes nothing": (
        "nurbs-interval-unused",
        "F60\nBSPLINE\nX1 PL=0\nX2 ¦PL=.5\nX3 PL=1\nX4 PL=2\nM2",
    ),
    "interval of the first of degree 2": (
        "nurbs-interval-unused",
        "F60\nBSPLINE SD=2\nX1 ¦PL=.5\nX2\nX3\nM2",
    ),
    "first piece empty": ("nurbs-end-multiplicity", "F60\nBSPLINE SD=2\nX1\nX2 ¦PL=0\nX3\nM2"),
    "last piece empty": ("nurbs-end-multiplicity", "F60\nBSPLINE SD=2\nX1\nX2\nX3\nX4 ¦PL=0\nM2"),
    "torn apart": ("nurbs-position-jump", "F60\nBSPLINE SD=2\nX1\nX2\nX3 PL=0\nX4 ¦PL=0\nX5\nM2"),
    "all empty": ("nurbs-end-multiplicity", "F60\nBSPLINE SD=2\nX1 PL=0\nX2 ¦PL=0\nX3 PL=0\nM2"),
    "degree inside": ("nurbs-foreign-word", "F60\nBSPLINE\nX1 ¦SD=2"),
    "rotary axis of another machine": ("axis-missing", "F60\nBSPLINE\nX1 ¦B1"),
    "parallel axis": ("nurbs-foreign-word", "F60\nBSPLINE\nX1 ¦U1"),
    "feed inside": ("nurbs-foreign-word", "F60\nBSPLINE\nX1\nX2 ¦F90"),
    "spindle inside": ("nurbs-foreign-word", "F60\nBSPLINE\nX1\n¦M3 S100"),
    "stop inside": ("nurbs-foreign-word", "F60\nBSPLINE\nX1\n¦M0"),
    "mode inside": ("nurbs-foreign-word", "F60\nBSPLINE\nX1\n¦G91 X1"),
    "dwell inside": ("nurbs-foreign-word", "F60\nBSPLINE\nX1\n¦G4 P1"),
    "machine coordinates inside": ("nurbs-foreign-word", "F60\nBSPLINE\nX1\n¦G53 X5"),
    "spindle beside": ("nurbs-foreign-word", "F60\n¦M8 BSPLINE"),
    "machine coordinates beside": ("machine-coordinates-motion", "F60\n¦G53 BSPLINE X1"),
    "two motions": ("modal-conflict", "F60\nG1 X1 ¦BSPLINE"),
    "no use beside": ("word-unused", "F60\nBSPLINE ¦R3"),
    "inverse time": ("nurbs-wrong-mode", "G93\n¦BSPLINE X1 F1"),
    "no feed": ("feed-missing", "BSPLINE\n¦X1 Y1"),
    "no feed in the first line": ("feed-missing", "¦BSPLINE X1 Y1"),
    "PL elsewhere": ("word-unused", "F60\nG1 X1 ¦PL=1"),
    "SD alone": ("word-unused", "F60\n¦SD=3"),
    "PW after the curve": ("word-unused", f"F60\nBSPLINE\n{POLYGON}\nG1 X1 ¦PW=1"),
    "A spline": ("code-not-supported", "F60\n¦ASPLINE X1 Y1"),
    "C spline": ("code-not-supported", "F60\nN3 ¦CSPLINE"),
    "spline axes": ("code-not-supported", "¦SPLINEPATH(1,X,Y)"),
    "a natural start": ("code-not-supported", "F60\nG1 X1 ¦BNAT"),
    "a tangential end": ("code-not-supported", "F60\n¦ETAN"),
    "polynomials": ("code-not-supported", "F60\n¦POLY PO[X]=1"),
}


@pytest.mark.parametrize("name", CASES)
def test_errors_are_reported_at_their_place(name: str) -> None:
    code, marked = CASES[name]
    assert_error_at(code, marked, axes=("x", "y", "z", "a", "u"))


@pytest.mark.parametrize("dialect", ["linuxcnc", "grbl", "fanuc", "paper"])
def test_dialects_without_bspline(dialect: str) -> None:
    assert error_of("F60\nBSPLINE SD=2 X1", dialect=dialect).code == "syntax-not-in-dialect"
