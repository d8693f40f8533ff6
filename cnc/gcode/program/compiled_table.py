"""The lines of a window for compiled code, and the subroutines of other windows that they call."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.program.call_stack import Loop, Step
from cnc.gcode.program.control_flow import ControlLine
from cnc.gcode.syntax.source_text import Window
from cnc.kernels.gcode import program_text as kernel
from cnc.kernels.gcode import rules
from cnc.kernels.gcode.arithmetic import NAMED
from cnc.kernels.gcode.statements import CONTROL, UNKNOWN, Code, Coded, Words

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
        while entry.action != rules.JUMP and (other := chain[-1].other) is not None:
            chain.append(other)
        is_known = entry.action != rules.END_REPEAT or chain[-1].line - first in self.repeats
        if not is_known or not 0 <= entry.target - first <= self.window.count:
            return
        if not all(self._has_values(each.line - first, each.value is not None) for each in chain):
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

    def add_copies(self, new: list[Copy]) -> None:
        """Append copies of subroutines; their places are set."""
        place = len(self.text.line)
        for each in new:
            each.place = self.places[each.source.window.first + each.begin] = place
            place += each.end - each.begin + 1
        self.text = _joined(self.text, len(self.slots), len(self.labels), new)
        self.slots = np.concatenate([self.slots, *(each.source.slots for each in new)])
        self.labels = self.labels + [label for each in new for label in each.source.labels]
        self.copies += new

    def update_copies(self) -> None:
        """Enter the control lines that the sources of the copies have learnt meanwhile."""
        for copy in self.copies:
            source, place = copy.source, copy.place
            if copy.version == source.version:
                continue
            copy.version = source.version
            known, own = source.text.control, self.text.control
            span = slice(copy.begin, copy.end + 1)
            here = slice(place, place + copy.end + 1 - copy.begin)
            action, target, other = known.action[span], known.target[span], known.other[span]
            inside = (copy.begin <= target) & (target <= copy.end)
            inside |= action == rules.RETURN
            inside &= (other < 0) | ((copy.begin <= other) & (other <= copy.end))
            shift = place - copy.begin
            own.action[here] = np.where(inside, action, rules.LEFT_OUT)
            own.target[here] = target + shift
            own.other[here] = np.where(other < 0, -1, other + shift)
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


class _Part:
    """Consecutive lines of a text, with the spans of their words, items and instructions."""

    def __init__(self, text: kernel.Text, begin: int, end: int, names: int, labels: int) -> None:
        """Create a part.

        Args:
            text: The text.
            begin: Index of the first line.
            end: Index after the last line.
            names: Number that is added to the indices of names.
            labels: Number that is added to the indices of labels.
        """
        coded = text.coded
        self.text = text
        self.lines = slice(begin, end)
        self.words = slice(int(text.first[begin]), int(text.first[end]))
        self.items = slice(int(coded.first[begin]), int(coded.first[end]))
        at, last = self.items.start, self.items.stop
        self.code = slice(int(coded.begin[at]), int(coded.end[last - 1])) if last > at else slice(0)
        self._names, self._labels = names, labels

    def numbers(self) -> Array:
        """Return the numbers of the instructions."""
        code = self.text.coded.code
        # The number of other instructions may be unset.
        numbers = code.number[self.code].copy()
        numbers[code.operation[self.code] == NAMED] += self._names
        return numbers

    def called(self) -> Array:
        """Return the labels that the lines call."""
        label = self.text.coded.label[self.lines]
        return np.where(label < 0, label, label + np.int32(self._labels))


def _joined(text: kernel.Text, names: int, labels: int, copies: list[Copy]) -> kernel.Text:
    """Return a text and, behind it, the lines of copies. Their control lines are empty.

    Args:
        text: The text.
        names: Number of its names.
        labels: Number of its labels.
        copies: The copies.
    """
    parts = [_Part(text, 0, len(text.line), 0, 0)]
    for each in copies:
        source = each.source
        parts.append(_Part(source.text, each.begin, each.end + 1, names, labels))
        names, labels = names + len(source.slots), labels + len(source.labels)
    words = items = instructions = 0
    joined: dict[str, list[Array]] = {"first": [], "item": [], "begin": [], "end": []}
    for part in parts:
        own = part.text.coded
        joined["first"].append(part.text.first[part.lines] + (words - part.words.start))
        joined["item"].append(own.first[part.lines] + (items - part.items.start))
        joined["begin"].append(own.begin[part.items] + (instructions - (part.code.start or 0)))
        joined["end"].append(own.end[part.items] + (instructions - (part.code.start or 0)))
        words += part.words.stop - part.words.start
        items += part.items.stop - part.items.start
        instructions += part.code.stop - (part.code.start or 0)
    joined["first"].append(np.array([words], np.int32))
    joined["item"].append(np.array([items], np.int32))
    coded = text.coded._replace(
        kind=np.concatenate([part.text.coded.kind[part.lines] for part in parts]),
        first=np.concatenate(joined["item"]),
        letter=np.concatenate([part.text.coded.letter[part.items] for part in parts]),
        begin=np.concatenate(joined["begin"]),
        end=np.concatenate(joined["end"]),
        code=Code(
            np.concatenate([part.text.coded.code.operation[part.code] for part in parts]),
            np.concatenate([part.numbers() for part in parts]),
        ),
        label=np.concatenate([part.called() for part in parts]),
    )
    more = len(coded.kind) - len(text.line)
    space = _control(more, labels - len(text.control.sub))
    return kernel.Text(
        np.concatenate([part.text.line[part.lines] for part in parts]),
        np.concatenate(joined["first"]),
        Words(
            *(
                np.concatenate([part.text.words[k][part.words] for part in parts])
                for k in range(len(text.words))
            )
        ),
        coded,
        kernel.Control(
            np.concatenate([text.control.action, space.action]),
            np.concatenate([text.control.target, space.target]),
            np.concatenate([text.control.other, space.other]),
            np.concatenate([text.control.since, space.since]),
            np.concatenate([text.control.rounds, space.rounds]),
            np.concatenate([text.control.sub, space.sub]),
        ),
    )


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
