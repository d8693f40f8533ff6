"""Errors inside expressions: brackets, values, parameters, operators."""

from __future__ import annotations

import re

from cnc.gcode.syntax.error_context import (
    DIGITS,
    LETTERS,
    MACRO_KEYWORDS,
    O_KEYWORDS,
    ErrorContext,
)
from cnc.gcode.syntax.keyword_errors import (
    letter_o_hint,
    unknown_function,
    unknown_keyword,
    unknown_operator,
    unknown_word,
)
from cnc.model.diagnostics import GcodeError

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
    if found := LETTERS.match(context.text, context.at):
        hint = f"write #<{found[0].lower()}> for a named parameter"
        return context.fault(
            "parameter-number-missing",
            "a number is missing after #",
            begin,
            found.end(),
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
    found = LETTERS.match(context.text, context.at)
    inside = bool(context.open) or "=" in context.text[: context.at]
    if last in ("+", "-") and context.char and context.char in "+-" and is_value_sign(context):
        return of_word(context, "number-malformed", begin, context.at + 1)
    if LETTERS.fullmatch(last) and (unknown := unknown_word(context, begin)):
        return unknown
    if found:
        run = context.letters_around()
        if context.text[found.end() : found.end() + 1] == "[" and len(found[0]) > 1:
            return unknown_function(context, (context.at, found.end()))
        if inside and run[0] < context.at:
            return unknown_operator(context, run)
        if inside and found[0] not in context.operators:
            hint = "" if context.macro else f"#<{found[0].lower()}> is the parameter of that name"
            return context.fault(
                "value-unknown", f"{found[0]} has no value", context.at, found.end(), hint
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
    found = pattern.match(context.text, begin)
    if found is None or found.end() <= context.at:
        return None
    return context.fault(
        "syntax-not-in-dialect",
        f"{found[1]}= is a word of SINUMERIK",
        begin,
        found.end(),
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
    found = None if context.open else re.search(r"([A-Z])[-+]*$", context.text[: context.at])
    if code == "number-malformed":
        message = f"the number after {found[1]} has two signs" if found else "two signs"
        return context.fault(code, message, *((found.start(), 0) if found else (begin, end)))
    name = found[1] if found else context.text[begin:end]
    hint = f"write {name} and its number, such as {name}10"
    if context.char == "(":
        hint = "( ) is a comment; use [ ] for expressions"
    elif zeros := letter_o_hint(context.text[found.start() if found else begin :]):
        hint = zeros
    elif name in "XYZABC" and re.search(r"G(?:28|30)(?![0-9.])", context.text[: context.at]):
        hint = f"G91 G28 {name}0 returns {name} from where it is; firmware of printers reads {name}"
    return context.fault(
        code,
        f"a number is missing after {name}",
        *((found.start(), 0) if found else (begin, end)),
        hint,
    )


def operator(context: ErrorContext) -> GcodeError:
    """Return the error inside brackets, after a value."""
    char, begin = context.char, context.open[-1]
    if not char or char == ";":
        return context.fault("bracket-not-closed", "this [ is not closed", begin, hint="add a ]")
    if char == "=":
        return context.fault("equals-place", "= is not a comparison", hint="use EQ")
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
        other = _OPERATOR_OF[char]
        hint = f"write {other}" if other in context.operators else ""
        return context.fault("operator-unknown", f"there is no operator {char}", hint=hint)
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
