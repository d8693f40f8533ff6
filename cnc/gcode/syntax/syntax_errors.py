"""What is wrong with a line that the grammar does not take, in a machinist's words.

The grammar tells where a line stops making sense and what it would have taken there. What is wanted
sorts the faults; the characters about the place name them.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from cnc.gcode.syntax.arithmetic import FUNCTIONS, MACRO_FUNCTIONS, MACRO_OPERATORS, OPERATORS
from cnc.gcode.syntax.words import fault
from cnc.model.diagnostics import GcodeError

if TYPE_CHECKING:
    from lark.exceptions import UnexpectedInput

_TOKEN = re.compile(r"\([^()]*\)|(?:SD|PL|PW)=|[A-Z]+|[0-9.]+|\*\*|<[^<>]*>|.")
_RUN = re.compile(r"[A-Z]+")
_O_KEYWORDS = (
    "SUB", "ENDSUB", "CALL", "RETURN", "IF", "ELSEIF", "ELSE", "ENDIF", "WHILE", "ENDWHILE", "DO", "REPEAT", "ENDREPEAT", "BREAK",
    "CONTINUE",
)  # fmt: skip
_MACRO_KEYWORDS = ("GOTO", "IF", "THEN", "WHILE", "DO", "END")
_SIGNS = {"<": "LT", ">": "GT", "!": "NE", "&": "AND", "|": "OR", "^": "**", "%": "MOD"}
"""What is written in place of a sign of other languages."""
_SPLINE_WORDS = (
    "ASPLINE",
    "CSPLINE",
    "SPLINEPATH",
    "POLY",
    "BAUTO",
    "BNAT",
    "BTAN",
    "EAUTO",
    "ENAT",
    "ETAN",
)
"""Siemens' words about splines other than the B-spline."""
_DIGITS = "0123456789."


def _shown(char: str) -> str:
    """A character as messages show it."""
    return f"{char!r}" if char.isprintable() else f"U+{ord(char):04X}"


def describe(
    text: str, columns: Sequence[int], error: UnexpectedInput, *, macro: bool
) -> GcodeError:
    """The error for a line without blanks (``columns`` as :func:`cnc.gcode.syntax.parser.squeeze`
    gives them) at which the grammar stopped.
    """
    return _Fault(text, columns, error, macro=macro).describe()


class _Fault:
    """The place where a line stopped making sense: ``at`` in the text without blanks, and what was
    wanted there.
    """

    def __init__(
        self, text: str, columns: Sequence[int], error: UnexpectedInput, *, macro: bool
    ) -> None:
        token = getattr(error, "token", None)
        ended = token is not None and token.type == "$END"
        self.text, self.columns, self.macro = text, columns, macro
        self.at = len(text) if ended else error.pos_in_stream or 0
        self.char = text[self.at : self.at + 1]
        self.wanted = {
            str(name)
            for name in getattr(error, "allowed", None) or getattr(error, "expected", None) or ()
        }
        self.motion_before = [
            found.span()
            for found in _TOKEN.finditer(text[: self.at])
            if not found[0].startswith("(")
        ]
        self.machine_codes = {
            *(MACRO_FUNCTIONS if macro else FUNCTIONS),
            "ATAN",
            *(() if macro else ("EXISTS",)),
        }
        self.operators = {*(MACRO_OPERATORS if macro else OPERATORS)}
        self.open: list[int] = []
        for begin, _ in self.motion_before:
            if text[begin] == "[":
                self.open.append(begin)
            elif text[begin] == "]" and self.open:
                self.open.pop()

    def fault(
        self, code: str, message: str, begin: int | None = None, end: int = 0, hint: str = ""
    ) -> GcodeError:
        """An error at a part of the text, or where it stopped making sense."""
        begin = min(self.at, len(self.text) - 1) if begin is None else begin
        first = self.columns[begin]
        length = self.columns[end - 1] + 1 - first if end > begin else 1
        return fault(code, message, column=first + 1, length=length, hint=hint)

    def last(self, back: int = 1) -> str:
        """A token before the place; empty where there is none."""
        return (
            self.text[slice(*self.motion_before[-back])] if len(self.motion_before) >= back else ""
        )

    def run(self) -> tuple[int, int]:
        """The letters about the place."""
        begin = self.at
        while begin > 0 and _RUN.fullmatch(self.text[begin - 1]):
            begin -= 1
        found = _RUN.match(self.text, begin)
        return (begin, found.end()) if found else (self.at, self.at)

    def describe(self) -> GcodeError:
        """Sort the fault by what was wanted; behind numbers and brackets the grammar answers for
        all places that they can stand in.
        """
        if not self.open and (refused := self._spline_word()):
            return refused
        if self.char == "(" and not re.match(r"\([^()]*\)", self.text[self.at :]):
            return self._bad_comment()
        if self.char == ")":
            return self.fault("comment-not-open", "a ) without a ( before it")
        if self.wanted and self.wanted <= {"LEFT", "SLASH"}:
            return self._argument()
        if self.last(2).endswith("EXISTS") and self.last() == "[":
            return self.fault(
                "exists-parameter",
                "EXISTS asks for a parameter",
                *self.motion_before[-1],
                "write EXISTS[#<name>]",
            )
        if self.last() == "THEN" and "HASH" in self.wanted:
            return self.fault(
                "assignment-missing",
                "THEN is followed by no assignment",
                *self.motion_before[-1],
                "such as IF [#1 EQ 0] THEN #1=5",
            )
        if self.last() == "#":
            return self._parameter()
        if self.last() == "O":
            return self._label()
        if "NUMBER" in self.wanted and not self.wanted & {"LETTER", "RIGHT"}:
            return self._value()
        if self.open:
            return self._operator()
        if (
            self.macro
            and re.match(r"/?(?:N[0-9]+)?(?:IF|WHILE)\[", self.text)
            and not re.search("GOTO|THEN|DO", self.text[: self.at])
        ):
            return self._continuation()
        if not self.macro and re.match(r"/?(?:N[0-9]+)?O", self.text):
            said = any(self.text[slice(*span)] in _O_KEYWORDS for span in self.motion_before)
            return self._after_all() if said or "PLAIN" not in self.wanted else self._keyword()
        if "EQUAL" in self.wanted and "LETTER" not in self.wanted:
            return self._assignment()
        if "LETTER" not in self.wanted:
            return self._after_all()
        return self._line()

    def _spline_word(self) -> GcodeError | None:
        """A word of Siemens' that has nothing like it here."""
        begin, _ = self.run()
        word = next((word for word in _SPLINE_WORDS if self.text.startswith(word, begin)), None)
        if word is None:
            return None
        return self.fault(
            "code-not-supported",
            f"{word} is not supported",
            begin,
            begin + len(word),
            "of Siemens' splines there is BSPLINE",
        )

    def _bad_comment(self) -> GcodeError:
        """A ( that opens no comment: it is never closed, or another stands inside."""
        closing, nested = self.text.find(")", self.at + 1), self.text.find("(", self.at + 1)
        if nested != -1 and (closing == -1 or nested < closing):
            return self.fault(
                "comment-nested",
                "a ( inside a comment",
                nested,
                hint="comments do not nest; use other brackets inside",
            )
        return self.fault("comment-not-closed", "this comment is never closed", hint="add a )")

    def _argument(self) -> GcodeError:
        """A [ or the / of ATAN is missing after a function or a keyword."""
        begin, end = self.motion_before[-1]
        word = self.text[begin:end]
        if self.wanted == {"SLASH"}:
            return self.fault(
                "arctangent-second", "ATAN needs two arguments", hint="write ATAN[y]/[x]"
            )
        if word == "/":
            return self.fault(
                "bracket-missing",
                "the second argument of ATAN must stand in [ ]",
                begin,
                end,
                "write ATAN[y]/[x]",
            )
        keywords = _MACRO_KEYWORDS if self.macro else _O_KEYWORDS
        while word not in self.machine_codes and word not in keywords and len(word) > 1:
            begin, word = begin + 1, word[1:]
        run = begin, self.run()[1]
        if run[1] > end:
            return (
                self._unknown_keyword(run, keywords)
                if word in keywords
                else self._unknown_function(run)
            )
        hint = "( ) is a comment" if self.char == "(" else f"write {word}[..]"
        return self.fault(
            "bracket-missing", f"what belongs to {word} must stand in [ ]", begin, end, hint
        )

    def _parameter(self) -> GcodeError:
        """Nothing useful after a #."""
        begin = self.motion_before[-1][0]
        if self.char == "<":
            if self.macro:
                return self.fault(
                    "syntax-not-in-dialect", "named parameters are not in this dialect", begin
                )
            return self._bad_name(begin)
        if found := _RUN.match(self.text, self.at):
            hint = f"write #<{found[0].lower()}> for a named one"
            return self.fault(
                "parameter-number-missing",
                "a number is missing after #",
                begin,
                found.end(),
                "" if self.macro else hint,
            )
        return self.fault(
            "parameter-number-missing",
            "a number is missing after #",
            begin,
            hint="such as #100, or #[#1+1]",
        )

    def _bad_name(self, begin: int) -> GcodeError:
        if self.text.startswith("<>", self.at):
            return self.fault("name-empty", "there is no name between < and >", begin, self.at + 2)
        return self.fault("name-not-closed", "this name is never closed", begin, hint="add a >")

    def _label(self) -> GcodeError:
        begin = self.motion_before[-1][0]
        if self.char == "<":
            if self.macro:
                return self.fault(
                    "syntax-not-in-dialect", "named programs are not in this dialect", begin
                )
            return self._bad_name(begin)
        hint = "such as O1234" if self.macro else "such as o100 or o<name>"
        return self.fault("label-missing", "a number is missing after O", begin, hint=hint)

    def _value(self) -> GcodeError:
        """A number, or what stands for one, is missing."""
        last = self.last()
        begin, end = self.motion_before[-1]
        found = _RUN.match(self.text, self.at)
        inside = bool(self.open) or "=" in self.text[: self.at]
        if last in ("+", "-") and self.char and self.char in "+-" and self._is_value_sign():
            return self._of_word("number-malformed", begin, self.at + 1)
        if _RUN.fullmatch(last) and (unknown := self._unknown_word(begin)):
            return unknown
        if found:
            run = self.run()
            if self.text[found.end() : found.end() + 1] == "[" and len(found[0]) > 1:
                return self._unknown_function((self.at, found.end()))
            if inside and run[0] < self.at:
                return self._unknown_operator(run)
            if inside and found[0] not in self.operators:
                hint = "" if self.macro else f"#<{found[0].lower()}> is the parameter of that name"
                return self.fault(
                    "value-unknown", f"{found[0]} has no value", self.at, found.end(), hint
                )
        if self.char == "=":
            if last == "=":
                return self.fault("equals-place", "two =", hint="EQ compares, inside [ ]")
            return self.fault(
                "equals-place", f"a = after {last}", hint=f"write {last} and its number, without ="
            )
        if self.char == "*" and last == "*":
            return self.fault(
                "operator-unknown",
                "there is no operator ** here",
                begin,
                self.at + 1,
                "multiply, or use EXP and LN",
            )
        if self.char == "(" and self.open:
            return self.fault(
                "comment-place", "a comment can't stand inside an expression", hint="use [ ] there"
            )
        return self._missing(begin, end)

    def _is_value_sign(self) -> bool:
        """Whether the sign before the place belongs to a number, and does not stand between two."""
        before = self.last(2)
        return (
            not before
            or before in ("=", "[", "*", "/", "**")
            or before.endswith("=")
            or bool(_RUN.fullmatch(before))
        )

    def _missing(self, begin: int, end: int) -> GcodeError:
        last = self.text[begin:end]
        if last == "[":
            what = (
                "there is nothing between the brackets"
                if self.char == "]"
                else "a value is missing after the ["
            )
            return self.fault("value-missing", what, begin)
        if self.open or "=" in self.text[: self.at]:
            return self.fault(
                "value-missing",
                f"a value is missing after {last}",
                begin,
                end,
                "a number, a parameter or [..]",
            )
        return self._of_word("number-missing", begin, end)

    def _of_word(self, code: str, begin: int, end: int) -> GcodeError:
        """An error at the letter of a word whose number is missing or has two signs, or from
        ``begin`` on where no letter stands.
        """
        found = None if self.open else re.search(r"([A-Z])[-+]*$", self.text[: self.at])
        if code == "number-malformed":
            message = f"the number after {found[1]} has two signs" if found else "two signs"
            return self.fault(code, message, *((found.start(), 0) if found else (begin, end)))
        name = found[1] if found else self.text[begin:end]
        hint = (
            "( ) is a comment; use [ ] for expressions"
            if self.char == "("
            else f"write {name} and its number, such as {name}10"
        )
        return self.fault(
            code,
            f"a number is missing after {name}",
            *((found.start(), 0) if found else (begin, end)),
            hint,
        )

    def _unknown_word(self, begin: int) -> GcodeError | None:
        """Letters that look like a keyword: a slip, another dialect's, or one that stands alone."""
        found = _RUN.match(self.text, begin)
        run = found[0] if found else ""
        if len(run) < 2 or self.open:
            return None
        place = begin, begin + len(run)
        follow = self.text[place[1] : place[1] + 1]
        if run in self.machine_codes and follow == "[":
            return self.fault(
                "letter-missing", f"{run} without a letter before it", *place, f"such as X{run}[..]"
            )
        if run in ("SD", "PL", "PW"):
            return self.fault(
                "number-missing", f"a = is missing after {run}", *place, f"such as {run}=3"
            )
        if self.macro:
            if "=" in self.text[:begin] and (near := _near(run, self.operators)):
                return self.fault("operator-unknown", f"there is no operator {run}", *place, near)
            return self._misplaced_keyword(run, place)
        if run in _MACRO_KEYWORDS and follow and follow in "[#0123456789":
            hint = "in RS274/NGC it is an O-word: o100 if [..]; FANUC's macros need --dialect fanuc"
            return self.fault(
                "syntax-not-in-dialect",
                f"{run} without an O-word is not in this dialect",
                *place,
                hint,
            )
        if run in _O_KEYWORDS:
            return self.fault(
                "label-missing",
                f"{run} needs an O and a label before it",
                *place,
                f"such as o100 {run.lower()}",
            )
        return self._unknown_keyword(place, ("BSPLINE",)) if _near(run, ("BSPLINE",)) else None

    def _misplaced_keyword(self, run: str, place: tuple[int, int]) -> GcodeError | None:
        """One of FANUC's that lacks what belongs to it, or is spelt wrong."""
        if run == "THEN":
            return self.fault(
                "keyword-place", "THEN without IF", *place, "such as IF [#1 EQ 0] THEN #1=5"
            )
        if run in _MACRO_KEYWORDS:
            return self.fault(
                "number-missing", f"a number is missing after {run}", *place, f"such as {run} 1"
            )
        return (
            self._unknown_keyword(place, _MACRO_KEYWORDS) if _near(run, _MACRO_KEYWORDS) else None
        )

    def _unknown_keyword(self, run: tuple[int, int], keywords: Iterable[str]) -> GcodeError:
        name = self.text[slice(*run)]
        return self.fault("keyword-unknown", f"{name} is unknown", *run, _near(name, keywords))

    def _unknown_function(self, run: tuple[int, int]) -> GcodeError:
        name = self.text[slice(*run)]
        return self.fault(
            "function-unknown",
            f"there is no function {name}",
            *run,
            _near(name, self.machine_codes),
        )

    def _unknown_operator(self, run: tuple[int, int]) -> GcodeError:
        name = self.text[slice(*run)]
        return self.fault(
            "operator-unknown", f"there is no operator {name}", *run, _near(name, self.operators)
        )

    def _operator(self) -> GcodeError:
        """Inside brackets, behind a value."""
        char, begin = self.char, self.open[-1]
        if not char or char == ";":
            return self.fault("bracket-not-closed", "this [ is never closed", begin, hint="add a ]")
        if char == "=":
            return self.fault("equals-place", "= does not compare", hint="use EQ")
        if char == "(":
            return self.fault(
                "comment-place", "a comment can't stand inside an expression", hint="use [ ] there"
            )
        if char in _DIGITS and re.fullmatch("[0-9.]+", self.last()):
            return self.fault("number-malformed", "this number has two decimal points")
        if char in "[#" or char in _DIGITS:
            return self.fault(
                "operator-missing",
                "an operator is missing between two values",
                hint="such as + or *",
            )
        if char in _SIGNS:
            other = _SIGNS[char]
            hint = f"write {other}" if other in self.operators else ""
            return self.fault("operator-unknown", f"there is no operator {char}", hint=hint)
        if char in "*" and self.macro:
            return self.fault(
                "operator-unknown",
                "there is no operator ** here",
                hint="multiply, or use EXP and LN",
            )
        if _RUN.match(char):
            run = self.run()
            if self.text[slice(*run)] in self.machine_codes:
                return self.fault(
                    "operator-missing",
                    "an operator is missing between two values",
                    hint="such as + or *",
                )
            if run[1] - run[0] == 1 and "]" not in self.text[self.at :]:
                return self.fault(
                    "bracket-not-closed",
                    "this [ is never closed",
                    begin,
                    hint=f"add a ] before {char}",
                )
            if char == "E" and self.text[self.at - 1] in _DIGITS:
                return self.fault(
                    "operator-unknown", "numbers have no exponent here", hint="write 1000, or 10**3"
                )
            return self._unknown_operator(run)
        return self.fault("character-unknown", f"the character {_shown(char)} has no meaning here")

    def _keyword(self) -> GcodeError:
        """After the label of an O-word."""
        found = _RUN.match(self.text, self.at)
        label = self.text[self.text.index("O") : self.at].lower()
        near = _near(found[0], _O_KEYWORDS) if found else ""
        hint = "one of sub, endsub, call, return, if, elseif, else, endif, while, endwhile, do, repeat, endrepeat, break, continue"
        if not self.char or self.char in ";(":
            return self.fault(
                "keyword-missing", f"{label} says nothing", self.text.index("O"), self.at, hint
            )
        end = found.end() if found else self.at + 1
        if near:
            return self.fault(
                "keyword-unknown", f"{self.text[self.at : end]} is unknown", self.at, end, near
            )
        return self.fault(
            "keyword-missing", f"{label} is not followed by what it controls", self.at, end, hint
        )

    def _assignment(self) -> GcodeError:
        """After a parameter that stands by itself."""
        begin = self.text.rindex("#", 0, self.at)
        while begin and self.text[begin - 1] == "#":
            begin -= 1
        name = self.text[begin : self.at].lower()
        return self.fault(
            "assignment-missing",
            f"{name} stands without a letter or a value",
            begin,
            self.at,
            f"{name}=5 sets it, X{name} uses it",
        )

    def _continuation(self) -> GcodeError:
        """After the condition of FANUC's IF or WHILE."""
        wanted = "DO and a number" if "WHILE[" in self.text[: self.at] else "GOTO or THEN"
        message = f"{wanted} is missing after the condition"
        run = self.run()
        near = _near(self.text[slice(*run)], _MACRO_KEYWORDS)
        return (
            self.fault("keyword-missing", message, *run, near)
            if near
            else self.fault("keyword-missing", message)
        )

    def _after_all(self) -> GcodeError:
        """After the end of a line that takes no more."""
        if (
            self.macro
            and (found := re.match(r"(?:N[0-9]+)?(O[0-9]+)([A-Z]+)", self.text))
            and found[2] in _O_KEYWORDS
        ):
            hint = "FANUC has IF [..] GOTO 10, WHILE [..] DO1 and M98 P100"
            return self.fault(
                "syntax-not-in-dialect",
                "O-words with a keyword are not in this dialect",
                found.start(1),
                found.end(),
                hint,
            )
        if self.text.startswith("%"):
            return self.fault("percent-place", "a % must stand alone in its line")
        if (
            self.char
            and self.char in "#-+.0123456789"
            and re.search("CALL|RETURN|ENDSUB", self.text)
        ):
            return self.fault(
                "bracket-missing", "values must stand in [ ] here", hint="such as o100 call [1] [2]"
            )
        if self.char == "]":
            return self.fault("bracket-not-open", "a ] without a [ before it")
        if self.char and self.char in "+-*/" and "GOTO" in self.text:
            return self.fault(
                "expression-without-brackets",
                "an expression must stand in [ ]",
                hint="such as GOTO[#1+10]",
            )
        return self.fault(
            "text-after-control",
            "nothing may follow here but a comment",
            hint="write it in the next line",
        )

    def _line(self) -> GcodeError:
        """Between the words of a line."""
        char, last = self.char, self.last()
        plain = self.text[self.at - 1] in _DIGITS and self.last(2) != "#"
        letter = (
            next((name for name in (self.last(2), self.last(3)) if _RUN.fullmatch(name)), "")[-1:]
            if plain
            else ""
        )
        if char == "/" and (
            not last or self.text[self.at + 1 : self.at + 2] not in ("#", "[", *_DIGITS)
        ):
            return self.fault(
                "block-delete-place", "a / for block delete must stand first in its line"
            )
        if char == "%":
            return self.fault("percent-place", "a % must stand alone in its line")
        if char and char in _DIGITS and letter:
            return self.fault(
                "number-malformed", f"the number after {letter} has two decimal points"
            )
        if char and char in "+-" and letter:
            hint = "write a sum in [ ], such as X[1+2]"
            return self.fault(
                "number-malformed", f"the number after {letter} goes on with a {char!r}", hint=hint
            )
        if char and char in "+-*/" and last:
            return self.fault(
                "expression-without-brackets",
                f"a {char} outside of brackets",
                hint="expressions stand in [ ], such as X[#1+2]",
            )
        if char == "]":
            return self.fault("bracket-not-open", "a ] without a [ before it")
        if char == "=":
            hint = "an assignment begins with #, such as #1=5"
            return self.fault("equals-place", "a = without a parameter before it", hint=hint)
        if char and char in "[+-.0123456789":
            what = "an expression" if char == "[" else "a number"
            hint = (
                "an assignment begins with #, such as #1=5"
                if "=" in self.text
                else "a word is a letter and a number, such as X10"
            )
            return self.fault("letter-missing", f"{what} without a letter before it", hint=hint)
        return self.fault("character-unknown", f"the character {_shown(char)} has no meaning here")


def _near(name: str, known: Iterable[str]) -> str:
    """A hint, where something known looks alike."""
    near = difflib.get_close_matches(name, sorted(known), 1)
    return f"did you mean {near[0]}?" if near else ""
