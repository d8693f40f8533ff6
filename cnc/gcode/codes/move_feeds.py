"""Feeds of moves in mm/s, or degrees/s where only rotary axes move."""

from __future__ import annotations

import math
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.codes.axis_words import AxisWords
from cnc.gcode.state.modal_groups import Feed, check_feed, feed_of
from cnc.gcode.syntax.words import LineWords, Word, fault
from cnc.kernels.gcode.rules import MIN_FEED, feed_of_move
from cnc.kernels.jit import interpreted
from cnc.model.diagnostics import GcodeError
from cnc.model.units import per_second

_feed_of_move = interpreted(feed_of_move)
_FEED_HINT = "write F and the feed in this line or before it, or use --default-feed"


class MoveFeeds(AxisWords):
    """Feeds of moves, from F and the mode of the feed."""

    _surface_radius = 0.0
    """Radius of the last move under G96 that was not on the axis, mm."""

    def distance(self, end: list[float]) -> float:
        """Length of a straight move for its feed, mm or degrees.

        It counts x y z if one of them moves, else u v w, else a b c.
        """
        for group in ("xyz", "uvw", "abc"):
            length = math.hypot(
                *(
                    end[i] - self.position[i]
                    for i, letter in enumerate(self.axes)
                    if letter in group
                )
            )
            if length > 0:
                return length
        return 0.0

    def feed(self, words: LineWords, end: list[float], length: float | None, at: Word) -> float:
        """Return the feed of a move in mm/s, or in deg/s if only rotary axes move.

        Args:
            words: The words of the line; an F under G93 is taken.
            end: (axes,) machine position of the end.
            length: mm, used under G93; None for that of a straight move.
            at: Word at which errors are reported.

        Raises:
            GcodeError: No feed is in effect, it is too slow, or the spindle does not turn.
        """
        state = self._state
        if state.feed_mode == "inverse-time":
            length = self.distance(end) if length is None else length
            return self._inverse_time(words, length, at)
        feed = state.feed
        if feed is None:
            feed = self._first_feed(words, at)
        self._unused_words.mark_used("F")
        rate = self.straight_feed(end, feed, length or 0.0)
        if state.feed_mode == "per-revolution":
            rate *= self.spindle_rpm(end, at) / 60.0
            if rate < MIN_FEED:
                raise fault("feed-too-slow", f"the feed is less than {MIN_FEED:g} mm/s", at)
        return rate

    def _first_feed(self, words: LineWords, at: Word) -> Feed:
        """Put the feed with which the controller begins into effect, with a warning."""
        first = self._dialect.first_feed
        if not first:
            raise _missing(words, at)
        message = f"no F before this move: the firmware begins with {first:g} mm/min"
        self._here.report_warning("feed-assumed", message, at, _FEED_HINT)
        self._state.feed = feed_of(first, 1.0)
        return self._state.feed

    def straight_feed(self, end: list[float], feed: Feed, length: float = 0.0) -> float:
        """Return the feed of linear axes, or of rotary axes if only they move.

        Args:
            end: (axes,) machine position of the end.
            feed: the feed in effect.
            length: length along the linear axes, mm; 0 for a straight move.
        """
        if self._has_rotary:
            steps = [there - here for there, here in zip(end, self.position, strict=True)]
            turned = [step for step, linear in zip(steps, self._linear, strict=True) if not linear]
            shifts, turns = any(compress(steps, self._linear)), any(turned)
            if self._dialect.feed_of_all_axes and shifts and turns:
                length = length or self.distance(end)
                return feed.linear * length / math.hypot(length, *turned)
            return _feed_of_move(feed.linear, feed.rotary, shifts, turns)
        return feed.linear

    def feed_of_rotary_curve(self, points: NDArray[np.float64]) -> float:
        """Return the ratio of the feed of a curve to that of linear axes.

        Args:
            points: (n, axes), control points.
        """
        moved = (points != points[0]).any(axis=0)
        feed = self._state.feed
        if feed is None or not moved.any() or moved[self._linear].any():
            return 1.0
        return feed.rotary / feed.linear

    def _inverse_time(self, words: LineWords, length: float, at: Word) -> float:
        word = words.take("F", "G93")
        if word is None:
            raise fault(
                "feed-missing",
                "under G93 every move needs an F word",
                at,
                "give F, one over the minutes of the move",
            )
        rate = per_second(word.number * (length or 1.0))
        # A move of length 0 takes no time at any feed.
        check_feed(word, rate if length else math.inf)
        return rate

    def spindle_rpm(self, end: list[float], at: Word) -> float:
        """Return the revolutions per minute of a move; under G96 at the largest radius."""
        state = self._state
        if state.spindle == "off" or not state.speed:
            raise fault(
                "spindle-stopped",
                f"{at.written} needs the spindle, which does not turn",
                at,
                "give S and M3 before",
            )
        if not state.constant_surface:
            return state.speed
        radius = max(self._radius(self.position), self._radius(end))
        if radius > 0.0:
            self._surface_radius = radius
        elif self._surface_radius and not state.most_rpm:
            radius = self._surface_radius
            rpm = surface_rpm(state.speed, 0.0, radius)
            message = (
                f"{at.written} on the axis under G96 without a limit: the spindle has its highest "
                f"speed, which is not known; the feed is that of {rpm:.0f} rpm, as at X before"
            )
            hint = "limit the speed, such as G50 S2000"
            self._here.report_warning("spindle-speed-assumed", message, at, hint)
        rpm = surface_rpm(state.speed, state.most_rpm, radius)
        if math.isinf(rpm):
            raise fault(
                "spindle-speed-unlimited",
                "G96 gives an infinite spindle speed on the axis",
                at,
                "limit the speed: G50 S2000 on FANUC's and Haas' lathes, D in the line of G96 in "
                "LinuxCNC",
            )
        return rpm

    def _radius(self, place: list[float]) -> float:
        """Return the distance of a machine position from the axis of a lathe's spindle, mm."""
        x = self.column.get("X")
        return 0.0 if x is None else abs(self.coordinates.to_program(place)[x])

    def keep_surface_radius(self, end: list[float]) -> None:
        """Keep the radius of a traverse under G96, for a feed on the axis without a limit."""
        self._surface_radius = (
            self._radius(end) or self._radius(self.position) or self._surface_radius
        )


def _missing(words: LineWords, at: Word) -> GcodeError:
    """Return the error of a feed move without a feed."""
    for word in words.vacant:
        if word.letter == "F":
            message = f"{word.written} gives no feed: the variable is empty, and no F is before it"
            return fault("feed-missing", message, word, "set the variable, or use --default-feed")
    return fault("feed-missing", "a feed move without a feed in effect", at, _FEED_HINT)


def surface_rpm(speed: float, most_rpm: float, radius: float) -> float:
    """Return the revolutions per minute at a surface speed.

    Args:
        speed: Surface speed, mm/s.
        most_rpm: Limit; 0 for none.
        radius: mm. Without a limit the result for 0 is infinite.
    """
    rpm = speed * 60.0 / (math.tau * radius) if radius > 0.0 else math.inf
    return min(rpm, most_rpm) if most_rpm else rpm
