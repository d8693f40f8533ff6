"""Bodies of the requests, as pydantic models: the OpenAPI document describes them."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from cnc.machine.height_map import TOLERANCE
from cnc.model.choices import Interpolation

MOST_TYPED = 500_000
"""Characters of a text whose findings are shown as it is typed."""
MOST_RECORD = 900_000
"""Characters of a record of an accelerometer."""
MOST_MACRO = 100_000
"""Characters of a macro."""
Letter = Annotated[str, Field(pattern="^[a-z]$")]
Percent = Annotated[FiniteFloat, Field(ge=1, le=200)]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid")


class TakeControl(_Body):
    """A client that takes control."""

    client: str = Field(min_length=1, max_length=80, description="Name that the others see.")


class Connect(_Body):
    """The board to connect."""

    board: str | None = Field(default=None, description="Its kind; null: the machine file's.")
    port: str | None = Field(default=None, description="Its port.")


class Home(_Body):
    """Axes to home."""

    axes: list[Letter] = Field(default=[], description="None for all axes.")


class JogStep(_Body):
    """A jog by a distance."""

    distances: dict[Letter, FiniteFloat] = Field(description="Distance by axis, mm.")
    feed: FiniteFloat | None = Field(default=None, gt=0, description="mm/min; null: highest.")
    unhomed: bool = Field(default=False, description="Jog although the machine is not homed.")


class JogStart(_Body):
    """A jog until its release."""

    directions: dict[Letter, FiniteFloat] = Field(description="Part of each axis.")
    feed: FiniteFloat | None = Field(default=None, gt=0, description="mm/min; null: highest.")
    unhomed: bool = Field(default=False, description="Jog although the machine is not homed.")


class JogKeep(_Body):
    """A sign of life of a jog."""

    jog: int


class Zero(_Body):
    """A new offset."""

    axes: dict[Letter, FiniteFloat] = Field(description="Work position by axis, mm.")
    system: str = Field(default="G54", description="G54 to G59.3, or G92.")
    half: bool = Field(default=False, description="Half the present position instead.")


class ChooseSystem(_Body):
    """The coordinate system of the work position that is shown."""

    system: str


class EnteredLine(_Body):
    """A line to run."""

    line: str = Field(min_length=1, max_length=1000)


class Override(_Body):
    """Overrides, per cent; null leaves one as it is."""

    feed: Percent | None = None
    rapid: int | None = None
    spindle: Percent | None = None


class DialogAnswer(_Body):
    """The answer to a dialog."""

    dialog: int
    yes: bool
    value: FiniteFloat | None = Field(default=None, description="Of a reading, mm.")


class SettingValue(_Body):
    """The new value of a setting of a GRBL board."""

    value: str = Field(pattern=r"^-?[0-9]{1,10}(\.[0-9]{1,6})?$")


class CycleRun(_Body):
    """Values of the parameters of a probing cycle."""

    parameters: dict[str, FiniteFloat] = Field(default={})


class ProbeGrid(_Body):
    """A grid to probe, in work coordinates."""

    x: tuple[FiniteFloat, FiniteFloat] = Field(description="Lowest and highest X, mm.")
    y: tuple[FiniteFloat, FiniteFloat] = Field(description="Lowest and highest Y, mm.")
    step: FiniteFloat = Field(default=10.0, gt=0, description="Largest distance of points, mm.")
    clear: FiniteFloat = Field(default=2.0, gt=0, description="Z between the points, mm.")
    depth: FiniteFloat = Field(default=2.0, gt=0, description="Lowest Z of a contact, mm below 0.")
    feed: FiniteFloat = Field(default=60.0, gt=0, description="Speed of the contacts, mm/min.")
    zero: bool = Field(default=False, description="The first contact becomes Z zero.")
    interpolation: Interpolation = Field(default="bilinear", description="Between the points.")
    tolerance: FiniteFloat = Field(
        default=TOLERANCE, description="Largest distance of pieces from the warped path, mm."
    )
    system: str = Field(default="G54", description="Coordinate system of the grid.")


class ProbeAgain(_Body):
    """Points of a height map to probe again."""

    points: list[tuple[int, int]] = Field(
        min_length=1, max_length=4900, description="Column and row of each, from 0."
    )
    clear: FiniteFloat = Field(default=2.0, gt=0, description="Z between the points, mm.")
    depth: FiniteFloat = Field(default=2.0, gt=0, description="Lowest Z of a contact, mm below 0.")
    feed: FiniteFloat = Field(default=60.0, gt=0, description="Speed of the contacts, mm/min.")


class OfProbe(_Body):
    """The touch probe in place of a gauge."""

    touch: str = Field(
        default="", max_length=2, description="Axis and direction of the touches, such as Y-."
    )
    reach: FiniteFloat = Field(default=10.0, gt=0, description="Longest way to a face, mm.")
    contacts: int = Field(default=5, ge=1, le=100, description="Contacts of a place.")
    contact_feed: FiniteFloat = Field(
        default=100.0, gt=0, description="Speed of a first contact, mm/min."
    )


class OfMeasurement(_Body):
    """How an axis is measured."""

    probe: OfProbe | None = Field(default=None, description="null: a gauge, whose numbers come.")
    feed: FiniteFloat | None = Field(
        default=None, gt=0, description="Beside a gauge, mm/min; null: highest that stops in 0.2 s."
    )
    unhomed: bool = Field(default=False, description="Move although the machine is not homed.")


class MeasureBacklash(OfMeasurement):
    """The play of a nut to measure."""

    axis: Letter
    reverse: FiniteFloat = Field(default=0.5, gt=0, description="The way back, mm.")
    repeats: int = Field(default=3, ge=1, le=100, description="Reversals.")


class MeasurePitch(OfMeasurement):
    """The errors of a screw to measure."""

    axis: Letter
    first: FiniteFloat | None = Field(default=None, description="The lowest place, mm.")
    last: FiniteFloat | None = Field(default=None, description="The highest place, mm.")
    places: int = Field(default=11, ge=2, le=1000, description="Number of places.")
    both: bool = Field(default=False, description="Come to each place from above too.")
    faces: tuple[FiniteFloat, ...] = Field(
        default=(), max_length=1000, description="Distances of the faces for the probe, mm."
    )
    lift: FiniteFloat = Field(default=20.0, description="Way of the probe over a face, mm.")
    blocks: bool = Field(default=False, description="Wait at each face for other blocks.")


class MeasureSquare(OfMeasurement):
    """The angle between two axes to measure."""

    axes: str = Field(pattern="^[a-z]{2}$", description="xy, xz or yz.")
    lengths: tuple[FiniteFloat, FiniteFloat] = Field(description="Ways along the legs, mm.")
    points_to_plus: bool = Field(default=True, description="The plunger points to plus.")
    turned: bool = Field(default=True, description="The square is turned over.")
    outside: bool = Field(default=False, description="The probe touches the outer faces.")


class MeasureLimits(_Body):
    """The limits of an axis to raise until it loses steps."""

    axis: Letter
    most: FiniteFloat = Field(default=2.0, gt=0, le=10, description="Factor of the file's limits.")


class MeasureRinging(_Body):
    """The record of an accelerometer, or an axis that the board's accelerometer records."""

    axis: Letter | None = Field(default=None, description="null: the record is given.")
    unhomed: bool = Field(default=False, description="Move although the machine is not homed.")
    text: str = Field(
        default="", max_length=MOST_RECORD, description="A csv file: times, accelerations."
    )
    name: str = Field(default="record.csv", max_length=200, description="Its name.")


class WriteMeasured(_Body):
    """The result to write into the machine file."""

    number: int = Field(description="Number of the measurement that was shown.")


class CheckJob(_Body):
    """How to check a job."""

    height_map: str | None = Field(default=None, description="Height map that warps the job.")


class CutJob(_Body):
    """A cut to simulate."""

    stock: str = Field(default="", max_length=200, description="Such as X0:100,Y0:60,Z-12:0.")
    system: str = Field(
        default="", max_length=10, description="Coordinate system of the stock; empty: machine."
    )
    resolution: FiniteFloat | None = Field(
        default=None, ge=0.01, description="Width of a cell, mm."
    )


class RepairJob(_Body):
    """A repair to write, as it was shown."""

    code: str = Field(max_length=80, description="Code of the finding.")
    line: int = Field(ge=0, description="Its line.")
    column: int = Field(ge=0, description="Its column.")
    version: str = Field(max_length=80, description="The text that was shown.")
    unsafe: bool = Field(default=False, description="The program may do something else then.")


class NewJob(_Body):
    """A simple job to write into the library."""

    name: str = Field(max_length=300, description="Name of the program.")
    parameters: dict[str, float | str] = Field(default={}, description="Those not at the default.")
    replace: bool = Field(default=False, description="Replace a program of this name.")


class TypedText(_Body):
    """A text that is typed."""

    text: str = Field(max_length=MOST_TYPED)


class MacroText(_Body):
    """The text of a macro."""

    text: str = Field(max_length=MOST_MACRO)


class RunJob(_Body):
    """How to run a job."""

    from_line: int | None = Field(default=None, ge=1, description="Line to begin at.")
    home: bool = Field(default=False, description="Home the machine first.")
    trust_position: bool = Field(
        default=False, description="Confirm the position that the board reports."
    )
    optional_stop: bool = Field(default=False, description="Stop at M1 as at M0.")
    height_map: str | None = Field(default=None, description="Height map that warps the job.")


class Accepted(_Body):
    """The command was accepted; its end comes as an event."""

    accepted: bool = True


class ControlKey(_Body):
    """The key of the client that has control."""

    key: str
    holder: str


class JogStarted(_Body):
    """A jog that moves."""

    jog: int
    feed: float = Field(description="mm/min")


class TextPart(_Body):
    """Lines of a program."""

    first: int
    lines: list[str]
    total: int


class ChangedLine(_Body):
    """A line before and after a repair; ``new`` may hold further lines."""

    line: int
    old: str
    new: str


class Repair(_Body):
    """A repair of a finding."""

    title: str = Field(description="What it does.")
    safe: bool = Field(description="Whether the program keeps its blocks.")
    lines: list[ChangedLine] = Field(description="The first lines that it changes.")
    count: int = Field(description="Number of lines that it changes.")
    version: str = Field(description="The text that was read.")


class LogText(_Body):
    """The log of a run."""

    text: str


class Setting(_Body):
    """A setting of a GRBL board."""

    number: int
    value: str
    name: str
    unit: str
    machine_file: float | None = Field(description="The value of the machine file, if it differs.")
