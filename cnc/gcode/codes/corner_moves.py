"""Moves with a chamfer or a round at their end: a move is kept until the next one is known."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cnc.gcode.codes import corner_words
from cnc.gcode.codes.corner_words import Corner
from cnc.gcode.geometry.corner_rounds import (
    Arc,
    Line,
    Round,
    chamfer_between,
    round_between,
)
from cnc.gcode.state.modal_groups import ModalState
from cnc.gcode.state.source_location import SourceLocation
from cnc.gcode.syntax.words import Word, fault
from cnc.model.blocks import ArcFeed
from cnc.model.diagnostics import CncError, GcodeError

if TYPE_CHECKING:
    from cnc.gcode.codes.motion import Motion


class CornerMoves:
    """The corner of the last move, if it has one.

    Attributes:
        corner: The corner whose second move is not known yet.
    """

    def __init__(
        self, motion: Motion, state: ModalState, here: SourceLocation, *, corners: str
    ) -> None:
        """``corners``: see the key of the dialect."""
        self.corner: Corner | None = None
        self._motion = motion
        self._state = state
        self._here = here
        self._corners = corners

    def hold(
        self, word: Word, start: list[float], end: list[float], feed: float, line: int
    ) -> None:
        """Keep a straight move until the next one is known."""
        plane, size = self._size(word)
        self.corner = Corner(word, size, start, end, feed, line, plane)

    def hold_arc(self, word: Word, start: list[float], block: ArcFeed) -> None:
        """Keep an arc until the next move is known.

        Raises:
            GcodeError: ``corner-next``.
        """
        if not self._may_have_arc(word):
            message = f"{word.written} at an arc: it needs two straight moves"
            raise fault("corner-next", message, word)
        plane, size = self._size(word)
        end = block.end.tolist()
        self.corner = Corner(word, size, start, end, block.feed, block.line, plane, block)

    def _may_have_arc(self, word: Word) -> bool:
        """Whether one of the moves of a corner may be an arc."""
        return self._corners == "all" or (self._corners == "rounds" and word.letter == ",R")

    def _size(self, word: Word) -> tuple[tuple[int, int], float]:
        """Return the plane of a corner, and its size in mm."""
        motion = self._motion
        plane = motion.arcs.plane_columns(word, word.letter)
        factor = motion.coordinates.figure.scale(plane)
        if factor is None:
            raise fault("scaling-arc", f"{word.written} under different factors of G51", word)
        return plane, word.number * self._state.scale * factor

    def finish(self, following: list[float]) -> list[float]:
        """Make the first move and the way round the corner; return the place behind it.

        Args:
            following: Machine position at the end of the straight second move.
        """
        corner = self._taken()
        if corner.arc is not None:
            line = self._line(corner, corner.end, following)
            return self._rounded(corner, self._round(corner, line))
        try:
            way = corner_words.cut(corner, following)
        except GcodeError as error:
            raise error.at(line=corner.line) from None
        motion = self._motion
        motion.make_straight(way.begin, corner.feed, corner.line)
        if way.centre is None:
            motion.make_straight(way.end, corner.feed, corner.line)
        else:
            motion.make_arc(self._block(corner, way.centre, way.end, corner.size, way.turns))
        return way.end

    def finish_before_arc(self, block: ArcFeed) -> tuple[ArcFeed, list[float]]:
        """Make the first move and the round; return what is left of the arc, and its start.

        Raises:
            GcodeError: ``corner-next``, ``corner-plane``, ``corner-too-large``.
        """
        assert self.corner is not None
        if not self._may_have_arc(self.corner.word):
            raise self.fault("an arc")
        corner = self._taken()
        arc = self._arc(corner, corner.end, block)
        found = self._round(corner, arc)
        start = self._rounded(corner, found)
        left = arc.spin * max(0.0, abs(arc.turns) - arc.part(found.end))
        return replace(block, turns=left), start

    def _taken(self) -> Corner:
        corner = self.corner
        assert corner is not None
        self.corner = None
        return corner

    def _round(self, corner: Corner, second: Line | Arc) -> Round:
        first = (
            self._line(corner, corner.start, corner.end)
            if corner.arc is None
            else self._arc(corner, corner.start, corner.arc)
        )
        make = round_between if corner.word.letter == ",R" else chamfer_between
        found = make(first, second, corner.size)
        if found is None:
            message = f"{corner.word.written} does not fit between the two moves"
            hint = "make it smaller; tangential moves have no corner"
            raise fault("corner-too-large", message, corner.word, hint).at(line=corner.line)
        return found

    def _rounded(self, corner: Corner, found: Round) -> list[float]:
        """Make the first move and the round; return the place behind it."""
        motion = self._motion
        begin, end = (self._at(corner, place) for place in (found.begin, found.end))
        if corner.arc is None:
            motion.make_straight(begin, corner.feed, corner.line)
        else:
            arc = self._arc(corner, corner.start, corner.arc)
            turns = arc.spin * arc.part(found.begin)
            motion.make_arc(replace(corner.arc, end=np.array(begin), turns=turns))
        if found.centre is None:
            motion.make_straight(end, corner.feed, corner.line)
            return end
        centre = found.centre.real, found.centre.imag
        motion.make_arc(self._block(corner, centre, end, corner.size, found.turns))
        return end

    def _block(
        self,
        corner: Corner,
        centre: tuple[float, float],
        end: list[float],
        radius: float,
        turns: float,
    ) -> ArcFeed:
        plane, file = self._state.plane, self._here.file
        return ArcFeed(file, corner.line, plane, centre, np.array(end), radius, turns, corner.feed)

    def _at(self, corner: Corner, place: complex) -> list[float]:
        """Return the machine position of a place in the plane of a corner."""
        found = corner.end.copy()
        found[corner.plane[0]], found[corner.plane[1]] = place.real, place.imag
        return found

    def _line(self, corner: Corner, start: list[float], end: list[float]) -> Line:
        self._check_plane(corner, start, end)
        i, j = corner.plane
        line = Line(complex(start[i], start[j]), complex(end[i], end[j]))
        if line.start == line.end:
            message = f"{corner.word.written}: a move of the corner has no length"
            raise fault("corner-too-large", message, corner.word).at(line=corner.line)
        return line

    def _arc(self, corner: Corner, start: list[float], block: ArcFeed) -> Arc:
        end = block.end.tolist()
        self._check_plane(corner, start, end)
        i, j = corner.plane
        begin, last = complex(start[i], start[j]), complex(end[i], end[j])
        return Arc(begin, last, complex(*block.center), block.turns)

    @staticmethod
    def _check_plane(corner: Corner, start: list[float], end: list[float]) -> None:
        others = (at for at in range(len(start)) if at not in corner.plane)
        if any(start[at] != end[at] for at in others):
            raise corner_words.out_of_plane(corner.word).at(line=corner.line)

    def fault(self, what: str) -> CncError:
        """Return the error of a corner that ``what`` follows, and no feed move."""
        assert self.corner is not None
        return corner_words.not_followed(
            self.corner, what, arcs=self._may_have_arc(self.corner.word)
        )
