"""Roughing and finishing of LinuxCNC: G70, G71 and G72 with a profile in a subroutine.

D is the distance that stays between the tool and the profile, at right angles to it. Outside
corners are passed on an arc. The passes are those of this program's own roughing: none is deeper
than I, and none comes closer than D. Source: LinuxCNC, "G70 Lathe finishing cycle", "G71 G72 Lathe
roughing cycles".
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

from cnc.gcode.cycles.profile_cycles import ProfileCycles, ends_of
from cnc.gcode.cycles.roughing import MOST_PASSES, Cut, Roughing, Traverse, TurningStep, rough
from cnc.gcode.geometry.offset_curves import (
    Curve,
    OffsetLine,
    TrueArc,
    join,
    round_offset,
    straight_offset,
)
from cnc.gcode.geometry.turning_profile import (
    TINY,
    Piece,
    Profile,
    View,
    arc_pieces,
    is_monotone,
    profile_of,
)
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import LineWords, Word, fault, whole
from cnc.model.blocks import Block, Polyline

_LEFT = 1
"""The stock is on the left of a profile that runs to the right."""


class SubroutineProfiles(ProfileCycles):
    """Execution of the cycles with the blocks of a profile."""

    def check(self, at: Word) -> None:
        """Check that a cycle is possible; see :meth:`TurningMoves.check`."""
        self._moves.check(at)

    def go_to_start(self, words: LineWords, at: Word) -> None:
        """Traverse to the X and Z of a cycle, if it has them."""
        z, x = self._moves.place
        given = self._moves.given(words, at.written)
        self._moves.rapid(given.get("Z", z), given.get("X", x))

    def make(self, code: G, words: LineWords, blocks: list[Block], at: Word) -> None:
        """Make the moves of a cycle.

        Args:
            code: G70, G71 or G72.
            words: Words of the line that belong to the cycle.
            blocks: Moves of the profile, from the position.
            at: The G word.
        """
        start = self._moves.motion.position
        body, view = self._body(code, blocks, start, at)
        top = view.point(start)
        if code == G.G70:
            steps = self._finishing(words, body, top, at)
        else:
            steps = self._passes(words, body, top, at)
        if words.rest:
            word = words.first()
            raise fault("word-unused", f"{word.written} has no use in {at.written}", word)
        with self._moves.exact_path():
            for step in steps:
                self._make(step, view, at, rapid_in=False)

    def _body(
        self, code: G, blocks: list[Block], start: list[float], at: Word
    ) -> tuple[Profile, View]:
        """The profile without the approach, and its view. G70 finds the axis by itself."""
        z, x = self._moves.columns
        first = ends_of(blocks)[0]
        for each in (G.G71, G.G72) if code == G.G70 else (code,):
            # The profile runs from its first point: G70 may start at its end.
            along, begin = (x if each == G.G72 else z), start.copy()
            begin[along] = first[along]
            view = self._view(each, blocks, begin, at)
            path = profile_of(blocks, start, view)
            body = path[1:] if isinstance(blocks[0], Polyline) and len(path) > 1 else path
            if is_monotone((body[0].start.real, *(piece.end.real for piece in body))):
                break
        top = view.point(start)
        if code == G.G70:
            top = complex(body[0].start.real, top.imag)
        self._check_profile([Piece(top, body[0].start), *body], at, pockets=True)
        return body, view

    def _distance(self, words: LineWords, letter: str, default: float, at: Word) -> float:
        word = words.take(letter, at.written)
        if word is None:
            return default * self._moves.state.scale
        if word.number < 0.0:
            raise fault("value-out-of-range", f"{word.written}: it must not be negative", word)
        return word.number * self._moves.state.scale

    def _passes(
        self, words: LineWords, body: Profile, start: complex, at: Word
    ) -> list[TurningStep]:
        """The steps of G71 and G72, up to the end of the profile at the height of the start."""
        distance, depth, retract = (
            self._distance(words, letter, default, at)
            for letter, default in (("D", 0.0), ("I", 1.0), ("R", 0.5))
        )
        body = self._offset(body, distance, at)
        profile = [Piece(start, body[0].start), *body]
        rises = is_monotone(piece.end.imag for piece in profile[1:])
        cycle = Roughing(profile, 0j, depth, retract, pockets=not rises)
        if not depth or cycle.passes > MOST_PASSES:
            message = f"{at.written} makes more than {MOST_PASSES} passes"
            raise fault("cycle-too-long", message, at, "give a larger I")
        return list(rough(cycle))[:-2]

    def _finishing(
        self, words: LineWords, body: Profile, start: complex, at: Word
    ) -> list[TurningStep]:
        """The steps of G70, which ends at the end of the profile."""
        first = self._distance(words, "D", 0.0, at)
        last = self._distance(words, "E", 0.0, at)
        word = words.take("P", at.written)
        count = whole(word, "the number of passes", 1, MOST_PASSES) if word else 1
        steps: list[TurningStep] = []
        for number in range(count, 0, -1):
            path = self._offset(body, (number - 1) * (first - last) / count + last, at)
            begin = path[0].start
            if steps:
                steps += [Traverse(complex(path[-1].end.real, start.imag)), Traverse(start)]
            steps += [Traverse(complex(begin.real, start.imag)), Traverse(begin)]
            steps += [Cut(piece) for piece in path]
        return steps

    def _offset(self, body: Profile, distance: float, at: Word) -> Profile:
        """Return the profile at a distance towards the stock."""
        if not distance:
            return body
        curves = [_beside(piece, distance) for piece in _whole(body)]
        found: Profile = []
        begin: complex | None = None
        cut_before = 0.0
        for a, b in pairwise([*curves, None]):
            if a is None:
                break
            here = a.first if begin is None else begin
            corner = None if b is None else join(a, b, _LEFT, distance)
            if b is not None and (corner is None or cut_before + corner.cut > a.length + TINY):
                break
            found += _pieces(a, here, a.last if corner is None else corner.leave)
            if b is None:
                return found
            assert corner is not None
            if corner.around:
                around = Piece(corner.leave, corner.enter, a.corner, -1)
                found += arc_pieces(around.start, around.end, a.corner, around.turns)
            begin, cut_before = corner.enter, max(corner.begin, 0.0)
        message = f"the distance {distance:g} mm does not fit into a corner of the profile"
        raise fault("allowance-in-pocket", message, at, "give a smaller one")


def _whole(body: Profile) -> Profile:
    """Return a profile with its arcs in one piece, which were cut at their quadrants."""
    found: Profile = []
    for piece in body:
        last = found[-1] if found else None
        same = last is not None and (last.center, last.spin) == (piece.center, piece.spin)
        if last is not None and same and piece.center is not None:
            found[-1] = replace(last, end=piece.end)
        else:
            found.append(piece)
    return found


def _beside(piece: Piece, distance: float) -> Curve | None:
    """Return the offset of a piece; None for an arc that is too narrow."""
    if piece.center is None:
        return straight_offset(piece.start, piece.end, _LEFT, distance)
    arc = TrueArc(piece.end, piece.center, piece.turns, 1.0)
    return round_offset(piece.start, arc, _LEFT, distance)


def _pieces(curve: Curve, start: complex, end: complex) -> Profile:
    """Return the part of a curve between two points."""
    if isinstance(curve, OffsetLine):
        return [Piece(start, end)]
    turns = Piece(start, end, curve.center, curve.spin).turns
    return arc_pieces(start, end, curve.center, turns)
