"""Circular pockets: G12 (clockwise) and G13 (anticlockwise).

The tool stands over the centre. It goes down to Z, out to the radius I along a half circle, round
the circle, and back. With K and Q it goes round circles from I to K, each Q larger, before it goes
back. With L it repeats all of that, deeper by Z under G91. D is the offset of the tool's radius;
the tool stays inside of the circles. Mach3 has I only: straight out along X, round, and straight
back. Sources: Haas, "Mill Operator's Manual", G12 and G13; "Using Mach3Mill", G12 and G13.

The manual draws the way between the circles but does not define it. Here it is a half circle, so
that the tool never leaves the next circle.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cnc.gcode.core.cycle_runner import refuse_axes, refuse_modes
from cnc.gcode.core.modal_groups import Code
from cnc.gcode.core.motion import Motion, MotionCodes
from cnc.gcode.core.tool_codes import ToolCodes
from cnc.gcode.reader.words import G, LineWords, Word, fault, whole
from cnc.model.blocks import ArcFeed

MOST_CIRCLES = 10_000
"""Most circles of one line. More are a typing error in Q or L."""
_ROUNDING = 1e-9
"""mm. A last step that is shorter makes no circle of its own."""


class CircularPocket(MotionCodes):
    """Execution of G12 and G13."""

    def __init__(self, motion: Motion, tools: ToolCodes) -> None:
        super().__init__(motion)
        self._straight = self._dialect.offsets.transforms == "mach3"
        self._tools = tools

    def make(self, words: LineWords, code: Code | None) -> None:
        """Execute a line with G12 or G13."""
        state, motion = self._state, self._motion
        assert state.motion is not None
        name = state.motion.written
        if code is None:
            raise fault("motion-missing", f"{name} is for one line", words.first(), "give G0 or G1")
        at = code.word
        refuse_modes(motion, state, name, at)
        refuse_axes(words, name, "Z")
        if state.plane != "XY":
            raise fault("pocket-plane", f"{name} in the {state.plane} plane", at, "give G17")
        if self._straight and (
            extra := next((letter for letter in "DKQLZ" if letter in words.rest), "")
        ):
            word = words.rest[extra]
            raise fault("word-unused", f"{name} takes I only, not {word.written}", word)
        clockwise = (state.motion is G.G12) != motion.coordinates.transform.mirrors(
            motion.arcs.plane_columns(at, name)
        )
        radii = self._radii(words, name, at)
        repeats = self._repeats(words, name)
        if repeats * len(radii) > MOST_CIRCLES:
            message = f"this line makes more than {MOST_CIRCLES} circles"
            raise fault("cycle-too-long", message, at, "give a larger Q")
        depth = motion.axis_values(words, name)
        feed = motion.feed(words, [*motion.position[:-1], motion.position[-1] - 1.0], 0.0, at)
        for _ in range(repeats):
            end = motion.reached(depth, motion.position)
            if end != motion.position:
                motion.feed_to(end, feed)
            if self._straight:
                self._circle(radii[0], feed, clockwise=clockwise)
            else:
                self._circles(radii, feed, clockwise=clockwise)
        state.motion = None

    def _radii(self, words: LineWords, name: str, at: Word) -> list[float]:
        """Radii of the path of the tool's centre, mm, ascending."""
        scale = self._state.scale
        factor = self._motion.coordinates.transform.scale(self._motion.arcs.plane_columns(at, name))
        if factor is None:
            raise fault("scaling-arc", f"{name} under different factors of G51", at)
        first, last, step = (words.take(letter, name) for letter in "IKQ")
        if first is None and last is None:
            raise fault("pocket-radius", f"{name} needs I, the radius", at, "such as I12.5")
        tool = self._tool_radius(words, at)
        given = [first.number * scale] if first else []
        if last is not None:
            if step is None or step.number <= 0.0:
                word = step or last
                raise fault(
                    "pocket-radius", f"{name} with K needs Q, the step", word, "such as Q2."
                )
            at_radius = given[0] if given else step.number * scale
            given = []
            while at_radius < last.number * scale - _ROUNDING and len(given) <= MOST_CIRCLES:
                given.append(at_radius)
                at_radius += step.number * scale
            given.append(last.number * scale)
        elif step is not None:
            raise fault("pocket-radius", f"{step.written} without K, the last radius", step)
        radii = [(value - tool) * factor for value in given]
        if radii[0] <= 0.0:
            message = f"the radius is not larger than that of the tool, {tool:g} mm"
            raise fault("pocket-radius", message, first or last or at, "give a larger I")
        return radii

    def _tool_radius(self, words: LineWords, at: Word) -> float:
        word = words.take("D", at.written)
        number = whole(word, "the tool number", 0, 99_999) if word else 0
        return self._tools.entry(number, word or at).radius if number else 0.0

    def _repeats(self, words: LineWords, name: str) -> int:
        word = words.take("L", name)
        if word is None:
            return 1
        if self._state.absolute:
            raise fault(
                "pocket-repeats", f"{word.written} under G90", word, "give G91 and a Z step"
            )
        return whole(word, "the repeats", 1, MOST_CIRCLES)

    def _circles(self, radii: list[float], feed: float, *, clockwise: bool) -> None:
        """Make the half circle out, the circles, and the half circle back."""
        motion = self._motion
        i, j = motion.arcs.plane_columns(Word("G", 12.0, "G12", 1, 1))
        centre = motion.position[i], motion.position[j]
        for x, turns, middle in _arcs(radii):
            end = motion.position.copy()
            end[i] = centre[0] + x
            end[j] = centre[1]
            radius = abs(motion.position[i] - centre[0] - middle)
            self._arc(
                end, (centre[0] + middle, centre[1]), radius, turns, feed, clockwise=clockwise
            )

    def _circle(self, radius: float, feed: float, *, clockwise: bool) -> None:
        """Make one circle, which a straight move along X reaches and leaves."""
        motion = self._motion
        i, j = motion.arcs.plane_columns(Word("G", 12.0, "G12", 1, 1))
        start = motion.position
        end = start.copy()
        end[i] += radius
        motion.feed_to(end, feed)
        self._arc(end.copy(), (start[i], start[j]), radius, 1.0, feed, clockwise=clockwise)
        motion.feed_to(start.copy(), feed)

    def _arc(
        self,
        end: list[float],
        centre: tuple[float, float],
        radius: float,
        turns: float,
        feed: float,
        *,
        clockwise: bool,
    ) -> None:
        """Make an arc from the position. ``turns`` is positive."""
        turns = -turns if clockwise else turns
        here = self._here
        arc = ArcFeed(here.file, here.line, "XY", centre, np.array(end), radius, turns, feed)
        self._motion.arc(arc)


def _arcs(radii: list[float]) -> Iterator[tuple[float, float, float]]:
    """Yield the arcs along X from the centre: end, turns, middle (all relative to the centre)."""
    at = 0.0
    for radius in radii:
        end = radius if at <= 0.0 else -radius
        yield end, 0.5, (at + end) / 2.0
        yield end, 1.0, 0.0
        at = end
    yield 0.0, 0.5, at / 2.0


def register(motion: Motion, tools: ToolCodes) -> None:
    """Register the handlers."""
    pocket = CircularPocket(motion, tools)
    motion.handlers |= {G.G12: pocket.make, G.G13: pocket.make}
