"""The commands ``cncrun jog``, ``cncrun zero`` and ``cncrun mdi``: a machine from the terminal."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, TypeVar

from cyclopts import Parameter

from cnc.cli.options import BoardOption, MachineOption, TerminalOptions, library, option
from cnc.cli.signals import OperatorSignals
from cnc.model.diagnostics import (
    EXIT_STOPPED,
    Diagnostic,
    UsageError,
)
from cnc.model.operator_control import Control

if TYPE_CHECKING:
    from concurrent.futures import Future

    from cnc.operate.events import JobEnded
    from cnc.operate.operator_session import OperatorSession

TERMINAL = TerminalOptions()
PortOption = Annotated[str | None, option("Port of the board (/dev/ttyUSB0).")]
WORD = re.compile(r"([a-zA-Z])([-+]?(?:\d+\.?\d*|\.\d+))?")
POLL = 0.1
"""Time between two looks at a signal, s."""
MM_PER_MIN = 60.0
T = TypeVar("T")


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
    """Move axes by a distance, within their travel. Ctrl-C brings the machine to rest."""
    wanted = _words(distances, "X10")
    with _session(terminal, machine, board, port) as (session, signals):
        mm_s = None if feed is None else feed / MM_PER_MIN
        _wait(session, signals, session.jog_step(wanted, mm_s, unhomed=unhomed))
        _show_position(session, terminal)
        return EXIT_STOPPED if signals.stopped else 0


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
    """Set the zero of a coordinate system at the present position; nothing moves."""
    values = _words(axes, "X", default=0.0)
    with _session(terminal, machine, board, port) as (session, signals):
        offsets = _wait(session, signals, session.zero(values, system.upper(), half=half))
        if not terminal.quiet:
            place = offsets[system.upper()]
            print(system.upper(), *(f"{axis.upper()}{place[axis]:.3f}" for axis in place))
    return 0


def mdi(
    *lines: Annotated[str, Parameter(help="Lines to run; without any, those of standard input.")],
    machine: MachineOption = None,
    board: BoardOption = None,
    port: PortOption = None,
    terminal: TerminalOptions = TERMINAL,
) -> int:
    """Run single lines, each checked as a program is, with the modes of the lines before it."""
    with _session(terminal, machine, board, port) as (session, signals):
        for line in lines or (each.rstrip("\n") for each in sys.stdin):
            if not line.strip():
                continue
            ended = _wait(session, signals, session.mdi(line))
            _show_findings(ended)
            if ended.outcome != "done":
                return EXIT_STOPPED if ended.outcome == "stopped" else ended.exit_code
        _show_position(session, terminal)
    return 0


@contextmanager
def _session(
    terminal: TerminalOptions, machine: str | None, board: str | None, port: str | None
) -> Iterator[tuple[OperatorSession, Control]]:
    """Provide a session with a connected board."""
    terminal.open_log(machine)
    known = library().load_machine(machine)
    from cnc.operate.operator_session import OperatorSession

    control = Control()
    with OperatorSession(known) as session, OperatorSignals(control) as signals:
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
        found = Diagnostic(
            each.code, each.message, each.file, each.line, each.column, each.length, each.text,
            each.hint, each.severity,
        )  # fmt: skip
        print(found.render(), file=sys.stderr)
