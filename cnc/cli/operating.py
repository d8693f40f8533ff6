"""The work of the commands that operate a machine, imported when it is carried out."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TypeVar

from cnc.boards import discovery, serial_port
from cnc.boards.protocols import BoardSettings
from cnc.boards.registry import board_factory, open_board
from cnc.cli.keyboard import Keyboard
from cnc.cli.messages import fail
from cnc.cli.signals import OperatorSignals
from cnc.machine.height_map import HeightMap, save_height_map
from cnc.machine.models import Machine
from cnc.model.diagnostics import Diagnostic, UsageError, printable
from cnc.model.operator_control import Control
from cnc.operate.events import Event, Finding, JobEnded, Notice
from cnc.operate.height_mapping import Grid
from cnc.operate.operator_session import OperatorSession
from cnc.report.result import position
from cnc.session.position_check import write_offsets

WORD = re.compile(r"([a-zA-Z])([-+]?(?:\d+\.?\d*|\.\d+))?")
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)"
SPAN = re.compile(rf"([xyXY])({_NUMBER}):({_NUMBER})", re.ASCII)
POLL = 0.1
"""Time between two looks at a signal, s."""
T = TypeVar("T")


def grid_of(area: Sequence[str], **options: Any) -> Grid:
    """Return a grid to probe; UsageError ``usage``, ``height-map-grid``.

    Args:
        area: Its ends along X and Y.
        **options: The other values of the grid.
    """
    matches = [SPAN.fullmatch(text) for text in area]
    ends = {m[1].lower(): (float(m[2]), float(m[3])) for m in matches if m is not None}
    if set(ends) != {"x", "y"} or len(area) != 2:
        message = "the area needs X and Y, each from its lowest position"
        hint = "such as X0:100 Y0:60"
        raise UsageError(Diagnostic("usage", message, hint=hint))
    grid = Grid(x=ends["x"], y=ends["y"], **options)
    grid.check()
    return grid


def write_map(surface: HeightMap, name: str, *, quiet: bool) -> None:
    """Write a height map, and print its size and its extremes."""
    save_height_map(surface, name)
    if not quiet:
        low, high = surface.extremes
        count = f"{len(surface.x)} x {len(surface.y)} points"
        print(f"height map   {printable(name)}: {count}, {low:.3f} to {high:.3f} mm")
    if surface.gaps:
        finding = replace(surface.gap_finding(printable(name)), severity="warning")
        print(finding.render(), file=sys.stderr)


@contextmanager
def connected(
    machine: Machine, board: str | None, port: str | None
) -> Iterator[tuple[OperatorSession, Control]]:
    """Provide a session of a machine with a connected board, and the control of its signals."""
    control = Control()

    def show(event: Event) -> None:
        if isinstance(event, Notice) and event.finding.code == "mdi-modes":
            print(_diagnostic(event.finding).render(), file=sys.stderr)

    with (
        OperatorSession(machine) as session,
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


def words(given: Sequence[str], example: str, default: float | None = None) -> dict[str, float]:
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


def show_position(session: OperatorSession, *, quiet: bool) -> None:
    """Print the position in machine and work coordinates."""
    if not quiet:
        state = session.state
        machine = (f"{axis.upper()}{place:.3f}" for axis, place in state.machine.items())
        work = (f"{axis.upper()}{place:.3f}" for axis, place in state.work.items())
        print("machine", *machine, f" {state.system}", *work)


def show_findings(ended: JobEnded) -> None:
    """Print the findings of a line to standard error."""
    for finding in ended.findings:
        print(_diagnostic(finding).render(), file=sys.stderr)


def _diagnostic(finding: Finding) -> Diagnostic:
    return Diagnostic(**asdict(finding))


def print_boards(ports: Sequence[str], baud: int) -> int:
    """Print the board at each port, and keep the offsets of GRBL boards; return the exit code."""
    found = discovery.probe_ports(ports, baud)
    for board in found:
        if board.info is not None:
            write_offsets(serial_port.identity(board.port), board.info.named_places())
        print(*map(printable, discovery.port_report(board, baud)), sep="\n", flush=True)
    if not found:
        print("# this computer has no serial port; is the board plugged in and switched on?")
    faults = (board.fault for board in found if ports and board.fault is not None)
    return next(map(fail, faults), 0)


def print_homed(positions: Mapping[str, float | None]) -> None:
    """Print where the machine stands after homing."""
    homed = {axis.upper(): value for axis, value in positions.items() if value is not None}
    if homed:
        print("the machine stands at", *(f"{axis}{position(at)}" for axis, at in homed.items()))
    lost = [axis.upper() for axis, value in positions.items() if value is None]
    if lost:
        print("not known:", *lost)


# The settings of a GRBL board: show, change, save and restore.


@contextmanager
def opened_settings(
    machine: Machine, board: str | None, port: str | None
) -> Iterator[BoardSettings]:
    """Give the settings of a board; UsageError ``no-settings`` for a board without them."""
    kind = board or machine.board.kind
    if board is None and not board_factory(kind).traits.has_settings:
        kind = "grbl"
    if not board_factory(kind).traits.has_settings:
        message, hint = f"the board {kind!r} has no settings", "name a GRBL board with --board grbl"
        raise UsageError(Diagnostic("no-settings", message, hint=hint))
    target = open_board(machine, kind=kind, port=port)
    try:
        yield target.numbered_settings()
    finally:
        target.close()


def show_settings(board: BoardSettings, machine: Machine, name: str | None) -> None:
    """Print the settings, or one of them, and mark those that differ from the machine file."""
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


def change_settings(board: BoardSettings, wanted: dict[int, str], *, yes: bool) -> None:
    """Show changes, and make them when they are confirmed."""
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


def save_settings(board: BoardSettings, name: str) -> None:
    """Write all settings to a file."""
    text = "".join(f"${number}={value}\n" for number, value in sorted(board.values.items()))
    try:
        Path(name).write_text(f"; {board.firmware}\n{text}", "utf-8")
    except OSError as error:
        message, hint = f"{name} is not writable: {error.strerror}", "name another file"
        raise UsageError(Diagnostic("can-not-write", message, hint=hint)) from error
    print(f"{len(board.values)} settings in {printable(name)}")


def lines_of(name: str) -> list[str]:
    """Return the lines of a file of settings. UsageError ``can-not-read``."""
    try:
        return Path(name).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        message, hint = f"{name} cannot be read: {error.strerror}", "check the name"
        raise UsageError(Diagnostic("can-not-read", message, hint=hint)) from error
