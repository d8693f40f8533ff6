"""Numbered programs: M98 and M99, and FANUC's G65 with arguments.

Source: LinuxCNC, "O codes", FANUC-style numbered programs; FANUC operator's manual, "Subprogram
(M98, M99)" and "Custom macro", macro call.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Literal

from cnc.gcode.program.call_stack import Flow, Frame
from cnc.gcode.program.control_flow import Back, jump_target
from cnc.gcode.program.listing import Listing, Mark, Step
from cnc.gcode.syntax.code_numbers import G, M
from cnc.gcode.syntax.parameters import LOCAL_MACRO, Parameters
from cnc.gcode.syntax.statement import Statement, Value
from cnc.gcode.syntax.words import Word, fault

MAX_PROGRAM = 99_999_999
MAX_REPEATS = 999_999_999
LONGEST_NUMBER = 9999
"""FANUC's M98 takes P with more digits as repeats and, in its last four, the number."""

_ARGUMENTS = dict(
    zip(
        "ABCDEFHIJKMQRSTUVWXYZ",
        (1, 2, 3, 7, 8, 9, 11, 4, 5, 6, 13, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26),
        strict=True,
    )
)
"""FANUC's first argument list: where a letter of G65 goes. I, J and K more than once are the second
list: #4 to #33 in threes.
"""
_SETS = 10


class _Taken:
    """Words that a call takes out of its statement, and what is left of it to be executed
    before.
    """

    def __init__(self, statement: Statement, letters: str, code: Word) -> None:
        computed = dict(statement.computed)
        self.values: dict[str, tuple[Word, Value | None]] = {}
        words: list[Word] = []
        left: list[tuple[int, Value]] = []
        for index, word in enumerate(statement.words):
            if word is code:
                continue
            if word.letter in letters:
                if word.letter in self.values:
                    raise fault("word-repeated", f"{word.letter} is given twice in this line", word)
                self.values[word.letter] = word, computed.get(index)
                continue
            if index in computed:
                left.append((len(words), computed[index]))
            words.append(word)
        self._empty = not words and not statement.assignments and not statement.remarks
        self._rest = Statement(tuple(words), tuple(left), statement.assignments, statement.remarks)

    def execute_rest(self, flow: Flow, line: int) -> None:
        """Do what else the line says."""
        flow.interpreter.begun = True
        if not self._empty:
            flow.interpreter.execute(self._rest, line)

    def whole(self, letter: str, parameters: Parameters, what: str, highest: int) -> int | None:
        """A word's number, which must be whole; None where it is not given (or vacant)."""
        if letter not in self.values:
            return None
        word, value = self.values[letter]
        number = word.number if value is None else value(parameters)
        if number != number:
            return None
        if not 0 <= number <= highest or number != int(number):
            raise fault(
                "value-out-of-range",
                f"{word.written}: {what} must be a whole number from 0 to {highest}",
                word,
            )
        return int(number)


class ProgramCall:
    """``M98 P L`` and ``G65 P L`` with arguments."""

    __slots__ = ("arguments", "at", "code", "macro", "taken")

    def __init__(self, line: int, statement: Statement, code: Word, *, macro: bool) -> None:
        self.at = Mark(line, code.column, code.length)
        self.code, self.macro = code, macro
        self.arguments: list[tuple[int, Word, Value | None]] | None = None
        if code.letter == "G":
            statement, self.arguments = _arguments(statement, code)
        self.taken = _Taken(statement, "PL", code)

    def run(self, flow: Flow, line: int) -> int:
        """Execute what else the line says, then go into the program."""
        parameters = flow.parameters
        number, repeats = self._number(parameters)
        arguments = None if self.arguments is None else self._computed(self.arguments, parameters)
        self.taken.execute_rest(flow, line)
        if flow.interpreter.ended or repeats == 0:
            return line + 1
        listing, scope = self._look_up(flow, number)
        kind: Literal["program", "macro"] = "program" if arguments is None else "macro"
        frame = Frame(
            kind, f"O{number}", listing, scope + 1, scope, flow.listing, self.at, line + 1, left=repeats - 1, repeated=repeats > 1
        )  # fmt: skip
        return flow.enter(frame, arguments)

    def _number(self, parameters: Parameters) -> tuple[int, int]:
        """Number of the program, and how often it is called."""
        number = self.taken.whole("P", parameters, "the number of a program", MAX_PROGRAM)
        if number is None:
            written = self.code.written
            raise fault(
                "program-number-missing",
                f"{written} needs P, the number of a program",
                self.code,
                f"such as {written} P100",
            )
        repeats = self.taken.whole("L", parameters, "the number of repeats", MAX_REPEATS)
        if repeats is None and self.macro and self.arguments is None and number > LONGEST_NUMBER:
            return number % (LONGEST_NUMBER + 1), number // (LONGEST_NUMBER + 1)
        return number, 1 if repeats is None else repeats

    def _computed(
        self, arguments: list[tuple[int, Word, Value | None]], parameters: Parameters
    ) -> list[float]:
        found = [math.nan] * LOCAL_MACRO
        for number, word, value in arguments:
            found[number - 1] = word.number if value is None else value(parameters)
        return found

    def _look_up(self, flow: Flow, number: int) -> tuple[Listing, int]:
        """In this file or the main program, or in a file of its own, which needs no O line."""
        for listing in (flow.listing, flow.main):
            if found := self._in(listing, number):
                return listing, found
        file = flow.library.find(str(number), self.at)
        if file is not None:
            if found := self._in(file, number):
                return file, found
            if not file.places().programs and not file.places().subs:
                return file, 0
        for listing in (flow.listing, flow.main, *([file] if file else [])):
            if str(number) in listing.places().subs:
                hint = f"call it with o{number} call"
                raise fault(
                    "call-style-mixed",
                    f"o{number} is a sub, not a program",
                    self.taken.values["P"][0],
                    hint,
                )
        hint = (
            f"O{number} stands nowhere in this file, and no folder of subroutines has {number}.ngc"
        )
        raise fault(
            "program-unknown", f"there is no program O{number}", self.taken.values["P"][0], hint
        )

    def _in(self, listing: Listing, number: int) -> int | None:
        places = listing.places()
        if again := places.programs_again.get(number):
            message = f"O{number} begins in line {places.programs[number]} already"
            raise listing.wrong(
                again, listing.control(again), "program-repeated", message, "take another number"
            )
        return places.programs.get(number)


def _arguments(
    statement: Statement, code: Word
) -> tuple[Statement, list[tuple[int, Word, Value | None]]]:
    """The statement of G65 without its arguments, and the variable each argument goes to; a later
    one takes the place of an earlier.
    """
    computed = dict(statement.computed)
    kept: list[Word] = []
    left: list[tuple[int, Value]] = []
    found: list[tuple[int, Word, Value | None]] = []
    threes, last = 0, "K"
    behind = False
    given: set[str] = set()
    for index, word in enumerate(statement.words):
        behind = behind or word is code
        if word is code or word.letter in "PLN":
            if index in computed:
                left.append((len(kept), computed[index]))
            kept.append(word)
            continue
        if word.letter not in _ARGUMENTS:
            raise fault(
                "argument-bad",
                f"{word.written} is no argument of G65",
                word,
                "arguments have the letters A to F, H to K, M and Q to Z",
            )
        if not behind:
            raise fault(
                "argument-bad",
                f"{word.written} stands before G65",
                word,
                "write arguments behind G65",
            )
        number = _ARGUMENTS[word.letter]
        if word.letter in "IJK":
            # A letter that does not come after the one before it begins another three.
            threes += word.letter <= last
            last = word.letter
            number += 3 * (threes - 1)
            if threes > _SETS:
                raise fault(
                    "argument-bad",
                    f"{word.written}: G65 takes I, J and K {_SETS} times at most",
                    word,
                )
        elif word.letter in given:
            raise fault("word-repeated", f"{word.letter} is given twice in this line", word)
        given.add(word.letter)
        found.append((number, word, computed.get(index)))
    return Statement(tuple(kept), tuple(left), statement.assignments, statement.remarks), found


class ProgramReturn:
    """``M99``, and ``M99 P n`` in FANUC's language."""

    __slots__ = ("at", "backs", "code", "taken")

    def __init__(self, line: int, statement: Statement, code: Word, *, macro: bool) -> None:
        self.at = Mark(line, code.column, code.length)
        self.code = code
        self.taken = _Taken(statement, "P" if macro else "", code)
        self.backs: dict[tuple[str, int], Back] = {}

    def run(self, flow: Flow, line: int) -> int:
        """Execute what else the line says, then go back to the caller, or to its block P."""
        block = self.taken.whole("P", flow.parameters, "a block number", MAX_PROGRAM)
        self.taken.execute_rest(flow, line)
        if flow.interpreter.ended:
            return line + 1
        frame = flow.frame
        if frame.kind == "sub":
            message = f"{self.code.written} in subroutine {frame.name} of line {frame.scope}"
            raise fault(
                "call-style-mixed",
                message,
                self.code,
                f"{frame.name} endsub and {frame.name} return lead back",
            )
        if frame.kind == "main":
            if block is None:
                message = f"{self.code.written} in the main program would begin it again, for ever"
                raise fault("program-endless", message, self.code, "end it with M30")
            return self._jump(flow, flow.listing, block, line, Back("this M99", self.at))
        if frame.left:
            frame.left -= 1
            frame.counts.clear()
            return frame.begin
        if block is None:
            return flow.leave()
        to = self._jump(
            flow, frame.caller, block, frame.at.line, Back(f"the call of {frame.name}", frame.at)
        )
        flow.leave()
        return to

    def _jump(self, flow: Flow, listing: Listing, block: int, line: int, back: Back) -> int:
        to = jump_target(listing, block, line, partial(flow.listing.fault, self.at))
        if to <= line:
            self.backs.setdefault((listing.name, line), back).note(flow, listing, to)
        return to


CODES = {("M", float(M.M98)), ("M", float(M.M99)), ("G", G.G65.code)}
"""Words that call and return."""


def call_or_return(line: int, statement: Statement, code: Word, *, macro: bool) -> Step:
    """The step of a line with M98, M99 or G65."""
    if code.number == M.M99:
        return ProgramReturn(line, statement, code, macro=macro)
    return ProgramCall(line, statement, code, macro=macro)
