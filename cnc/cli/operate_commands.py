"""The commands that operate a machine from the terminal: jog, unlock, zero, mdi, height-map."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, TypeVar

from cyclopts import Parameter

from cnc.cli.options import (
    BoardOption,
    MachineOption,
    TerminalOptions,
    check_files,
    library,
    option,
)
from cnc.cli.signals import OperatorSignals
from cnc.model.choices import Interpolation
from cnc.model.diagnostics import (
    EXIT_STOPPED,
    CncError,
    Diagnostic,
    UsageError,
)
from cnc.model.operator_control import Control
from cnc.model.shown_text import printable

if TYPE_CHECKING:
    from concurrent.futures import Future

    from cnc.operate.events import Event, Finding, JobEnded
    from cnc.operate.height_mapping import Grid
    from cnc.operate.operator_session import OperatorSession

TERMINAL = TerminalOptions()
PortOption = Annotated[str | None, option("Port of the board (/dev/ttyUSB0).")]
TrustOption = Annotated[bool, option("The position that the board reports is right.")]
WORD = re.compile(r"([a-zA-Z])([-+]?(?:\d+\.?\d*|\.\d+))?")
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)"
SPAN = re.compile(rf"([xyXY])({_NUMBER}):({_NUMBER})", re.ASCII)
POLL = 0.1
"""Time between two looks at a signal, s."""
MM_PER_MIN = 60.0
T = TypeVar("T")


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class GridOptions:
    """Options of the grid of a height map."""

    step: Annotated[float, option("Largest distance of two points, mm.")] = 10.0
    clear: Annotated[float, option("Z of the moves between the points, mm.")] = 2.0
    depth: Annotated[float, option("Lowest Z of a contact, mm below the work zero.")] = 2.0
    feed: Annotated[float, option("Speed of the contacts, mm/min.")] = 60.0
    set_zero: Annotated[bool, option("The first contact becomes Z zero.")] = False
    interpolation: Annotated[Interpolation, option("Between the points.")] = "bilinear"
    tolerance: Annotated[
        float, option("Largest distance of the pieces of a move from the warped move, mm.")
    ] = 0.005

    def over(self, area: Mapping[str, tuple[float, float]]) -> Grid:
        """Return the grid over an area."""
        from cnc.operate.height_mapping import Grid

        return Grid(
            x=area["x"],
            y=area["y"],
            step=self.step,
            clear=self.clear,
            depth=self.depth,
            feed=self.feed,
            zero=self.set_zero,
            interpolation=self.interpolation,
            tolerance=self.tolerance,
        )


GRID = GridOptions()


def jog(
    *distances: Annotated[str, Parameter(help="Distance of each axis, such as X10 Y-2.5, mm.")],
    feed: Annotated[
        float | None, option("Speed, mm/min; by default the highest that stops within 0.2 s.")
    ] = None,
    unhomed: Annotated[bool, option("Move although the machine is not homed.")] = False,
    machine: MachineOption = None,
    board: BoardOption = None,
    port: PortOption = None,
    terminal: TerminalOptions = TERMINAL,
) -> int:
    """Move axes by a distance, within their travel.

    Ctrl-C brings the machine to rest.
    """
    wanted = _words(distances, "X10")
    with _session(terminal, machine, board, port) as (session, signals):
        mm_s = None if feed is None else feed / MM_PER_MIN
        _wait(session, signals, session.jog_step(wanted, mm_s, unhomed=unhomed))
        _show_position(session, terminal)
        return EXIT_STOPPED if signals.stopped else 0


def unlock(
    *,
    machine: MachineOption = None,
    board: BoardOption = None,
    port: PortOption = None,
    terminal: TerminalOptions = TERMINAL,
) -> int:
    """Leave an alarm of a GRBL board; nothing moves.

    The machine is not homed.
    """
    with _session(terminal, machine, board, port) as (session, signals):
        locked = session.state.state == "alarm"
        _wait(session, signals, session.unlock(at_switch=False))
        if not terminal.quiet:
            print("the board is unlocked" if locked else "the board was not locked")
        _show_position(session, terminal)
    return 0


def zero(
    *axes: Annotated[str, Parameter(help="Axes, such as X Y; X5 makes the present position 5 mm.")],
    system: Annotated[str, option("Coordinate system: G54 to G59.3, or G92.")] = "G54",
    half: Annotated[bool, option("Halve the present position: the middle between two sides.")] = (
        False
    ),
    machine: MachineOption = None,
    board: BoardOption = None,
    port: PortOption = None,
    terminal: TerminalOptions = TERMINAL,
) -> int:
    """Set the zero of a coordinate system; nothing moves.

    The zero is at the present position.
    """
    values = _words(axes, "X", default=0.0)
    with _session(terminal, machine, board, port) as (session, signals):
        offsets = _wait(session, signals, session.zero(values, system.upper(), half=half))
        if not terminal.quiet:
            place = offsets[system.upper()]
            print(system.upper(), *(f"{axis.upper()}{place[axis]:.3f}" for axis in place))
    return 0


def mdi(
    *lines: Annotated[str, Parameter(help="Lines to run; without any, those of standard input.")],
    trust_position: TrustOption = False,
    machine: MachineOption = None,
    board: BoardOption = None,
    port: PortOption = None,
    terminal: TerminalOptions = TERMINAL,
) -> int:
    """Run single lines, each checked as a program is.

    A line has the modes of the lines before it.
    """
    with _session(terminal, machine, board, port) as (session, signals):
        for line in lines or (each.rstrip("\n") for each in sys.stdin):
            if not line.strip():
                continue
            ended = _wait(session, signals, session.mdi(line, trust_position=trust_position))
            _show_findings(ended)
            if ended.outcome != "done":
                return EXIT_STOPPED if ended.outcome == "stopped" else ended.exit_code
        _show_position(session, terminal)
    return 0


def height_map(
    *area: Annotated[str, Parameter(help="Work positions, such as X0:100 Y0:60, mm.")],
    output: Annotated[
        str, Parameter(name=["--output", "-o"], help="The height map to write, a .json file.")
    ],
    grid: GridOptions = GRID,
    system: Annotated[str, option("Coordinate system: G54 to G59.3.")] = "G54",
    trust_position: TrustOption = False,
    machine: MachineOption = None,
    board: BoardOption = None,
    port: PortOption = None,
    terminal: TerminalOptions = TERMINAL,
) -> int:
    """Probe a surface on a grid, and write its height map.

    A run with --height-map follows the surface.
    """
    from cnc.machine.height_map import save_height_map

    check_files((output, terminal.log), (machine,))
    points = grid.over(_spans(area))
    points.check()
    with _session(terminal, machine, board, port) as (session, signals):
        session.select_system(system.upper())
        try:
            found = _wait(
                session, signals, session.probe_grid(points, trust_position=trust_position)
            )
        except CncError:
            if signals.stopped:
                return EXIT_STOPPED
            raise
    save_height_map(found, output)
    if not terminal.quiet:
        low, high = found.extremes
        count = f"{len(found.x)} x {len(found.y)} points"
        print(f"height map   {printable(output)}: {count}, {low:.3f} to {high:.3f} mm")
    return 0


def _spans(given: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Return the area by axis; UsageError ``usage``."""
    matches = [SPAN.fullmatch(text) for text in given]
    found = {m[1].lower(): (float(m[2]), float(m[3])) for m in matches if m is not None}
    if set(found) != {"x", "y"} or len(given) != 2:
        message = "the area needs X and Y, each from its lowest position"
        hint = "such as X0:100 Y0:60"
        raise UsageError(Diagnostic("usage", message, hint=hint))
    return found


@contextmanager
def _session(
    terminal: TerminalOptions, machine: str | None, board: str | None, port: str | None
) -> Iterator[tuple[OperatorSession, Control]]:
    """Provide a session with a connected board."""
    terminal.open_log(machine)
    known = library().load_machine(machine)
    from cnc.operate.events import Notice
    from cnc.operate.operator_session import OperatorSession

    control = Control()

    def show(event: Event) -> None:
        if isinstance(event, Notice) and event.finding.code == "mdi-modes":
            print(_diagnostic(event.finding).render(), file=sys.stderr)

    with OperatorSession(known) as session, OperatorSignals(control) as signals:
        session.listen(show)
        session.connect(board, port).result()
        signals.moving = True
        yield session, control


def _wait(session: OperatorSession, control: Control, future: Future[T]) -> T:
    """Return the result; a signal stops the machine, and the wait goes on until it is at rest."""
    while True:
        try:
            return future.result(POLL)
        except TimeoutError:
            if future.done():
                raise
            if control.stopped:
                session.stop()


def _words(given: Sequence[str], example: str, default: float | None = None) -> dict[str, float]:
    """Return the values by axis; UsageError ``usage``."""
    found: dict[str, float] = {}
    for text in given:
        match = WORD.fullmatch(text)
        value = default if match is None or match[2] is None else float(match[2])
        if match is None or value is None or match[1].lower() in found:
            hint = f"give each axis once, such as {example}"
            message = f"{text!r} is not an axis with its distance"
            raise UsageError(Diagnostic("usage", message, hint=hint))
        found[match[1].lower()] = value
    if not found:
        raise UsageError(Diagnostic("usage", "no axis is given", hint=f"such as {example}"))
    return found


def _show_position(session: OperatorSession, terminal: TerminalOptions) -> None:
    if not terminal.quiet:
        state = session.state
        each = (f"{axis.upper()}{place:.3f}" for axis, place in state.machine.items())
        work = (f"{axis.upper()}{place:.3f}" for axis, place in state.work.items())
        print("machine", *each, f" {state.system}", *work)


def _show_findings(ended: JobEnded) -> None:
    for each in ended.findings:
        print(_diagnostic(each).render(), file=sys.stderr)


def _diagnostic(found: Finding) -> Diagnostic:
    return Diagnostic(
        found.code, found.message, found.file, found.line, found.column, found.length, found.text,
        found.hint, found.severity,
    )  # fmt: skip
