"""Roughing and finishing of profiles on lathes: G70 to G73 with the lines P to Q.

The profile is read by the interpreter itself: its lines are executed without tools, speeds and
compensation, and the moves are taken instead of the machine. Type II of G71 (G72) is meant if the
first line of the profile has Z (X) too. The start point must be outside of the profile, and the
allowances must lie on its side. Source: FANUC, "Operator's Manual for Lathe System", "Multiple
repetitive cycle".
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from cnc.gcode.cycles.roughing import (
    MOST_PASSES,
    Cut,
    Pattern,
    Roughing,
    TurningStep,
    repeat,
    rough,
)
from cnc.gcode.cycles.turning_cycles import TurningCycles
from cnc.gcode.geometry.turning_profile import (
    SLACK,
    TINY,
    Profile,
    View,
    arc_block,
    is_monotone,
    profile_of,
)
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import LineWords, Word, fault, whole
from cnc.model.blocks import Block, Polyline


class ProfileCycles:
    """Execution of G71, G72 and G73 with the blocks of a profile."""

    def __init__(self, cycles: TurningCycles) -> None:
        self._dialect = cycles.moves.dialect
        self._cycles = cycles
        self._moves = cycles.moves

    def run(
        self, code: G, words: LineWords, blocks: list[Block], at: Word, *, pockets: bool
    ) -> None:
        """Execute a cycle.

        Args:
            code: G71, G72 or G73.
            words: Words of the line that belong to the cycle.
            blocks: Moves of the profile, from the position.
            at: The G word.
            pockets: Whether the first line has both axes (type II).
        """
        moves = self._moves
        moves.check(at)
        start = moves.motion.position
        view = self._view(code, blocks, start, at)
        profile = profile_of(blocks, start, view)
        rapid_in = bool(isinstance(blocks[0], Polyline) and math.isnan(blocks[0].feeds[0]))
        allowance = self._allowance(words, view, at)
        rises = self._check_profile(profile, at, pockets=pockets or code == G.G73)
        if not rises and abs(allowance.real) > TINY and code != G.G73:
            letter = "U" if code == G.G72 else "W"
            message = f"{letter} of {at.written} would cut into a wall of the pocket"
            hint = f"give {letter}0: a profile with a pocket has its allowance across only"
            raise fault("allowance-in-pocket", message, at, hint)
        steps: Iterable[TurningStep]
        if code == G.G73:
            steps = repeat(self._pattern(words, profile, allowance, view, at))
        else:
            steps = self._roughing(words, profile, allowance, at, pockets=pockets)
        if words.rest:
            word = words.first()
            raise fault("word-unused", f"{word.written} has no use in {at.written}", word)
        with moves.exact_path():
            for step in steps:
                self._make(step, view, at, rapid_in=rapid_in)

    def _view(self, code: G, blocks: list[Block], start: list[float], at: Word) -> View:
        """The view in which the stock is above and the passes go to the right."""
        z, x = self._moves.columns
        along, across = (x, z) if code == G.G72 else (z, x)
        ends = ends_of(blocks)
        if not ends:
            raise fault("profile-empty", "the profile has no move", at, "give the lines P to Q")
        to, first = ends[-1], ends[0]
        if abs(to[along] - start[along]) <= SLACK:
            letter = "X" if code == G.G72 else "Z"
            raise fault("profile-start", f"the profile does not go along {letter}", at)
        away = start[across] - first[across]
        if abs(away) <= SLACK:
            away = start[across] - min(
                (end[across] for end in ends), key=lambda place: -abs(place - start[across])
            )
        mirror = (
            1 if to[along] > start[along] else -1,
            1 if away >= 0.0 else -1,
        )
        return View((along, across), mirror, z_along=code != G.G72)

    def _allowance(self, words: LineWords, view: View, at: Word) -> complex:
        """The shift by U and W, which must lead away from the part."""
        motion = self._moves.motion
        x = words.take("U", at.written)
        z = words.take("W", at.written)
        scales = motion.scales
        z_column, x_column = self._moves.columns
        shift = [0.0] * len(motion.position)
        shift[x_column] = x.number * scales[x_column] if x else 0.0
        shift[z_column] = z.number * scales[z_column] if z else 0.0
        point = view.point(shift)
        for word, column in ((x, x_column), (z, z_column)):
            part = point.real if column == view.columns[0] else -point.imag
            if word and part > 0.0:
                message = f"{word.written} shifts the profile into the part"
                raise fault("allowance-sign", message, word, "give it the other sign")
        return point

    def _check_profile(self, profile: Profile, at: Word, *, pockets: bool) -> bool:
        """Check the profile; return whether it never falls."""
        along = [piece.end.real for piece in profile]
        if not is_monotone([profile[0].start.real, *along]):
            axis = "X" if at.number == G.G72.code else "Z"
            message = f"the profile turns back along {axis}"
            raise fault("profile-not-monotone", message, at, "let it go in one direction")
        top = profile[0].start.imag
        if max(piece.end.imag for piece in profile) > top + SLACK:
            message = "the profile reaches beyond the start point of the cycle"
            raise fault("profile-start", message, at, "start the cycle outside of the stock")
        rises = is_monotone(piece.end.imag for piece in profile)
        if not pockets and not rises:
            message = "the profile has a pocket, and its first line has one axis only (type I)"
            hint = "give both axes in the first line of the profile, such as W0, for type II"
            raise fault("profile-not-monotone", message, at, hint)
        return rises

    def _roughing(
        self, words: LineWords, profile: Profile, allowance: complex, at: Word, *, pockets: bool
    ) -> Iterable[TurningStep]:
        settings = self._cycles.settings
        depth = settings.depth
        if word := words.take("D", at.written):
            depth = self._moves.length(word, self._dialect.integer_unit)
        if depth is None:
            letter = "U" if at.number == G.G71.code else "W"
            hint = f"give {at.written} {letter} R in the line before, or D"
            if not self._dialect.two_line_cycles:
                hint = "give D"
            raise fault("cycle-word-missing", f"{at.written} needs the depth of a pass", at, hint)
        cycle = Roughing(profile, allowance, depth, settings.retract, pockets)
        if cycle.passes > MOST_PASSES:
            message = f"{at.written} makes more than {MOST_PASSES} passes"
            raise fault("cycle-too-long", message, at, "give a larger depth")
        return rough(cycle)

    def _pattern(
        self, words: LineWords, profile: Profile, allowance: complex, view: View, at: Word
    ) -> Pattern:
        settings, motion = self._cycles.settings, self._moves.motion
        relief, passes = settings.relief, settings.passes
        scale = self._moves.state.scale
        x, z, count = (words.take(letter, at.written) for letter in "IKD")
        if count is not None:
            relief = (x.number * scale if x else 0.0, z.number * scale if z else 0.0)
            passes = whole(count, "the number of passes", 1, MOST_PASSES)
        if relief is None:
            hint = "give G73 U W R in the line before" if self._dialect.two_line_cycles else ""
            message = f"{at.written} needs the relief and the number of passes"
            raise fault("cycle-word-missing", message, at, hint or "give I, K and D")
        shift = [0.0] * len(motion.position)
        z_column, x_column = self._moves.columns
        shift[x_column], shift[z_column] = relief
        point = view.point(shift)
        if point.real > 0.0 or point.imag < 0.0:
            message = "the relief shifts the first pass into the part"
            raise fault("allowance-sign", message, at, "give it the other sign")
        return Pattern(profile, allowance, point, passes)

    def _make(self, step: TurningStep, view: View, at: Word, *, rapid_in: bool) -> None:
        """Make a step. A cut that only approaches is a traverse if the profile's first one is."""
        motion, here = self._moves.motion, self._moves.here
        position = motion.position
        if not isinstance(step, Cut):
            end = _placed(view, position, step.to)
            if end != position:
                motion.traverse(end)
            return
        piece = step.piece
        end = _placed(view, position, piece.end)
        if end == position:
            return
        if step.approach and rapid_in:
            motion.traverse(end)
            return
        feed = motion.feed(LineWords(), end, motion.distance(end), at)
        if piece.center is None:
            motion.feed_to(end, feed)
        else:
            motion.arc(arc_block(piece, view, position, (here.file, here.line), feed))


def _placed(view: View, position: list[float], point: complex) -> list[float]:
    """A machine position at a point; an axis that stays keeps its exact value."""
    end = view.placed(position, point)
    return [old if abs(new - old) <= TINY else new for new, old in zip(end, position, strict=True)]


def ends_of(blocks: list[Block]) -> list[list[float]]:
    """Return the ends of moves, as machine positions."""
    found: list[list[float]] = []
    for block in blocks:
        if isinstance(block, Polyline):
            found += block.points.tolist()
        else:
            found.append(block.end.tolist())  # type: ignore[attr-defined]
    return found
