"""Numbered programs: calls with M98, G65, G66 and M97 (of lines), return with M99.

Sources: LinuxCNC, "O codes", FANUC-style numbered programs; FANUC operator's manual, "Subprogram
(M98, M99)", the call of a sequence number, and "Custom macro", macro call and modal call; Haas,
"Mill Operator's Manual", M97.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from functools import partial
from typing import Literal, NamedTuple

from cnc.gcode.core.call_stack import Flow, Frame, Listing, Step
from cnc.gcode.core.control_flow import BackwardJump, jump_target
from cnc.gcode.core.modal_groups import Code
from cnc.gcode.core.subprograms import skips_missing
from cnc.gcode.reader.parameters import LOCAL_MACRO, Parameters
from cnc.gcode.reader.source_text import PROGRAM, Place, bare_text, lines_from
from cnc.gcode.reader.statements import Statement, Value
from cnc.gcode.reader.words import G, M, Word, fault
from cnc.model.diagnostics import GcodeError

# Arguments of macro calls: the words of G65 and G66, and the variables that they set.
#
# Source: FANUC operator's manual, "Custom macro", argument specification I and II.

_ARGUMENTS = dict(
    zip(
        "ABCDEFHIJKMQRSTUVWXYZ",
        (1, 2, 3, 7, 8, 9, 11, 4, 5, 6, 13, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26),
        strict=True,
    )
)
"""FANUC's argument list I: the variable of each letter of G65. I, J and K given several times are
list II: #4 to #33 in threes.
"""
_MAX_THREES = 10
_ARGUMENT_LETTERS = "arguments have the letters A to F, H to K, M and Q to Z"


class Argument(NamedTuple):
    """An argument of G65: the number of its variable, its word, and its value if computed."""

    number: int
    word: Word
    value: Value | None

    def result(self, parameters: Parameters) -> float:
        """Return the number of the argument."""
        return self.word.number if self.value is None else self.value(parameters)


class _ArgumentNumbers:
    """Assigns the words of G65 to variables, in the order written."""

    def __init__(self) -> None:
        self._threes, self._last = 0, "K"
        self._given: set[str] = set()

    def number(self, word: Word) -> int:
        """Return the variable of a word.

        Raises:
            GcodeError: ``argument-bad``, ``word-repeated``.
        """
        letter = word.letter
        if letter not in _ARGUMENTS:
            message = f"{word.written} is not an argument of G65"
            raise fault("argument-bad", message, word, _ARGUMENT_LETTERS)
        number = _ARGUMENTS[letter]
        if letter in "IJK":
            # A letter that does not come after the one before it begins another three.
            self._threes += letter <= self._last
            self._last = letter
            number += 3 * (self._threes - 1)
            if self._threes > _MAX_THREES:
                message = f"{word.written}: G65 takes I, J and K at most {_MAX_THREES} times"
                raise fault("argument-bad", message, word)
        elif letter in self._given:
            raise repeated(word)
        self._given.add(letter)
        return number


def split_arguments(statement: Statement, code: Word) -> tuple[Statement, list[Argument]]:
    """Split the statement of G65 into its other words and its arguments.

    A later argument of the same variable replaces an earlier one.
    """
    computed = dict(statement.computed)
    kept: list[int] = []
    arguments: list[Argument] = []
    numbers = _ArgumentNumbers()
    behind = False
    for index, word in enumerate(statement.words):
        behind = behind or word is code
        if word is code or word.letter in "PLN":
            kept.append(index)
            continue
        if word.letter in _ARGUMENTS and not behind:
            message = f"{word.written} stands before G65"
            raise fault("argument-bad", message, word, "write arguments after G65")
        arguments.append(Argument(numbers.number(word), word, computed.get(index)))
    return statement.with_words(kept), arguments


def repeated(word: Word) -> GcodeError:
    """Return the error for a word that a line gives twice."""
    return fault("word-repeated", f"{word.letter} is given twice in this line", word)


# Programs of a file that its first program does not call.
#
# A control stores each program of a file under its number, and the operator selects one. Here the
# first one is the main program, so that another one is executed only if it is called.

_CALL = re.compile(r"(?:m98|g65|g66)(?![0-9.]).*?p([0-9]+)(?![0-9.])")
_REPEATS = 10_000
"""FANUC's M98 reads a larger P as repeats followed by four digits of program number."""


def check_main(flow: Flow, code: Word, line: int) -> None:
    """Refuse a first program that ends with M99 and that a later program of the file calls.

    Raises:
        GcodeError: ``main-program-later``.
    """
    if (number := _main_number(flow)) is None:
        return
    caller = "", 0
    for at, text in _lines(flow, line + 1):
        if program := PROGRAM.fullmatch(text):
            caller = f"O{program[1]}", at
        elif caller[1] and (call := _CALL.search(text)):
            called = int(call[1])
            if called == number or (called >= _REPEATS and called % _REPEATS == number):
                name, first = caller
                message = (
                    f"{name} of line {first} calls O{number}, which ends with {code.written}: "
                    f"{name} is the main program"
                )
                hint = f"put {name} first, and its subprograms behind it, before the last %"
                raise fault("main-program-later", message, code, hint)


def report_uncalled(flow: Flow) -> None:
    """Warn once of the programs behind the end of the main program that were not called.

    A text whose first program has no number is read to its end only: it is a stream, or a file with
    one program.
    """
    if flow.frames or flow.listing is not flow.main or _main_number(flow) is None:
        return
    here = flow.interpreter.here
    left = [
        (f"O{match[1]}", line)
        for line, text in _lines(flow, here.line + 1)
        if (match := PROGRAM.fullmatch(text)) and match[1] and line not in flow.entered
    ]
    if not left:
        return
    name, here.line = left[0]
    more = f" and {len(left) - 1} more" if len(left) > 1 else ""
    message = f"{name}{more} behind the end of the program: not called, and not checked"
    hint = "check each program in a file of its own"
    here.report_warning("program-not-called", message, Word("O", 0.0, name, 1, 1), hint)


def _lines(flow: Flow, line: int) -> Iterator[tuple[int, str]]:
    """Yield the lines of the main text from here on, without comments and blanks."""
    for number, text in lines_from(flow.main, line):
        if bare := bare_text(text):
            yield number, bare


def _main_number(flow: Flow) -> int | None:
    """Return the number of the main program; None without one."""
    match = PROGRAM.fullmatch(bare_text(flow.main.source(flow.main_border)))
    return int(match[1]) if match and match[1] else None


MAX_PROGRAM = 99_999_999
MAX_REPEATS = 999_999_999
LONGEST_NUMBER = 9999
"""FANUC's M98 reads a larger P as repeats followed by four digits of program number."""

BUILDERS = range(8000, 10_000)
"""Programs that FANUC's parameter 3202 protects: a builder's and those of probes are among them."""


class _CallWords:
    """The words of a call, apart from the rest of its line, which is executed before the call."""

    def __init__(self, statement: Statement, letters: str, code: Word) -> None:
        computed = dict(statement.computed)
        self.values: dict[str, tuple[Word, Value | None]] = {}
        kept: list[int] = []
        for index, word in enumerate(statement.words):
            if word is code:
                continue
            if word.letter in letters:
                if word.letter in self.values:
                    raise repeated(word)
                self.values[word.letter] = word, computed.get(index)
                continue
            kept.append(index)
        self._rest = statement.with_words(kept)

    def execute_rest(self, flow: Flow, line: int) -> None:
        """Execute the rest of the line."""
        flow.interpreter.begun = True
        if self._rest != Statement():
            flow.interpreter.execute(self._rest, line)

    def whole(self, letter: str, parameters: Parameters, meaning: str, highest: int) -> int | None:
        """Return the whole number of a word.

        Args:
            letter: The letter of the word.
            parameters: The parameters to compute it with.
            meaning: The meaning of the number, for the message.
            highest: Largest number that is allowed.

        Returns:
            The number; None if the word is missing or vacant.

        Raises:
            GcodeError: ``value-out-of-range``.
        """
        if letter not in self.values:
            return None
        word, value = self.values[letter]
        number = word.number if value is None else value(parameters)
        if number != number:
            return None
        if not 0 <= number <= highest or number != int(number):
            message = f"{word.written}: {meaning} must be a whole number from 0 to {highest}"
            raise fault("value-out-of-range", message, word)
        return int(number)


class ProgramCall:
    """``M98 P L``, ``M97 P L`` and ``M98 Q L`` of lines, and ``G65 P L`` with arguments."""

    __slots__ = ("arguments", "at", "code", "letter", "local", "packed", "words")

    def __init__(
        self, line: int, statement: Statement, code: Word, *, packed: bool, lines: bool = False
    ) -> None:
        """Read the words of a call.

        Args:
            line: The line.
            statement: Its words.
            code: The code of the call.
            packed: Whether P of M98 over 9999 has the repeats before its last four digits.
            lines: Whether M98 calls the lines from the N number of its Q on.
        """
        self.at = Place(line, code.column, code.length)
        self.code, self.packed = code, packed
        self.letter: Literal["P", "Q"] = "Q" if lines else "P"
        self.local = lines or (code.letter == "M" and code.number == M.M97)
        self.arguments: list[Argument] | None = None
        if code.letter == "G":
            statement, self.arguments = split_arguments(statement, code)
        self.words = _CallWords(statement, self.letter + "L", code)

    def run(self, flow: Flow, line: int) -> int:
        """Execute the rest of the line, then enter the program."""
        parameters = flow.parameters
        number, repeats = self._number_and_repeats(flow)
        arguments = None if self.arguments is None else self._locals(self.arguments, parameters)
        self.words.execute_rest(flow, line)
        if flow.interpreter.ended or repeats == 0:
            return line + 1
        return self.enter(flow, line, (number, repeats), arguments)

    def enter(
        self,
        flow: Flow,
        line: int,
        called: tuple[int, int],
        arguments: list[float] | None,
    ) -> int:
        """Enter the program.

        Args:
            flow: The flow of control.
            line: The line of the call, or the line after which a modal call is made.
            called: The number of the program, and how often it is executed.
            arguments: Values of the local variables of a macro.
        """
        number, repeats = called
        program = (
            self._look_up_line(flow, number) if self.local else self._look_up(flow, number, line)
        )
        if program is None:
            return line + 1
        listing, scope = program
        if listing is flow.main:
            flow.entered.add(scope)
        kind: Literal["program", "macro"] = "program" if arguments is None else "macro"
        name, caller = f"{'N' if self.local else 'O'}{number}", flow.listing
        frame = Frame(kind, name, listing, scope, caller, self.at, line + 1, repeats)
        return flow.enter(frame, arguments)

    def _number_and_repeats(self, flow: Flow) -> tuple[int, int]:
        """Return the number of the program, and how often it is called.

        P has no repeats before the number if the text has a program of all its digits: the control
        has numbers of eight digits (or, as Haas, of five).
        """
        parameters = flow.parameters
        meaning = "the N number" if self.local else "the program number"
        number = self.words.whole(self.letter, parameters, meaning, MAX_PROGRAM)
        if number is None:
            written = self.code.written
            message = f"{written} needs P, the program number"
            raise fault("program-number-missing", message, self.code, f"such as {written} P100")
        repeats = self.words.whole("L", parameters, "the number of repeats", MAX_REPEATS)
        packed = self.packed and self.arguments is None and not self.local
        if (
            repeats is None
            and packed
            and number > LONGEST_NUMBER
            and not self._begins(flow, number)
        ):
            return number % (LONGEST_NUMBER + 1), number // (LONGEST_NUMBER + 1)
        return number, 1 if repeats is None else repeats

    @staticmethod
    def _begins(flow: Flow, number: int) -> bool:
        """Return whether a program of this number begins in the text of the call or of the main."""
        texts = (flow.listing, flow.main)
        return any(number in listing.definitions().programs for listing in texts)

    def _locals(self, arguments: list[Argument], parameters: Parameters) -> list[float]:
        """Return the values of #1 to #33; NaN for those without an argument."""
        values = [math.nan] * LOCAL_MACRO
        for argument in arguments:
            values[argument.number - 1] = argument.result(parameters)
        return values

    def _look_up_line(self, flow: Flow, number: int) -> tuple[Listing, int]:
        """Find the lines that M97 P or M98 Q calls, in the program of the call."""
        listing = flow.listing
        begin, end = listing.program_around(self.at.line)
        line = listing.numbered(number, begin, end)
        if line is None:
            word = self.words.values[self.letter][0]
            hint = f"give the first line of them N{number}"
            raise fault("block-unknown", f"there is no line N{number}", word, hint)
        return listing, line - 1

    def _look_up(self, flow: Flow, number: int, line: int) -> tuple[Listing, int] | None:
        """Find a program in this text, in the main program, or in a file of its own.

        Returns:
            The text and the line of the O number; 0 for a file without O lines. None if a check
            continues without the program.
        """
        for listing in (flow.listing, flow.main):
            if program := self._in(listing, number):
                return listing, program
        file = flow.library.find(str(number), self.at)
        if file is not None:
            if program := self._in(file, number):
                return file, program
            if not file.definitions().programs and not file.definitions().subs:
                return file, 0
        word = self.words.values["P"][0]
        for listing in (flow.listing, flow.main, *([file] if file else [])):
            if str(number) in listing.definitions().subs:
                message = f"o{number} is a subroutine, not a program"
                raise fault("call-style-mixed", message, word, f"call it with o{number} call")
        hint = ""
        if end := flow.main.definitions().behind.get(number):
            hint = f"O{number} stands behind the % in line {end}, which ends the text: remove it"
        repeats, short = divmod(number, LONGEST_NUMBER + 1)
        if repeats and any(self._in(listing, short) for listing in (flow.listing, flow.main)):
            hint = f"FANUC reads it as O{short}, {repeats} times: write P{short} L{repeats}"
        if not hint:
            # A file with subprograms has all of them, but for a builder's: the number is mistyped.
            begins = flow.main.definitions().programs.values()
            alone = all(begin == flow.main_border for begin in begins)
            if (alone or number in BUILDERS) and skips_missing(flow, f"O{number}", word, line):
                return None
            hint = f"there is no O{number} in this file, and no {number}.ngc in the folders"
        raise fault("program-unknown", f"there is no program O{number}", word, hint)

    def _in(self, listing: Listing, number: int) -> int | None:
        definitions = listing.definitions()
        if repeated := definitions.repeated_programs.get(number):
            message = f"O{number} begins in line {definitions.programs[number]} already"
            control = listing.control(repeated)
            hint = "use another number"
            raise listing.control_fault(repeated, control, "program-repeated", message, hint)
        return definitions.programs.get(number)


class ProgramReturn:
    """``M99``, and ``M99 P n`` in FANUC's language."""

    __slots__ = ("at", "backs", "code", "words")

    def __init__(self, line: int, statement: Statement, code: Word, *, macro: bool) -> None:
        self.at = Place(line, code.column, code.length)
        self.code = code
        self.words = _CallWords(statement, "P" if macro else "", code)
        self.backs: dict[tuple[str, int], BackwardJump] = {}

    def run(self, flow: Flow, line: int) -> int:
        """Execute the rest of the line, then return to the caller, or to its block P."""
        block = self.words.whole("P", flow.parameters, "a block number", MAX_PROGRAM)
        self.words.execute_rest(flow, line)
        if flow.interpreter.ended:
            return line + 1
        frame = flow.frame
        if frame.kind == "sub":
            message = f"{self.code.written} in subroutine {frame.name} of line {frame.scope}"
            hint = f"return with {frame.name} endsub or {frame.name} return"
            raise fault("call-style-mixed", message, self.code, hint)
        if frame.kind == "main":
            if block is None:
                _end_once(flow, self.code, line)
                return line + 1
            jump = BackwardJump("this M99", self.at)
            return self._jump(flow, flow.listing, block, line, jump)
        if frame.rounds > 1 or block is None:
            return flow.finish()
        jump = BackwardJump(f"the call of {frame.name}", frame.at)
        to = self._jump(flow, frame.caller, block, frame.at.line, jump)
        flow.leave()
        return to

    def _jump(self, flow: Flow, listing: Listing, block: int, line: int, jump: BackwardJump) -> int:
        to = jump_target(listing, block, line, partial(flow.listing.fault, self.at))
        if to <= line:
            self.backs.setdefault((listing.name, line), jump).record(flow, listing, to)
        return to


def _end_once(flow: Flow, code: Word, line: int) -> None:
    """End a main program that its M99 would repeat for ever.

    Raises:
        GcodeError: ``program-endless``, ``main-program-later``.
    """
    check_main(flow, code, line)
    message, interpreter = f"{code.written} repeats the main program for ever", flow.interpreter
    # A lathe with a bar feeder makes one part after the other.
    if not interpreter.dialect.lenient and not interpreter.dialect.turning.lathe:
        raise fault("program-endless", message, code, "end it with M30")
    interpreter.here.line = line
    message += " on its controller; here it ends"
    interpreter.here.report_warning("program-ends-once", message, code, "write M30")
    interpreter.stop(Code(M.M30, code))


class ModalCall(ProgramCall):
    """``G66 P L`` with arguments: the macro is executed after each move, until ``G67``."""

    def run(self, flow: Flow, line: int) -> int:
        """Execute the rest of the line, and keep the call."""
        parameters = flow.parameters
        if flow.modal is not None:
            message = f"{self.code.written} under another G66"
            raise fault("macro-active", message, self.code, "give G67 before")
        called = self._number_and_repeats(flow)
        assert self.arguments is not None
        arguments = self._locals(self.arguments, parameters)
        self.words.execute_rest(flow, line)
        if self._look_up(flow, called[0], line) is not None:
            flow.begin_modal(lambda after: self.enter(flow, after, called, arguments.copy()))
        return line + 1


class ModalEnd:
    """``G67``: the end of G66."""

    __slots__ = ("words",)

    def __init__(self, statement: Statement, code: Word) -> None:
        self.words = _CallWords(statement, "", code)

    def run(self, flow: Flow, line: int) -> int:
        """End the modal call, then execute the rest of the line."""
        flow.modal = None
        self.words.execute_rest(flow, line)
        return line + 1


CODES = {
    *(("M", float(code)) for code in (M.M97, M.M98, M.M99)),
    *(("G", code.code) for code in (G.G65, G.G66, G.G67)),
}
"""Letters and numbers of the words that call and return."""


def call_or_return(
    line: int, statement: Statement, code: Word, *, macro: bool, packed: bool, sequence: bool
) -> Step:
    """Return the step of a line with one of the codes.

    Args:
        line: The line.
        statement: Its words.
        code: The code.
        macro: Whether the language is FANUC's macro B.
        packed: Whether P of M98 over 9999 has the repeats before its last four digits.
        sequence: Whether M98 without P calls the lines from the N number of its Q on.
    """
    if code.letter == "G" and code.number == G.G66.code:
        return ModalCall(line, statement, code, packed=packed)
    if code.letter == "G" and code.number == G.G67.code:
        return ModalEnd(statement, code)
    if code.letter == "M" and code.number == M.M99:
        return ProgramReturn(line, statement, code, macro=macro)
    letters = {word.letter for word in statement.words}
    lines = sequence and code.letter == "M" and code.number == M.M98
    lines = lines and "Q" in letters and "P" not in letters
    return ProgramCall(line, statement, code, packed=packed, lines=lines)
