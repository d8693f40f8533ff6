"""Lines of text as events, and as the words and items of compiled code."""

from __future__ import annotations

import threading
from functools import cache
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.kernels import automaton
from cnc.gcode.kernels import statements as kernel
from cnc.gcode.kernels.arithmetic import ATAN, SUBTRACT
from cnc.gcode.reader.expressions import (
    FUNCTIONS,
    MACRO_OPERATORS,
    OPERATORS,
    SIEMENS_FUNCTIONS,
    SIEMENS_OPERATORS,
)
from cnc.gcode.reader.tables import Grammar, grammar
from cnc.gcode.reader.words import MAX_NUMBER

MAX_LINE = 4096
"""Most characters of a line. RS274 allows 256; a longer line than this is not G-code."""

_TERMINALS = {
    "NUMBER": kernel.DIGITS, "NAME": kernel.NAME, "REGISTER": kernel.VARIABLE,
    "COMMENT": kernel.REMARK, "TAIL": kernel.REMARK,
    "O": kernel.LETTER_O, "EQUAL": kernel.EQUALS,
    **dict.fromkeys(
        (
            "LETTER", "SIGN", "SLASH", "TIMES", "POWER", "COMPARE", "LOGIC", "FUNCTION", "ATAN",
            "PLAIN", "CONDITION", "CALL", "RESULT", "RADIUS", "PARAMETER", "AND", "XOR", "OR",
        ),
        kernel.KEY,
    ),
}  # fmt: skip
_RULES = {
    "word": kernel.WORD, "sign": kernel.SIGN, "block": kernel.BLOCK, "binary": kernel.BINARY,
    "function": kernel.FUNCTION, "arctangent": kernel.ARCTANGENT, "parameter": kernel.INDEX,
    "bracket": kernel.BRACKET, "assignment": kernel.ASSIGN, "oword": kernel.O_WORD,
    "assigned": kernel.WORD, "indexed": kernel.ASSIGN, "named": kernel.ASSIGN,
    "variable": kernel.PASSED,
}  # fmt: skip
_LETTERS = {chr(code): code for code in range(ord("A"), ord("Z") + 1)}
_OPERATIONS = {
    "ngc": OPERATORS | FUNCTIONS | {"ATAN": ATAN} | _LETTERS,
    "macro": MACRO_OPERATORS | _LETTERS,
    "sinumerik": SIEMENS_OPERATORS | SIEMENS_FUNCTIONS | _LETTERS | {"CR": ord("R")},
    "klartext": {"-": SUBTRACT, "R0": ord("R")} | {letter: ord(letter) for letter in "LXYZABCUVW"},
}
"""Operation or letter of the text of a keyword, by grammar."""
_KLARTEXT_TERMINALS = {
    "NUMBER": kernel.DIGITS, "SIGN": kernel.KEY, "COMMENT": kernel.REMARK, "MOVE": kernel.MOVE,
    "AXIS": kernel.AXIS, "FEED": kernel.FEED, "FMAX": kernel.RAPID, "SIDE": kernel.SIDE,
}  # fmt: skip
_KLARTEXT_RULES = {
    "sign": kernel.SIGN, "valued": kernel.VALUED, "words": kernel.MOVED, "line": kernel.BLOCK,
}  # fmt: skip
_OF_WORDS = {kernel.WORD, kernel.SIGN, kernel.BLOCK}
"""Meanings of rules of the languages whose expressions the interpreter alone computes."""

_MOST_NAMES = 1 << 15
"""Most different names in the lines that are read at once: one in 8 bytes of a window. A line with
a further one is left to the interpreter. A larger table would not fit into the processor's cache.
"""

Arrays = TypeVar("Arrays", kernel.Words, kernel.Code, automaton.Events)
Positions = NDArray[np.int32]
_AT_START = np.zeros(1, np.int32)


class Language(NamedTuple):
    """How lines are read.

    Attributes:
        grammar: Name of the grammar.
        joined: Whether no blank may stand inside a word of compiled code.
        single: Whether a line of compiled code may have one assignment only.
    """

    grammar: str
    joined: bool = False
    single: bool = False


NGC, MACRO, KLARTEXT = Language("ngc"), Language("macro"), Language("klartext")
SINUMERIK = Language("sinumerik", joined=True, single=True)


class Reading(NamedTuple):
    """The events of some lines."""

    grammar: Grammar
    events: automaton.Events
    results: automaton.Results


class Sorted(NamedTuple):
    """Lines as words and items, and their events if compiled code does not know all of them."""

    lines: kernel.Lines
    words: kernel.Words
    coded: kernel.Coded
    reading: Reading | None


@cache
def classes(grammar_name: str) -> NDArray[np.uint8]:
    """Return the class of each byte in the automaton of a grammar.

    RS274 ignores blanks and case outside of comments. A language that ignores a terminal of blanks
    has names that end at a blank.
    """
    classes_of = np.arange(256).astype(np.uint8)
    classes_of[ord("a") : ord("z") + 1] -= ord("a") - ord("A")
    classes_of[:32] = classes_of[127] = automaton.REFUSED
    if not grammar(grammar_name).tables.ignored.any():
        classes_of[[9, 32]] = automaton.SKIPPED
    else:
        classes_of[9] = 32
    classes_of[128:] = automaton.OTHER
    return classes_of


@cache
def _meaning(language: Language) -> kernel.Meaning:
    tables, operations = grammar(language.grammar), _OPERATIONS.get(language.grammar, {})
    is_klartext = language.grammar == "klartext"
    of_rules = _KLARTEXT_RULES if is_klartext else _RULES
    of_terminals = _KLARTEXT_TERMINALS if is_klartext else _TERMINALS
    rules = np.array([of_rules.get(rule, kernel.LEFT_ALONE) for rule in tables.rules], np.uint8)
    if language.grammar == "macro":
        rules[~np.isin(rules, list(_OF_WORDS))] = kernel.LEFT_ALONE
    terminals = [of_terminals.get(terminal, kernel.LEFT_ALONE) for terminal in tables.terminals]
    if language is SINUMERIK:
        terminals[tables.terminals.index("NAME")] = kernel.VARIABLE
    return kernel.Meaning(
        np.array(terminals, np.uint8),
        rules,
        np.array([operations.get(text, 0) for text in tables.texts], np.uint8),
        tables.texts.index("CALL") if "CALL" in tables.texts else -1,
        tables.terminals.index("LETTER") + 1 if "LETTER" in tables.terminals else 0,
        tables.terminals.index("NUMBER") + 1,
        int(language.joined),
        int(language.single),
        int(is_klartext),
    )


def _events(lines: int, size: int) -> automaton.Events:
    """Return space for the events of lines with ``size`` bytes.

    In the grammars of today a byte has at most three, and a line ten more.
    """
    most = 4 * size + 32 * lines
    return automaton.Events(
        np.empty(most, np.int16), np.empty(most, np.int32), np.empty(most, np.int32), np.empty(most)
    )


class _Scratch(threading.local):
    """Arrays that each window of a thread uses again: new memory takes as long as the reading."""

    def __init__(self) -> None:
        self.stack = np.empty((3, MAX_LINE + 8), np.int64)
        self.size, self.lines = -1, -1

    def fit(self, lines: int, size: int) -> None:
        """Make the arrays large enough."""
        if size <= self.size and lines <= self.lines:
            return
        self.size, self.lines = max(size, self.size), max(lines, self.lines)
        self.events = _events(self.lines, self.size)
        # A word and an item have two bytes at least. An item that is left out may have begun two
        # more.
        items = self.size // 2 + 2
        self.words = kernel.Words(
            np.empty(items, np.uint8),
            np.empty(items),
            np.empty(items, np.int32),
            np.empty(items, np.int32),
        )
        self.items = np.empty(items, np.uint8), np.empty(items, np.int64), np.empty(items, np.int64)
        self.code = kernel.Code(np.empty(self.size + 1, np.uint8), np.empty(self.size + 1))
        names = min(items, _MOST_NAMES)
        self.names, self.labels = names_space(names), names_space(names)


_scratch = _Scratch()


def _read(
    data: NDArray[np.uint8], begins: Positions, ends: Positions, name: str, events: automaton.Events
) -> Reading:
    """Read lines of a text into the space for events."""
    lines, tables = len(begins), grammar(name)
    results = automaton.Results(
        np.empty(lines + 1, np.int32),
        np.empty(lines, np.uint8),
        np.empty(lines, np.int32),
        np.empty(lines, np.int16),
    )
    automaton.read(
        data, begins, ends, MAX_LINE, tables.tables, classes(name), _scratch.stack, events, results
    )
    return Reading(tables, events, results)


def events_of_lines(data: bytes, begins: Positions, ends: Positions, language: Language) -> Reading:
    """Return the events of lines. They last until this thread reads further lines.

    The arguments are those of :func:`read_lines`.
    """
    _scratch.fit(len(begins), len(data))
    chars = np.frombuffer(data, np.uint8)
    return _read(chars, begins, ends, language.grammar, _scratch.events)


def read_line(text: str, name: str) -> Reading:
    """Read a line. Its events have the positions of its characters.

    Args:
        text: The line, without its end.
        name: Name of the grammar.
    """
    data = text.encode() if text.isascii() else _one_byte_each(text)
    size = np.array([len(data)], np.int32)
    return _read(np.frombuffer(data, np.uint8), _AT_START, size, name, _events(1, len(data)))


def _one_byte_each(text: str) -> bytes:
    return bytes(min(ord(char), automaton.OTHER) for char in text)


def read_lines(data: bytes, begins: Positions, ends: Positions, language: Language) -> Sorted:
    """Return lines as words and items.

    Args:
        data: The text.
        begins: (lines,) position of the first byte of each line.
        ends: (lines,) position after the last byte.
        language: Their language.
    """
    count, chars = len(begins), np.frombuffer(data, np.uint8)
    scratch = _scratch
    scratch.fit(count, len(data))
    reading = _read(chars, begins, ends, language.grammar, scratch.events)
    lines = kernel.Lines(
        np.empty(count, np.uint8),
        np.empty(count, np.int64),
        np.empty(count, np.int32),
        np.empty(count, np.int32),
        np.empty(count + 1, np.int32),
    )
    coded = kernel.Coded(
        np.empty(count, np.uint8),
        np.empty(count + 1, np.int32),
        *scratch.items,
        scratch.code,
        scratch.names,
        np.empty(count, np.int32),
        scratch.labels,
    )
    kernel.sort_events(
        chars, begins, ends, reading.events, reading.results, _meaning(language), MAX_NUMBER,
        lines, scratch.words, coded,
    )  # fmt: skip
    words, items = int(lines.first[count]), int(coded.first[count])
    instructions = int(coded.end[items - 1]) if items else 0
    are_read = (coded.kind != kernel.UNKNOWN) | (lines.plain > 0)
    return Sorted(
        lines,
        _copied(scratch.words, words),
        coded._replace(
            letter=coded.letter[:items].copy(),
            begin=coded.begin[:items].copy(),
            end=coded.end[:items].copy(),
            code=_copied(coded.code, instructions),
            names=_taken(coded.names),
            labels=_taken(coded.labels),
        ),
        None
        if are_read.all()
        else reading._replace(events=_copied(reading.events, int(reading.results.first[count]))),
    )


def _copied(arrays: Arrays, count: int) -> Arrays:
    """Return the first elements of arrays in memory of their own."""
    return arrays._replace(
        **{name: array[:count].copy() for name, array in arrays._asdict().items()}
    )


def names_space(most: int) -> kernel.Names:
    """Return space for so many names."""
    places = 1 << (2 * most - 1).bit_length()
    return kernel.Names(
        np.empty(most, np.int32),
        np.empty(most, np.int32),
        np.full(places, -1, np.int32),
        np.zeros(1, np.int32),
    )


def _taken(names: kernel.Names) -> kernel.Names:
    """Return a copy of names without their table; the space is empty then."""
    used = int(names.used[0])
    if used:
        names.table.fill(-1)
        names.used[0] = 0
    return kernel.Names(
        names.begin[:used].copy(),
        names.end[:used].copy(),
        names.table[:0],
        np.array([used], np.int32),
    )
