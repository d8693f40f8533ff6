"""Protocols of moves that other modules make: curves of many lines, and moves with a vector."""

from __future__ import annotations

from typing import Protocol

from cnc.gcode.state.modal_groups import Codes
from cnc.gcode.syntax.words import LineWords, Word
from cnc.model.diagnostics import GcodeError


class Collector(Protocol):
    """A curve whose definition takes many lines."""

    def line(self, words: LineWords, codes: Codes) -> bool:
        """Take a line. The last one sets ``motion.collector = None``.

        Returns:
            Whether the line belongs to the curve, and must not be executed otherwise.
        """

    def end(self, what: str) -> None:
        """Complete the curve at the program end.

        Args:
            what: Description of the error.

        Raises:
            GcodeError: The curve is not complete.
        """

    def foreign(self, word: Word) -> GcodeError:
        """Return the error for a word that can't stand inside the curve."""


class VectorMove(Protocol):
    """A straight move with a direction of the tool."""

    def __call__(self, words: LineWords, code: Word | None, *, rapid: bool) -> None:
        """Make the move."""


class VectorTurn(Protocol):
    """The angles of a point that has a direction of the tool."""

    def __call__(self, words: LineWords, point: list[float], at: str) -> None:
        """Take the direction of a line, if it has one, and set the angles of the point (axes,)."""
