"""The commands ``cncrun measure``: guided measurements, and their keys in the machine file."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

from cyclopts import Parameter

import cnc
from cnc import cli
from cnc.cli.keyboard import Keyboard
from cnc.cli.operate_commands import TERMINAL, PortOption
from cnc.cli.options import BoardOption, MachineOption, TerminalOptions, option
from cnc.cli.signals import OperatorSignals, typed_line
from cnc.model.diagnostics import CncError, Diagnostic, UsageError, printable
from cnc.model.operator_control import Control

if TYPE_CHECKING:
    import cnc.cli.operating
    from cnc.machine.compensation import ErrorPoint
    from cnc.machine.models import Machine
    from cnc.measure.limits import Strokes
    from cnc.measure.probing import Face
    from cnc.measure.procedures import Measured, Procedure, Scale
    from cnc.operate.operator_session import OperatorSession

T = TypeVar("T")
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

    def face(self, towards: int = 1) -> Face:
        """Return how faces are touched."""
        from cnc.measure.probing import Face

        return Face(towards, self.reach, self.contacts)

    def towards(self, text: str, example: str) -> tuple[str, Face]:
        """Return the axis of a touch such as ``Y-``, and how it touches.

        Raises:
            UsageError: ``measure-option``.
        """
        if len(text) != 2 or text[1] not in "+-":
            message = f"{printable(text)!r} is no direction of a touch"
            hint = f"name the axis and its direction: --touch {example}"
            raise UsageError(Diagnostic("measure-option", message, hint=hint))
        return text[0].lower(), self.face(1 if text[1] == "+" else -1)


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
    from cnc.measure import probing, procedures

    if with_probe.probe:
        other, face = with_probe.towards(touch, "Y-")

        def begin_probe(scales: Sequence[Scale]) -> Procedure:
            return probing.backlash(scales[0], scales[1], face, repeats=repeats)

        return _measure([axis, other], begin_probe, on_board, with_probe)

    def begin(scales: Sequence[Scale]) -> Procedure:
        return procedures.backlash(scales[0], reverse=reverse, repeats=repeats)

    return _measure([axis], begin, on_board)


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
    from cnc.measure import probing, procedures

    if with_probe.probe:
        touching, face = with_probe.towards(at_faces.touch, f"{axis.upper()}-")
        if touching != axis.lower():
            message = f"the faces are touched along {axis.upper()}, not along {touching.upper()}"
            hint = f"--touch {axis.upper()}- or {axis.upper()}+"
            raise UsageError(Diagnostic("measure-option", message, hint=hint))
        upright = "y" if touching == "z" else "z"

        def begin_probe(scales: Sequence[Scale]) -> Procedure:
            return probing.pitch(
                scales[0],
                scales[1],
                face,
                faces=at_faces.faces,
                lift=at_faces.lift,
                blocks=at_faces.blocks,
            )

        return _measure([axis, upright], begin_probe, on_board, with_probe, needs_home=True)
    if first is None or last is None:
        message, hint = "the places are not given", "such as --first 0 --last 300 --places 31"
        raise UsageError(Diagnostic("measure-option", message, hint=hint))

    def begin(scales: Sequence[Scale]) -> Procedure:
        return procedures.pitch(scales[0], first=first, last=last, places=places, both=both)

    return _measure([axis], begin, on_board, needs_home=True)


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
    from cnc.measure import probing, procedures

    if axes.lower() not in ("xy", "xz", "yz"):
        message = f"{printable(axes)} is no pair of axes"
        raise UsageError(Diagnostic("measure-axis", message, hint="the pairs are XY, XZ, YZ"))

    def begin(scales: Sequence[Scale]) -> Procedure:
        pair = scales[0], scales[1]
        if with_probe.probe:
            return probing.square(
                pair, with_probe.face(), lengths=lengths, outside=outside, turned=not once
            )
        return procedures.square(
            pair,
            lengths=lengths,
            points_to_plus=plunger == "plus",
            turned=not once,
        )

    return _measure(list(axes), begin, on_board, with_probe)


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
    velocity, acceleration, jerk = map(max, step.out, step.back)
    numbers = f"{velocity:.4g} mm/s, {acceleration:.4g} mm/s^2"
    return numbers if jerk == math.inf else f"{numbers}, {jerk:.4g} mm/s^3"


def ringing(
    record: Annotated[str, Parameter(help="A csv file: times, s, and accelerations.")],
    /,
    *,
    terminal: TerminalOptions = TERMINAL,
) -> int:
    """Find the modes of a frame that rings in the record of an accelerometer; nothing moves.

    Record taps on the frame, or short quick moves with rests of 0.5 s.
    """
    terminal.open_log(record)
    cli.load_library()
    from cnc.measure import ringing as records

    rate, columns = records.read_record(Path(record))
    found = {letter: records.modes(samples, rate) for letter, samples in columns.items()}
    print(f"{rate:.0f} samples a second")
    for letter, modes in found.items():
        for mode in modes:
            numbers = f"{mode.frequency:7.2f} Hz, damping {mode.damping:.3f}"
            print(f"{letter.upper()}  {numbers}, {100.0 * mode.share:.0f} % of the energy")
    print("the machine file has no keys for modes: use the numbers for an input shaper")
    return 0


def _measure(
    axes: Sequence[str],
    begin: Callable[[Sequence[Scale]], Procedure],
    on: GaugeOptions,
    probe: ProbeOptions = PROBE,
    *,
    needs_home: bool = False,
) -> int:
    """Carry out a procedure, show its result, and write its keys."""
    from cnc.boards.registry import board_factory
    from cnc.model.units import per_second
    from cnc.operate import measuring

    on.terminal.open_log(on.machine)
    given, letters = cnc.load_machine(on.machine), [axis.lower() for axis in axes]
    if probe.probe and board_factory(on.board or given.board.kind).traits.simulated:
        message, hint = "a simulated board has no probe that touches a face", "name a real board"
        raise UsageError(Diagnostic("measure-board", message, hint=hint))
    if probe.probe and given.kind == "lathe":
        message, hint = "the probe measures along X, not across a diameter", "use a gauge"
        raise UsageError(Diagnostic("measure-option", message, hint=hint))
    # A touch needs an axis that rests while another one moves.
    apart = {letter for letter in given.axes if letter in measuring.LINEAR} if probe.probe else ()
    plain = measuring.uncompensated(given, {*letters, *apart}, square=len(letters) > 1)
    feed = None if on.feed is None else per_second(on.feed)
    with cli.operating.connected(plain, on.board, on.port) as (session, signals):
        for letter in letters if needs_home else ():
            if not session.state.homed.get(letter, True):
                message = f"{letter.upper()} is not homed: the table is for places of the machine"
                raise UsageError(Diagnostic("measure-axis", message, hint="run cncrun home first"))
        scales = [measuring.scale_of(session, letter) for letter in letters]
        measured = measuring.carried_out(
            begin(scales),
            session,
            _AtTerminal(session, signals),
            measuring.Moves(feed, probe.contact_feed, on.unhomed),
        )
    _show(measured)
    _write(measured, given, yes=on.yes)
    return 0


class _AtTerminal:
    """The operator at the terminal."""

    def __init__(self, session: OperatorSession, control: Control) -> None:
        self._session, self._control = session, control

    def wait(self, future: Future[T]) -> T:
        """Return a result. KeyboardInterrupt where the operator stops the machine."""
        try:
            result = cli.operating.waited(self._session, self._control, future)
        except CncError:
            if self._control.stopped:
                raise KeyboardInterrupt from None
            raise
        if self._control.stopped:
            raise KeyboardInterrupt
        return result

    def read(self, text: str) -> float:
        """Return a number that is typed."""
        return _read(text, self._control)

    def let_do(self, text: str) -> None:
        """Wait for a line."""
        print(text, "then press Enter: ", sep="\n", end="", file=sys.stderr, flush=True)
        if not typed_line(self._control):
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
    largest = max((max(abs(row.before), abs(row.after)) for row in measured.rows), default=0.0)
    width = max((len(row.name) for row in measured.rows), default=0)
    print(f"  {'error, mm':{width}}  {'before':^{2 * BAR + 10}}{'after':^{2 * BAR + 10}}")
    for row in measured.rows:
        print(f"  {row.name:{width}}  {_bar(row.before, largest)}{_bar(row.after, largest)}")


def _bar(value: float, largest: float) -> str:
    """Return a number with a bar to the left or right of 0."""
    length = round(BAR * abs(value) / largest) if largest else 0
    left, right = ("#" * length, "") if value < 0.0 else ("", "#" * length)
    return f"{value:+8.4f} {left:>{BAR}}|{right:{BAR}}"


def _write(measured: Measured, machine: Machine, *, yes: bool) -> None:
    """Show the change of the machine file, ask, and write it. Without a file, name the keys."""
    from cnc.machine.load import shipped_machines
    from cnc.measure import machine_file
    from cnc.session.required_capabilities import takes_lines

    name, file = machine.file, Path(machine.file).resolve()  # a link stays one
    keys = dict(measured.keys)
    remark = f"measured {date.today().isoformat()}: {measured.remark}"
    table = None
    for path in keys:
        if path[-1] == "error_table":
            table = file.with_name(f"{file.stem}-{path[1]}-errors.csv")
            keys[path] = table.name
    steps = [f"{'.'.join(path)} = {value}" if value is not None else f"no {'.'.join(path)}"
             for path, value in keys.items()]  # fmt: skip
    if not name or not file.is_file() or name in map(str, shipped_machines().values()):
        print("write into a machine file of your own:", *steps, sep="\n  ")
        if table is not None:
            print(f"and into {table.name}:", _csv(measured.table, remark), sep="\n")
        return
    if takes_lines(machine.board.kind):
        print(f"nothing was written: the board {machine.board.kind} plans by itself, so errors of")
        print("the machine are not compensated there. For a board that plays pulses it would be:")
        print(*steps, sep="\n")
        return
    before = file.read_bytes().decode()  # with the ends of its lines
    after = machine_file.changed_text(before, keys, remark)
    if table is not None:
        steps.append(f"{table} with {len(measured.table)} rows")
    with Keyboard(Control()) as asked:
        if not asked.confirm([f"change in {file}:", *steps], yes=yes):
            print("nothing was written")
            return
    tables = {} if table is None else {table: _csv(measured.table, remark)}
    machine_file.write(file, after, tables)
    print(printable(f"written to {file}"), "home the machine before it runs again", sep="\n")
    if machine.error_map is not None and measured.is_of_place:
        print("machine.error_map was measured with the values before: measure it again")


def _csv(table: Sequence[ErrorPoint], remark: str) -> str:
    """Return the text of an error table."""
    rows = (f"{row.place:g},{row.forward:g},{row.reverse:g}" for row in table)
    return "\n".join([f"# {remark}", "position,forward_error,reverse_error", *rows, ""])
