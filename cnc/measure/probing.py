r"""Guided measurements with the touch probe: backlash, pitch of a screw, squareness.

All contacts that are compared come from one direction. So the radius of the ball, the pre-travel of
the probe and the play of the axis that touches are the same in them, and go away.

Backlash. Two opposite faces do not show it: the places of their contacts are apart by

    block + ball - play        ring - ball + play

and the ball counts with its pre-travel, which is known no better than the play. A slanted face
shows it:

        ▲ touch      \   face       X comes to a place from below, and the touch ends at y1;
        |             \             X comes to it from above, its nut is ahead by the play: y2;
        ●──►           \            X comes from below to a place that is w farther: y3.
           X                        play = w (y2 - y1) / (y3 - y1)

X rests while the other axis touches, and that axis always pushes its nut the same way.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

from cnc.measure.procedures import (
    AGREE,
    LEAD,
    GoTo,
    Procedure,
    Scale,
    Step,
    Todo,
    Touch,
    backlash_of,
    check_count,
    check_covered,
    checked,
    disagree,
    listed,
    pitch_of,
    square_of,
    wrong_option,
)

TRIES = 3
"""Touches of a place until its contacts agree."""
SLANT = 0.25
"""Least tangent of the angle between a slanted face and each of its two axes."""
SHIFT = 0.37
"""Way between the places of two reversals, mm: so rounding to steps differs, and averages out."""
INSET = 2.0
"""Way of the first touch from the corner of an outer square, in ways to the face."""


class Face(NamedTuple):
    """How faces are touched.

    Attributes:
        towards: Direction of the touch, +1 or -1.
        way: Longest way to a face, mm.
        contacts: Contacts of a touch.
    """

    towards: int = 1
    way: float = 10.0
    contacts: int = 5

    def check(self) -> None:
        """Raise UsageError ``measure-option`` for a touch that is none."""
        checked("the way to a face", self.way)
        check_count("the contacts", self.contacts, 1)


Touched = Generator[Step, Any, tuple[float, float]]


def touched(scale: Scale, face: Face) -> Touched:
    """Touch a face along an axis; return the mean of the contacts and their spread, mm.

    Raises:
        UsageError: ``measure-readings`` where the contacts do not agree, time after time.
    """
    allowed = max(AGREE, 1.0 / scale.steps_per_mm)
    for _ in range(TRIES):
        contacts = yield Touch(scale.letter, face.towards * face.way, face.contacts)
        spread = max(contacts) - min(contacts)
        if spread <= allowed:
            return sum(contacts) / len(contacts), spread
    raise disagree(
        f"the contacts along {scale.letter.upper()} differ by {spread:.3f} mm: {listed(contacts)}",
        "clean the face and the probe, and fix the part; then measure again",
    )


def backlash(scale: Scale, other: Scale, face: Face, *, repeats: int = 3) -> Procedure:
    """Measure the play of a nut with a slanted face.

    Args:
        scale: The axis.
        other: The axis that touches. Both stand where the face is in reach.
        face: How it is touched.
        repeats: Reversals.

    Raises:
        UsageError: ``measure-option``, ``measure-travel``, ``measure-readings``.
    """
    face.check()
    check_count("the reversals", repeats, 1)
    letter, name = scale.letter, scale.letter.upper()
    if letter == other.letter:
        message = f"{name} cannot show its own play: its nut is pushed the same way at each touch"
        raise wrong_option(message, "let another axis touch a slanted face, such as --touch Y+")
    scale.check(scale.place - LEAD, scale.place + LEAD + (repeats - 1) * SHIFT)
    other.check(other.place, other.place + face.towards * face.way)
    plays, largest = [], 0.0
    for number in range(repeats):
        top, places = scale.place + scale.whole(number * SHIFT), []
        below, above = top - LEAD, top + LEAD
        for way in ((below, top), (above, top), (below, above)):
            for place in way:
                yield GoTo(letter, place, guarded=True)
            place, spread = yield from touched(other, face)
            places.append(place)
            largest = max(largest, spread)
        first, second, third = places
        slope = (third - first) / (above - top)
        if not SLANT <= abs(slope) <= 1.0 / SLANT:
            degrees = math.degrees(math.atan(abs(slope)))
            raise disagree(
                f"the face leans by {degrees:.0f} degrees from {name}",
                f"let it lie across both axes, 30 to 60 degrees from {name}",
            )
        plays.append((second - first) / slope)
    step, play = 1.0 / scale.steps_per_mm, sum(plays) / repeats
    if max(plays) - min(plays) > max(AGREE, step):
        raise disagree(
            f"the reversals differ by {max(plays) - min(plays):.3f} mm: {listed(plays)}",
            "fix the part; an axis that differs by itself is loose or dirty",
        )
    if not -max(AGREE, step) <= play < 0.5 * LEAD:
        raise disagree(
            f"the face shows a play of {play:.3f} mm", "is it flat and fixed? Else use a gauge"
        )
    yield GoTo(letter, scale.place, guarded=True)
    method = f"{repeats} reversals at a slanted face, contacts within {largest:.4f} mm"
    return backlash_of(scale, plays, method)


def pitch(
    scale: Scale, upright: Scale, face: Face, *, faces: Sequence[float], lift: float, blocks: bool
) -> Procedure:
    """Measure the errors of a screw with faces at known distances.

    Args:
        scale: The axis. It stands in front of the first face.
        upright: The axis that lifts the probe over the faces.
        face: How they are touched.
        faces: Distances of the faces from the first one, ascending from 0, mm.
        lift: Way of ``upright`` over a face, mm, with its sign.
        blocks: Whether the operator changes a row of blocks at a stop before each face.

    Raises:
        UsageError: ``measure-option``, ``measure-travel``, ``measure-readings``.
    """
    face.check()
    check_count("the faces", len(faces), 2)
    checked("the lift", lift, signed=True)
    if faces[0] != 0.0 or not all(after - before > LEAD for before, after in pairwise(faces)):
        message = f"the faces must be more than {LEAD:g} mm from each other, the first one at 0"
        raise wrong_option(message, "such as --faces 0 50 100.002 150.001")
    letter, start, depth = scale.letter, scale.place, upright.place
    check_covered(scale, [start + distance for distance in faces])
    reach = face.towards * face.way
    scale.check(*(start + distance + way for distance in faces for way in (0.0, reach)))
    upright.check(depth, depth + lift)
    at, largest = [], 0.0
    for number, distance in enumerate(faces):
        if number:
            yield GoTo(upright.letter, depth + lift, guarded=True)
            yield GoTo(letter, start + distance, guarded=True)
            if blocks:
                yield Todo(
                    f"put blocks to the row, until its face is {distance:g} mm above the first one"
                    if face.towards < 0
                    else f"take blocks from the row, until its face is {distance:g} mm above the "
                    "first one"
                )
            yield GoTo(upright.letter, depth, guarded=True)
        place, spread = yield from touched(scale, face)
        at.append(place)
        largest = max(largest, spread)
    yield GoTo(upright.letter, depth + lift, guarded=True)
    method = f"{len(faces)} faces over {faces[-1]:g} mm, contacts within {largest:.4f} mm"
    return pitch_of(scale, at, faces, faces, method)


def square(
    scales: tuple[Scale, Scale],
    face: Face,
    *,
    lengths: tuple[float, float],
    outside: bool = False,
    turned: bool = True,
) -> Procedure:
    """Measure the angle between two axes with two places on each leg of a square.

    The angle is that of :func:`cnc.measure.procedures.square`. Turned over about its first leg, the
    square has its corner at the other end of the second way.

    Args:
        scales: The two axes. They stand at the corner of the square, clear of both legs.
        face: How they are touched; the direction follows from ``lengths``.
        lengths: Ways along the legs, mm; negative where the leg goes towards minus.
        outside: Whether the outer faces are touched instead of the inner ones.
        turned: Whether the square is turned over and measured again.

    Raises:
        UsageError: ``measure-option``, ``measure-travel``, ``measure-readings``.
    """
    face.check()
    inset = INSET * face.way if outside else 0.0
    for scale, length in zip(scales, lengths, strict=True):
        if abs(checked("a length", length, signed=True)) - inset < 10.0:
            message = f"the two places on the leg along {scale.letter.upper()} are too close"
            raise wrong_option(message, f"give a length of at least {inset + 10.0:g} mm")
        scale.check(scale.place, scale.place + length)
    names = tuple(scale.letter.upper() for scale in scales)
    corner, ways = [scale.place for scale in scales], list(lengths)
    angles, largest = [], 0.0
    for half in range(2 if turned else 1):
        if half:
            corner[1], ways[1] = corner[1] + ways[1], -ways[1]
            yield GoTo(scales[1].letter, corner[1], guarded=True)
            yield Todo(
                f"turn the square over: its first leg stays along {names[0]}, and its corner goes "
                f"to the probe, at {names[0]}{corner[0]:.3f} {names[1]}{corner[1]:.3f}"
            )
        lean = 0.0
        for k, (along, across) in enumerate((scales, scales[::-1])):
            towards = int(math.copysign(1.0, ways[1 - k])) * (1 if outside else -1)
            across.check(corner[1 - k] + towards * face.way)
            contacts = []
            for way in (math.copysign(inset, ways[k]), ways[k]):
                yield GoTo(along.letter, corner[k] + way, guarded=True)
                place, spread = yield from touched(across, face._replace(towards=towards))
                contacts.append(place)
                largest = max(largest, spread)
            yield GoTo(along.letter, corner[k], guarded=True)
            run = ways[k] - math.copysign(inset, ways[k])
            lean += math.atan((contacts[1] - contacts[0]) / run)
        angles.append(math.degrees(lean))
    return square_of(scales, lengths, angles, f"contacts within {largest:.4f} mm")
