"""Roughing and finishing of profiles on lathes: G70 to G73 of FANUC, G70 to G72 of LinuxCNC.

Of each: first the moves of the cycles, then the steps that find the profile in the program.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

from cnc.gcode.core.call_stack import Flow
from cnc.gcode.core.interpreter import Interpreter
from cnc.gcode.core.modal_groups import Diverted, ModalState
from cnc.gcode.core.offset_curves import (
    Curve,
    OffsetLine,
    TrueArc,
    join,
    round_offset,
    straight_offset,
)
from cnc.gcode.core.subprograms import Call
from cnc.gcode.dialects import Dialect
from cnc.gcode.reader.source_text import Place
from cnc.gcode.reader.statements import Control, Statement
from cnc.gcode.reader.words import G, LineWords, Word, fault, whole
from cnc.gcode.turning.codes import MOST_PASSES, take_least_increments
from cnc.gcode.turning.cycles import TurningCycles
from cnc.gcode.turning.moves import TurningMoves
from cnc.gcode.turning.roughing import (
    SLACK,
    TINY,
    Cut,
    Pattern,
    Piece,
    Profile,
    Roughing,
    Traverse,
    TurningStep,
    View,
    arc_block,
    arc_pieces,
    is_monotone,
    profile_of,
    repeat,
    rough,
    without_pockets,
)
from cnc.model.blocks import ArcFeed, Block, Polyline
from cnc.model.diagnostics import GcodeError

# Roughing and finishing of profiles on lathes: G70 to G73 with the lines P to Q.
#
# The profile is read by the interpreter itself: its lines are executed without tools, speeds and
# compensation, and the moves are taken instead of the machine. Type II of G71 (G72) is meant if the
# first line of the profile has Z (X) too. The start point must be outside of the profile, and the
# allowances must lie on its side. Source: FANUC, "Operator's Manual for Lathe System", "Multiple
# repetitive cycle".


_DOUBTFUL = 10.0
"""Depths of the whole profile from which a depth without a decimal point is doubtful."""


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
        if code != G.G73 and (kept := self._without_return(code, blocks, start)) is not blocks:
            blocks = kept
            message = f"the last line of the profile goes back: {at.written} ends before it"
            moves.here.report_warning("profile-return", message, at, "write it behind the profile")
        view = self._view(code, blocks, start, at)
        profile = profile_of(blocks, start, view)
        rapid_in = bool(isinstance(blocks[0], Polyline) and math.isnan(blocks[0].feeds[0]))
        allowance = self._allowance(words, view, at)
        rises = self._check_profile(profile, at, pockets=pockets or code == G.G73)
        if not rises and abs(allowance.real) > TINY and code != G.G73:
            # FANUC: with W the tool may bite into the side wall of a type II profile.
            letter = "U" if code == G.G72 else "W"
            message = f"{letter} of {at.written} cuts into a wall of the pocket by that much"
            hint = f"give {letter}0: a profile with a pocket has its allowance across only"
            moves.here.report_warning("allowance-at-wall", message, at, hint)
        steps: Iterable[TurningStep]
        if code == G.G73:
            steps = repeat(self._pattern(words, profile, allowance, view, at))
        else:
            steps = self._roughing(words, profile, allowance, at, pockets=pockets)
        if words.rest:
            word = words.first()
            raise fault("word-unused", f"{word.written} has no use in {at.written}", word)
        with moves.context.exact_path():
            for step in steps:
                self.make_step(step, view, at, rapid_in=rapid_in)

    def _without_return(self, code: G, blocks: list[Block], start: list[float]) -> list[Block]:
        """Return the blocks without a last G0 that goes straight back at the outside of the stock.

        Such a line (``N20 G0 G40 Z0.1``) ends the compensation of G70. No pass can follow it.
        """
        ends = ends_of(blocks)
        if len(ends) < 3:
            return blocks
        last = blocks[-1]
        if not isinstance(last, Polyline) or not math.isnan(last.feeds[-1]):
            return blocks
        z, x = self._moves.columns
        along, across = (x, z) if code == G.G72 else (z, x)
        before, end, direction = ends[-2], ends[-1], ends[-2][along] - start[along]
        outwards = math.copysign(1.0, start[across] - ends[0][across])
        height = [place[across] * outwards for place in ends]
        is_outside = min(height[-2:]) >= max(height) - SLACK
        if (end[along] - before[along]) * direction >= 0.0 or not is_outside:
            return blocks
        if len(last.points) == 1:
            return blocks[:-1]
        short = replace(last, points=last.points[:-1], feeds=last.feeds[:-1], lines=last.lines[:-1])
        return [*blocks[:-1], short]

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
            # FANUC checks this where parameter 5104, bit 2 (FCK), is 1: alarm PS0322.
            message = (
                "the profile reaches beyond the start point of the cycle: no pass but the last "
                "goes there"
            )
            hint = "start the cycle outside of the stock"
            self._moves.here.report_warning("profile-beyond-start", message, at, hint)
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
        depth, doubtful = settings.depth, settings.doubtful
        if word := words.take("D", at.written):
            doubtful = None
            depth = self._moves.length(word, self._dialect.turning.integer_unit)
        if depth is None:
            letter = "U" if at.number == G.G71.code else "W"
            hint = f"give {at.written} {letter} R in the line before, or D"
            if not self._dialect.turning.two_line_cycles:
                hint = "give D"
            raise fault("cycle-word-missing", f"{at.written} needs the depth of a pass", at, hint)
        cycle = Roughing(profile, allowance, depth, settings.retract, pockets)
        if doubtful is not None and cycle.passes * _DOUBTFUL < 1.0:
            message = f"{doubtful.written} is many times deeper than the profile"
            hint = (
                "write the decimal point, or set least_increments = true under [program] of the "
                "machine file if the control counts 0.001 mm"
            )
            raise fault("decimal-point-needed", message, at, hint)
        if cycle.passes > MOST_PASSES:
            message = f"{at.written} makes more than {MOST_PASSES} passes"
            raise fault("cycle-too-long", message, at, "give a larger depth")
        return rough(cycle)

    def _pattern(
        self, words: LineWords, profile: Profile, allowance: complex, view: View, at: Word
    ) -> Pattern:
        settings, motion = self._cycles.settings, self._moves.motion
        relief, passes = settings.relief, settings.passes
        scale = self._moves.context.state.scale
        x, z, count = (words.take(letter, at.written) for letter in "IKD")
        if count is not None:
            relief = (x.number * scale if x else 0.0, z.number * scale if z else 0.0)
            passes = whole(count, "the number of passes", 1, MOST_PASSES)
        if relief is None:
            hint = (
                "give G73 U W R in the line before" if self._dialect.turning.two_line_cycles else ""
            )
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

    def make_step(self, step: TurningStep, view: View, at: Word, *, rapid_in: bool) -> None:
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
    ends: list[list[float]] = []
    for block in blocks:
        if isinstance(block, Polyline):
            ends += block.points.tolist()
        else:
            ends.append(block.end.tolist())  # type: ignore[attr-defined]
    return ends


# Steps of G70 to G73, which name the lines of a profile by P and Q.
#
# After G71 to G73 the program goes on behind the profile if the profile follows, else behind the
# cycle. G70 executes the lines of the profile like other lines, and returns to the start point.

MOST_LINES = 10_000
"""Most lines of a profile; it limits the memory."""
_PROFILE_CODES = {code.code: code for code in (G.G70, G.G71, G.G72, G.G73)}
_NO_MOVES = frozenset((65.0, 66.0, *(float(code) for code in range(70, 80))))
"""Calls of macros, and cycles."""
_MODES = "FSTMNG"
"""Letters of a cycle's line that are executed before the cycle."""
_PATH_CODES = frozenset((0.0, 1.0, 2.0, 3.0, 4.0, 9.0, 18.0, 90.0, 91.0))
"""Codes of a profile that roughing cycles execute."""
_PATH_LETTERS = frozenset((*"NGXZUWCRIKF", ",R", ",C", ",A"))


def profile_cycle(line: int, statement: Statement, dialect: Dialect) -> ProfileCycle | None:
    """Return the step of a line with G70 to G73, P and Q; None for another line."""
    if not dialect.turning.lathe or not {"P", "Q"} <= {word.letter for word in statement.words}:
        return None
    for word in statement.words:
        if word.letter == "G":
            alias = dialect.aliases.get(word.number)
            number = word.number if alias is None else alias.code
            if number in _PROFILE_CODES:
                return ProfileCycle(line, statement, word, _PROFILE_CODES[number])
    return None


class ProfileLine(NamedTuple):
    """A line of a profile."""

    number: int
    statement: Statement


class ProfileCycle:
    """``G71 P Q ..`` and its like."""

    def __init__(self, line: int, statement: Statement, word: Word, code: G, kind: int = 0) -> None:
        self._kind = kind
        self._statement = statement
        self._at = Place(line, word.column, word.length)
        self._word = word
        self._code = code

    def run(self, flow: Flow, line: int) -> int:
        """Execute the cycle; return the line to continue at."""
        interpreter = flow.interpreter
        words, rest = self._sorted(flow)
        first = self._line_of(flow, words, "P", line)
        last = self._line_of(flow, words, "Q", first - 1)
        if last < first:
            raise self._fault("profile-missing", "the last line of the profile is before the first")
        lines = self._lines(flow, first, last)
        after = self._after(flow, first, last, line)
        # The plain word of the cycle stands for it in messages.
        at = Word("G", self._code.code, self._word.written, self._word.column, self._word.length)
        interpreter.execute(rest, line)
        if self._code == G.G70:
            self._refuse_rest(words)
            _finish(interpreter, lines, line)
            return after
        moves = [ProfileLine(row.number, _path_words(row.statement)) for row in lines]
        turning = interpreter.turning_cycles
        assert turning is not None
        letters = {word.letter for word in lines[0].statement.words}
        both = bool(letters & set("XU")) and bool(letters & set("ZW"))
        with turning.moves.uncompensated(at):
            blocks = path_of(interpreter, moves, line)
            cycles = ProfileCycles(turning)
            cycles.run(self._code, words, blocks, at, pockets=both)
        return after

    def _sorted(self, flow: Flow) -> tuple[LineWords, Statement]:
        """The words of the cycle, and the rest of the line as a statement."""
        own: list[Word] = []
        kept: list[int] = []
        values = dict(self._statement.computed)
        for index, word in enumerate(self._statement.words):
            if word is self._word:
                continue
            if word.letter in _MODES:
                kept.append(index)
                continue
            number = values[index](flow.parameters) if index in values else word.number
            own.append(Word(word.letter, number, word.written, word.column, word.length))
        words, interpreter = LineWords.of(own), flow.interpreter
        if interpreter.dialect.turning.least_increments:
            scale = interpreter.modal.scale
            take_least_increments(words, self._code.code, scale)
        return words, self._statement.with_words(kept)

    def _line_of(self, flow: Flow, words: LineWords, letter: str, line: int) -> int:
        word = words.take(letter, self._word.written)
        assert word is not None
        number = whole(word, "the line number", 1, 99_999_999)
        begin, end = flow.listing.program_around(line)
        found = flow.listing.numbered(number, line + 1, end) or flow.listing.numbered(
            number, begin, line
        )
        if found is None:
            hint = f"give N{number} to the {'first' if letter == 'P' else 'last'} line"
            raise fault("profile-missing", f"there is no line N{number}", word, hint)
        return found

    def _lines(self, flow: Flow, first: int, last: int) -> list[ProfileLine]:
        """The lines of the profile.

        Raises:
            GcodeError: ``profile-too-long``, ``profile-line``.
        """
        if last - first >= MOST_LINES:
            message = f"the profile has more than {MOST_LINES} lines"
            raise self._fault("profile-too-long", message)
        lines: list[ProfileLine] = []
        for number in range(first, last + 1):
            statement = flow.listing.statement_at(number)
            if statement is None:
                continue
            if statement.control is not None or statement.percent or self._calls(flow, statement):
                message = f"line {number} of the profile is no move"
                hint = "profiles have no jumps, calls and cycles"
                raise self._fault("profile-line", message, hint)
            lines.append(ProfileLine(number, statement))
        return lines

    def _after(self, flow: Flow, first: int, last: int, line: int) -> int:
        """The line to continue at."""
        if first < line:
            return line + 1
        for number in range(line + 1, first):
            statement = flow.listing.statement_at(number)
            if statement is not None and (statement.words or statement.control):
                message = f"line {number} stands between the cycle and its profile"
                hint = "write the profile right behind the cycle, or before it"
                raise self._fault("profile-place", message, hint)
        return last + 1

    @staticmethod
    def _calls(flow: Flow, statement: Statement) -> bool:
        """Whether a line has a call, an end or a cycle."""
        aliases = flow.interpreter.dialect.aliases
        return any(
            (word.letter == "M" and word.number in (2.0, 30.0, 97.0, 98.0, 99.0))
            or (
                word.letter == "G"
                and (aliases[word.number].code if word.number in aliases else word.number)
                in _NO_MOVES
            )
            for word in statement.words
        )

    def _refuse_rest(self, words: LineWords) -> None:
        if words.rest:
            word = words.first()
            message = f"{word.written} has no use in {self._word.written}"
            raise fault("word-unused", message, word)

    def _fault(self, code: str, message: str, hint: str = "") -> GcodeError:
        return fault(code, message, self._word, hint)


def _path_words(statement: Statement) -> Statement:
    """A line of a profile without tools, speeds, compensation and machine codes."""
    computed = dict(statement.computed)
    kept = (
        index
        for index, word in enumerate(statement.words)
        if word.letter in _PATH_LETTERS
        and (word.letter != "G" or index in computed or word.number in _PATH_CODES)
    )
    return replace(statement.with_words(kept), remarks=())


def path_of(interpreter: Interpreter, lines: Iterable[ProfileLine], line: int) -> list[Block]:
    """Return the moves of lines without making them.

    Position and modes are as before afterwards, and the current line is ``line``.
    """
    motion = interpreter.motion
    state, position = replace(interpreter.modal), motion.position
    unused = interpreter.unused_words
    notes, unused.enabled = unused.enabled, False
    with interpreter.out.captured() as blocks:
        for number, statement in lines:
            try:
                interpreter.execute(statement, number)
            except GcodeError as error:
                raise error.at(line=error.diagnostic.line or number) from None
    unused.enabled = notes
    interpreter.context.state = state
    motion.position, interpreter.here.line = position, line
    interpreter.update_plain()
    return [block for block in blocks if isinstance(block, Polyline | ArcFeed)]


def _finish(interpreter: Interpreter, lines: Iterable[ProfileLine], line: int) -> None:
    """Execute the lines of a profile (G70), and return to the position before.

    The axis that approaches the profile most leaves it first: a straight return could cross the
    part.
    """
    motion = interpreter.motion
    start = motion.position
    approach: int | None = None
    for number, statement in lines:
        interpreter.execute(statement, number)
        if approach is None and motion.position != start:
            way = [abs(a - b) for a, b in zip(motion.position, start, strict=True)]
            approach = way.index(max(way))
    interpreter.here.line = line
    if motion.compensated:
        interpreter.compensation_codes.off()
    if approach is not None:
        clear = motion.position.copy()
        clear[approach] = start[approach]
        motion.traverse(clear)
    motion.traverse(start)
    interpreter.update_plain()


# Roughing and finishing of LinuxCNC: G70, G71 and G72 with a profile in a subroutine.
#
# D is the distance that stays between the tool and the profile, at right angles to it. Outside
# corners are passed on an arc. The passes are those of this program's own roughing: none is deeper
# than I, and none comes closer than D. Source: LinuxCNC, "G70 Lathe finishing cycle", "G71 G72
# Lathe roughing cycles".

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

    def make(self, code: G, words: LineWords, blocks: list[Block], at: Word, kind: int = 0) -> None:
        """Make the moves of a cycle.

        Args:
            code: G70, G71 or G72.
            words: Words of the line that belong to the cycle.
            blocks: Moves of the profile, from the position.
            at: The G word.
            kind: What G71 and G72 cut: all (0), all without pockets (1), pockets (2).
        """
        start = self._moves.motion.position
        body, view = self._body(code, blocks, start, at)
        top = view.point(start)
        if code == G.G70:
            steps = self._finishing(words, body, top, at)
        else:
            steps = self._passes(words, body, top, at, kind)
        if words.rest:
            word = words.first()
            raise fault("word-unused", f"{word.written} has no use in {at.written}", word)
        with self._moves.context.exact_path():
            for step in steps:
                self.make_step(step, view, at, rapid_in=False)

    def _body(
        self, code: G, blocks: list[Block], start: list[float], at: Word
    ) -> tuple[Profile, View]:
        """The profile without the approach, and its view. G70 finds the axis by itself."""
        z, x = self._moves.columns
        first = ends_of(blocks)[0]
        for cycle in (G.G71, G.G72) if code == G.G70 else (code,):
            # The profile runs from its first point: G70 may start at its end.
            along, begin = (x if cycle == G.G72 else z), start.copy()
            begin[along] = first[along]
            view = self._view(cycle, blocks, begin, at)
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
            return default * self._moves.context.state.scale
        if word.number < 0.0:
            raise fault("value-out-of-range", f"{word.written}: it must not be negative", word)
        return word.number * self._moves.context.state.scale

    def _passes(
        self, words: LineWords, body: Profile, start: complex, at: Word, kind: int
    ) -> list[TurningStep]:
        """The steps of G71 and G72, up to the end of the profile at the height of the start."""
        distance, depth, retract = (
            self._distance(words, letter, default, at)
            for letter, default in (("D", 0.0), ("I", 1.0), ("R", 0.5))
        )
        pockets: list[Profile]
        body, pockets = offset_profile(body, distance, at), [[]]
        if kind:
            closed, pockets = without_pockets(body)
            body, pockets = (closed, [[]]) if kind == 1 else (body, pockets)
        steps: list[TurningStep] = []
        for pocket in pockets:
            begin = pocket[0].start if pocket else start
            profile = pocket or [Piece(start, body[0].start), *body]
            rises = is_monotone(piece.end.imag for piece in profile[1:])
            above = max(start.imag - begin.imag, 0.0)
            cycle = Roughing(profile, 0j, depth, retract, pockets=not rises, clearance=above)
            if not depth or cycle.passes > MOST_PASSES:
                message = f"{at.written} makes more than {MOST_PASSES} passes"
                raise fault("cycle-too-long", message, at, "give a larger I")
            if pocket:
                steps.append(Traverse(begin + above * 1j))
            steps += list(rough(cycle))[:-2]
        return steps

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
            path = offset_profile(body, (number - 1) * (first - last) / count + last, at)
            begin = path[0].start
            if steps:
                steps += [Traverse(complex(path[-1].end.real, start.imag)), Traverse(start)]
            steps += [Traverse(complex(begin.real, start.imag)), Traverse(begin)]
            steps += [Cut(piece) for piece in path]
        return steps


def offset_profile(body: Profile, distance: float, at: Word) -> Profile:
    """Return the profile at a distance towards the stock."""
    if not distance:
        return body
    # A hollow arc of just this radius becomes the point where its neighbours meet.
    curves = [_beside(piece, distance) for piece in _whole(body) if not _ends_in(piece, distance)]
    offset: Profile = []
    begin: complex | None = None
    cut_before = 0.0
    whole = [curve for curve in curves if curve is not None]
    for a, b in pairwise([*whole, None]):
        if a is None or len(whole) < len(curves):
            break
        here = a.first if begin is None else begin
        corner = None if b is None else join(a, b, _LEFT, distance)
        if b is not None and (corner is None or cut_before + corner.cut > a.length + TINY):
            break
        offset += _pieces(a, here, a.last if corner is None else corner.leave)
        if b is None:
            return offset
        assert corner is not None
        if corner.around:
            around = Piece(corner.leave, corner.enter, a.corner, -1)
            offset += arc_pieces(around.start, around.end, a.corner, around.turns)
        begin, cut_before = corner.enter, max(corner.begin, 0.0)
    message = f"the distance {distance:g} mm does not fit into a corner of the profile"
    raise fault("allowance-in-pocket", message, at, "give a smaller one")


def _whole(body: Profile) -> Profile:
    """Return a profile with its arcs in one piece, which were cut at their quadrants."""
    profile: Profile = []
    for piece in body:
        last = profile[-1] if profile else None
        same = last is not None and (last.center, last.spin) == (piece.center, piece.spin)
        if last is not None and same and piece.center is not None:
            profile[-1] = replace(last, end=piece.end)
        else:
            profile.append(piece)
    return profile


def _ends_in(piece: Piece, distance: float) -> bool:
    """Return whether the offset of an arc is its centre."""
    hollow = piece.center is not None and piece.spin > 0
    return hollow and abs(abs(piece.start - piece.center) - distance) <= TINY  # type: ignore[operator]


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


# Steps of LinuxCNC's G70, G71 and G72, whose profile is a subroutine.
#
# The line is executed twice: first it enters the subroutine, whose blocks are kept back. At the
# return it makes the cycle with them. Commands of the subroutine besides moves have no effect.

_CODES = {
    70.0: (G.G70, 0), 71.0: (G.G71, 0), 71.1: (G.G71, 1), 71.2: (G.G71, 2),
    72.0: (G.G72, 0), 72.1: (G.G72, 1), 72.2: (G.G72, 2),
}  # fmt: skip
"""Each code, and what it cuts: all, all without the pockets of the profile (1), or these (2)."""
MAX_SUBROUTINE = 99_999


def subroutine_cycle(line: int, statement: Statement) -> SubroutineCycle | None:
    """Return the step of a line with G70, G71 or G72, and Q; None for another line."""
    if not any(word.letter == "Q" for word in statement.words):
        return None
    for word in statement.words:
        if word.letter == "G" and word.number in _CODES:
            return SubroutineCycle(line, statement, word, *_CODES[word.number])
    return None


@dataclass(slots=True)
class OpenProfile:
    """A cycle whose subroutine is being executed.

    Attributes:
        line: The line of the cycle.
        depth: Number of calls around it.
        code: The cycle.
        words: Words of the cycle.
        modal: The modal state before.
        position: Machine position before.
        blocks: The blocks that are kept back.
    """

    line: int
    depth: int
    code: G
    words: LineWords
    modal: ModalState
    position: list[float]
    blocks: Diverted


class SubroutineCycle(ProfileCycle):
    """``G71 Q100 X.. Z.. D.. I.. R..`` and its like."""

    def run(self, flow: Flow, line: int) -> int:
        """Enter the subroutine, or make the cycle after its return."""
        profile = flow.state(OpenProfile)
        if profile is None:
            return self._begin(flow, line)
        if profile.line != line or profile.depth != len(flow.frames):
            message = f"{self._word.written} within the profile of another cycle"
            raise self._fault("profile-line", message)
        self._end(flow, profile)
        return line + 1

    def _begin(self, flow: Flow, line: int) -> int:
        interpreter = flow.interpreter
        words, rest = self._sorted(flow)
        interpreter.execute(rest, line)
        cycles = self._cycles(flow)
        cycles.check(self._word)
        at = words.take("Q", self._word.written)
        assert at is not None
        label = str(whole(at, "the number of a subroutine", 0, MAX_SUBROUTINE))
        cycles.go_to_start(words, self._word)
        modal, position = replace(interpreter.modal), list(interpreter.motion.position)
        call = Call(flow, line, Control("call", label, (), at.column, at.length))
        first = call.run(flow, line)
        flow.frame.return_line = line
        depth = len(flow.frames) - 1
        blocks = interpreter.out.divert()
        flow.keep(OpenProfile(line, depth, self._code, words, modal, position, blocks))
        return first

    def _end(self, flow: Flow, profile: OpenProfile) -> None:
        interpreter = flow.interpreter
        flow.forget(OpenProfile)
        kept_back = interpreter.out.restore(profile.blocks)
        interpreter.context.state = profile.modal
        interpreter.motion.position = profile.position
        interpreter.here.line = profile.line
        interpreter.update_plain()
        blocks: list[Block] = [
            block for block in kept_back if isinstance(block, Polyline | ArcFeed)
        ]
        if not blocks:
            raise self._fault("profile-empty", "the profile has no move")
        self._cycles(flow).make(self._code, profile.words, blocks, self._word, self._kind)
        interpreter.update_plain()

    @staticmethod
    def _cycles(flow: Flow) -> SubroutineProfiles:
        return SubroutineProfiles(TurningCycles(TurningMoves(flow.interpreter.motion)))
