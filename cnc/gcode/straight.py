"""Runs of straight moves the quick way: a program of a million short lines makes no Python object a line (:mod:`cnc.kernels.straight`)."""

from __future__ import annotations

import math
import re

import numpy as np

from cnc.canon import ROTARY_LETTERS
from cnc.gcode.interpreter import Interpreter
from cnc.gcode.modal import Feed
from cnc.gcode.motion import MIN_FEED
from cnc.gcode.text import Window
from cnc.kernels import straight as kernel

SHORTEST = 6
"""Lines; a shorter run is no faster in one piece."""

WITHOUT_POINT = re.compile(rb"[XYZABCUVWIJKR][+-]?0*[1-9][0-9]*(?![0-9.])", re.IGNORECASE)
"""A distance that is not 0, without a decimal point (or a comment that looks like one, which does no harm)."""
_MODES: dict[int | None, int] = {0: kernel.TRAVERSE, 10: kernel.FEED}


class StraightLane:
    """Executes lines of straight moves in place of an interpreter, which can't tell the difference."""

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

        Of the lines that ``window.straight`` tells of, all before one that needs a closer look; none where something is in effect that a
        straight move has to heed.
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
        feed = np.array((math.nan, math.nan) if state.feed is None else (state.feed.linear, state.feed.rotary))
        points, feeds, lines = np.empty((end - index, len(position))), np.empty(end - index), np.empty(end - index, np.int32)
        count, moves, mode = kernel.straight(
            window.first + index, scan.first, scan.letter, scan.number, index, end, self._column, axes, int(state.absolute), state.scale,
            MIN_FEED, mode, position, feed, points, feeds, lines,
        )  # fmt: skip
        if mode != kernel.NO_MOTION:
            state.motion = 10 if mode == kernel.FEED else 0
        if not np.isnan(feed[0]):
            state.feed = Feed(float(feed[0]), float(feed[1]))
        motion.position = position.tolist()
        interpreter.begun = interpreter.begun or bool(scan.first[index + count] > scan.first[index])
        interpreter.here.line = window.first + index + count - 1
        if motion.compensation.active:
            for point, rate, line in zip(points[:moves].tolist(), feeds[:moves].tolist(), lines[:moves].tolist(), strict=True):
                motion.compensation.move(point, rate, line)
        else:
            interpreter.out.moves(points[:moves], feeds[:moves], lines[:moves])
        return int(count)
