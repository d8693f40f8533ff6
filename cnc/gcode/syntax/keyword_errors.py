"""Errors of names: keywords, functions, operators and words that are unknown or misplaced."""

from __future__ import annotations

import re
from collections.abc import Iterable

from cnc.gcode.syntax.error_context import (
    LETTERS,
    MACRO_KEYWORDS,
    O_KEYWORDS,
    ErrorContext,
    near_hint,
)
from cnc.model.diagnostics import GcodeError

_LETTER_O = re.compile(r"([GM])(O+)(?![BT])")


def unknown_word(context: ErrorContext, begin: int) -> GcodeError | None:
    """Return the error of letters that look like a keyword; None if they do not.

    The keyword is misspelt, of another dialect, or lacks its other parts.
    """
    found = LETTERS.match(context.text, begin)
    run = found[0] if found else ""
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
    found = _LETTER_O.match(letters)
    if found is None:
        return ""
    return f"write zeros after {found[1]}, not the letter O: {found[1]}{'0' * len(found[2])}"


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
    found = LETTERS.match(context.text, context.at)
    label = context.text[context.text.index("O") : context.at].lower()
    near = near_hint(found[0], O_KEYWORDS) if found else ""
    hint = f"one of {', '.join(O_KEYWORDS).lower()}"
    if not context.char or context.char in ";(":
        return context.fault(
            "keyword-missing",
            f"a keyword is missing after {label}",
            context.text.index("O"),
            context.at,
            hint,
        )
    end = found.end() if found else context.at + 1
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
