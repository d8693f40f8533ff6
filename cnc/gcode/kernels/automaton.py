"""The automaton that reads lines of text: longest tokens, and the LALR parser of a grammar.

It writes *events*: the tokens that are kept, and the rules behind their parts. So the events of an
expression are its instructions in reverse Polish order. A rule that makes no node has no event; the
nodes of its parts belong to the rule around it.

Source: Aho, Lam, Sethi, Ullman, "Compilers", second edition, 3.8 (lexical analysis by a finite
automaton) and 4.6 to 4.7 (LR parsing).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit

Bytes = NDArray[np.uint8]
Small = NDArray[np.int16]
States = NDArray[np.uint16]
Counts = NDArray[np.int32]
Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

OTHER = 128
"""Column of the automaton for all characters that are not ASCII."""
SKIPPED, REFUSED = 129, 130
"""Classes of bytes: a blank that has no meaning, and a control character."""
OK, WRONG, TOO_LONG = 0, 1, 2
"""Status of a line."""
NONE = 0xFFFF
"""No state, no terminal. The tables have no signs, which makes them faster to index."""
INLINED, NODE_OF_SEVERAL, NODE = 0, 1, 2
"""Kinds of rules: without a node; with one unless it has a single part; with a node."""
DIGITS = 18
"""Most digits of a number: any number of so many digits fits into an int64."""
EXACT = 1 << 53
_POWERS = np.array([float(f"1e{k}") for k in range(DIGITS + 1)])
_ZERO, _NINE, _DOT, _BLANK, _SEMICOLON, _LESS = 48, 57, 46, 32, 59, 60


class Tables(NamedTuple):
    """The tables of a grammar; n states of the lexers, s of the parser, t terminals, r rules.

    A *row* says how the parser goes on after a terminal or a rule: which state it has, and what it
    does, by the next terminal. NONE stands for no state and no terminal.

    Attributes:
        moves: (n, 129) the next state of the lexers by character.
        final: (n,) 1 if no longer token can follow.
        start: (rows,) state of the lexers at the begin of the next token.
        token: (n,) the terminal that a state accepts.
        spelling: (n,) index of the text of a keyword, -1 for another terminal.
        reached: (rows,) state of the parser before the next terminal is seen.
        pair: (s, nonterminals) row after a rule.
        after: (rows, t + 1) state of the parser, by the next terminal; the last column is the end.
        action: (rows, t + 1) next row + 1, -rule - 1, or 0 for an error.
        length: (r,) number of symbols of a rule.
        left: (r,) its nonterminal.
        kind: (r,) its kind.
        kept: (t,) 1 for a terminal that has an event.
        ignored: (t,) whether it may stand anywhere and means nothing.
        number: (t,) whether it is a number without a sign.
        ends: the first row, and the last state of the parser.
    """

    moves: States
    final: Bytes
    start: States
    token: States
    spelling: Small
    reached: States
    pair: States
    after: States
    action: Small
    length: Ints
    left: States
    kind: Bytes
    kept: Ints
    ignored: Bytes
    number: Bytes
    ends: Ints


class Events(NamedTuple):
    """Tokens and rules in the order in which the parser meets them.

    Attributes:
        kind: (events,) terminal + 1, or -rule - 1.
        begin: (events,) position of the first byte.
        end: (events,) position after the last byte.
        value: (events,) number of a NUMBER (NaN for one with too many digits), index of the text of
            a keyword, number of parts of a rule.
    """

    kind: Small
    begin: Counts
    end: Counts
    value: Floats


class Results(NamedTuple):
    """What is known about each line.

    Attributes:
        first: (lines + 1,) index of its first event; a faulty line has none.
        status: (lines,) status.
        place: (lines,) position of the fault.
        state: (lines,) state of the parser at the fault.
    """

    first: Counts
    status: Bytes
    place: Counts
    state: Small


@njit
def _has_semicolon(data: Bytes, begin: int, end: int) -> bool:
    """Return whether a text has a semicolon."""
    for i in range(begin, end):  # noqa: SIM110 numba compiles no generator
        if data[i] == _SEMICOLON:
            return True
    return False


@njit
def _longest_token(
    data: Bytes, at: int, stop: int, here: int, tables: Tables, classes: Bytes, loose: bool
) -> tuple[int, int]:
    """Return the end of the longest token at ``at``, and the state of the lexers there.

    The state accepts no token if there is none. Blanks count if ``loose``.
    """
    end, there, place = at, here, at
    while place < stop:
        column = classes[data[place]]
        place += 1
        if column == REFUSED:
            break
        if column == SKIPPED:
            loose = loose or (data[at] == _LESS and _has_semicolon(data, at, place))
            if not loose:
                continue
            column = _BLANK
        here = tables.moves[here, column]
        if here == NONE:
            break
        if tables.token[here] != NONE:
            end, there = place, here
    return end, int(there)


@njit
def _number(data: Bytes, begin: int, end: int) -> float:
    """Return a number without a sign; NaN for one with too many digits.

    Numerator and power of ten are exact, so one division gives the correctly rounded number.
    Source: Clinger, "How to read floating point numbers accurately", PLDI 1990.
    """
    mantissa = digits = decimals = 0
    pointed = False
    for k in range(begin, end):
        char = int(data[k])
        if _ZERO <= char <= _NINE:
            mantissa = mantissa * 10 + char - _ZERO
            digits += 1
            decimals += pointed
        elif char == _DOT:
            pointed = True
    # More digits than fit have overflowed by now, which is why they are counted.
    if digits > DIGITS or mantissa > EXACT:
        return math.nan
    return mantissa / _POWERS[decimals]


@njit
def read(
    data: Bytes, begins: Counts, ends: Counts, longest: int, tables: Tables, classes: Bytes,
    stack: Ints, events: Events, results: Results,
) -> int:  # fmt: skip
    """Read lines of a text.

    Args:
        data: The text.
        begins: (lines,) position of the first byte of each line.
        ends: (lines,) position after the last byte.
        longest: A line of more bytes is not read.
        tables: The grammar.
        classes: (256,) column of each byte in the automaton, SKIPPED or REFUSED.
        stack: (3, longest + 8) scratch space.
        events: Takes the events. A line for which there is no space is TOO_LONG.
        results: Filled.

    Returns:
        The number of events.
    """
    moves, final, start, token_of = tables.moves, tables.final, tables.start, tables.token
    action, pair, after = tables.action, tables.pair, tables.after
    # Blanks between tokens are passed where they end a token, too.
    gaps = False
    for k in range(len(tables.ignored)):
        gaps = gaps or tables.ignored[k] != 0
    kind, begin_of, end_of, value_of = events
    states, firsts, before = stack[0], stack[1], stack[2]
    end_token, most = action.shape[1] - 1, len(kind)
    count = 0
    for line in range(len(begins)):
        results.first[line] = count
        results.status[line] = OK
        at, stop = int(begins[line]), int(ends[line])
        if stop - at > longest:
            results.status[line] = TOO_LONG
            continue
        top = nodes = 0
        last = at
        row = tables.ends[0]
        state = tables.reached[row]
        # Blanks behind a semicolon count: LinuxCNC takes it for a comment, even in a name.
        loose = False
        while True:
            while at < stop and classes[data[at]] == SKIPPED and not loose:
                at += 1
            while gaps and at < stop and classes[data[at]] == _BLANK:
                at += 1
            token, end, value = end_token, at, 0.0
            if at < stop:
                here, place, blocked = start[row], at, False
                while place < stop:
                    column = classes[data[place]]
                    if column >= SKIPPED:
                        blocked = column == REFUSED or loose or data[at] == _LESS
                        if blocked:
                            break
                        place += 1
                        continue
                    following = moves[here, column]
                    if following == NONE:
                        break
                    here = following
                    place += 1
                    end = place
                    if final[here]:
                        break
                if token_of[here] == NONE or blocked:
                    # The text goes on after its longest token, or a blank may belong to a name.
                    end, here = _longest_token(data, at, stop, start[row], tables, classes, loose)
                token = int(token_of[here])
                if token == NONE:
                    state = tables.reached[row]
                    break
                if tables.ignored[token]:
                    at = end
                    continue
                if tables.number[token]:
                    value = _number(data, at, end)
                else:
                    value = float(tables.spelling[here])
            states[top] = state = after[row, token]
            act = action[row, token]
            while act < 0 and count < most:
                rule = -act - 1
                top += 1 - tables.length[rule]
                if tables.length[rule] == 0:
                    firsts[top], before[top], last = at, nodes, at
                parts = nodes - before[top]
                sort = tables.kind[rule]
                if sort == NODE or (sort == NODE_OF_SEVERAL and parts != 1):
                    kind[count], value_of[count] = act, parts
                    begin_of[count], end_of[count] = firsts[top], last
                    count += 1
                    nodes = before[top] + 1
                row = pair[states[top - 1], tables.left[rule]]
                states[top] = state = after[row, token]
                act = action[row, token]
            if act <= 0 or token == end_token or count == most:
                break
            row = act - 1
            top += 1
            firsts[top], before[top], last = at, nodes, end
            kind[count], value_of[count] = token + 1, value
            begin_of[count], end_of[count] = at, end
            count += tables.kept[token]
            nodes += tables.kept[token]
            loose = loose or (data[at] == _LESS and _has_semicolon(data, at, end))
            at = end
        if count == most:
            results.status[line] = TOO_LONG
            count = results.first[line]
        elif state != tables.ends[1] or token != end_token:
            results.status[line] = WRONG
            results.place[line], results.state[line] = at, state
            count = results.first[line]
    results.first[len(begins)] = count
    return count
