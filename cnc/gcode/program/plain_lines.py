"""Runs of straight moves the quick way: a program of a million short lines makes no Python object a
line (:mod:`cnc.kernels.gcode.plain_lines`).
"""

from __future__ import annotations

import math
import re

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.codes.motion import MIN_FEED
from cnc.gcode.program.interpreter import Interpreter
from cnc.gcode.state.modal_groups import Feed
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.source_text import Window
from cnc.gcode.syntax.words import Word
from cnc.kernels.gcode import plain_lines as kernel
from cnc.model.blocks import ROTARY_LETTERS

SHORTEST = 6
"""Lines; a shorter run is no faster in one piece."""

WITHOUT_POINT = re.compile(rb"[XYZABCUVWIJKR][+-]?0*[1-9][0-9]*(?![0-9.])", re.IGNORECASE)
"""A distance that is not 0, without a decimal point (or a comment that looks like one, which does
no harm).
"""
_FEED_WORD = re.compile(r"F\s*[-+]?[0-9.]+", re.IGNORECASE)
_COMMENT = re.compile(r"\([^)]*\)|;.*")
_F = ord("F")
_MODES: dict[G | None, int] = {G.G0: kernel.TRAVERSE, G.G1: kernel.FEED}


class StraightLane:
    """Executes lines of straight moves in place of an interpreter, which can't tell the
    difference.
    """

    def __init__(self, interpreter: Interpreter) -> None:
        self._interpreter = interpreter
        axes = interpreter.motion.axes
        self._column = np.full(26, kernel.NO_AXIS, np.int64)
        for index, axis in enumerate(axes):
            if axis.upper() in interpreter.dialect.axes:
                self._column[ord(axis.upper()) - ord("A")] = index
        self._turns = [float(axis in ROTARY_LETTERS) for axis in axes]

    def run(self, window: Window, index: int) -> int:
        """Execute lines from ``index`` on; how many.

        Of the lines that ``window.straight`` tells of, all before one that needs a closer look;
        none where something is in effect that a straight move has to heed.
        """
        interpreter = self._interpreter
        if not interpreter.plain:
            return 0
        if interpreter.out.asked:
            interpreter.out.take_answers()
        state, motion, scan = interpreter.modal, interpreter.motion, window.scan
        end = index + int(window.straight[index])
        if interpreter.points_wanted:
            end = window.find(WITHOUT_POINT, index, end)
        mode = _MODES.get(state.motion, kernel.NO_MOTION)
        axes = np.array((motion.scales, motion.coordinates.zero, self._turns))
        position = np.array(motion.position)
        feed = np.array(
            (math.nan, math.nan) if state.feed is None else (state.feed.linear, state.feed.rotary)
        )
        points, feeds, lines = (
            np.empty((end - index, len(position))),
            np.empty(end - index),
            np.empty(end - index, np.int32),
        )
        count, moves, mode = kernel.straight(
            window.first + index, scan.first, scan.letter, scan.number, index, end, self._column, axes, int(state.absolute), state.scale,
            MIN_FEED, mode, position, feed, points, feeds, lines,
        )  # fmt: skip
        if mode != kernel.NO_MOTION:
            state.motion = G.G1 if mode == kernel.FEED else G.G0
        if not np.isnan(feed[0]):
            state.feed = Feed(float(feed[0]), float(feed[1]))
        motion.position = position.tolist()
        interpreter.begun = interpreter.begun or bool(scan.first[index + count] > scan.first[index])
        interpreter.here.line = window.first + index + count - 1
        if motion.compensation.active:
            for point, rate, line in zip(
                points[:moves].tolist(), feeds[:moves].tolist(), lines[:moves].tolist(), strict=True
            ):
                motion.compensation.move(point, rate, line)
        else:
            interpreter.out.moves(points[:moves], feeds[:moves], lines[:moves])
        if interpreter.waiting.watching:
            self._note_feeds(
                window, index, index + int(count), lines[:moves][~np.isnan(feeds[:moves])]
            )
        return int(count)

    def _note_feeds(self, window: Window, begin: int, end: int, moved: NDArray[np.int32]) -> None:
        """Which F words of some lines wait for a move, where ``moved`` are the numbers of the lines
        with a feed move.
        """
        waiting, scan = self._interpreter.waiting, window.scan
        first = scan.first[begin : end + 1]
        words = first[0] + np.flatnonzero(scan.letter[first[0] : first[-1]] == _F)
        if len(moved) and (
            not len(words)
            or moved[0]
            < window.first + begin + int(np.searchsorted(first, words[0], side="right")) - 1
        ):
            waiting.used("F")
        if not len(words):
            return
        rows = begin + np.searchsorted(first, words, side="right") - 1
        nowhere = window.first + end
        used = np.append(moved, nowhere)[np.searchsorted(moved, window.first + rows)]
        idle = used >= np.append(window.first + rows[1:], nowhere)
        # what is told of an F word depends on the one before it, so only those after an idle one
        # have to be looked at, and the first
        for each in np.flatnonzero(idle | np.append(True, idle[:-1])).tolist():
            row = int(rows[each])
            text = window.text(row)
            found = _FEED_WORD.search(_COMMENT.sub(lambda comment: " " * len(comment[0]), text))
            assert found
            written = "".join(found[0].split()).upper()
            waiting.give(
                Word(
                    "F", float(scan.number[words[each]]), written, found.start() + 1, len(found[0])
                ),
                window.first + row,
                text,
            )
            if not idle[each]:
                waiting.used("F")
