"""Lines with expressions and control flow, executed by compiled code.

The interpreter executes a control line once, and finds the lines that belong to it. The line is
then entered into the table of its window, and compiled code executes it from there on.
"""

from __future__ import annotations

import math
from collections import OrderedDict

import numpy as np

from cnc.gcode.program.call_stack import Flow, Frame, Step
from cnc.gcode.program.compiled_table import MOST_COPIED, Copy, Table, frames_of, table_of
from cnc.gcode.program.control_flow import ControlLine
from cnc.gcode.program.line_index import Place
from cnc.gcode.program.line_machine import MOST_ROWS, LineMachine
from cnc.gcode.program.parameter_mirror import ParameterMirror
from cnc.gcode.program.subprograms import Return
from cnc.gcode.syntax.source_text import KEPT_WINDOWS, Window
from cnc.kernels.gcode import program_text as kernel
from cnc.kernels.gcode.program import run
from cnc.kernels.gcode.rows import MOST_ROWS as MOST_LINE_ROWS
from cnc.kernels.gcode.statements import UNKNOWN

MOST_LINES = 100_000
"""Lines that are executed at once. Ctrl-C takes effect between."""
_FEW_ROWS = 256
START_COST = 20
"""Lines that the interpreter executes in the time that compiled code takes to begin and end."""
MOST_CREDIT = 200
PAUSE = 500
"""Lines that are left to the interpreter after too many short runs."""


class CompiledProgram:
    """Executes lines of a window in place of an interpreter."""

    def __init__(self, flow: Flow, machine: LineMachine) -> None:
        self._flow = flow
        self._machine = machine
        self._mirror: ParameterMirror | None = None
        self._tables: OrderedDict[tuple[str, int], Table] = OrderedDict()
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
        table.update_copies()
        counts, rounds = flow.frame.counts, table.text.control.rounds
        for index, step in table.repeats.items():
            rounds[index] = counts.get(step, 0)
        assert self._mirror is not None
        if table.labels:
            # A call keeps the names of its window only.
            flow.parameters.settle()
        values, changes = self._mirror.load(table.slots)
        job = self._machine.begin(self._rows)
        listing = flow.listing
        self._progress[0] = (
            line - window.first,
            0,
            flow.executed - 1,
            flow.new,
            listing.last_executed,
            flow.limits.repeated_lines,
            MOST_LINES,
            flow.interpreter.begun,
            -1,
            0,
            min(len(table.frames.back), flow.limits.depth - len(flow.frames)),
            flow.marks_calls,
            table.index_of(flow.frame.scope) if flow.frame.scope else -1,
            0,
            math.nan,
        )
        setup, state, position, rows, _ = job
        frames = table.frames
        run(table.text, values, changes, frames, setup, state, position, rows, self._progress)
        (
            index, done, executed, new, highest, _, _, begun, last, depth, _, _, _, returned, value,
        ) = self._progress[0].item()  # fmt: skip
        self._credit = min(self._credit + done - START_COST, MOST_CREDIT)
        if self._credit < 0:
            self._credit, self._pause = START_COST, PAUSE
        if not done:
            return None
        flow.executed, flow.new = executed, new
        if returned:
            flow.value = None if value != value else value
        listing.last_executed = highest
        interpreter = flow.interpreter
        interpreter.begun = bool(begun)
        if last >= 0:
            interpreter.here.line = last
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
        return int(table.text.line[index])

    def _frame(self, table: Table, level: int) -> Frame:
        """Return the frame of a call that compiled code has entered."""
        listing = self._flow.listing
        line = int(table.text.line[table.frames.back[level] - 1]) + 1
        window = listing.window(line - 1)
        assert window is not None
        statement = listing.statement(window, line - 1 - window.first)
        assert statement is not None and statement.control is not None
        control = statement.control
        assert isinstance(control.label, str)
        subroutine = listing.subs[control.label]
        at = Place(line - 1, control.column, control.length)
        return Frame("sub", subroutine.name, listing, subroutine.first, listing, at, line)

    def _store_rounds(self, table: Table, calls: list[Frame]) -> None:
        """Store the rounds left of loops in the calls that they belong to.

        Args:
            table: The table of the window.
            calls: The call in which compiled code began, and those that it entered.
        """
        flow, rounds = self._flow, table.text.control.rounds
        for index, step in table.repeats.items():
            line = int(table.text.line[index])
            owner = calls[0]
            for frame in calls[1:]:
                sub = flow.listing.subs[frame.name[1:]]
                owner = frame if sub.first < line < sub.last else owner
            if rounds[index] > 0 or step in owner.counts:
                owner.counts[step] = int(rounds[index])

    def register(self, window: Window, index: int, step: Step) -> None:
        """Enter the step of a control line into the table of its window."""
        table = self._table(window)
        if isinstance(step, ControlLine):
            table.enter(step)
        elif isinstance(step, Return):
            label, sub = step.control.label, 0
            if step.control.keyword != "return":
                found = self._flow.listing.subs.get(label) if isinstance(label, str) else None
                if found is None or found.first < window.first:
                    return
                sub = found.first
            table.enter_return(index, sub, len(step.control.values))

    def _find_subs(self, table: Table) -> None:
        """Enter the subroutines that are known by now; those of other windows are copied."""
        listing = self._flow.listing
        table.subs = len(listing.subs)
        copied = sum(each.end - each.begin + 1 for each in table.copies)
        done = 0
        while done < len(table.labels):
            new: dict[str, Copy] = {}
            for label in table.labels[done:]:
                found = listing.subs.get(label)
                if found is None or table.index_of(found.first) >= 0 or label in new:
                    continue
                window = listing.window(found.first)
                length = found.last - found.first + 1
                if (
                    window is None
                    or found.last >= window.first + window.count
                    or copied + length > MOST_COPIED
                ):
                    continue
                copied += length
                first = window.first
                new[label] = Copy(self._table(window), found.first - first, found.last - first)
            done = len(table.labels)
            if new:
                table.add_copies(list(new.values()))
        for index, label in enumerate(table.labels):
            found = listing.subs.get(label)
            table.text.control.sub[index] = -1 if found is None else table.index_of(found.first)
        if table.labels:
            assert self._mirror is not None
            table.frames = frames_of(self._mirror.local_slots(table.slots))

    def _table(self, window: Window) -> Table:
        """Return the table of a window, which is made when it is first asked for."""
        if self._mirror is None:
            self._mirror = ParameterMirror(self._flow.parameters)
        key = self._flow.listing.name, window.first
        table = self._tables.get(key)
        if table is None:
            slots = self._mirror.slots(*self._flow.listing.names(window))
            table = table_of(window, window.code(), slots)
            self._tables[key] = table
            sources = {id(copy.source) for each in self._tables.values() for copy in each.copies}
            others = [name for name, each in self._tables.items() if id(each) not in sources]
            if len(others) > KEPT_WINDOWS:
                del self._tables[others[0]]
        return table

    def _update_loops(self) -> None:
        """Tell the loops when compiled code entered them."""
        for table in self._tables.values():
            for index, loop in table.loops.items():
                loop.since = max(loop.since, int(table.text.control.since[index]))
