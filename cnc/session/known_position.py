"""Start position of a program on a board that plays pulses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cnc.boards.protocols import PulseSink
from cnc.executor.homing_cycles import homed_steps, homing_sequence
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError, Diagnostic
from cnc.planner.joints import Joints
from cnc.session.context import SessionContext


def locate(context: SessionContext, board: PulseSink) -> None:
    """Set the start position: where the board knows it is, or where homing will leave it.

    A board that does not remember its position begins where the machine file says.

    Raises:
        BoardError: ``not-homed`` if the board has lost a position that homing can find, or
            ``singular-pose`` where the machine stands.
    """
    reader, machine = context.reader, context.reader.machine
    known, joints = board.known_steps, Joints(machine)
    if known is None:
        return
    homed_machine = machine if joints.linear else joints.machine
    sequence = (
        homing_sequence(homed_machine, (), len(board.switches))
        if context.options.home and board.capabilities.limit_switches
        else ()
    )
    steps = homed_steps(machine, sequence, known, reader.start)
    place = steps / joints.machine.steps_per_mm
    reader.start = joints.tip(place)
    if not joints.determined(place):
        names = zip(joints.machine.axes, place.tolist(), strict=True)
        where = " ".join(f"{name} = {value:g}" for name, value in names)
        message = f"the machine stands in a pose that its tip does not determine ({where})"
        hint = "move it away from the pole by hand with the drivers off, then home it"
        raise BoardError(Diagnostic("singular-pose", message, hint=hint))
    homed = {axis.letter for axis in sequence}
    lost = [
        name
        for name, place in zip(joints.machine.axes, known, strict=True)
        if place is None and name not in homed
    ]
    if not lost or sequence:
        return
    message = f"the board has lost the position of {' '.join(lost).upper()}"
    if machine.can_home:
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
