"""Random programs of moves, arcs, cycles, units, distance modes and offsets."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable

HEADS = {
    "fanuc": "O1000",
    "haas": "O01000",
    "mach3": "N10 G71G91.1",
    "linuxcnc": "#<a>=1",
    "grbl": "; GRBL",
    "auto": "",
}
"""A first line by which each dialect is recognised."""
_PLANES = {"G17": ("XY", "IJ", "Z"), "G18": ("ZX", "KI", "Y"), "G19": ("YZ", "JK", "X")}


def program(rng: random.Random, dialect: str) -> list[str]:
    """Return the lines of a program for a dialect."""
    lines = [HEADS[dialect], "G21 G90 G17 G94", "G0 X1. Y2. Z30.", "F100."]
    kinds = [*_KINDS, _full_circle, _cycles, _local]
    if dialect == "grbl":
        kinds = [*_KINDS, _circle_with_end]
    for _ in range(rng.randint(5, 20)):
        lines += rng.choice(kinds)(rng)
    return [*lines, "M30"]


def _number(rng: random.Random, low: float = -20.0, high: float = 20.0) -> str:
    return f"{rng.uniform(low, high):.3f}"


def _words(rng: random.Random, letters: Iterable[str]) -> str:
    return " ".join(letter + _number(rng) for letter in letters)


def _straight(rng: random.Random) -> list[str]:
    first = f"{rng.choice(('G0', 'G1', 'g01', 'G00'))} {_words(rng, rng.sample('XYZ', 2))}"
    feed = rng.choice(("", f" F{_number(rng, 50, 900)}"))
    more = [_words(rng, rng.sample("XYZ", rng.randint(1, 3))) for _ in range(rng.randint(0, 3))]
    return [first + feed, *more]


def _full_circle(rng: random.Random) -> list[str]:
    plane, (_, centre, across) = rng.choice(list(_PLANES.items()))
    rise = rng.choice(("", f" {across}{_number(rng)}"))
    return [f"{plane} {rng.choice(('G2', 'G3'))} {_words(rng, centre)}{rise}", "G17"]


def _circle_with_end(rng: random.Random) -> list[str]:
    """Return a full circle with an axis word of its plane, which GRBL needs."""
    plane, (axes, centre, across) = rng.choice(list(_PLANES.items()))
    rise = rng.choice(("", f" {across}{_number(rng)}"))
    code = rng.choice(("G2", "G3"))
    return [f"{plane} G91 {code} {axes[0]}0 {_words(rng, centre)}{rise}", "G90 G17"]


def _radius_arc(rng: random.Random) -> list[str]:
    plane, (axes, _, across) = rng.choice(list(_PLANES.items()))
    ends = " ".join(axis + _number(rng, 1, 5) for axis in axes)
    rise = rng.choice(("", f" {across}{_number(rng)}"))
    radius = rng.choice(("", "-")) + _number(rng, 6, 20)
    return [f"{plane} G91 {rng.choice(('G2', 'G3'))} {ends}{rise} R{radius}", "G90 G17"]


def _mode(rng: random.Random) -> list[str]:
    return [rng.choice(("G20", "G21", "G90", "G91", "G54", "G55", "G56"))]


def _offset(rng: random.Random) -> list[str]:
    return [rng.choice(("G92", f"G90 G10 L2 P{rng.randint(1, 3)}")) + " " + _words(rng, "Y")]


def _local(rng: random.Random) -> list[str]:
    return [f"G52 {_words(rng, rng.choice('XYZ'))}"]


def _machine(rng: random.Random) -> list[str]:
    return [f"{rng.choice(('G90 G53 G0', 'G28'))} {_words(rng, rng.choice('XYZ'))}"]


def _cycles(rng: random.Random) -> list[str]:
    code, words = rng.choice(
        (("G81", ""), ("G82", " P1"), ("G83", " Q2."), ("G73", " Q2."), ("G85", ""))
    )
    heights = f"Z{_number(rng, -20, -5)} R{_number(rng, 0, 9)}"
    holes = [_words(rng, rng.choice(("X", "Y", "XY"))) for _ in range(rng.randint(0, 3))]
    ends = ["G80", rng.choice(("G0 Z30.", "G1 X0."))]
    return [
        rng.choice(("G90 G17", "G90 G17 G0 Z30.")),
        f"{rng.choice(('G98', 'G99'))} {code} {_words(rng, 'XY')} {heights}{words}",
        *holes,
        f"{rng.choice(('G98', 'G99'))} {_words(rng, 'X')}",
        *ends,
    ]


_KINDS: list[Callable[[random.Random], list[str]]] = [
    _straight, _straight, _radius_arc, _mode, _mode, _offset, _machine,
]  # fmt: skip
