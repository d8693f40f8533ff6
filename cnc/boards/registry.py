"""Board drivers by name.

Other packages add drivers by entry points of the group ``cnc.boards``. A driver is imported only
when it is used.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import cast

from cnc.boards.protocols import BoardTraits, LineSink, PulseSink
from cnc.machine.models import Machine
from cnc.model.diagnostics import Diagnostic, UsageError

GROUP = "cnc.boards"

BUILT_IN = {
    name: EntryPoint(name, driver, GROUP)
    for name, driver in (
        ("loopback", "cnc.boards.loopback:Loopback"),
        ("file", "cnc.boards.file:FileBoard"),
        ("grbl", "cnc.boards.grbl.driver:GrblBoard"),
        ("grbl-sim", "cnc.simulators.grbl.board:GrblSimulatorBoard"),
        ("klipper", "cnc.boards.klipper.driver:Klipper"),
        ("klipper-sim", "cnc.simulators.klipper.ports:KlipperSimulatorBoard"),
        ("stepper", "cnc.boards.stepper.driver:Stepper"),
    )
}
"""Drivers of this package, which are known even without an installation."""


def _known() -> dict[str, EntryPoint]:
    """Return the entry point of each driver by its name."""
    return {point.name: point for point in entry_points(group=GROUP)} | BUILT_IN


def board_names() -> tuple[str, ...]:
    """Return the names for ``--board``, sorted."""
    return tuple(sorted(_known()))


BoardFactory = type[PulseSink] | type[LineSink]
"""A driver class, as named by the entry points of the group ``cnc.boards``."""


def board_factory(kind: str) -> BoardFactory:
    """Return the driver class called ``kind``.

    Raises:
        UsageError: ``unknown-board``, or ``board-not-loadable`` if the import fails.
    """
    # The search of all installed packages takes tenths of a second.
    entries = BUILT_IN if kind in BUILT_IN else _known()
    if kind not in entries:
        close = difflib.get_close_matches(kind, entries, n=1)
        hint = (
            f"did you mean {close[0]}?"
            if close
            else "set board.kind in the machine file, or --board"
        )
        raise UsageError(
            Diagnostic(
                "unknown-board",
                f"there is no board called {kind!r}; known are {', '.join(board_names())}",
                hint=hint,
            )
        )
    try:
        factory = cast(BoardFactory, entries[kind].load())
        if not isinstance(factory.traits, BoardTraits):
            raise AttributeError(f"its traits are not BoardTraits but {factory.traits!r}")
        if factory.takes not in ("pulses", "lines"):
            raise AttributeError(f"it takes neither pulses nor lines but {factory.takes!r}")
        return factory
    except (ImportError, AttributeError) as error:
        hint = "install the package that the driver needs"
        raise UsageError(
            Diagnostic(
                "board-not-loadable",
                f"the driver {entries[kind].value} does not load: {error}",
                hint=hint,
            )
        ) from error


def joints_on_board(machine: Machine, board: str) -> UsageError:
    """Return the error of a machine whose joints are not its axes, for a board that takes lines.

    The firmware of such a board plans, counts, homes and checks the travel in the places of its
    motors. Compensated lines would be right, but its limits and all its reports would be wrong.
    """
    if machine.is_compensated:
        message = f"{board} plans its own motion, so errors of the machine are not compensated"
        hint = (
            "use a board that plays pulses, or remove squareness, error_map, error_table, backlash"
        )
        return UsageError(Diagnostic("compensation-on-board", message, hint=hint))
    message = f"{board} has its kinematics in its firmware"
    hint = "leave [kinematics] and [joints] out of the machine file of such a board"
    return UsageError(Diagnostic("kinematics-on-board", message, hint=hint))


def open_board(
    machine: Machine,
    *,
    kind: str | None = None,
    target: Path | None = None,
    port: str | None = None,
    homes: bool = False,
    start: Sequence[float] | None = None,
) -> PulseSink | LineSink:
    """Open a board.

    Args:
        machine: The machine.
        kind: Name of the driver, instead of that in the machine file.
        target: File to write, for the file board.
        port: Port of the board, instead of that in the machine file.
        homes: Whether the machine is to be homed: a simulated board needs limit switches then.
        start: The board is for an operator, so that a simulated one runs in real time; it stands
            at this position of the joints, mm.

    Raises:
        UsageError: ``board-without-port``, ``kinematics-on-board`` for joints and a board that
            takes lines, or the driver is unknown or not loadable.
    """
    name = machine.board.kind if kind is None else kind
    factory = board_factory(name)
    if factory.takes == "lines" and (machine.kinematics.joints or machine.is_compensated):
        raise joints_on_board(machine, f"the board {name!r}")
    if port is not None:
        if not factory.traits.has_port:
            hint = "leave --port out, or name a board that has one: --board grbl"
            raise UsageError(
                Diagnostic("board-without-port", f"the board {name!r} has no port", hint=hint)
            )
        machine = machine.model_copy(
            update={"board": machine.board.model_copy(update={"port": port})}
        )
    if start is not None:
        return factory.for_operator(machine.of_joints, start)
    if homes and factory.takes == "pulses":
        return factory.with_switches(machine)
    return factory.from_machine(machine.of_joints, target)
