"""Polar coordinates: positions, and codes that do not allow them."""

from __future__ import annotations

import math

import pytest

from tests.support.gcode.gcode_cases import (
    assert_error_at,
    block_summaries,
    error_of,
    points,
    rows,
    run,
)

HALF = f"{math.sqrt(3) / 2 * 10:.6f}"

PROGRAMS = {
    "distance and angle": ("G0 @10 ^30", [f"rapid {HALF} 5 0"]),
    "quarters are exact": (
        "G0 @1 ^90\n^180\n^-90\n^360",
        ["rapid 0 1 0", "rapid -1 0 0", "rapid 0 -1 0", "rapid 1 0 0"],
    ),
    "what is not given stays": (
        "G0 X3 Y4\n@10\n^90",
        ["rapid 3 4 0", "rapid 6 8 0", "rapid 0 10 0"],
    ),
    "an angle at the zero point": ("G0 ^90 Z1", ["rapid 0 0 1"]),
    "a negative distance": ("G0 @-5 ^0", ["rapid -5 0 0"]),
    "blanks": ("g 0 @ 1 0 ^ 3 0", [f"rapid {HALF} 5 0"]),
    "computed": ("#1=5\nG0 @[#1*2] ^#2", ["rapid 10 0 0"]),
    "increments": ("G0 X3 Y4\nG91 @5\n^90", ["rapid 3 4 0", "rapid 6 8 0", "rapid -8 6 0"]),
    "other axes": ("G1 F60 @2 ^0 Z3", ["line 2 0 3 F60"]),
    "about the zero of the system": (
        "G10 L2 P1 X10 Y1\nG0 @5 ^0\n^90",
        ["rapid 15 1 0", "rapid 10 6 0"],
    ),
    "in a turned system": ("G10 L2 P1 R90\nG0 @5 ^0", ["rapid 0 5 0"]),
    "inches": ("G20 G0 @1 ^90", ["rapid 0 25.4 0"]),
    "diameters": ("G7 G0 @5 ^0", ["rapid 5 0 0"]),
    "the end of an arc": (
        "G0 X10\nG3 @10 ^90 I-10 F60",
        ["rapid 10 0 0", "arc xy 0 0 0 10 0 10 0.25 60"],
    ),
    "a cycle": (
        "G0 Z5\nG81 @5 ^90 Z-1 R1 F60",
        ["rapid 0 0 5", "rapid 0 5 5", "rapid 0 5 1", "line 0 5 -1 F60", "rapid 0 5 5"],
    ),
    "steps of a cycle with increments": (
        "G0 X0 Y8 Z5\nG91 G99 G81 @-1 ^90 Z-1 R-4 L3 F60",
        [
            "rapid 0 8 5",
            *("rapid -7 0 5", "rapid -7 0 1", "line -7 0 0 F60", "rapid -7 0 1"),
            *("rapid 0 -6 1", "line 0 -6 0 F60", "rapid 0 -6 1"),
            *("rapid 5 0 1", "line 5 0 0 F60", "rapid 5 0 1"),
        ],
    ),
    "a probe": ("G38.2 @5 ^0 F60", ["probe 5 0 0 F60 true true"]),
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_positions(name: str) -> None:
    source, wanted = PROGRAMS[name]
    assert block_summaries(source) == wanted


def test_increments_count_from_the_polar_position() -> None:
    """A spiral: 12 steps of 30 degrees and 1 mm."""
    found = list(rows(run("G0 X1\nG91\n" + "@1 ^30\n" * 12)))[1:]
    for index, (_, x, y, _) in enumerate(found, start=1):
        assert math.hypot(x, y) == pytest.approx(1 + index)
        assert (x, y) == (
            pytest.approx((1 + index) * math.cos(math.radians(30 * index)), abs=1e-12),
            pytest.approx((1 + index) * math.sin(math.radians(30 * index)), abs=1e-12),
        )


ERRORS = {
    "an increment from the zero point": ("polar-at-origin", "G91 G0 ¦@5"),
    "a distance alone from the zero point": ("polar-at-origin", "G0 ¦@5"),
    "in another plane": ("polar-plane", "G18 G0 ¦@5 ^30"),
    "beside X": ("polar-and-axis", "G0 ¦@5 X1"),
    "beside Y": ("polar-and-axis", "G0 Y1 ¦^5"),
    "in machine coordinates": ("polar-not-here", "G53 G0 ¦@5 ^0"),
    "of an offset": ("polar-not-here", "G92 ¦@5 ^0"),
    "of a coordinate system": ("polar-not-here", "G10 L2 P1 ¦@5"),
    "on the way home": ("polar-not-here", "G28 ¦@5"),
    "of a spline": ("word-unused", "G0 X0\nG5.2 P1 ¦@5 ^0 F60"),
    "of a cycle with increments": ("polar-at-origin", "G91 G81 ¦@5 ^30 Z-1 R1 F60"),
    "twice": ("word-repeated", "G0 @5 ¦@6"),
    "without a number": ("number-missing", "G0 ¦@ ^5"),
    "without a motion code": ("motion-missing", "G2 I5 F60\nG80\n¦@5"),
}


@pytest.mark.parametrize("name", ERRORS)
def test_not_allowed(name: str) -> None:
    assert_error_at(*ERRORS[name])


@pytest.mark.parametrize(
    ("dialect", "code"), [("grbl", "syntax-not-in-dialect"), ("fanuc", "character-unknown")]
)
def test_other_dialects_have_no_polar_coordinates(dialect: str, code: str) -> None:
    assert error_of("G0 @5", dialect=dialect).code == code


def test_a_machine_without_y_has_no_polar_coordinates() -> None:
    assert error_of("G0 @5", axes=("x", "z")).code == "axis-missing"


@pytest.mark.parametrize("line", ["AP=90", "RP=5", "AP=IC(30)"])
@pytest.mark.parametrize("before", ["G0 X10 Y0", "G0 RP=10 AP=0\nX5", ""])
def test_one_polar_word_of_siemens_goes_on_from_the_last_polar_point(
    line: str, before: str
) -> None:
    """The control keeps the last AP and RP, which moves by X and Y do not change."""
    assert error_of(f"G90\n{before}\n{line}\nM30", dialect="siemens").code == "polar-word-missing"


def test_polar_increments_of_siemens() -> None:
    source = "G90 G0 RP=10 AP=0\nAP=IC(90)\nRP=IC(5)\nG91 AP=IC(90)\nG90 AP=AC(0)\nM30"
    ends = [(10, 0), (0, 10), (0, 15), (-15, 0), (15, 0)]
    assert [end[:2] for end in points(source, "siemens")] == [
        pytest.approx(end, abs=1e-9) for end in ends
    ]
