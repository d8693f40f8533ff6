"""Guided measurements with a gauge: backlash, pitch of a screw, squareness.

A procedure moves nothing and reads nothing itself. It is a generator that yields steps, and
receives the reading or the contacts that a step asks for:

    procedure ──► GoTo("x", 12.5)           whoever drives it moves the axis
              ──► Reading("the gauge, mm")  ◄── 0.043
              ──► Touch("x", 10.0)          ◄── (21.302, 21.304, 21.303)
              ──► Measured                  by ``return``

So the terminal, the console and a test drive the same procedure. Positions are those of the
machine, in mm, in the plain scale of its motors: nothing is compensated on the axes measured.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from cnc.boards.protocols import Accelerations
from cnc.machine.compensation import ErrorPoint, TableError, screw, table_faults
from cnc.model.diagnostics import Diagnostic, UsageError

AGREE = 0.02
"""mm; two readings at one place that differ by more are not those of one machine: a gauge shows
0.01 mm."""
LEAD = 1.0
"""mm; an axis comes to a place from so far away, so that its nut lies against one flank."""
MOST_PLACES = 1000
"""Places of a table."""
FINE = 1e-9
"""mm; rounding of a position."""


class GoTo(NamedTuple):
    """A step: move an axis to a place.

    Attributes:
        axis: Its letter.
        place: The place, mm.
        guarded: Whether the touch probe is in the spindle: a contact ends the move, and the
            measurement.
    """

    axis: str
    place: float
    guarded: bool = False


class Touch(NamedTuple):
    """A step: touch a face along an axis with the probe, and go back; ask for the contacts.

    Attributes:
        axis: Its letter.
        way: The longest way to the face, mm, with its sign.
        contacts: Number of contacts.
    """

    axis: str
    way: float
    contacts: int = 5


class Shake(NamedTuple):
    """A step: move an axis there and back with rests, while the accelerometer records.

    The record has a mark at the begin and at the end of each rest; the first rest is before the
    first move.

    Attributes:
        axis: Its letter.
        ways: The ways there, mm.
        rest: The time of a rest, s.
    """

    axis: str
    ways: tuple[float, ...]
    rest: float


class Todo(NamedTuple):
    """A step: let the operator do something, and wait.

    Attributes:
        text: What to do.
    """

    text: str


class Reading(NamedTuple):
    """A step: ask for a number, mm.

    Attributes:
        text: What to read; lines before the last one say what to do first.
    """

    text: str


Step = GoTo | Reading | Shake | Touch | Todo
Answer = float | tuple[float, ...] | Accelerations
"""The reading, mm; machine places of contacts, mm; the record of a shake; after other steps it does
not count."""
Procedure = Generator[Step, Any, "Measured"]


class Row(NamedTuple):
    """A line of the picture of a result.

    Attributes:
        name: The place, or what was measured.
        before: Error without the keys, mm.
        after: Error that is left with them, mm.
    """

    name: str
    before: float
    after: float


class Bar(NamedTuple):
    """A line of the picture with its bars.

    Attributes:
        name: As of the row.
        before: As of the row, mm.
        after: As of the row, mm.
        before_part: Length of its bar, -1 to 1: 1 is the largest error of all rows.
        after_part: Length of the other bar.
    """

    name: str
    before: float
    after: float
    before_part: float
    after_part: float


KeyValue = float | str | Sequence[Mapping[str, float]] | None


class AxisMode(NamedTuple):
    """A mode of the frame that an axis excites.

    Attributes:
        axis: Its letter.
        frequency: Hz, undamped.
        damping: Part of the critical damping.
        share: Its part of the energy of the decays.
    """

    axis: str
    frequency: float
    damping: float
    share: float


@dataclass(frozen=True, slots=True)
class Measured:
    """A result.

    Attributes:
        title: What was measured, and the value.
        remark: How, in one line: it is written behind the keys.
        rows: The picture.
        keys: Values of the machine file by their path, such as ("axes", "x", "backlash"); None
            for a key that goes, rows for an array of tables.
        table: Rows of the error table that a key names; none without such a key.
        modes: Modes of the frame.
    """

    title: str
    remark: str
    rows: tuple[Row, ...]
    keys: Mapping[tuple[str, ...], KeyValue]
    table: tuple[ErrorPoint, ...] = field(default=())
    modes: tuple[AxisMode, ...] = field(default=())

    @property
    def bars(self) -> list[Bar]:
        """The picture, for the terminal and the console."""
        largest = max((max(abs(row.before), abs(row.after)) for row in self.rows), default=0.0)
        unit = largest or 1.0
        return [Bar(*row, row.before / unit, row.after / unit) for row in self.rows]

    @property
    def is_of_place(self) -> bool:
        """Whether the keys change places to which the machine is sent."""
        changed = {name for path in self.keys for name in path}
        return not changed.isdisjoint(("backlash", "error_table", "squareness"))


class Scale(NamedTuple):
    """An axis that is measured.

    Attributes:
        letter: Its letter.
        steps_per_mm: Steps of its motor, 1/mm.
        place: Where it stands, mm.
        travel: Its lowest and highest place, mm.
    """

    letter: str
    steps_per_mm: float
    place: float
    travel: tuple[float, float]

    def whole(self, distance: float) -> float:
        """Return a distance in whole steps, mm."""
        return round(distance * self.steps_per_mm) / self.steps_per_mm

    def check(self, *places: float) -> None:
        """Compare places with the travel. UsageError ``measure-travel``."""
        low, high = self.travel
        for place in places:
            if not low - FINE <= place <= high + FINE:
                name = self.letter.upper()
                message = f"the measurement would move {name} to {place:.3f}, beyond its travel"
                hint = f"begin where {name} has room: its travel is {low:g} to {high:g}"
                raise UsageError(Diagnostic("measure-travel", message, hint=hint))


def backlash(scale: Scale, *, reverse: float = 0.5, repeats: int = 3) -> Procedure:
    """Measure the play of a nut with a gauge along the axis.

    The axis comes from below and goes back. The gauge shows the way back less the play.

    Args:
        scale: The axis; it stands where the gauge has about half of its way left.
        reverse: The way back, mm; more than the play.
        repeats: Reversals.

    Raises:
        UsageError: ``measure-option``, ``measure-travel``, ``measure-readings``.
    """
    check_count("the reversals", repeats, 1)
    way = scale.whole(checked("the way back", reverse))
    top, below = scale.place, scale.place - way - LEAD
    scale.check(top, below)
    letter, name = scale.letter, scale.letter.upper()
    yield GoTo(letter, below)
    yield GoTo(letter, top)
    up = first = yield Reading(
        f"set a gauge along {name}, so that it follows {name} in both directions by {way:g} mm\n"
        "the gauge"
    )
    plays = []
    for number in range(1, repeats + 1):
        yield GoTo(letter, top - way)
        down = yield Reading(f"the gauge after reversal {number} of {repeats}")
        plays.append(way - abs(up - down))
        yield GoTo(letter, below)
        yield GoTo(letter, top)
        up = yield Reading("the gauge where it began")
        if abs(up - first) > AGREE:
            raise disagree(
                f"the gauge shows {up:g} where it showed {first:g}",
                "fix the gauge and its stand, and measure again",
            )
    spread, play = max(plays) - min(plays), float(np.mean(plays))
    step = 1.0 / scale.steps_per_mm
    if spread > max(AGREE, step):
        raise disagree(
            f"the reversals differ by {spread:.3f} mm: {listed(plays)}",
            "fix the gauge and its stand; an axis that differs by itself is loose or dirty",
        )
    if play < -max(AGREE, step):
        raise disagree(
            f"the gauge moved {way - play:.3f} mm while {name} moved {way:g} mm",
            f"let the gauge lie along {name}; is the scale of {name} (steps_per_mm) right?",
        )
    if play >= way - max(AGREE, step):
        raise disagree(
            f"the gauge does not follow {name} back by {way:g} mm",
            "measure again with a longer way back: --reverse 3",
        )
    return backlash_of(scale, plays, f"{repeats} reversals of {way:g} mm")


def backlash_of(scale: Scale, plays: Sequence[float], method: str) -> Measured:
    """Return the result of a play that was measured several times.

    Args:
        scale: The axis.
        plays: The plays, mm.
        method: How they were measured.
    """
    letter, name, step = scale.letter, scale.letter.upper(), 1.0 / scale.steps_per_mm
    key, play = ("axes", letter, "backlash"), float(np.mean(plays))
    remark = f"{method}, {min(plays):.3f} to {max(plays):.3f} mm"
    if play < 0.5 * step:
        title = f"{name} has no backlash: {play:.3f} mm is less than half a step"
        return Measured(title, remark, (Row("reversal", play, play),), {key: None})
    value = round(play, 4)
    rows = tuple(Row(f"reversal {k}", each, each - value) for k, each in enumerate(plays, 1))
    return Measured(f"backlash of {name}: {value:g} mm", remark, rows, {key: value})


def pitch(
    scale: Scale, *, first: float, last: float, places: int = 11, both: bool = False
) -> Procedure:
    """Measure the errors of a screw with a scale along the axis.

    Args:
        scale: The axis.
        first: The lowest place, mm.
        last: The highest place, mm.
        places: Number of the places, with first and last.
        both: Whether the axis also comes from above, which measures the play at each place.

    Raises:
        UsageError: ``measure-option``, ``measure-travel``, ``measure-readings``.
    """
    check_count("the places", places, 2)
    if not last - first > LEAD:
        message = f"the last place must be more than {LEAD:g} mm above the first one"
        raise wrong_option(message, "such as --first 0 --last 300")
    letter, name = scale.letter, scale.letter.upper()
    at = [scale.whole(float(place)) for place in np.linspace(first, last, places)]
    if len(set(at)) < places:
        raise wrong_option(f"{places} places are closer than a step", "take fewer places")
    check_covered(scale, at)
    turns = [at[0] - LEAD, *([at[-1] + LEAD] if both else [])]
    scale.check(*turns, *at)
    todo = (
        f"let a scale, or a gauge on blocks of known length, show the true place of {name}\n"
        f"(it may begin at any number, and must grow where {name} grows)\n"
    )
    yield GoTo(letter, turns[0])
    up = []
    for number, place in enumerate(at):
        yield GoTo(letter, place)
        reading = f"the scale at {name}{place:g}"
        up.append((yield Reading(reading if number else todo + reading)))
    down = list(up)
    if both:
        yield GoTo(letter, turns[1])
        for number in reversed(range(places)):
            yield GoTo(letter, at[number])
            down[number] = yield Reading(f"the scale at {name}{at[number]:g}, from above")
    method = f"{places} places from {at[0]:g} to {at[-1]:g} mm"
    if both:
        method += ", both directions"
    return pitch_of(scale, at, up, down, method)


def pitch_of(
    scale: Scale, at: Sequence[float], up: Sequence[float], down: Sequence[float], method: str
) -> Measured:
    """Return the result of true places along an axis.

    Args:
        scale: The axis.
        at: Places to which it was sent, mm.
        up: Places that it reached from below, from any zero, mm.
        down: Places that it reached from above, mm.
        method: How they were measured.

    Raises:
        UsageError: ``measure-readings``.
    """
    letter, name, table = scale.letter, scale.letter.upper(), []
    for place, low, high in zip(at, up, down, strict=True):
        forward, back = (reading - up[0] - (place - at[0]) for reading in (low, high))
        if forward - back > AGREE:
            raise disagree(
                f"at {name}{place:g} the scale shows less from above ({high:g}) "
                f"than from below ({low:g})",
                f"does the scale grow where {name} grows, and is it fixed?",
            )
        table.append(ErrorPoint(place, round(forward, 4), round(max(forward, back), 4)))
    for fault in table_faults(tuple(table)):
        raise disagree(fault, "measure again, with numbers in mm")
    play = max(row.reverse - row.forward for row in table)
    if play <= 0.5 / scale.steps_per_mm:
        table = [ErrorPoint(row.place, row.forward, row.forward) for row in table]
    keys: dict[tuple[str, ...], float | str | None] = {("axes", letter, "error_table"): ""}
    if any(row.reverse > row.forward for row in table):
        keys["axes", letter, "backlash"] = None
    largest = max(max(abs(row.forward), abs(row.reverse)) for row in table)
    low, high = scale.travel
    beyond = [table[0]._replace(place=low)] if low < at[0] else []
    behind = [table[-1]._replace(place=high)] if high > at[-1] else []
    return Measured(
        f"errors of {name}: up to {largest:.3f} mm",
        method,
        _pitch_rows(table, letter),
        keys,
        (*beyond, *table, *behind),
    )


def check_covered(scale: Scale, at: Sequence[float]) -> None:
    """Compare places with the travel: beyond them the error counts as that of the nearest one.

    Raises:
        UsageError: ``measure-option`` where the travel goes on for more than their distance.
    """
    low, high = scale.travel
    if not math.isfinite(high - low):
        message = f"the travel of {scale.letter.upper()} is not known, and a table is for all of it"
        raise wrong_option(message, f"write axes.{scale.letter}.travel = [lowest, highest]")
    first, last = at[1] - at[0], at[-1] - at[-2]
    if at[0] - low > first + FINE or high - at[-1] > last + FINE:
        name = scale.letter.upper()
        message = f"the places leave out a part of the travel of {name}, {low:g} to {high:g}"
        hint = f"begin within {first:g} mm and end within {last:g} mm of its ends"
        raise wrong_option(message, f"{hint}, or take fewer places")


def _pitch_rows(table: Sequence[ErrorPoint], letter: str) -> tuple[Row, ...]:
    """Return the errors before and after, from below and from above.

    What is left between two places is the difference of the spline from a straight line.
    """
    try:
        corrected = screw(tuple(table), None)
    except TableError as error:
        raise disagree(str(error), "measure again") from None
    at = np.array([row.place for row in table])
    middle = np.sort(np.concatenate((at, 0.5 * (at[1:] + at[:-1]))))
    rows = []
    for side, column in ((1.0, "forward"), (-1.0, "reverse")):
        errors = np.array([getattr(row, column) for row in table])
        if side < 0.0 and not corrected.play:
            break
        motors = middle + corrected.correction(middle, side)
        after = motors + np.interp(motors, at, errors) - middle
        before = np.interp(middle, at, errors)
        for place, b, a in zip(middle, before, after, strict=True):
            name = f"{letter.upper()}{place:g}"
            if corrected.play:
                name = f"{name} up" if side > 0.0 else f"{name} down"
            rows.append(Row(name, float(b), float(a)))
    return tuple(rows)


def square(
    scales: tuple[Scale, Scale],
    *,
    lengths: tuple[float, float],
    points_to_plus: bool = True,
    turned: bool = True,
) -> Procedure:
    r"""Measure the angle between two axes with a gauge on the spindle and a square on the table.

        second axis   |              The gauge shows by how much each leg of the square leans:
              ^       | second leg   along the first axis r1, along the second r2, over lengths
              |       |              L1, L2. The angle beyond 90 degrees is atan(r2/L2) +
              └──►    └────────      atan(r1/L1), of readings that grow towards plus.
             first     first leg

    With the square turned over its own error has the other sign, so the mean is without it.

    Args:
        scales: The two axes. They stand where the gauge touches the first leg at its corner.
        lengths: Ways along the legs, mm; negative where the leg goes towards minus.
        points_to_plus: Whether the plunger points to plus of the axis across the leg. Then the
            reading grows where the leg comes closer, which is towards minus.
        turned: Whether the square is turned over and measured again.

    Raises:
        UsageError: ``measure-option``, ``measure-travel``.
    """
    sign = -1.0 if points_to_plus else 1.0
    names = tuple(scale.letter.upper() for scale in scales)
    for scale, length in zip(scales, lengths, strict=True):
        if abs(checked("a length", length, signed=True)) < 10.0:
            raise wrong_option("a leg is shorter than 10 mm", "move along at least 10 mm of it")
        scale.check(scale.place, scale.place + length)
    angles = []
    for half in range(2 if turned else 1):
        leans = []
        for k, (scale, length) in enumerate(zip(scales, lengths, strict=True)):
            across, side = names[1 - k], "plus" if points_to_plus else "minus"
            place = (
                f"turn the square over, keep its first leg along {names[0]} "
                f"and its second leg along {names[1]}\n"
                if half
                else f"lay a square along {names[0]} and its second leg along {names[1]}\n"
            )
            yield GoTo(scale.letter, scale.place)
            before = yield Reading(
                ("" if k else place)
                + f"let the gauge of the spindle touch the leg along {names[k]}, "
                f"its plunger towards {side} {across}\nthe gauge at the begin of the leg"
            )
            yield GoTo(scale.letter, scale.place + length)
            after = yield Reading(f"the gauge {abs(length):g} mm along the leg")
            leans.append(math.atan(sign * (after - before) / length))
            yield GoTo(scale.letter, scale.place)
        angles.append(math.degrees(leans[0] + leans[1]))
    return square_of(scales, lengths, angles)


def square_of(
    scales: tuple[Scale, Scale],
    lengths: tuple[float, float],
    angles: Sequence[float],
    method: str = "",
) -> Measured:
    """Return the result of an angle between two axes.

    Args:
        scales: The axes.
        lengths: Ways along the legs, mm.
        angles: Degrees beyond 90, also with the square turned over if there are two.
        method: More about how they were measured.
    """
    names = tuple(scale.letter.upper() for scale in scales)
    angle = float(np.mean(angles))
    pair = "".join(scale.letter for scale in scales)
    remark = f"legs of {abs(lengths[0]):g} and {abs(lengths[1]):g} mm"
    if len(angles) > 1:
        remark += f", the square's own error {0.5 * (angles[1] - angles[0]):+.4f} deg"
    if method:
        remark += f", {method}"
    value = round(angle, 4)
    row = Row(
        f"over {abs(lengths[1]):g} mm",
        math.radians(angle) * lengths[1],
        math.radians(angle - value) * lengths[1],
    )
    title = f"angle between {names[0]} and {names[1]}: {90.0 + value:.4f} deg"
    text = f"{value:.4f} deg" if value else None
    return Measured(title, remark, (row,), {("machine", "squareness", pair): text})


def listed(values: Sequence[float]) -> str:
    """Return numbers for a message, mm."""
    return ", ".join(f"{value:.3f}" for value in values)


def checked(what: str, value: float, *, signed: bool = False) -> float:
    """Return a length. UsageError ``measure-option`` where it is none."""
    if not math.isfinite(value) or value == 0.0 or (value < 0.0 and not signed):
        raise wrong_option(f"{what} is {value:g} mm", "give a length in mm")
    return value


def check_count(what: str, count: int, least: int) -> None:
    """Compare a number of things with its bounds. UsageError ``measure-option``."""
    if not least <= count <= MOST_PLACES:
        raise wrong_option(f"{what} are {count}", f"give a number from {least} to {MOST_PLACES}")


def wrong_option(message: str, hint: str) -> UsageError:
    """Return the error of numbers with which nothing can be measured."""
    return UsageError(Diagnostic("measure-option", message, hint=hint))


def disagree(message: str, hint: str) -> UsageError:
    """Return the error of readings or contacts that contradict each other."""
    return UsageError(Diagnostic("measure-readings", message, hint=hint))
