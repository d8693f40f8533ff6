"""The commands ``cncrun measure``: guided measurements, and their keys in the machine file."""

from __future__ import annotations

from typing import Annotated, Literal

from cyclopts import Parameter

from cnc.cli import work
from cnc.cli.options import (
    FaceOptions,
    GaugeOptions,
    MeasureOptions,
    ProbeOptions,
    SensorOptions,
    option,
)
from cnc.model.diagnostics import Diagnostic, UsageError

AxisArgument = Annotated[str, Parameter(help="The axis, such as X.")]
MEASURE, GAUGE, PROBE, FACES = MeasureOptions(), GaugeOptions(), ProbeOptions(), FaceOptions()
SENSOR = SensorOptions()


def backlash(
    axis: AxisArgument,
    /,
    *,
    reverse: Annotated[float, option("The way back, mm; more than the backlash.")] = 0.5,
    repeats: Annotated[int, option("Reversals.")] = 3,
    touch: Annotated[
        str, option("With the probe: another axis and its direction to a slanted face, such as Y-.")
    ] = "",
    with_probe: ProbeOptions = PROBE,
    on_board: GaugeOptions = GAUGE,
) -> int:
    """Measure the play of a nut with a dial gauge or the probe, and write axes.x.backlash.

    The axis moves back and forth; readings are typed. Begin where the axis has room downwards.
    """
    return work.measuring.backlash(axis, reverse, repeats, touch, with_probe, on_board)


def pitch(
    axis: AxisArgument,
    /,
    *,
    first: Annotated[float | None, option("The lowest place, mm.")] = None,
    last: Annotated[float | None, option("The highest place, mm.")] = None,
    places: Annotated[int, option("Number of places.")] = 11,
    both: Annotated[bool, option("Come to each place from above too: the backlash there.")] = False,
    at_faces: FaceOptions = FACES,
    with_probe: ProbeOptions = PROBE,
    on_board: GaugeOptions = GAUGE,
) -> int:
    """Measure the errors of a screw with a scale, blocks or the probe; write axes.x.error_table.

    The axis goes to places of the machine from below, and true places are typed. Or the probe
    touches faces at known distances, each from the same direction.
    """
    chosen = work.measuring.Places(first, last, places, both)
    return work.measuring.pitch(axis, chosen, at_faces, with_probe, on_board)


def square(
    axes: Annotated[str, Parameter(help="The two axes, such as XY.")],
    /,
    *,
    lengths: Annotated[
        tuple[float, float], option("Ways along the two legs of the square, mm; with their signs.")
    ],
    plunger: Annotated[
        Literal["plus", "minus"], option("Direction of the axis to which the plunger points.")
    ] = "plus",
    once: Annotated[bool, option("Do not turn the square over: its own error stays in.")] = False,
    outside: Annotated[
        bool, option("With the probe: touch the outer faces, not the inner ones.")
    ] = False,
    with_probe: ProbeOptions = PROBE,
    on_board: GaugeOptions = GAUGE,
) -> int:
    """Measure the angle between two axes with a square, and write machine.squareness.

    The gauge is on the spindle, the square on the table; readings are typed. Or the probe touches
    two places on each leg; it begins at the corner.
    """
    points_to_plus, turned = plunger == "plus", not once
    return work.measuring.square(
        axes, lengths, points_to_plus, turned, outside, with_probe, on_board
    )


def limits(
    axis: AxisArgument,
    /,
    *,
    most: Annotated[float, option("Factor up to which the limits of the file are raised.")] = 2.0,
    on_board: MeasureOptions = MEASURE,
) -> int:
    """Raise the limits of an axis until it loses steps, and write 70 % of the values.

    The axis homes, then goes out and back ever faster. Its limit switch shows lost steps.
    """
    return work.measuring.limits(axis, most, on_board)


def ringing(
    record: Annotated[
        str, Parameter(help="A csv file: times, s, and accelerations. Or an axis, such as X.")
    ],
    /,
    *,
    accelerometer: Annotated[
        bool, option("Move the axis, and record with the accelerometer of the board.")
    ] = False,
    on_board: SensorOptions = SENSOR,
) -> int:
    """Find the modes of a frame that rings, in the record of an accelerometer.

    Record taps on the frame, or short quick moves with rests of 0.5 s. With the accelerometer of a
    Klipper board the axis makes such moves itself, up to 5.5 mm.
    """
    if accelerometer:
        return work.measuring.shake(record, on_board)
    given = (on_board.board, on_board.port)
    if any(value is not None for value in given) or on_board.unhomed:
        message, hint = "nothing moves for a record", "add --accelerometer, or leave the board out"
        raise UsageError(Diagnostic("measure-option", message, hint=hint))
    return work.measuring.of_record(record, on_board)
