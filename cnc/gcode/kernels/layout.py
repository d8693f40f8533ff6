"""Lines of a program in one form: blanks, capitals, numbers, the order and repetition of words.

A line is a list of *groups*: a word, an assignment, a comment, the parts of a control line. The
tokens of the automaton (:mod:`cnc.gcode.kernels.automaton`) say where a group begins, and which
bytes are a number, a name or a comment. A line that the grammar does not read stays as it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.gcode.kernels.automaton import Events, Results

Bytes = NDArray[np.uint8]
Counts = NDArray[np.int32]
Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

PLAIN, LETTER, NUMBER, SIGN, SLASH, REMARK, AS_WRITTEN, CAPITALS, OPERATOR = range(9)
"""Kinds of terminals. PLAIN has no blanks; an OPERATOR is a word of letters between blanks."""
MEANINGLESS, END_NAMES, STAY = range(3)
"""Meanings of blanks outside of comments."""
MOTION, FEED, INVERSE = range(3)
"""Rows of the state: G0 to G3 of the last line (-1: none), its F (NaN: none), if G93 came."""

_BLANK, _TAB, _PLUS, _DOT, _ZERO, _NINE, _LEFT = 32, 9, 43, 46, 48, 57, 91
_EXACT = b"DHLNOPT"
"""Letters of words whose digits stay: numbers of tools, offsets, programs and lines."""
_ORDER = b"NGXYZABCUVWIJK"
"""Words in their order; all others stay behind them as they are written."""
_ORDERED = b"NGXYZABCUVWIJKFSMT"
"""Letters of a line whose words are put in order. Others belong to the code before them."""
_AXES = b"XYZABCUVW"
_SWITCHES = (3.0, 4.0, 5.0, 7.0, 8.0, 9.0)
"""M codes that do not change the motion code."""


def _flags(letters: bytes) -> Bytes:
    flags = np.zeros(256, np.uint8)
    flags[list(letters)] = 1
    return flags


_IS_EXACT, _IS_ORDERED, _IS_AXIS = _flags(_EXACT), _flags(_ORDERED), _flags(_AXES)
_RANK = np.full(256, len(_ORDER), np.int64)
_RANK[list(_ORDER)] = np.arange(len(_ORDER))


class Meaning(NamedTuple):
    """What the symbols of a grammar mean for the form of a line.

    Attributes:
        terminal: (t,) kind of each terminal.
        begins: (r,) whether a group begins with each rule.
        names: whether blanks are MEANINGLESS, or STAY, or END_NAMES: one stays between two names.
        signs: 1 if a plus sign stays.
    """

    terminal: Bytes
    begins: Bytes
    names: int
    signs: int


class Style(NamedTuple):
    """The form, each 0 or 1.

    Attributes:
        blanks: blanks between groups, the indentation, and a 0 before a decimal point.
        ordered: put words in order.
        numbered: keep block numbers.
        repeated: keep a motion code and a feed that are in effect already.
    """

    blanks: int
    ordered: int
    numbered: int
    repeated: int


class Draft(NamedTuple):
    """Space for one line.

    Attributes:
        text: the groups, one behind another.
        begins: 1 at each byte of the line with which a group begins.
        first: begin of each group in ``text``; ``last`` its end.
        last: see ``first``.
        letter: letter of a word with a written number; 0 for another group.
        number: that number.
        order: the groups in the order in which they are written; ``-1 - group`` is left out.
    """

    text: Bytes
    begins: Bytes
    first: Ints
    last: Ints
    letter: Bytes
    number: Floats
    order: Ints


def draft(longest: int) -> Draft:
    """Return space for lines of up to ``longest`` bytes."""
    most = longest + 8
    return Draft(
        np.empty(4 * most, np.uint8),
        np.zeros(most, np.uint8),
        np.empty(most, np.int64),
        np.empty(most, np.int64),
        np.empty(most, np.uint8),
        np.empty(most),
        np.empty(most, np.int64),
    )


@njit
def format_lines(
    text: Bytes,
    places: tuple[Counts, Counts],
    events: Events,
    results: Results,
    meaning: Meaning,
    style: Style,
    state: Floats,
    space: Draft,
    out: Bytes,
) -> int:
    """Write lines in their form; return the number of bytes.

    Args:
        text: the bytes of the lines.
        places: (lines,) begin and end of each line in them, without its line end, which stays.
        events: tokens and rules of all lines.
        results: index of the first event of each line, and whether it was read.
        meaning: meaning of the grammar's symbols.
        style: the form.
        state: MOTION, FEED and INVERSE, carried from one call to the next.
        space: space for the longest line.
        out: receives the bytes: at least 4 a byte of the text.
    """
    begins, ends = places
    size = 0
    for line in range(len(begins)):
        begin, end = begins[line], ends[line]
        following = begins[line + 1] if line + 1 < len(begins) else len(text)
        if results.status[line] == 0 and end - begin + 8 <= len(space.begins):
            span = results.first[line], results.first[line + 1]
            groups = _divide(text, (begin, end), events, span, meaning, style, space)
            _arrange(space, groups, style, state)
            size = _write(text, begin, space, groups, style, out, size)
        else:
            size = _copy(text, begin, end, out, size)
            state[MOTION], state[FEED] = -1.0, np.nan
        size = _copy(text, end, following, out, size)
    return size


@njit
def _copy(text: Bytes, begin: int, end: int, out: Bytes, size: int) -> int:
    for at in range(begin, end):
        out[size] = text[at]
        size += 1
    return size


@njit
def _divide(
    text: Bytes,
    line: tuple[int, int],
    events: Events,
    span: tuple[int, int],
    meaning: Meaning,
    style: Style,
    space: Draft,
) -> int:
    """Write the groups of a line to the draft; return their number."""
    begin, end = line
    space.begins[: end - begin + 1] = 0
    for event in range(span[0], span[1]):
        kind = events.kind[event]
        starts = meaning.begins[-kind - 1] if kind < 0 else meaning.terminal[kind - 1] == REMARK
        if starts:
            space.begins[events.begin[event] - begin] = 1
    groups, size, at, event = 0, 0, begin, span[0]
    before, earlier = PLAIN, PLAIN  # kinds of the last two tokens
    letter, pending, glued = 0, False, False
    while at < end:
        while event < span[1] and (events.kind[event] < 0 or events.begin[event] < at):
            event += 1
        is_token = event < span[1] and events.begin[event] == at
        byte = text[at]
        if not is_token and (byte == _BLANK or byte == _TAB):
            pending = pending or meaning.names != MEANINGLESS
            at += 1
            continue
        if groups == 0 or (space.begins[at - begin] and not glued):
            if groups:
                space.last[groups - 1] = size
            space.first[groups], space.letter[groups] = size, 0
            groups += 1
            pending, before, earlier = False, PLAIN, PLAIN
        start = space.first[groups - 1]
        glued = False
        kind = meaning.terminal[events.kind[event] - 1] if is_token else PLAIN
        if kind == OPERATOR and not 65 <= _capital(byte) <= 90:
            kind = PLAIN  # a sign such as *
        if kind == OPERATOR and style.blanks:
            pending = True
        if (
            pending
            and size > start
            and _is_apart(space.text[size - 1], byte, kind, before, meaning)
        ):
            space.text[size] = _BLANK
            size += 1
        pending = False
        if not is_token:
            space.text[size] = _capital(byte)
            size += 1
            at += 1
            earlier, before = before, PLAIN
            continue
        after = events.end[event]
        if kind == NUMBER:
            is_word = before == LETTER or (before == SIGN and earlier == LETTER)
            exact = not is_word or _IS_EXACT[letter] or meaning.signs == 1
            negative = before == SIGN and size > start and space.text[size - 1] != _PLUS
            if is_word and space.text[start] == letter:
                space.letter[groups - 1] = letter
                value = events.value[event]
                space.number[groups - 1] = -value if before == SIGN and negative else value
            size = _number(text, at, after, space.text, size, exact, style.blanks == 1)
        elif kind == SIGN and byte == _PLUS and before == LETTER and not meaning.signs:
            pass
        elif kind == REMARK or kind == AS_WRITTEN:
            size = _copy(text, at, after, space.text, size)
        else:
            for place in range(at, after):
                if text[place] != _BLANK and text[place] != _TAB:
                    space.text[size] = _capital(text[place])
                    size += 1
                elif kind == CAPITALS and space.text[size - 1] != _BLANK:
                    space.text[size] = _BLANK
                    size += 1
            if kind == LETTER:
                letter = _capital(byte) if after == at + 1 else 0
        glued = kind == SLASH and groups == 1 and size == 1
        pending = kind == OPERATOR and style.blanks == 1
        earlier, before, at = before, kind, after
    if groups:
        space.last[groups - 1] = size
    return groups


@njit
def _capital(byte: int) -> int:
    return byte - 32 if 97 <= byte <= 122 else byte


@njit
def _is_name(byte: int) -> bool:
    """Return whether a byte may stand in a name or number."""
    return (
        _ZERO <= byte <= _NINE
        or 65 <= byte <= 90
        or 97 <= byte <= 122
        or byte in (_DOT, 95)
        or byte > 127
    )


@njit
def _is_apart(last: int, byte: int, kind: int, before: int, meaning: Meaning) -> bool:
    """Return whether a blank stands between two bytes that had one, or beside an operator."""
    if kind == OPERATOR or before == OPERATOR:
        return last != _LEFT and last != _BLANK
    return meaning.names == STAY or (_is_name(last) and _is_name(byte))


@njit
def _number(
    text: Bytes, begin: int, end: int, out: Bytes, size: int, exact: bool, zero: bool
) -> int:
    """Write a number: as written, or without zeros that mean nothing. The point stays."""
    first = size
    for at in range(begin, end):
        if text[at] != _BLANK and text[at] != _TAB:
            out[size] = text[at]
            size += 1
    if exact:
        return size
    point = first
    while point < size and out[point] != _DOT:
        point += 1
    start = first
    while start < point - 1 and out[start] == _ZERO:
        start += 1
    last = size
    if point < size:
        while last > point + 1 and out[last - 1] == _ZERO:
            last -= 1
    fraction = last > point + 1
    whole = point > start and not (point == start + 1 and out[start] == _ZERO)
    if fraction and not whole and not zero:
        start = point  # .5
    adds = fraction and point == first and zero
    shift = first - start + (1 if adds else 0)
    if shift > 0:
        for at in range(last - 1, start - 1, -1):
            out[at + shift] = out[at]
        out[first] = _ZERO
    elif shift < 0:
        for at in range(start, last):
            out[at + shift] = out[at]
    return last + shift


@njit
def _arrange(space: Draft, groups: int, style: Style, state: Floats) -> None:
    """Put the groups of a line in order, leave some out, and follow the state."""
    is_words, is_ordered, has_axis, is_changed = True, style.ordered == 1, False, False
    motion, feed = -1.0, np.nan
    at_motion, at_feed, count = -1, -1, 0
    for group in range(groups):
        space.order[group] = group
        letter, number = space.letter[group], space.number[group]
        if letter == 0:
            is_remark = space.text[space.first[group]] in (40, 59) and group == groups - 1
            is_words = is_words and is_remark
            continue
        count += 1
        has_axis = has_axis or _IS_AXIS[letter] == 1
        is_ordered = is_ordered and _IS_ORDERED[letter] == 1
        for other in range(group):
            if space.letter[other] == letter and letter != 71 and letter != 77:
                is_words = False
        if letter == 71:  # G
            if number in (0.0, 1.0, 2.0, 3.0):
                motion, at_motion = number, group
            else:
                is_changed = True
                state[INVERSE] = 1.0 if number == 93.0 else state[INVERSE]
        elif letter == 77:  # M
            is_changed = is_changed or number not in _SWITCHES
        elif letter == 70:  # F
            feed, at_feed = number, group
        elif letter == 84:  # T
            is_changed = True
        elif letter == 78 and not style.numbered and groups > 1:  # N
            space.order[group] = -1 - group
    if count and not is_words:
        is_changed = True
    if not style.repeated and is_words and has_axis and not is_changed:
        if at_motion >= 0 and motion == state[MOTION]:
            space.order[at_motion] = -1 - at_motion
        if at_feed >= 0 and feed == state[FEED] and state[INVERSE] == 0.0:
            space.order[at_feed] = -1 - at_feed
    if is_changed or (groups and not count and not is_words):
        state[MOTION], state[FEED] = -1.0, np.nan
    else:
        state[MOTION] = motion if motion >= 0.0 else state[MOTION]
        state[FEED] = state[FEED] if math.isnan(feed) else feed
    if is_ordered and is_words:
        _sort(space, groups)


@njit
def _sort(space: Draft, groups: int) -> None:
    """Sort the words of a line; words of one rank stay as they are written."""
    for group in range(1, groups):
        moved = space.order[group]
        rank = _rank(space, moved)
        at = group
        while at > 0 and _rank(space, space.order[at - 1]) > rank:
            space.order[at] = space.order[at - 1]
            at -= 1
        space.order[at] = moved


@njit
def _rank(space: Draft, group: int) -> int:
    """Return the rank of a group that is written or left out; that of others is the last."""
    return _RANK[space.letter[group if group >= 0 else -1 - group]]


@njit
def _write(
    text: Bytes, begin: int, space: Draft, groups: int, style: Style, out: Bytes, size: int
) -> int:
    """Write the groups of a line to the text."""
    if style.blanks and groups:
        while text[begin] == _BLANK or text[begin] == _TAB:
            out[size] = text[begin]
            size += 1
            begin += 1
    first = size
    for place in range(groups):
        group = space.order[place]
        if group >= 0:
            if style.blanks and size > first:
                out[size] = _BLANK
                size += 1
            size = _copy(space.text, space.first[group], space.last[group], out, size)
    return size
