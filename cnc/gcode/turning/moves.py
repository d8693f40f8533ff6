"""Moves of the cycles of lathes: points of the ZX plane in program coordinates to blocks."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager, nullcontext
from typing import NamedTuple

from cnc.gcode.core.compensation_codes import CompensationCodes
from cnc.gcode.core.cycle_runner import refuse_modes
from cnc.gcode.core.motion import Motion
from cnc.gcode.reader.words import LineWords, Word, fault, positive

PIECES = 8
"""Pieces in which a turn of a thread of variable lead is cut; the lead is constant in each.

A piece leaves the thread by at most change / (8 * PIECES**2).
"""


class Helix(NamedTuple):
    """How a thread follows the spindle.

    Attributes:
        lead: mm a turn at its start.
        turns: Turns of the spindle a second.
        angle: Angle of the spindle at which it begins, degrees.
        change: Change of the lead, mm a turn each turn.
    """

    lead: float
    turns: float
    angle: float = 0.0
    change: float = 0.0

    def scaled(self, scale: float) -> Helix:
        """Return the thread with other lengths."""
        return self._replace(lead=self.lead * scale, change=self.change * scale)

    def number(self, length: float) -> float:
        """Return the turns in a length; NaN if the lead falls to 0 before."""
        if not self.change:
            return length / self.lead
        last = self.lead * self.lead + 2.0 * self.change * length
        return (math.sqrt(last) - self.lead) / self.change if last > 0.0 else math.nan


class TurningMoves:
    """Moves to points (z, x), mm in the coordinate system in use; x is a radius.

    Attributes:
        compensation: Nose compensation, which some cycles suspend; None if none does.
    """

    def __init__(self, motion: Motion) -> None:
        context = motion.context
        self.motion, self.dialect = motion, context.dialect
        self.context, self.here, self.out = context, context.here, context.out
        self._z = motion.column.get("Z")
        self._x = motion.column.get("X")
        self.compensation: CompensationCodes | None = None

    def uncompensated(self, at: Word) -> AbstractContextManager[None]:
        """Suspend nose compensation for the cycle at a word."""
        return nullcontext() if self.compensation is None else self.compensation.suspended(at)

    def check(self, at: Word) -> None:
        """Check that the cycle at a word is possible.

        Raises:
            GcodeError: ``axis-missing``, ``turning-plane``, ``figure-active``, and those of
                :func:`refuse_modes`.
        """
        name = at.written
        if self._z is None or self._x is None:
            raise fault("axis-missing", f"{name} needs the axes X and Z", at)
        if self.context.state.plane != "ZX":
            message = f"{name} in the {self.context.state.plane} plane"
            raise fault("turning-plane", message, at, "give G18 before")
        if self.motion.coordinates.turned:
            message = f"{name} in a rotated or mirrored coordinate system"
            raise fault("figure-active", message, at)
        refuse_modes(self.motion, self.context.state, name, at)

    @staticmethod
    def take_taper(words: LineWords, letter: str) -> None:
        """File the taper of a single cycle, which is I or K on a Haas and in Series 10/11."""
        if letter in words.rest and "R" not in words.rest:
            words.rest["R"] = words.rest.pop(letter)

    def length(self, word: Word, unit: float) -> float:
        """Return the length of a word of a cycle in mm.

        Args:
            word: The word, such as P, Q or D.
            unit: mm of 1 without a decimal point under G21, ten times that of G20; 0 for a word
                that must have one.

        Raises:
            GcodeError: ``value-out-of-range``, ``decimal-point-needed``.
        """
        number, scale = positive(word, "the length"), self.context.state.scale
        if "." in word.written:
            return number * scale
        if not unit:
            message = f"{word.written} has no decimal point: controllers differ on its unit"
            hint = f"write {word.written}. if that is meant"
            raise fault("decimal-point-needed", message, word, hint)
        # The least increment is 0.001 mm, or 0.0001 inch.
        return word.number * unit * (1.0 if scale == 1.0 else 0.1 * scale)

    @property
    def columns(self) -> tuple[int, int]:
        """Columns of Z and X. Call :meth:`check` first."""
        assert self._z is not None
        assert self._x is not None
        return self._z, self._x

    @property
    def place(self) -> tuple[float, float]:
        """The position, z and x."""
        program = self.motion.coordinates.to_program(self.motion.position)
        z, x = self.columns
        return program[z], program[x]

    def given(self, words: LineWords, user: str) -> dict[str, float]:
        """Take the axis words of a line: positions by letter X and Z, increments added.

        Raises:
            GcodeError: ``axis-not-allowed``.
        """
        motion = self.motion
        end = motion.coordinates.to_program(
            motion.reached(values := motion.axis_values(words, user), motion.position)
        )
        letters = {column: letter for letter, column in motion.column.items()}
        for column in values:
            if letters[column] not in "XZ":
                word = words.users[letters[column]][1]
                raise fault("axis-not-allowed", f"{user} does not move {word.letter}", word)
        return {letters[column]: end[column] for column in values}

    def rapid(self, z: float, x: float) -> None:
        """Traverse to a point."""
        end = self.end(z, x)
        if end != self.motion.position:
            self.motion.traverse(end)

    def cut(self, z: float, x: float, at: Word) -> None:
        """Cut straight to a point at the feed in effect; errors are reported at a word."""
        end = self.end(z, x)
        if end != self.motion.position:
            motion = self.motion
            motion.feed_to(end, motion.feed(LineWords(), end, motion.distance(end), at))

    def follow(self, z: float, x: float, helix: Helix) -> None:
        """Cut straight to a point; the lengths of the thread are those along the move.

        Further moves go on from the one before: a stop between them would cut a groove.
        """
        end = self.end(z, x)
        if end == self.motion.position:
            return
        self.context.follow_spindle(helix.lead, helix.angle)
        if not helix.change:
            self.motion.feed_to(end, helix.lead * helix.turns)
            return
        z0, x0 = self.place
        length = math.hypot(z - z0, x - x0)
        number = helix.number(length)
        count = math.ceil(number * PIECES)
        rate, share = helix.turns * count / number, 0.0
        for piece in range(1, count + 1):
            turn, before = number * piece / count, share
            share = turn * (helix.lead + helix.change * turn / 2.0) / length
            to = self.end(z0 + share * (z - z0), x0 + share * (x - x0)) if piece < count else end
            self.motion.feed_to(to, (share - before) * length * rate)

    def end(self, z: float, x: float) -> list[float]:
        """Return the machine position of a point. An axis that stays keeps its exact value."""
        position = self.motion.position
        zero, end = self.motion.coordinates.zero, position.copy()
        program = self.motion.coordinates.to_program(position)
        for column, value in zip(self.columns, (z, x), strict=True):
            if value != program[column]:
                end[column] = value + zero[column]
        return end
