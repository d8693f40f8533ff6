r"""Threads as steps: the passes of G76, rigid tapping (G33.1) and a single synchronised move (G33)
once every number is known.

      x                                         one pass of G76, external (peak negative), with both tapers:
    drive line   ┌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌┐     ╌ traverse      The whole pass is moved away from the work by what is left to
                 ┊                      ┊     ─ synchronised  cut, so that the stroke from there to the bottom is the same
    thread peak  ┘                      │                     in every pass.
                  \                    /
    bottom         \__________________/
                 E                    E
               z end              z start

In pass n the tool has gone ``first * n ** (1 / degression)`` beyond the peak, up to the full depth:
with degression 1 every pass is as deep as the first, with 2 every pass takes the same area. Source:
LinuxCNC 2.9, "G-codes", G76.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, copysign, hypot, log, radians, tan

from cnc.gcode.cycles.steps import (
    ROUNDING,
    Cut,
    Point,
    Rapid,
    SetOverrides,
    Step,
    Synchronise,
    Turning,
    TurnSpindle,
    opposite,
    without_standing,
)

MOST_PASSES = 10_000


@dataclass(frozen=True, slots=True)
class Thread:
    """A thread in the ZX plane, mm; x is a radius.

    start, end: z of the drive line's ends. drive: its x. height: y. pitch: mm a turn. peak: from
    the drive line to the peak, negative for an external thread. first, full: depth beyond the peak
    of the first and of the last pass. degression: at least 1. angle: degrees of the compound slide.
    springs: passes more at full depth. taper: length of the tapers along z, at the ``entry`` and at
    the ``exit``.
    """

    start: float
    end: float
    drive: float
    height: float
    pitch: float
    peak: float
    first: float
    full: float
    degression: float = 1.0
    angle: float = 0.0
    springs: int = 0
    taper: float = 0.0
    entry: bool = False
    exit: bool = False

    @property
    def slide(self) -> float:
        """How far a pass at full depth is shifted along z, mm."""
        return self.full * tan(radians(self.angle))


def passes(thread: Thread) -> int:
    """How many passes it takes to full depth, springs left out; where it would be more than
    :data:`MOST_PASSES`, one more than that.
    """
    exponent = thread.degression * log(thread.full / thread.first)
    if exponent > log(MOST_PASSES):
        return MOST_PASSES + 1
    return max(1, ceil(float((thread.full / thread.first) ** thread.degression) - ROUNDING))


def depths(thread: Thread) -> Iterator[float]:
    """Depth beyond the peak of each pass, mm; the last ones are exactly the full depth."""
    count = passes(thread)
    for number in range(1, count):
        yield min(thread.first * number ** (1.0 / thread.degression), thread.full)
    for _ in range(1 + thread.springs):
        yield thread.full


def cut(thread: Thread, turns_per_second: float) -> Iterator[Step]:
    """The steps of G76 from the drive line's start to its end."""
    way = copysign(1.0, thread.end - thread.start)
    inward = copysign(1.0, thread.peak)
    # On the taper the tool also moves in x: more way a turn, so that z keeps the pitch.
    on_taper = (
        thread.pitch * hypot(thread.taper, thread.full) / thread.taper
        if thread.taper
        else thread.pitch
    )

    def at(z: float, x: float) -> Point:
        return z, x, thread.height

    def passing(depth: float) -> Iterator[Step]:
        start = thread.start + way * depth / thread.full * thread.slide
        end = thread.end - way * (1.0 - depth / thread.full) * thread.slide
        bottom = thread.drive + thread.peak + inward * depth
        crest = bottom - inward * thread.full
        away = thread.drive - inward * (thread.full - depth)
        yield Rapid(at(start, away))
        if thread.entry:
            yield Synchronise(on_taper)
            yield Cut(at(start, crest), on_taper * turns_per_second)
            yield Cut(at(start + way * thread.taper, bottom), on_taper * turns_per_second)
        else:
            yield Rapid(at(start, bottom))
        yield Synchronise(thread.pitch)
        straight_end = end - way * thread.taper if thread.exit else end
        yield Cut(at(straight_end, bottom), thread.pitch * turns_per_second)
        if thread.exit:
            yield Synchronise(on_taper)
            yield Cut(at(end, crest), on_taper * turns_per_second)
        yield Synchronise(0.0)
        yield Rapid(at(end, away))

    def whole() -> Iterator[Step]:
        yield SetOverrides(overrides=False, spindle=False)
        for depth in depths(thread):
            yield from passing(depth)
        yield SetOverrides(overrides=True, spindle=False)
        yield Rapid(at(thread.end, thread.drive))

    yield from without_standing(at(thread.start, thread.drive), whole())


def follow(start: Point, end: Point, pitch: float, turns_per_second: float) -> Iterator[Step]:
    """G33: a straight move of ``pitch`` mm a turn of the spindle, measured along the move."""
    if end != start:
        yield Synchronise(pitch)
        yield Cut(end, pitch * turns_per_second)
        yield Synchronise(0.0)


def tap_rigidly(
    start: Point, end: Point, pitch: float, turns_per_second: float, turning: Turning, faster: float
) -> Iterator[Step]:
    """G33.1: in and out following the spindle, which turns the other way and ``faster`` times as
    fast on the way out.
    """
    if end != start:
        yield Synchronise(pitch)
        yield Cut(end, pitch * turns_per_second)
        yield TurnSpindle(opposite(turning), faster)
        yield Cut(start, pitch * turns_per_second * faster)
        yield TurnSpindle(turning)
        yield Synchronise(0.0)
