r"""Steps of threads: the passes of G76, rigid tapping (G33.1) and one synchronised move (G33).

    x            one pass of G76, external (peak negative), with both tapers

    drive line   ┌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌┐    ╌ traverse
                 ┊                      ┊    ─ synchronised
    thread peak  ┘                      │
                  \                    /
    bottom         \__________________/
                 E                    E
               z end              z start

The whole pass is shifted away from the workpiece by the remaining depth. So the stroke from its
start to the bottom is the same in every pass.

In pass n the tool is ``first * n ** (1 / degression)`` beyond the peak, up to the full depth. With
degression 1 every pass has the same depth, with 2 the same area. Source: LinuxCNC 2.9, "G-codes",
G76.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, copysign, hypot, log, radians, tan

from cnc.gcode.cycles.steps import (
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
from cnc.kernels.gcode.holes import ROUNDING

MOST_PASSES = 10_000


@dataclass(frozen=True, slots=True)
class Thread:
    """A thread in the ZX plane, mm; x is a radius.

    Attributes:
        start: z of the start of the drive line.
        end: z of its end.
        drive: x of the drive line.
        height: y.
        pitch: mm a revolution.
        peak: From the drive line to the peak; negative for an external thread.
        first: Depth of the first pass beyond the peak.
        full: Depth of the last pass beyond the peak.
        degression: At least 1.
        angle: Angle of the compound slide, degrees.
        springs: Additional passes at full depth.
        taper: Length of the tapers along z.
        entry: Whether the start has a taper.
        exit: Whether the end has a taper.
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
        """Shift of a pass at full depth along z, mm."""
        return self.full * tan(radians(self.angle))


def passes(thread: Thread) -> int:
    """Return the number of passes to full depth without spring passes.

    The largest result is :data:`MOST_PASSES` + 1.
    """
    exponent = thread.degression * log(thread.full / thread.first)
    if exponent > log(MOST_PASSES):
        return MOST_PASSES + 1
    return max(1, ceil(float((thread.full / thread.first) ** thread.degression) - ROUNDING))


def depths(thread: Thread) -> Iterator[float]:
    """Return the depth of each pass beyond the peak, mm; the last are exactly the full depth."""
    count = passes(thread)
    for number in range(1, count):
        yield min(thread.first * number ** (1.0 / thread.degression), thread.full)
    for _ in range(1 + thread.springs):
        yield thread.full


def cut(thread: Thread, turns_per_second: float) -> Iterator[Step]:
    """Return the steps of G76 from the start of the drive line to its end."""
    direction = copysign(1.0, thread.end - thread.start)
    inward = copysign(1.0, thread.peak)
    # On the taper the tool also moves in x, so the pitch along the move is longer.
    on_taper = (
        thread.pitch * hypot(thread.taper, thread.full) / thread.taper
        if thread.taper
        else thread.pitch
    )

    def at(z: float, x: float) -> Point:
        return z, x, thread.height

    def passing(depth: float) -> Iterator[Step]:
        start = thread.start + direction * depth / thread.full * thread.slide
        end = thread.end - direction * (1.0 - depth / thread.full) * thread.slide
        bottom = thread.drive + thread.peak + inward * depth
        crest = bottom - inward * thread.full
        away = thread.drive - inward * (thread.full - depth)
        yield Rapid(at(start, away))
        if thread.entry:
            yield Synchronise(on_taper)
            yield Cut(at(start, crest), on_taper * turns_per_second)
            yield Cut(at(start + direction * thread.taper, bottom), on_taper * turns_per_second)
        else:
            yield Rapid(at(start, bottom))
        yield Synchronise(thread.pitch)
        straight_end = end - direction * thread.taper if thread.exit else end
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
    """G33: a straight move of ``pitch`` mm a revolution, measured along the move."""
    if end != start:
        yield Synchronise(pitch)
        yield Cut(end, pitch * turns_per_second)
        yield Synchronise(0.0)


def tap_rigidly(
    start: Point, end: Point, pitch: float, turns_per_second: float, turning: Turning, faster: float
) -> Iterator[Step]:
    """G33.1: in and out at ``pitch`` mm a revolution.

    The spindle reverses for the retract, where it turns ``faster`` times as fast.
    """
    if end != start:
        yield Synchronise(pitch)
        yield Cut(end, pitch * turns_per_second)
        yield TurnSpindle(opposite(turning), faster)
        yield Cut(start, pitch * turns_per_second * faster)
        yield TurnSpindle(turning)
        yield Synchronise(0.0)
