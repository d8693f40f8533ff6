"""The commands that operate a machine from the terminal: jog, unlock, zero, mdi, height-map."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

from cyclopts import Parameter, validators

import cnc
from cnc.cli.keyboard import Keyboard
from cnc.cli.messages import fail
from cnc.cli.options import (
    BoardOption,
    MachineOption,
    TerminalOptions,
    check_files,
    load_library,
    option,
)
from cnc.cli.progress import ProgressDisplay
from cnc.cli.signals import OperatorSignals, report_hang_up
from cnc.model.choices import Interpolation
from cnc.model.diagnostics import (
    EXIT_STOPPED,
    CncError,
    Diagnostic,
    UsageError,
    printable,
)
from cnc.model.operator_control import Control
from cnc.model.units import per_second

if TYPE_CHECKING:
    from concurrent.futures import Future

    from cnc.boards.protocols import BoardSettings
    from cnc.machine.models import Machine
    from cnc.operate.events import Event, Finding, JobEnded
    from cnc.operate.operator_session import OperatorSession
    from cnc.server.serve import Address


TERMINAL = TerminalOptions()
PortOption = Annotated[str | None, option("Port of the board (/dev/ttyUSB0).")]
TrustOption = Annotated[bool, option("The position that the board reports is right.")]
WORD = re.compile(r"([a-zA-Z])([-+]?(?:\d+\.?\d*|\.\d+))?")
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)"
SPAN = re.compile(rf"([xyXY])({_NUMBER}):({_NUMBER})", re.ASCII)
POLL = 0.1
"""Time between two looks at a signal, s."""
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
        mm_s = None if feed is None else per_second(feed)
        waited(session, signals, session.jog_step(wanted, mm_s, unhomed=unhomed))
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
        waited(session, signals, session.unlock(at_switch=False))
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
        offsets = waited(session, signals, session.zero(values, system.upper(), half=half))
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
        for line in lines or (line.rstrip("\n") for line in sys.stdin):
            if not line.strip():
                continue
            ended = waited(session, signals, session.mdi(line, trust_position=trust_position))
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
    check_files((output, terminal.log), (machine,))
    load_library()
    from cnc.machine.height_map import save_height_map
    from cnc.operate.height_mapping import Grid

    area_x, area_y = _spans(area)
    points = Grid(
        x=area_x,
        y=area_y,
        step=grid.step,
        clear=grid.clear,
        depth=grid.depth,
        feed=grid.feed,
        zero=grid.set_zero,
        interpolation=grid.interpolation,
        tolerance=grid.tolerance,
    )
    points.check()
    with _session(terminal, machine, board, port) as (session, signals):
        session.select_system(system.upper())
        try:
            surface = waited(
                session, signals, session.probe_grid(points, trust_position=trust_position)
            )
        except CncError:
            if signals.stopped:
                return EXIT_STOPPED
            raise
    save_height_map(surface, output)
    if not terminal.quiet:
        low, high = surface.extremes
        count = f"{len(surface.x)} x {len(surface.y)} points"
        print(f"height map   {printable(output)}: {count}, {low:.3f} to {high:.3f} mm")
    return 0


def _spans(given: Sequence[str]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ends of the area along X and Y; UsageError ``usage``."""
    matches = [SPAN.fullmatch(text) for text in given]
    spans = {m[1].lower(): (float(m[2]), float(m[3])) for m in matches if m is not None}
    if set(spans) != {"x", "y"} or len(given) != 2:
        message = "the area needs X and Y, each from its lowest position"
        hint = "such as X0:100 Y0:60"
        raise UsageError(Diagnostic("usage", message, hint=hint))
    return spans["x"], spans["y"]


@contextmanager
def _session(
    terminal: TerminalOptions, machine: str | None, board: str | None, port: str | None
) -> Iterator[tuple[OperatorSession, Control]]:
    """Provide a session with a connected board."""
    terminal.open_log(machine)
    load_library()
    with connected(cnc.load_machine(machine), board, port) as session:
        yield session


@contextmanager
def connected(
    machine: Machine, board: str | None, port: str | None
) -> Iterator[tuple[OperatorSession, Control]]:
    """Provide a session of a machine with a connected board, and the control of its signals."""
    from cnc.operate import events, operator_session

    control = Control()

    def show(event: Event) -> None:
        if isinstance(event, events.Notice) and event.finding.code == "mdi-modes":
            print(_diagnostic(event.finding).render(), file=sys.stderr)

    with (
        operator_session.OperatorSession(machine) as session,
        OperatorSignals(control) as signals,
    ):
        session.listen(show)
        session.connect(board, port).result()
        signals.moving = True
        yield session, control


def waited(session: OperatorSession, control: Control, future: Future[T]) -> T:
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
    values: dict[str, float] = {}
    for text in given:
        match = WORD.fullmatch(text)
        value = default if match is None or match[2] is None else float(match[2])
        if match is None or value is None or match[1].lower() in values:
            hint = f"give each axis once, such as {example}"
            message = f"{text!r} is not an axis with its distance"
            raise UsageError(Diagnostic("usage", message, hint=hint))
        values[match[1].lower()] = value
    if not values:
        raise UsageError(Diagnostic("usage", "no axis is given", hint=f"such as {example}"))
    return values


def _show_position(session: OperatorSession, terminal: TerminalOptions) -> None:
    if not terminal.quiet:
        state = session.state
        machine = (f"{axis.upper()}{place:.3f}" for axis, place in state.machine.items())
        work = (f"{axis.upper()}{place:.3f}" for axis, place in state.work.items())
        print("machine", *machine, f" {state.system}", *work)


def _show_findings(ended: JobEnded) -> None:
    for finding in ended.findings:
        print(_diagnostic(finding).render(), file=sys.stderr)


def _diagnostic(finding: Finding) -> Diagnostic:
    return Diagnostic(
        finding.code,
        finding.message,
        finding.file,
        finding.line,
        finding.column,
        finding.length,
        finding.text,
        finding.hint,
        finding.severity,
    )


# The commands ``cncrun boards`` and ``cncrun home``.


def boards(
    *ports: Annotated[
        str,
        Parameter(
            help="Ports to examine, also pyserial URLs; by default all serial ports of this "
            "computer."
        ),
    ],
    baud: Annotated[
        int,
        option(
            "Baud rate. Boards that do not answer at this one are tried as stepper boards at "
            "1000000 and as Klipper boards at 250000."
        ),
    ] = 115200,
    terminal: TerminalOptions = TERMINAL,
) -> int:
    """List the serial ports and the board at each.

    For a GRBL board its settings and a machine file made from them are printed (redirect the output
    into a file), for a stepper board its version, axes, tick and buffer, for a Klipper board its
    pins and the tables of a machine file. Opening a port resets most boards; nothing moves.
    """
    terminal.open_log()
    load_library()
    from cnc.boards import discovery, serial_port
    from cnc.session.position_check import write_offsets

    boards_there = discovery.probe_ports(ports, baud)
    for board in boards_there:
        if board.info is not None:
            write_offsets(serial_port.identity(board.port), board.info.named_places())
        print(*map(printable, discovery.port_report(board, baud)), sep="\n", flush=True)
    if not boards_there:
        print("# this computer has no serial port; is the board plugged in and switched on?")
    faults = (board.fault for board in boards_there if ports and board.fault is not None)
    return next(map(fail, faults), 0)


def home(
    *axes: Annotated[str, Parameter(help="Axes to home; by default all that have a switch.")],
    machine: MachineOption = None,
    board: BoardOption = None,
    port: Annotated[
        str | None, option("Port of the board (/dev/ttyUSB0); by default the machine file's.")
    ] = None,
    terminal: TerminalOptions = TERMINAL,
) -> int:
    """Home the machine on its limit switches.

    With a stepper or Klipper board each axis moves to its switch twice, then off it. A GRBL board
    homes all axes in its own cycle ($H). The loopback board rehearses homing: it has simulated
    switches at the ends of the travels.
    """
    terminal.open_log(machine)
    load_library()
    control = Control()
    keys = Keyboard(control, report_hang_up)
    with ProgressDisplay(control, quiet=terminal.quiet) as display, keys:
        if not keys.available:
            display.without_keys()
        positions = cnc.home(
            machine,
            axes,
            board=board,
            port=port,
            callbacks=display.callbacks(),
            control=control,
            on_axis=None if terminal.quiet else lambda axis: print(axis.description, flush=True),
            on_squared=None if terminal.quiet else lambda it: print(it.description, flush=True),
        )
    if not terminal.quiet:
        from cnc.report.result import position

        homed = {axis.upper(): value for axis, value in positions.items() if value is not None}
        if homed:
            print("the machine stands at", *(f"{axis}{position(at)}" for axis, at in homed.items()))
        lost = [axis.upper() for axis, value in positions.items() if value is None]
        if lost:
            print("not known:", *lost)
    return 0


# The command ``cncrun settings``: show, change, save and restore the settings of a GRBL board.


def settings(
    name: Annotated[
        str | None, Parameter(help="A setting, such as 110, or 110=5000 to change it.")
    ] = None,
    /,
    *,
    save: Annotated[str | None, option("Write all settings to FILE.")] = None,
    load: Annotated[str | None, option("Write the settings of FILE to the board.")] = None,
    yes: Annotated[bool, option("Do not ask before the board is changed.")] = False,
    machine: MachineOption = None,
    board: BoardOption = None,
    port: Annotated[str | None, option("Port of the board (/dev/ttyUSB0).")] = None,
    terminal: TerminalOptions = TERMINAL,
) -> int:
    """Show the settings ($$) of a GRBL board, or change them.

    Settings that differ from the machine file are marked. A change is shown, confirmed, written,
    and read back.
    """
    terminal.open_log(machine, load)
    if sum(given is not None for given in (name, save, load)) > 1:
        message, hint = "settings does one thing at a time", "give a setting, --save, or --load"
        raise UsageError(Diagnostic("usage", message, hint=hint))
    load_library()
    chosen = cnc.load_machine(machine)
    with _opened(chosen, board, port) as kept:
        if save is not None:
            _save(kept, save)
        elif load is not None:
            _change(kept, kept.parsed(_lines_of(load), load), yes=yes)
        elif name is not None and "=" in name:
            number, _, value = name.partition("=")
            _change(kept, {kept.number_of(number.strip()): value.strip()}, yes=yes)
        else:
            _show(kept, chosen, name)
    return 0


@contextmanager
def _opened(machine: Machine, board: str | None, port: str | None) -> Iterator[BoardSettings]:
    """Give the settings of a board; UsageError ``no-settings`` for a board without them."""
    from cnc.boards.registry import board_factory, open_board

    kind = board or machine.board.kind
    if board is None and not board_factory(kind).traits.has_settings:
        kind = "grbl"
    if not board_factory(kind).traits.has_settings:
        message, hint = f"the board {kind!r} has no settings", "name a GRBL board with --board grbl"
        raise UsageError(Diagnostic("no-settings", message, hint=hint))
    opened = open_board(machine, kind=kind, port=port)
    try:
        yield opened.numbered_settings()
    finally:
        opened.close()


def _show(board: BoardSettings, machine: Machine, name: str | None) -> None:
    values, names, other = board.values, board.names(), board.differing(machine)
    wanted = sorted(values) if name is None else [board.number_of(name)]
    for number in wanted:
        if number not in values:
            message, hint = f"the board has no setting ${number}", "cncrun settings lists them"
            raise UsageError(Diagnostic("setting-unknown", message, hint=hint))
        mark = f"  (machine file: {other[number]:.10g})" if number in other else ""
        print(f"${number} = {values[number]}  {printable(names.get(number, ''))}".rstrip() + mark)
    if name is None and other:
        count = "1 setting differs" if len(other) == 1 else f"{len(other)} settings differ"
        print(f"{count} from those of the machine file {machine.name!r}")


def _change(board: BoardSettings, wanted: dict[int, str], *, yes: bool) -> None:
    listed = board.changes(wanted)
    if not listed:
        print("the board has these values already")
        return
    names = board.names()
    steps = [f"${n} {names.get(n, '')}: {before} -> {after}" for n, before, after in listed]
    with Keyboard(Control()) as keys:
        if not keys.confirm(["change on the board:", *steps], yes=yes):
            print("nothing was changed")
            return
    other_steps = board.write(listed)
    print(*(f"${number} = {after}" for number, _, after in listed), sep="\n")
    if other_steps:
        print("home the machine: with other steps/mm its position is another one")


def _save(board: BoardSettings, name: str) -> None:
    text = "".join(f"${number}={value}\n" for number, value in sorted(board.values.items()))
    try:
        Path(name).write_text(f"; {board.firmware}\n{text}", "utf-8")
    except OSError as error:
        message, hint = f"{name} is not writable: {error.strerror}", "name another file"
        raise UsageError(Diagnostic("can-not-write", message, hint=hint)) from error
    print(f"{len(board.values)} settings in {printable(name)}")


def _lines_of(name: str) -> list[str]:
    try:
        return Path(name).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        message, hint = f"{name} cannot be read: {error.strerror}", "check the name"
        raise UsageError(Diagnostic("can-not-read", message, hint=hint)) from error


# The command ``cncrun serve``: the operator's console in a browser.


def serve(
    *,
    host: Annotated[
        str, option("Address to listen at; with any other than this, a token is compulsory.")
    ] = "127.0.0.1",
    port: Annotated[
        int,
        Parameter(
            help="Port to listen at; 0 for a free one, which the first line names.",
            validator=validators.Number(gte=0, lte=65535),
        ),
    ] = 8080,
    token: Annotated[
        str | None, option("Token of every request; by default a new one where one is needed.")
    ] = None,
    folder: Annotated[
        str | None,
        Parameter(name="--library", help="Folder of the jobs, with a folder of macros."),
    ] = None,
    machine: MachineOption = None,
    terminal: TerminalOptions = TERMINAL,
) -> int:
    """Serve the operator's console: jog, zero, check, run.

    It needs the extra: pip install 'cncrun[serve]'. It ends with Ctrl-C; the machine comes to rest.
    """
    terminal.open_log(machine)
    load_library()
    chosen = cnc.load_machine(machine)
    try:
        from cnc.server import serve as server
    except ImportError as error:
        message = f"the console needs {error.name}, which is not installed"
        hint = "pip install 'cncrun[serve]'"
        raise UsageError(Diagnostic("serve-missing", message, hint=hint)) from error

    def announce(address: Address) -> None:
        print(address.link, flush=True)
        if address.access.token is not None and not terminal.quiet:
            print(server.qr_code(address.link), flush=True)
        if not terminal.quiet:
            print(
                "This console is no emergency stop: the machine needs one of its own.", flush=True
            )

    server.serve(
        chosen,
        server.open_address(host, port, token),
        None if folder is None else Path(folder),
        announce=announce,
    )
    return 0
