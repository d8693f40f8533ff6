"""Events of lines (:mod:`cnc.kernels.gcode.automaton`) as words, and as items with instructions.

A *plain* line has words with numbers, and comments that are no commands. Most lines that CAM
systems write are plain. Other lines of words, assignments and O-words become items: a word, a side
of an assignment, a value of a control line. The value of an item is a run of instructions in
reverse Polish order: ``#1 + 2`` is PARAMETER 1, NUMBER 2, ADD.

A line that compiled code does not execute is only marked; the interpreter executes its events.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.gcode.automaton import OK, OTHER, Events, Results
from cnc.kernels.jit import njit

Bytes = NDArray[np.uint8]
Counts = NDArray[np.int32]
Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

LAST_PARAMETER = 5000
"""Highest parameter number of instructions. Those above belong to the system."""

NUMBER, PARAMETER, NAMED, INDIRECT, MINUS = 0, 1, 2, 3, 4
ADD, SUBTRACT, MULTIPLY, DIVIDE, MODULO, POWER = 5, 6, 7, 8, 9, 10
EQ, NE, GT, GE, LT, LE, AND, OR, XOR = 11, 12, 13, 14, 15, 16, 17, 18, 19
ABS, ACOS, ASIN, COS, EXP, FIX, FUP, LN = 20, 21, 22, 23, 24, 25, 26, 27
ROUND, SIN, SQRT, TAN, ATAN = 28, 29, 30, 31, 32
"""Operations of instructions."""
MOST_VALUES = 24
"""Most values on the stack of an expression."""
MOST_INSTRUCTIONS = 90
"""Most instructions of an expression. The interpreter limits their depth."""

UNKNOWN, SIMPLE, WORDS, ASSIGNMENT, NUMBERED_ASSIGNMENT, CONTROL = 0, 1, 2, 3, 4, 5
"""Kinds of lines: left to the interpreter, plain words, words with expressions, assignments, those
after a line number, O-words.
"""
TARGET, EQUAL, VALUE = 35, 61, 91
"""Letters of items that are no words: the left and the right side of an assignment, and a value in
brackets.
"""
MOST_ITEMS = 64
"""Most items of a line."""

(
    LEFT_ALONE, DIGITS, KEY, NAME, REMARK, LETTER_O, EQUALS,
    WORD, BINARY, SIGN, FUNCTION, ARCTANGENT, INDEX, BRACKET, ASSIGN, O_WORD, BLOCK,
) = range(17)  # fmt: skip
"""Meanings of terminals and rules. LEFT_ALONE: only the interpreter knows it."""

_TAB, _LF, _CR, _BLANK = 9, 10, 13, 32
_OPEN, _CLOSE, _SLASH, _DOT, _ZERO, _SEMICOLON = 40, 41, 47, 46, 48, 59
_A, _G, _M, _N, _O, _Z, _LOWER = 65, 71, 77, 78, 79, 90, 32
_LINE_DIGITS, _HEAD_DIGITS = 9, 18
_HASH_MASK = (1 << 40) - 1
_ACTIVE = np.array(
    [[ord(char) for char in begin] for begin in ("msg", "deb", "pri", "log", "pro", "abo", "py\0")],
    np.uint8,
)
"""Beginnings of comments that may be commands: msg, debug, print, log.., probe.., abort, py."""


class Meaning(NamedTuple):
    """What a grammar's symbols mean here.

    Attributes:
        terminal: (t,) meaning of each terminal.
        rule: (r,) meaning of each rule.
        text: (texts,) letter of a word, operation of an operator or function, or 0, by the text.
        call: Index of the text CALL; -1 for none.
        joined: 1 if no blank may stand inside a word.
    """

    terminal: Bytes
    rule: Bytes
    text: Bytes
    call: int
    joined: int


class Lines(NamedTuple):
    """The lines of a text.

    Attributes:
        head: (lines,) first letter after blanks, comments, ``/`` and N; a capital, 0 for none.
        label: (lines,) N number, -1 for none.
        plain: (lines,) number of consecutive plain lines from here on; 0 if this one is not plain.
        simple: (lines,) number of consecutive plain lines from here on without a repeated word.
        first: (lines + 1,) index of the first word; the last entry is the number of words.
    """

    head: Bytes
    label: Ints
    plain: Counts
    simple: Counts
    first: Counts


class Words(NamedTuple):
    """The words of the plain lines of a text.

    Attributes:
        letter: (words,) code of the capital letter.
        number: (words,) the number.
        column: (words,) column in the line, from 1.
        length: (words,) number of characters.
    """

    letter: Bytes
    number: Floats
    column: Counts
    length: Counts


class Code(NamedTuple):
    """Instructions of a text.

    Attributes:
        operation: (instructions,) operations.
        number: (instructions,) number of NUMBER, parameter number, or index of a name.
    """

    operation: Bytes
    number: Floats


class Names(NamedTuple):
    """Different names in a text. Capital and small letters are equal.

    Attributes:
        begin: (names,) position of the first byte.
        end: (names,) position after the last byte.
        table: (a power of two,) hash table of indices of names, -1 for none.
        used: (1,) number of names.
    """

    begin: Counts
    end: Counts
    table: Counts
    used: Counts


class Coded(NamedTuple):
    """The lines of a text as items: words, sides of assignments, values of control lines.

    Attributes:
        kind: (lines,) kinds.
        first: (lines + 1,) index of the first item.
        letter: (items,) letter of a word, TARGET, EQUAL or VALUE.
        begin: (items,) first instruction of the value.
        end: (items,) instruction after the last one.
        code: The instructions.
        names: The names of parameters.
        label: (lines,) index of the label of a call; -1 for other lines.
        labels: The labels of calls, names in angle brackets.
    """

    kind: Bytes
    first: Counts
    letter: Bytes
    begin: Ints
    end: Ints
    code: Code
    names: Names
    label: Counts
    labels: Names


@njit
def index_of_name(data: Bytes, begin: int, end: int, names: Names) -> int:
    """Return the index of a name, which is added if it is new; -1 if the arrays are full."""
    mixed = 0
    for i in range(begin, end):
        char = int(data[i])
        if _A <= char <= _Z:
            char |= _LOWER
        mixed = ((mixed ^ char) * 16777619) & _HASH_MASK
    places = len(names.table)
    at = (mixed ^ (mixed >> 17)) & (places - 1)
    while names.table[at] >= 0:
        known = int(names.table[at])
        first = int(names.begin[known])
        same = int(names.end[known]) - first == end - begin
        i = 0
        while same and i < end - begin:
            a, b = int(data[first + i]), int(data[begin + i])
            if a != b:
                a = a | _LOWER if _A <= a <= _Z else a
                b = b | _LOWER if _A <= b <= _Z else b
                same = a == b
            i += 1
        if same:
            return known
        at = (at + 1) & (places - 1)
    new = int(names.used[0])
    if new == len(names.begin):
        return -1
    names.table[at] = new
    names.begin[new] = begin
    names.end[new] = end
    names.used[0] = new + 1
    return new


@njit
def _is_idle(data: Bytes, begin: int, end: int) -> bool:
    """Return whether a comment is no command, and has no character of several bytes."""
    i = begin + 1
    while i < end and (data[i] == _BLANK or data[i] == _TAB):
        i += 1
    for row in range(len(_ACTIVE)):
        same = 0
        while same < 3 and i + same < end and int(data[i + same]) | _LOWER == _ACTIVE[row, same]:
            same += 1
        if data[begin] == _OPEN and (same == 3 or (same == 2 and _ACTIVE[row, 2] == 0)):
            return False
    for k in range(i, end):
        if data[k] >= OTHER:
            return False
    return True


@njit
def _has_blank(data: Bytes, begin: int, end: int) -> bool:
    """Return whether a text has a blank or a semicolon."""
    for i in range(begin, end):
        if data[i] == _BLANK or data[i] == _TAB or data[i] == _SEMICOLON:
            return True
    return False


@njit
def _is_blank(data: Bytes, begin: int, end: int) -> bool:
    """Return whether a text has nothing but blanks."""
    for i in range(begin, end):
        if data[i] != _BLANK and data[i] != _TAB:
            return False
    return True


@njit
def _head(data: Bytes, begin: int, stop: int) -> tuple[int, int]:
    """Return the first letter of a line and its N number.

    Blanks, comments, ``/`` and the N number are passed. The letter is a capital, 0 for none; the
    number is -1 for none.
    """
    i = begin
    label = -1
    while i < stop:
        char = int(data[i])
        capital = char & ~_LOWER
        if char in (_BLANK, _TAB, _SLASH):
            i += 1
        elif char == _OPEN:
            while i < stop and data[i] != _CLOSE:
                i += 1
            i += 1
        elif char == _N or char == _N + _LOWER:
            value = 0
            digits = 0
            i += 1
            while i < stop and (
                data[i] == _BLANK or data[i] == _TAB or 0 <= int(data[i]) - _ZERO <= 9
            ):
                if int(data[i]) >= _ZERO and digits < _HEAD_DIGITS:
                    value = value * 10 + int(data[i]) - _ZERO
                    digits += 1
                i += 1
            if digits == 0 or label >= 0:
                return _N, label
            label = value
        elif char >= _A and _A <= capital <= _Z:
            return capital, label
        else:
            return 0, label
    return 0, label


@njit
def _run_lengths(flags: Counts, count: int) -> None:
    """Replace each flag (1 or 0) by the number of consecutive ones from it on."""
    run = 0
    for i in range(count - 1, -1, -1):
        run = run + 1 if flags[i] else 0
        flags[i] = run


@njit
def sort_events(
    data: Bytes, begins: Counts, ends: Counts, events: Events, results: Results, meaning: Meaning,
    largest: float, lines: Lines, words: Words, coded: Coded,
) -> None:  # fmt: skip
    """Fill words and items from the events of lines.

    Args:
        data: The text.
        begins: (lines,) position of the first byte of each line.
        ends: (lines,) position after the last byte.
        events: The events.
        results: Which events belong to each line.
        meaning: What the grammar's symbols mean.
        largest: A line with a number above this is left to the interpreter.
        lines: Filled with the lines.
        words: Filled with the words of plain lines: space for a word for two bytes.
        coded: Filled with the other lines: space for an item for two bytes and two more, and for an
            instruction for each byte.
    """
    code = coded.code
    operation, number = code.operation, code.number
    keys, brackets, closes = np.empty(4200, np.uint8), np.empty(4200, np.int64), np.empty(
        4200, np.int64
    )  # fmt: skip
    found = items = count = 0
    for k in range(len(begins)):
        lines.first[k], coded.first[k] = found, items
        coded.kind[k], coded.label[k] = UNKNOWN, -1
        lines.plain[k] = lines.simple[k] = 0
        begin = int(begins[k])
        a, b = int(results.first[k]), int(results.first[k + 1])
        first_item, first_code = items, count
        word = found
        height = keyed = opened = split = 0
        item_code, seen, simple = count, 0, True
        known = plain = results.status[k] == OK
        kind, head, label = UNKNOWN, 0, -1
        numbered = False
        name_begin, name_end, calls = 0, -1, False
        for e in range(a, b):
            if not known and not plain:
                break
            sort = int(events.kind[e])
            value = events.value[e]
            if sort > 0:
                role = int(meaning.terminal[sort - 1])
                if role == KEY:
                    keys[keyed] = meaning.text[int(value)]
                    keyed += 1
                    calls = calls or int(value) == meaning.call
                    # A / that begins the line is that of block delete.
                    if e == a and data[events.begin[e]] == _SLASH:
                        known = plain = False
                elif role == DIGITS:
                    if name_end == 0:
                        name_begin, name_end = int(events.begin[e]), int(events.end[e])
                        # The label may be computed: #1 or [..].
                        known = known and _is_blank(data, int(events.end[e - 1]), name_begin)
                    else:
                        operation[count], number[count] = NUMBER, value
                        count += 1
                        height += 1
                        # Not for NaN, too.
                        if not value <= largest or height > MOST_VALUES:
                            known = plain = False
                elif role == NAME:
                    plain = False
                    if name_end == 0:
                        name_begin, name_end = int(events.begin[e]), int(events.end[e])
                        known = known and _is_blank(data, int(events.end[e - 1]), name_begin)
                    else:
                        at, end = int(events.begin[e]) + 1, int(events.end[e]) - 1
                        index = -1
                        if not _has_blank(data, at, end):
                            index = index_of_name(data, at, end, coded.names)
                        operation[count], number[count] = NAMED, index
                        count += 1
                        height += 1
                        known = known and index >= 0 and height <= MOST_VALUES
                elif role == REMARK:
                    if not _is_idle(data, int(events.begin[e]), int(events.end[e])):
                        known = plain = False
                elif role == LETTER_O:
                    name_end, plain = 0, False
                elif role == EQUALS:
                    split = count
                else:
                    known = plain = False
                continue
            role = int(meaning.rule[-sort - 1])
            if role == WORD:
                keyed -= 1
                letter = int(keys[keyed])
                alone = count == item_code + 1 and operation[item_code] == NUMBER
                plain = plain and alone
                if letter == 0:
                    known = plain = False
                    continue
                known = known and items - first_item + 2 <= MOST_ITEMS
                if meaning.joined and _has_blank(data, int(events.begin[e]), int(events.end[e])):
                    known = plain = False
                is_code = letter == _G or letter == _M
                bit = 1 << (letter - _A)
                if letter == _N:
                    # A line number with a minus is wrong, even -0.
                    whole = alone and number[item_code] == math.floor(number[item_code])
                    simple = whole and math.copysign(1.0, number[item_code]) > 0.0
                    if whole and number[item_code] >= 0.0:
                        label = int(number[item_code])
                    is_first = items == first_item and not numbered
                    known = known and simple and is_first
                    plain = plain and is_first
                    for i in range(events.begin[e], events.end[e]):
                        known = known and data[i] != _DOT
                    known = known and events.end[e] - events.begin[e] <= _LINE_DIGITS
                    numbered = True
                else:
                    if seen & bit != 0 and not is_code:
                        known = simple = False
                    seen |= bit
                    head = letter if head == 0 else head
                    known = known and (kind == UNKNOWN or kind == WORDS)
                    kind = WORDS
                    # A computed code has rules of its own.
                    if is_code and operation[item_code] != NUMBER:
                        known = False
                    coded.letter[items] = letter
                    coded.begin[items], coded.end[items] = item_code, count
                    items += 1
                if plain:
                    words.letter[word], words.number[word] = letter, number[item_code]
                    words.column[word] = events.begin[e] - begin + 1
                    words.length[word] = events.end[e] - events.begin[e]
                    word += 1
                if letter == _N:
                    count = item_code
                item_code, height, opened = count, 0, 0
            elif role == SIGN:
                keyed -= 1
                if keys[keyed] == SUBTRACT:
                    if operation[count - 1] == NUMBER:
                        number[count - 1] = -number[count - 1]
                    else:
                        operation[count] = MINUS
                        count += 1
            elif role == BINARY:
                keyed -= 1
                operation[count] = keys[keyed]
                known = known and keys[keyed] != 0
                count += 1
                height -= 1
                while opened > 0 and brackets[opened - 1] >= events.begin[e]:
                    opened -= 1
            elif role == FUNCTION:
                keyed -= 1
                opened -= 1
                operation[count] = keys[keyed]
                known = known and keys[keyed] != 0
                count += 1
            elif role == ARCTANGENT:
                keyed -= 2
                opened -= 2
                operation[count] = ATAN
                count += 1
                height -= 1
            elif role == INDEX:
                plain = False
                while opened > 0 and brackets[opened - 1] >= events.begin[e]:
                    opened -= 1
                last = count - 1
                of_name = int(events.kind[e - 1])
                if operation[last] == NUMBER:
                    operation[last] = PARAMETER
                    known = known and number[last] == math.floor(number[last])
                    known = known and 1.0 <= number[last] <= LAST_PARAMETER
                elif of_name < 0 or meaning.terminal[of_name - 1] != NAME:
                    operation[count] = INDIRECT
                    count += 1
            elif role == BRACKET:
                plain = False
                while opened > 0 and brackets[opened - 1] >= events.begin[e]:
                    opened -= 1
                brackets[opened], closes[opened] = events.begin[e], count
                opened += 1
            elif role == ASSIGN:
                known = known and (kind == UNKNOWN or kind == ASSIGNMENT)
                known = known and items - first_item + 3 <= MOST_ITEMS
                plain = False
                kind = ASSIGNMENT
                if known:
                    coded.letter[items], coded.letter[items + 1] = TARGET, EQUAL
                    coded.begin[items], coded.end[items] = item_code, split
                    coded.begin[items + 1], coded.end[items + 1] = split, count
                    items += 2
                item_code, height, opened = count, 0, 0
            elif role == O_WORD:
                plain = False
                known = known and kind == UNKNOWN and name_end > name_begin
                known = known and not _has_blank(data, name_begin, name_end)
                known = known and opened + 2 <= MOST_ITEMS
                kind = CONTROL
                if known and calls:
                    while name_begin < name_end and data[name_begin] == _ZERO:
                        name_begin += 1
                    known = name_end > name_begin
                for i in range(name_begin, name_end):
                    known = known and data[i] != _DOT
                if known:
                    if calls:
                        coded.label[k] = index_of_name(data, name_begin, name_end, coded.labels)
                    for i in range(opened):
                        coded.letter[items] = VALUE
                        coded.begin[items], coded.end[items] = item_code, closes[i]
                        item_code = closes[i]
                        items += 1
            elif role != BLOCK:
                known = plain = False
            if height > MOST_VALUES or count - item_code > MOST_INSTRUCTIONS:
                known = plain = False
        if plain:
            lines.plain[k] = 1
            lines.simple[k] = int(simple)
            lines.head[k], lines.label[k] = head, label
            coded.kind[k] = SIMPLE if simple else UNKNOWN
            found = word
            items, count = first_item, first_code
        else:
            lines.head[k], lines.label[k] = _head(data, begin, int(ends[k]))
            if known and kind != UNKNOWN:
                coded.kind[k] = kind + (kind == ASSIGNMENT and numbered)
            else:
                items, count = first_item, first_code
    lines.first[len(begins)], coded.first[len(begins)] = found, items
    _run_lengths(lines.plain, len(begins))
    _run_lengths(lines.simple, len(begins))
