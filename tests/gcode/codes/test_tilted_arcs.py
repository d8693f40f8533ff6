"""Arcs in G18 and G19 under a rotation about Z, and in G17 under one about another axis.

The expected points are those of the circle or helix of the program, turned by a matrix.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from cnc.model.blocks import NurbsFeed, Polyline
from tests.support.gcode.gcode_cases import error_of, run
from tests.support.soak import share

Points = NDArray[np.float64]
PLANES = {"G17": "xyz", "G18": "zxy", "G19": "yzx"}


def curve(block: NurbsFeed, count: int = 201) -> Points:
    """Return points of a spline at even parameters (count, 3), by scipy."""
    numerator = np.column_stack((block.control_points * block.weights[:, None], block.weights))
    u = np.linspace(block.knots[0], block.knots[-1], count)
    found = BSpline(block.knots, numerator, block.degree)(u)
    return np.asarray(found[:, :-1] / found[:, -1:])


def turned(angle: float, axis: int = 2) -> Points:
    """Return the matrix of a rotation about an axis."""
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[np.ix_([i, j], [i, j])] = [[c, -s], [s, c]]
    return matrix


def splines(source: str, **options: Any) -> list[NurbsFeed]:
    return [block for block in run(source, **options) if isinstance(block, NurbsFeed)]


@given(
    st.sampled_from(("G18", "G19")), st.floats(1.0, 359.0), st.floats(0.5, 40.0),
    st.floats(0.0, 360.0), st.floats(1.0, 359.0), st.booleans(), st.sampled_from((0.0, 7.0)),
)  # fmt: skip
@settings(max_examples=share(500, 40), deadline=None)
def test_an_arc_is_turned_with_the_coordinate_system(
    plane: str, angle: float, radius: float, first: float, opening: float, clockwise: bool,
    rise: float,
) -> None:  # fmt: skip
    i, j, k = ("xyz".index(letter) for letter in PLANES[plane])
    centre, start, end = np.array([3.0, -2.0, 5.0]), np.zeros(3), np.zeros(3)
    last = math.radians(first - opening if clockwise else first + opening)
    first = math.radians(first)
    for point, at in ((start, first), (end, last)):
        point[:] = centre
        point[[i, j]] += radius * np.array([math.cos(at), math.sin(at)])
    end[k] += rise
    offset = centre - start
    x, y, z = (f"{letter}{value:.12f}" for letter, value in zip("XYZ", start, strict=True))
    words = " ".join(f"{letter}{value:.12f}" for letter, value in zip("XYZ", end, strict=True))
    centres = " ".join(f"{'IJK'[n]}{offset[n]:.12f}" for n in (i, j))
    source = (
        f"G10 L2 P1 X1 Y2 Z3 R{angle:.12f}\n{plane}\nG0 {x} {y} {z}\n"
        f"{'G2' if clockwise else 'G3'} {words} {centres} F600"
    )
    (block,) = splines(source)
    found = (curve(block) - [1.0, 2.0, 3.0]) @ turned(angle)
    across = found - centre
    assert np.hypot(across[:, i], across[:, j]) == pytest.approx(radius, abs=1e-9)
    angles = np.unwrap(np.arctan2(across[:, j], across[:, i]))
    swept = -math.radians(opening) if clockwise else math.radians(opening)
    assert angles[-1] - angles[0] == pytest.approx(swept, abs=1e-6)
    # A helix rises evenly with the angle.
    assert across[:, k] == pytest.approx(rise * (angles - angles[0]) / swept, abs=2e-5)
    assert block.feed == 10.0


@pytest.mark.parametrize(
    ("code", "plane", "axis"),
    [("G17 G68 X0 Y0 R30.", "G18", 2), ("G18 G68 X0 Z0 R30.", "G17", 1)],
)
@pytest.mark.parametrize("form", ["I5. J0 K0", "R5."])
def test_an_arc_is_turned_with_the_figure(code: str, plane: str, axis: int, form: str) -> None:
    """Half a circle from the zero to X10 about X5."""
    source = f"G90 G94\nG0 X0 Y0 Z0\n{code}\n{plane} G1 X0 Y0 Z0 F60\nG2 X10. Y0 Z0 {form}\nG69"
    (block,) = splines(source.replace("I5. J0 K0", "I5."), dialect="fanuc")
    found = curve(block) @ turned(30.0, axis)
    across = 1 if plane == "G18" else 2
    assert found[:, across] == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.norm(found - [5.0, 0.0, 0.0], axis=1) == pytest.approx(5.0, abs=1e-9)
    assert found[-1] == pytest.approx([10.0, 0.0, 0.0], abs=1e-9)
    # From X to Z is against, from X to Y with the sense of G3.
    side = found[100, 2] if plane == "G18" else found[100, 1]
    assert side == pytest.approx(5.0 * (-1.0 if plane == "G18" else 1.0), abs=1e-9)


def test_full_turns_and_absolute_centres() -> None:
    source = "G10 L2 P1 R20\nG18\nG0 X5 Y0 Z0\nG90.1 G3 X5 Z0 I0 K0 P3 F60\nM2"
    (block,) = splines(source, dialect="linuxcnc")
    found = curve(block) @ turned(20.0)
    assert np.hypot(found[:, 0], found[:, 2]) == pytest.approx(5.0, abs=1e-9)
    angles = np.unwrap(np.arctan2(found[:, 0], found[:, 2]))
    assert angles[-1] - angles[0] == pytest.approx(3.0 * math.tau, abs=1e-9)


def test_the_path_goes_on_from_a_tilted_arc() -> None:
    """Half a circle of 5 mm, a line of 3 mm and a quarter of 3 mm, to the last bit."""
    first, half, line, quarter = run(
        "G10 L2 P1 R33\nG18\nG0 X5\nG3 X-5 R5 F60\nG1 X-8\nG2 X-5 Z3 R3"
    )
    assert isinstance(first, Polyline)
    assert isinstance(half, NurbsFeed)
    assert isinstance(line, Polyline)
    assert isinstance(quarter, NurbsFeed)
    assert half.control_points[0].tolist() == first.points[-1].tolist()
    assert quarter.control_points[0].tolist() == line.points[-1].tolist()
    for block, length in ((half, 5.0 * math.pi), (quarter, 1.5 * math.pi)):
        steps = np.diff(curve(block, 20_001), axis=0)
        assert np.linalg.norm(steps, axis=1).sum() == pytest.approx(length, rel=1e-7)


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("G2 X10 F60", "arc-center-missing"),
        ("G2 X10 R1 F60", "arc-radius-too-small"),
        ("G2 X10 I1 F60", "arc-radius-mismatch"),
        ("G41.1 D1", "arc-rotated"),
    ],
)
def test_errors_in_a_tilted_plane(line: str, code: str) -> None:
    assert error_of(f"G10 L2 P1 R30\nG18\n{line}").code == code
