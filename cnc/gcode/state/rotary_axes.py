"""Rotary axes that repeat after 360 degrees: the end of a move, and its direction.

A wrapped axis has the same place at 10, 370 and -350 degrees. Its position counts on over whole
turns, so the end of a move is one of these. The rule of the controller selects it:

    shortest  the nearest one; half a turn is positive. FANUC, parameter 1008 ROA = 1, RAB = 0
    sign      in the direction of the sign of the word. LinuxCNC, WRAPPED_ROTARY; FANUC, RAB = 1
    in-turn   within the present turn of 0 to 360 degrees. SINUMERIK, MD30310 ROT_IS_MODULO, AC

SINUMERIK also writes the direction beside the value: DC (shortest), ACP (positive) and ACN
(negative). Source: LinuxCNC, "INI configuration", WRAPPED_ROTARY; Siemens, "Programming Manual,
Fundamentals", DC, ACP, ACN.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal, get_args

from cnc.gcode.syntax.words import Word, fault
from cnc.model.choices import WrapRule

Direction = Literal["shortest", "positive", "negative", "counted"]
"""Direction of DC, ACP and ACN; with IC whole turns count."""

_DIRECTIONS: dict[str, Direction] = {name: name for name in get_args(Direction)}
TURN = 360.0
SAME = 1e-7
"""Degrees. An axis that is this near to its end does not make a turn."""


class RotaryAxes:
    """Ends of absolute moves of wrapped axes.

    Args:
        axes: letters of the machine's axes.
        rules: rule of each wrapped axis by its letter.
        of_dialect: rule of the dialect.

    Attributes:
        wrapped: whether an axis is wrapped, or has a direction in the present line.
    """

    def __init__(
        self, axes: tuple[str, ...], rules: Mapping[str, WrapRule], of_dialect: WrapRule
    ) -> None:
        self._rules = {
            column: of_dialect if rules[axis] == "dialect" else rules[axis]
            for column, axis in enumerate(axes)
            if axis in rules
        }
        self._directions: dict[int, Direction] = {}
        self.wrapped = bool(self._rules)

    def turn(self, column: int, direction: str) -> None:
        """Set the direction of an axis for the next word of it."""
        self._directions[column] = _DIRECTIONS[direction]
        self.wrapped = True

    def has(self, column: int) -> bool:
        """Return whether whole turns of an axis do not count."""
        return column in self._rules or column in self._directions

    def is_directed(self, column: int) -> bool:
        """Return whether an axis has a direction in the present line."""
        return column in self._directions

    def check(self, column: int, value: float, word: Word | None = None) -> None:
        """Check the value of an absolute move, degrees.

        Raises:
            GcodeError: ``wrapped-axis-range``, at the word.
        """
        rule = self._directions.get(column) or self._rules.get(column)
        if rule in (None, "shortest", "counted"):
            return
        lowest = -TURN if rule == "sign" else 0.0
        if not (lowest < value < TURN or value == 0.0):
            raise fault(
                "wrapped-axis-range",
                f"{value:g} degrees on an axis that repeats after 360 degrees",
                word,
                "write an angle from 0 to less than 360, or count the turns under G91",
            )

    def end(self, column: int, value: float, here: float) -> float:
        """Return the end of an absolute move in the coordinates of the word.

        Args:
            column: column of the axis.
            value: number of the word, degrees.
            here: present position, degrees.

        Raises:
            GcodeError: ``wrapped-axis-range``, without a place.
        """
        self.check(column, value)
        direction = self._directions.pop(column, None)
        self.wrapped = bool(self._rules or self._directions)
        rule = direction or self._rules[column]
        if rule == "counted":
            return value
        if rule == "shortest":
            return value + TURN * math.floor((here - value) / TURN + 0.5)
        negative = rule == "negative" or (rule == "sign" and math.copysign(1.0, value) < 0.0)
        angle = abs(value)
        if rule == "in-turn":
            return angle + TURN * math.floor((here + SAME) / TURN)
        ahead = (here - angle) / TURN
        nearest = angle + TURN * round(ahead)
        if abs(nearest - here) <= SAME:
            return nearest
        return angle + TURN * (math.floor(ahead) if negative else math.ceil(ahead))
