"""Travel of whole curves: a bulge beyond the travel is a fault, one that just fits is none."""

import math

import numpy as np
import pytest

from cnc.api import check, load_machine

MACHINE = load_machine("default")
HEAD = "G21 G90 G94 G17\nG0 X{0} Y{1} Z{2}\n"
CLOSE = 1e-3
"""mm. Distance of the limit from the farthest point of the curve, inside and outside."""


def cubic(
    points: list[tuple[float, float]], weights: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)
) -> np.ndarray:
    """Return points (n, 2) of a rational Bezier cubic by its definition."""
    t = np.linspace(0.0, 1.0, 200_001)[:, None]
    basis = np.concatenate(
        [math.comb(3, k) * t**k * (1.0 - t) ** (3 - k) for k in range(4)], axis=1
    ) * np.array(weights)
    return basis @ np.array(points) / basis.sum(axis=1, keepdims=True)


CUBIC = cubic([(50.0, 50.0), (52.0, 71.0), (80.0, 64.0), (90.0, 50.0)])
WEIGHTED = cubic([(50.0, 50.0), (50.0, 80.0), (90.0, 80.0), (90.0, 50.0)], (1.0, 2.0, 3.0, 1.0))

CURVES = [
    # start, line, axis, the farthest coordinate of the curve in that axis, whether it is the
    # largest
    ((50, 50, 0), "G2 X90 Y50 I20 F600", "y", 70.0, True),
    ((50, 50, 0), "G3 X90 Y50 I20 F600", "y", 30.0, False),
    ((50, 50, 0), "G2 X70 Y70 I20 J0 F600", "y", 70.0, True),  # a quarter that ends there
    ((50, 50, 0), "G3 X70 Y70 I0 J20 F600", "x", 70.0, True),
    ((50, 50, 0), "G3 X36 Y68 R-25 F600", "x", None, True),  # more than half a turn
    ((50, 50, 0), "G2 X50 Y50 I15 F600", "x", 80.0, True),  # all around
    ((50, 50, 0), "G2 X50 Y50 Z-3 I15 F600", "y", 65.0, True),  # helix
    ((50, 50, 0), "G18 G2 X90 Z0 I20 F600", "z", -20.0, False),
    ((50, 50, 0), "G19 G2 Y90 Z0 J20 F600", "z", 20.0, True),
    ((50, 50, 0), "G2 X50 Y50 P3 I15 F600", "x", 80.0, True),  # three turns
    ((50, 50, 0), "G5 I2 J21 P-10 Q14 X90 Y50 F600", "y", CUBIC[:, 1].max(), True),
    ((50, 50, 0), "G5 I2 J-21 P-10 Q-14 X90 Y50 F600", "y", 100.0 - CUBIC[:, 1].max(), False),
    (
        (50, 50, 0),
        "G5.1 I20 J30 X90 Y50 F600",
        "y",
        65.0,
        True,
    ),  # a parabola: half of the way to its control point
    (
        (50, 50, 0),
        "G5.2 P1 L4 F600\nX50 Y80 P2\nX90 Y80 P3\nX90 Y50 P1\nG5.3",
        "y",
        WEIGHTED[:, 1].max(),
        True,
    ),
]


def farthest(line: str, given: float | None) -> float:
    if given is not None:
        return float(given)
    # The centre lies to the left of the chord from (50, 50) to (36, 68); the far side counts.
    dx, dy, r = -14.0, 18.0, 25.0
    chord = math.hypot(dx, dy)
    off = math.sqrt(r * r - chord * chord / 4.0)
    return 50.0 + dx / 2.0 + off * dy / chord + r


@pytest.mark.parametrize(("start", "line", "axis", "reached", "up"), CURVES)
def test_a_bulge_beyond_the_travel_is_a_fault(tmp_path, start, line, axis, reached, up):
    file = tmp_path / "p.nc"
    file.write_text(HEAD.format(*start) + line + "\nM2\n")
    limit = farthest(line, reached)
    found = {}
    for beyond in (-CLOSE, CLOSE):
        least, most = (-1000.0, limit - beyond) if up else (limit + beyond, 1000.0)
        axes = {
            letter: each.model_copy(
                update={"travel": (least, most) if letter == axis else (-1000.0, 1000.0)}
            )
            for letter, each in MACHINE.axes.items()
        }
        report = check(file, MACHINE.model_copy(update={"axes": axes}))
        found[beyond] = [(fault.diagnostic.code, fault.diagnostic.line) for fault in report.faults]
        if up:  # below, the start position moves with the limit
            assert report.bounding_box[axis][1] == pytest.approx(limit, abs=1e-6)
    assert found[-CLOSE] == []
    (fault,) = found[CLOSE]
    # The fault of a spline over several lines is at its first or at its last line.
    assert fault in {("soft-limit", 3), ("soft-limit", 3 + line.count("\n"))}
