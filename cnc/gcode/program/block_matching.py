"""Blocks of control lines, from if to endif and from while to endwhile: which line belongs to
which.

A block is understood when its first line is executed for the first time: its control lines are read
up to its end, so that whatever is wrong with them is told before anything in it is executed, and
every one of them becomes a step that knows where it leads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from cnc.gcode.program.call_stack import Flow
from cnc.gcode.program.control_flow import (
    Border,
    Do,
    DoWhile,
    EndRepeat,
    EndWhile,
    Goto,
    If,
    Jump,
    Repeat,
    While,
    shown,
)
from cnc.gcode.program.listing import NOTHING, Listing, Loop, Mark, Step
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.statement import Control
from cnc.model.diagnostics import CncError

MACRO_LOOPS = ("1", "2", "3")
"""FANUC's DO numbers."""

_OPENERS = ("if", "while", "do", "repeat", "while-do")
_CLOSES = {
    "endif": "if",
    "endwhile": "while",
    "endrepeat": "repeat",
    "end": "while-do",
    "elseif": "if",
    "else": "if",
}
"""What the block that a line closes or goes on with was opened by; ``while`` may close a ``do``."""


@dataclass(slots=True)
class _Block:
    """A block whose end has not been found yet. ``branches``: its elseif lines; ``leaves``: break
    and continue.
    """

    line: int
    control: Control
    branches: list[tuple[int, Control]] = field(default_factory=list)
    otherwise: int = 0
    leaves: list[tuple[int, Control]] = field(default_factory=list)

    @property
    def name(self) -> str:
        return shown(self.control)

    def is_for(self, control: Control) -> bool:
        """Whether the line belongs to this block."""
        keyword = control.keyword
        opener = "do" if keyword == "while" else _CLOSES.get(keyword)
        return control.label == self.control.label and opener == self.control.keyword


def block_at(flow: Flow, line: int, control: Control) -> Step:
    """The step of a line that opens a block, or of one that should stand in a block. The whole
    block gets its steps.
    """
    listing = flow.listing
    if control.keyword not in _OPENERS:
        raise _not_open(listing, line, control)
    _Reader(listing, flow.frame.scope, flow.parameters).read(line)
    return listing.steps[line]


def goto_at(flow: Flow, line: int, control: Control) -> Step:
    """The step of ``GOTO n`` or ``IF [..] GOTO n``."""
    condition = control.values[0] if control.keyword == "if-goto" else None
    return Goto(
        flow.parameters, condition, control.values[-1], Mark(line, control.column, control.length)
    )


def border_at(flow: Flow, line: int, control: Control) -> Step:
    """The step of O and a number alone: the name of the main program, or the border of the next."""
    return Border(Mark(line, control.column, control.length), shown(control))


class _Reader:
    """Reads the control lines of a block to its end."""

    def __init__(self, listing: Listing, scope: int, parameters: Parameters) -> None:
        self.listing = listing
        self.scope = scope
        self.parameters = parameters
        self.open: list[_Block] = []

    def read(self, line: int) -> None:
        """From the line that opens the block."""
        for at, control in self.listing.control_lines(line):
            keyword = control.keyword
            if keyword in ("program", "endsub"):
                what = (
                    "the end of the subroutine"
                    if keyword == "endsub"
                    else f"program {shown(control)} begins"
                )
                raise self._not_closed(f"before {what} in line {at}")
            if keyword == "sub":
                hint = "define subroutines outside of all blocks"
                raise self.listing.wrong(
                    at, control, "sub-nested", f"{shown(control)} inside {self._last()}", hint
                )
            if keyword in ("break", "continue"):
                self._leave(at, control)
            elif keyword in _CLOSES or (
                keyword == "while" and any(block.is_for(control) for block in self.open)
            ):
                self._go_on(at, control)
            elif keyword in _OPENERS:
                self._begin(at, control)
            if not self.open:
                return
        raise self._not_closed("before the end of the file")

    def _begin(self, line: int, control: Control) -> None:
        label, listing = control.label, self.listing
        if not isinstance(label, str):
            raise listing.wrong(
                line,
                control,
                "label-computed",
                f"the label of {control.keyword} must be written as it is",
                "only a call may compute its label",
            )
        if control.keyword == "while-do":
            if label not in MACRO_LOOPS:
                raise listing.wrong(
                    line, control, "loop-number-bad", f"DO{label}: loops are DO1, DO2 and DO3"
                )
            if same := next((block for block in self.open if block.control.label == label), None):
                raise listing.wrong(
                    line,
                    control,
                    "label-repeated",
                    f"DO{label} inside the DO{label} of line {same.line}",
                    "take another number",
                )
        elif (first := listing.labels.setdefault((self.scope, label), line)) != line:
            message = f"the label o{label} is taken already, by line {first}"
            raise listing.wrong(
                line, control, "label-repeated", message, "each block needs a label of its own"
            )
        self.open.append(_Block(line, control))

    def _go_on(self, line: int, control: Control) -> None:
        """elseif, else, or the end of a block."""
        block = self.open[-1]
        if not block.is_for(control):
            if any(other.is_for(control) for other in self.open):
                message = f"{shown(control)} inside {self._last()}, which is still open"
                raise self.listing.wrong(
                    line,
                    control,
                    "block-crossed",
                    message,
                    "what was opened last must be closed first",
                )
            raise _not_open(self.listing, line, control)
        if control.keyword in ("elseif", "else"):
            if block.otherwise:
                raise self.listing.wrong(
                    line,
                    control,
                    "else-repeated",
                    f"{shown(control)} after the else of line {block.otherwise}",
                )
            if control.keyword == "else":
                block.otherwise = line
            else:
                block.branches.append((line, control))
            return
        self.open.pop()
        self._close(block, line, control)

    def _leave(self, line: int, control: Control) -> None:
        block = next((block for block in self.open if block.control.label == control.label), None)
        if block is None or block.control.keyword not in ("while", "do"):
            raise _not_open(self.listing, line, control, block)
        block.leaves.append((line, control))

    def _close(self, block: _Block, line: int, control: Control) -> None:
        """Make the steps of a block that ends at ``line``."""
        listing, parameters, first = self.listing, self.parameters, block.line
        steps = listing.steps
        values = block.control.values
        at = Mark(first, block.control.column, block.control.length)
        loop = Loop(block.name, at, first, line)
        match block.control.keyword:
            case "if":
                branches = [
                    (branch, branch_control.values[0]) for branch, branch_control in block.branches
                ]
                steps[first] = If(parameters, values[0], branches, (block.otherwise or line) + 1)
                for branch, _ in block.branches:
                    steps[branch] = Jump(line + 1)
                if block.otherwise:
                    steps[block.otherwise] = Jump(line + 1)
                steps[line] = NOTHING
                return
            case "while" | "while-do":
                while_loop = While(parameters, values[0], loop)
                steps[first], steps[line] = while_loop, EndWhile(while_loop)
            case "do":
                steps[first], steps[line] = Do(loop), DoWhile(parameters, control.values[0], loop)
            case _:
                repeat = Repeat(parameters, values[0], loop)
                steps[first], steps[line] = repeat, EndRepeat(repeat)
        listing.loops.append(loop)
        for leave, leave_control in block.leaves:
            steps[leave] = Jump(line + 1 if leave_control.keyword == "break" else line)

    def _last(self) -> str:
        block = self.open[-1]
        return f"{block.name} of line {block.line}"

    def _not_closed(self, where: str) -> CncError:
        block = self.open[-1]
        ends = {"if": "endif", "while": "endwhile", "do": "while", "repeat": "endrepeat"}
        control = block.control
        needed = (
            f"END{control.label}"
            if control.keyword == "while-do"
            else f"o{control.label} {ends[control.keyword]}"
        )
        return self.listing.wrong(
            block.line,
            control,
            "block-not-closed",
            f"{block.name} is not closed {where}",
            f"{needed} is missing",
        )


def _not_open(
    listing: Listing, line: int, control: Control, block: _Block | None = None
) -> CncError:
    """The error for a line whose block was never opened, or is of another kind (``block``)."""
    name, label = shown(control), control.label
    if control.keyword in ("break", "continue"):
        if block is not None:
            message = f"{name}: {block.name} of line {block.line} is no while or do loop"
        else:
            message = f"{name} outside of a loop with that label"
        return listing.wrong(
            line,
            control,
            "loop-not-open",
            message,
            f"{control.keyword} belongs inside o{label} while or o{label} do",
        )
    if control.keyword == "end":
        hint = "a GOTO must not lead into a loop"
        return listing.wrong(
            line, control, "block-not-open", f"{name} without DO{label} before it", hint
        )
    opener = _CLOSES[control.keyword]
    return listing.wrong(
        line, control, "block-not-open", f"{name} without o{label} {opener} before it"
    )


MAKERS: dict[str, Callable[[Flow, int, Control], Step]] = {
    **dict.fromkeys((*_OPENERS, *_CLOSES, "break", "continue"), block_at),
    "goto": goto_at,
    "if-goto": goto_at,
    "program": border_at,
}
"""What makes the step of a control line, by its keyword."""
