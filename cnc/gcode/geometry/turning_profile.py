"""Profiles of turned parts: lines and arcs, cut at levels.

A point is a complex number: the real part lies along the passes and the imaginary part across
them. :class:`View` maps machine positions to such points so that the stock lies on the side of
larger imaginary parts, and the profile runs towards larger real parts.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from cnc.model.blocks import ArcFeed, Block, Polyline

SLACK = 2e-3
"""Largest motion against the direction of a profile, mm: rounding of arcs in the program."""
TINY = 1e-9
"""Lengths below this are rounding, mm."""
_QUARTER = math.pi / 2


@dataclass(frozen=True, slots=True)
class Piece:
    """A line, or an arc within one quadrant of its circle.

    Attributes:
        start: First point.
        end: Last point.
        center: Centre of an arc; None for a line.
        spin: Direction of an arc, counter-clockwise positive.
    """

    start: complex
    end: complex
    center: complex | None = None
    spin: int = 0

    @property
    def turns(self) -> float:
        """Signed number of turns of an arc."""
        assert self.center is not None
        swept = cmath.phase((self.end - self.center) / (self.start - self.center))
        if swept * self.spin < 0.0:
            swept += self.spin * math.tau
        return swept / math.tau

    def crossing(self, level: float) -> complex:
        """Return the point at a level between the two ends."""
        start, end = self.start, self.end
        if self.center is None:
            share = (level - start.imag) / (end.imag - start.imag)
            return complex(start.real + share * (end.real - start.real), level)
        rise = level - self.center.imag
        reach = math.sqrt(max(abs(start - self.center) ** 2 - rise * rise, 0.0))
        right = (start.real + end.real) / 2.0 >= self.center.real
        along = self.center.real + (reach if right else -reach)
        low, high = sorted((start.real, end.real))
        return complex(min(max(along, low), high), level)

    def shifted(self, by: complex) -> Piece:
        """Return the piece at another place."""
        center = None if self.center is None else self.center + by
        return Piece(self.start + by, self.end + by, center, self.spin)


Profile = list[Piece]


@dataclass(frozen=True, slots=True)
class View:
    """Map between machine positions and points.

    Attributes:
        columns: Columns of the axis along the passes and of the one across them.
        mirror: Direction of each, 1 or -1.
        z_along: Whether the passes are along Z, else along X.
    """

    columns: tuple[int, int]
    mirror: tuple[int, int]
    z_along: bool

    @property
    def spin(self) -> int:
        """Factor between a turn in the ZX plane and one of the view."""
        return self.mirror[0] * self.mirror[1] * (1 if self.z_along else -1)

    @property
    def z_x(self) -> tuple[int, int]:
        """Columns of Z and X."""
        along, across = self.columns
        return (along, across) if self.z_along else (across, along)

    def point(self, position: Iterable[float]) -> complex:
        """Return the point of a machine position."""
        values = list(position)
        along, across = (
            values[column] * sign for column, sign in zip(self.columns, self.mirror, strict=True)
        )
        return complex(along, across)

    def placed(self, position: list[float], point: complex) -> list[float]:
        """Return a machine position with its two axes at a point."""
        found = position.copy()
        found[self.columns[0]] = point.real * self.mirror[0]
        found[self.columns[1]] = point.imag * self.mirror[1]
        return found


def profile_of(blocks: Iterable[Block], start: list[float], view: View) -> Profile:
    """Return the pieces of blocks in the ZX plane from a machine position."""
    here, position = view.point(start), start
    found: Profile = []
    for block in blocks:
        if isinstance(block, Polyline):
            for end in block.points.tolist():
                point = view.point(end)
                found += _line(here, point)
                here, position = point, end
        elif isinstance(block, ArcFeed):
            end = block.end.tolist()
            z, x = view.z_x
            around = position.copy()
            around[z], around[x] = block.center
            turns = block.turns * view.spin
            found += arc_pieces(here, view.point(end), view.point(around), turns)
            here, position = view.point(end), end
    return found


def _line(start: complex, end: complex) -> Profile:
    return [Piece(start, end)] if abs(end - start) > TINY else []


def arc_pieces(start: complex, end: complex, center: complex, turns: float) -> Profile:
    """Return an arc as pieces of one quadrant each.

    The centre is moved so that both ends lie on the circle.
    """
    chord = end - start
    if abs(chord) <= TINY:
        return []
    normal = 1j * chord / abs(chord)
    middle = (start + end) / 2.0
    distance = ((center - middle) * normal.conjugate()).real
    center = middle + distance * normal
    spin = 1 if turns > 0.0 else -1
    whole = Piece(start, end, center, spin)
    begin, radius = cmath.phase(start - center), abs(start - center)
    sweep = whole.turns * math.tau
    angles = sorted(
        (
            k * _QUARTER
            for k in range(-8, 9)
            if 1e-9 < (k * _QUARTER - begin) * spin < abs(sweep) - 1e-9
        ),
        key=lambda angle: angle * spin,
    )
    points = [start, *(center + cmath.rect(radius, angle) for angle in angles), end]
    return [Piece(a, b, center, spin) for a, b in pairwise(points) if abs(b - a) > TINY]


def shifted(profile: Profile, by: complex) -> Profile:
    """Return a profile at another place."""
    return [piece.shifted(by) for piece in profile]


def lowest(profile: Profile) -> float:
    """Return the lowest level of a profile, at the end of a piece."""
    return min(min(piece.start.imag, piece.end.imag) for piece in profile)


def highest(profile: Profile) -> float:
    """Return the highest level of a profile."""
    return max(max(piece.start.imag, piece.end.imag) for piece in profile)


def is_monotone(values: Iterable[float]) -> bool:
    """Whether values never fall by more than the slack below one before."""
    most = -math.inf
    for value in values:
        if value < most - SLACK:
            return False
        most = max(most, value)
    return True


def split(profile: Profile, level: float) -> Iterator[tuple[bool, Profile]]:
    """Yield the runs of a profile at or above a level (True) and below it (False), in order."""
    run: Profile = []
    above: bool | None = None
    for piece in profile:
        for part in _parts(piece, level):
            is_above = (part.start.imag + part.end.imag) / 2.0 >= level - TINY
            if above is not None and is_above != above:
                yield above, run
                run = []
            above = is_above
            run.append(part)
    if above is not None:
        yield above, run


def _parts(piece: Piece, level: float) -> Profile:
    low, high = sorted((piece.start.imag, piece.end.imag))
    if not low + TINY < level < high - TINY:
        return [piece]
    at = piece.crossing(level)
    return [replace(piece, end=at), replace(piece, start=at)]


def arc_block(
    piece: Piece, view: View, position: list[float], place: tuple[str, int], feed: float
) -> ArcFeed:
    """Return the canonical arc of a piece in the ZX plane.

    Args:
        piece: An arc.
        view: The map to machine positions.
        position: (axes,) machine position before the arc.
        place: File and line.
        feed: mm/s.
    """
    assert piece.center is not None
    center = view.placed(position, piece.center)
    z, x = view.z_x
    return ArcFeed(
        *place,
        "ZX",
        (center[z], center[x]),
        np.array(view.placed(position, piece.end)),
        abs(piece.start - piece.center),
        piece.turns * view.spin,
        feed,
    )
