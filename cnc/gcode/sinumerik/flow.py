"""Steps of SINUMERIK's control lines: jumps, blocks, repeated sections, frames, subprograms.

Source: Siemens, "SINUMERIK 840D sl/828D Programming Manual, Job Planning", "Program jumps to jump
markers", "Check structures", "Program section repetition" and "Subprogram technique"; Fundamentals,
"Axial work offset (G58, G59)" and "Programmable spindle speed limitation (G25, G26)".
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import replace

from cnc.gcode.core.block_matching import BLOCK_KEYWORDS, block_at
from cnc.gcode.core.call_stack import ControlStep, Flow, Frame, Listing, Loop, Maker, Section, Step
from cnc.gcode.core.control_flow import BackwardJump
from cnc.gcode.core.coordinates import ProgramFrame, Transform, Triple
from cnc.gcode.core.subprograms import skips_missing
from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.source_text import Place, lines_with, windows_from
from cnc.gcode.reader.statements import Control, Statement, Value
from cnc.gcode.reader.words import Word, fault, under_compensation
from cnc.model.blocks import PLANE_AXES
from cnc.model.diagnostics import GcodeError

# Jumps: a label is searched in the direction of the jump, to the end of the program (GOTOF), to its
# beginning (GOTOB) or both.


class LabelJump(ControlStep):
    """``GOTOF name`` and its like, with or without a condition."""

    __slots__ = ("back", "condition", "direction", "found", "target")

    def __init__(self, flow: Flow, line: int, control: Control) -> None:
        super().__init__(flow, line, control)
        self.direction, self.target = str(control.names[0]), str(control.label)
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
        _leave_sections(flow, self.found)
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
    for window, index in lines_with(listing, pattern, line, end):
        yield window.first + index


# Sections that REPEAT executes again.

_END = "ENDLABEL"
MOST_REPEATS = 9999


class _Repeat(ControlStep):
    """``REPEAT FIRST LAST P=3`` or ``REPEATB FIRST P=3``.

    ``REPEAT FIRST`` repeats from the label to ENDLABEL, or to the line before REPEAT. P is the
    number of repetitions, 1 if it is left out.
    """

    __slots__ = ("loop",)

    def __init__(self, flow: Flow, line: int, control: Control) -> None:
        super().__init__(flow, line, control)
        self.loop: Loop | None = None

    def run(self, flow: Flow, line: int) -> int:
        """Go to the first line of the section; its end leads back."""
        if self.loop is None:
            self.loop = self._find(flow, line)
            flow.listing.loops.append(self.loop)
        self.loop.since = flow.executed
        count = self.control.values[0](flow.parameters) if self.control.values else 1.0
        count = 1.0 if count != count else count
        if not 1.0 <= count <= MOST_REPEATS or count != int(count):
            message = f"P={count:g}: the number of repetitions is 1 to {MOST_REPEATS}"
            raise flow.listing.fault(self.at, "call-repeats", message)
        first, last = self.loop.first, self.loop.last
        flow.sections.append(
            Section(flow.listing, len(flow.frames), first, last, line + 1, int(count) - 1)
        )
        if last + 1 not in flow.listing.section_ends:
            flow.listing.section_ends[last + 1] = SectionEnd
            flow.listing.forget_steps()
        return first

    def _find(self, flow: Flow, line: int) -> Loop:
        """Return the first and the last line of the section.

        Raises:
            CncError: ``jump-target-missing``, ``code-not-supported``.
        """
        first, *last = map(str, self.control.names)
        begin = self._line_of(flow, first, line)
        if self.control.label == "REPEATB":
            end = begin
        elif last:
            end = self._line_of(flow, last[0], line)
        else:
            end = next(labelled(flow.listing, _END, begin), 0)
            if begin < line and (not end or end > line):
                end = line - 1
        if not end or end < begin or begin <= line <= end:
            message = f"the section from {first} on has no end outside of this line"
            hint = f"write {_END}: first in its last line, or a second label here"
            raise flow.listing.fault(self.at, "jump-target-missing", message, hint)
        if at := next((at for at in range(begin, end + 1) if _is_end(flow.listing, at)), 0):
            message = f"line {at} ends the program inside the repeated section"
            hint = "let the section end before it"
            raise flow.listing.fault(self.at, "code-not-supported", message, hint)
        if flow.listing.page(end + 1) is None:
            message = "the repeated section is the end of the text"
            raise flow.listing.fault(
                self.at, "program-end-missing", message, "write M17 or M30 after it"
            )
        return Loop("this REPEAT", self.at, begin, end)

    def _line_of(self, flow: Flow, label: str, line: int) -> int:
        """Return the nearest line before this one with a label, or else the first one after it."""
        before = list(labelled(flow.listing, label, 1, line))
        target = before[-1] if before else next(labelled(flow.listing, label, line + 1), 0)
        if not target:
            hint = "write the label and a colon first in the target line"
            message = f"there is no {label}:"
            raise flow.listing.fault(self.at, "jump-target-missing", message, hint)
        return target


def _is_end(listing: Listing, line: int) -> bool:
    """Return whether a line ends a program or a subprogram. A faulty line does not."""
    try:
        statement = listing.statement_at(line)
    except GcodeError:
        return False
    control = statement.control if statement is not None else None
    return control is not None and control.keyword == "s-end"


class SectionEnd:
    """The line after a repeated section."""

    __slots__ = ("step",)

    def __init__(self, step: Step) -> None:
        self.step = step

    def run(self, flow: Flow, line: int) -> int:
        """Repeat the section that ends here, or return to the line after its REPEAT."""
        section = flow.sections[-1] if flow.sections else None
        if (
            section is None
            or section.last + 1 != line
            or section.listing is not flow.listing
            or section.depth != len(flow.frames)
        ):
            return self.step.run(flow, line)
        if section.repeats_left:
            section.repeats_left -= 1
            return section.first
        flow.sections.pop()
        return section.after


def _leave_sections(flow: Flow, target: int) -> None:
    """End the sections of this call that a jump to a line leaves."""
    depth = len(flow.frames)
    while flow.sections:
        section = flow.sections[-1]
        if section.depth != depth or section.first <= target <= section.last + 1:
            return
        flow.sections.pop()


# Frames: TRANS, ROT, SCALE, MIRROR, and those that add to them.

SMALLEST_FACTOR = 1e-6
_NO_SHIFT = (0.0, 0.0, 0.0)


class FrameLine(ControlStep):
    """A line with a frame. Its values are computed when the line is executed."""

    __slots__ = ()

    @property
    def name(self) -> str:
        """The frame."""
        return str(self.control.label)

    def run(self, flow: Flow, line: int) -> int:
        """Put the frame into effect. The machine does not move."""
        interpreter = flow.interpreter
        interpreter.here.line = line
        interpreter.begun = True
        if interpreter.motion.compensated:
            raise under_compensation(
                Word(self.name, 0.0, self.name, self.at.column, self.at.length)
            )
        if self.name == "CYCLE800":
            self._check_level(flow)
        given = [value(flow.parameters) for value in self.control.values]
        flow.program_frame = frame = self._changed(flow, flow.program_frame, given)
        _put_into_effect(flow, frame)
        return line + 1

    def _check_level(self, flow: Flow) -> None:
        """Refuse a CYCLE800 that ends a frame or turns axes; report a retraction that is left out.

        Raises:
            GcodeError: ``code-not-supported``.
        """
        motion, here = flow.interpreter.motion, flow.interpreter.here
        if flow.program_frame != ProgramFrame():
            message = "CYCLE800() after TRANS, ROT, SCALE or MIRROR is not supported"
            hint = "end the frame first, with TRANS in a line of its own"
            raise flow.listing.fault(self.at, "code-not-supported", message, hint)
        if not self.control.names:
            return
        if any(motion.position[column] for column in motion.rotary_columns):
            message = "CYCLE800 with arguments may turn rotary axes, which are not at 0"
            hint = "turn them to 0 by a move before, or write CYCLE800()"
            raise flow.listing.fault(self.at, "code-not-supported", message, hint)
        if "FR" in self.control.names:
            word = Word("CYCLE800", 0.0, "CYCLE800", self.at.column, self.at.length)
            message = "the retraction of CYCLE800 (its first argument) is not made here"
            hint = "its place is in the data of the machine; write a move to it"
            here.report_warning("retraction-left-out", message, word, hint)

    def _changed(self, flow: Flow, frame: ProgramFrame, given: list[float]) -> ProgramFrame:
        """Return the frame after this line. A value that is not given is not a number."""
        scale = flow.interpreter.modal.scale
        *axes, angle = given
        x, y, z = axes
        lengths = x * scale, y * scale, z * scale
        if self.name == "G58":
            return replace(frame, shift=_given_or(lengths, frame.shift))
        if self.name == "G59":
            return replace(frame, added=_given_or(lengths, frame.added), is_axial=True)
        kind, adds = self.name.removeprefix("A"), self.name.startswith("A")
        if all(value != value for value in given):
            return frame if adds else ProgramFrame()
        if self.name == "TRANS":
            if frame.is_axial and any(frame.added):
                message = "TRANS after G59: the control may keep the shift of G59, or end it"
                hint = "write TRANS in a line of its own before, or G58 in place of TRANS"
                raise flow.listing.fault(self.at, "code-not-supported", message, hint)
            return ProgramFrame(shift=_given_or(lengths, _NO_SHIFT))
        if self.name == "ATRANS":
            return frame.moved(_given_or(lengths, _NO_SHIFT))
        frame = frame if adds else ProgramFrame()
        if kind == "MIRROR":
            return frame.scaled((_mirror(x), _mirror(y), _mirror(z)))
        if kind == "SCALE":
            factors = (_or(x, 1.0), _or(y, 1.0), _or(z, 1.0))
            if any(abs(factor) < SMALLEST_FACTOR for factor in factors):
                message = f"{self.name}: a factor must not be 0"
                raise flow.listing.fault(self.at, "scaling-factor", message)
            return frame.scaled(factors)
        plane = (0, 1) if angle != angle else _plane(flow)
        turned = frame.turned(plane, z if angle != angle else angle)
        if turned is None:
            message = f"{self.name} in another plane, or with different factors, is not supported"
            hint = "scale both axes of the plane alike, and turn one plane only"
            raise flow.listing.fault(self.at, "code-not-supported", message, hint)
        return turned


def _given_or(given: tuple[float, float, float], others: Triple) -> Triple:
    """Return the values that are given, and others for those that are not numbers."""
    x, y, z = (a if a == a else b for a, b in zip(given, others, strict=True))
    return x, y, z


def _put_into_effect(flow: Flow, frame: ProgramFrame) -> None:
    interpreter = flow.interpreter
    coordinates, column = interpreter.coordinates, interpreter.motion.column
    columns = [column.get(axis) for axis in "XYZ"]
    coordinates.set_local(
        {at: value for at, value in zip(columns, frame.origin, strict=True) if at is not None}
    )
    none = Transform.none(len(coordinates.axes))
    factors = list(none.factors)
    for at, factor in zip(columns, frame.factors, strict=True):
        if at is not None:
            factors[at] = factor
    first, second = (columns[axis] for axis in frame.plane)
    turns = frame.angle != 0.0 and first is not None and second is not None
    plane = (first, second) if first is not None and second is not None and turns else None
    coordinates.transform = Transform(tuple(factors), none.fixed, plane, (0.0, 0.0), frame.angle)
    interpreter.update_plain()


def _plane(flow: Flow) -> tuple[int, int]:
    """Return the numbers of the axes of the plane in effect, in the direction of its angles."""
    names = PLANE_AXES[flow.interpreter.modal.plane]
    return "XYZ".index(names[0].upper()), "XYZ".index(names[1].upper())


def _or(value: float, default: float) -> float:
    return default if value != value else value


def _mirror(value: float) -> float:
    return 1.0 if value != value else -1.0


# Subprograms: calls by number or name, PROC, M17, RET, and the variables that DEF defines.
#
# A subprogram follows a line ``%_N_NAME_SPF`` or ``PROC NAME`` of the same text, or is the file
# ``name.spf`` in a folder of subroutines. R parameters belong to all programs, and
# the parameters of PROC to a call.

_NUMBERED = re.compile("L[0-9]+")


class Call(ControlStep):
    """``L10``, ``NAME``, one of them with ``P3`` repeats, or ``NAME(1, R2)`` with values."""

    __slots__ = ()

    def run(self, flow: Flow, line: int) -> int:
        """Enter the subprogram."""
        name, count = str(self.control.label), self.control.count
        if not count:
            return line + 1
        flow.interpreter.begun = True
        program = self._found(flow, name)
        if program is None:
            return line + 1
        listing, scope = program
        given = self._values(flow, listing, scope, name)
        caller = flow.listing
        first = flow.enter(Frame("program", name, listing, scope, caller, self.at, line + 1, count))
        for parameter, value in given.items():
            flow.parameters.set_name(parameter, value, 1)
        return first

    def _values(self, flow: Flow, listing: Listing, scope: int, name: str) -> dict[str, float]:
        """Return the values of the parameters; 0 for those that the call leaves out.

        Raises:
            CncError: ``call-arguments``: the call has more values than the head has parameters.
        """
        names = _parameters(listing, scope)
        declared = list(zip(names[::2], names[1::2], strict=True))
        given = [value(flow.parameters) for value in self.control.values]
        if len(given) > len(declared):
            message = (
                f"{name} has {len(declared)} parameters, and the call gives {len(given)} values"
            )
            hint = f"its head is PROC {name}(REAL FIRST, ..)"
            raise flow.listing.fault(self.at, "call-arguments", message, hint)
        values = given + [0.0] * (len(declared) - len(given))
        return {
            str(parameter): _as_type(kind, 0.0 if value != value else value)
            for (parameter, kind), value in zip(declared, values, strict=True)
        }

    def _found(self, flow: Flow, name: str) -> tuple[Listing, int] | None:
        """Return the text of a subprogram and the line of its head; 0 for a file without one.

        None if a check continues without the subprogram: one of a number, or one with values. A
        name alone may be a mistyped word of another function.
        """
        if found := subprogram(flow, name, self.at):
            return found
        is_call = _NUMBERED.fullmatch(name) or self.control.values
        word = Word("L", 0.0, name, self.at.column, self.at.length)
        if is_call and skips_missing(flow, name, word, self.at.line):
            return None
        message = f"there is no subprogram {name}, and {name} is no word that is known"
        raise flow.listing.fault(self.at, "sub-unknown", message, how_it_begins(name))


def subprogram(flow: Flow, name: str, at: Place) -> tuple[Listing, int] | None:
    """Return the text of a subprogram and the line of its head; 0 for a file without one.

    Args:
        flow: The flow of control.
        name: The name of the subprogram.
        at: The place of the call, for errors.

    Returns:
        None if there is no such subprogram.
    """
    for listing in (flow.listing, flow.main):
        if line := _head_of(listing, name):
            return listing, line
    file = flow.library.find(f"<{name.lower()}>", at)
    return None if file is None else (file, _head_of(file, name))


def how_it_begins(name: str) -> str:
    """Return the hint at the beginning of a subprogram that is missing."""
    return f"%_N_{name}_SPF or PROC {name} begins it in this file; {name.lower()}.spf is a file"


def _head_of(listing: Listing, name: str) -> int:
    """Return the line that begins a subprogram; 0 if the text does not have it."""
    pattern = re.compile(
        rb"(?<![^\r\n])[ \t]*(?:%_N_" + name.encode() + rb"_[MS]PF\b"
        rb"|(?:N[0-9]+[ \t]*)?PROC[ \t]+" + name.encode() + rb"\b)",
        re.IGNORECASE,
    )
    return next((window.first + index for window, index in lines_with(listing, pattern)), 0)


def _parameters(listing: Listing, scope: int) -> tuple[str | int, ...]:
    """Return the parameters of a subprogram, each with its type, from the PROC that begins it."""
    for window, begin in windows_from(listing, max(scope, 1)):
        for index in range(begin, window.count):
            statement = listing.statement(window, index)
            if statement is None or statement.words:
                return ()
            if (control := statement.control) is not None:
                return control.names if control.keyword == "s-proc" else ()
    return ()


def _as_type(kind: str | int, value: float) -> float:
    if kind == "INT":
        return math.copysign(math.floor(abs(value) + 0.5), value)
    return float(value != 0.0) if kind == "BOOL" else value


class End(ControlStep):
    """``M17``, ``RET``, M2 or M30: the end of a subprogram, or of the main program."""

    __slots__ = ()

    def run(self, flow: Flow, line: int) -> int:
        """Return to the caller, or end the program."""
        frame, code = flow.frame, str(self.control.label)
        if frame.kind == "main":
            end = Word("M", float(code or 2), f"M{code or 2}", *self.at[1:])
            flow.interpreter.execute(Statement((end,)), line)
            return line + 1
        if code:
            message = f"M{code} in the subprogram {frame.name}"
            hint = "a subprogram ends with M17 or RET"
            raise flow.listing.fault(self.at, "call-style-mixed", message, hint)
        return flow.finish()


class Head(ControlStep):
    """``PROC``: it has no effect."""

    __slots__ = ()

    def run(self, _: Flow, line: int) -> int:
        """Continue with the next line."""
        return line + 1


class _Definition(ControlStep):
    """``DEF REAL NAME=1.5, OTHER``: variables of the main program, or of a call."""

    __slots__ = ()

    def run(self, flow: Flow, line: int) -> int:
        """Set the variables.

        Raises:
            CncError: ``code-not-supported``: a subprogram so far down in the text that its
                variables would belong to all programs.
        """
        names, values = self.control.names, self.control.values
        if flow.frame.kind != "main" and any(str(name).startswith("_") for name in names):
            hint = "move the subprogram to a file of its own, or use R parameters"
            message = "DEF in a subprogram this far from the beginning is not supported"
            raise flow.listing.fault(self.at, "code-not-supported", message, hint)
        flow.interpreter.begun = True
        for name, value in zip(names, values, strict=True):
            if isinstance(name, int):
                flow.parameters.set_number(name, value(flow.parameters), 1)
            else:
                flow.parameters.set_name(name, value(flow.parameters), 1)
        return line + 1


# Lines of G25 and G26 with S, and of G58 and G59 with X, Y, Z.

_LIMITS, _AXIAL = (25.0, 26.0), (58.0, 59.0)


def _not_given(_: Parameters) -> float:
    return math.nan


class SpeedLimit(ControlStep):
    """G25 S (lowest speed of the spindle) or G26 S (highest). S of the program stays."""

    __slots__ = ()

    def run(self, flow: Flow, line: int) -> int:
        """Put the limit into effect, for a spindle that turns at once."""
        interpreter, code = flow.interpreter, str(self.control.label)
        interpreter.here.line = line
        interpreter.begun = True
        rpm = self.control.values[0](flow.parameters)
        if not 0.0 <= rpm < math.inf:
            message = f"{code} needs S, a speed from 0 on"
            raise flow.listing.fault(self.at, "value-out-of-range", message)
        interpreter.machine_codes.limit_range(code, rpm)
        return line + 1


def step_of_code(flow: Flow, line: int, statement: Statement) -> Step | None:
    """Return the step of a line of G25 S, G26 S, G58 or G59; None for another line.

    Raises:
        GcodeError: ``code-not-supported``: another word stands beside G58 or G59.
    """
    codes = (word for word in statement.words if word.letter == "G")
    code = next((word for word in codes if word.number in _LIMITS + _AXIAL), None)
    if code is None:
        return None
    computed, name = dict(statement.computed), f"G{code.number:g}"
    given = {
        word.letter: computed.get(at, lambda _, number=word.number: number)
        for at, word in enumerate(statement.words)
        if word is not code and word.letter != "N"
    }
    is_alone = not statement.remarks and not statement.assignments

    def control(*values: Value) -> Control:
        return Control("frame", name, values, code.column, code.length)

    if code.number in _LIMITS:
        is_speed = given.keys() == {"S"} and is_alone
        return SpeedLimit(flow, line, control(given["S"])) if is_speed else None
    if not given or not given.keys() <= {"X", "Y", "Z"} or not is_alone:
        hint = f"write {name} with X, Y or Z in a line of its own"
        message = f"{name} without X, Y and Z, or with other words, is not supported"
        raise fault("code-not-supported", message, code, hint)
    values = (given.get(word, _not_given) for word in ("X", "Y", "Z", "RPL"))
    return FrameLine(flow, line, control(*values))


MAKERS: dict[str, Maker] = {
    "s-again": _Repeat,
    "s-def": _Definition,
    "s-goto": LabelJump,
    **dict.fromkeys(BLOCK_KEYWORDS, block_at),
    "frame": FrameLine,
    "s-call": Call,
    "s-end": End,
    "s-proc": Head,
}
"""Functions that make the step of a control line, by keyword."""
