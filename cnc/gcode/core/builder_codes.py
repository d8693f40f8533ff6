"""Codes without a part in the motion: a builder's M-codes, and codes that are known to do nothing.

The machine file gives the effect of a builder's M-code ([program.codes]). The dialect lists the
codes of its controller that have no effect here, such as a chip conveyor. Both are taken out of the
line before its other codes are sorted.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from typing import NamedTuple

from cnc.gcode.core.context import Context, Executor
from cnc.gcode.core.modal_groups import GROUP_OF_G, PLAIN_MOTIONS, Codes, codes_of
from cnc.gcode.dialects import Dialect
from cnc.gcode.dialects.rules import NotedCode
from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.statements import Statement
from cnc.gcode.reader.words import AXES, G_OF_TENTHS, MAX_NUMBER, G, LineWords, M, Word, fault
from cnc.machine.program_codes import CodeAction, RunFile, SetOutput
from cnc.model.blocks import BoardCommand, DigitalOutput, Stop
from cnc.model.diagnostics import Fix
from cnc.model.units import decimal_text

_BUILDER_WORDS = "PQ"
"""Words that may stand beside a builder's M-code. Source: LinuxCNC, "M100 - M199"."""


_LAST_COUNTS = frozenset((
    "plane", "units", "distance", "feed-mode", "compensation", "tool-length", "system", "path",
    "spindle-mode", "retract",
))  # fmt: skip
"""Groups in which the last code of a line counts, besides the straight moves and arcs. Their
members are those of FANUC's groups 02, 06, 03, 05, 07, 08, 14, 15, 13 and 10."""


class ExtraCode(NamedTuple):
    """A code that was taken out of its line: its word, and one of an effect and a note."""

    word: Word
    action: CodeAction | None
    note: NotedCode | None


class BuilderCodes(Executor):
    """Recognition and execution of these codes."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._axes = {axis.upper() for axis in context.coordinates.axes}
        self._extruder_reported = False
        self._reported: set[tuple[str, float]] = set()

    def replace(self, first: Word, second: Word) -> bool:
        """Return whether the last of two words with one letter counts, and report it.

        A 0 after another number never does: it would stop the spindle or the feed.
        """
        if first.letter not in self._dialect.lines.repeated or (first.number and not second.number):
            return False
        message = f"{first.written} has no effect: {second.written} in the same line replaces it"
        self._here.report_warning("word-replaced", message, first, "remove one of them")
        return True

    def take(self, words: LineWords) -> tuple[ExtraCode, ...]:
        """Take these codes out of the words of a line."""
        if self._dialect.lines.extruder and "E" in words.rest:
            self._extrude(words)
        if not (words.m or words.g or "D" in words.rest):
            return ()
        found: list[ExtraCode] = []
        if self._dialect.tools.edges:
            _activate_edge(words)
        if self._dialect.spelled:
            self._refuse_spelled(words)
        if self._dialect.aliases:
            words.g[:] = [self._meant(word, words) for word in words.g]
        if self._dialect.lines.last_of_group and len(words.g) > 1:
            self._drop_replaced(words.g)
        for row in (words.g, words.m):
            for word in tuple(row):
                if extra := self._extra(word, words):
                    row.remove(word)
                    found.append(extra)
        return tuple(found)

    def _drop_replaced(self, row: list[Word]) -> None:
        """Drop the G-codes of a line that a later one of their group replaces, and report them.

        Source: FANUC Series 30i/31i/32i, "Operator's Manual", "Preparatory function": of codes of
        one group in a block the last one is valid.
        """
        last: dict[str, Word] = {}
        for word in tuple(row):
            if (group := _group_of(word)) is None:
                continue
            before = last.get(group)
            last[group] = word
            if before is None or before.number == word.number:
                continue
            row.remove(before)
            message = f"{before.written} has no effect: {word.written} in the same line replaces it"
            hint = "write the codes in two lines, in the intended order"
            self._here.report_warning("code-replaced", message, before, hint)

    def _extra(self, word: Word, words: LineWords) -> ExtraCode | None:
        is_m = word.letter == "M"
        if word.number != word.number or "-" in word.written:
            return None
        if is_m and (action := self._policy.codes.get(int(word.number))) is not None:
            return ExtraCode(word, action, None) if word.number.is_integer() else None
        note = self._dialect.noted.get((word.letter, word.number))
        if note is not None and note.unchecked and self._policy.missing_programs == "error":
            note = None
        if note is not None and note.applies(words):
            return ExtraCode(word, None, note)
        if is_m and self._policy.unknown_codes == "warn" and word.whole not in self._dialect.m:
            return ExtraCode(word, "ignore", None)
        return None

    def _extrude(self, words: LineWords) -> None:
        """Let E move its axis, or leave it out with a warning on a machine without one."""
        word, letter = words.rest.pop("E"), self._dialect.lines.extruder
        if any(code.letter == "M" for code in words.m):
            return
        if letter in self._axes:
            words.rest[letter] = Word(letter, word.number, word.written, word.column, word.length)
            return
        words.g[:] = [g for g in words.g if g.number != G.G92.code or words.has_axis()]
        if not self._extruder_reported:
            self._extruder_reported = True
            message = f"{word.written}: the machine has no {letter} axis for the extruder"
            hint = f"E follows the path on a machine file with [axes.{letter.lower()}]"
            self._here.report_warning("axis-idle", message, word, hint)

    def _refuse_spelled(self, words: LineWords) -> None:
        """Refuse the codes by which other words of the control are executed.

        Raises:
            GcodeError: ``code-not-in-dialect``.
        """
        for word in words.g:
            meant = self._dialect.spelled.get(word.number)
            if meant and word.written[:1] in "Gg":
                message = f"{word.written} is not in the {self._dialect.name} dialect"
                raise fault("code-not-in-dialect", message, word, f"write {' or '.join(meant)}")

    def _meant(self, word: Word, words: LineWords) -> Word:
        """Return the code that a number of this dialect stands for."""
        alias = self._dialect.aliases.get(word.number)
        if alias is None or not words.rest.keys().isdisjoint(alias.without):
            return word
        if alias.word:
            letter, number = alias.word[0], float(alias.word[1:])
            if letter in words.rest:
                return word
            words.rest[letter] = Word(letter, number, alias.word, word.column, word.length)
        return Word(word.letter, alias.code, word.written, word.column, word.length)

    def execute(self, words: LineWords, codes: tuple[ExtraCode, ...]) -> None:
        """Execute the codes before the others of their line, and take the words beside them."""
        here = self._here
        for word, action, note in codes:
            letters = _BUILDER_WORDS if note is None else note.words
            for letter in letters:
                if letter in words.rest:
                    words.take(letter, word.written)
            if note is not None:
                self._report(word, note)
            elif isinstance(action, SetOutput):
                self._out.add(
                    DigitalOutput(here.file, here.line, action.output, action.on, with_motion=False)
                )
            elif action == "pass-on":
                self._out.add(BoardCommand(here.file, here.line, word.written))
            elif action == "ignore" and word.whole not in self._policy.codes:
                self._report_unknown(word)

    def pause(self, codes: tuple[ExtraCode, ...]) -> None:
        """Stop for the operator at the end of a line with a code that says so."""
        for _, action, _ in codes:
            if action == "pause":
                self._out.add(Stop(self._here.file, self._here.line))

    def _report(self, word: Word, note: NotedCode) -> None:
        if not self._is_new(word):
            return
        message = f"{word.written} ({note.name}) has no effect here"
        if note.unchecked:
            message = f"{word.written} ({note.name}): the control's part of it is not checked"
            hint = "a run refuses it"
            self._here.report_warning("moves-not-checked", message, word, hint)
        elif word.letter == "G":
            self._here.report_note("code-not-needed", message, word)
        else:
            self._here.report_warning("code-without-effect", message, word)

    def _report_unknown(self, word: Word) -> None:
        if self._is_new(word):
            message = f"{word.written} is unknown; it is skipped"
            hint = f'say what it does in the machine file: {word.written} = ".." in [program.codes]'
            self._here.report_warning("code-skipped", message, word, hint)

    def _is_new(self, word: Word) -> bool:
        """Whether the code is met for the first time."""
        key = word.letter, word.number
        if key in self._reported:
            return False
        self._reported.add(key)
        return True


_SIDES = (G.G41.code, G.G42.code)


def _activate_edge(words: LineWords) -> None:
    """Put SINUMERIK's D and M6 into words of the tool length: D0 ends it, M6 activates edge 1."""
    edge = words.rest.pop("D", None)
    changes = any(word.number == M.M6 for word in words.m)
    if (edge is None and not changes) or any(word.number in _SIDES for word in words.g):
        return
    at = edge or words.m[0]
    code = G.G49 if edge is not None and edge.number == 0 else G.G43
    words.g.append(Word("G", code.code, at.written, at.column, at.length))


def file_of(action: CodeAction | None) -> RunFile | None:
    """Return the file that a builder's code executes; None for another effect."""
    return action if isinstance(action, RunFile) else None


def _group_of(word: Word) -> str | None:
    """Return the group of a G-code, None if it does not replace another one of its line."""
    code = None if word.tenths is None else G_OF_TENTHS.get(word.tenths)
    if code is None:
        return None
    group = GROUP_OF_G.get(code)
    return group if group in _LAST_COUNTS or code in PLAIN_MOTIONS else None


# Preparation of statements: the part of their interpretation that needs no parameter values.
#
# A statement in a loop is prepared once.

NEAR_CODE = 1e-3
"""Largest distance of ten times a computed code from a whole number."""
_EXPONENT = re.compile(r"E(?:[+-][0-9]{1,2}|[0-9]{2})")
_COORDINATES = AXES | frozenset("FIJKR")


@dataclass(frozen=True, slots=True)
class PreparedLine:
    """A statement and its sorted words; the ``computed`` ones have no number yet.

    Attributes:
        codes: The codes by modal group; None if a code is computed.
        extra: Codes that were taken out of the words.
        builder: Takes them out.
    """

    statement: Statement
    words: LineWords
    codes: Codes | None
    extra: tuple[ExtraCode, ...]
    builder: BuilderCodes

    def line_words(self, parameters: Parameters) -> LineWords:
        """Return the words for one execution with their computed numbers.

        A word with FANUC's vacant value counts as not written.
        """
        statement = self.statement
        if not statement.computed:
            known = self.words
            return LineWords(known.g, known.m, known.rest.copy())
        rest, sorted_words = self.words.rest, not self.extra and self.codes is not None
        words = list(statement.words)
        vacant: list[int] = []
        for index, value in statement.computed:
            word, number = words[index], value(parameters)
            sorted_words = sorted_words and rest.get(word.letter) is word
            if math.isnan(number):
                vacant.append(index)
            elif not -MAX_NUMBER <= number <= MAX_NUMBER:
                message = f"{word.written} is {number:g}; the limit is {MAX_NUMBER:.0f}"
                raise fault("number-too-large", message, word)
            elif word.letter in "GM":
                words[index] = _code(word, number)
            else:
                words[index] = Word(word.letter, number, word.written, word.column, word.length)
        if sorted_words and not vacant:
            new = {words[index].letter: words[index] for index, _ in statement.computed}
            return LineWords(self.words.g, self.words.m, rest | new)
        empty = tuple(words.pop(index) for index in reversed(vacant))
        line = LineWords.of(words, self.builder.replace)
        line.vacant = empty
        self.builder.take(line)
        return line


def _code(word: Word, number: float) -> Word:
    """A computed code, rounded to a tenth if it is close to one. Messages name it by its number."""
    tenths = round(number * 10)
    code = tenths / 10 if abs(number * 10 - tenths) < NEAR_CODE else number
    return Word(word.letter, code, f"{word.letter}{code:g}", word.column, word.length)


def prepare(statement: Statement, dialect: Dialect, builder: BuilderCodes) -> PreparedLine:
    """Prepare a statement.

    Args:
        statement: The statement.
        dialect: The dialect.
        builder: Takes codes without a part in the motion out of the line.

    Raises:
        GcodeError: The words or codes are wrong.
    """
    words = LineWords.of(statement.words, builder.replace)
    if dialect.lines.most_number:
        _check_line_number(statement, dialect)
    if "E" in words.rest:
        _refuse_exponent(statement)
    extra = builder.take(words)
    computed = {index for index, _ in statement.computed}
    constant = all(statement.words[index].letter not in "GM" for index in computed)
    codes = codes_of(words.g, words.m, dialect) if constant else None
    return PreparedLine(statement, words, codes, extra, builder)


def _check_line_number(statement: Statement, dialect: Dialect) -> None:
    for word in statement.words:
        if word.letter == "N" and word.number > dialect.lines.most_number:
            message = f"{word.written}: {dialect.name} has line numbers up to "
            message += f"{dialect.lines.most_number}"
            raise fault("line-number-bad", message, word, "number the lines anew, or without N")


def _refuse_exponent(statement: Statement) -> None:
    """Refuse an E that follows a coordinate without a blank and looks like an exponent."""
    for before, word in pairwise(statement.words):
        if (
            word.letter == "E"
            and before.letter in _COORDINATES
            and before.column + before.length == word.column
            and _EXPONENT.fullmatch(word.written)
        ):
            whole = Word(
                before.letter,
                before.number,
                before.written + word.written,
                before.column,
                before.length + word.length,
            )
            message = f"{whole.written}: a number has no exponent"
            hint, fix = _without_exponent(whole, before, word)
            raise fault("number-exponent", message, whole, hint, fix=fix)


def _without_exponent(whole: Word, before: Word, exponent: Word) -> tuple[str, Fix | None]:
    """Return hint and repair of a number with an exponent: its digits, unless they are too many."""
    value = Decimal(before.number).scaleb(int(exponent.written[1:]))
    if abs(value) > MAX_NUMBER:
        return f"a number is at most {MAX_NUMBER:.0f}", None
    digits = decimal_text(value, 9)
    exact = f"{Decimal(before.written[1:]).scaleb(int(exponent.written[1:])):f}"
    fix = Fix.replace("write the number out", whole.column, whole.length, before.letter + exact)
    return f"write {before.letter}{digits}", fix
