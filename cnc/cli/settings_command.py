"""The command ``cncrun settings``: show, change, save and restore the settings of a GRBL board."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from cnc.cli.keyboard import Keyboard
from cnc.cli.options import BoardOption, MachineOption, TerminalOptions, library, option
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.model.operator_control import Control
from cnc.model.shown_text import printable

if TYPE_CHECKING:
    from cnc.boards.protocols import BoardSettings
    from cnc.machine.models import Machine

TERMINAL = TerminalOptions()


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
    if sum(each is not None for each in (name, save, load)) > 1:
        message, hint = "settings does one thing at a time", "give a setting, --save, or --load"
        raise UsageError(Diagnostic("usage", message, hint=hint))
    known = library().load_machine(machine)
    with _opened(known, board, port) as found:
        if save is not None:
            _save(found, save)
        elif load is not None:
            _change(found, found.parsed(_lines_of(load), load), yes=yes)
        elif name is not None and "=" in name:
            number, _, value = name.partition("=")
            _change(found, {found.number_of(number.strip()): value.strip()}, yes=yes)
        else:
            _show(found, known, name)
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
