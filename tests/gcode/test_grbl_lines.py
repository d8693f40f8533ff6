"""Lines that GRBL 1.1 refuses (gcode.c): arcs without an axis word, R too small, large N."""

from __future__ import annotations

import random
from fractions import Fraction

import numpy as np
import pytest

from tests.gcode.program.test_compiled_lines_in_programs import agree
from tests.support.gcode.gcode_cases import error_of, run
from tests.support.soak import share


@pytest.mark.parametrize(
    ("source", "code"),
    [
        ("G2 I5 F100", "axis-words-missing"),
        ("G2 Z-1 I5 F100", "axis-words-missing"),
        ("G18\nG2 Y1 I5 F100", "axis-words-missing"),
        ("F100\nG2 X5 R10\nI5", "axis-words-missing"),
        ("G0 X5\nG3 X-5 R4.999 F100", "arc-radius-too-small"),
        ("N10000001 G0 X1", "line-number-bad"),
        ("N99999999", "line-number-bad"),
    ],
)
def test_lines_that_grbl_refuses(source: str, code: str) -> None:
    """Errors 26, 32, 34 and 27. Many lines are read by compiled code, few by the interpreter."""
    assert error_of(source, dialect="grbl").code == code
    many = "\n".join(f"G0 X{n} Y0" for n in range(20))
    assert error_of(f"{many}\nG0 X0\n{source}\n{many}", dialect="grbl").code == code


@pytest.mark.parametrize(
    "source",
    ["G2 X0 Y0 I5 F100", "G2 X0 I5 F100", "G18\nG2 X0 I5 F100", "N10000000 G0 X1",
     "G0 X5\nG3 X-5 R5 F100"],
)  # fmt: skip
def test_lines_that_grbl_accepts(source: str) -> None:
    assert run(source, dialect="grbl")


def _room(x0: str, x1: str, radius: str) -> Fraction:
    """Return 4 R^2 - x^2 of the numbers that GRBL has, computed exactly."""
    start, end, r = (np.float32(value) for value in (x0, x1, radius))
    return 4 * Fraction(float(r)) ** 2 - Fraction(float(end - start)) ** 2


def test_half_circles_by_r_are_refused_by_the_rounding_of_grbl() -> None:
    """Where the exact result is far from 0 the sign is that of single precision, too."""
    draw, refused = random.Random(5), 0
    for _ in range(300):
        start, radius = round(draw.uniform(0, 200), 3), round(draw.uniform(1, 50), 3)
        words = f"{start:.3f}", f"{start + 2 * radius:.3f}", f"{radius:.3f}"
        room = _room(*words)
        if abs(room) < 4e-7 * radius * radius:
            continue
        source = f"G0 X{words[0]}\nG2 X{words[1]} R{words[2]} F100"
        if room < 0:
            refused += 1
            assert error_of(source, dialect="grbl").code == "arc-radius-too-small"
        else:
            assert run(source, dialect="grbl")
    assert refused > 10


@pytest.mark.parametrize("seed", range(share(60, 6)))
def test_both_readers_agree_on_arcs_of_grbl(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    draw = random.Random(seed)
    lines, at = ["G21 G90 F500", "G0 X0 Y0"], 0.0
    for number in range(200):
        radius = round(draw.uniform(1, 20), 3)
        to = round(at + draw.choice((2.0, 1.5)) * radius, 3)
        choices = [f"G2 X{to} R{radius}", f"G3 X{at} I{radius}", f"N{number} G1 X{to}"]
        rare = [f"I{radius}", f"G2 Z1 I{radius}", f"N{10_000_000 + number % 2} G1 X{to}"]
        line = draw.choice(rare if draw.random() < 0.005 else choices)
        lines.append(line)
        at = to if f"X{to}" in line else at
    agree(monkeypatch, lines, ("x", "y", "z"), "grbl")
