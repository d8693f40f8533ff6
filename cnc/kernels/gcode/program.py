"""Lines with expressions and control flow, executed in the order of the program.

Control lines are executed once by the interpreter, which finds the lines that belong together. It
enters them into a table; from then on they are executed here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.gcode.arithmetic import NAMED, PARAMETER
from cnc.kernels.gcode.evaluation import Parameters, evaluate, number_of
from cnc.kernels.gcode.line import execute_line
from cnc.kernels.gcode.program_text import (
    NOWHERE,
    Changes,
    Control,
    Frames,
    Progress,
    Text,
)
from cnc.kernels.gcode.rows import BOUNDARY, MOST_OTHERS, MOST_ROWS, Record, Rows, Setup
from cnc.kernels.gcode.rules import (
    DO,
    END_REPEAT,
    END_WHILE,
    IF,
    LEFT_OUT,
    LOCAL,
    MAX_NUMBER,
    REPEAT,
    RETURN,
    WHILE,
    asks_value,
    line_after,
)
from cnc.kernels.gcode.statements import (
    CONTROL,
    MOST_ITEMS,
    MOST_VALUES,
    NUMBERED_ASSIGNMENT,
    SIMPLE,
    UNKNOWN,
    WORDS,
    Coded,
)
from cnc.kernels.jit import njit

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
    state[0]["others"] += 1


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
        full = now["rows"] + MOST_ROWS > len(rows.kinds) or now["others"] >= MOST_OTHERS
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
