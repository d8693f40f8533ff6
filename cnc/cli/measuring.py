"""The commands ``cncrun measure``: guided measurements, and their keys in the machine file."""

from __future__ import annotations

import math
import sys
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

import cnc
from cnc import cli
from cnc.cli.keyboard import Keyboard
from cnc.cli.operate_commands import TERMINAL, PortOption
from cnc.cli.options import BoardOption, MachineOption, TerminalOptions, option
from cnc.cli.signals import OperatorSignals, typed_line
from cnc.model.diagnostics import Diagnostic, UsageError, printable
from cnc.model.operator_control import Control

if TYPE_CHECKING:
    import cnc.cli.operating
    from cnc.machine.models import Machine
    from cnc.measure.limits import Strokes
    from cnc.measure.orders import Order, TouchProbe
    from cnc.measure.procedures import Measured
    from cnc.operate.events import Event
    from cnc.operate.operator_session import OperatorSession

AxisArgument = Annotated[str, Parameter(help="The axis, such as X.")]
BAR = 24
"""Columns of a bar on either side of 0."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class MeasureOptions:
    """Options of all measurements."""

    yes: Annotated[bool, option("Write the machine file without a question.")] = False
    machine: MachineOption = None
    board: BoardOption = None
    port: PortOption = None
    terminal: TerminalOptions = TERMINAL


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class SensorOptions(MeasureOptions):
    """Options of the accelerometer of a board."""

    unhomed: Annotated[bool, option("Move although the machine is not homed.")] = False


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class GaugeOptions(MeasureOptions):
    """Options of measurements with a gauge, beside which the axes move slowly."""

    unhomed: Annotated[bool, option("Move although the machine is not homed.")] = False
    feed: Annotated[
        float | None, option("Speed, mm/min; by default the highest that stops within 0.2 s.")
    ] = None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ProbeOptions:
    """Options of the touch probe in place of a gauge."""

    probe: Annotated[bool, option("Measure with the touch probe in the spindle.")] = False
    reach: Annotated[float, option("With the probe: longest way to a face, mm.")] = 10.0
    contacts: Annotated[int, option("With the probe: contacts of a place.")] = 5
    contact_feed: Annotated[
        float, option("With the probe: speed of a first contact, mm/min; four times slower then.")
    ] = 100.0

    def of_order(self, touch: str = "") -> TouchProbe | None:
        """Return the probe of an order; None for a gauge."""
        from cnc.measure.orders import TouchProbe

        return (
            TouchProbe(touch=touch, reach=self.reach, contacts=self.contacts)
            if self.probe
            else None
        )


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class FaceOptions:
    """Options of faces at known distances, which the probe touches."""

    faces: Annotated[
        tuple[float, ...],
        Parameter(
            help="With the probe: distances of the faces from the first one, mm.",
            consume_multiple=True,
            negative="",
        ),
    ] = ()
    touch: Annotated[
        str, option("With the probe: the axis and the direction of the touches, such as X-.")
    ] = ""
    lift: Annotated[float, option("With the probe: way of Z over a face, mm.")] = 20.0
    blocks: Annotated[
        bool, option("With the probe: wait at each face until the row of blocks is changed.")
    ] = False


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
    cli.load_library()
    from cnc.measure.orders import Backlash

    order = Backlash(axis=axis, reverse=reverse, repeats=repeats, probe=with_probe.of_order(touch))
    return _measure(order, on_board, with_probe)


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
    cli.load_library()
    from cnc.measure.orders import Pitch

    order = Pitch(
        axis=axis,
        first=first,
        last=last,
        places=places,
        both=both,
        faces=at_faces.faces,
        lift=at_faces.lift,
        blocks=at_faces.blocks,
        probe=with_probe.of_order(at_faces.touch),
    )
    return _measure(order, on_board, with_probe)


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
    cli.load_library()
    from cnc.measure.orders import Square

    order = Square(
        axes=axes,
        lengths=lengths,
        points_to_plus=plunger == "plus",
        turned=not once,
        outside=outside,
        probe=with_probe.of_order(),
    )
    return _measure(order, on_board, with_probe)


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
    on_board.terminal.open_log(on_board.machine)
    cli.load_library()
    from cnc.measure.limits import UNITS
    from cnc.operate import measuring

    given, letter = cnc.load_machine(on_board.machine), axis.lower()
    plain, control = measuring.uncompensated(given, [letter]), Control()
    with (
        measuring.opened(plain, on_board.board, on_board.port) as board,
        OperatorSignals(control) as signals,
    ):
        signals.moving = True
        test = measuring.LimitTest(board, plain, letter, control)
        print(f"{letter.upper()} moves fast over most of its travel; Ctrl-C stops", file=sys.stderr)
        raised = test.raised(most, lambda step: print(_strokes(step), file=sys.stderr))
        rehearsed = board.traits.simulated
    for name, value, error in raised.trials:
        lost = "lost steps" if abs(error) > raised.allowed else "right"
        print(f"{name:12} {value:10.4g} {UNITS[name]:7} {error:+9.4f} mm  {lost}")
    print(printable(raised.measured.title), f"  {raised.measured.remark}", sep="\n")
    if rehearsed or not raised.measured.keys:
        reason = "the board is simulated, so " if rehearsed else ""
        print(f"{reason}the limits of the machine file stay")
        return 0
    _write(raised.measured, given, yes=on_board.yes)
    return 0


def _strokes(step: Strokes) -> str:
    from cnc.operate.measuring import strokes

    return strokes(step)


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
        return _shake(record, on_board)
    given = (on_board.board, on_board.port)
    if any(value is not None for value in given) or on_board.unhomed:
        message, hint = "nothing moves for a record", "add --accelerometer, or leave the board out"
        raise UsageError(Diagnostic("measure-option", message, hint=hint))
    on_board.terminal.open_log(record)
    cli.load_library()
    from cnc.measure import ringing as records

    file = Path(record)
    measured = records.of_record(records.read_record(file), file.name)
    _show_modes(measured)
    _write(measured, cnc.load_machine(on_board.machine), yes=on_board.yes)
    return 0


def _shake(axis: str, on: SensorOptions) -> int:
    """Record short quick moves of an axis, and print the modes."""
    on.terminal.open_log(on.machine)
    cli.load_library()
    from cnc.measure.orders import Ringing
    from cnc.operate import measuring

    order = Ringing(axis=axis)
    given = cnc.load_machine(on.machine)
    plain = measuring.measured_machine(given, order)
    with cli.operating.connected(plain, on.board, on.port) as (session, signals):
        moves = measuring.Moves(unhomed=on.unhomed)
        measured = _answered(session, signals, session.measure(order, moves))
    _show_modes(measured)
    _write(measured, given, yes=on.yes)
    return 0


def _show_modes(measured: Measured) -> None:
    print(printable(measured.title), printable(f"  {measured.remark}"), sep="\n")
    for letter, frequency, damping, share in measured.modes:
        numbers = f"{frequency:7.2f} Hz, damping {damping:.3f}"
        print(f"{letter.upper()}  {numbers}, {100.0 * share:.0f} % of the energy")


def _measure(order: Order, on: GaugeOptions, probe: ProbeOptions) -> int:
    """Carry out an order, show its result, and write its keys."""
    from cnc.boards.registry import board_factory
    from cnc.model.units import per_second
    from cnc.operate import measuring

    on.terminal.open_log(on.machine)
    given = cnc.load_machine(on.machine)
    plain = measuring.measured_machine(given, order)
    if order.probe is not None and board_factory(on.board or given.board.kind).traits.simulated:
        raise measuring.no_probe()
    feed = None if on.feed is None else per_second(on.feed)
    with cli.operating.connected(plain, on.board, on.port) as (session, signals):
        moves = measuring.Moves(feed, probe.contact_feed, on.unhomed)
        measured = _answered(session, signals, session.measure(order, moves))
    _show(measured)
    _write(measured, given, yes=on.yes)
    return 0


def _answered(
    session: OperatorSession, control: Control, future: Future[Measured | None]
) -> Measured:
    """Answer the questions of a measurement until its end.

    Raises:
        KeyboardInterrupt: The operator stopped the machine.
        CncError: As the measurement, and ``reading-missing`` at the end of input.
    """
    from cnc.operate.events import Dialog

    events: SimpleQueue[Event | None] = SimpleQueue()
    session.listen(events.put)
    if session.dialog is not None:
        events.put(session.dialog)
    future.add_done_callback(lambda _: events.put(None))
    answered = 0
    while (event := events.get()) is not None:
        if control.stopped:
            session.stop()
        elif isinstance(event, Dialog) and event.id > answered:
            answered = event.id
            number = _read(event.text, control) if event.kind == "reading" else None
            if event.kind == "todo":
                _let_do(event.text, control)
            session.answer(event.id, True, number)
    error = future.exception()
    measured = None if error is not None else future.result()
    if control.stopped or (measured is None and error is None):
        raise KeyboardInterrupt
    if error is not None:
        raise error
    assert measured is not None
    return measured


def _let_do(text: str, control: Control) -> None:
    """Wait for a line. UsageError ``reading-missing`` at the end of input."""
    print(text, "then press Enter: ", sep="\n", end="", file=sys.stderr, flush=True)
    if not typed_line(control):
        print(file=sys.stderr)
        hint = "answer at the terminal, or give an empty line on standard input"
        raise UsageError(Diagnostic("reading-missing", f"no answer to: {text}", hint=hint))


def _read(text: str, control: Control) -> float:
    """Ask for a number until there is one.

    Raises:
        UsageError: ``reading-missing`` at the end of input.
        KeyboardInterrupt: As :func:`cnc.cli.signals.typed_line`.
    """
    *todo, what = text.split("\n")
    for line in todo:
        print(line, file=sys.stderr)
    while True:
        print(f"{what}: ", end="", file=sys.stderr, flush=True)
        line = typed_line(control)
        if not line:
            print(file=sys.stderr)
            hint = "type the numbers, or give them on standard input, one a line"
            raise UsageError(Diagnostic("reading-missing", f"no number for: {what}", hint=hint))
        try:
            number = float(line.strip().removesuffix("mm"))
        except ValueError:
            number = math.nan
        if math.isfinite(number):
            return number
        print("  a number in mm is wanted, such as 0.043", file=sys.stderr)


def _show(measured: Measured) -> None:
    """Print the result and its picture."""
    print(printable(measured.title))
    print(printable(f"  {measured.remark}"))
    bars = measured.bars
    width = max((len(bar.name) for bar in bars), default=0)
    print(f"  {'error, mm':{width}}  {'before':^{2 * BAR + 10}}{'after':^{2 * BAR + 10}}")
    for name, before, after, *parts in bars:
        print(f"  {name:{width}}  {_bar(before, parts[0])}{_bar(after, parts[1])}")


def _bar(value: float, part: float) -> str:
    """Return a number with a bar to the left or right of 0."""
    length = round(BAR * abs(part))
    left, right = ("#" * length, "") if part < 0.0 else ("", "#" * length)
    return f"{value:+8.4f} {left:>{BAR}}|{right:{BAR}}"


def _write(measured: Measured, machine: Machine, *, yes: bool) -> None:
    """Show the change of the machine file, ask, and write it. Without a file, name the keys."""
    from cnc.measure import machine_file

    change = machine_file.Change.of(measured, machine)
    if change.refusal:
        print(printable(change.refusal), *(f"  {step}" for step in change.steps), sep="\n")
        if change.table is not None:
            print(f"and into {change.table.name}:", change.rows, sep="\n")
        return
    change.new_text()
    with Keyboard(Control()) as asked:
        if not asked.confirm([f"change in {change.file}:", *change.steps], yes=yes):
            print("nothing was written")
            return
    change.write()
    print(printable(f"written to {change.file}"))
    if not measured.modes:
        print("home the machine before it runs again")
    if machine.error_map is not None and measured.is_of_place:
        print("machine.error_map was measured with the values before: measure it again")
