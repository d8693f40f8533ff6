"""Guided measurements on a machine: the moves of a procedure, and the machine meanwhile."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from cnc.machine.models import Machine
from cnc.measure.procedures import GoTo, Measured, Procedure, Scale
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.operate.operator_session import OperatorSession

LINEAR = "xyzuvw"
Read = Callable[[str], float]
"""Asks the operator for a number: the text says of what."""
Move = Callable[[dict[str, float]], None]
"""Moves axes by distances, mm, and waits for the rest."""


def uncompensated(machine: Machine, letters: Iterable[str], *, square: bool = False) -> Machine:
    """Return the machine as it is while axes are measured: none of their errors is compensated.

    Args:
        machine: The machine.
        letters: The axes.
        square: Whether the angles between axes are measured too.

    Raises:
        UsageError: ``measure-axis`` for an axis without a motor of its own.
    """
    axes = dict(machine.axes)
    for letter in letters:
        if letter not in axes or letter not in LINEAR or machine.kinematics.joints:
            names = " ".join(axes).upper()
            message = f"{letter.upper()} is no linear axis with a motor of its own"
            raise UsageError(Diagnostic("measure-axis", message, hint=f"the axes are {names}"))
        axes[letter] = axes[letter].model_copy(update={"backlash": None, "error_table": None})
    changed = {"axes": axes, **({"squareness": None} if square else {})}
    return machine.model_copy(update=changed)


def scale_of(session: OperatorSession, letter: str) -> Scale:
    """Return an axis of a connected machine, where it stands now."""
    axis, homed = session.machine.joint_tables[letter], session.state.homed.get(letter, True)
    travel = (axis.travel if homed else None) or (-math.inf, math.inf)
    return Scale(letter, axis.steps_per_mm, session.state.machine[letter], travel)


def carried_out(procedure: Procedure, session: OperatorSession, move: Move, read: Read) -> Measured:
    """Carry out a procedure; return its result.

    Raises:
        CncError: As the procedure, the moves, and ``read``.
    """
    answer = 0.0
    try:
        step = next(procedure)
        while True:
            if isinstance(step, GoTo):
                way = step.place - session.state.machine[step.axis]
                if abs(way) > 0.5 / session.machine.joint_tables[step.axis].steps_per_mm:
                    move({step.axis: way})
            else:
                answer = read(step.text)
            step = procedure.send(answer)
    except StopIteration as end:
        result: Measured = end.value
        return result
