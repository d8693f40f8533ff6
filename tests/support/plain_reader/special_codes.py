"""Codes that do not move to their words: offsets, figures, reference points, pockets, patterns."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from tests.support.plain_reader.lines import NotRead

if TYPE_CHECKING:
    from tests.support.plain_reader.moves import Mover, Point

Special = Callable[["Mover", int, dict[str, float], list[float]], None]
CYCLES = {73, 74, 76, 81, 82, 83, 84, 85, 86, 88, 89}


def _dwell(mover: Mover, number: int, given: dict[str, float], codes: list[float]) -> None:
    pass


def _machine_move(mover: Mover, number: int, given: dict[str, float], codes: list[float]) -> None:
    mover.motion = next((code for code in codes if code in (0, 1)), mover.motion)
    if not mover.absolute:
        raise NotRead("G53 under G91")
    if not given.keys() & set("XYZ"):
        return
    x, y, z = (
        given[letter] * mover.unit if letter in given else mover.at[axis]
        for axis, letter in enumerate("XYZ")
    )
    mover.record(number, (x, y, z), rapid=mover.motion == 0)


def _home(mover: Mover, number: int, given: dict[str, float], codes: list[float]) -> None:
    mover.choose(80 if mover.motion in CYCLES else mover.motion)
    motions = [code for code in codes if code in (0, 1)]
    mover.motion = motions[-1] if motions else mover.motion
    passing = mover.machine(mover.target(given))
    named = [letter in given for letter in "XYZ"]
    if not any(named):
        named = [True] * 3
    x, y, z = (0.0 if home else old for home, old in zip(named, passing, strict=True))
    mover.record(number, passing, (x, y, z), rapid=True)


def _set_offset(mover: Mover, number: int, given: dict[str, float], codes: list[float]) -> None:
    if given.get("L") not in (2, 20):
        raise NotRead("G10")
    system = int(given.get("P", 0)) or mover.system
    own = mover.systems.setdefault(system, [0.0, 0.0, 0.0])
    for axis, letter in enumerate("XYZ"):
        if letter in given:
            length = given[letter] * mover.unit
            moved = mover.shift[axis] + mover.local[axis]
            own[axis] = length if given["L"] == 2 else mover.at[axis] - moved - length


def _shift(mover: Mover, number: int, given: dict[str, float], codes: list[float]) -> None:
    now = mover.programmed
    for axis, letter in enumerate("XYZ"):
        if letter in given:
            length = given[letter] * mover.unit
            if 52 in codes and mover.dialect in ("fanuc", "haas"):
                mover.local[axis] = length
            elif 52 in codes:
                mover.shift[axis] = length
            else:
                mover.shift[axis] += now[axis] + mover.local[axis] - length
                mover.local[axis] = 0.0


def _no_shift(mover: Mover, number: int, given: dict[str, float], codes: list[float]) -> None:
    mover.shift = [0.0, 0.0, 0.0]


def _probe(mover: Mover, number: int, given: dict[str, float], codes: list[float]) -> None:
    mover.record(number, mover.machine(mover.target(given)), rapid=False)


def _scale(mover: Mover, number: int, given: dict[str, float], codes: list[float]) -> None:
    factor = given["P."] if "P." in given else given["P"] / 1000
    about = [given.get(letter, 0.0) * mover.unit for letter in "XYZ"]
    mover.figure = replace(mover.figure, factors=[factor] * 3, about=about)


def _mirror(mover: Mover, number: int, given: dict[str, float], codes: list[float]) -> None:
    factors, about = list(mover.figure.factors), list(mover.figure.about)
    for axis, letter in enumerate("XYZ"):
        if letter in given:
            factors[axis] = -1.0 if 51.1 in codes else 1.0
            about[axis] = given[letter] * mover.unit
    mover.figure = replace(mover.figure, factors=factors, about=about)


def _rotate(mover: Mover, number: int, given: dict[str, float], codes: list[float]) -> None:
    if not given.keys() >= {"X", "Y"}:
        raise NotRead("G68 without its centre")
    pivot = (given["X"] * mover.unit, given["Y"] * mover.unit)
    mover.figure = replace(mover.figure, angle=given["R"], pivot=pivot)


def _pocket(mover: Mover, number: int, given: dict[str, float], codes: list[float]) -> None:
    """Go to the depth of a circular pocket; it ends at its centre."""
    mover.record(number, mover.machine(mover.target(given)), rapid=False)
    mover.moved[-1] = replace(mover.moved[-1], is_whole=False)


def _circle_of_holes(
    mover: Mover, number: int, given: dict[str, float], codes: list[float]
) -> None:
    x, y, _ = mover.programmed
    points: list[Point] = []
    for hole in range(int(given["L"])):
        angle = math.radians(given["J"] + 360 * hole / given["L"])
        radius = given["I"] * mover.unit
        place = [x + radius * math.cos(angle), y + radius * math.sin(angle), mover.programmed[2]]
        points += mover.hole_points(place)
        mover.at = points[-1]
    mover.record(number, *points, rapid=False)


SPECIAL: dict[float, Special] = {
    4: _dwell, 53: _machine_move, 28: _home, 30: _home, 10: _set_offset, 92: _shift, 52: _shift,
    92.1: _no_shift, 31: _probe, 38.2: _probe, 51: _scale, 51.1: _mirror, 50.1: _mirror,
    68: _rotate, 12: _pocket, 13: _pocket, 70: _circle_of_holes,
}  # fmt: skip
