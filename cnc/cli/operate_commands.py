"""The commands that operate a machine from the terminal: jog, unlock, zero, mdi, height-map."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter, validators

import cnc
from cnc.cli import work
from cnc.cli.keyboard import Keyboard
from cnc.cli.options import (
    TERMINAL,
    BoardOption,
    MachineOption,
    PortOption,
    TerminalOptions,
    check_files,
    option,
)
from cnc.cli.progress import ProgressDisplay
from cnc.cli.signals import report_hang_up, typed_line
from cnc.model.choices import Interpolation
from cnc.model.diagnostics import (
    EXIT_STOPPED,
    CncError,
    Diagnostic,
    UsageError,
)
from cnc.model.operator_control import Control
from cnc.model.units import per_second

if TYPE_CHECKING:
    from cnc.server.serve import Address

TrustOption = Annotated[bool, option("The position that the board reports is right.")]


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
    wanted = work.operating.words(distances, "X10")
    terminal.open_log(machine)
    with work.operating.connected(cnc.load_machine(machine), board, port) as (session, signals):
        mm_s = None if feed is None else per_second(feed)
        work.operating.waited(session, signals, session.jog_step(wanted, mm_s, unhomed=unhomed))
        work.operating.show_position(session, quiet=terminal.quiet)
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
    terminal.open_log(machine)
    with work.operating.connected(cnc.load_machine(machine), board, port) as (session, signals):
        locked = session.state.state == "alarm"
        work.operating.waited(session, signals, session.unlock(at_switch=False))
        if not terminal.quiet:
            print("the board is unlocked" if locked else "the board was not locked")
        work.operating.show_position(session, quiet=terminal.quiet)
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
    values = work.operating.words(axes, "X", default=0.0)
    terminal.open_log(machine)
    with work.operating.connected(cnc.load_machine(machine), board, port) as (session, signals):
        offsets = work.operating.waited(
            session, signals, session.zero(values, system.upper(), half=half)
        )
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
    terminal.open_log(machine)
    with work.operating.connected(cnc.load_machine(machine), board, port) as (session, signals):
        typed = iter(partial(typed_line, signals), "")
        for line in lines or (line.rstrip("\n") for line in typed):
            if not line.strip():
                continue
            ended = work.operating.waited(
                session, signals, session.mdi(line, trust_position=trust_position)
            )
            work.operating.show_findings(ended)
            if ended.outcome != "done":
                return EXIT_STOPPED if ended.outcome == "stopped" else ended.exit_code
        work.operating.show_position(session, quiet=terminal.quiet)
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
    chosen = asdict(grid)
    points = work.operating.grid_of(area, zero=chosen.pop("set_zero"), **chosen)
    terminal.open_log(machine)
    with work.operating.connected(cnc.load_machine(machine), board, port) as (session, signals):
        session.select_system(system.upper())
        try:
            surface = work.operating.waited(
                session, signals, session.probe_grid(points, trust_position=trust_position)
            )
        except CncError:
            if signals.stopped:
                return EXIT_STOPPED
            raise
    work.operating.write_map(surface, output, quiet=terminal.quiet)
    return 0


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
    return work.operating.print_boards(ports, baud)


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
    work.load_library()
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
        work.operating.print_homed(positions)
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
    work.load_library()
    chosen = cnc.load_machine(machine)
    with work.operating.opened_settings(chosen, board, port) as kept:
        if save is not None:
            work.operating.save_settings(kept, save)
        elif load is not None:
            work.operating.change_settings(
                kept, kept.parsed(work.operating.lines_of(load), load), yes=yes
            )
        elif name is not None and "=" in name:
            number, _, value = name.partition("=")
            work.operating.change_settings(
                kept, {kept.number_of(number.strip()): value.strip()}, yes=yes
            )
        else:
            work.operating.show_settings(kept, chosen, name)
    return 0


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
    work.load_library()
    if machine is None and folder is not None:
        machine = work.projects.machine_of(Path(folder))
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
