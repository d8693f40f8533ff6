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

from cnc.kernels.jit import njit

Bytes = NDArray[np.uint8]
Small = NDArray[np.int16]
Counts = NDArray[np.int32]
Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

OTHER = 128
"""Column of the automaton for all characters that are not ASCII."""
SKIPPED, REFUSED = 129, 130
"""Classes of bytes: a blank that has no meaning, and a control character."""
OK, WRONG, TOO_LONG = 0, 1, 2
"""Status of a line."""
DIGITS = 18
"""Most digits of a number: any number of so many digits fits into an int64."""
EXACT = 1 << 53
_POWERS = np.array([float(f"1e{k}") for k in range(DIGITS + 1)])
_ZERO, _NINE, _DOT, _BLANK, _SEMICOLON, _LESS = 48, 57, 46, 32, 59, 60


class Tables(NamedTuple):
    """The tables of a grammar; n states of the lexers, s of the parser, t terminals, r rules.

    Attributes:
        moves: (n, 129) the next state of the lexers by character, -1 for none.
        final: (n,) 1 if no longer token can follow.
        lexer: (s,) lexer of each state of the parser.
        token: (lexers, n) the terminal that a state accepts, -1 for none.
        spelling: (t, n) index of the text of a keyword, -1 for another terminal.
        action: (s, t + 1) next state + 1, -rule - 1, or 0 for an error; the last column is the end.
        pair: (s, nonterminals) row of ``after``.
        after: (pairs, t + 1) state after a rule, by the next terminal.
        length: (r,) number of symbols of a rule.
        left: (r,) its nonterminal.
        kind: (r,) 0 for a rule without a node, 1 for one with a node unless it has one part, 2 for
            one with a node.
        kept: (t,) whether a terminal has an event.
        ignored: (t,) whether it may stand anywhere and means nothing.
        number: (t,) whether it is a number without a sign.
        ends: first and last state of the parser.
    """

    moves: Small
    final: Bytes
    lexer: Small
    token: Small
    spelling: Small
    action: Small
    pair: Small
    after: Small
    length: Small
    left: Small
    kind: Bytes
    kept: Bytes
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
    for i in range(begin, end):
        if data[i] == _SEMICOLON:
            return True
    return False


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
        stack: (4, longest + 8) scratch space.
        events: Takes the events: space for three of each byte, and two of each line.
        results: Filled.

    Returns:
        The number of events.
    """
    moves, final, lexer, token_of = tables.moves, tables.final, tables.lexer, tables.token
    action, after, pair = tables.action, tables.after, tables.pair
    kind, begin_of, end_of, value_of = events
    states, nodes, firsts, lasts = stack[0], stack[1], stack[2], stack[3]
    end_token = action.shape[1] - 1
    count = 0
    for line in range(len(begins)):
        results.first[line] = count
        results.status[line] = OK
        at, stop = int(begins[line]), int(ends[line])
        if stop - at > longest:
            results.status[line] = TOO_LONG
            continue
        before = count
        top = 0
        state = tables.ends[0]
        states[0] = state
        # Blanks behind a semicolon count: LinuxCNC takes it for a comment, even in a name.
        loose = False
        while True:
            while at < stop and classes[data[at]] == SKIPPED and not loose:
                at += 1
            token, end, value = end_token, at, 0.0
            if at < stop:
                own = lexer[state]
                place, here, there = at, 0, 0
                token = -1
                while place < stop:
                    column = classes[data[place]]
                    place += 1
                    if column >= SKIPPED:
                        if column == REFUSED:
                            break
                        if not loose and data[at] == _LESS:
                            loose = _has_semicolon(data, at, place)
                        if not loose:
                            continue
                        column = _BLANK
                    here = moves[here, column]
                    if here < 0:
                        break
                    found = token_of[own, here]
                    if found >= 0:
                        token, end, there = found, place, here
                        if final[here]:
                            break
                if token < 0:
                    break
                if tables.ignored[token]:
                    at = end
                    continue
                if tables.number[token]:
                    mantissa = digits = decimals = 0
                    pointed = False
                    for k in range(at, end):
                        char = int(data[k])
                        if _ZERO <= char <= _NINE:
                            mantissa = mantissa * 10 + char - _ZERO
                            digits += 1
                            decimals += pointed
                        elif char == _DOT:
                            pointed = True
                    # More digits than fit have overflowed by now, which is why they are counted.
                    if digits > DIGITS or mantissa > EXACT:
                        value = math.nan
                    else:
                        value = mantissa / _POWERS[decimals]
                else:
                    value = float(tables.spelling[token, there])
            act = action[state, token]
            while act < 0:
                rule = -act - 1
                length = tables.length[rule]
                parts = 0
                first, last = at, at
                if length > 0:
                    first, last = firsts[top - length + 1], lasts[top]
                    for k in range(top - length + 1, top + 1):
                        parts += nodes[k]
                top -= length
                sort = tables.kind[rule]
                if sort == 2 or (sort == 1 and parts != 1):
                    kind[count], value_of[count] = -rule - 1, parts
                    begin_of[count], end_of[count] = first, last
                    count += 1
                    parts = 1
                state = after[pair[states[top], tables.left[rule]], token]
                top += 1
                states[top], nodes[top], firsts[top], lasts[top] = state, parts, first, last
                act = action[state, token]
            if act == 0 or token == end_token:
                break
            state = act - 1
            top += 1
            states[top], nodes[top], firsts[top], lasts[top] = state, tables.kept[token], at, end
            if tables.kept[token]:
                kind[count], value_of[count] = token + 1, value
                begin_of[count], end_of[count] = at, end
                count += 1
            loose = loose or (data[at] == _LESS and _has_semicolon(data, at, end))
            at = end
        if state != tables.ends[1] or token != end_token:
            results.status[line] = WRONG
            results.place[line], results.state[line] = at, state
            count = before
    results.first[len(begins)] = count
    return count
