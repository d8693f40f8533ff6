"""The command ``cncrun settings``: show, change, save and restore the settings of a GRBL board."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from cnc.cli.keyboard import Keyboard
from cnc.cli.options import BoardOption, MachineOption, TerminalOptions, library, option
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.model.operator_control import Control
from cnc.model.shown_text import printable

if TYPE_CHECKING:
    from cnc.boards.grbl.driver import GrblBoard
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
    opened = _opened(known, board, port)
    try:
        if save is not None:
            _save(opened, save)
        elif load is not None:
            from cnc.boards.grbl.setting_changes import parsed

            _change(opened, parsed(_lines_of(load), load), yes=yes)
        elif name is not None and "=" in name:
            number, _, value = name.partition("=")
            from cnc.boards.grbl.setting_changes import number_of

            _change(opened, {number_of(number.strip()): value.strip()}, yes=yes)
        else:
            _show(opened, known, name)
    finally:
        opened.close()
    return 0


def _opened(machine: Machine, board: str | None, port: str | None) -> GrblBoard:
    """Return the board; UsageError ``no-settings`` for a board without numbered settings."""
    from cnc.boards.grbl.driver import GrblBoard
    from cnc.boards.registry import board_factory, open_board

    kind = board or (machine.board.kind if machine.board.kind.startswith("grbl") else "grbl")
    factory = board_factory(kind)
    if not (isinstance(factory, type) and issubclass(factory, GrblBoard)):
        message, hint = f"the board {kind!r} has no settings", "name a GRBL board with --board grbl"
        raise UsageError(Diagnostic("no-settings", message, hint=hint))
    opened = open_board(machine, kind=kind, port=port)
    assert isinstance(opened, GrblBoard)
    if not opened.info.settings:
        opened.close()
        message = f"the board has no numbered settings ({opened.info.firmware})"
        hint = "FluidNC keeps them in its file config.yaml: change that file"
        raise UsageError(Diagnostic("no-settings", message, hint=hint))
    return opened


def _show(board: GrblBoard, machine: Machine, name: str | None) -> None:
    from cnc.boards.grbl.setting_changes import differing, expected_by, names_of, number_of

    info, names = board.info, names_of(board.link)
    other = differing(info, expected_by(machine, info))
    wanted = sorted(info.settings) if name is None else [number_of(name)]
    for number in wanted:
        if number not in info.settings:
            message, hint = f"the board has no setting ${number}", "cncrun settings lists them"
            raise UsageError(Diagnostic("setting-unknown", message, hint=hint))
        mark = f"  (machine file: {other[number]:.10g})" if number in other else ""
        print(
            f"${number} = {info.settings[number]}  {printable(names.get(number, ''))}".rstrip()
            + mark
        )
    if name is None and other:
        count = "1 setting differs" if len(other) == 1 else f"{len(other)} settings differ"
        print(f"{count} from those of the machine file {machine.name!r}")


def _change(board: GrblBoard, wanted: dict[int, str], *, yes: bool) -> None:
    from cnc.boards.grbl.setting_changes import changes, names_of, write
    from cnc.boards.grbl.settings import STEPS

    listed = changes(board.info, wanted)
    if not listed:
        print("the board has these values already")
        return
    names = names_of(board.link)
    steps = [f"${n} {names.get(n, '')}: {before} -> {after}" for n, before, after in listed]
    with Keyboard(Control()) as keys:
        if not keys.confirm(["change on the board:", *steps], yes=yes):
            print("nothing was changed")
            return
    write(board.link, listed)
    print(*(f"${number} = {after}" for number, _, after in listed), sep="\n")
    if any(STEPS <= number < STEPS + 9 for number, _, _ in listed):
        print("home the machine: with other steps/mm its position is another one")


def _save(board: GrblBoard, name: str) -> None:
    text = "".join(f"${number}={value}\n" for number, value in sorted(board.info.settings.items()))
    try:
        Path(name).write_text(f"; {board.info.firmware} {board.info.build}\n{text}", "utf-8")
    except OSError as error:
        message, hint = f"{name} is not writable: {error.strerror}", "name another file"
        raise UsageError(Diagnostic("can-not-write", message, hint=hint)) from error
    print(f"{len(board.info.settings)} settings in {printable(name)}")


def _lines_of(name: str) -> list[str]:
    try:
        return Path(name).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        message, hint = f"{name} cannot be read: {error.strerror}", "check the name"
        raise UsageError(Diagnostic("can-not-read", message, hint=hint)) from error
