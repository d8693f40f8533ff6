"""Blocks of control lines, from if to endif and from while to endwhile, of all languages.

A block is read to its end when its first line is executed for the first time. So its faults are
reported before any line of it is executed. Each of its control lines becomes a step that knows its
target.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import cast

from cnc.gcode.core.call_stack import Flow, Listing, Loop, Maker, Step
from cnc.gcode.core.control_flow import (
    Border,
    Conditional,
    ControlLine,
    Goto,
    enter_branch,
    enter_loop,
    shown,
)
from cnc.gcode.kernels import rules
from cnc.gcode.reader.source_text import Place
from cnc.gcode.reader.statements import Control, Keyword, Value
from cnc.model.diagnostics import CncError

MACRO_LOOPS = ("1", "2", "3")
"""FANUC's DO numbers."""

_OPENER_OF = {
    "endif": "if",
    "endwhile": "while",
    "endrepeat": "repeat",
    "end": "while-do",
    "elseif": "if",
    "else": "if",
    "s-endif": "s-if",
    "s-else": "s-if",
    "s-endwhile": "s-while",
    "s-endfor": "s-for",
    "s-endloop": "s-loop",
    "s-until": "s-repeat",
}
"""The keyword that opens the block of a line. ``while`` may also end a ``do``."""
_OPENERS = {*_OPENER_OF.values(), "do"}
_ENDS = {opener: end for end, opener in _OPENER_OF.items() if "else" not in end} | {"do": "while"}
"""The keyword that ends a block, by the one that opens it."""
BLOCK_KEYWORDS = {*_OPENERS, *_OPENER_OF}
_ACTIONS = {
    "while": (rules.WHILE, rules.END_WHILE),
    "while-do": (rules.WHILE, rules.END_WHILE),
    "do": (rules.DO, rules.DO_WHILE),
    "repeat": (rules.REPEAT, rules.END_REPEAT),
    "s-while": (rules.WHILE, rules.END_WHILE),
    "s-loop": (rules.DO, rules.JUMP),
    "s-repeat": (rules.DO, rules.DO_WHILE),
}
"""Actions of the first and the last line of a loop."""


@dataclass(slots=True)
class _Block:
    """A block whose end has not been found yet.

    Attributes:
        branches: Its elseif lines.
        otherwise: The line of its else; 0 for none.
        leaves: Its break and continue lines.
    """

    line: int
    control: Control
    branches: list[tuple[int, Control]] = field(default_factory=list)
    otherwise: int = 0
    leaves: list[tuple[int, Control]] = field(default_factory=list)

    @property
    def name(self) -> str:
        return shown(self.control)

    def has(self, control: Control) -> bool:
        """Return whether a control line belongs to this block."""
        keyword = control.keyword
        opener = "do" if keyword == "while" else _OPENER_OF.get(keyword)
        # The blocks of SINUMERIK have no labels.
        same = control.label == self.control.label or keyword.startswith("s-")
        return same and opener == self.control.keyword


def block_at(flow: Flow, line: int, control: Control) -> Step:
    """Return the step of a line that opens a block, and make the steps of the whole block.

    Raises:
        CncError: The block is faulty, or the line belongs to a block that was not opened.
    """
    listing = flow.listing
    if control.keyword not in _OPENERS:
        raise _not_open(listing, line, control)
    _Reader(listing, flow.frame.scope).read(line)
    return listing.steps[line]


class _Reader:
    """Reads the control lines of a block to its end."""

    def __init__(self, listing: Listing, scope: int) -> None:
        self.listing = listing
        self.scope = scope
        self.open: list[_Block] = []

    def read(self, line: int) -> None:
        """Make the steps of the block that ``line`` opens."""
        for at, control in self.listing.control_lines(line):
            keyword = control.keyword
            if keyword in ("program", "endsub", "sub"):
                raise self._interrupted(at, control)
            if keyword in ("break", "continue"):
                self._add_leave(at, control)
            elif keyword in _OPENER_OF or (
                keyword == "while" and any(block.has(control) for block in self.open)
            ):
                self._continue_or_end(at, control)
            elif keyword in _OPENERS:
                self._begin(at, control)
            if not self.open:
                return
        raise self._not_closed("before the end of the file")

    def _interrupted(self, line: int, control: Control) -> CncError:
        """Return the error for a subroutine or program that begins or ends inside a block."""
        if control.keyword == "sub":
            hint = "define subroutines outside of all blocks"
            message = f"{shown(control)} inside {self._last()}"
            return self.listing.control_fault(line, control, "sub-nested", message, hint)
        event = (
            "the end of the subroutine"
            if control.keyword == "endsub"
            else f"program {shown(control)} begins"
        )
        return self._not_closed(f"before {event} in line {line}")

    def _begin(self, line: int, control: Control) -> None:
        label, listing = control.label, self.listing
        if control.keyword.startswith("s-"):
            self.open.append(_Block(line, control))
            return
        if not isinstance(label, str):
            raise listing.control_fault(
                line,
                control,
                "label-computed",
                f"the label of {control.keyword} must be a number or a name",
                "only a call may compute its label",
            )
        if control.keyword == "while-do":
            self._check_macro_loop(line, control, label)
        elif (first := listing.labels.setdefault((self.scope, label), line)) != line:
            message = f"the label o{label} is used in line {first} already"
            raise listing.control_fault(
                line, control, "label-repeated", message, "give each block its own label"
            )
        self.open.append(_Block(line, control))

    def _check_macro_loop(self, line: int, control: Control, label: str) -> None:
        """Raise the error for a wrong or repeated DO number."""
        if label not in MACRO_LOOPS:
            raise self.listing.control_fault(
                line, control, "loop-number-bad", f"DO{label}: loops are DO1, DO2 and DO3"
            )
        if same := next((block for block in self.open if block.control.label == label), None):
            message = f"DO{label} inside the DO{label} of line {same.line}"
            raise self.listing.control_fault(
                line, control, "label-repeated", message, "use another number"
            )

    def _continue_or_end(self, line: int, control: Control) -> None:
        """Take elseif, else, or the end of a block."""
        block = self.open[-1]
        if not block.has(control):
            if any(other.has(control) for other in self.open):
                message = f"{shown(control)} inside {self._last()}, which is still open"
                hint = "close the innermost block first"
                raise self.listing.control_fault(line, control, "block-crossed", message, hint)
            raise _not_open(self.listing, line, control)
        if control.keyword in ("elseif", "else", "s-else"):
            if block.otherwise:
                message = f"{shown(control)} after the else of line {block.otherwise}"
                raise self.listing.control_fault(line, control, "else-repeated", message)
            if control.keyword == "elseif":
                block.branches.append((line, control))
            else:
                block.otherwise = line
            return
        self.open.pop()
        self._close(block, line, control)

    def _add_leave(self, line: int, control: Control) -> None:
        """Take a break or a continue."""
        block = next((block for block in self.open if block.control.label == control.label), None)
        if block is None or block.control.keyword not in ("while", "do"):
            raise _not_open(self.listing, line, control, block)
        block.leaves.append((line, control))

    def _close(self, block: _Block, line: int, control: Control) -> None:
        """Make the steps of a block that ends at ``line``."""
        listing, first, values = self.listing, block.line, block.control.values
        opener = block.control.keyword
        if opener in ("if", "s-if"):
            chain = [(first, values[0]), *((at, branch.values[0]) for at, branch in block.branches)]
            enter_branch(listing, chain, block.otherwise, line)
            return
        loop = Loop(
            block.name, Place(first, block.control.column, block.control.length), first, line
        )
        if opener == "s-for":
            _enter_count(listing, block.control, loop)
            return
        # The last line of do .. while has the condition, and that of REPEAT .. UNTIL its opposite.
        first_value, last_value = next(iter(values), None), next(iter(control.values), None)
        if opener == "s-repeat":
            last_value = _not(control.values[0])
        enter_loop(listing, loop, _ACTIONS[opener], first_value, last_value)
        for leave, leave_control in block.leaves:
            to = line + 1 if leave_control.keyword == "break" else line
            listing.steps[leave] = ControlLine(leave, rules.JUMP, to)

    def _last(self) -> str:
        block = self.open[-1]
        return f"{block.name} of line {block.line}"

    def _not_closed(self, where: str) -> CncError:
        block = self.open[-1]
        control = block.control
        needed = (
            f"END{control.label}"
            if control.keyword == "while-do"
            else shown(replace(control, keyword=cast(Keyword, _ENDS[control.keyword])))
        )
        return self.listing.control_fault(
            block.line,
            control,
            "block-not-closed",
            f"{block.name} is not closed {where}",
            f"{needed} is missing",
        )


def _not_open(
    listing: Listing, line: int, control: Control, block: _Block | None = None
) -> CncError:
    """Return the error for a line outside of its block.

    Args:
        listing: The text.
        line: The number of the line.
        control: The control line.
        block: The block with the label of the line, if it is of another kind.
    """
    name, label = shown(control), control.label
    if control.keyword in ("break", "continue"):
        if block is not None:
            message = f"{name}: {block.name} of line {block.line} is not a while or do loop"
        else:
            message = f"{name} outside of a loop with that label"
        hint = f"write {control.keyword} inside o{label} while or o{label} do"
        return listing.control_fault(line, control, "loop-not-open", message, hint)
    hint = ""
    if control.keyword == "end":
        message, hint = f"{name} without DO{label} before it", "a GOTO must not lead into a loop"
    elif control.keyword.startswith("s-"):
        message = f"{name} without the beginning of its block before it"
        hint = "a jump must not lead into a block"
    else:
        message = f"{name} without o{label} {_OPENER_OF[control.keyword]} before it"
    return listing.control_fault(line, control, "block-not-open", message, hint)


def _not(value: Value) -> Value:
    return lambda parameters: float(not value(parameters))


MAKERS: dict[str, Maker] = {
    **dict.fromkeys((*BLOCK_KEYWORDS, "break", "continue"), block_at),
    "goto": Goto,
    "if-goto": Goto,
    "if-then": Conditional,
    "program": Border,
}
"""Functions that make the step of a control line, by keyword."""


# Counting loops of SINUMERIK.


class _For:
    """``FOR R1 = first TO last``: the parameter or variable counts up by 1."""

    __slots__ = ("first", "last", "loop", "name")

    def __init__(self, control: Control, loop: Loop) -> None:
        assert isinstance(control.label, str)
        self.name = control.label
        self.first, self.last = control.values
        self.loop = loop

    def run(self, flow: Flow, line: int) -> int:
        """Enter the loop or pass it."""
        self.loop.since = flow.executed
        flow.parameters.set_name(self.name, self.first(flow.parameters), 1)
        return self.after(flow)

    def after(self, flow: Flow) -> int:
        """Return the line to continue at, by the value of the parameter."""
        count = flow.parameters.name(self.name, 1)
        return self.loop.first + 1 if count <= self.last(flow.parameters) else self.loop.last + 1


class _EndFor:
    """``ENDFOR``."""

    __slots__ = ("begin",)

    def __init__(self, begin: _For) -> None:
        self.begin = begin

    def run(self, flow: Flow, line: int) -> int:
        """Count, and repeat the loop or leave it."""
        begin = self.begin
        flow.parameters.set_name(begin.name, flow.parameters.name(begin.name, 1) + 1.0, 1)
        return begin.after(flow)


def _enter_count(listing: Listing, control: Control, loop: Loop) -> None:
    """Enter the first and the last line of a FOR."""
    count = _For(control, loop)
    listing.steps[loop.first], listing.steps[loop.last] = count, _EndFor(count)
    listing.loops.append(loop)
