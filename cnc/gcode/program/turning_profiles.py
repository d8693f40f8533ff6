"""Steps of G70 to G73 on lathes, which name the lines of a profile by P and Q.

After G71 to G73 the program goes on behind the profile if the profile follows, else behind the
cycle. G70 executes the lines of the profile like other lines, and returns to the start point.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, replace
from typing import NamedTuple

from cnc.gcode.cycles.profile_cycles import ProfileCycles
from cnc.gcode.dialects import Dialect
from cnc.gcode.program.call_stack import Flow
from cnc.gcode.program.interpreter import Interpreter
from cnc.gcode.program.line_index import Place
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.statement import Statement, Value
from cnc.gcode.syntax.words import LineWords, Word, fault, whole
from cnc.model.blocks import ArcFeed, Block, Polyline
from cnc.model.diagnostics import GcodeError

MOST_LINES = 10_000
"""Most lines of a profile; it limits the memory."""
_PROFILE_CODES = {code.code: code for code in (G.G70, G.G71, G.G72, G.G73)}
_MODES = "FSTMNG"
"""Letters of a cycle's line that are executed before the cycle."""
_PATH_CODES = frozenset((0.0, 1.0, 2.0, 3.0, 4.0, 9.0, 18.0, 90.0, 91.0))
"""Codes of a profile that roughing cycles execute."""
_PATH_LETTERS = frozenset((*"NGXZUWCRIKF", ",R", ",C", ",A"))


def profile_cycle(line: int, statement: Statement, dialect: Dialect) -> ProfileCycle | None:
    """Return the step of a line with G70 to G73, P and Q; None for another line."""
    if not dialect.lathe or not {"P", "Q"} <= {word.letter for word in statement.words}:
        return None
    for word in statement.words:
        if word.letter == "G":
            alias = dialect.aliases.get(word.number)
            number = word.number if alias is None else alias.code
            if number in _PROFILE_CODES:
                return ProfileCycle(line, statement, word, _PROFILE_CODES[number])
    return None


class _Line(NamedTuple):
    """A line of a profile."""

    number: int
    statement: Statement


class ProfileCycle:
    """``G71 P Q ..`` and its like."""

    def __init__(self, line: int, statement: Statement, word: Word, code: G) -> None:
        self._statement = statement
        self._at = Place(line, word.column, word.length)
        self._word = word
        self._code = code

    def run(self, flow: Flow, line: int) -> int:
        """Execute the cycle; return the line to continue at."""
        interpreter = flow.interpreter
        words, rest = self._sorted(flow)
        first, last = (self._line_of(flow, words, letter, line) for letter in "PQ")
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
        moves = [_Line(each.number, _path_words(each.statement)) for each in lines]
        turning = interpreter.turning_cycles
        assert turning is not None
        letters = {word.letter for word in lines[0].statement.words}
        both = bool(letters & set("XU")) and bool(letters & set("ZW"))
        with turning.moves.uncompensated(at):
            blocks = _path_of(interpreter, moves, line)
            cycles = ProfileCycles(turning)
            cycles.run(self._code, words, blocks, at, pockets=both)
        return after

    def _sorted(self, flow: Flow) -> tuple[LineWords, Statement]:
        """The words of the cycle, and the rest of the line as a statement."""
        own: list[Word] = []
        kept: list[Word] = []
        computed: list[tuple[int, Value]] = []
        values = dict(self._statement.computed)
        for index, word in enumerate(self._statement.words):
            if word is self._word:
                continue
            if word.letter in _MODES:
                if index in values:
                    computed.append((len(kept), values[index]))
                kept.append(word)
                continue
            number = values[index](flow.parameters) if index in values else word.number
            own.append(Word(word.letter, number, word.written, word.column, word.length))
        statement = self._statement
        rest = Statement(tuple(kept), tuple(computed), statement.assignments, statement.remarks)
        return LineWords.of(own), rest

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

    def _lines(self, flow: Flow, first: int, last: int) -> list[_Line]:
        """The lines of the profile.

        Raises:
            GcodeError: ``profile-too-long``, ``profile-line``.
        """
        if last - first >= MOST_LINES:
            message = f"the profile has more than {MOST_LINES} lines"
            raise self._fault("profile-too-long", message)
        found: list[_Line] = []
        for number in range(first, last + 1):
            statement = _statement(flow, number)
            if statement is None:
                continue
            if statement.control is not None or statement.percent or _calls(statement):
                message = f"line {number} of the profile is no move"
                raise self._fault("profile-line", message, "profiles have no jumps and no calls")
            found.append(_Line(number, statement))
        return found

    def _after(self, flow: Flow, first: int, last: int, line: int) -> int:
        """The line to continue at."""
        if first < line:
            return line + 1
        for number in range(line + 1, first):
            statement = _statement(flow, number)
            if statement is not None and (statement.words or statement.control):
                message = f"line {number} stands between the cycle and its profile"
                hint = "write the profile right behind the cycle, or before it"
                raise self._fault("profile-place", message, hint)
        return last + 1

    def _refuse_rest(self, words: LineWords) -> None:
        if words.rest:
            word = words.first()
            message = f"{word.written} has no use in {self._word.written}"
            raise fault("word-unused", message, word)

    def _fault(self, code: str, message: str, hint: str = "") -> GcodeError:
        return fault(code, message, self._word, hint)


def _statement(flow: Flow, line: int) -> Statement | None:
    window = flow.listing.window(line)
    return None if window is None else flow.listing.statement(window, line - window.first)


def _calls(statement: Statement) -> bool:
    return any(
        (word.letter == "M" and word.number in (2.0, 30.0, 97.0, 98.0, 99.0))
        or (word.letter == "G" and word.number in (65.0, 66.0))
        for word in statement.words
    )


def _path_words(statement: Statement) -> Statement:
    """A line of a profile without tools, speeds, compensation and machine codes."""
    values = dict(statement.computed)
    kept: list[Word] = []
    computed: list[tuple[int, Value]] = []
    for index, word in enumerate(statement.words):
        if word.letter not in _PATH_LETTERS or (
            word.letter == "G" and index not in values and word.number not in _PATH_CODES
        ):
            continue
        if index in values:
            computed.append((len(kept), values[index]))
        kept.append(word)
    return Statement(tuple(kept), tuple(computed), statement.assignments)


def _path_of(interpreter: Interpreter, lines: Iterable[_Line], line: int) -> list[Block]:
    """Return the moves of lines without making them.

    Position and modes are as before afterwards, and the current line is ``line``.
    """
    motion, modal = interpreter.motion, interpreter.modal
    state, position = replace(modal), motion.position
    unused = interpreter.unused_words
    notes, unused.enabled = unused.enabled, False
    with interpreter.out.captured() as found:
        for number, statement in lines:
            interpreter.execute(statement, number)
    unused.enabled = notes
    for each in fields(state):
        setattr(modal, each.name, getattr(state, each.name))
    motion.position, interpreter.here.line = position, line
    interpreter.update_plain()
    return [block for block in found if isinstance(block, Polyline | ArcFeed)]


def _finish(interpreter: Interpreter, lines: Iterable[_Line], line: int) -> None:
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
