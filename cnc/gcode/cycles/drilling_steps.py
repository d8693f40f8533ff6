"""Steps of the canned cycles for holes, from the numbers of :mod:`cnc.kernels.gcode.holes`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from cnc.gcode.cycles.steps import (
    Cut,
    OperatorStop,
    OrientSpindle,
    Pause,
    Point,
    Rapid,
    SetOverrides,
    Step,
    Turning,
    TurnSpindle,
    opposite,
)
from cnc.gcode.syntax.code_numbers import G
from cnc.kernels.gcode import holes as kernel
from cnc.kernels.gcode.holes import Hole, HoleSettings
from cnc.kernels.gcode.rows import PAUSE, STRAIGHT
from cnc.kernels.jit import interpreted

_add_hole, _most_steps = interpreted(kernel.add_hole), interpreted(kernel.most_steps)


def steps(
    cycle: G, position: Point, holes: Iterable[Hole], settings: HoleSettings, turning: Turning
) -> Iterator[Step]:
    """Return the steps of a line with a cycle.

    Args:
        cycle: The code of the cycle.
        position: The point before the line.
        holes: The holes.
        settings: Their settings.
        turning: Direction of the spindle before the cycle.
    """
    events: dict[int, Step] = {
        kernel.SPINDLE_OFF: TurnSpindle("off"),
        kernel.SPINDLE_BACK: TurnSpindle(opposite(turning)),
        kernel.SPINDLE_AGAIN: TurnSpindle(turning),
        kernel.ORIENT: OrientSpindle(),
        kernel.OPERATOR_STOP: OperatorStop(),
        kernel.OVERRIDES_OFF: SetOverrides(overrides=False),
        kernel.OVERRIDES_ON: SetOverrides(overrides=True),
    }
    number = cycle // 10
    for hole in holes:
        most = _most_steps(number, hole, settings)
        space = kernel.Steps(np.empty(most, np.uint8), np.zeros((most, 4)))
        count = _add_hole(0, number, position, hole, settings, space)
        position = hole.first, hole.second, hole.clear
        for kind, numbers in zip(
            space.kinds[:count].tolist(), space.numbers[:count].tolist(), strict=True
        ):
            if kind == STRAIGHT:
                *to, feed = numbers
                yield Cut(tuple(to), feed) if feed == feed else Rapid(tuple(to))
            else:
                yield Pause(numbers[0]) if kind == PAUSE else events[kind]
