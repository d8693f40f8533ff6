"""Repeats of cycles under polar coordinates, rotation, scaling, mirror and offsets, by matrices.

Each repeat is the line once more (FANUC Series 0i operator's manual, "canned cycle for drilling",
K; LinuxCNC, "G81 to G89", L), so the places follow from the step and the transform alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.support.gcode.gcode_cases import error_of, points

Vector = NDArray[np.float64]

PLANES = {"G17": "XYZ", "G18": "ZXY", "G19": "YZX"}
"""Letters of the first and second axis of the plane and of the axis across it."""
BOTTOM = -3.0
STAR = [
    (50.0, 0.0), (25.0, 43.30127), (-25.0, 43.30127), (-50.0, 0.0), (-25.0, -43.30127),
    (25.0, -43.30127),
]  # fmt: skip
"""Six holes on a circle of 50 mm, 60 degrees apart."""
CYCLES = {
    "G73": "Q1.", "G81": "", "G82": "P100", "G83": "Q1.", "G84": "", "G85": "", "G86": "P100",
    "G89": "P100",
}  # fmt: skip


def holes(program: str, plane: str, dialect: str, **options: Any) -> list[list[float]]:
    """Return the places of the holes in the two axes of the plane, in their order."""
    i, j, k = ("XYZ".index(letter) for letter in PLANES[plane])
    found: list[list[float]] = []
    for point in points(program, dialect, **options):
        place = [point[i], point[j]]
        if abs(point[k] - BOTTOM) < 1e-9 and (not found or math.dist(found[-1], place) > 1e-6):
            found.append(place)
    return found


@pytest.mark.parametrize("plane", PLANES)
@pytest.mark.parametrize("cycle", CYCLES)
@pytest.mark.parametrize(("dialect", "repeats"), [("fanuc", "K"), ("haas", "L"), ("mach3", "L")])
def test_an_angle_repeats_about_the_pole(
    plane: str, cycle: str, dialect: str, repeats: str
) -> None:
    first, second, across = PLANES[plane]
    words = CYCLES[cycle].replace("P100", "P.1") if dialect == "mach3" else CYCLES[cycle]
    source = (
        f"{plane} G21 G90 G94 M3 S500\nG0 {across}2.\nG16\n"
        f"G99 {cycle} {first}50. {second}0 R2. {across}-3. {words} F100\n"
        f"G91 {second}60. R0 {across}-5. {repeats}5\nG15 G80"
    )
    assert holes(source, plane, dialect) == [pytest.approx(place, abs=1e-4) for place in STAR]


def test_a_radius_repeats_from_each_hole() -> None:
    """Under G91 a radius counts from the present position and the angle from the last one."""
    source = "G16\nG99 G81 X10. Y0 R2. Z-3. F100\nG91 X10. Y90. K3\nG15 G80"
    places = [(10, 0), (10, 10), (0, 10), (0, 0)]
    assert holes(source, "G17", "fanuc") == [pytest.approx(place, abs=1e-9) for place in places]


def test_polar_steps_repeat_in_a_rotated_system() -> None:
    source = "G10 L2 P1 X1 Y2 R90\nG0 @50 ^0 Z2\nG91 G99 G81 ^60 R0 Z-5 L6 F100\nG80\nM2"
    expected = [(1.0 - y, 2.0 + x) for x, y in (*STAR[1:], STAR[0])]
    assert holes(source, "G17", "linuxcnc") == [pytest.approx(p, abs=1e-4) for p in expected]


def _turn(angle: float, centre: Vector) -> Callable[[Vector], Vector]:
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    return lambda at: centre + np.array([[c, -s], [s, c]]) @ (at - centre)


CENTRE = np.array([4.0, -2.0])
TRANSFORMS: dict[str, tuple[str, Callable[[Vector], Vector]]] = {
    "rotation": ("G68 {0}4. {1}-2. R37.5", _turn(37.5, CENTRE)),
    "scaling": ("G51 {0}4. {1}-2. {I}2. {J}2. {K}1.", lambda at: CENTRE + 2.0 * (at - CENTRE)),
    "mirror": ("G51.1 {0}4.", lambda at: np.array([8.0 - at[0], at[1]])),
    "local offset": ("G52 {0}4. {1}-2.", lambda at: at + CENTRE),
}


@pytest.mark.parametrize("plane", PLANES)
@pytest.mark.parametrize("polar", [False, True])
@pytest.mark.parametrize("name", TRANSFORMS)
@pytest.mark.parametrize(("dialect", "repeats"), [("fanuc", "K"), ("haas", "L")])
def test_repeats_are_the_transform_of_the_plain_places(
    plane: str, polar: bool, name: str, dialect: str, repeats: str
) -> None:
    first, second, across = PLANES[plane]
    code, transform = TRANSFORMS[name]
    centre = dict(zip("XYZ", "IJK", strict=True))
    line = code.format(first, second, I=centre[first], J=centre[second], K=centre[across])
    step = f"{second}60." if polar else f"{first}7. {second}3."
    source = (
        f"{plane} G21 G90 G94\nG0 {across}2.\n{line}\n{'G16' if polar else ''}\n"
        f"G99 G81 {first}50. {second}0 R2. {across}-3. F100\n"
        f"G91 {step} R0 {across}-5. {repeats}5\nG15 G80"
    )
    plain = STAR if polar else [(50.0 + 7.0 * n, 3.0 * n) for n in range(6)]
    expected = [transform(np.array(place)) for place in plain]
    assert holes(source, plane, dialect) == [pytest.approx(place, abs=1e-4) for place in expected]


FRAMES: dict[str, Callable[[Vector], Vector]] = {
    "TRANS X4 Y-2": lambda at: at + CENTRE,
    "ROT RPL=90": _turn(90.0, np.zeros(2)),
    "MIRROR X0": lambda at: np.array([-at[0], at[1]]),
    "SCALE X2 Y2": lambda at: 2.0 * at,
    "TRANS X4 Y-2\nAROT RPL=37.5": lambda at: CENTRE + _turn(37.5, np.zeros(2))(at),
}


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize(
    "moves", ["HOLES2(0,0,50,0,60,6)", "G0 AP=0 RP=50\n" + "AP=IC(60)\n" * 5, None]
)
def test_a_modal_call_is_made_at_the_transformed_places(frame: str, moves: str | None) -> None:
    moves = moves or "\n".join(f"G0 X{x} Y{y}" for x, y in STAR)
    source = f"G17 G90 G71 F100 S500 M3\n{frame}\nG0 Z10\nMCALL CYCLE81(5,0,2,-3)\n{moves}\nMCALL\n"
    expected = [FRAMES[frame](np.array(place)) for place in STAR]
    assert holes(source, "G17", "siemens") == [pytest.approx(p, abs=1e-4) for p in expected]


@pytest.mark.parametrize(
    ("program", "code"),
    [
        ("G16\nG81 X0 Y0 R2. Z-3. F100\nG70 I10. J0 L3", "polar-active"),
        ("G16\nG0 X10. Y0\nG18", "polar-active"),
        ("M3 S500\nG68 X0 Y0 R90.\nG76 X1. Y0 R2. Z-3. Q1. F100", "scaling-cycle"),
        ("M3 S500\nG51.1 X0\nG76 X1. Y0 R2. Z-3. Q1. F100", "scaling-cycle"),
    ],
)
def test_what_no_controller_defines_is_refused(program: str, code: str) -> None:
    """The tip of a boring bar keeps its direction while the figure turns."""
    assert error_of(program, dialect="haas").code == code
