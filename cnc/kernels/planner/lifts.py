"""The linear system of a step of the descent, and limits that are raised for a while.

Where the first motion is at or beyond a limit, the descent raises the limits, and lowers them again
as the motion leaves them. A motion between fixed ends has those of the cells raised that need it.
For a ramp to rest those of all cells are raised by the same share: else what one cell uses too much
would be pushed into another one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit

Floats = NDArray[np.float64]

NEAR, NEAREST = 0.99999, 1.0 - 1e-9
"""Limits are raised if the first motion uses more than the first share of one; more than the second
one where the limits of all cells are raised.
"""

LIFT, LEAST_LIFT = 0.003, 1e-5
"""Limits are raised by the first share at least; by the second one where those of all cells are."""

HIGH = 1e6
"""Limits raised by this share do not bind."""

TOUCH = 1e-4
"""Relative: a motion may exceed a limit by this."""


class NewtonSystem(NamedTuple):
    """The linear system of a Newton step over n cells.

    Attributes:
        diagonal: (n + 1, 2, 2): blocks of the Hessian, of which the upper halves count.
        upper: (n + 1, 2, 2): the blocks beside the diagonal.
        gradient: (n + 1, 2).
        step: (n + 1, 2): the solution.
        lift: (n,): share by which the limits of each cell are raised.
        used: (n,): the largest constraint of each cell, as a share of the limit not raised.
    """

    diagonal: Floats
    upper: Floats
    gradient: Floats
    step: Floats
    lift: Floats
    used: Floats


@njit
def system_for(n: int, lift: float) -> NewtonSystem:
    """Return a system for ``n`` cells whose limits are all raised by ``lift``."""
    return NewtonSystem(
        np.zeros((n + 1, 2, 2)),
        np.zeros((n + 1, 2, 2)),
        np.zeros((n + 1, 2)),
        np.zeros((n + 1, 2)),
        np.full(n, lift),
        np.zeros(n),
    )


@njit
def start_lifts(first: int, last: int, even: bool, system: NewtonSystem) -> bool:
    """Raise the limits of the cells that are at or beyond them; return whether there are any.

    ``even``: raise those of all cells, by as much as the one that is farthest beyond needs.
    """
    highest = 0.0
    for k in range(first, last):
        system.lift[k] = 0.0
        if system.used[k] >= (NEAREST if even else NEAR):
            least = LEAST_LIFT if even else LIFT
            system.lift[k] = 1.5 * max(system.used[k] - 1.0, 0.0) + least
            highest = max(highest, system.lift[k])
    if even:
        system.lift[first:last] = highest
    return highest > 0.0


@njit
def lower_even_lifts(first: int, last: int, part: float, system: NewtonSystem) -> bool:
    """Lower the limits of all cells as :func:`lower_lifts` does those of each."""
    lift = system.lift[first]
    worst = 0.0
    for k in range(first, last):
        worst = max(worst, system.used[k])
    if worst < NEAREST:
        lift = 0.0
    elif part > 0.4:
        lift -= 0.5 * (1.0 + lift - worst)
    system.lift[first:last] = lift
    return lift > 0.0


@njit
def lower_lifts(first: int, last: int, part: float, system: NewtonSystem) -> bool:
    """Lower the raised limits after a step of length ``part``; return whether some stay raised."""
    lifted = False
    for k in range(first, last):
        lift = system.lift[k]
        if lift > 0.0:
            if system.used[k] < NEAR:
                system.lift[k] = 0.0
            else:
                lifted = True
                if part > 0.4:
                    system.lift[k] -= 0.5 * (1.0 + lift - system.used[k])
    return lifted
