"""Moves that cutter compensation holds back until their end is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from cnc.gcode.geometry.offset_curves import Curve
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import Word, fault
from cnc.model.blocks import ArcFeed, Block
from cnc.model.diagnostics import CncError

_MOTIONS = tuple(code.code for code in (G.G0, G.G1, G.G2, G.G3))


class MoveSink(Protocol):
    """Receiver of the moves of the tool's centre."""

    def place(self, end: list[float], feed: float, line: int, file: str) -> None:
        """Add a straight move to ``end`` (axes,); NaN feed for a traverse."""

    def put(self, block: Block) -> None:
        """Add any other block."""


@dataclass(slots=True)
class SourceLine:
    """An earlier line of the program, for errors."""

    file: str
    line: int
    text_of: Callable[[int], str]
    words_of: Callable[[int], tuple[Word, ...]]

    def fault(self, code: str, message: str, hint: str) -> CncError:
        """Return an error at the line's motion code, or at its first word."""
        words = [word for word in self.words_of(self.line) if word.letter != "N"]
        codes = (word for word in words if word.letter == "G" and word.number in _MOTIONS)
        error = fault(code, message, next(codes, words[0] if words else None), hint)
        return error.at(file=self.file, line=self.line, text=self.text_of(self.line))


@dataclass(slots=True)
class WaitingMove:
    """A straight move after the held one. Its plane axes follow from the end of that."""

    end: list[float]
    feed: float
    line: int
    file: str


@dataclass(slots=True)
class HeldMove:
    """A move whose end is not known yet.

    Attributes:
        curve: Path of the tool's centre.
        end: (axes,) programmed end.
        feed: mm/s; NaN for a traverse.
        place: Line of the move.
        template: The arc as it was programmed.
        around: Path around the outside corner before it. It is sent when the move itself is known
            to be possible.
        entry: The move leads in.
        circle: The move is part of a full circle, or nearly one.
        before: The move before, unless that leads in.
    """

    curve: Curve
    end: list[float]
    feed: float
    place: SourceLine
    template: ArcFeed | None = None
    around: tuple[Curve, ...] = ()
    entry: bool = False
    circle: bool = False
    before: Curve | None = None
