r"""Passes of the roughing cycles G71, G72 and G73 of lathes.

    across   A          clear      The stock lies above the profile and below A. Each pass lowers it
      |      |\_________           to max(level, profile) between two points of the level before, so
      |      | ________ \          no pass is deeper than the given depth, and no pass comes closer
      |      A'        \ B         to the profile than the allowance.
      +------------------> along

Type I has a profile that only rises. A pass goes straight to the profile and retracts at 45
degrees; the steps remain for the last pass. Type II may have pockets. A pass follows the profile
where it is above its level, so that no steps remain. Pockets are cleared one after the other, each
to its bottom.

At the end one pass follows the whole profile at the allowance. Traverses are above what was
removed: over the last pass, or at the height that clears the stock. Source: FANUC, "Operator's
Manual for Lathe System", "Multiple repetitive cycle".
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from cnc.model.blocks import ArcFeed, Block, Polyline

# Profiles of turned parts: lines and arcs, cut at levels.
#
# A point is a complex number: the real part lies along the passes and the imaginary part across
# them. :class:`View` maps machine positions to such points so that the stock lies on the side of
# larger imaginary parts, and the profile runs towards larger real parts.

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
        placed = position.copy()
        placed[self.columns[0]] = point.real * self.mirror[0]
        placed[self.columns[1]] = point.imag * self.mirror[1]
        return placed


def profile_of(blocks: Iterable[Block], start: list[float], view: View) -> Profile:
    """Return the pieces of blocks in the ZX plane from a machine position."""
    here, position = view.point(start), start
    profile: Profile = []
    for block in blocks:
        if isinstance(block, Polyline):
            for end in block.points.tolist():
                point = view.point(end)
                profile += _line(here, point)
                here, position = point, end
        elif isinstance(block, ArcFeed):
            end = block.end.tolist()
            z, x = view.z_x
            around = position.copy()
            around[z], around[x] = block.center
            turns = block.turns * view.spin
            profile += arc_pieces(here, view.point(end), view.point(around), turns)
            here, position = view.point(end), end
    return profile


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


def without_pockets(profile: Profile) -> tuple[Profile, list[Profile]]:
    """Return a profile with its pockets closed by straight lines, and the pockets.

    A pocket begins where the profile falls, and ends where it is as high again, or at the end.
    """
    closed: Profile = []
    pockets: list[Profile] = []
    level = profile[0].start.imag
    pocket: Profile = []
    for piece in profile:
        if not pocket and piece.end.imag >= level - TINY:
            closed.append(piece)
            level = max(level, piece.end.imag)
            continue
        rest: Piece | None = None
        if piece.start.imag < level - TINY and piece.end.imag > level + TINY:
            at = piece.crossing(level)
            piece, rest = replace(piece, end=at), replace(piece, start=at)
        pocket.append(piece)
        if piece.end.imag >= level - TINY:
            closed.append(Piece(pocket[0].start, piece.end))
            pockets.append(pocket)
            pocket = []
        if rest is not None:
            closed.append(rest)
            level = rest.end.imag
    if pocket:
        closed.append(Piece(pocket[0].start, complex(pocket[-1].end.real, level)))
        pockets.append(pocket)
    return closed, pockets


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


@dataclass(frozen=True, slots=True)
class Traverse:
    """A traverse to a point of the view."""

    to: complex


@dataclass(frozen=True, slots=True)
class Cut:
    """A piece that is cut at feed, or a straight approach that may be a traverse."""

    piece: Piece
    approach: bool = False


TurningStep = Traverse | Cut


@dataclass(frozen=True, slots=True)
class Roughing:
    """A roughing cycle in the view of its profile, mm.

    Attributes:
        profile: From the start point A over A' to B.
        allowance: Shift of the profile that leaves the allowance.
        depth: Largest depth of a pass.
        retract: Distance of the retract along and across.
        pockets: Whether the profile may fall (type II).
        even: Whether the passes of a section have the same depth, up to ``depth``, and the last of
            them reaches its bottom, so that no pass along the whole profile follows.
        clearance: Distance of traverses above the stock.
    """

    profile: Profile
    allowance: complex
    depth: float
    retract: float
    pockets: bool
    even: bool = False
    clearance: float = 0.0

    @property
    def shifted(self) -> Profile:
        """The profile with its allowance."""
        return shifted(self.profile, self.allowance)

    @property
    def passes(self) -> float:
        """Number of levels, which limits the number of passes."""
        profile = self.shifted
        return (profile[0].start.imag - lowest(profile)) / self.depth


def rough(cycle: Roughing) -> Iterator[TurningStep]:
    """Return the steps of G71 or G72 from the start point and back to it."""
    profile = cycle.shifted
    start = here = cycle.profile[0].start + cycle.clearance * 1j
    clear = max(highest(profile), cycle.profile[0].start.imag) + cycle.clearance
    base = profile[0].start.imag
    pending = [(run, base) for above, run in split(profile, base) if not above]
    cleared = _Cleared(start.real, start.real, clear)
    while pending:
        run, upper = pending.pop()
        bottom = lowest(run)
        level = upper - cycle.depth
        if cycle.even and upper > bottom + TINY:
            level = upper - (upper - bottom) / math.ceil((upper - bottom) / cycle.depth - TINY)
        way = _way(run, level, pockets=cycle.pockets)
        if not way or (upper <= bottom + TINY if cycle.even else bottom >= level - TINY):
            continue
        begin, end = way[0].start, way[-1].end
        yield from _approach(here, begin, profile, cleared, clear, upper + cycle.retract)
        for piece in way:
            yield Cut(piece, approach=_is_approach(piece, profile))
        here = _retracted(way, cycle.retract, straight=cycle.pockets and end.imag < upper - TINY)
        yield Traverse(here)
        cleared = _Cleared(begin.real, end.real, upper if cycle.pockets else level)
        pending += reversed([(below, level) for above, below in split(run, level) if not above])
    if not cycle.even:
        yield from _last_pass(profile, here, clear)
        here = profile[-1].end
    yield Traverse(complex(here.real, clear))
    yield Traverse(complex(profile[0].start.real, clear))
    yield Traverse(start)


class _Cleared(NamedTuple):
    """What the last pass has cleared: all above ``floor`` between two places along."""

    first: float
    last: float
    floor: float


def _way(run: Profile, level: float, *, pockets: bool) -> Profile:
    """The path of a pass: along the profile above the level, straight where it is below."""
    way: Profile = []
    for above, part in split(run, level):
        if above:
            way += part
            continue
        first = complex(part[0].start.real, level)
        last = complex(part[-1].end.real, level)
        if abs(last - first) > TINY:
            way.append(Piece(first, last))
        if not pockets:
            break
    return way


def _approach(
    here: complex, to: complex, profile: Profile, cleared: _Cleared, clear: float, above: float
) -> Iterator[TurningStep]:
    """The way to the start of a pass: over the last pass, or else above the stock.

    Args:
        here: Present position.
        to: Start of the pass.
        profile: The whole profile.
        cleared: What the last pass has cleared.
        clear: Height above the stock.
        above: Height to which a traverse may come down.
    """
    is_along = cleared.first - TINY <= to.real <= cleared.last + TINY
    is_over = is_along and to.imag <= cleared.floor + TINY
    height = max(here.imag, cleared.floor if is_over else clear)
    if abs(height - here.imag) > TINY:
        yield Traverse(complex(here.real, height))
    if abs(to.real - here.real) > TINY:
        yield Traverse(complex(to.real, height))
    if height > above + TINY:
        yield Traverse(complex(to.real, above))
        height = above
    if height > to.imag + TINY:
        last = Piece(complex(to.real, height), to)
        yield Cut(last, approach=_is_approach(last, profile) and _is_across(profile[0]))


def _is_approach(piece: Piece, profile: Profile) -> bool:
    """Whether a piece goes straight down in front of the stock, where the profile begins."""
    return abs(piece.start.real - profile[0].start.real) <= TINY and _is_across(piece)


def _is_across(piece: Piece) -> bool:
    return piece.center is None and abs(piece.end.real - piece.start.real) <= TINY


def _retracted(way: Profile, distance: float, *, straight: bool) -> complex:
    """The end of the retract at 45 degrees, or straight where the pass does not end at its top."""
    end = way[-1].end
    back = 0.0 if straight else min(distance, end.real - way[0].start.real)
    return complex(end.real - back, end.imag + distance)


def _last_pass(profile: Profile, here: complex, clear: float) -> Iterator[TurningStep]:
    """The pass along the whole profile."""
    begin = profile[0].start
    yield Traverse(complex(here.real, clear))
    yield Traverse(complex(begin.real, clear))
    if clear > begin.imag + TINY:
        yield Cut(Piece(complex(begin.real, clear), begin), approach=True)
    for piece in profile:
        yield Cut(piece, approach=_is_approach(piece, profile))


@dataclass(frozen=True, slots=True)
class Pattern:
    """The cycle G73 in the view of its profile.

    Attributes:
        profile: From the start point A over A' to B.
        allowance: Shift of the last pass.
        relief: Shift of the first pass beyond that.
        passes: Number of passes.
    """

    profile: Profile
    allowance: complex
    relief: complex
    passes: int


def repeat(cycle: Pattern) -> Iterator[TurningStep]:
    """Return the steps of G73 from the start point and back to it."""
    start = cycle.profile[0].start
    for number in range(cycle.passes):
        left = 1.0 - number / (cycle.passes - 1) if cycle.passes > 1 else 0.0
        profile = shifted(cycle.profile, cycle.allowance + left * cycle.relief)
        clear = max(highest(profile), start.imag)
        begin, end = profile[0].start, profile[-1].end
        yield Traverse(complex(begin.real, clear))
        if clear > begin.imag + TINY:
            yield Traverse(begin)
        for piece in profile:
            yield Cut(piece, approach=_is_approach(piece, profile))
        yield Traverse(complex(end.real, clear))
        yield Traverse(complex(begin.real, clear))
    yield Traverse(start)
