"""Height map of a surface: the heights that a probe found on a grid, kept as a JSON file."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from cnc.model.choices import Interpolation
from cnc.model.diagnostics import Diagnostic, UsageError

MOST_POINTS = 1000
"""Limit on the points of the grid along an axis."""
TOLERANCE, LEAST_TOLERANCE = 0.005, 0.0001
"""Tolerance of the pieces of a move, and the least one, mm."""
LARGEST_FILE = 50_000_000
"""Limit on the size of a file, bytes."""

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positions = Annotated[tuple[Finite, ...], Field(min_length=2, max_length=MOST_POINTS)]
Row = Annotated[tuple[Finite | None, ...], Field(min_length=2, max_length=MOST_POINTS)]
Rows = Annotated[tuple[Row, ...], Field(min_length=2, max_length=MOST_POINTS)]


class HeightMap(BaseModel):
    """Heights of a surface above a grid, mm.

    A program that uses the map has its Z raised by the height at each place.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: Literal["cnc-height-map"] = Field(
        default="cnc-height-map", description="Kind of the file."
    )
    version: Literal[1] = Field(default=1, description="Version of the format.")
    x: Positions = Field(description="Machine positions of the columns, ascending, mm.")
    y: Positions = Field(description="Machine positions of the rows, ascending, mm.")
    heights: Rows = Field(
        description="Height of each point, mm: a row for each y, a column for each x. It is the "
        "work position of Z at the contact, so it is 0 at the height of the work zero; null where "
        "the probe met nothing."
    )
    interpolation: Interpolation = Field(
        default="bilinear",
        description="Between the points: bilinear, or the bicubic natural spline.",
    )
    tolerance: float = Field(
        default=TOLERANCE,
        ge=LEAST_TOLERANCE,
        le=1.0,
        allow_inf_nan=False,
        description="Largest distance of the pieces of a move from the warped move, mm.",
    )
    system: str = Field(default="", description="Coordinate system of the heights, such as G54.")
    work_zero: dict[str, Finite] = Field(
        default_factory=dict,
        description="Machine position of the work zero by axis at the time of probing, mm.",
    )
    probed: str = Field(default="", description="Date and time of the probing, ISO 8601.")

    @field_validator("x", "y")
    @classmethod
    def _ascending(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if any(b - a < 1e-3 for a, b in pairwise(value)):
            message = "must ascend by at least 0.001 mm"
            raise ValueError(message)
        return value

    @model_validator(mode="after")
    def _fits(self) -> HeightMap:
        if len(self.heights) != len(self.y) or any(len(row) != len(self.x) for row in self.heights):
            message = f"heights must have {len(self.y)} rows of {len(self.x)} numbers"
            raise ValueError(message)
        if all(height is None for row in self.heights for height in row):
            message = "heights must have a number"
            raise ValueError(message)
        return self

    @property
    def extremes(self) -> tuple[float, float]:
        """Lowest and highest point, mm."""
        known = [height for row in self.heights for height in row if height is not None]
        return min(known), max(known)

    @property
    def gaps(self) -> list[tuple[int, int]]:
        """Column and row, from 0, of each point where the probe met nothing."""
        return [
            (column, row)
            for row, heights in enumerate(self.heights)
            for column, height in enumerate(heights)
            if height is None
        ]

    def gap_finding(self, name: str) -> Diagnostic:
        """Return the finding ``height-map-gap``; ``name``: of the map."""
        gaps = self.gaps
        column, row = gaps[0]
        x = self.x[column] - self.work_zero.get("x", 0.0)
        y = self.y[row] - self.work_zero.get("y", 0.0)
        more = f" and at {len(gaps) - 1} more points" if len(gaps) > 1 else ""
        message = f"the probe met nothing at X{x:g} Y{y:g}{more}: {name} has no height there"
        hint = "probe these points again in the console, or a grid that lies on the part"
        return Diagnostic("height-map-gap", message, hint=hint)


def load_height_map(file: Path | str) -> HeightMap:
    """Return the height map of a file.

    Raises:
        UsageError: ``height-map-file`` if it cannot be read, or is no height map.
    """
    try:
        if Path(file).stat().st_size > LARGEST_FILE:
            raise _wrong(file, f"is larger than {LARGEST_FILE // 1_000_000} MB")
        return HeightMap.model_validate_json(Path(file).read_bytes())
    except OSError as error:
        raise _wrong(file, f"cannot be read: {error.strerror or error}") from error
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        text = str(first["msg"]).removeprefix("Value error, ")
        raise _wrong(file, f"is no height map: {place + ': ' if place else ''}{text}") from error


def save_height_map(surface: HeightMap, file: Path | str) -> None:
    """Write a height map.

    Raises:
        UsageError: ``height-map-file``.
    """
    try:
        Path(file).write_text(height_map_text(surface), encoding="utf-8")
    except OSError as error:
        raise _wrong(file, f"cannot be written: {error.strerror or error}") from error


def height_map_text(surface: HeightMap) -> str:
    """Return the text of the file, a row of the grid on each line."""
    content = surface.model_dump(mode="json")
    rows = ",\n".join(f"    {json.dumps(row)}" for row in content.pop("heights"))
    head = json.dumps(content, indent=None, ensure_ascii=False)[1:-1]
    return f'{{{head},\n  "heights": [\n{rows}\n  ]}}\n'


def height_map_schema() -> dict[str, Any]:
    """Return the JSON Schema of a height map."""
    return HeightMap.model_json_schema()


def _wrong(file: Path | str, what: str) -> UsageError:
    hint = "name a file that cncrun height-map has written"
    return UsageError(Diagnostic("height-map-file", f"{file} {what}", hint=hint))
