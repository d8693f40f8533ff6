"""What is wrong with a line that the grammar does not take, in a machinist's words."""

from __future__ import annotations

import re

from cnc.errors import GcodeError
from cnc.gcode.words import fault

_LETTER = re.compile(r"[A-Za-z]")
_O_WORD = re.compile(r"[ \t/]*(?:[Nn][ \t]*[0-9]+[ \t]*)?[Oo]")


def describe(text: str, at: int) -> GcodeError:
    """The error for a line that stops making sense at ``at`` (from 0)."""
    char, column = text[at], at + 1
    if subprogram := _O_WORD.match(text):
        return fault("not-supported", "O words (subprograms and control flow) are not supported", column=subprogram.end())
    if _LETTER.fullmatch(char):
        return _number_missing(text, at)
    if char in "0123456789.+-":
        letter = _letter_before(text, at)
        if letter and char == ".":
            return fault("number-malformed", f"the number after {letter} has two decimal points", column=column)
        if letter:
            return fault("number-malformed", f"the number after {letter} goes on with a {char!r}", column=column)
        hint = "a word is a letter and a number, such as X10"
        return fault("letter-missing", "a number without a letter before it", column=column, hint=hint)
    if char == "(":
        return _bad_comment(text, at)
    if char == ")":
        return fault("comment-not-open", "a ) without a ( before it", column=column)
    if char == "/":
        return fault("block-delete-place", "a / for block delete must stand first in its line", column=column)
    if char == "%":
        return fault("percent-place", "a % must stand alone in its line", column=column)
    if char in "[]#=<>*":
        return fault("not-supported", f"{char!r}: parameters and expressions are not supported", column=column)
    return fault("character-unknown", f"the character {char!r} has no meaning here", column=column)


def _letter_before(text: str, at: int) -> str:
    """The letter of the word that ends at ``at``, upper-case; empty where no word ends there."""
    word = text[:at].rstrip("0123456789. \t")
    if word.endswith(("+", "-")):
        word = word[:-1].rstrip(" \t")
    return word[-1].upper() if word and _LETTER.fullmatch(word[-1]) else ""


def _number_missing(text: str, at: int) -> GcodeError:
    """A letter that no number follows."""
    letter = text[at].upper()
    follow = text[at + 1 :].lstrip(" \t")
    column = at + 1
    if text[:at].strip(" \t") == "%":
        return fault("percent-place", "a % must stand alone in its line", column=column)
    if follow[:1] in ("#", "["):
        message = f"{follow[0]!r} after {letter}: parameters and expressions are not supported"
        return fault("not-supported", message, column=text.index(follow[0], at) + 1)
    if follow[:1] and follow[0] in "+-" and follow[1:].lstrip(" \t")[:1] in ("+", "-"):
        return fault("number-malformed", f"the number after {letter} has two signs", column=column)
    hint = f"write {letter} and its number, such as {letter}10"
    return fault("number-missing", f"a number is missing after {letter}", column=column, hint=hint)


def _bad_comment(text: str, at: int) -> GcodeError:
    """A ( that opens no comment: it is never closed, or another stands inside."""
    closing, nested = text.find(")", at + 1), text.find("(", at + 1)
    if nested != -1 and (closing == -1 or nested < closing):
        return fault("comment-nested", "a ( inside a comment", column=nested + 1, hint="comments do not nest; use other brackets inside")
    return fault("comment-not-closed", "this comment is never closed", column=at + 1, hint="add a )")
