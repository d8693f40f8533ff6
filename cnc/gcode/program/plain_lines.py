"""Runs of straight moves, executed on arrays (:mod:`cnc.kernels.gcode.plain_lines`).

A program of a million short lines makes no Python object for each line. The result is the same as
that of the interpreter.
"""

from __future__ import annotations

import math
import re

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.codes.axis_words import MIN_FEED
from cnc.gcode.program.interpreter import Interpreter
from cnc.gcode.state.modal_groups import Feed
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.source_text import Window
from cnc.gcode.syntax.words import Word
from cnc.kernels.gcode import plain_lines as kernel
from cnc.model.blocks import ROTARY_LETTERS

SHORTEST = 6
"""Lines. A shorter run is no faster on arrays."""

WITHOUT_POINT = re.compile(rb"[XYZABCUVWIJKR][+-]?0*[1-9][0-9]*(?![0-9.])", re.IGNORECASE)
"""A distance that is not 0, without a decimal point. A comment may match too, which does no
harm.
"""
_FEED_WORD = re.compile(r"F\s*[-+]?[0-9.]+", re.IGNORECASE)
_COMMENT = re.compile(r"\([^)]*\)|;.*")
_F = ord("F")
_MODES: dict[G | None, int] = {G.G0: kernel.TRAVERSE, G.G1: kernel.FEED}


class StraightRuns:
    """Executes runs of straight moves in place of an interpreter."""

    def __init__(self, interpreter: Interpreter) -> None:
        self._interpreter = interpreter
        axes = interpreter.motion.axes
        self._column = np.full(26, kernel.NO_AXIS, np.int64)
        for index, axis in enumerate(axes):
            if axis.upper() in interpreter.dialect.axes:
                self._column[ord(axis.upper()) - ord("A")] = index
        self._turns = np.array([float(axis in ROTARY_LETTERS) for axis in axes])

    def run(self, window: Window, index: int) -> int:
        """Execute consecutive lines of straight moves.

        Stops before a line that needs the interpreter. Does nothing while a mode is in effect that
        straight moves on arrays do not support.

        Args:
            window: The text.
            index: The first line.

        Returns:
            The number of lines executed.
        """
        interpreter = self._interpreter
        if not interpreter.plain:
            return 0
        if interpreter.out.unanswered:
            interpreter.out.take_answers()
        end = index + int(window.straight[index])
        if interpreter.points_wanted:
            end = window.find(WITHOUT_POINT, index, end)
        count, moves = self._execute(window, index, end)
        first = window.scan.lines.first
        interpreter.begun = interpreter.begun or bool(first[index + count] > first[index])
        interpreter.here.line = window.first + index + count - 1
        compensation = interpreter.motion.compensation
        if compensation.active:
            for point, rate, line in zip(*(values.tolist() for values in moves), strict=True):
                compensation.move(point, rate, line)
        else:
            interpreter.out.moves(moves.points, moves.feeds, moves.lines)
        if interpreter.unused_words.enabled:
            fed = moves.lines[~np.isnan(moves.feeds)]
            self._note_feeds(window, index, index + count, fed)
        return count

    def _execute(self, window: Window, index: int, end: int) -> tuple[int, kernel.Moves]:
        """Bring modal state and position up to date; return the number of lines and the moves."""
        modal, motion, scan = self._interpreter.modal, self._interpreter.motion, window.scan
        setup = kernel.Setup(
            column=self._column,
            scale=np.array(motion.scales),
            zero=np.array(motion.coordinates.zero),
            turns=self._turns,
            absolute=int(modal.absolute),
            feed_scale=modal.scale,
            min_feed=MIN_FEED,
        )
        before = kernel.State(
            _MODES.get(modal.motion, kernel.NO_MOTION),
            math.nan if modal.feed is None else modal.feed.linear,
            math.nan if modal.feed is None else modal.feed.rotary,
        )
        position = np.array(motion.position)
        most = end - index
        moves = kernel.Moves(
            np.empty((most, len(position))), np.empty(most), np.empty(most, np.int32)
        )
        first, words, number = scan.lines.first, scan.words, window.first + index
        count, made, after = kernel.straight(
            first, words, index, end, number, setup, before, position, moves
        )
        if after.mode != kernel.NO_MOTION:
            modal.motion = G.G1 if after.mode == kernel.FEED else G.G0
        if not math.isnan(after.linear):
            modal.feed = Feed(float(after.linear), float(after.rotary))
        motion.position = position.tolist()
        return int(count), kernel.Moves(moves.points[:made], moves.feeds[:made], moves.lines[:made])

    def _note_feeds(self, window: Window, begin: int, end: int, moved: NDArray[np.int32]) -> None:
        """Report F words that no feed move uses.

        Args:
            window: The text.
            begin: Index of the first executed line.
            end: Index after the last executed line.
            moved: Numbers of the lines with a feed move.
        """
        unused_words, scan = self._interpreter.unused_words, window.scan
        first = scan.lines.first[begin : end + 1]
        words = first[0] + np.flatnonzero(scan.words.letter[first[0] : first[-1]] == _F)
        rows = begin + np.searchsorted(first, words, side="right") - 1
        if len(moved) and (not len(words) or moved[0] < window.first + rows[0]):
            unused_words.mark_used("F")
        if not len(words):
            return
        nowhere = window.first + end
        used = np.append(moved, nowhere)[np.searchsorted(moved, window.first + rows)]
        idle = used >= np.append(window.first + rows[1:], nowhere)
        # The note on an F word depends on the one before it. So only the first one matters, those
        # that are idle, and those after an idle one.
        for each in np.flatnonzero(idle | np.append(True, idle[:-1])).tolist():
            row = int(rows[each])
            text = window.text(row)
            number = float(scan.words.number[words[each]])
            unused_words.note(_feed_word(number, text), window.first + row, text)
            if not idle[each]:
                unused_words.mark_used("F")


def _feed_word(number: float, text: str) -> Word:
    """Return the F word of a line."""
    found = _FEED_WORD.search(_COMMENT.sub(lambda comment: " " * len(comment[0]), text))
    assert found
    written = "".join(found[0].split()).upper()
    return Word("F", number, written, found.start() + 1, len(found[0]))
