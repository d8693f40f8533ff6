"""Steps of SINUMERIK's jumps, branches and loops.

A block is read to its end when its first line is executed for the first time. A label is searched
in the direction of the jump: to the end of the program (GOTOF), to its beginning (GOTOB) or both.
Source: Siemens, "SINUMERIK 840D sl/828D Programming Manual, Job Planning", "Program jumps to jump
markers" and "Check structures".
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from cnc.gcode.program.call_stack import Flow, Listing, Loop, Step
from cnc.gcode.program.control_flow import BackwardJump, enter_branch, enter_loop
from cnc.gcode.program.line_index import Place
from cnc.gcode.syntax.statement import Control, Value
from cnc.kernels.gcode import rules
from cnc.model.diagnostics import CncError

_END_OF = {
    "s-if": "s-endif",
    "s-while": "s-endwhile",
    "s-for": "s-endfor",
    "s-loop": "s-endloop",
    "s-repeat": "s-until",
}
_ENDS = frozenset((*_END_OF.values(), "s-else"))


class LabelJump:
    """``GOTOF name`` and its like, with or without a condition."""

    __slots__ = ("at", "back", "condition", "direction", "found", "target")

    def __init__(self, line: int, control: Control) -> None:
        assert isinstance(control.label, str)
        self.at = Place(line, control.column, control.length)
        self.direction, self.target = control.label[0], control.label[1:]
        self.condition = control.values[0] if control.values else None
        self.found = 0
        self.back = BackwardJump("this jump", self.at)

    def run(self, flow: Flow, line: int) -> int:
        """Jump if there is no condition or it holds."""
        if self.condition is not None:
            value = self.condition(flow.parameters)
            if value == value and not value:
                return line + 1
        if not self.found:
            self.found = self._find(flow.listing, line)
        if self.found <= line:
            self.back.record(flow, flow.listing, self.found)
        flow.sections.leave(len(flow.frames), self.found)
        return self.found

    def _find(self, listing: Listing, line: int) -> int:
        """Return the line of the target.

        Raises:
            CncError: ``jump-target-missing``.
        """
        ahead = None if self.direction == "B" else next(labelled(listing, self.target, line + 1), 0)
        if ahead:
            return ahead
        if self.direction != "F":
            behind = list(labelled(listing, self.target, 1, line + 1))
            if behind:
                return behind[-1]
        where = {"F": " after this line", "B": " before this line"}.get(self.direction, "")
        name = f"N{self.target}" if self.target.isdigit() else f"{self.target}:"
        hint = "write the label and a colon, or the N number, first in the target line"
        raise listing.fault(self.at, "jump-target-missing", f"there is no {name}{where}", hint)


def labelled(listing: Listing, target: str, line: int, end: int = 1 << 62) -> Iterator[int]:
    """Yield the lines from ``line`` to before ``end`` with a label or an N number."""
    head = r"(?<![^\r\n])[ \t]*(?:/[0-9]?[ \t]*)?"
    number = r"[N:][ \t]*0*"
    pattern = re.compile(
        (
            f"{head}{number}{target}(?![0-9.])"
            if target.isdigit()
            else f"{head}(?:{number}[0-9]+)?[ \t]*{re.escape(target)}[ \t]*:(?!=)"
        ).encode(),
        re.IGNORECASE,
    )
    while line < end and (window := listing.window(line)) is not None:
        index, last = line - window.first, min(window.count, end - window.first)
        while index < last and (index := window.find(pattern, index, last)) < last:
            yield window.first + index
            index += 1
        line = window.first + window.count


@dataclass(slots=True)
class _Block:
    """A branch or loop whose end has not been found yet; ``otherwise`` is the line of its ELSE."""

    line: int
    control: Control
    otherwise: int = 0


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


class _Definition:
    """``DEF REAL NAME=1.5, OTHER``: variables of the main program, or of a call."""

    __slots__ = ("at", "names", "values")

    def __init__(self, line: int, control: Control) -> None:
        assert isinstance(control.label, str)
        self.at = Place(line, control.column, control.length)
        self.names, self.values = control.label.split(), control.values

    def run(self, flow: Flow, line: int) -> int:
        """Set the variables.

        Raises:
            CncError: ``code-not-supported``: a subprogram so far down in the text that its
                variables would belong to all programs.
        """
        if flow.frame.kind != "main" and any(name.startswith("_") for name in self.names):
            hint = "move the subprogram to a file of its own, or use R parameters"
            message = "DEF in a subprogram this far from the beginning is not supported"
            raise flow.listing.fault(self.at, "code-not-supported", message, hint)
        flow.interpreter.begun = True
        for name, value in zip(self.names, self.values, strict=True):
            if name.startswith("#"):
                flow.parameters.set_number(int(name[1:]), value(flow.parameters), 1)
            else:
                flow.parameters.set_name(name, value(flow.parameters), 1)
        return line + 1


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


def _block_at(flow: Flow, line: int, control: Control) -> Step:
    """Return the step of a line that opens a block, and make the steps of the whole block.

    Raises:
        CncError: ``block-not-closed``, ``block-crossed``, ``block-not-open``.
    """
    listing = flow.listing
    if control.keyword in _ENDS:
        name = control.keyword[2:].upper()
        message = f"{name} without the beginning of its block before it"
        hint = "a jump must not lead into a block"
        raise listing.control_fault(line, control, "block-not-open", message, hint)
    blocks: list[_Block] = []
    for at, found in _control_lines(listing, line):
        if found.keyword in _END_OF:
            blocks.append(_Block(at, found))
        elif found.keyword in _ENDS:
            _end(listing, blocks, at, found)
        if not blocks:
            return listing.steps[line]
    name = blocks[-1].control.keyword[2:].upper()
    needed = _END_OF[blocks[-1].control.keyword][2:].upper()
    raise listing.control_fault(
        blocks[-1].line,
        blocks[-1].control,
        "block-not-closed",
        f"{name} is not closed before the end of the file",
        f"{needed} is missing",
    )


def _control_lines(listing: Listing, line: int) -> Iterator[tuple[int, Control]]:
    """Yield the control lines from a line on, with their numbers."""
    while (window := listing.window(line)) is not None:
        for index in range(line - window.first, window.count):
            statement = None if window.plain[index] else listing.statement(window, index)
            if statement is not None and statement.control is not None:
                yield window.first + index, statement.control
        line = window.first + window.count


def _end(listing: Listing, blocks: list[_Block], line: int, control: Control) -> None:
    """Take an ELSE or the end of a block."""
    block = blocks[-1]
    opener = block.control.keyword
    if control.keyword == "s-else" and opener == "s-if" and not block.otherwise:
        block.otherwise = line
        return
    if _END_OF[opener] != control.keyword:
        raise _crossed(listing, line, control, block)
    blocks.pop()
    first, values = block.line, block.control.values
    if opener == "s-if":
        enter_branch(listing, [(first, values[0])], block.otherwise, line)
        return
    at = Place(first, block.control.column, block.control.length)
    loop = Loop(opener[2:].upper(), at, first, line)
    if opener == "s-while":
        enter_loop(listing, loop, (rules.WHILE, rules.END_WHILE), values[0], None)
    elif opener == "s-loop":
        enter_loop(listing, loop, (rules.DO, rules.JUMP), None, None)
    elif opener == "s-repeat":
        until = _not(control.values[0])
        enter_loop(listing, loop, (rules.DO, rules.DO_WHILE), None, until)
    else:
        count = _For(block.control, loop)
        listing.steps[first], listing.steps[line] = count, _EndFor(count)
        listing.loops.append(loop)


def _crossed(listing: Listing, line: int, control: Control, block: _Block) -> CncError:
    name, other = control.keyword[2:].upper(), block.control.keyword[2:].upper()
    message = f"{name} inside the {other} of line {block.line}, which is still open"
    hint = "close the innermost block first"
    return listing.control_fault(line, control, "block-crossed", message, hint)


def _not(value: Value) -> Value:
    return lambda parameters: float(not value(parameters))


def _jump_at(_: Flow, line: int, control: Control) -> LabelJump:
    return LabelJump(line, control)


def _define(_: Flow, line: int, control: Control) -> Step:
    return _Definition(line, control)


MAKERS = {
    "s-goto": _jump_at,
    "s-def": _define,
    **dict.fromkeys((*_END_OF, *_ENDS), _block_at),
}
"""Functions that make the step of a control line, by keyword."""
