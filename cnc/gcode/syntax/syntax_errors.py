"""Descriptions of syntax errors for a machinist.

The grammar reports the place at which a line stopped making sense, and the tokens that it would
have accepted there. These tokens classify the error; the characters around the place name it.
"""

from __future__ import annotations

import re

from cnc.gcode.syntax.error_context import (
    DIGITS,
    LETTERS,
    O_KEYWORDS,
    ErrorContext,
)
from cnc.gcode.syntax.expression_errors import argument, label, operator, parameter, value
from cnc.gcode.syntax.keyword_errors import continuation, o_word_keyword
from cnc.model.diagnostics import GcodeError

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
    return context.fault("comment-mark", message, 0, 1, _COMMENTS)


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
        and (found := re.match(r"(?:N[0-9]+)?(O[0-9]+)([A-Z]+)", context.text))
        and found[2] in O_KEYWORDS
    ):
        hint = "FANUC has IF [..] GOTO 10, WHILE [..] DO1 and M98 P100"
        return context.fault(
            "syntax-not-in-dialect",
            "O-words with a keyword are not in this dialect",
            found.start(1),
            found.end(),
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
        if number := _ZERO_FOR_O.fullmatch(context.text):
            hint = f"a program number begins with the letter O, and not with a zero: O{number[1]}"
        return context.fault("letter-missing", f"{part} without a letter before it", hint=hint)
    return context.unknown_character()
