"""Steps of SINUMERIK's frames: TRANS, ROT, SCALE, MIRROR, and those that add to them."""

from __future__ import annotations

from cnc.gcode.geometry.figure import Figure
from cnc.gcode.geometry.program_frame import ProgramFrame
from cnc.gcode.program.call_stack import ControlStep, Flow, Maker
from cnc.gcode.syntax.words import Word, under_compensation
from cnc.model.blocks import PLANE_AXES

SMALLEST_FACTOR = 1e-6


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
        base = flow.program_frame if self.name.startswith("A") else ProgramFrame()
        flow.program_frame = frame = self._changed(flow, base, given)
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
        kind = self.name.removeprefix("A")
        if all(value != value for value in given):
            return ProgramFrame() if not self.name.startswith("A") else frame
        if kind == "TRANS":
            return frame.moved((_or(x, 0.0) * scale, _or(y, 0.0) * scale, _or(z, 0.0) * scale))
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


def _put_into_effect(flow: Flow, frame: ProgramFrame) -> None:
    interpreter = flow.interpreter
    coordinates, column = interpreter.coordinates, interpreter.motion.column
    found = [column.get(axis) for axis in "XYZ"]
    coordinates.set_local(
        {at: value for at, value in zip(found, frame.shift, strict=True) if at is not None}
    )
    none = Figure.none(len(coordinates.axes))
    factors = list(none.factors)
    for at, factor in zip(found, frame.factors, strict=True):
        if at is not None:
            factors[at] = factor
    first, second = (found[axis] for axis in frame.plane)
    turns = frame.angle != 0.0 and first is not None and second is not None
    plane = (first, second) if first is not None and second is not None and turns else None
    coordinates.figure = Figure(tuple(factors), none.fixed, plane, (0.0, 0.0), frame.angle)
    interpreter.update_plain()


def _plane(flow: Flow) -> tuple[int, int]:
    """Return the numbers of the axes of the plane in effect, in the direction of its angles."""
    names = PLANE_AXES[flow.interpreter.modal.plane]
    return "XYZ".index(names[0].upper()), "XYZ".index(names[1].upper())


def _or(value: float, other: float) -> float:
    return other if value != value else value


def _mirror(value: float) -> float:
    return 1.0 if value != value else -1.0


MAKERS: dict[str, Maker] = {"frame": FrameLine}
"""Classes of the steps of control lines, by keyword."""
