"""Errors in splines, each with its line and column. The mark ¦ is before the place of the error."""

from __future__ import annotations

import pytest

from tests.support.gcode.gcode_cases import assert_error_at

FEED = "F60\n"
OPEN = "F60\nG5.2 P1 L3\nX0 Y1\n"
LEFT = "F60\nG41.1 D2\nG1 X5 Y5\n"
FANUC = "G06.2 P2 K0 X0 Y0 F60\n"
PAPER = "G06.2 K1 U0 X0 Y0 F60\n"

CASES: dict[str, tuple[str, str]] = {
    # G5
    "P missing": ("spline-control-point-missing", FEED + "G5 X1 Y1 I0 J3 ¦Q1"),
    "Q missing": ("spline-control-point-missing", FEED + "G5 X1 Y1 I0 J3 ¦P1"),
    "P and Q missing": ("spline-control-point-missing", FEED + "¦G5 X1 Y1 I0 J3"),
    "I without J": ("spline-control-point-missing", FEED + "G5 X1 Y1 ¦I0 P1 Q1"),
    "J without I": ("spline-control-point-missing", FEED + "G5 X1 Y1 ¦J0 P1 Q1"),
    "I K of the wrong plane": ("spline-control-point-missing", FEED + "G5 X1 Y1 ¦I0 K0 P1 Q1"),
    "nothing before to go on from": ("spline-tangent-missing", FEED + "¦G5 X1 Y1 P1 Q1"),
    "no end point": ("axis-words-missing", FEED + "¦G5 I0 J3 P0 Q-3"),
    "an axis across the plane": ("spline-axis", FEED + "G5 X1 Y1 ¦Z1 I0 J3 P0 Q-3"),
    "an axis across another plane": ("spline-axis", FEED + "G18 G5 X1 ¦Y1 I0 K3 P0 Q-3"),
    "a rotary axis": ("spline-axis", FEED + "G5 X1 ¦A1 Y1 I0 J3 P0 Q-3"),
    "an offset across the plane": ("word-unused", FEED + "G5 X1 Y1 I0 J3 ¦K1 P0 Q-3"),
    "a radius": ("word-unused", FEED + "G5 X1 Y1 I0 J3 P0 Q-3 ¦R1"),
    "a word twice": ("word-repeated", FEED + "G5 X1 Y1 I0 J3 P0 Q-3 ¦P0"),
    "no feed": ("feed-missing", "¦G5 X1 Y1 I0 J3 P0 Q-3"),
    "no feed, modal": ("feed-missing", "G5 X1 Y1 I0 J3 P0 Q-3 F60\nG93\nG94\n¦X2 Y2 P0 Q0"),
    "no feed of its own under G93": ("feed-missing", FEED + "G93\n¦G5 X1 Y1 I0 J3 P0 Q-3"),
    "a P for two": ("word-wanted-twice", FEED + "G4 ¦P1 G5 X1 Y1 I0 J3 Q-3"),
    "machine coordinates": ("machine-coordinates-motion", FEED + "¦G53 G5 X1 Y1 I0 J3 P0 Q-3"),
    "two motions": ("modal-conflict", FEED + "G5 X1 Y1 I0 J3 P0 Q-3 ¦G1"),
    # G5.1
    "no offset": ("spline-control-point-missing", FEED + "¦G5.1 X1 Y1"),
    "no offset but 0": ("spline-control-point-missing", FEED + "G5.1 X1 Y1 ¦I0 J0"),
    "an offset of another plane": ("spline-control-point-missing", FEED + "G19 ¦G5.1 Z1 Y1 I3"),
    "no end point, quadratic": ("axis-words-missing", FEED + "¦G5.1 I1 J1"),
    "an axis across the plane, quadratic": ("spline-axis", FEED + "G5.1 ¦Z1 X1 I1"),
    "P and Q, quadratic": ("word-unused", FEED + "G5.1 X1 I1 ¦P1 Q1"),
    # G5.2, G5.3
    "too few points": ("nurbs-too-few-points", OPEN + "¦G5.3"),
    "too few points of a higher order": (
        "nurbs-too-few-points",
        FEED + "G5.2 L5\nX1 Y1\nX2 Y2\nX3 Y3\n¦G5.3",
    ),
    "no points": ("nurbs-too-few-points", FEED + "G5.2 L2\n¦G5.3"),
    "not open": ("nurbs-not-open", FEED + "G1 X1\n¦G5.3"),
    "closed twice": ("nurbs-not-open", OPEN + "X1 Y1\nG5.3\n¦G5.3"),
    "order too small": ("value-out-of-range", FEED + "G5.2 ¦L1"),
    "order too large": ("value-out-of-range", FEED + "G5.2 P1 ¦L11"),
    "fractional order": ("value-out-of-range", FEED + "G5.2 P1 ¦L2.5"),
    "weight of nothing": ("nurbs-weight-not-positive", OPEN + "X1 Y1 ¦P0"),
    "negative weight": ("nurbs-weight-not-positive", FEED + "G5.2 ¦P-1 L3"),
    "weight without a point": ("nurbs-foreign-word", OPEN + "¦P2"),
    "order inside": ("nurbs-foreign-word", OPEN + "X1 Y1 ¦L4"),
    "one axis is no point": ("nurbs-point-incomplete", FEED + "G5.2\n¦X1 P1"),
    "an axis too few": ("nurbs-mixed-axes", OPEN + "¦X1 P1"),
    "an axis too many": ("nurbs-mixed-axes", OPEN + "X1 Y1 ¦Z1"),
    "another axis": ("nurbs-mixed-axes", OPEN + "X1 ¦Z1"),
    "rotary axis in a block": ("nurbs-rotary-axis", OPEN + "X1 Y1 ¦A1"),
    "parallel axis in a block": ("nurbs-foreign-word", OPEN + "X1 Y1 ¦U1"),
    "spindle inside": ("nurbs-foreign-word", OPEN + "¦M3 S100"),
    "speed inside": ("nurbs-foreign-word", OPEN + "X1 Y1 ¦S100"),
    "mode inside": ("nurbs-foreign-word", OPEN + "¦G91 X1 Y1"),
    "dwell inside": ("nurbs-foreign-word", OPEN + "¦G4 P1"),
    "optional stop inside": ("nurbs-foreign-word", OPEN + "¦M1"),
    "left by a move": ("nurbs-left-early", OPEN + "X1 Y1\n¦G1 X5"),
    "left by the end of the program": ("nurbs-left-early", OPEN + "X1 Y1\n¦M2"),
    "left by the end of the file": ("nurbs-left-early", "F60\n¦G5.2 P1 L3\nX0 Y1\nX1 Y1"),
    "left by a percent sign": ("nurbs-left-early", "%\nF60\n¦G5.2 P1 L3\nX0 Y1\nX1 Y1\n%"),
    "axis words beside the end": ("nurbs-foreign-word", OPEN + "X1 Y1\nG5.3 ¦X1 Y1"),
    "M2 beside the end": ("nurbs-foreign-word", OPEN + "X1 Y1\nG5.3 ¦M2"),
    "no feed of a block": ("feed-missing", "G5.2\nX0 Y1\nX1 Y1\n¦G5.3"),
    "no feed of a block under G93": ("feed-missing", "F60\nG93\n¦G5.2\nX0 Y1\nX1 Y1\nG5.3"),
    "another feed inside under G93": ("nurbs-foreign-word", "G93\nG5.2 F1\nX0 Y1 ¦F1\nX1 Y1\nG5.3"),
    "feed of nothing": ("feed-not-positive", OPEN + "X1 Y1 ¦F0"),
    "spindle beside the opening": ("nurbs-foreign-word", FEED + "S100 ¦M3 G5.2 P1 L3"),
    "tool beside the opening": ("nurbs-foreign-word", FEED + "¦T1 G5.2 P1 L3"),
    "dwell beside the opening": ("word-wanted-twice", FEED + "G4 ¦P1 G5.2 X1 Y1 L3"),
    "no use in the opening": ("word-unused", FEED + "G5.2 P1 L3 ¦R5"),
    # under cutter compensation
    "compensated G5": ("compensation-active", LEFT + "¦G5 X9 Y9 I1 J1 P1 Q1"),
    "compensated G5.1": ("compensation-active", LEFT + "¦G5.1 X9 I1"),
    "compensated G5.2": ("compensation-active", LEFT + "¦G5.2 L2\nX9 Y9\nG5.3"),
    "compensated BSPLINE": ("compensation-active", LEFT + "¦BSPLINE SD=2\nX9\nX8 Y8"),
    "compensated G6.2, FANUC's form": ("fanuc-1006", LEFT + "¦G6.2 P2 K0\nK0 X9\nK1\nK1"),
    "compensated G6.2, the paper's form": (
        "nurbs-wrong-mode",
        LEFT + "¦G6.2 K1 U0 X5 Y5\nU0 X9\nU1\nU1",
    ),
    "the way out of compensation": ("compensation-exit", LEFT + "X9\nG40\n¦G5.1 X5 I1"),
    "compensation inside": ("nurbs-foreign-word", OPEN + "¦G41.1 D2"),
    # G6.2
    "paper's form without its first knot": (
        "nurbs-knot-missing",
        "¦G6.2 X0 Y0 F60\nU0 X1 Y1\nU1\nU1",
    ),
    "paper's form with a degree, without its first knot": (
        "nurbs-knot-missing",
        "¦G6.2 K2 X0 Y0 F60\nU0 X1 Y1 W1\nU1\nU1",
    ),
    "FANUC's form told by the second line": (
        "nurbs-foreign-word",
        "G6.2 X0 Y0 F60\nK0 X1 Y1\n¦U0 X2 Y2",
    ),
    "coolant beside G6.2": ("nurbs-foreign-word", "¦M8 G6.2 P2 K0 X0 Y0 F60"),
    "dwell beside G6.2": ("nurbs-foreign-word", "¦G4 P1 G6.2 K1 U0 X0 Y0 F60"),
    "tool beside G6.2": ("nurbs-foreign-word", "¦T3 G6.2 P2 K0 X0 Y0 F60"),
    "still in effect": ("nurbs-still-active", PAPER + "U0 X1\nU1\nU1\n¦X5 Y5"),
    "G5.2 inside": ("fanuc-1005", FANUC + "K0 X1\n¦G5.2 P1"),
    "G5.3 inside": ("nurbs-left-early", PAPER + "U0 X1\n¦G5.3"),
}


@pytest.mark.parametrize("name", CASES)
def test_errors_are_reported_at_their_place(name: str) -> None:
    code, marked = CASES[name]
    assert_error_at(code, marked, axes=("x", "y", "z", "a", "u"))


def test_an_axis_that_the_machine_lacks() -> None:
    assert_error_at("axis-missing", "G5 X1 ¦Y1 I0 J3 P0 Q-3 F60", axes=("x", "z"))
    assert_error_at("axis-missing", "G5 X1 I0 ¦J3 P0 Q-3 F60", axes=("x", "z"))
    assert_error_at("axis-missing", "G5.2 F60\nX1 ¦Y1", axes=("x", "z"))
