"""Steps of the canned cycles for holes: G73, G74, G76 and G81 to G89.

    height                  G98: clear is the level before the cycles (if above R)
      clear  ──────┬─────┬──    G99: clear is R
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
    """A hole: its place in the plane and its heights, mm.

    The cycle ends at ``clear``, which is ``retract`` (R) or above.
    """

    first: float
    second: float
    bottom: float
    retract: float
    clear: float

    def at(self, height: float) -> Point:
        """Return the point of the hole's axis at a height."""
        return self.first, self.second, height


@dataclass(frozen=True, slots=True)
class HoleSettings:
    """Settings of the holes of a line.

    Attributes:
        feed: mm/s.
        dwell: s at the bottom.
        peck: mm of a peck (Q), or of the first one (I of Haas).
        less: mm by which each peck is smaller than the one before (J of Haas).
        least: mm of the smallest peck (K of Haas).
        clearance: mm of the retract of G73, and of the distance at which G83 ends its return.
        turning: Direction of the spindle before the cycle.
        shift: mm away from the wall along the plane's first axis before G76 retracts.
        feed_out_to: End of the feed move out in G74, G84 and G89; a traverse does the rest.
        tap_dwell: Whether a tap dwells once after the spindle reverses, or before each of the two
            reversals.
    """

    feed: float
    dwell: float = 0.0
    peck: float = 0.0
    less: float = 0.0
    least: float = 0.0
    clearance: float = 0.0
    turning: Turning = "cw"
    shift: float = 0.0
    feed_out_to: Literal["clear", "retract"] = "clear"
    tap_dwell: Literal["after", "before-each"] = "after"


def peck_count(top: float, bottom: float, peck: float) -> int:
    """Return the number of pecks of ``peck`` mm from ``top`` to ``bottom``."""
    return max(1, ceil((top - bottom) / peck - ROUNDING))


def _depths(hole: Hole, settings: HoleSettings) -> Iterator[float]:
    """Heights of the bottom after each peck; the last one is exact."""
    peck = settings.peck
    if settings.less > 0.0:
        at = hole.retract - peck
        while at > hole.bottom + ROUNDING * settings.least:
            yield at
            peck = max(settings.least, peck - settings.less)
            at -= peck
        yield hole.bottom
        return
    count = peck_count(hole.retract, hole.bottom, peck)
    for number in range(1, count):
        yield hole.retract - number * peck
    yield hole.bottom


def drill(hole: Hole, settings: HoleSettings) -> Iterator[Step]:
    """G81, and G82 with a dwell."""
    yield Cut(hole.at(hole.bottom), settings.feed)
    yield Pause(settings.dwell)
    yield Rapid(hole.at(hole.clear))


def break_chips(hole: Hole, settings: HoleSettings) -> Iterator[Step]:
    """G73: retract a little after each peck."""
    for depth in _depths(hole, settings):
        yield Cut(hole.at(depth), settings.feed)
        if depth > hole.bottom:
            yield Rapid(hole.at(min(depth + settings.clearance, hole.retract)))
    yield Pause(settings.dwell)
    yield Rapid(hole.at(hole.clear))


def peck(hole: Hole, settings: HoleSettings) -> Iterator[Step]:
    """G83: retract to R after each peck, and return to the clearance above its bottom."""
    for depth in _depths(hole, settings):
        yield Cut(hole.at(depth), settings.feed)
        if depth > hole.bottom:
            yield Rapid(hole.at(hole.retract))
            # A peck shorter than the clearance must not end above R.
            yield Rapid(hole.at(min(depth + settings.clearance, hole.retract)))
    yield Pause(settings.dwell)
    yield Rapid(hole.at(hole.clear))


def tap(hole: Hole, settings: HoleSettings) -> Iterator[Step]:
    """G84 and G74, with a floating chuck: feed in, reverse, feed out, reverse again."""
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
    """G86: retract with the spindle stopped."""
    yield Cut(hole.at(hole.bottom), settings.feed)
    yield Pause(settings.dwell)
    yield TurnSpindle("off")
    yield Rapid(hole.at(hole.clear))
    yield TurnSpindle(settings.turning)


def bore_by_hand(hole: Hole, settings: HoleSettings) -> Iterator[Step]:
    """G88: stop for the operator, who may withdraw the tool.

    The rest of the retract is a traverse with the spindle stopped.
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
    """FANUC's G76: orient the spindle, shift the tool off the wall, retract without contact."""
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
    """Return the steps of a line with a cycle.

    Below R the tool first rises to R. For each hole it then moves across at its height, down to R,
    and makes the hole.

    Args:
        cycle: The code of the cycle.
        position: The point before the line.
        holes: The holes.
        settings: Their settings.
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
