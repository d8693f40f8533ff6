"""Limits of an axis by lost steps.

The axis moves ever faster between two homings. Where steps were lost, its switch closes elsewhere
than it was counted. A procedure moves nothing itself. It is a generator:

    procedure ──► Home()                     ◄── 0.0, mm by which the switch closed elsewhere
              ──► Strokes(ways, fast, slow)
              ──► Home()                     ◄── 0.16: steps were lost
              ──► Raised                     by ``return``

The ways out of all strokes together are less than the room behind the switch. So the axis stays
inside its travel even if it loses every step of the ways back.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass
from typing import NamedTuple

from cnc.measure.procedures import Measured, Scale
from cnc.model.diagnostics import Diagnostic, UsageError

START = 0.5
"""Part of the limits in the machine file with which the strokes begin."""
STEP = 1.1
"""Factor from one series of strokes to the next."""
KEPT = 0.7
"""Part of the value at which steps were lost, or of the highest one tried, that is proposed."""
WAYS = (0.54, 0.27, 0.13)
"""Strokes as parts of the room: 0.94 of it together."""
REPEATS = 3
"""Homings at first, by which the switch shows how well it repeats."""
LOST = 2.0
"""Steps; a larger difference than this, and than the switch shows by itself, are lost steps."""
ROUGH = 0.1
"""mm; a switch that repeats worse does not tell lost steps."""


class Bounds(NamedTuple):
    """Limits of one axis: mm/s, mm/s^2, mm/s^3. Without a limit of jerk it is infinite."""

    velocity: float
    acceleration: float
    jerk: float


UNITS = {"velocity": "mm/s", "acceleration": "mm/s^2", "jerk": "mm/s^3"}


class Home(NamedTuple):
    """A step: home the axis; the answer is by how much its switch closed elsewhere, mm."""


class Strokes(NamedTuple):
    """A step: go out and back.

    Attributes:
        ways: Signed distances from the place of rest after homing, mm.
        out: The limits of the ways out.
        back: Those of the ways back. One of both is slow: steps lost out and back would cancel.
    """

    ways: tuple[float, ...]
    out: Bounds
    back: Bounds


class Trial(NamedTuple):
    """Strokes that are fast on the way out, and others that are fast on the way back.

    Attributes:
        name: What was raised: velocity, acceleration or jerk.
        value: Its value.
        error: By how much the switch closed elsewhere after them at most, mm; infinite where the
            axis ran into its switch.
    """

    name: str
    value: float
    error: float


@dataclass(frozen=True, slots=True)
class Raised:
    """A result.

    Attributes:
        trials: All series in their order.
        allowed: Error up to which no step is lost, mm.
        measured: The keys of the machine file.
    """

    trials: tuple[Trial, ...]
    allowed: float
    measured: Measured


Raising = Generator[Home | Strokes, float, Raised]


def limits(scale: Scale, given: Bounds, *, away: int, fastest: float, most: float = 2.0) -> Raising:
    """Raise velocity, acceleration and jerk of an axis, one after the other, until steps are lost.

    Args:
        scale: The axis, at the place of rest after homing.
        given: Its limits in the machine file.
        away: Direction off the switch, +1 or -1.
        fastest: Highest speed that the board's rate of steps allows, mm/s.
        most: Part of the limits in the machine file up to which they are raised.

    Raises:
        UsageError: ``measure-option``, ``measure-readings``.
    """
    if not START < most <= 10.0:
        message, hint = f"--most is {most:g}", f"give a factor above {START:g}, up to 10"
        raise UsageError(Diagnostic("measure-option", message, hint=hint))
    low, high = scale.travel
    room = high - scale.place if away > 0 else scale.place - low
    ways = tuple(away * scale.whole(part * room) for part in WAYS)
    yield Home()
    errors = []
    for _ in range(REPEATS):
        errors.append(abs((yield Home())))
    step = 1.0 / scale.steps_per_mm
    if max(errors) > max(ROUGH, LOST * step):
        message = f"at rest the switch closes at places that differ by {max(errors):.3f} mm"
        hint = f"a better switch is needed, or a slower latch: axes.{scale.letter}.homing.latch"
        raise UsageError(Diagnostic("measure-readings", message, hint=hint))
    allowed = max(errors) + LOST * step
    bounds = slow = Bounds(*(START * value for value in given))
    trials: list[Trial] = []
    remarks: list[str] = []
    keys: dict[tuple[str, ...], float | str | None] = {}
    for name, limit in zip(Bounds._fields, given, strict=True):
        if not math.isfinite(limit):
            continue
        # The quantities behind it: acceleration is reached with the jerk of the machine file.
        if name == "acceleration":
            bounds = bounds._replace(jerk=given.jerk)
        value, highest, lost = START * limit, 0.0, False
        while value <= most * limit * (1.0 + 1e-9) and not lost:
            tried = bounds._replace(**{name: value})
            if not _reached(tried, name, abs(ways[0]), fastest):
                break
            error = 0.0
            for out, back in ((tried, slow), (slow, tried)):
                yield Strokes(ways, out, back)
                error = max(error, (yield Home()), key=abs)
                if lost := abs(error) > allowed:
                    break
            trials.append(Trial(name, value, error))
            highest = value
            value *= STEP
        kept = _rounded_down(KEPT * highest)
        if lost or kept > limit:
            keys["axes", scale.letter, f"max_{name}"] = kept
        else:
            kept = limit
        bounds = bounds._replace(**{name: kept})
        unit = UNITS[name]
        remarks.append(
            f"steps lost at {highest:g} {unit}"
            if lost
            else f"none lost up to {highest:g} {unit}"
            if highest
            else f"{name} not reached"
        )
    letter = scale.letter.upper()
    values = ", ".join(
        f"{value:g} {unit}"
        for value, unit in zip(bounds, UNITS.values(), strict=True)
        if value < math.inf
    )
    title = f"limits of {letter}: {values}"
    measured = Measured(title, "; ".join(remarks), (), keys)
    return Raised(tuple(trials), allowed, measured)


def _reached(bounds: Bounds, name: str, way: float, fastest: float) -> bool:
    """Return whether a stroke from rest to rest comes to the limit that is raised."""
    v, a, j = bounds
    plateau = v * j >= a * a
    time = v / a + a / j if plateau else 2.0 * math.sqrt(v / j)
    if v > fastest or (name == "acceleration" and not plateau):
        return False
    return name == "jerk" or v * time <= way


def _rounded_down(value: float) -> float:
    """Return a value with three digits, not above it."""
    if value <= 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return float(f"{math.floor(value / unit * (1.0 + 1e-12)) * unit:.6g}")
