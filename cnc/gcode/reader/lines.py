"""Lines of text as events, and as the words and items of compiled code."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.reader.tables import Grammar, grammar
from cnc.gcode.syntax.words import MAX_NUMBER
from cnc.kernels.gcode import automaton
from cnc.kernels.gcode import statements as kernel

MAX_LINE = 4096
"""Most characters of a line. RS274 allows 256; a longer line than this is not G-code."""

_TERMINALS = {
    "NUMBER": kernel.DIGITS, "NAME": kernel.NAME, "COMMENT": kernel.REMARK, "TAIL": kernel.REMARK,
    "O": kernel.LETTER_O, "EQUAL": kernel.EQUALS,
    **dict.fromkeys(
        (
            "LETTER", "SIGN", "SLASH", "TIMES", "POWER", "COMPARE", "LOGIC", "FUNCTION", "ATAN",
            "PLAIN", "CONDITION", "CALL", "RESULT",
        ),
        kernel.KEY,
    ),
}  # fmt: skip
_RULES = {
    "word": kernel.WORD, "sign": kernel.SIGN, "block": kernel.BLOCK, "binary": kernel.BINARY,
    "function": kernel.FUNCTION, "arctangent": kernel.ARCTANGENT, "parameter": kernel.INDEX,
    "bracket": kernel.BRACKET, "assignment": kernel.ASSIGN, "oword": kernel.O_WORD,
}  # fmt: skip
_OPERATIONS = {
    "+": kernel.ADD, "-": kernel.SUBTRACT, "*": kernel.MULTIPLY, "/": kernel.DIVIDE,
    "**": kernel.POWER, "MOD": kernel.MODULO,
    "EQ": kernel.EQ, "NE": kernel.NE, "GT": kernel.GT, "GE": kernel.GE, "LT": kernel.LT,
    "LE": kernel.LE, "AND": kernel.AND, "OR": kernel.OR, "XOR": kernel.XOR,
    "ABS": kernel.ABS, "ACOS": kernel.ACOS, "ASIN": kernel.ASIN, "COS": kernel.COS,
    "EXP": kernel.EXP, "FIX": kernel.FIX, "FUP": kernel.FUP, "LN": kernel.LN,
    "ROUND": kernel.ROUND, "SIN": kernel.SIN, "SQRT": kernel.SQRT, "TAN": kernel.TAN,
    "ATAN": kernel.ATAN,
    **{chr(code): code for code in range(ord("A"), ord("Z") + 1)},
}  # fmt: skip
_OF_WORDS = {kernel.WORD, kernel.SIGN, kernel.BLOCK}
"""Meanings of rules of the languages whose expressions the interpreter alone computes."""

Positions = NDArray[np.int32]
_AT_START = np.zeros(1, np.int32)


class Language(NamedTuple):
    """How lines are read.

    Attributes:
        grammar: Name of the grammar.
        joined: Whether no blank may stand inside a word of compiled code.
    """

    grammar: str
    joined: bool = False


NGC, MACRO, KLARTEXT = Language("ngc"), Language("macro"), Language("klartext")


class Reading(NamedTuple):
    """The events of some lines."""

    grammar: Grammar
    events: automaton.Events
    results: automaton.Results


class Sorted(NamedTuple):
    """Lines as words and items."""

    lines: kernel.Lines
    words: kernel.Words
    coded: kernel.Coded


@cache
def classes(grammar_name: str) -> NDArray[np.uint8]:
    """Return the class of each byte in the automaton of a grammar.

    RS274 ignores blanks and case outside of comments. A language that ignores a terminal of blanks
    has names that end at a blank.
    """
    found = np.arange(256).astype(np.uint8)
    found[ord("a") : ord("z") + 1] -= ord("a") - ord("A")
    found[:32] = found[127] = automaton.REFUSED
    if not grammar(grammar_name).tables.ignored.any():
        found[[9, 32]] = automaton.SKIPPED
    else:
        found[9] = 32
    found[128:] = automaton.OTHER
    return found


@cache
def _meaning(language: Language) -> kernel.Meaning:
    found = grammar(language.grammar)
    rules = np.array([_RULES.get(rule, kernel.LEFT_ALONE) for rule in found.rules], np.uint8)
    if language.grammar != "ngc":
        rules[~np.isin(rules, list(_OF_WORDS))] = kernel.LEFT_ALONE
    return kernel.Meaning(
        np.array([_TERMINALS.get(each, kernel.LEFT_ALONE) for each in found.terminals], np.uint8),
        rules,
        np.array([_OPERATIONS.get(text, 0) for text in found.texts], np.uint8),
        found.texts.index("CALL") if "CALL" in found.texts else -1,
        found.terminals.index("LETTER") + 1 if "LETTER" in found.terminals else 0,
        found.terminals.index("NUMBER") + 1,
        int(language.joined),
    )


@cache
def _stack() -> NDArray[np.int64]:
    return np.empty((4, MAX_LINE + 8), np.int64)


def read(data: NDArray[np.uint8], begins: Positions, ends: Positions, name: str) -> Reading:
    """Read lines of a text.

    Args:
        data: The text.
        begins: (lines,) position of the first byte of each line.
        ends: (lines,) position after the last byte.
        name: Name of the grammar.
    """
    lines = len(begins)
    most = 3 * len(data) + 2 * lines
    found = grammar(name)
    events = automaton.Events(
        np.empty(most, np.int16),
        np.empty(most, np.int32),
        np.empty(most, np.int32),
        np.empty(most),
    )
    results = automaton.Results(
        np.empty(lines + 1, np.int32),
        np.empty(lines, np.uint8),
        np.empty(lines, np.int32),
        np.empty(lines, np.int16),
    )
    automaton.read(
        data, begins, ends, MAX_LINE, found.tables, classes(name), _stack(), events, results
    )
    return Reading(found, events, results)


def read_line(text: str, name: str) -> Reading:
    """Read a line. Its events have the positions of its characters.

    Args:
        text: The line, without its end.
        name: Name of the grammar.
    """
    data = text.encode() if text.isascii() else _one_byte_each(text)
    size = np.array([len(data)], np.int32)
    return read(np.frombuffer(data, np.uint8), _AT_START, size, name)


def _one_byte_each(text: str) -> bytes:
    return bytes(min(ord(char), automaton.OTHER) for char in text)


def sort_lines(
    data: NDArray[np.uint8], begins: Positions, ends: Positions, reading: Reading,
    language: Language,
) -> Sorted:  # fmt: skip
    """Return lines as words and items.

    Args:
        data: The text.
        begins: (lines,) position of the first byte of each line.
        ends: (lines,) position after the last byte.
        reading: Their events.
        language: Their language.
    """
    count, size = len(begins), len(data)
    lines = kernel.Lines(
        np.empty(count, np.uint8),
        np.empty(count, np.int64),
        np.empty(count, np.int32),
        np.empty(count, np.int32),
        np.empty(count + 1, np.int32),
    )
    # A word and an item have two bytes at least. An item that is left out may have begun two more.
    items = size // 2 + 2
    text = data.tobytes()
    names = _names(text.count(b"<"))
    labels = _names(text.count(b"o") + text.count(b"O"))
    words = kernel.Words(
        np.empty(items, np.uint8),
        np.empty(items),
        np.empty(items, np.int32),
        np.empty(items, np.int32),
    )
    coded = kernel.Coded(
        np.empty(count, np.uint8),
        np.empty(count + 1, np.int32),
        np.empty(items, np.uint8),
        np.empty(items, np.int64),
        np.empty(items, np.int64),
        kernel.Code(np.empty(size + 1, np.uint8), np.empty(size + 1)),
        names,
        np.empty(count, np.int32),
        labels,
    )
    kernel.sort_events(
        data, begins, ends, reading.events, reading.results, _meaning(language),
        MAX_NUMBER, lines, words, coded,
    )  # fmt: skip
    return Sorted(lines, words, coded)


def _names(most: int) -> kernel.Names:
    """Return space for so many names."""
    places = 16
    while places < 2 * most:
        places *= 2
    return kernel.Names(
        np.empty(most + 1, np.int32),
        np.empty(most + 1, np.int32),
        np.full(places, -1, np.int32),
        np.zeros(1, np.int32),
    )
