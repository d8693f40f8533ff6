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

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from cnc.gcode.geometry.turning_profile import (
    TINY,
    Piece,
    Profile,
    highest,
    lowest,
    shifted,
    split,
)

MOST_PASSES = 10_000


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
    """

    profile: Profile
    allowance: complex
    depth: float
    retract: float
    pockets: bool

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
    start = here = cycle.profile[0].start
    clear = max(highest(profile), start.imag)
    base = profile[0].start.imag
    pending = [(run, base) for above, run in split(profile, base) if not above]
    cleared = _Cleared(start.real, start.real, clear)
    while pending:
        run, upper = pending.pop()
        level = upper - cycle.depth
        way = _way(run, level, pockets=cycle.pockets)
        if not way or lowest(run) >= level - TINY:
            continue
        begin, end = way[0].start, way[-1].end
        yield from _approach(here, begin, profile, cleared, upper + cycle.retract)
        for piece in way:
            yield Cut(piece, approach=_is_approach(piece, profile))
        here = _retracted(way, cycle.retract, straight=cycle.pockets and end.imag < upper - TINY)
        yield Traverse(here)
        cleared = _Cleared(begin.real, end.real, upper if cycle.pockets else level)
        pending += reversed([(below, level) for above, below in split(run, level) if not above])
    yield from _last_pass(profile, here, clear)
    last = profile[-1].end
    yield Traverse(complex(last.real, clear))
    yield Traverse(complex(profile[0].start.real, clear))
    yield Traverse(start)


class _Cleared(NamedTuple):
    """What the last pass has cleared: all above ``floor`` between two places along."""

    first: float
    last: float
    floor: float


def _way(run: Profile, level: float, *, pockets: bool) -> Profile:
    """The path of a pass: along the profile above the level, straight where it is below."""
    found: Profile = []
    for above, part in split(run, level):
        if above:
            found += part
            continue
        first = complex(part[0].start.real, level)
        last = complex(part[-1].end.real, level)
        if abs(last - first) > TINY:
            found.append(Piece(first, last))
        if not pockets:
            break
    return found


def _approach(
    here: complex, to: complex, profile: Profile, cleared: _Cleared, above: float
) -> Iterator[TurningStep]:
    """The way to the start of a pass: over the last pass, or else above the stock.

    Args:
        here: Present position.
        to: Start of the pass.
        profile: The whole profile.
        cleared: What the last pass has cleared.
        above: Height to which a traverse may come down.
    """
    clear = max(highest(profile), profile[0].start.imag)
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
