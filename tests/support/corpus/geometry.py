"""Random geometry of the corpus: profiles of lines and arcs, and holes."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

Format = Callable[[float], str]


def point(value: float) -> str:
    """Return a number as FANUC posts write it: ``5.``, ``-0.25``."""
    text = f"{value:.4f}".rstrip("0")
    return "0." if text in ("-0.", "0.") else text


def fixed(digits: int) -> Format:
    """Return the format with a fixed number of digits."""
    return lambda value: f"{value + 0.0 if round(value, digits) else 0.0:.{digits}f}"


def profile(rng: random.Random, number: Format, *, feed: str, k: bool = False) -> list[str]:
    """Return a rounded rectangle with arcs, as lines of a program from its first corner on."""
    x, y = rng.uniform(5, 40), rng.uniform(5, 40)
    w, h = rng.uniform(30, 80), rng.uniform(30, 80)
    r = rng.uniform(1, 10)
    lines = [f"G1 Y{number(y + h - r)} {feed}"]
    centre = " K0." if k else ""
    corners = [
        (x + r, y + h, r, 0.0, x + w - r, y + h),
        (x + w, y + h - r, 0.0, -r, x + w, y + r),
        (x + w - r, y, -r, 0.0, x + r, y),
        (x, y + r, 0.0, r, x, y + r),
    ]
    for ex, ey, i, j, lx, ly in corners:
        lines.append(f"G2 X{number(ex)} Y{number(ey)} I{number(i)} J{number(j)}{centre}")
        lines.append(f"G1 X{number(lx)} Y{number(ly)}")
    return [f"G0 X{number(x)} Y{number(y + r)}", *lines]


def holes(rng: random.Random) -> list[tuple[float, float]]:
    """Return the places of some holes on a circle."""
    count, radius, turn = rng.randint(3, 8), rng.uniform(10, 30), rng.random()
    angles = [math.tau * (turn + hole / count) for hole in range(count)]
    return [
        (round(60 + radius * math.cos(a), 3), round(60 + radius * math.sin(a), 3)) for a in angles
    ]


def short_moves(rng: random.Random, number: Format) -> list[str]:
    """Return a finishing pass of short moves."""
    phase = rng.random()
    return [
        f"X{number(10 + step * 0.4)} Y{number(30 + 8 * math.sin(phase + step / 9))}"
        f" Z{number(-1 - 0.5 * math.cos(step / 14))}"
        for step in range(1, rng.randint(30, 90))
    ]
