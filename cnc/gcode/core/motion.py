"""Motion codes: selection and execution of the move of a line.

G0 to G3 are executed here. The modules of other motion codes register a handler.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from cnc.compiled.jit import interpreted
from cnc.gcode.core import corners
from cnc.gcode.core.arcs import ArcMoves
from cnc.gcode.core.axis_words import MoveFeeds
from cnc.gcode.core.compensation import Compensation
from cnc.gcode.core.context import Context, Executor
from cnc.gcode.core.corners import CornerMoves
from cnc.gcode.core.modal_groups import PLAIN_MOTIONS, Code, Codes
from cnc.gcode.kernels.rules import motion_after_cancel
from cnc.gcode.reader.words import AXES, G, LineWords, M, Word, fault, under_compensation
from cnc.model.blocks import ArcFeed, NurbsFeed
from cnc.model.diagnostics import Fix, GcodeError

# The motion of axis words without a motion code: at the start of a program and after G80.
#
# FANUC and Haas go on with the motion code of group 1 that was in effect before the cycle; LinuxCNC
# has none after G80 (``no motion``), and refuses the axis words.

_motion_after_cancel = interpreted(motion_after_cancel)
_HIGHEST = {"none": -1, "assumed": -1, "previous": PLAIN_MOTIONS.index(G.G3)}
_STRAIGHT_WORDS = PLAIN_MOTIONS.index(G.G1)


class AssumedMotion(Executor):
    """Knows the motion code before a cycle.

    Attributes:
        restored: Highest of G0 to G3 to which G80 returns, -1 for none.
        resting: The last of G0 to G3 that was in effect, None for none.
    """

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        rules = context.dialect.motion
        self._assumes = rules.after_g80 == "assumed"
        self._code: G | None = G.G0 if rules.assumed else None
        self.restored = _HIGHEST[rules.after_g80]
        self.resting: G | None = rules.at_start

    def end(self) -> None:
        """Assume no motion: a motion code is in effect, or something else than G80 ended it."""
        self._code = None

    def keep(self) -> None:
        """Remember the motion in effect before a line that has a motion code."""
        if self._state.motion in PLAIN_MOTIONS:
            self.resting = self._state.motion

    def cancel(self) -> None:
        """Execute G80, after :meth:`keep`."""
        resting, before = self.resting, self._state.motion
        place = -1 if resting is None else PLAIN_MOTIONS.index(resting)
        after = _motion_after_cancel(place, self.restored)
        self._state.motion = PLAIN_MOTIONS[after] if after >= 0 else None
        if before is not None:
            self.cancelled()

    def cancelled(self) -> None:
        """Record that G80 has ended a motion; it may be assumed for the axis words after it."""
        straight = self.resting in PLAIN_MOTIONS[: _STRAIGHT_WORDS + 1]
        self._code = self.resting if self._assumes and straight else None

    def assume(self, word: Word) -> G | None:
        """Return the motion of an axis word while none is in effect; None for an error."""
        code = self._code
        if code is None:
            return None
        message = f"{word.written} without a motion code in effect is read with {code.written}"
        hint = "begin with G0 or G1: controllers differ"
        if self.resting is not None:
            hint = f"{hint}; from here on each G80 returns to the G0 or G1 before it"
            self.restored = _STRAIGHT_WORDS
        fix = Fix.replace(f"write {code.written}", word.column, 0, f"{code.written} ", safe=True)
        self._here.report_warning("motion-assumed", message, word, hint, fix)
        self._state.motion, self._code = code, None
        return code


# Protocols of moves that other modules make: curves of many lines, and moves with a vector.


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


_ARC_WORDS = frozenset("IJKR")
_CURVES = (G.G5, G.G5_1, G.G5_2, G.G6_2, G.BSPLINE)
_TRANSFORMS = ("figure-scaling", "figure-mirror", "figure-rotation")
_TRANSFORM_TAKES_AXES = (G.G51, G.G50_1, G.G51_1, G.G68, G.G68_2)
_TAKES_AXES = (G.G7_1, G.G10, G.G28, G.G30, G.G52, G.G92)
"""Non-modal codes that take the axis words of their line."""
# A look-up of a member in its class takes time in each line.
_TRAVERSE, _FEED, _CANCEL = G.G0, G.G1, G.G80
_STRAIGHT, _ARCS = (G.G0, G.G1), (G.G2, G.G3)
_ROUND = frozenset((*"RIJK", ",O"))
"""Words that make an arc round."""

Handler = Callable[[LineWords, Code | None], None]
"""Makes the move of a motion code: takes the words of the line and sets the position.

The code is None if it was in effect already.
"""


class Motion(MoveFeeds):
    """Execution of moves.

    Attributes:
        handlers: Handlers of motion codes other than G0 to G3.
        collector: The curve that is being defined, if any.
        compensation: Cutter radius compensation of the moves.
        motion_before: Motion code in effect before the line.
        repeat_words: Letters that repeat the move of a motion code without an axis word.
        tip_controlled: Whether tool-tip control is on.
        move_with_vector: Makes a move that has the direction of the tool (G43.5, TRAORI).
        turn_with_vector: Turns the rotary axes of a control point to the direction of the tool.
        vector_letters: Words of the direction of the tool.
        corners: The corner whose second move is not known yet (,C and ,R).
        assumed: The motion of axis words without a motion code.
    """

    def __init__(
        self,
        context: Context,
        position: list[float],
    ) -> None:
        super().__init__(context, position)
        self.collector: Collector | None = None
        self.compensation = Compensation(context.out, context.here)
        self.handlers: dict[G, Handler] = {}
        self.motion_before: G | None = None
        self.repeat_words: dict[G, frozenset[str]] = dict.fromkeys(_ARCS, _ARC_WORDS)
        self.tip_controlled = False
        self.move_with_vector: VectorMove | None = None
        self.turn_with_vector: VectorTurn | None = None
        self.vector_letters: tuple[str, ...] = ()
        self.assumed = AssumedMotion(context)
        self.arcs = ArcMoves(self)
        self.corners = CornerMoves(self.arcs, self.make_straight, self.make_arc)

    @property
    def compensated(self) -> bool:
        """Whether cutter compensation is on."""
        return self.compensation.on

    def check(self, words: LineWords, codes: Codes) -> G | None:
        """Find the motion code of a line before it is executed.

        Returns:
            The code; None for a line without a move.

        Raises:
            GcodeError: The words and the codes of the line do not fit together.
        """
        code, special, state = codes.get("motion"), codes.get("non-modal"), self._state
        self._machine_words = special is not None and special.number == G.G53
        self.motion_before = state.motion
        has_axis = words.has_axis()
        if special and special.number == G.G4 and has_axis:
            has_axis = self._axis_beside_dwell(words, code)
        taker = special if special and special.number in _TAKES_AXES else None
        for group in _TRANSFORMS:
            transform = codes.get(group)
            if transform and transform.number in _TRANSFORM_TAKES_AXES:
                taker = taker or transform
        if (length := codes.get("tool-length")) and (
            length.number == G.G43_1 or (length.number == G.G43_2 and "H" not in words.rest)
        ):
            if special and (taker or self._machine_words):
                raise fault(
                    "axis-words-wanted-twice",
                    f"both {special.word.written} and {length.word.written} take axis words",
                    length.word,
                )
            taker = length
        if taker:
            if code:
                beside = (
                    code.number in _STRAIGHT
                    and taker.number in (G.G28, G.G30)
                    and self._dialect.home.beside_motion
                )
                if code.number != _CANCEL and not beside:
                    raise fault(
                        "axis-words-wanted-twice",
                        f"both {taker.word.written} and {code.word.written} take axis words",
                        code.word,
                    )
                if taker.number not in _TRANSFORM_TAKES_AXES:
                    self.assumed.keep()
                    if code.number == _CANCEL:
                        self.assumed.cancel()
                    else:
                        self.assumed.end()
                        state.motion = code.g
            return None
        if code:
            return self._explicit(words, code, special, has_axis)
        if not has_axis:
            if self._machine_words and special:
                self._machine_without_axes(special.word)
                return None
            orient = codes.get("spindle")
            letters = self.repeat_words.get(state.motion or _TRAVERSE, frozenset())
            if state.motion in _STRAIGHT and self._has_vector(words):
                return state.motion
            again = not letters.isdisjoint(words.rest) and not (orient and orient.number == M.M19)
            return state.motion if again and special is None else None
        return self._modal_move(words, special)

    def _machine_without_axes(self, at: Word) -> None:
        """Refuse a G53 without axis words, or report it: it acts in its own line only."""
        if not self._dialect.lenient:
            hint = "such as G53 G0 Z0"
            raise fault("axis-words-missing", f"{at.written} needs axis words", at, hint)
        message = f"{at.written} without axis words has no effect"
        self._here.report_warning("code-without-effect", message, at, "it is not modal")

    def _axis_beside_dwell(self, words: LineWords, code: Code | None) -> bool:
        """Whether a line with G4 has axis words of a move.

        If an axis letter is the time of the dwell, the line can't have a move.
        """
        units = self._dialect.dwell.units_in(words)
        timed = [letter for letter in units if letter in AXES and letter in words.rest]
        if timed and code:
            raise fault(
                "word-wanted-twice",
                f"both G4 and {code.word.written} take a {timed[0]} word in this line",
                words.rest[timed[0]],
            )
        return any(letter in AXES and letter not in timed for letter in words.rest)

    def _explicit(
        self, words: LineWords, code: Code, special: Code | None, has_axis: bool
    ) -> G | None:
        """Check a line that has a motion code."""
        if self._machine_words and special:
            if code.number not in _STRAIGHT:
                raise fault(
                    "machine-coordinates-motion",
                    f"{special.word.written} goes with G0 and G1 only",
                    special.word,
                )
            if not has_axis:
                self._machine_without_axes(special.word)
        self.assumed.keep()
        if code.number == _CANCEL:
            self.assumed.cancel()
            if not has_axis:
                return None
            motion, word = self._state.motion, words.first_axis()
            if motion is None and (motion := self.assumed.assume(word)) is None:
                message = f"{word.written} with {code.word.written}, which makes no move"
                raise fault("motion-missing", message, word, "give G0 or G1")
            return motion
        self.assumed.end()
        self._state.motion = code.g
        if code.number in _STRAIGHT and not has_axis and not self._has_vector(words):
            return None
        return code.g

    def _modal_move(self, words: LineWords, special: Code | None) -> G:
        """Check axis words that belong to the motion code in effect."""
        word, motion = words.first_axis(), self._state.motion
        if special and not self._machine_words:
            message = f"{word.written} with {special.word.written}, but no motion code in this line"
            raise fault("axis-words-unused", message, word, "write the move on a line of its own")
        if motion is None and (motion := self.assumed.assume(word)) is None:
            message = f"{word.written} without a motion code in effect"
            raise fault("motion-missing", message, word, "begin with G0 or G1")
        if motion == G.G6_2:
            message = f"G6.2 is still in effect: {word.written} needs a new motion code"
            raise fault("nurbs-still-active", message, word, "give G0, G1, G2, G3 or another G6.2")
        if special and motion not in _STRAIGHT:
            raise fault(
                "machine-coordinates-motion",
                f"{special.word.written} goes with G0 and G1 only",
                special.word,
            )
        return motion

    def move(self, words: LineWords, motion: G | None, explicit: Code | None = None) -> None:
        """Make the move of the code that :meth:`check` returned; ``explicit`` is in the line."""
        if motion is None:
            return
        code = explicit.word if explicit else None
        if motion in _ARCS and self._dialect.arcs.straight and words.rest.keys().isdisjoint(_ROUND):
            at = code or words.first()
            message = f"{motion.written} without R, I, J and K is a straight move"
            hint = "write G1; other controls refuse the line"
            self._here.report_warning("arc-without-center", message, at, hint)
            motion = _FEED
        turned = self.move_with_vector if self._has_vector(words) else None
        if turned is not None and motion in _STRAIGHT:
            turned(words, code, rapid=motion is _TRAVERSE)
        elif motion is _TRAVERSE:
            self.traverse(self.target(words, "G0", self.position, machine=self._machine_words))
        elif motion is _FEED:
            at = code or words.first_axis()
            angled = words.take(",A", "G1") if self._dialect.motion.corners else None
            given = set(words.rest) if angled else set()
            end = self.target(words, "G1", self.position, machine=self._machine_words)
            if angled:
                end = self._end_at_angle(angled, given, end)
            feed = self.feed(words, end, None, at)
            if self._dialect.motion.corners and (word := corners.take(words, "G1")):
                start = self.position
                if self.corners.corner is not None:
                    start = self.corners.finish(end)
                self.corners.hold(word, start, end, feed, self._here.line)
                self.position = end
            else:
                self.feed_to(end, feed)
        elif motion in _ARCS:
            at = code or words.first()
            block = self.arcs.block(words, motion, code)
            if isinstance(block, NurbsFeed):
                self._make_tilted_arc(block, at)
                return
            name = motion.written
            self._arc(block, corners.take(words, name) if self._dialect.motion.corners else None)
        else:
            if motion in _CURVES:
                self.compensation.refuse_curve(code)
            self.handlers[motion](words, explicit)

    def _make_tilted_arc(self, block: NurbsFeed, at: Word) -> None:
        """Make an arc in a plane that a rotation tilts, which has no offset curve here."""
        if self.compensated:
            raise under_compensation(at)
        self.compensation.refuse_curve(at)
        self.spline(block)

    def _end_at_angle(self, angle: Word, given: set[str], end: list[float]) -> list[float]:
        """Return the end of a straight move of which one axis and the angle are given."""
        if self.coordinates.turned or self._machine_words:
            message = f"{angle.written} in machine coordinates, or under a rotation or scaling"
            raise fault("corner-angle", message, angle, "give both axes of the plane")
        plane = self.arcs.plane_columns(angle, angle.letter)
        columns = [index for index in plane if self.axes[index].upper() in given]
        return corners.line_with_angle(angle, self.position, end, plane, columns)

    def _has_vector(self, words: LineWords) -> bool:
        """Whether a straight move has the direction of the tool."""
        return not words.rest.keys().isdisjoint(self.vector_letters)

    def traverse(self, end: list[float]) -> None:
        """Make a straight move at the speed of the axes."""
        self.feed_to(end, math.nan)

    def feed_to(self, end: list[float], feed: float) -> None:
        """Make a straight move to a machine position at ``feed`` mm/s."""
        if self._state.constant_surface and math.isnan(feed):
            self.keep_surface_radius(end)
        if self.corners.corner is not None:
            if math.isnan(feed):
                raise self.corners.fault("G0")
            self.corners.finish(end)
        self.make_straight(end, feed, self._here.line)
        self.position = end

    def set_timed(self, on: bool) -> None:
        """State whether F is the time of each move from here on (G93)."""
        self._out.set_timed(on)

    def make_straight(self, end: list[float], feed: float, line: int) -> None:
        """Put a straight move out, without setting the position."""
        if self.compensation.active:
            self.compensation.move(end, feed, line)
        else:
            self._out.move(end, feed, line)

    def arc(self, block: ArcFeed) -> None:
        """Make an arc from the position."""
        self._arc(block, None)

    def _arc(self, block: ArcFeed, corner: Word | None) -> None:
        """Make an arc from the position, or keep it if it has a corner at its end."""
        start = self.position
        if self.corners.corner is not None:
            block, start = self.corners.finish_before_arc(block)
        if corner is not None:
            self.corners.hold_arc(corner, start, block)
        else:
            self.make_arc(block)
        self.position = block.end.tolist()

    def make_arc(self, block: ArcFeed) -> None:
        """Put an arc out, without setting the position."""
        if self.compensation.active:
            self.compensation.arc(block)
        else:
            self._out.add(block)

    def spline(self, block: NurbsFeed) -> None:
        """Make a spline from the position."""
        if self.corners.corner is not None:
            raise self.corners.fault("a spline")
        self._out.add(block)
        self.position = block.control_points[-1].tolist()

    def homed(self, position: tuple[float, ...]) -> None:
        """Go on where the board stands after homing."""
        if position:
            self.position = list(position)


class MotionCodes(Executor):
    """A module of codes that use or make moves."""

    def __init__(self, motion: Motion) -> None:
        super().__init__(motion.context)
        self._motion = motion
