"""Rotation, scaling and mirroring of figures, compared with matrices and with moves by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.gcode.core.coordinates import Transform
from cnc.model.blocks import ArcFeed, Polyline
from tests.support.gcode.gcode_cases import run
from tests.support.soak import share

NUMBERS = st.floats(-100.0, 100.0).map(lambda value: round(value, 3))
ANGLES = st.floats(-720.0, 720.0).map(lambda value: round(value, 2))
FACTORS = st.sampled_from((-2.0, -1.0, -0.5, 0.5, 1.0, 3.0))
POINTS = st.tuples(NUMBERS, NUMBERS, NUMBERS).map(list)


@given(
    POINTS, st.tuples(FACTORS, FACTORS, FACTORS), POINTS, ANGLES, st.tuples(NUMBERS, NUMBERS),
    st.sampled_from(((0, 1), (2, 0), (1, 2))),
)  # fmt: skip
@settings(max_examples=share(2000, 17), deadline=None)
def test_a_point_goes_where_matrices_take_it_and_back(
    point: list[float],
    factors: tuple[float, float, float],
    fixed: list[float],
    angle: float,
    centre: tuple[float, float],
    plane: tuple[int, int],
) -> None:
    transform = Transform(factors, tuple(fixed), plane, centre, angle)
    i, j = plane
    turn = np.eye(3)
    radians = np.radians(angle)
    turn[np.ix_([i, j], [i, j])] = [
        [np.cos(radians), -np.sin(radians)], [np.sin(radians), np.cos(radians)],
    ]  # fmt: skip
    middle = np.zeros(3)
    middle[[i, j]] = centre
    scaled = np.array(fixed) + np.diag(factors) @ (np.array(point) - fixed)
    expected = middle + turn @ (scaled - middle)
    assert transform.point(point) == pytest.approx(expected, abs=1e-9)
    assert transform.original(transform.point(point)) == pytest.approx(point, abs=1e-8)
    assert transform.vector(point) == pytest.approx(
        turn @ np.diag(factors) @ np.array(point), abs=1e-9
    )


def ends(source: str, **options: Any) -> list[tuple[float, ...]]:
    """Return the ends of all moves."""
    found: list[tuple[float, ...]] = []
    for block in run(source, **options):
        if isinstance(block, Polyline):
            found += [tuple(point) for point in block.points.tolist()]
        elif isinstance(block, ArcFeed):
            found.append(tuple(block.end.tolist()))
    return found


SHAPE = "G0 X12. Y3.\nG1 X20. Y5. F100\nG3 X25. Y10. R5.\nG91 G1 X-3. Y4.\nG2 X2. Y2. I2. J0.\nG90"


@pytest.mark.parametrize("angle", [90.0, 37.5, -120.0])
def test_a_rotated_program_is_the_rotation_of_its_ends(angle: float) -> None:
    plain = np.array(ends(SHAPE))
    turned = np.array(ends(f"G68 X4. Y-2. R{angle}\n{SHAPE}"))
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    expected = plain.copy()
    expected[:, :2] = [4.0, -2.0] + (plain[:, :2] - [4.0, -2.0]) @ np.array([[c, s], [-s, c]])
    assert turned == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("code", "factors", "fixed"),
    [
        ("G51 X2. Y3. P2.", (2.0, 2.0, 2.0), (2.0, 3.0, 0.0)),
        ("G51 X0 Y0 I-1. J-1.", (-1.0, -1.0, 1.0), (0.0, 0.0, 0.0)),
        ("G51.1 X5.", (-1.0, 1.0, 1.0), (5.0, 0.0, 0.0)),
        ("G51.1 X5. Y1.", (-1.0, -1.0, 1.0), (5.0, 1.0, 0.0)),
    ],
)
def test_a_scaled_program_is_the_scale_of_its_ends(
    code: str, factors: tuple[float, ...], fixed: tuple[float, ...]
) -> None:
    plain = np.array(ends(SHAPE))
    found = np.array(ends(f"{code}\n{SHAPE}"))
    assert found == pytest.approx(np.array(fixed) + (plain - fixed) * factors, abs=1e-9)


def test_mirrored_arcs_turn_the_other_way_and_compensation_keeps_its_side() -> None:
    (arc,) = [
        block for block in run("G51.1 X0\nG2 X10. Y0 I5. J0 F60") if isinstance(block, ArcFeed)
    ]
    assert arc.turns == 0.5
    source = "G41.1 D2. G1 X0 Y10. F60\nY20.\nG40 X0 Y30."
    plain = ends(f"G0 X0 Y0\n{source}")
    mirrored = ends(f"G51.1 X0\nG0 X0 Y0\n{source}")
    assert plain[2][0] == pytest.approx(-1.0)
    assert mirrored[2][0] == pytest.approx(1.0)


def test_a_corner_is_tangent_to_both_moves() -> None:
    """The arc of ,R touches both lines: its centre is R from each."""
    for end in ((17.0, 9.0), (3.0, 8.0), (14.0, -6.0)):
        blocks = run(f"G1 X10. F60 ,R1.5\nX{end[0]} Y{end[1]}\nM2")
        (arc,) = [block for block in blocks if isinstance(block, ArcFeed)]
        x, y = arc.center
        ux, uy = end[0] - 10.0, end[1]
        length = math.hypot(ux, uy)
        assert abs(y) == pytest.approx(1.5)
        assert abs((x - 10.0) * uy - y * ux) / length == pytest.approx(1.5)
        assert arc.radius == 1.5
