"""Figures of Mach3, and the pecks of Haas that become smaller."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from cnc.model.blocks import ArcFeed, Polyline
from tests.support.gcode.gcode_cases import error_of, points, run

MACH3 = [
    ("G90 G0 X10 Y10\nG51 X2 Y-2\nG1 X20 F9\nY5\nG50\nG1 X1", [(40, 10), (40, -10), (1, -10)]),
    ("G90 G51 X2\nG51 Y3\nG1 X1 Y1 F9", [(2, 3)]),
    ("G91 G51 X2\nG1 X1 F9\nX1", [(2, 0), (4, 0)]),
    ("G90 G68 A1 B0 R90\nG1 X2 Y0 F9\nG69\nX2 Y0", [(1, 1), (2, 0)]),
    ("G90 G68 X1 Y0 R90\nG1 X2 Y0 F9\nG69\nX2 Y0", [(1, 1), (2, 0)]),
    ("G90 G0 X10 Y10\nG16\nG1 X5 Y90 F9\nY180\nG15\nX0 Y0", [(10, 15), (5, 10), (0, 0)]),
    ("G90 G0 X1\nG12 I5 F9", [(6, 0), (1, 0)]),
]


@pytest.mark.parametrize(("program", "ends"), MACH3)
def test_figures_of_mach3(program: str, ends: list[tuple[float, float]]) -> None:
    """Axis words of G51 are factors, A and B the centre of G68; G16 counts from the position.

    Mach4 names the centre of G68 by X and Y.
    """
    reached = [end[:2] for end in points(program, "mach3")]
    assert reached[-len(ends) :] == [pytest.approx(end, abs=1e-12) for end in ends]


@pytest.mark.parametrize(
    ("program", "code"),
    [
        ("G51", "scaling-factor"),
        ("G51 X0", "scaling-factor"),
        ("G68 R90", "axis-words-missing"),
        ("G12 I5 D1 F9", "word-unused"),
    ],
)
def test_faults_of_figures_of_mach3(program: str, code: str) -> None:
    assert error_of(program, dialect="mach3").code == code


@pytest.mark.parametrize(("code", "turns"), [("G12", -1.0), ("G13", 1.0)])
def test_a_circle_of_mach3(code: str, turns: float) -> None:
    (arc,) = (each for each in run(f"{code} I5 F9", dialect="mach3") if isinstance(each, ArcFeed))
    assert (arc.center, arc.radius, arc.turns) == ((0.0, 0.0), 5.0, turns)


@pytest.mark.parametrize("code", ["G73", "G83"])
def test_pecks_of_haas_become_smaller(code: str) -> None:
    """I is the first peck, J its decrease, K the smallest one: 5, 4, 3, 2, 2, 2, 2."""
    program = f"G90 G0 Z10\nG99 {code} Z-18 R2 I5 J1 K2 F100\nX5\nG80"
    bottoms: list[float] = []
    previous = 10.0
    for x, _, z in points(program, "haas"):
        if x == 0.0 and z < previous and z not in (2.0, *(b + 0.5 for b in bottoms)):
            bottoms.append(z)
        previous = z
    assert bottoms == [-3, -7, -10, -12, -14, -16, -18]
    again = [z for x, _, z in points(program, "haas") if x == 5.0]
    assert [z for z in again if z in bottoms] == bottoms


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("I5 J1", "cycle-word-missing"),
        ("I5 J-1 K2", "value-out-of-range"),
        ("I5 J1 K6", "value-out-of-range"),
        ("I0 J1 K0", "value-out-of-range"),
        ("I5 J1 K0.001", "cycle-too-long"),
    ],
)
def test_faults_of_smaller_pecks(words: str, code: str) -> None:
    program = f"G90 G0 Z10\nG83 Z-1000 R2 {words} F100"
    assert error_of(program, dialect="haas").code == code


def test_q_takes_the_place_of_smaller_pecks() -> None:
    later = "G90 G0 Z10\nG99 G83 Z-8 R2 I5 J1 K2 F100\nX5 Q5\nG80"
    only = "G90 G0 X5 Z10\nG99 G83 Z-8 R2 Q5 F100\nG80"
    assert points(later, "haas")[-5:] == points(only, "haas")[-5:]


@pytest.mark.parametrize("seed", range(5))
def test_a_plane_without_tilt_is_moved_and_turned(seed: int) -> None:
    """The zero of G68.2 and its Euler angles about Z, X and Z, of which the second is 0."""
    draw = np.random.default_rng(seed)
    zero, point = draw.uniform(-50, 50, (2, 3))
    first, last = draw.uniform(-180, 180, 2)

    def about_z(angle: float) -> NDArray[np.float64]:
        cosine, sine = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])

    words = " ".join(f"{letter}{value:.9f}" for letter, value in zip("XYZ", zero, strict=True))
    target = " ".join(f"{letter}{value:.9f}" for letter, value in zip("XYZ", point, strict=True))
    program = (
        f"G90\nG68.2 {words} I{first:.9f} J0. K{last:.9f}\nG53.1\nG0 {target}\nG69\nG0 {target}"
    )
    ends = [
        row
        for block in run(program, dialect="fanuc")
        if isinstance(block, Polyline)
        for row in block.points
    ]
    assert ends[0] == pytest.approx(zero + about_z(first) @ about_z(last) @ point, abs=1e-6)
    assert ends[1] == pytest.approx(point, abs=1e-6)


@pytest.mark.parametrize(
    ("program", "code"),
    [
        ("G68.2 X0. Y0. Z0. I0 J30. K0", "code-not-supported"),
        ("G91\nG68.2 X1. Y0. Z0. I0 J0 K0", "rotation-incremental"),
        ("G53.1", "figure-missing"),
        ("G68.2 X1. Y0. Z0. I0 J0 K0\nG52 X1.", "figure-active"),
        ("G68.2 X1. Y0. Z0. I0 J0 K0\nG68 X0. Y0. R3.", "figure-active"),
        ("G68.2 X1. Y0. Z0. I0 J0 K0\nG68.2 X1. Y0. Z0. I0 J0 K0", "figure-active"),
    ],
)
def test_faults_of_a_plane(program: str, code: str) -> None:
    assert error_of(program, dialect="fanuc").code == code


def test_a_plane_with_turned_rotary_axes_is_refused() -> None:
    for program in ("G0 A5.\nG68.2 X0. Y0. Z0.", "G68.2 X0. Y0. Z0.\nG0 A5.\nG53.1"):
        found = error_of(program, dialect="fanuc", axes=["x", "y", "z", "a"])
        assert found.code == "code-not-supported"
