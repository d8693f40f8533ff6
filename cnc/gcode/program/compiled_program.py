"""Lines with expressions and control flow, executed by compiled code.

The interpreter executes a control line once, and finds the lines that belong to it. The line is
then entered into the table of its window, and compiled code executes it from there on.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.program.call_stack import Flow, Frame, Loop, Nothing, Step
from cnc.gcode.program.control_flow import (
    Do,
    DoWhile,
    EndRepeat,
    EndWhile,
    If,
    Jump,
    Repeat,
    While,
)
from cnc.gcode.program.line_index import Place
from cnc.gcode.program.line_machine import MOST_ROWS, LineMachine
from cnc.gcode.program.parameter_mirror import ParameterMirror
from cnc.gcode.program.subprograms import Return
from cnc.gcode.syntax.source_text import KEPT_WINDOWS, Window
from cnc.kernels.gcode import program_text as kernel
from cnc.kernels.gcode.coding import CONTROL, UNKNOWN
from cnc.kernels.gcode.program import run
from cnc.kernels.gcode.rows import MOST_ROWS as MOST_LINE_ROWS

MOST_LINES = 100_000
"""Lines that are executed at once. Ctrl-C takes effect between."""
MOST_CALLS = 8
"""Calls within each other in compiled code."""
MOST_NAMES = 256
"""Names of a window with calls in compiled code, since each call has all of them."""
_FEW_ROWS = 256
START_COST = 20
"""Lines that the interpreter executes in the time that compiled code takes to begin and end."""
MOST_CREDIT = 200
PAUSE = 500
"""Lines that are left to the interpreter after too many short runs."""


@dataclass(slots=True)
class _Table:
    """The lines of a window for compiled code.

    Attributes:
        window: The window.
        text: The lines.
        slots: Slots of the names in the lines.
        frames: Space for calls.
        repeats: Steps of REPEAT by the index of their line.
        labels: Labels of calls.
        loops: Loops by the index of their first line.
        subs: Number of subroutines that are entered.
    """

    window: Window
    text: kernel.Text
    slots: NDArray[np.int32]
    frames: kernel.Frames
    repeats: dict[int, Step]
    labels: list[str]
    loops: dict[int, Loop]
    subs: int = 0


class CompiledProgram:
    """Executes lines of a window in place of an interpreter."""

    def __init__(self, flow: Flow, machine: LineMachine) -> None:
        self._flow = flow
        self._machine = machine
        self._mirror: ParameterMirror | None = None
        self._tables: OrderedDict[tuple[str, int], _Table] = OrderedDict()
        self._progress = np.zeros(1, kernel.PROGRESS)
        self._rows = _FEW_ROWS
        self._credit, self._pause = MOST_CREDIT, 0
        flow.update_loops = self._update_loops

    def knows(self, window: Window, index: int) -> bool:
        """Return whether compiled code may execute a line."""
        return bool(self._table(window).text.coded.kind[index] != UNKNOWN)

    def run(self, window: Window, line: int) -> int | None:
        """Execute lines from ``line`` on.

        Returns:
            The line to continue at; None if nothing was executed.
        """
        flow = self._flow
        if self._pause:
            self._pause -= 1
            return None
        if not self._machine.ready():
            return None
        table = self._table(window)
        if table.subs != len(flow.listing.subs):
            self._find_subs(table)
        counts, rounds = flow.frame.counts, table.text.control.rounds
        for index, step in table.repeats.items():
            rounds[index] = counts.get(step, 0)
        assert self._mirror is not None
        values, changes = self._mirror.load(table.slots)
        job = self._machine.begin(self._rows)
        listing, first = flow.listing, window.first
        self._progress[0] = (
            first,
            line - first,
            0,
            flow.executed - 1,
            flow.new,
            listing.last_executed - first,
            flow.limits.repeated_lines,
            MOST_LINES,
            flow.interpreter.begun,
            -1,
            0,
            min(len(table.frames.back), flow.limits.depth - len(flow.frames)),
            flow.marks_calls,
            flow.frame.scope - first if flow.frame.scope else -1,
            0,
            math.nan,
        )
        setup, state, position, rows, _ = job
        frames = table.frames
        run(table.text, values, changes, frames, setup, state, position, rows, self._progress)
        (
            _, index, done, executed, new, highest, _, _, begun, last, depth, _, _, _, returned,
            value,
        ) = self._progress[0].item()  # fmt: skip
        self._credit = min(self._credit + done - START_COST, MOST_CREDIT)
        if self._credit < 0:
            self._credit, self._pause = START_COST, PAUSE
        if not done:
            return None
        flow.executed, flow.new = executed, new
        if returned:
            flow.value = None if value != value else value
        listing.last_executed = highest + first
        interpreter = flow.interpreter
        interpreter.begun = bool(begun)
        if last >= 0:
            interpreter.here.line = first + last
        if int(state[0]["rows"]) + MOST_LINE_ROWS >= len(rows.kinds):
            self._rows = min(2 * self._rows, MOST_ROWS)
        self._machine.finish(job)
        calls = [flow.frame]
        for level in range(depth):
            self._mirror.restore(frames, level)
            calls.append(self._frame(table, level))
            flow.enter_again(calls[-1])
        self._mirror.store()
        self._store_rounds(table, calls)
        return first + int(index)

    def _frame(self, table: _Table, level: int) -> Frame:
        """Return the frame of a call that compiled code has entered."""
        back, listing = int(table.frames.back[level]), self._flow.listing
        line = table.window.first + back
        statement = listing.statement(table.window, back - 1)
        assert statement is not None and statement.control is not None
        control = statement.control
        assert isinstance(control.label, str)
        subroutine = listing.subs[control.label]
        at = Place(line - 1, control.column, control.length)
        return Frame("sub", subroutine.name, listing, subroutine.first, listing, at, line)

    def _store_rounds(self, table: _Table, calls: list[Frame]) -> None:
        """Store the rounds left of loops in the calls that they belong to.

        Args:
            table: The table of the window.
            calls: The call in which compiled code began, and those that it entered.
        """
        flow, first, rounds = self._flow, table.window.first, table.text.control.rounds
        for index, step in table.repeats.items():
            line = first + index
            owner = calls[0]
            for frame in calls[1:]:
                sub = flow.listing.subs[frame.name[1:]]
                owner = frame if sub.first < line < sub.last else owner
            if rounds[index] > 0 or step in owner.counts:
                owner.counts[step] = int(rounds[index])

    def register(self, window: Window, index: int, step: Step) -> None:
        """Enter the step of a control line into the table of its window."""
        table = self._table(window)
        coded, control = table.text.coded, table.text.control
        if coded.kind[index] != CONTROL:
            return
        entry = (
            _loop_entry(table, index, step)
            or _branch_entry(table, index, step)
            or self._return_entry(table, index, step)
        )
        if entry is None:
            return
        if int(coded.first[index + 1] - coded.first[index]) == entry.values:
            control.target[index], control.action[index] = entry.target, entry.action
            # That of an elseif is the next one, whatever the line does when it is reached.
            if entry.action != kernel.JUMP:
                control.other[index] = entry.other

    def _return_entry(self, table: _Table, index: int, step: Step) -> _Entry | None:
        """Return the entry of a return; None if it is left to the interpreter."""
        first, subs = table.window.first, self._flow.listing.subs
        if not isinstance(step, Return):
            return None
        label, values = step.control.label, len(step.control.values)
        if step.control.keyword == "return":
            return _Entry(kernel.RETURN, 0, -1, values)
        subroutine = subs.get(label) if isinstance(label, str) else None
        if subroutine is None or subroutine.first < first:
            return None
        return _Entry(kernel.RETURN, 0, subroutine.first - first, values)

    def _find_subs(self, table: _Table) -> None:
        """Enter the subroutines that are known by now and stand in the window."""
        first, subs = table.window.first, self._flow.listing.subs
        for index, label in enumerate(table.labels):
            found = subs.get(label)
            place = -1 if found is None else found.first - first
            table.text.control.sub[index] = place if 0 <= place < table.window.count else -1
        table.subs = len(subs)

    def _table(self, window: Window) -> _Table:
        """Return the table of a window, which is made when it is first asked for."""
        if self._mirror is None:
            self._mirror = ParameterMirror(self._flow.parameters)
        key = self._flow.listing.name, window.first
        table = self._tables.get(key)
        if table is None or table.window is not window:
            coded = window.code()
            count, scan = window.count, window.scan
            control = kernel.Control(
                np.zeros(count, np.uint8),
                np.zeros(count, np.int32),
                np.zeros(count, np.int32),
                np.full(count, -1, np.int64),
                np.zeros(count, np.int64),
                np.full(int(coded.labels.used[0]), -1, np.int32),
            )
            text = kernel.Text(scan.lines.first, scan.words, coded, control)
            slots = self._mirror.slots(window, coded)
            frames = _frames(self._mirror.local_slots(slots))
            labels = window.names(coded.labels)
            table = _Table(window, text, slots, frames, {}, labels, {})
            self._tables[key] = table
            if len(self._tables) > KEPT_WINDOWS:
                self._tables.popitem(last=False)
        return table

    def _update_loops(self) -> None:
        """Tell the loops when compiled code entered them."""
        for table in self._tables.values():
            for index, loop in table.loops.items():
                loop.since = max(loop.since, int(table.text.control.since[index]))


def _frames(local_slots: NDArray[np.int32]) -> kernel.Frames:
    """Return space for calls; none if there are too many names."""
    names = len(local_slots)
    depth = MOST_CALLS if names <= MOST_NAMES else 0
    numbers = kernel.LAST_LOCAL + 1
    return kernel.Frames(
        np.zeros(depth, np.int64),
        np.zeros(depth, np.int64),
        np.zeros((depth, numbers)),
        np.zeros((depth, numbers), np.uint8),
        local_slots,
        np.zeros((depth, names)),
        np.zeros((depth, names), np.uint8),
    )


class _Entry(NamedTuple):
    """An entry of the table: action, target, other line, and number of values of the line."""

    action: int
    target: int
    other: int = -1
    values: int = 0


def _branch_entry(table: _Table, index: int, step: Step) -> _Entry | None:
    """Return the entry of a line that is no loop; None if it is left to the interpreter."""
    first, control = table.window.first, table.text.control
    match step:
        case Nothing():
            return _Entry(kernel.JUMP, index + 1)
        case Jump(to=to):
            return _Entry(kernel.JUMP, to - first)
        case If(branches=branches, otherwise=otherwise):
            chain = [index, *(branch - first for branch, _ in branches)]
            if not all(_has_one_value(table, each) for each in chain):
                return None
            for before, after in pairwise(chain):
                control.other[before] = after
            control.other[chain[-1]] = -1
            return _Entry(kernel.IF, otherwise - first, int(control.other[index]), 1)
    return None


def _loop_entry(table: _Table, index: int, step: Step) -> _Entry | None:
    """Return the entry of the first or last line of a loop; None if the line is another one."""
    first = table.window.first
    match step:
        case While(loop=loop):
            table.loops[index] = loop
            return _Entry(kernel.WHILE, loop.last + 1 - first, values=1)
        case EndWhile(first=begin) if _has_one_value(table, begin - first):
            return _Entry(kernel.END_WHILE, begin + 1 - first, begin - first)
        case Do(loop=loop):
            table.loops[index] = loop
            return _Entry(kernel.DO, 0)
        case DoWhile(begin=begin):
            return _Entry(kernel.DO_WHILE, begin - first, values=1)
        case Repeat(loop=loop):
            table.loops[index], table.repeats[index] = loop, step
            return _Entry(kernel.REPEAT, loop.last + 1 - first, values=1)
        case EndRepeat(begin=begin) if begin - 1 - first in table.repeats:
            return _Entry(kernel.END_REPEAT, begin - first, begin - 1 - first)
    return None


def _has_one_value(table: _Table, index: int) -> bool:
    """Return whether a line is a control line with one value."""
    coded = table.text.coded
    return (
        0 <= index < len(coded.kind)
        and coded.kind[index] == CONTROL
        and int(coded.first[index + 1] - coded.first[index]) == 1
    )
