"""The summary of a check or a run as a data model: its keys in order, their meaning and units.

The JSON file and its JSON Schema are made from these classes. The values come from
:class:`cnc.report.result.Report` and are not validated again.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, SkipValidation, TypeAdapter

from cnc.model.blocks import AxisLetter
from cnc.model.diagnostics import Diagnostic, Severity

Count = Annotated[int, Field(ge=0)]
Amount = Annotated[float, Field(ge=0)]
Span = Annotated[list[float], Field(min_length=2, max_length=2)]
Text = Annotated[str, SkipValidation]
"""Text that may hold lone surrogates, such as the name of a file that is not UTF-8."""


def _without_default(schema: dict[str, Any]) -> None:
    """Remove the default from the schema of a key that may be absent, but is never null."""
    del schema["default"]


def _optional(description: str) -> Any:
    return Field(default=None, description=description, json_schema_extra=_without_default)


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class AxisDynamics(_Part):
    """Values of one axis; null where nothing was measured or nothing limits."""

    velocity: Amount | None = Field(description="mm/s (degrees/s for rotary axes)")
    acceleration: Amount | None = Field(description="mm/s²")
    jerk: Amount | None = Field(description="mm/s³")


class PathDynamics(_Part):
    """Values along the path and of each axis; null where nothing was measured or limits."""

    feed: Amount | None = Field(description="Feed along the path, mm/s")
    accel: Amount | None = Field(description="Tangential acceleration, mm/s²")
    jerk: Amount | None = Field(description="Tangential jerk, mm/s³")
    normal_accel: Amount | None = Field(description="Normal acceleration, mm/s²")
    chord_error: Amount | None = Field(description="Chord error of the samples, mm")
    step_deviation: Amount | None = Field(
        description="Relative difference between a sampled step and the commanded step"
    )
    axes: dict[AxisLetter, AxisDynamics] = Field(description="The values of each axis")


class Edit(_Part):
    """A replacement in a line of the program."""

    line: Count = Field(description="Line from 1")
    column: Count = Field(description="First character that is replaced, from 1")
    length: Count = Field(description="Number of characters; 0 inserts")
    text: Text = Field(description="Text in their place; a line end adds a line")


class Fix(_Part):
    """The one right repair of a finding."""

    title: Text = Field(description="What the repair does")
    safe: bool = Field(description="Whether the program keeps its blocks, and no text is lost")
    edits: list[Edit] = Field(description="Replacements that belong together")


class Finding(_Part):
    """An error, a warning or a note."""

    code: str = Field(
        description="Code of the finding, see the reference of findings",
        pattern="^[a-z]+(-[a-z0-9]+)*$",
    )
    message: Text = Field(description="The cause")
    file: Text = Field(description="Source file; empty if the finding has none")
    line: Count = Field(description="Source line from 1; 0 if the finding has none")
    column: Count = _optional("Column from 1; 0 if the finding has none")
    severity: Severity = Field(description="An error ends the program; the others do not")
    hint: Text = _optional("The remedy; empty if there is none")
    fix: Fix = _optional("The repair; absent where there is none, or more than one")


class Timing(_Part):
    """Computing time."""

    parse_s: Amount = Field(description="Reading the program, s")
    plan_s: Amount = Field(description="Planning, s")
    interpolate_s: Amount = Field(description="Interpolation, s")
    total_s: Amount = Field(description="Everything, with checks and output, s")


class Stock(_Part):
    """The simulated cut of the stock."""

    resolution_mm: Amount = Field(description="Width of a cell of the stock, mm")
    removed_mm3: Amount = Field(description="Volume that the program removes from the stock, mm^3")


class WarpedBy(_Part):
    """The height map that warps the program."""

    file: Text = Field(description="File of the height map")
    columns: Count = Field(description="Points along X")
    rows: Count = Field(description="Points along Y")
    lowest_mm: float = Field(description="Lowest point, mm")
    highest_mm: float = Field(description="Highest point, mm")
    interpolation: Literal["bilinear", "bicubic"] = Field(description="Between the points")
    tolerance_mm: Amount = Field(
        description="Largest distance of the pieces from the warped path, mm"
    )
    pieces: Count = Field(description="Straight pieces of the warped path")


class Changes(_Part):
    """Differences to the baseline; pairs are [then, now]."""

    known: bool = Field(description="Whether the baseline has the program")
    new: list[Finding] = Field(description="Findings that the baseline lacks")
    gone: list[Finding] = Field(description="Findings of the baseline that have disappeared")
    duration_s: Span = _optional("Machine time then and now, s; absent if unchanged")
    path_length_mm: Span = _optional("Path length then and now, mm; absent if unchanged")
    bounding_box: dict[
        AxisLetter, Annotated[list[Span | None], Field(min_length=2, max_length=2)]
    ] = Field(
        description="Extents of axes then and now, mm; unchanged axes are absent, "
        "null where the axis did not move"
    )


class Summary(BaseModel):
    """Summary of one program."""

    model_config = ConfigDict(frozen=True)

    program: Text = Field(description="Name of the program")
    machine: Text = Field(description="Name of the machine")
    dialect: str = Field(
        description="Dialect that the program was read in; auto if none was recognised. Empty if "
        "the program could not be read"
    )
    assumed: str = _optional(
        "What the reading of the program assumes, such as millimetres; absent for nothing"
    )
    ok: bool = Field(description="Whether there is no error")
    lines: Count = Field(description="Source lines that were read")
    blocks: Count = Field(description="Canonical blocks; each straight move counts")
    errors: list[Finding] = Field(description="Errors, then warnings and notes")
    duration_s: Amount = Field(description="Machine time with dwells, s")
    played_s: Amount = _optional("Measured time of a run on a board that plans its motion, s")
    stock: Stock = _optional("The simulated cut of the stock; absent without a stock")
    height_map: WarpedBy = _optional("The height map of the program; absent without one")
    path_length_mm: Amount = Field(description="Length of the path, mm")
    travel_checked: bool = Field(description="Whether the machine gives a travel of its axes")
    bounding_box: dict[AxisLetter, Span] = Field(
        description="[smallest, largest] position of each axis, mm"
    )
    end_position: dict[AxisLetter, float] = Field(description="Last position of each axis, mm")
    max: PathDynamics = Field(description="Largest values that occurred")
    limits: PathDynamics = Field(description="Limits of the machine file")
    violations: dict[str, Count] = Field(description="Number of samples beyond each limit")
    steps: dict[AxisLetter, Count] = Field(description="Steps of each axis in both directions")
    pulse_error_blu: Amount | None = Field(
        description="Largest distance of a grid point from the path, in steps (BLU)"
    )
    stopped_at_line: Count | None = Field(
        description="Source line at which the operator stopped the run"
    )
    timing: Timing = Field(description="Computing time")
    lines_per_s: Amount = Field(description="Source lines for each second of computing")
    steps_per_s: Amount = Field(description="Steps for each second of computing")
    changes: Changes = _optional("Differences to the baseline; absent without one")

    def as_json(self) -> dict[str, Any]:
        """Return the keys in their order. Optional keys that were not set are absent."""
        return self.model_dump(exclude_unset=True, warnings=False)


def finding_of(finding: Diagnostic, **more: Any) -> Finding:
    """Return a finding as a part of the summary.

    Args:
        finding: The finding.
        **more: Its optional keys.
    """
    return Finding.model_construct(
        code=finding.code,
        message=finding.message,
        file=finding.file,
        line=finding.line,
        severity=finding.severity,
        **more,
    )


def fix_of(finding: Diagnostic) -> dict[str, Fix]:
    """Return the key of the repair of a finding, if it has one."""
    if finding.fix is None:
        return {}
    edits = [
        Edit.model_construct(**edit._replace(line=edit.line or finding.line)._asdict())
        for edit in finding.fix.edits
    ]
    fix = Fix.model_construct(title=finding.fix.title, safe=finding.fix.safe, edits=edits)
    return {"fix": fix}


def summary_schema() -> dict[str, Any]:
    """Return the JSON Schema of the JSON file: one summary, or a list of summaries."""
    schema = TypeAdapter(Summary | list[Summary]).json_schema()
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Summary of a check or a run by cncrun: of one program, or a list of many",
        **schema,
    }
