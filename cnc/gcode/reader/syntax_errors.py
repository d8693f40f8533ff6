"""Descriptions of syntax errors for a machinist.

The grammar reports the place at which a line stopped making sense, and the tokens that it would
have accepted there. These tokens classify the error; the characters around the place name it.
"""

from __future__ import annotations

import difflib
import re
import string
import unicodedata
from bisect import bisect_left
from collections.abc import Iterable

from cnc.gcode.reader.expressions import FUNCTIONS, MACRO_FUNCTIONS, MACRO_OPERATORS, OPERATORS
from cnc.gcode.reader.words import fault
from cnc.model.diagnostics import Fix, GcodeError

# The place in a line at which the grammar stopped, for the functions that describe the error.

O_KEYWORDS = (
    "SUB",
    "ENDSUB",
    "CALL",
    "RETURN",
    "IF",
    "ELSEIF",
    "ELSE",
    "ENDIF",
    "WHILE",
    "ENDWHILE",
    "DO",
    "REPEAT",
    "ENDREPEAT",
    "BREAK",
    "CONTINUE",
)
MACRO_KEYWORDS = ("GOTO", "IF", "THEN", "WHILE", "DO", "END")
_ASCII = 128
_TYPOGRAPHIC = {
    "\u2212": "a minus sign (-)",
    "\u2010": "a minus sign (-)",
    "\u2011": "a minus sign (-)",
    "\u2012": "a minus sign (-)",
    "\u2013": "a minus sign (-)",
    "\u2014": "a minus sign (-)",
    "\u00a0": "a plain blank",
    "\u2009": "a plain blank",
    "\u202f": "a plain blank",
    "\u3000": "a plain blank",
    "\u200b": "nothing: the character is invisible",
    "\ufeff": "nothing: the character is invisible",
    "\u00ad": "nothing: the character is invisible",
    "\u2018": "a comment in ( )",
    "\u2019": "a comment in ( )",
    "\u201c": "a comment in ( )",
    "\u201d": "a comment in ( )",
    "\u00d7": "a * in an expression",
    "\uff0e": "a decimal point (.)",
    "\u00b7": "a decimal point (.)",
    "\uff08": "a ( with its )",
    "\uff09": "a ) with its (",
}
"""Characters of word processors that stand for one of G-code."""
_MEANT = {"a minus": "-", "a plain": " ", "nothing": "", "a decimal": "."}
_PLAIN = {
    char: plain
    for char, meaning in _TYPOGRAPHIC.items()
    for begin, plain in _MEANT.items()
    if meaning.startswith(begin)
}
"""The character that is meant, where it is certain."""
DIGITS = "0123456789."
LETTERS = re.compile(r"[A-Z]+")

_PIECE = re.compile(r"\([^()]*\)|[(;].*|[ \t]+|[^ \t(;]+", re.DOTALL)
_CAPITALS = str.maketrans(string.ascii_lowercase, string.ascii_uppercase)
_TOKEN = re.compile(r"\([^()]*\)|(?:SD|PL|PW|[ABC]3)=|[A-Z]+|[0-9.]+|\*\*|<[^<>]*>|.")


def squeeze(text: str) -> tuple[str, list[int]]:
    """Remove blanks and make capitals, except in comments.

    Returns:
        The text, and the position in the line of each of its characters and of the line's end.
    """
    kept: list[str] = []
    columns: list[int] = []
    for piece in _PIECE.finditer(text):
        part = piece[0]
        if part[0] in " \t":
            continue
        kept.append(part if part[0] in "(;" else part.translate(_CAPITALS))
        columns.extend(range(*piece.span()))
    columns.append(columns[-1] + 1 if columns else len(text))
    return "".join(kept), columns


class ErrorContext:
    """The place in a line at which the grammar stopped.

    Attributes:
        text: The line without blanks.
        columns: Position in the line, from 0, of each character of ``text`` and of its end.
        macro: Whether the language is FANUC's macro B.
        at: Position in ``text`` at which the grammar stopped.
        char: The character there; empty at the end of the line.
        wanted: Names of the tokens that the grammar would have accepted.
        before: Begin and end of each token before the place, comments left out.
        functions: Names of functions.
        operators: Names of operators.
        open: Positions of the brackets that are open at the place.
    """

    def __init__(self, line: str, place: int, wanted: frozenset[str], *, macro: bool) -> None:
        """Create a context.

        Args:
            line: The line.
            place: Position at which the grammar stopped.
            wanted: Names of the tokens that it would have accepted there.
            macro: Whether the language is FANUC's macro B.
        """
        text, columns = squeeze(line)
        self.text, self.macro = text, macro
        self.at = bisect_left(columns, place) if place < len(line.rstrip(" \t")) else len(text)
        self.columns = columns
        self.char = text[self.at : self.at + 1]
        self.wanted = wanted
        self.before = [
            match.span()
            for match in _TOKEN.finditer(text[: self.at])
            if not match[0].startswith("(")
        ]
        self.functions = {
            *(MACRO_FUNCTIONS if macro else FUNCTIONS),
            "ATAN",
            *(() if macro else ("EXISTS",)),
        }
        self.operators = {*(MACRO_OPERATORS if macro else OPERATORS)}
        self.open: list[int] = []
        for begin, _ in self.before:
            if text[begin] == "[":
                self.open.append(begin)
            elif text[begin] == "]" and self.open:
                self.open.pop()

    def fault(
        self,
        code: str,
        message: str,
        begin: int | None = None,
        end: int = 0,
        hint: str = "",
        fix: tuple[str, str] | None = None,
    ) -> GcodeError:
        """Return an error.

        Args:
            code: Error code.
            message: Message.
            begin: Position of the faulty part; by default the place at which the grammar stopped.
            end: End of the faulty part; by default it is one character long.
            hint: Hint.
            fix: Title of the repair, and the text in place of the faulty part.
        """
        begin = min(self.at, len(self.text) - 1) if begin is None else begin
        first = self.columns[begin]
        length = self.columns[end - 1] + 1 - first if end > begin else 1
        repair = fix and Fix.replace(fix[0], first + 1, length, fix[1])
        return fault(code, message, column=first + 1, length=length, hint=hint, fix=repair or None)

    def last(self, back: int = 1) -> str:
        """Return a token before the place, the last by default; empty if there is none."""
        return self.text[slice(*self.before[-back])] if len(self.before) >= back else ""

    def letters_around(self) -> tuple[int, int]:
        """Return begin and end of the letters around the place."""
        begin = self.at
        while begin > 0 and LETTERS.fullmatch(self.text[begin - 1]):
            begin -= 1
        match = LETTERS.match(self.text, begin)
        return (begin, match.end()) if match else (self.at, self.at)

    def unknown_character(self) -> GcodeError:
        """Return the error for a character that the language does not have."""
        char = self.char
        if char == "," and self.text[self.at + 1 : self.at + 2].isdigit():
            message, hint = "a decimal comma is not G-code", "write a decimal point"
            return self.fault("character-unknown", message, hint=hint, fix=(hint, "."))
        message, hint = about_character(char)
        fix = (hint, _PLAIN[char]) if char in _PLAIN else None
        return self.fault("character-unknown", message, hint=hint, fix=fix)


def about_character(char: str) -> tuple[str, str]:
    """Return the message and the hint for a character that G-code does not have."""
    if ord(char) < _ASCII:
        return f"the character {char!r} has no meaning here", ""
    name = unicodedata.name(char, "").lower()
    shown = f"U+{ord(char):04X}{f', {name}' if name else ''}"
    if char.isprintable():
        shown = f"'{char}' ({shown})"
    meant = _TYPOGRAPHIC.get(char)
    hint = f"write {meant}" if meant else "the word processor or web page may have changed it"
    return f"the character {shown} has no meaning here", hint


def near_hint(name: str, names: Iterable[str]) -> str:
    """Return a hint at a known name of similar spelling; empty if there is none."""
    near = difflib.get_close_matches(name, sorted(names), 1)
    return f"did you mean {near[0]}?" if near else ""


# Errors of names: keywords, functions, operators and words that are unknown or misplaced.

_LETTER_O = re.compile(r"([GM])(O+)(?![BT])")


def unknown_word(context: ErrorContext, begin: int) -> GcodeError | None:
    """Return the error of letters that look like a keyword; None if they do not.

    The keyword is misspelt, of another dialect, or lacks its other parts.
    """
    match = LETTERS.match(context.text, begin)
    run = match[0] if match else ""
    if len(run) < 2 or context.open:
        return None
    place = begin, begin + len(run)
    follow = context.text[place[1] : place[1] + 1]
    if run in context.functions and follow == "[":
        return context.fault(
            "letter-missing", f"{run} without a letter before it", *place, f"such as X{run}[..]"
        )
    if run in ("SD", "PL", "PW"):
        return context.fault(
            "number-missing", f"a = is missing after {run}", *place, f"such as {run}=3"
        )
    if context.macro:
        if "=" in context.text[:begin] and (near := near_hint(run, context.operators)):
            return context.fault("operator-unknown", f"there is no operator {run}", *place, near)
        return misplaced_keyword(context, run, place)
    if run in MACRO_KEYWORDS and follow and follow in "[#0123456789":
        hint = "in RS274/NGC it is an O-word: o100 if [..]; FANUC's macros need --dialect fanuc"
        return context.fault(
            "syntax-not-in-dialect",
            f"{run} without an O-word is not in this dialect",
            *place,
            hint,
        )
    if run in O_KEYWORDS:
        return context.fault(
            "label-missing",
            f"{run} needs an O and a label before it",
            *place,
            f"such as o100 {run.lower()}",
        )
    return unknown_keyword(context, place, ("BSPLINE",)) if near_hint(run, ("BSPLINE",)) else None


def misplaced_keyword(context: ErrorContext, run: str, place: tuple[int, int]) -> GcodeError | None:
    """Return the error of a keyword of FANUC that is misspelt or lacks its other parts."""
    if run == "THEN":
        return context.fault(
            "keyword-place", "THEN without IF", *place, "such as IF [#1 EQ 0] THEN #1=5"
        )
    if run in MACRO_KEYWORDS:
        return context.fault(
            "number-missing", f"a number is missing after {run}", *place, f"such as {run} 1"
        )
    return (
        unknown_keyword(context, place, MACRO_KEYWORDS) if near_hint(run, MACRO_KEYWORDS) else None
    )


def unknown_keyword(
    context: ErrorContext, run: tuple[int, int], keywords: Iterable[str]
) -> GcodeError:
    """Return the error of an unknown keyword, with a hint at one of ``keywords``."""
    name = context.text[slice(*run)]
    hint = letter_o_hint(name) or near_hint(name, keywords)
    return context.fault("keyword-unknown", f"{name} is unknown", *run, hint)


def letter_o_hint(letters: str) -> str:
    """Return a hint for a code that is written with the letter O, such as GOO; else empty."""
    match = _LETTER_O.match(letters)
    if match is None:
        return ""
    return f"write zeros after {match[1]}, not the letter O: {match[1]}{'0' * len(match[2])}"


def unknown_function(context: ErrorContext, run: tuple[int, int]) -> GcodeError:
    """Return the error of an unknown function."""
    name = context.text[slice(*run)]
    return context.fault(
        "function-unknown", f"there is no function {name}", *run, near_hint(name, context.functions)
    )


def unknown_operator(context: ErrorContext, run: tuple[int, int]) -> GcodeError:
    """Return the error of an unknown operator."""
    name = context.text[slice(*run)]
    return context.fault(
        "operator-unknown", f"there is no operator {name}", *run, near_hint(name, context.operators)
    )


def o_word_keyword(context: ErrorContext) -> GcodeError:
    """Return the error after the label of an O-word."""
    match = LETTERS.match(context.text, context.at)
    label = context.text[context.text.index("O") : context.at].lower()
    near = near_hint(match[0], O_KEYWORDS) if match else ""
    hint = f"one of {', '.join(O_KEYWORDS).lower()}"
    if not context.char or context.char in ";(":
        return context.fault(
            "keyword-missing",
            f"a keyword is missing after {label}",
            context.text.index("O"),
            context.at,
            hint,
        )
    end = match.end() if match else context.at + 1
    if near:
        return context.fault(
            "keyword-unknown", f"{context.text[context.at : end]} is unknown", context.at, end, near
        )
    return context.fault(
        "keyword-missing", f"a keyword is missing after {label}", context.at, end, hint
    )


def continuation(context: ErrorContext) -> GcodeError:
    """Return the error after the condition of FANUC's IF or WHILE."""
    wanted = "DO and a number" if "WHILE[" in context.text[: context.at] else "GOTO or THEN"
    message = f"{wanted} is missing after the condition"
    run = context.letters_around()
    near = near_hint(context.text[slice(*run)], MACRO_KEYWORDS)
    return (
        context.fault("keyword-missing", message, *run, near)
        if near
        else context.fault("keyword-missing", message)
    )


# Errors inside expressions: brackets, values, parameters, operators.

_OPERATOR_OF = {"<": "LT", ">": "GT", "!": "NE", "&": "AND", "|": "OR", "^": "**", "%": "MOD"}
"""The operator for a sign of other languages."""


def argument(context: ErrorContext) -> GcodeError:
    """Return the error of a missing [ after a function or a keyword, or a missing / of ATAN."""
    begin, end = context.before[-1]
    word = context.text[begin:end]
    if context.wanted == {"SLASH"}:
        return context.fault(
            "arctangent-second", "ATAN needs two arguments", hint="write ATAN[y]/[x]"
        )
    if word == "/":
        return context.fault(
            "bracket-missing",
            "the second argument of ATAN must stand in [ ]",
            begin,
            end,
            "write ATAN[y]/[x]",
        )
    keywords = MACRO_KEYWORDS if context.macro else O_KEYWORDS
    while word not in context.functions and word not in keywords and len(word) > 1:
        begin, word = begin + 1, word[1:]
    run = begin, context.letters_around()[1]
    if run[1] > end:
        return (
            unknown_keyword(context, run, keywords)
            if word in keywords
            else unknown_function(context, run)
        )
    hint = "( ) is a comment" if context.char == "(" else f"write {word}[..]"
    return context.fault(
        "bracket-missing", f"the value of {word} must stand in [ ]", begin, end, hint
    )


def parameter(context: ErrorContext) -> GcodeError:
    """Return the error of a # without a number or a name."""
    begin = context.before[-1][0]
    if context.char == "<":
        if context.macro:
            return context.fault(
                "syntax-not-in-dialect", "named parameters are not in this dialect", begin
            )
        return bad_name(context, begin)
    if match := LETTERS.match(context.text, context.at):
        hint = f"write #<{match[0].lower()}> for a named parameter"
        return context.fault(
            "parameter-number-missing",
            "a number is missing after #",
            begin,
            match.end(),
            "" if context.macro else hint,
        )
    return context.fault(
        "parameter-number-missing",
        "a number is missing after #",
        begin,
        hint="such as #100, or #[#1+1]",
    )


def bad_name(context: ErrorContext, begin: int) -> GcodeError:
    """Return the error of a name that is empty or not closed."""
    if context.text.startswith("<>", context.at):
        return context.fault(
            "name-empty", "a name is missing between < and >", begin, context.at + 2
        )
    return context.fault("name-not-closed", "this name is not closed", begin, hint="add a >")


def label(context: ErrorContext) -> GcodeError:
    """Return the error of an O without a number or a name."""
    begin = context.before[-1][0]
    if context.char == "<":
        if context.macro:
            return context.fault(
                "syntax-not-in-dialect", "named programs are not in this dialect", begin
            )
        return bad_name(context, begin)
    hint = "such as O1234" if context.macro else "such as o100 or o<name>"
    return context.fault("label-missing", "a number is missing after O", begin, hint=hint)


def value(context: ErrorContext) -> GcodeError:
    """Return the error of a missing number or value."""
    last = context.last()
    begin, end = context.before[-1]
    match = LETTERS.match(context.text, context.at)
    inside = bool(context.open) or "=" in context.text[: context.at]
    if last in ("+", "-") and context.char and context.char in "+-" and is_value_sign(context):
        return of_word(context, "number-malformed", begin, context.at + 1)
    if LETTERS.fullmatch(last) and (unknown := unknown_word(context, begin)):
        return unknown
    if match:
        run = context.letters_around()
        if context.text[match.end() : match.end() + 1] == "[" and len(match[0]) > 1:
            return unknown_function(context, (context.at, match.end()))
        if inside and run[0] < context.at:
            return unknown_operator(context, run)
        if inside and match[0] not in context.operators:
            hint = "" if context.macro else f"#<{match[0].lower()}> is the parameter of that name"
            return context.fault(
                "value-unknown", f"{match[0]} has no value", context.at, match.end(), hint
            )
    return _misplaced_sign(context) or missing(context, begin, end)


def _misplaced_sign(context: ErrorContext) -> GcodeError | None:
    """Return the error of =, * or a comment in the place of a value; None for another character."""
    last, begin = context.last(), context.before[-1][0]
    if refused := siemens_address(context):
        return refused
    if context.char == "=":
        if last == "=":
            return context.fault("equals-place", "two =", hint="compare with EQ, inside [ ]")
        return context.fault(
            "equals-place",
            f"a = after {last}",
            hint=f"write {last} and its number, without =; only SINUMERIK has {last}=",
        )
    if context.char == "*" and last == "*":
        return context.fault(
            "operator-unknown",
            "there is no operator ** here",
            begin,
            context.at + 1,
            "multiply, or use EXP and LN",
        )
    if context.char == "(" and context.open:
        return context.fault(
            "comment-place", "a comment is not allowed inside an expression", hint="use [ ] there"
        )
    return None


def siemens_address(context: ErrorContext) -> GcodeError | None:
    """Return the error of an address of SINUMERIK, such as CR=4 or X=IC(5); None for other text."""
    if context.open:
        return None
    begin, _ = context.letters_around()
    pattern = re.compile(r"([A-Z]{2,}[0-9]*|[A-Z](?==(?:IC|AC|DC)\())=(?!=)")
    match = pattern.match(context.text, begin)
    if match is None or match.end() <= context.at:
        return None
    return context.fault(
        "syntax-not-in-dialect",
        f"{match[1]}= is a word of SINUMERIK",
        begin,
        match.end(),
        "use --dialect siemens for a program of SINUMERIK",
    )


def is_value_sign(context: ErrorContext) -> bool:
    """Return whether the sign before the place belongs to a number, and is not an operator."""
    before = context.last(2)
    return (
        not before
        or before in ("=", "[", "*", "/", "**")
        or before.endswith("=")
        or bool(LETTERS.fullmatch(before))
    )


def missing(context: ErrorContext, begin: int, end: int) -> GcodeError:
    """Return the error of a missing value after the token from ``begin`` to ``end``."""
    last = context.text[begin:end]
    if last == "[":
        message = (
            "there is nothing between the brackets"
            if context.char == "]"
            else "a value is missing after the ["
        )
        return context.fault("value-missing", message, begin)
    if context.open or "=" in context.text[: context.at]:
        return context.fault(
            "value-missing",
            f"a value is missing after {last}",
            begin,
            end,
            "a number, a parameter or [..]",
        )
    return of_word(context, "number-missing", begin, end)


def of_word(context: ErrorContext, code: str, begin: int, end: int) -> GcodeError:
    """Return the error of a word whose number is missing or has two signs.

    It stands at the letter, or at ``begin`` if there is no letter.
    """
    match = None if context.open else re.search(r"([A-Z])[-+]*$", context.text[: context.at])
    if code == "number-malformed":
        message = f"the number after {match[1]} has two signs" if match else "two signs"
        return context.fault(code, message, *((match.start(), 0) if match else (begin, end)))
    name = match[1] if match else context.text[begin:end]
    hint = f"write {name} and its number, such as {name}10"
    if context.char == "(":
        hint = "( ) is a comment; use [ ] for expressions"
    elif zeros := letter_o_hint(context.text[match.start() if match else begin :]):
        hint = zeros
    elif name in "XYZABC" and re.search(r"G(?:28|30)(?![0-9.])", context.text[: context.at]):
        hint = f"G91 G28 {name}0 returns {name} from where it is; firmware of printers reads {name}"
    return context.fault(
        code,
        f"a number is missing after {name}",
        *((match.start(), 0) if match else (begin, end)),
        hint,
    )


def operator(context: ErrorContext) -> GcodeError:
    """Return the error inside brackets, after a value."""
    char, begin = context.char, context.open[-1]
    if not char or char == ";":
        return context.fault("bracket-not-closed", "this [ is not closed", begin, hint="add a ]")
    if char == "=":
        message, hint = "= is not a comparison", "use EQ"
        return context.fault("equals-place", message, hint=hint, fix=("write EQ", "EQ"))
    if char == "(":
        return context.fault(
            "comment-place", "a comment is not allowed inside an expression", hint="use [ ] there"
        )
    if char in DIGITS and re.fullmatch("[0-9.]+", context.last()):
        return context.fault("number-malformed", "this number has two decimal points")
    if char in "[#" or char in DIGITS:
        return context.fault(
            "operator-missing",
            "an operator is missing between two values",
            hint="such as + or *",
        )
    if char in _OPERATOR_OF:
        meant = _OPERATOR_OF[char]
        hint = f"write {meant}" if meant in context.operators else ""
        # Signs of two characters, such as <=, have other meanings.
        alone = context.text[context.at + 1 : context.at + 2] not in ("=", "<", ">", char)
        fix = (hint, meant) if hint and alone else None
        return context.fault("operator-unknown", f"there is no operator {char}", hint=hint, fix=fix)
    if char in "*" and context.macro:
        return context.fault(
            "operator-unknown",
            "there is no operator ** here",
            hint="multiply, or use EXP and LN",
        )
    return _letters(context) if LETTERS.match(char) else context.unknown_character()


def _letters(context: ErrorContext) -> GcodeError:
    """Return the error of letters inside brackets, after a value."""
    char, begin = context.char, context.open[-1]
    run = context.letters_around()
    if context.text[slice(*run)] in context.functions:
        return context.fault(
            "operator-missing",
            "an operator is missing between two values",
            hint="such as + or *",
        )
    if run[1] - run[0] == 1 and "]" not in context.text[context.at :]:
        return context.fault(
            "bracket-not-closed",
            "this [ is not closed",
            begin,
            hint=f"add a ] before {char}",
        )
    if char == "E" and context.text[context.at - 1] in DIGITS:
        return context.fault(
            "operator-unknown", "numbers have no exponent here", hint="write 1000, or 10**3"
        )
    return unknown_operator(context, run)


_ZERO_FOR_O = re.compile(r"[ \t]*0([0-9]{4,5})[ \t]*(?:[(;].*)?", re.DOTALL)
_CHECKSUM = re.compile(r"\*[0-9]{1,3}")
_COMPUTED = re.compile(r"[=#\[]")
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
"""Siemens' words of splines other than the B-spline."""
_COMMENTS = "write ; before a comment, or ( ) around it"
_OF_NO_LANGUAGE = "~`\\{}"
"""Characters that stand in no language of machines."""
_NAMED = {"#": parameter, "O": label}
"""Tokens that need a number or a name after them."""


def describe(context: ErrorContext) -> GcodeError:
    """Classify the error by the tokens that the grammar would have accepted."""
    return foreign_comment(context) or _of_part(context) or _of_line(context)


def foreign_comment(context: ErrorContext) -> GcodeError | None:
    """Return the error of a # before a text, which is a comment elsewhere; None without one."""
    text, columns = context.text, context.columns
    if not re.match(r"#[0-9.]*[A-Z][^=#]*$", text):
        return None
    if not text[1].isalpha() and columns[1] == columns[0] + 1:
        return None
    message = "# does not begin a comment in G-code"
    return context.fault("comment-mark", message, 0, 1, _COMMENTS, ("write ; before it", ";"))


def _of_part(context: ErrorContext) -> GcodeError | None:
    """Return the error of a comment, an expression, a parameter or a label; None otherwise."""
    if context.char and (not context.char.isascii() or context.char in _OF_NO_LANGUAGE):
        return context.unknown_character()
    if not context.open and (refused := spline_word(context)):
        return refused
    if context.char == "(" and not re.match(r"\([^()]*\)", context.text[context.at :]):
        return bad_comment(context)
    if context.char == ")":
        return context.fault("comment-not-open", "a ) without a ( before it")
    if context.wanted and context.wanted <= {"LEFT", "SLASH"}:
        return argument(context)
    if context.last(2).endswith("EXISTS") and context.last() == "[":
        return context.fault(
            "exists-parameter",
            "EXISTS needs a parameter",
            *context.before[-1],
            "write EXISTS[#<name>]",
        )
    if context.last() == "THEN" and "HASH" in context.wanted:
        return context.fault(
            "assignment-missing",
            "an assignment is missing after THEN",
            *context.before[-1],
            "such as IF [#1 EQ 0] THEN #1=5",
        )
    if of_name := _NAMED.get(context.last()):
        return of_name(context)
    if "NUMBER" in context.wanted and not context.wanted & {"LETTER", "RIGHT"}:
        return value(context)
    if context.open:
        return operator(context)
    return None


def _of_line(context: ErrorContext) -> GcodeError:
    """Return the error of a control line, an assignment, or the words of a line."""
    if (
        context.macro
        and re.match(r"/?(?:N[0-9]+)?(?:IF|WHILE)\[", context.text)
        and not re.search("GOTO|THEN|DO", context.text[: context.at])
    ):
        return continuation(context)
    if not context.macro and re.match(r"/?(?:N[0-9]+)?O", context.text):
        has_keyword = any(context.text[slice(*span)] in O_KEYWORDS for span in context.before)
        return (
            after_end(context)
            if has_keyword or "PLAIN" not in context.wanted
            else o_word_keyword(context)
        )
    if "EQUAL" in context.wanted and "LETTER" not in context.wanted:
        return assignment(context)
    if "LETTER" not in context.wanted:
        return after_end(context)
    return between_words(context)


def spline_word(context: ErrorContext) -> GcodeError | None:
    """Return the error of a word of Siemens' splines that is not supported; None otherwise."""
    begin, _ = context.letters_around()
    word = next((word for word in _SPLINE_WORDS if context.text.startswith(word, begin)), None)
    if word is None:
        return None
    return context.fault(
        "code-not-supported",
        f"{word} is not supported",
        begin,
        begin + len(word),
        "of Siemens' splines only BSPLINE is supported",
    )


def bad_comment(context: ErrorContext) -> GcodeError:
    """Return the error of a comment that is not closed or has another one inside."""
    closing, nested = context.text.find(")", context.at + 1), context.text.find("(", context.at + 1)
    if nested != -1 and (closing == -1 or nested < closing):
        return context.fault(
            "comment-nested",
            "a ( inside a comment",
            nested,
            hint="comments do not nest; use other brackets inside",
        )
    return context.fault("comment-not-closed", "this comment is not closed", hint="add a )")


def assignment(context: ErrorContext) -> GcodeError:
    """Return the error of a parameter without a letter before it or = after it."""
    begin = context.text.rindex("#", 0, context.at)
    while begin and context.text[begin - 1] == "#":
        begin -= 1
    name = context.text[begin : context.at].lower()
    return context.fault(
        "assignment-missing",
        f"{name} has no letter before it and no = after it",
        begin,
        context.at,
        f"set it with {name}=5, or use it as in X{name}",
    )


def after_end(context: ErrorContext) -> GcodeError:
    """Return the error after the end of a line that accepts no more."""
    if (
        context.macro
        and (match := re.match(r"(?:N[0-9]+)?(O[0-9]+)([A-Z]+)", context.text))
        and match[2] in O_KEYWORDS
    ):
        hint = "FANUC has IF [..] GOTO 10, WHILE [..] DO1 and M98 P100"
        return context.fault(
            "syntax-not-in-dialect",
            "O-words with a keyword are not in this dialect",
            match.start(1),
            match.end(),
            hint,
        )
    if context.text.startswith("%"):
        return context.fault("percent-place", "a % must stand alone in its line")
    if (
        context.char
        and context.char in "#-+.0123456789"
        and re.search("CALL|RETURN|ENDSUB", context.text)
    ):
        return context.fault(
            "bracket-missing", "values must stand in [ ] here", hint="such as o100 call [1] [2]"
        )
    if context.char == "]":
        return context.fault("bracket-not-open", "a ] without a [ before it")
    if context.char and context.char in "+-*/" and "GOTO" in context.text:
        return context.fault(
            "expression-without-brackets",
            "an expression must stand in [ ]",
            hint="such as GOTO[#1+10]",
        )
    return context.fault(
        "text-after-control",
        "only a comment may follow here",
        hint="write it in the next line",
    )


def between_words(context: ErrorContext) -> GcodeError:
    """Return the error between the words of a line."""
    char, last = context.char, context.last()
    letter = ""
    if context.text[context.at - 1] in DIGITS and context.last(2) != "#":
        names = (name for name in (context.last(2), context.last(3)) if LETTERS.fullmatch(name))
        letter = next(names, "")[-1:]
    if char == "/" and (
        not last or context.text[context.at + 1 : context.at + 2] not in ("#", "[", *DIGITS)
    ):
        message = "a / for block delete must stand first in its line"
        hint = f"// begins no comment: {_COMMENTS}" if "//" in context.text else ""
        return context.fault("block-delete-place", message, hint=hint)
    if char == "%":
        return context.fault("percent-place", "a % must stand alone in its line")
    if char and char in DIGITS and letter:
        return context.fault(
            "number-malformed", f"the number after {letter} has two decimal points"
        )
    if char and char in "+-" and letter:
        hint = "write a sum in [ ], such as X[1+2]"
        return context.fault(
            "number-malformed", f"the number after {letter} continues with {char!r}", hint=hint
        )
    if _CHECKSUM.fullmatch(context.text, context.at) and not _COMPUTED.search(context.text):
        return context.fault(
            "line-checksum",
            f"{context.text[context.at :]} is the checksum of a line sent to a 3D printer",
            context.at,
            len(context.text),
            hint="remove the checksums, or use --dialect marlin",
            fix=("remove the checksum", ""),
        )
    if char and char in "+-*/" and last:
        return context.fault(
            "expression-without-brackets",
            f"a {char} outside of brackets",
            hint="write expressions in [ ], such as X[#1+2]",
        )
    if char == "]":
        return context.fault("bracket-not-open", "a ] without a [ before it")
    if char == "=":
        if (before := context.last(2)) and LETTERS.fullmatch(before):
            name = f"{before}{context.last()}"
            hint = f"{name}= is a word of SINUMERIK: use --dialect siemens; else write #{name}"
            return context.fault("equals-place", f"a = after {name}", hint=hint)
        hint = "an assignment begins with #, such as #1=5"
        return context.fault("equals-place", "a = without a parameter before it", hint=hint)
    if char and char in "[+-.0123456789":
        part = "an expression" if char == "[" else "a number"
        hint = (
            "an assignment begins with #, such as #1=5"
            if "=" in context.text
            else "a word is a letter and a number, such as X10"
        )
        fix = None
        if number := _ZERO_FOR_O.fullmatch(context.text):
            hint = f"a program number begins with the letter O, and not with a zero: O{number[1]}"
            fix = ("write the letter O", "O")
        message = f"{part} without a letter before it"
        return context.fault("letter-missing", message, hint=hint, fix=fix)
    return context.unknown_character()
