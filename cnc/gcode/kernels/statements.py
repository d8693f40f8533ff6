"""Events of lines (:mod:`cnc.gcode.kernels.automaton`) as words, and as items with instructions.

A *plain* line has words with numbers, and comments that are no commands. Most lines that CAM
systems write are plain. Other lines of words, assignments and O-words become items: a word, a side
of an assignment, a value of a control line. The value of an item is a run of instructions in
reverse Polish order: ``#1 + 2`` is PARAMETER 1, NUMBER 2, ADD.

A line that compiled code does not execute is only marked; the interpreter executes its events.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.gcode.kernels.arithmetic import INDIRECT, MINUS, NAMED, NUMBER, PARAMETER, SUBTRACT
from cnc.gcode.kernels.automaton import OK, OTHER, Events, Results

Bytes = NDArray[np.uint8]
Counts = NDArray[np.int32]
Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

LAST_PARAMETER = 5000
"""Highest parameter number of instructions. Those above belong to the system."""

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
    VARIABLE, PASSED, MOVE, AXIS, FEED, RAPID, SIDE, VALUED, MOVED,
) = range(26)  # fmt: skip
"""Meanings of terminals and rules. LEFT_ALONE: only the interpreter knows it. VARIABLE: a name
without brackets. PASSED: a rule that adds nothing to its part. MOVE to SIDE: words of Klartext,
whose rules are VALUED, for a word with its number, and MOVED, for all words of a block.
"""

_TAB, _LF, _CR, _BLANK = 9, 10, 13, 32
_OPEN, _CLOSE, _SLASH, _DOT, _ZERO, _SEMICOLON = 40, 41, 47, 46, 48, 59
_A, _F, _G, _L, _M, _N, _O, _R, _Z, _LOWER = 65, 70, 71, 76, 77, 78, 79, 82, 90, 32
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
        letter: Kind of the events of a word's letter.
        number: Kind of those of a number.
        joined: 1 if no blank may stand inside a word.
        single: 1 if a line may have one assignment only: they take effect one by one.
        klartext: 1 if only straight moves of Klartext are plain.
    """

    terminal: Bytes
    rule: Bytes
    text: Bytes
    call: int
    letter: int
    number: int
    joined: int
    single: int
    klartext: int


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


Record = Any
"""A record of _LINE."""
_LINE = np.dtype(
    [(name, np.int64) for name in ("head", "label", "words", "simple", "items", "count")]
)
"""What is known about a line: for a plain line its head, label, number of words, and whether it is
simple; for another one the numbers of items and instructions after it.
"""


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
def add_names(
    data: Bytes, begins: Counts, ends: Counts, text: Bytes, known: Names, found: Counts
) -> None:
    """Find names among known ones. A new one is added.

    Args:
        data: A text with the names.
        begins: (names,) position of the first byte of each name.
        ends: (names,) position after the last byte.
        text: The known names, with space for the others.
        known: Their places, with space for the others.
        found: Takes the index of each name.
    """
    for k in range(len(begins)):
        used = int(known.used[0])
        at = int(known.end[used - 1]) if used else 0
        end = at + int(ends[k]) - int(begins[k])
        text[at:end] = data[begins[k] : ends[k]]
        for i in range(at, end):
            if _A <= text[i] <= _Z:
                text[i] |= _LOWER
        found[k] = index_of_name(text, at, end, known)


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
    for k in range(i, end):  # noqa: SIM110 numba compiles no generator
        if data[k] >= OTHER:
            return False
    return True


@njit
def _is_special(data: Bytes, begin: int, end: int) -> bool:
    """Return whether a text has a blank, a semicolon or a character that is not ASCII."""
    for i in range(begin, end):
        # No other control character than a tab is in a token.
        if data[i] <= _BLANK or data[i] == _SEMICOLON or data[i] >= OTHER:
            return True
    return False


@njit
def _is_blank(data: Bytes, begin: int, end: int) -> bool:
    """Return whether a text has nothing but blanks."""
    for i in range(begin, end):  # noqa: SIM110 numba compiles no generator
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
def _word_of(events: Events, e: int, b: int, meaning: Meaning) -> tuple[int, float]:
    """Return the number of events of the word at event ``e``, and its number; 0 for another part.

    Only a word with a written number counts. One in brackets ends before its word.
    """
    kind, end = events.kind, events.end
    if e + 2 < b and kind[e] == meaning.letter:
        after = int(kind[e + 2])
        if kind[e + 1] == meaning.number and after < 0 and meaning.rule[-after - 1] == WORD:
            return (3, events.value[e + 1]) if end[e + 1] == end[e + 2] else (0, 0.0)
        if e + 4 < b and after == meaning.number:
            last = int(kind[e + 4])
            if last < 0 and meaning.rule[-last - 1] == WORD and end[e + 2] == end[e + 4]:
                minus = meaning.text[int(events.value[e + 1])] == SUBTRACT
                return 5, -events.value[e + 2] if minus else events.value[e + 2]
    return 0, 0.0


@njit
def _plain_line(
    data: Bytes, a: int, b: int, begin: int, found: int, events: Events, meaning: Meaning,
    largest: float, words: Words, known: Record,
) -> bool:  # fmt: skip
    """Fill the words of a line, if it is plain.

    Args:
        data: The text.
        a: Its first event.
        b: The event after its last one.
        begin: Position of its first byte.
        found: Number of words before.
        events: The events.
        meaning: What the grammar's symbols mean.
        largest: Largest number.
        words: Takes the words.
        known: Takes the head, the label, the number of words and whether the line is simple.

    Returns:
        Whether it is plain.
    """
    word, e, seen = found, a, 0
    head, label, simple = 0, -1, True
    while e < b - 1:
        count, value = _word_of(events, e, b, meaning)
        if count == 0:
            kind = int(events.kind[e])
            if (
                kind < 0
                or meaning.terminal[kind - 1] != REMARK
                or not _is_idle(data, int(events.begin[e]), int(events.end[e]))
            ):
                return False
            e += 1
            continue
        letter = int(meaning.text[int(events.value[e])])
        at, end = int(events.begin[e]), int(events.end[e + count - 1])
        # Not for NaN, too.
        if not abs(value) <= largest or (meaning.joined and _is_special(data, at, end)):
            return False
        bit = 1 << (letter - _A)
        if letter == _N:
            if word > found:
                return False
            # A line number with a minus is wrong, even -0.
            simple = value == math.floor(value) and math.copysign(1.0, value) > 0.0
            if value >= 0.0 and value == math.floor(value):
                label = int(value)
        else:
            simple = simple and (seen & bit == 0 or letter == _G or letter == _M)
            head = letter if head == 0 else head
        seen |= bit
        words.letter[word], words.number[word] = letter, value
        words.column[word], words.length[word] = at - begin + 1, end - at
        word += 1
        e += count
    if b == a or meaning.rule[-int(events.kind[b - 1]) - 1] != BLOCK:
        return False
    known["head"], known["label"], known["words"], known["simple"] = head, label, word, simple
    return True


@njit
def _role(events: Events, e: int, meaning: Meaning) -> int:
    """Return the meaning of an event."""
    kind = int(events.kind[e])
    return int(meaning.terminal[kind - 1]) if kind > 0 else int(meaning.rule[-kind - 1])


@njit
def _klartext_line(
    a: int, b: int, begin: int, found: int, events: Events, meaning: Meaning, largest: float,
    words: Words, known: Record,
) -> bool:  # fmt: skip
    """Fill the words of a straight move of Klartext: G1, or G0 for FMAX, absolute axes, and F.

    R0 adds no word: compiled code does not run under compensation.

    Args:
        a: The first event of the line.
        b: The event after its last one.
        begin: Position of its first byte.
        found: Number of words before.
        events: The events.
        meaning: What the grammar's symbols mean.
        largest: Largest number.
        words: Takes the words.
        known: Takes the head, the label, the number of words and whether the line is simple.

    Returns:
        Whether it is such a move.
    """
    e, seen, moves = a, 0, False
    if a < b and _role(events, a, meaning) == DIGITS:
        e += 1
    if e >= b or _role(events, e, meaning) != MOVE or meaning.text[int(events.value[e])] != _L:
        return False
    words.letter[found], words.number[found] = _G, 1.0
    words.column[found], words.length[found] = int(events.begin[e]) - begin + 1, 1
    word = found + 1
    e += 1
    while e < b and _role(events, e, meaning) != MOVED:
        role, first = _role(events, e, meaning), e
        letter = int(meaning.text[int(events.value[e])]) if role == AXIS or role == SIDE else _F
        # A code without a letter is 0, whose shift would be negative.
        bit = 1 << (letter - _A) if letter else 0
        if bit == 0 or seen & bit:
            return False
        seen |= bit
        e += 1
        if role == SIDE:
            continue
        if role == RAPID:
            words.number[found] = 0.0
        elif role == AXIS or role == FEED:
            signed = _role(events, e, meaning) == KEY
            minus = signed and meaning.text[int(events.value[e])] == SUBTRACT
            e += signed
            value = events.value[e]
            # Not for NaN, too.
            if _role(events, e, meaning) != DIGITS or not abs(value) <= largest:
                return False
            words.letter[word], words.number[word] = letter, -value if minus else value
            words.column[word] = int(events.begin[first]) - begin + 1
            words.length[word] = int(events.end[e]) - int(events.begin[first])
            word += 1
            e += 1 + signed
            moves = moves or role == AXIS
        else:
            return False
        if _role(events, e, meaning) != VALUED:
            return False
        e += 1
    e += 1
    if e < b and _role(events, e, meaning) == REMARK:
        e += 1
    if not moves or e != b - 1 or _role(events, e, meaning) != BLOCK:
        return False
    known["head"], known["label"], known["words"], known["simple"] = 0, -1, word, True
    return True


@njit
def _coded_line(
    data: Bytes, k: int, a: int, b: int, events: Events, meaning: Meaning, largest: float,
    coded: Coded, keys: Bytes, closes: Ints, now: Record,
) -> int:  # fmt: skip
    """Append the items of line ``k``, whose events are those from ``a`` to before ``b``.

    The numbers of items and instructions in ``now`` are brought up to date. ``keys`` (MOST_ITEMS)
    takes letters and operators; ``closes`` (MOST_VALUES), for each value on the stack, the
    instruction behind its outermost bracket.

    Returns:
        The kind of the line. If it is UNKNOWN, what was appended has no meaning.
    """
    operation, number = coded.code.operation, coded.code.number
    first_item, items, count = int(now["items"]), int(now["items"]), int(now["count"])
    keyed = height = seen = split = 0
    first, kind = count, UNKNOWN
    numbered = calls = False
    label, label_end = 0, -1
    for e in range(a, b):
        sort = int(events.kind[e])
        begin, end, value = int(events.begin[e]), int(events.end[e]), events.value[e]
        role = int(meaning.terminal[sort - 1]) if sort > 0 else int(meaning.rule[-sort - 1])
        if role == LEFT_ALONE or count - first > MOST_INSTRUCTIONS or keyed == MOST_ITEMS:
            return UNKNOWN
        if role == KEY:
            # A / that begins the line is that of block delete.
            if e == a and data[begin] == _SLASH:
                return UNKNOWN
            keys[keyed] = meaning.text[int(value)]
            keyed += 1
            calls = calls or int(value) == meaning.call
        elif (role == DIGITS or role == NAME) and label_end == 0:
            label, label_end = begin, end
            # The label may be computed: #1 or [..].
            if not _is_blank(data, int(events.end[e - 1]), begin):
                return UNKNOWN
        elif role == DIGITS:
            operation[count], number[count] = NUMBER, value
            count += 1
            height += 1
            # Not for NaN, too.
            if not value <= largest or height > MOST_VALUES:
                return UNKNOWN
        elif role == NAME or role == VARIABLE:
            index = -1
            inner = int(role == NAME)
            if not _is_special(data, begin + inner, end - inner):
                index = index_of_name(data, begin + inner, end - inner, coded.names)
            operation[count], number[count] = NAMED, index
            count += 1
            height += 1
            if index < 0 or height > MOST_VALUES:
                return UNKNOWN
        elif role == LETTER_O:
            label_end = 0
        elif role == EQUALS:
            split = count
            if keyed > 0 and count == first + 1 and operation[first] == NUMBER:
                # SINUMERIK's R1=
                keyed -= 1
                before = int(events.begin[e - 2])
                index = -1
                if keys[keyed] == _R and not _is_special(data, before, begin):
                    index = index_of_name(data, before, int(events.end[e - 1]), coded.names)
                operation[first], number[first] = NAMED, index
                if index < 0:
                    return UNKNOWN
        elif role == PASSED:
            continue
        elif role == REMARK:
            if not _is_idle(data, begin, end):
                return UNKNOWN
        elif role == INDEX:
            before = int(events.kind[e - 1])
            if operation[count - 1] == NUMBER:
                index = number[count - 1]
                operation[count - 1] = PARAMETER
                if index != math.floor(index) or not 1.0 <= index <= LAST_PARAMETER:
                    return UNKNOWN
            elif before < 0 or meaning.terminal[before - 1] != NAME:
                operation[count] = INDIRECT
                count += 1
        elif role == BRACKET:
            closes[height - 1] = count
        elif role == SIGN:
            keyed -= 1
            if keys[keyed] == SUBTRACT and operation[count - 1] == NUMBER:
                number[count - 1] = -number[count - 1]
            elif keys[keyed] == SUBTRACT:
                operation[count] = MINUS
                count += 1
        elif role == BINARY or role == FUNCTION or role == ARCTANGENT:
            keyed -= 2 if role == ARCTANGENT else 1
            operation[count] = keys[keyed]
            count += 1
            height -= role != FUNCTION
            if keys[keyed] == 0:
                return UNKNOWN
        elif role == WORD:
            keyed -= 1
            letter = int(keys[keyed])
            is_code = letter == _G or letter == _M
            if letter == 0 or (kind != UNKNOWN and kind != WORDS):
                return UNKNOWN
            if letter == _N:
                # Digits alone make a line number.
                plain = count == first + 1 and operation[first] == NUMBER
                for i in range(begin + 1, end):
                    plain = plain and (data[i] == _BLANK or 0 <= int(data[i]) - _ZERO <= 9)
                if not plain or end - begin > _LINE_DIGITS or kind != UNKNOWN or numbered:
                    return UNKNOWN
                numbered = True
                count = first
            else:
                bit = 1 << (letter - _A)
                # A computed code has rules of its own.
                if (seen & bit and not is_code) or (is_code and operation[first] != NUMBER):
                    return UNKNOWN
                seen |= bit
                kind = WORDS
                coded.letter[items] = letter
                coded.begin[items], coded.end[items] = first, count
                items += 1
                if items - first_item + 3 > MOST_ITEMS:
                    return UNKNOWN
            first, height = count, 0
        elif role == ASSIGN:
            if kind != UNKNOWN and (kind != ASSIGNMENT or meaning.single):
                return UNKNOWN
            kind = ASSIGNMENT
            coded.letter[items], coded.letter[items + 1] = TARGET, EQUAL
            coded.begin[items], coded.end[items] = first, split
            coded.begin[items + 1], coded.end[items + 1] = split, count
            items += 2
            if items - first_item + 3 > MOST_ITEMS:
                return UNKNOWN
            first, height = count, 0
        elif role == O_WORD:
            if kind != UNKNOWN or not _is_label(data, label, label_end):
                return UNKNOWN
            if calls:
                while label < label_end and data[label] == _ZERO:
                    label += 1
                if label == label_end:
                    return UNKNOWN
                coded.label[k] = index_of_name(data, label, label_end, coded.labels)
            kind = CONTROL
            for i in range(height):
                coded.letter[items] = VALUE
                coded.begin[items], coded.end[items] = first, closes[i]
                first = int(closes[i])
                items += 1
    now["items"], now["count"] = items, count
    return NUMBERED_ASSIGNMENT if kind == ASSIGNMENT and numbered else kind


@njit
def _is_label(data: Bytes, begin: int, end: int) -> bool:
    """Return whether a text is a label of ASCII without a blank or a point."""
    for i in range(begin, end):
        if data[i] == _DOT:
            return False
    return end > begin and not _is_special(data, begin, end)


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
    space = np.zeros(1, _LINE)
    now = space[0]
    keys, closes = np.empty(MOST_ITEMS, np.uint8), np.empty(MOST_VALUES, np.int64)
    found = items = count = 0
    for k in range(len(begins)):
        lines.first[k], coded.first[k] = found, items
        coded.kind[k], coded.label[k] = UNKNOWN, -1
        lines.plain[k] = lines.simple[k] = 0
        begin = int(begins[k])
        a, b = int(results.first[k]), int(results.first[k + 1])
        is_read = results.status[k] == OK
        if is_read and (
            _klartext_line(a, b, begin, found, events, meaning, largest, words, now)
            if meaning.klartext
            else _plain_line(data, a, b, begin, found, events, meaning, largest, words, now)
        ):
            lines.plain[k], lines.simple[k] = 1, now["simple"]
            lines.head[k], lines.label[k] = now["head"], now["label"]
            coded.kind[k] = SIMPLE if now["simple"] else UNKNOWN
            found = int(now["words"])
            continue
        lines.head[k], lines.label[k] = _head(data, begin, int(ends[k]))
        now["items"], now["count"] = items, count
        if is_read:
            coded.kind[k] = _coded_line(
                data, k, a, b, events, meaning, largest, coded, keys, closes, now
            )
            if coded.kind[k] != UNKNOWN:
                items, count = int(now["items"]), int(now["count"])
    lines.first[len(begins)], coded.first[len(begins)] = found, items
    _run_lengths(lines.plain, len(begins))
    _run_lengths(lines.simple, len(begins))
