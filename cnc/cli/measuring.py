"""The work of the commands ``cncrun measure``, imported when it is carried out."""

from __future__ import annotations

import math
import sys
from concurrent.futures import Future
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple

from cnc.boards import registry
from cnc.cli.keyboard import Keyboard
from cnc.cli.operating import connected
from cnc.cli.options import (
    FaceOptions,
    GaugeOptions,
    MeasureOptions,
    ProbeOptions,
    SensorOptions,
)
from cnc.cli.signals import OperatorSignals, typed_line
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.measure import ringing
from cnc.measure.limits import UNITS
from cnc.measure.machine_file import Change
from cnc.measure.orders import Backlash, Order, Pitch, Ringing, Square, TouchProbe
from cnc.measure.procedures import Measured
from cnc.model.diagnostics import Diagnostic, UsageError, printable
from cnc.model.operator_control import Control
from cnc.model.units import per_second
from cnc.operate import measuring
from cnc.operate.events import Dialog, Event
from cnc.operate.operator_session import OperatorSession

BAR = 24
"""Columns of a bar on either side of 0."""


class Places(NamedTuple):
    """The places of a screw that are measured.

    Attributes:
        first: The lowest place, mm; None for that of the order.
        last: The highest place, mm; None for that of the order.
        number: Number of places.
        both: Whether each place is measured from above, too.
    """

    first: float | None
    last: float | None
    number: int
    both: bool


def backlash(
    axis: str, reverse: float, repeats: int, touch: str, probe: ProbeOptions, on: GaugeOptions
) -> int:
    """Measure the play of a nut; return the exit code."""
    touched = _touch_probe(probe, touch)
    return _measure(Backlash(axis=axis, reverse=reverse, repeats=repeats, probe=touched), on, probe)


def pitch(
    axis: str, places: Places, faces: FaceOptions, probe: ProbeOptions, on: GaugeOptions
) -> int:
    """Measure the errors of a screw; return the exit code."""
    order = Pitch(
        axis=axis,
        first=places.first,
        last=places.last,
        places=places.number,
        both=places.both,
        faces=faces.faces,
        lift=faces.lift,
        blocks=faces.blocks,
        probe=_touch_probe(probe, faces.touch),
    )
    return _measure(order, on, probe)


def square(
    axes: str,
    lengths: tuple[float, float],
    points_to_plus: bool,
    turned: bool,
    outside: bool,
    probe: ProbeOptions,
    on: GaugeOptions,
) -> int:
    """Measure the angle between two axes; return the exit code."""
    order = Square(
        axes=axes,
        lengths=lengths,
        points_to_plus=points_to_plus,
        turned=turned,
        outside=outside,
        probe=_touch_probe(probe),
    )
    return _measure(order, on, probe)


def _touch_probe(options: ProbeOptions, touch: str = "") -> TouchProbe | None:
    """Return the probe of an order; None for a gauge."""
    if not options.probe:
        return None
    return TouchProbe(touch=touch, reach=options.reach, contacts=options.contacts)


def limits(axis: str, most: float, on: MeasureOptions) -> int:
    """Raise the limits of an axis until it loses steps; return the exit code."""
    on.terminal.open_log(on.machine)
    given, letter = load_machine(on.machine), axis.lower()
    plain, control = measuring.uncompensated(given, [letter]), Control()
    with (
        measuring.opened(plain, on.board, on.port) as board,
        OperatorSignals(control) as signals,
    ):
        signals.moving = True
        test = measuring.LimitTest(board, plain, letter, control)
        print(f"{letter.upper()} moves fast over most of its travel; Ctrl-C stops", file=sys.stderr)
        raised = test.raised(most, lambda step: print(measuring.strokes(step), file=sys.stderr))
        rehearsed = board.traits.simulated
    for name, value, error in raised.trials:
        lost = "lost steps" if abs(error) > raised.allowed else "right"
        print(f"{name:12} {value:10.4g} {UNITS[name]:7} {error:+9.4f} mm  {lost}")
    print(printable(raised.measured.title), f"  {raised.measured.remark}", sep="\n")
    if rehearsed or not raised.measured.keys:
        reason = "the board is simulated, so " if rehearsed else ""
        print(f"{reason}the limits of the machine file stay")
        return 0
    _write(raised.measured, given, yes=on.yes)
    return 0


def of_record(record: str, on: SensorOptions) -> int:
    """Find the modes of a frame in a record; return the exit code."""
    on.terminal.open_log(record)
    file = Path(record)
    measured = ringing.of_record(ringing.read_record(file), file.name)
    _show_modes(measured)
    _write(measured, load_machine(on.machine), yes=on.yes)
    return 0


def shake(axis: str, on: SensorOptions) -> int:
    """Record short quick moves of an axis, and print the modes."""
    on.terminal.open_log(on.machine)
    order = Ringing(axis=axis)
    given = load_machine(on.machine)
    plain = measuring.measured_machine(given, order)
    with connected(plain, on.board, on.port) as (session, signals):
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
    on.terminal.open_log(on.machine)
    given = load_machine(on.machine)
    plain = measuring.measured_machine(given, order)
    if (
        order.probe is not None
        and registry.board_factory(on.board or given.board.kind).traits.simulated
    ):
        raise measuring.no_probe()
    feed = None if on.feed is None else per_second(on.feed)
    with connected(plain, on.board, on.port) as (session, signals):
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
    change = Change.of(measured, machine)
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
