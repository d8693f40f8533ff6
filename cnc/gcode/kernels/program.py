"""Lines with expressions and control flow, executed in the order of the program.

Control lines are executed once by the interpreter, which finds the lines that belong together. It
enters them into a table; from then on they are executed here.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.gcode.kernels.arithmetic import (
    INDIRECT,
    NAMED,
    NUMBER,
    PARAMETER,
    binary,
    takes_two,
    unary,
)
from cnc.gcode.kernels.line import execute_line
from cnc.gcode.kernels.rows import BOUNDARY, MOST_ROWS, Record, Rows, Setup
from cnc.gcode.kernels.rules import (
    DO,
    END_REPEAT,
    END_WHILE,
    IF,
    LEFT_OUT,
    LOCAL,
    MAX_NUMBER,
    NEAR_WHOLE,
    REPEAT,
    RETURN,
    WHILE,
    asks_value,
    line_after,
)
from cnc.gcode.kernels.statements import (
    CONTROL,
    LAST_PARAMETER,
    MOST_ITEMS,
    MOST_VALUES,
    NUMBERED_ASSIGNMENT,
    SIMPLE,
    UNKNOWN,
    WORDS,
    Code,
    Coded,
    Words,
)

# The lines of a program for compiled code, its control lines and calls, and its progress.

Bytes = NDArray[np.uint8]
Counts = NDArray[np.int32]
Table = NDArray[np.float64]
Flags = NDArray[np.uint8]

Progress = Any

NOWHERE = -(1 << 40)
"""No line."""

PROGRESS = np.dtype(
    [
        ("index", np.int64),
        ("done", np.int64),
        ("executed", np.int64),
        ("new", np.int64),
        ("highest", np.int64),
        ("most_repeated", np.int64),
        ("most_done", np.int64),
        ("begun", np.int64),
        ("last", np.int64),
        ("depth", np.int64),
        ("deepest", np.int64),
        ("marks", np.int64),
        ("scope", np.int64),
        ("returned", np.int64),
        ("value", np.float64),
    ]
)
"""Progress: index of the next line, lines executed in this call and in all, lines executed for the
first time, number of the highest line that was ever executed, the limits of lines that are repeated
and of lines of a call, whether a word was executed, number of the last line that was no control
line (-1 for none), calls within each other, the limit of these,
whether calls of the main program are marked, index of the first line of the subroutine around all
(-1 for none), whether a call or return was executed, and the value of the last return (NaN for
none).
"""


class Control(NamedTuple):
    """What the interpreter knows about the control lines of a text.

    Attributes:
        action: (lines,) actions.
        target: (lines,) index of the line to which each leads.
        other: (lines,) index of the next elseif of an IF (-1 for none), or of the first line of the
            loop that the line ends, or of the subroutine that it ends (-1 for any).
        since: (lines,) number of executed lines when a loop was entered; -1 for not in this call.
        rounds: (lines,) rounds left of a REPEAT; 0 if it was not entered.
        sub: (labels,) index of the first line of each subroutine; -1 for an unknown one.
    """

    action: Bytes
    target: Counts
    other: Counts
    since: Ints
    rounds: Ints
    sub: Counts


class Text(NamedTuple):
    """The lines of a text.

    Attributes:
        line: (lines,) their numbers.
        first: (lines + 1,) index of the first word of each simple line.
        words: The words of simple lines.
        coded: The other lines.
        control: The control lines.
    """

    line: Ints
    first: Counts
    words: Words
    coded: Coded
    control: Control


class Frames(NamedTuple):
    """Calls within each other, and what they restore; n calls, m names of the text.

    Attributes:
        back: (n,) index of the line after the call.
        sub: (n,) index of the first line of the subroutine.
        numbered: (n, LOCAL + 1) local parameters of the caller.
        numbered_changes: (n, LOCAL + 1) their flags.
        slot: (m,) slots of the names that are not global.
        named: (n, m) the caller's values of these names.
        named_changes: (n, m) their flags.
    """

    back: Ints
    sub: Ints
    numbered: Table
    numbered_changes: Flags
    slot: Counts
    named: Table
    named_changes: Flags


class Changes(NamedTuple):
    """Flags of the parameters that were set: by number, and by slot of their name."""

    numbered: Bytes
    named: Bytes


# Values of instructions (:mod:`cnc.gcode.kernels.statements`).
#
# A result that does not exist is NaN. The line is then left to the interpreter, which reports the
# error.


class Parameters(NamedTuple):
    """Values of parameters.

    Attributes:
        numbered: (LAST_PARAMETER + 1,) values by number; NaN for one of the interpreter.
        named: (slots,) values of named parameters; NaN for one of the interpreter.
        slot: (names,) slot of each name of the text.
    """

    numbered: Floats
    named: Floats
    slot: Counts


@njit
def number_of(value: float) -> int:
    """Return the number of a parameter from a computed value; 0 for one of the interpreter."""
    if not 0.5 < value < LAST_PARAMETER + 0.5:
        return 0
    whole = int(value + 0.5)
    return whole if abs(value - whole) <= NEAR_WHOLE else 0


@njit
def evaluate(code: Code, at: int, end: int, parameters: Parameters, stack: Floats) -> float:
    """Return the value of instructions, or NaN if the interpreter must compute it.

    Args:
        code: The instructions of the text.
        at: The first instruction.
        end: The instruction after the last.
        parameters: The parameters.
        stack: (MOST_VALUES,) scratch space.
    """
    height = 0
    for k in range(at, end):
        operation = int(code.operation[k])
        if operation == NUMBER:
            stack[height] = code.number[k]
            height += 1
            continue
        if operation == PARAMETER:
            result = parameters.numbered[int(code.number[k])]
            height += 1
        elif operation == NAMED:
            result = parameters.named[parameters.slot[int(code.number[k])]]
            height += 1
        elif operation == INDIRECT:
            index = number_of(stack[height - 1])
            result = parameters.numbered[index] if index else math.nan
        elif takes_two(operation):
            height -= 1
            result = binary(operation, stack[height - 1], stack[height])
        else:
            result = unary(operation, stack[height - 1])
        # NaN, too, is not finite.
        if not -math.inf < result < math.inf:
            return math.nan
        stack[height - 1] = result
    return stack[0]


Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

_MOST_ROUNDS = 1e15


@njit
def _assign(
    coded: Coded, a: int, b: int, parameters: Parameters, changes: Changes, values: Floats,
    places: Ints, stack: Floats,
) -> bool:  # fmt: skip
    """Execute the assignments of a line: all values are computed before the first is set."""
    code = coded.code
    for item in range(a, b, 2):
        first, last = int(coded.begin[item]), int(coded.end[item])
        operation = int(code.operation[last - 1])
        if operation == NAMED:
            slot = parameters.slot[int(code.number[last - 1])]
            place = -1 - slot
            if changes.named[slot] > 1:
                return False
        else:
            # The last instruction reads the parameter; the others compute its number.
            place = (
                int(code.number[last - 1])
                if operation == PARAMETER
                else number_of(evaluate(code, first, last - 1, parameters, stack))
            )
            if place <= 0 or changes.numbered[place] > 1:
                return False
        value = evaluate(code, coded.begin[item + 1], coded.end[item + 1], parameters, stack)
        if value != value:
            return False
        places[item - a] = place
        values[item - a] = value
    for item in range(0, b - a, 2):
        if places[item] < 0:
            parameters.named[-1 - places[item]] = values[item]
            changes.named[-1 - places[item]] = 1
        else:
            parameters.numbered[places[item]] = values[item]
            changes.numbered[places[item]] = 1
    return True


@njit
def _call(
    k: int, text: Text, parameters: Parameters, changes: Changes, frames: Frames, here: Progress,
    values: Floats, stack: Floats,
) -> int:  # fmt: skip
    """Enter the subroutine that line ``k`` calls; return the line to continue at, or NOWHERE."""
    coded, depth, sub = text.coded, int(here["depth"]), int(text.control.sub[text.coded.label[k]])
    known = depth < here["deepest"] and sub >= 0 and sub != here["scope"]
    for outer in range(depth):
        # A subroutine that calls itself has the rounds of its loops once for each call.
        known = known and frames.sub[outer] != sub
    a, b = int(coded.first[k]), int(coded.first[k + 1])
    known = known and b - a <= LOCAL
    for item in range(a, b):
        value = evaluate(coded.code, coded.begin[item], coded.end[item], parameters, stack)
        known = known and value == value
        values[item - a] = value
    if not known:
        return NOWHERE
    frames.back[depth], frames.sub[depth] = k + 1, sub
    for number in range(1, LOCAL + 1):
        frames.numbered[depth, number] = parameters.numbered[number]
        frames.numbered_changes[depth, number] = changes.numbered[number]
        given = number <= b - a
        parameters.numbered[number] = values[number - 1] if given else 0.0
        changes.numbered[number] = given
    for m in range(len(frames.slot)):
        slot = frames.slot[m]
        frames.named[depth, m] = parameters.named[slot]
        frames.named_changes[depth, m] = changes.named[slot]
        if changes.named[slot] <= 1:
            parameters.named[slot] = np.nan
            changes.named[slot] = 0
    here["depth"], here["returned"], here["value"] = depth + 1, 1, np.nan
    return sub + 1


@njit
def _leave(
    k: int, text: Text, parameters: Parameters, changes: Changes, frames: Frames, here: Progress,
    stack: Floats,
) -> int:  # fmt: skip
    """Return to the caller; return the line to continue at, or NOWHERE."""
    coded, depth, sub = text.coded, int(here["depth"]) - 1, int(text.control.other[k])
    if depth < 0 or (sub >= 0 and frames.sub[depth] != sub):
        return NOWHERE
    item, result = int(coded.first[k]), np.nan
    if item < coded.first[k + 1]:
        result = evaluate(coded.code, coded.begin[item], coded.end[item], parameters, stack)
        if result != result:
            return NOWHERE
    for number in range(1, LOCAL + 1):
        parameters.numbered[number] = frames.numbered[depth, number]
        changes.numbered[number] = frames.numbered_changes[depth, number]
    for m in range(len(frames.slot)):
        parameters.named[frames.slot[m]] = frames.named[depth, m]
        changes.named[frames.slot[m]] = frames.named_changes[depth, m]
    here["depth"], here["returned"], here["value"] = depth, 1, result
    return int(frames.back[depth])


@njit
def _mark(rows: Rows, state: Record, line: int, inside: bool) -> None:
    """Append a row for the begin or the end of a call."""
    row = state[0]["rows"]
    rows.kinds[row], rows.lines[row], rows.data[row, 0] = BOUNDARY, line, inside
    state[0]["rows"] += 1


@njit
def _value(k: int, coded: Coded, parameters: Parameters, stack: Floats) -> float:
    """Return the value of a control line that has one."""
    item = coded.first[k]
    return evaluate(coded.code, coded.begin[item], coded.end[item], parameters, stack)


@njit
def _next_line(
    k: int, executed: int, coded: Coded, control: Control, parameters: Parameters, stack: Floats
) -> int:
    """Return the index of the line after a control line; NOWHERE for the interpreter."""
    action = int(control.action[k])
    target, other = int(control.target[k]), int(control.other[k])
    if action == LEFT_OUT or (action == END_REPEAT and control.rounds[other] <= 0):
        return NOWHERE
    asked = other if action == END_WHILE else k
    counted = other if action == END_REPEAT else k
    value = _value(asked, coded, parameters, stack) if asks_value(action) else 0.0
    after, rounds = line_after(action, value, float(control.rounds[counted]), k, target)
    while action == IF and after == target and value == value and control.other[asked] >= 0:
        asked = int(control.other[asked])
        value = _value(asked, coded, parameters, stack)
        after, _ = line_after(IF, value, 0.0, asked, target)
    if value != value or rounds > _MOST_ROUNDS:
        return NOWHERE
    if action == WHILE or action == DO or action == REPEAT:
        control.since[k] = executed
    if action == REPEAT or action == END_REPEAT:
        control.rounds[counted] = int(rounds)
    return after


@njit
def _word_line(
    line: int, k: int, coded: Coded, parameters: Parameters, setup: Setup, state: Record,
    position: Floats, rows: Rows, values: Floats, stack: Floats,
) -> bool:  # fmt: skip
    """Execute a line of words with expressions; False if it is left to the interpreter."""
    a, b = int(coded.first[k]), int(coded.first[k + 1])
    for item in range(a, b):
        value = evaluate(coded.code, coded.begin[item], coded.end[item], parameters, stack)
        # Not for NaN, too.
        if not -MAX_NUMBER <= value <= MAX_NUMBER:
            return False
        values[item - a] = value
    return execute_line(coded.letter[a:b], values[: b - a], line, setup, state, position, rows)


@njit
def run(
    text: Text,
    parameters: Parameters,
    changes: Changes,
    frames: Frames,
    setup: Setup,
    state: Record,
    position: Floats,
    rows: Rows,
    progress: Record,
) -> None:
    """Execute lines until one is left to the interpreter, or the rows are full.

    Args:
        text: The lines.
        parameters: The parameters, brought up to date.
        changes: Flags of parameters: 1 for one that was set, which is filled in; 2 for one that the
            interpreter must set.
        frames: Space for calls.
        setup: Settings.
        state: Modal state, brought up to date.
        position: (n,) the position, brought up to date.
        rows: Takes the rows.
        progress: The line to begin at and the limits, brought up to date.
    """
    first, words, coded, control = text.first, text.words, text.coded, text.control
    stack, values = np.empty(MOST_VALUES), np.empty(MOST_ITEMS)
    places = np.empty(MOST_ITEMS, np.int64)
    here, now = progress[0], state[0]
    k, done, begun = int(here["index"]), 0, int(here["begun"])
    executed, highest, new = int(here["executed"]), int(here["highest"]), int(here["new"])
    while 0 <= k < len(coded.kind) and done < here["most_done"]:
        kind = int(coded.kind[k])
        line = int(text.line[k])
        is_new = int(line > highest)
        # A line counts as executed before it is.
        full = now["rows"] + MOST_ROWS > len(rows.kinds)
        if full or executed + 1 - new - is_new > here["most_repeated"]:
            break
        after = k + 1
        if kind == SIMPLE:
            a, b = first[k], first[k + 1]
            if a < b and not execute_line(
                words.letter[a:b], words.number[a:b], line, setup, state, position, rows
            ):
                break
            begun |= int(a < b)
        elif kind == CONTROL:
            action = control.action[k]
            if coded.label[k] >= 0:
                inside = here["depth"] > 0
                after = _call(k, text, parameters, changes, frames, here, values, stack)
                if after == NOWHERE:
                    break
                if here["marks"] and not inside:
                    _mark(rows, state, line, True)
            elif action == RETURN:
                after = _leave(k, text, parameters, changes, frames, here, stack)
                if after == NOWHERE:
                    break
                if here["marks"] and here["depth"] == 0:
                    _mark(rows, state, int(text.line[after - 1]), False)
            else:
                after = _next_line(k, executed + 1, coded, control, parameters, stack)
                if after == NOWHERE:
                    break
        elif kind == WORDS:
            if not _word_line(
                line, k, coded, parameters, setup, state, position, rows, values, stack
            ):
                break
            begun = 1
        else:
            a, b = int(coded.first[k]), int(coded.first[k + 1])
            if kind == UNKNOWN or not _assign(
                coded, a, b, parameters, changes, values, places, stack
            ):
                break
            begun |= int(kind == NUMBERED_ASSIGNMENT)
        if after == k + 1 and kind != CONTROL and (kind != SIMPLE or first[k] < first[k + 1]):
            here["last"] = line
        executed += 1
        new += is_new
        highest = max(highest, line)
        k = after
        done += 1
    here["index"], here["done"], here["begun"] = k, done, begun
    here["executed"], here["highest"], here["new"] = executed, highest, new
