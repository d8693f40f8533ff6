"""The commands ``cncrun boards`` and ``cncrun home``."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from cnc.cli.exit_status import fail
from cnc.cli.keyboard import Keyboard
from cnc.cli.options import BoardOption, MachineOption, TerminalOptions, library, option
from cnc.cli.progress import ProgressDisplay
from cnc.cli.signals import report_hang_up
from cnc.model.operator_control import Control
from cnc.model.shown_text import printable

TERMINAL = TerminalOptions()


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
    from cnc.boards.discovery import port_report, probe_ports
    from cnc.boards.serial_port import identity
    from cnc.session.kept_offsets import write_offsets

    found = probe_ports(ports, baud)
    for each in found:
        if each.info is not None:
            write_offsets(identity(each.port), each.info.named_places())
        print(*map(printable, port_report(each, baud)), sep="\n", flush=True)
    if not found:
        print("# this computer has no serial port; is the board plugged in and switched on?")
    return next((fail(each.fault) for each in found if ports and each.fault is not None), 0)


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
    api = library()
    control = Control()
    keys = Keyboard(control, report_hang_up)
    with ProgressDisplay(control, quiet=terminal.quiet) as display, keys:
        positions = api.home(
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
        from cnc.report.number_format import position

        known = {axis.upper(): value for axis, value in positions.items() if value is not None}
        if known:
            print("the machine stands at", *(f"{axis}{position(at)}" for axis, at in known.items()))
        lost = [axis.upper() for axis, value in positions.items() if value is None]
        if lost:
            print("not known:", *lost)
    return 0
