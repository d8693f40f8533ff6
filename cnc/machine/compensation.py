"""Errors of a machine that its file states: angles between axes, and error tables of screws.

Three forms of an error table:

    error_table = [[0, 0.0], [100, 0.012]]    place to which the axis is sent, its error there, mm
    x.csv                                     the same with the heading ``position,error``
    x.comp                                    LinuxCNC's: place, place reached, place reached again
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import AfterValidator, BeforeValidator, Field, WithJsonSchema

from cnc.kinematics.compensation import STEEPEST, Screw
from cnc.model.section import Section

# Angles between axes.

WIDEST = 5.0
"""Degrees; a machine that leans more is not described by small errors: the unit is wrong."""
_ANGLE = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*(deg|mm/m)\s*", re.IGNORECASE)


def angle(text: str) -> float:
    """Return an angle such as ``0.02 deg`` or ``0.35 mm/m`` in rad.

    Raises:
        ValueError: The text is no such angle, or a large one.
    """
    match = _ANGLE.fullmatch(text)
    if match is None:
        raise ValueError('must be a number with its unit, "0.02 deg" or "0.35 mm/m"')
    number = float(match[1])
    radians = math.radians(number) if match[2].lower() == "deg" else math.atan(number / 1000.0)
    if not abs(math.degrees(radians)) <= WIDEST:
        raise ValueError(f"must be at most {WIDEST:g} degrees")
    return radians


def _checked(text: str) -> str:
    angle(text)
    return text


def _with_unit(value: Any) -> Any:
    """Refuse a number without a unit: degrees and mm/m differ by a factor of 17."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        raise ValueError('must have a unit: "0.02 deg" or "0.35 mm/m"')
    return value


Angle = Annotated[str, BeforeValidator(_with_unit), AfterValidator(_checked)]


class Squareness(Section):
    """Angles between axes less 90 degrees, each with its unit: "0.02 deg" or "0.35 mm/m".

    An angle counts from the positive direction of one axis to that of the other.
    """

    xy: Angle | None = Field(default=None, description="Angle between +X and +Y, less 90 degrees.")
    xz: Angle | None = Field(default=None, description="Angle between +X and +Z, less 90 degrees.")
    yz: Angle | None = Field(default=None, description="Angle between +Y and +Z, less 90 degrees.")

    @property
    def given(self) -> dict[str, float]:
        """The angles that the file gives, rad."""
        texts = {"xy": self.xy, "xz": self.xz, "yz": self.yz}
        return {pair: angle(text) for pair, text in texts.items() if text is not None}


# Error tables.


class ErrorPoint(NamedTuple):
    """A row of an error table.

    Attributes:
        place: Place to which the axis is sent, mm.
        forward: Error where it comes from below: place reached less ``place``, mm.
        reverse: Error where it comes from above, mm.
    """

    place: float
    forward: float
    reverse: float


ErrorPoints = tuple[ErrorPoint, ...]
HEADINGS = (("position", "error"), ("position", "forward_error", "reverse_error"))
LINUXCNC = (".comp", ".tbl")
"""Suffixes of files in LinuxCNC's form: three columns without a heading."""


class TableError(ValueError):
    """A mistake in an error table."""


def numbered_lines(file: Path) -> list[tuple[int, str]]:
    """Return the lines of a table without comments, with their numbers; empty ones are left out.

    Raises:
        TableError: The file is not readable.
    """
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise TableError(f"{file} is not readable: {reason}") from None
    numbered = [(n, line.split("#", 1)[0].strip()) for n, line in enumerate(lines, start=1)]
    return [(n, line) for n, line in numbered if line]


def read_error_table(file: Path) -> ErrorPoints:
    """Return the rows of a file.

    Raises:
        TableError: The file is not readable, or a row is not as its heading says.
    """
    rows = numbered_lines(file)
    if file.suffix.lower() in LINUXCNC:
        triples = [numbers_of_row(file, n, line.replace(",", " ").split(), 3) for n, line in rows]
        return tuple(ErrorPoint(at, up - at, down - at) for at, up, down in triples)
    heading = tuple(name.strip().lower() for name in next(csv.reader([rows[0][1]]))) if rows else ()
    if heading not in HEADINGS:
        forms = " or ".join(",".join(names) for names in HEADINGS)
        raise TableError(
            f"the first line of {file.name} must be {forms}; "
            f"LinuxCNC's files end with {' or '.join(LINUXCNC)}"
        )
    cells = [(n, next(csv.reader([line]))) for n, line in rows[1:]]
    return tuple(point(numbers_of_row(file, n, row, len(heading))) for n, row in cells)


def numbers_of_row(file: Path, line: int, words: list[str], count: int) -> list[float]:
    """Return the numbers of a row."""
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise TableError(f"line {line} of {file.name} must have {count} numbers")
    return numbers


def point(row: list[float]) -> ErrorPoint:
    """Return a row: place and error, or place and errors from below and from above."""
    return ErrorPoint(row[0], row[1], row[-1])


def _table(value: Any) -> Any:
    """Return a file name as a path, and rows as points."""
    if isinstance(value, str) and value:
        return Path(value)
    if not isinstance(value, list | tuple):
        return value
    for row in value:
        numbers = [v for v in row if isinstance(v, int | float)] if isinstance(row, list) else []
        if isinstance(row, ErrorPoint):
            continue
        if len(numbers) not in (2, 3) or len(numbers) != len(row):
            raise ValueError("must have rows of two or three numbers, such as [100, 0.012]")
    return tuple(
        row if isinstance(row, ErrorPoint) else point(list(map(float, row))) for row in value
    )


ErrorTable = Annotated[
    Path | ErrorPoints,
    BeforeValidator(_table),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "string", "minLength": 1},
                {
                    "type": "array",
                    "items": {
                        "type": "array",
                        "items": {"type": "number"},
                        "minItems": 2,
                        "maxItems": 3,
                    },
                    "minItems": 2,
                },
            ]
        }
    ),
]
"""A file, or its rows."""


def screw(table: Path | ErrorPoints | None, backlash: float | None) -> Screw:
    """Return the correction of an axis with an error table, backlash, or both.

    Raises:
        TableError: The table is not that of a screw, or contradicts the backlash.
    """
    if table is None:
        return Screw((), (), (backlash or 0.0,))
    points = read_error_table(table) if isinstance(table, Path) else table
    for fault in table_faults(points):
        raise TableError(fault)
    places = [at + 0.5 * (up + down) for at, up, down in points]
    corrections = [at - place for (at, _, _), place in zip(points, places, strict=True)]
    plays = [down - up for _, up, down in points]
    if backlash is not None:
        if max(plays) > 0.0:
            raise TableError("the errors from below and from above have the backlash in them")
        plays = [backlash] * len(points)
    least = min(after.place - before.place for before, after in pairwise(points))
    if max(plays) > least:
        raise TableError(f"the backlash, {max(plays):g}, is larger than a step of the table")
    result = Screw(places, corrections, plays)
    slope, cell = result.steepest()
    if slope > STEEPEST:
        near = points[min(max(cell, 1), len(points)) - 1].place
        raise TableError(f"the spline through the rows has a slope of {slope:.2g} near {near:g}")
    return result


def table_faults(points: ErrorPoints) -> Iterator[str]:
    """Yield why rows are not those of a screw."""
    if len(points) < 2:
        yield "an error table has at least two rows"
        return
    for before, row in pairwise(points):
        if row.place == before.place:
            yield f"two rows are for {row.place:g}"
        elif row.place < before.place:
            yield f"the row for {row.place:g} stands behind that for {before.place:g}"
        for a, b in ((before.forward, row.forward), (before.reverse, row.reverse)):
            if abs(b - a) > STEEPEST * (row.place - before.place):
                yield (
                    f"between {before.place:g} and {row.place:g} the error changes by {b - a:g}, "
                    f"which no screw does"
                )
    for row in points:
        if row.reverse < row.forward:
            yield (
                f"at {row.place:g} the axis stands lower when it comes from above "
                f"({row.reverse:g}) than from below ({row.forward:g})"
            )
