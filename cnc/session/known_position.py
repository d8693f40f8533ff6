"""Start position of a program on a board that plays pulses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cnc.boards.protocols import Located, Switched
from cnc.executor.homing import rest_steps, ways_home
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError, Diagnostic
from cnc.session.context import SessionContext


def locate(context: SessionContext, board: Located) -> None:
    """Set the start position: where the board knows it is, or where homing will leave it.

    Raises:
        BoardError: ``not-homed`` if the board has lost a position that homing can find.
    """
    reader, machine = context.reader, context.reader.machine
    known = board.standing_steps
    ways = (
        ways_home(machine, (), len(board.switches))
        if context.options.home and isinstance(board, Switched)
        else ()
    )
    steps = rest_steps(machine, ways, known, reader.start)
    reader.start = steps / np.array([axis.steps_per_mm for axis in machine.axes.values()])
    homed = {way.letter for way in ways}
    lost = [
        letter
        for letter, place in zip(machine.axes, known, strict=True)
        if place is None and letter not in homed
    ]
    if not lost or ways:
        return
    message = f"the board has lost the position of {' '.join(lost).upper()}"
    if machine.homes:
        cause = "it was reset, or a limit switch or the emergency stop has stopped it"
        hint = "home the machine: --home does so before the program, cncrun home alone"
        raise BoardError(Diagnostic("not-homed", f"{message}: {cause}", hint=hint))
    context.observer.warn(_assumed(message, machine, reader.start))


def _assumed(message: str, machine: Machine, start: NDArray[np.float64]) -> Diagnostic:
    """Return the warning that a position is assumed."""
    each: Sequence[float] = start.tolist()
    places = " ".join(
        f"{letter.upper()}{place:g}" for letter, place in zip(machine.axes, each, strict=True)
    )
    message = f"{message}; the program begins as if the machine stood at {places}"
    hint = "on a machine with limit switches, home it: --home, or cncrun home"
    return Diagnostic("position-assumed", message, hint=hint, severity="warning")
