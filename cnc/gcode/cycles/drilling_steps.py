"""The canned cycles for holes, as steps: what G73, G74, G76 and G81 to G89 do once every number is
known.

    height                      G98: clear is the level before the cycles (if above R), G99: clear is R
      clear  ──────┬─────┬──
                   ┊     ┊      ┊ traverse
      R      ──────┊─────┊──    │ feed
                   │     ┊
      bottom ──────┴─────┘

Sources: LinuxCNC 2.9, "G-codes", G80-G89 canned cycles; FANUC Series 0i operator's manual, "canned
cycle for drilling".
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import ceil
from typing import Literal

from cnc.gcode.cycles.steps import (
    ROUNDING,
    Cut,
    OperatorStop,
    OrientSpindle,
    Pause,
    Point,
    Rapid,
    SetOverrides,
    Step,
    Turning,
    TurnSpindle,
    opposite,
    without_standing,
)
from cnc.gcode.syntax.code_numbers import G


@dataclass(frozen=True, slots=True)
class Hole:
    """Where a hole is: its place in the plane and its heights, mm. ``clear`` is where the cycle
    ends, at ``retract`` (R) or above.
    """

    first: float
    second: float
    bottom: float
    retract: float
    clear: float

    def at(self, height: float) -> Point:
        """The point of the hole's axis at a height."""
        return self.first, self.second, height


@dataclass(frozen=True, slots=True)
class HoleSettings:
    """How the holes of a line are made.

    feed: mm/s. dwell: s at the bottom. peck: mm a bite (Q). clearance: mm that G73 backs off
    between two peck_count, or that G83 stays away from the bottom when it returns. turning: how the
    spindle turns before the cycle. shift: mm away from the wall, along the plane's first axis,
    before G76 leaves. feed_out_to: how far up G74, G84 and G89 feed; what is left is a traverse.
    tap_dwell: whether a tap dwells once, when the spindle has been reversed, or before each of its
    two reversals.
    """

    feed: float
    dwell: float = 0.0
    peck: float = 0.0
    clearance: float = 0.0
    turning: Turning = "cw"
    shift: float = 0.0
    feed_out_to: Literal["clear", "retract"] = "clear"
    tap_dwell: Literal["after", "before-each"] = "after"


def peck_count(top: float, bottom: float, peck: float) -> int:
    """How many bites of ``peck`` mm it takes from ``top`` to ``bottom``."""
    return max(1, ceil((top - bottom) / peck - ROUNDING))


def _depths(hole: Hole, peck: float) -> Iterator[float]:
    """Heights of the bottom after each bite, the last one exact."""
    count = peck_count(hole.retract, hole.bottom, peck)
    for bite in range(1, count):
        yield hole.retract - bite * peck
    yield hole.bottom


def drill(hole: Hole, settings: HoleSettings) -> Iterator[Step]:
    """G81, and G82 with a dwell."""
    yield Cut(hole.at(hole.bottom), settings.feed)
    yield Pause(settings.dwell)
    yield Rapid(hole.at(hole.clear))


def break_chips(hole: Hole, settings: HoleSettings) -> Iterator[Step]:
    """G73: back off a little after each bite."""
    for depth in _depths(hole, settings.peck):
        yield Cut(hole.at(depth), settings.feed)
        if depth > hole.bottom:
            yield Rapid(hole.at(min(depth + settings.clearance, hole.retract)))
    yield Rapid(hole.at(hole.clear))


def peck(hole: Hole, settings: HoleSettings) -> Iterator[Step]:
    """G83: out to R after each bite, and back to just above where it ended."""
    for depth in _depths(hole, settings.peck):
        yield Cut(hole.at(depth), settings.feed)
        if depth > hole.bottom:
            yield Rapid(hole.at(hole.retract))
            # A bite shorter than the clearance: there is no way above R to make.
            yield Rapid(hole.at(min(depth + settings.clearance, hole.retract)))
    yield Rapid(hole.at(hole.clear))


def tap(hole: Hole, settings: HoleSettings) -> Iterator[Step]:
    """G84 and G74, with a floating chuck: feed in, stop the spindle and reverse it, feed out, and
    turn it as before.
    """
    each = settings.tap_dwell == "before-each"
    top = hole.clear if settings.feed_out_to == "clear" else hole.retract
    yield SetOverrides(overrides=False)
    yield Cut(hole.at(hole.bottom), settings.feed)
    if each:
        yield Pause(settings.dwell)
    yield TurnSpindle("off")
    yield TurnSpindle(opposite(settings.turning))
    if not each:
        yield Pause(settings.dwell)
    yield Cut(hole.at(top), settings.feed)
    if each:
        yield Pause(settings.dwell)
    yield TurnSpindle("off")
    yield TurnSpindle(settings.turning)
    yield SetOverrides(overrides=True)
    yield Rapid(hole.at(hole.clear))


def bore(hole: Hole, settings: HoleSettings) -> Iterator[Step]:
    """G85: feed in and out to R."""
    yield Cut(hole.at(hole.bottom), settings.feed)
    yield Cut(hole.at(hole.retract), settings.feed)
    yield Rapid(hole.at(hole.clear))


def bore_and_stop(hole: Hole, settings: HoleSettings) -> Iterator[Step]:
    """G86: leave with the spindle standing."""
    yield Cut(hole.at(hole.bottom), settings.feed)
    yield Pause(settings.dwell)
    yield TurnSpindle("off")
    yield Rapid(hole.at(hole.clear))
    yield TurnSpindle(settings.turning)


def bore_by_hand(hole: Hole, settings: HoleSettings) -> Iterator[Step]:
    """G88: stop for the operator, who may withdraw the tool; what is left of the way out is a
    traverse with the spindle standing.
    """
    yield Cut(hole.at(hole.bottom), settings.feed)
    yield Pause(settings.dwell)
    yield TurnSpindle("off")
    yield OperatorStop()
    yield Rapid(hole.at(hole.clear))
    yield TurnSpindle(settings.turning)


def bore_and_dwell(hole: Hole, settings: HoleSettings) -> Iterator[Step]:
    """G89: feed in, dwell, feed out."""
    top = hole.clear if settings.feed_out_to == "clear" else hole.retract
    yield Cut(hole.at(hole.bottom), settings.feed)
    yield Pause(settings.dwell)
    yield Cut(hole.at(top), settings.feed)
    yield Rapid(hole.at(hole.clear))


def bore_finely(hole: Hole, settings: HoleSettings) -> Iterator[Step]:
    """FANUC's G76: hold the spindle, move the tool off the wall, and leave without touching it."""
    aside = hole.first + settings.shift
    yield Cut(hole.at(hole.bottom), settings.feed)
    yield Pause(settings.dwell)
    yield TurnSpindle("off")
    yield OrientSpindle()
    yield Rapid((aside, hole.second, hole.bottom))
    yield Rapid((aside, hole.second, hole.clear))
    yield Rapid(hole.at(hole.clear))
    yield TurnSpindle(settings.turning)


_CYCLES: dict[G, Callable[[Hole, HoleSettings], Iterator[Step]]] = {
    G.G73: break_chips,
    G.G74: tap,
    G.G76: bore_finely,
    G.G81: drill,
    G.G82: drill,
    G.G83: peck,
    G.G84: tap,
    G.G85: bore,
    G.G86: bore_and_stop,
    G.G88: bore_by_hand,
    G.G89: bore_and_dwell,
}


def steps(
    cycle: G, position: Point, holes: Iterable[Hole], settings: HoleSettings
) -> Iterator[Step]:
    """The steps of a line of cycles, from ``position`` on.

    Below R the tool first rises to R. Then, for every hole, it goes across at the height where it
    is, down to R, and makes the hole.
    """
    yield from without_standing(position, _steps(cycle, position, holes, settings))


def _steps(
    cycle: G, position: Point, holes: Iterable[Hole], settings: HoleSettings
) -> Iterator[Step]:
    first, second, height = position
    for hole in holes:
        if height < hole.retract:
            height = hole.retract
            yield Rapid((first, second, height))
        yield Rapid(hole.at(height))
        yield Rapid(hole.at(hole.retract))
        yield from _CYCLES[cycle](hole, settings)
        first, second, height = hole.at(hole.clear)
