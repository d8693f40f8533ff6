"""Lines with expressions and control flow, executed by compiled code.

The interpreter executes a control line once, and finds the lines that belong to it. The line is
then entered into the table of its window, and compiled code executes it from there on.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.core.call_stack import Flow, Frame, Loop, Step
from cnc.gcode.core.control_flow import ControlLine
from cnc.gcode.core.line_machine import MOST_ROWS, LineMachine
from cnc.gcode.core.subprograms import Return
from cnc.gcode.kernels import program as kernel
from cnc.gcode.kernels import rules
from cnc.gcode.kernels.program import Changes, Frames, run
from cnc.gcode.kernels.program import Parameters as Values
from cnc.gcode.kernels.rows import MOST_ROWS as MOST_LINE_ROWS
from cnc.gcode.kernels.statements import (
    CONTROL,
    LAST_PARAMETER,
    UNKNOWN,
    Coded,
    Names,
    add_names,
)
from cnc.gcode.reader.lines import names_space
from cnc.gcode.reader.parameters import LOCAL, Parameters
from cnc.gcode.reader.source_text import KEPT_WINDOWS, Place, Splits, Window

# The lines of a window for compiled code, and the subroutines of other windows that they call.

MOST_CALLS = 8
"""Calls within each other in compiled code."""
MOST_NAMES = 256
"""Names of a window with calls in compiled code, since each call has all of them."""
MOST_COPIED = 8192
"""Lines of other windows that a window takes."""

Array = NDArray[Any]


@dataclass(slots=True)
class Copy:
    """A subroutine of another window, whose lines stand behind those of a table.

    Attributes:
        source: The table of that window.
        begin: Index there of the line of sub.
        end: Index there of the line of endsub.
        place: Index of the line of sub in the table that has the copy.
        version: The version of the source that was copied last.
    """

    source: Table
    begin: int
    end: int
    place: int = -1
    version: int = -1


@dataclass(slots=True)
class Table:
    """The lines of a window for compiled code, and copies of subroutines.

    Attributes:
        window: The window.
        text: The lines. Those of the window come first, and a line that is left to the interpreter.
        slots: Slots of the names in the lines.
        labels: Labels of calls.
        frames: Space for calls.
        repeats: Steps of REPEAT by the index of their line.
        loops: Loops by the index of their first line.
        subs: Number of subroutines that are entered.
        copies: The copies.
        places: Index of the sub line of each copy, by its number.
        version: Number of control lines that were entered.
    """

    window: Window
    text: kernel.Text
    slots: NDArray[np.int32]
    labels: list[str]
    frames: kernel.Frames
    repeats: dict[int, Step] = field(default_factory=dict)
    loops: dict[int, Loop] = field(default_factory=dict)
    subs: int = -1
    copies: list[Copy] = field(default_factory=list)
    places: dict[int, int] = field(default_factory=dict)
    version: int = 0

    def index_of(self, line: int) -> int:
        """Return the index of a line of the window, or of the sub line of a copy; -1 for none."""
        first = self.window.first
        if first <= line < first + self.window.count:
            return line - first
        return self.places.get(line, -1)

    def enter(self, entry: ControlLine) -> None:
        """Enter a line of a branch or loop, unless it leads or asks out of the window."""
        control, first, index = self.text.control, self.window.first, entry.line - self.window.first
        chain = [entry]
        # A jump asks no other line, even if it is an elseif, which its if asks.
        while entry.action != rules.JUMP and (alternative := chain[-1].other) is not None:
            chain.append(alternative)
        is_known = entry.action != rules.END_REPEAT or chain[-1].line - first in self.repeats
        if not is_known or not 0 <= entry.target - first <= self.window.count:
            return
        if not all(
            self._has_values(branch.line - first, branch.value is not None) for branch in chain
        ):
            return
        for before, after in pairwise(chain):
            control.other[before.line - first] = after.line - first
        if entry.action == rules.REPEAT:
            self.repeats[index] = entry
        if entry.loop is not None:
            self.loops[index] = entry.loop
        control.target[index], control.action[index] = entry.target - first, entry.action
        self.version += 1

    def enter_return(self, index: int, sub: int, values: int) -> None:
        """Enter the return of the subroutine that begins at the line ``sub``; 0 for any."""
        if self._has_values(index, values):
            self.text.control.action[index] = rules.RETURN
            self.text.control.other[index] = sub - self.window.first if sub else -1
            self.version += 1

    def _has_values(self, index: int, values: int) -> bool:
        """Return whether a line of the window is a control line with a number of values."""
        coded = self.text.coded
        return (
            0 <= index < self.window.count
            and coded.kind[index] == CONTROL
            and int(coded.first[index + 1] - coded.first[index]) == values
        )

    def add_copies(self, new: list[Copy], mirror: ParameterMirror) -> None:
        """Read the window again with copies of subroutines behind it, and set their places.

        Lines, names and labels that were there keep their indices.
        """
        place = len(self.text.line)
        self.copies += new
        for copy in new:
            copy.place = self.places[copy.source.window.first + copy.begin] = place
            place += copy.end - copy.begin + 1
        window, control = _joined(self.window, self.copies), self.text.control
        coded = window.code()
        coded.kind[self.window.count] = UNKNOWN
        self.slots = mirror.slots(window.data, coded.names)
        self.labels = window.names(coded.labels)
        lines = (copy.source.text.line[copy.begin : copy.end + 1] for copy in new)
        space = _control(place - len(self.text.line), len(self.labels) - len(control.sub))
        pairs: Any = zip(control, space, strict=True)
        self.text = kernel.Text(
            np.concatenate([self.text.line, *lines]),
            window.sorted.lines.first,
            window.sorted.words,
            coded,
            kernel.Control(*(np.concatenate(pair) for pair in pairs)),
        )

    def update_copies(self) -> None:
        """Enter the control lines that the sources of the copies have learnt meanwhile."""
        for copy in self.copies:
            source, place = copy.source, copy.place
            if copy.version == source.version:
                continue
            copy.version = source.version
            source_lines, own = source.text.control, self.text.control
            span = slice(copy.begin, copy.end + 1)
            here = slice(place, place + copy.end + 1 - copy.begin)
            action, target, other_lines = (
                source_lines.action[span],
                source_lines.target[span],
                source_lines.other[span],
            )
            inside = (copy.begin <= target) & (target <= copy.end)
            inside |= action == rules.RETURN
            inside &= (other_lines < 0) | ((copy.begin <= other_lines) & (other_lines <= copy.end))
            shift = place - copy.begin
            own.action[here] = np.where(inside, action, rules.LEFT_OUT)
            own.target[here] = target + shift
            own.other[here] = np.where(other_lines < 0, -1, other_lines + shift)
            for index, step in source.repeats.items():
                if copy.begin <= index <= copy.end:
                    self.repeats[index + shift] = step
            for index, loop in source.loops.items():
                if copy.begin <= index <= copy.end:
                    self.loops[index + shift] = loop


def table_of(window: Window, coded: Coded, slots: NDArray[np.int32]) -> Table:
    """Return the table of a window without copies. It has no space for calls yet.

    Args:
        window: The window.
        coded: Its lines as instructions.
        slots: Slots of the names in its lines.
    """
    count, words = window.count, window.sorted.words
    own = coded._replace(
        kind=np.append(coded.kind, np.uint8(UNKNOWN)),
        first=np.append(coded.first, coded.first[count]),
        label=np.append(coded.label, np.int32(-1)),
    )
    labels = window.names(coded.labels)
    lines = np.arange(window.first, window.first + count + 1)
    first = np.append(window.sorted.lines.first[: count + 1], window.sorted.lines.first[count])
    text = kernel.Text(lines, first, words, own, _control(count + 1, len(labels)))
    return Table(window, text, slots, labels, frames_of(np.zeros(0, np.int32)))


def frames_of(local_slots: NDArray[np.int32]) -> kernel.Frames:
    """Return space for calls; none if there are too many names."""
    names = len(local_slots)
    depth = MOST_CALLS if names <= MOST_NAMES else 0
    numbers = rules.LOCAL + 1
    return kernel.Frames(
        np.zeros(depth, np.int64),
        np.zeros(depth, np.int64),
        np.zeros((depth, numbers)),
        np.zeros((depth, numbers), np.uint8),
        local_slots,
        np.zeros((depth, names)),
        np.zeros((depth, names), np.uint8),
    )


def _joined(window: Window, copies: list[Copy]) -> Window:
    """Return the lines of a window, an empty one, and the lines of copies."""
    begins, ends = window.places
    at = len(window.data)
    data, places = [window.data], [(begins, ends), (np.array([at]), np.array([at]))]
    for copy in copies:
        source, span = copy.source.window, slice(copy.begin, copy.end + 1)
        begins, ends = source.places[0][span], source.places[1][span]
        first, last = int(begins[0]), int(ends[-1])
        data.append(source.data[first:last])
        places.append((begins - first + at, ends - first + at))
        at += last - first
    begins, ends = (np.concatenate(part).astype(np.int32) for part in zip(*places, strict=True))
    joined = Window(window.first, b"".join(data), Splits(begins, ends, at))
    return joined.read_as(window.language)


def _control(lines: int, labels: int) -> kernel.Control:
    """Return space for control lines, all of which are left to the interpreter."""
    return kernel.Control(
        np.zeros(lines, np.uint8),
        np.zeros(lines, np.int32),
        np.full(lines, -1, np.int32),
        np.full(lines, -1, np.int64),
        np.zeros(lines, np.int64),
        np.full(labels, -1, np.int32),
    )


# The parameters of a program as arrays, for compiled code (:mod:`cnc.gcode.kernels.program`).

_SET, _OF_INTERPRETER = 1, 2
"""Flags: compiled code has set the parameter; it must not, because a function shows it."""
_FEW_NAMES, _FEW_BYTES = 64, 1024
_GLOBAL = ord("_")


class ParameterMirror:
    """Copies parameters into arrays, and changed ones back. Names have slots in an array.

    The names that compiled code has set are copied back when the interpreter asks for a name. Every
    name that the interpreter knows has a slot, so a new name of a text has no value yet.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._calls = parameters.calls
        self._known = names_space(_FEW_NAMES)
        self._text = np.empty(_FEW_BYTES, np.uint8)
        self._slots: dict[str, int] = {}
        self._named = np.full(_FEW_NAMES, math.nan)
        self._left_alone = np.zeros(_FEW_NAMES, np.bool_)
        self._numbered = np.zeros(LAST_PARAMETER + 1)
        self._changes = Changes(
            np.zeros(LAST_PARAMETER + 1, np.uint8), np.zeros(_FEW_NAMES, np.uint8)
        )
        # A place that is no parameter.
        self._numbered[0], self._changes.numbered[0] = math.nan, _OF_INTERPRETER
        # All others are 0.
        for number in parameters.known_numbers(LAST_PARAMETER):
            self._read(number)
        for name in parameters.known_names():
            self._read(name)
        parameters.changed = set()

    def slots(
        self, text: bytes, names: Names, left_alone: list[bool] | None = None
    ) -> NDArray[np.int32]:
        """Return the slot of each name; new names get new slots.

        Args:
            text: A text with the names.
            names: Their places in it.
            left_alone: Whether compiled code must not set each; None for none.
        """
        slots = np.empty(len(names.begin), np.int32)
        self._grow(len(slots), int((names.end - names.begin).sum()))
        data = np.frombuffer(text, np.uint8)
        add_names(data, names.begin, names.end, self._text, self._known, slots)
        if left_alone is not None:
            self._left_alone[slots[left_alone]] = True
            self._changes.named[slots[left_alone]] = _OF_INTERPRETER
        return slots

    def load(self, slots: NDArray[np.int32]) -> tuple[Values, Changes]:
        """Return the values of all parameters.

        Args:
            slots: Slots of the names of the text.
        """
        parameters = self._parameters
        changed = parameters.changed
        assert changed is not None
        if parameters.calls != self._calls:
            self._calls = parameters.calls
            changed.update(range(1, LOCAL + 1))
            changed.update(parameters.known_names())
            local = np.flatnonzero(self._is_local())
            self._named[local] = math.nan
            self._changes.named[local] = _OF_INTERPRETER * self._left_alone[local]
        for key in changed:
            if isinstance(key, str) or key <= LAST_PARAMETER:
                self._read(key)
        changed.clear()
        return Values(self._numbered, self._named, slots), self._changes

    def local_slots(self, slots: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return the slots of the names that belong to their call."""
        distinct = np.unique(slots)
        return distinct[self._is_local()[distinct]]

    def restore(self, frames: Frames, depth: int) -> None:
        """Copy the local parameters of a caller back, before its call is entered."""
        flags, values = frames.numbered_changes[depth], frames.numbered[depth]
        for number in np.flatnonzero(flags == _SET).tolist():
            self._parameters.store_value(number, float(values[number]))
        places = np.flatnonzero(frames.named_changes[depth] == _SET)
        self._store_names(frames.slot[places], frames.named[depth][places])

    def store(self) -> None:
        """Copy the numbers that compiled code has set back, and note that names may be set."""
        store, numbered = self._parameters.store_value, self._changes.numbered
        for number in np.flatnonzero(numbered == _SET).tolist():
            store(number, float(self._numbered[number]))
        numbered[numbered == _SET] = 0
        self._parameters.unstored = self._store_set_names

    def _store_set_names(self) -> None:
        """Copy the names that compiled code has set back."""
        self._parameters.unstored = None
        slots = np.flatnonzero(self._changes.named == _SET)
        self._store_names(slots, self._named[slots])
        self._changes.named[slots] = 0

    def _store_names(self, slots: NDArray[np.integer], values: NDArray[np.float64]) -> None:
        spans = map(slice, self._known.begin[slots].tolist(), self._known.end[slots].tolist())
        text = self._text.data
        for span, value in zip(spans, values.tolist(), strict=True):
            self._parameters.store_value(bytes(text[span]).decode(), value)

    def _is_local(self) -> NDArray[np.bool_]:
        """Return for each slot whether its name belongs to its call."""
        first: NDArray[np.uint8] = self._text[self._known.begin[: self._known.used[0]]]
        return np.not_equal(first, _GLOBAL)

    def _read(self, key: int | str) -> None:
        """Copy one parameter."""
        values, flags, place, is_left = self._numbered, self._changes.numbered, key, False
        if isinstance(place, str):
            place = self._slot(place)
            values, flags, is_left = self._named, self._changes.named, self._left_alone[place]
        values[place] = self._parameters.stored_value(key)
        flags[place] = _OF_INTERPRETER if is_left or self._parameters.is_bound(key) else 0

    def _slot(self, name: str) -> int:
        """Return the slot of a name that the interpreter knows."""
        if name not in self._slots:
            text = name.encode()
            place = Names(np.zeros(1, np.int32), np.array([len(text)], np.int32), *self._known[2:])
            self._slots[name] = int(self.slots(text, place)[0])
        return self._slots[name]

    def _grow(self, names: int, size: int) -> None:
        """Make space for more names, of ``size`` bytes in all."""
        values, used = self._known, int(self._known.used[0])
        end = int(values.end[used - 1]) if used else 0
        # A known name stands behind the others while it is looked up.
        if end + size > len(self._text):
            self._text = np.concatenate((self._text, np.empty(end + size, np.uint8)))
        if used + names <= len(values.begin):
            return
        # Each time all names are entered again, which takes longer than to look them up.
        more = 3 * len(values.begin) + names
        self._known = names_space(len(values.begin) + more)
        begins, ends = values.begin[:used], values.end[:used]
        # The type of a text, so that the kernel is not compiled for another one.
        text = self._text.view()
        text.flags.writeable = False
        add_names(text, begins, ends, self._text, self._known, np.empty(used, np.int32))
        self._named = np.concatenate((self._named, np.full(more, math.nan)))
        self._left_alone = np.concatenate((self._left_alone, np.zeros(more, np.bool_)))
        self._changes = self._changes._replace(
            named=np.concatenate((self._changes.named, np.zeros(more, np.uint8)))
        )


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
        statement = listing.statement_at(line - 1)
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
                subroutine = self._flow.listing.subs.get(label) if isinstance(label, str) else None
                if subroutine is None or subroutine.first < window.first:
                    return
                sub = subroutine.first
            table.enter_return(index, sub, len(step.control.values))

    def _find_subs(self, table: Table) -> None:
        """Enter the subroutines that are known by now; those of other windows are copied."""
        listing = self._flow.listing
        table.subs = len(listing.subs)
        copied = sum(copy.end - copy.begin + 1 for copy in table.copies)
        done = 0
        while done < len(table.labels):
            new: dict[str, Copy] = {}
            for label in table.labels[done:]:
                subroutine = listing.subs.get(label)
                if subroutine is None or table.index_of(subroutine.first) >= 0 or label in new:
                    continue
                window = listing.window(subroutine.first)
                length = subroutine.last - subroutine.first + 1
                if (
                    window is None
                    or subroutine.last >= window.first + window.count
                    or copied + length > MOST_COPIED
                ):
                    continue
                copied += length
                first = window.first
                new[label] = Copy(
                    self._table(window), subroutine.first - first, subroutine.last - first
                )
            done = len(table.labels)
            if new:
                assert self._mirror is not None
                table.add_copies(list(new.values()), self._mirror)
        for index, label in enumerate(table.labels):
            subroutine = listing.subs.get(label)
            table.text.control.sub[index] = (
                -1 if subroutine is None else table.index_of(subroutine.first)
            )
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
