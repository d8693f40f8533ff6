"""SINUMERIK's patterns of holes: HOLES1 (on a line) and HOLES2 (on a circle).

Each hole is a traverse in the plane, after which the cycle of MCALL is made. Source: Siemens,
"SINUMERIK 840D sl/828D Programming Manual, Cycles", drilling pattern cycles.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from cnc.gcode.program.call_stack import Flow
from cnc.gcode.program.line_index import Place
from cnc.gcode.program.siemens_cycles import in_plane
from cnc.gcode.syntax.statement import Control, Statement
from cnc.gcode.syntax.words import Word
from cnc.model.diagnostics import CncError

MOST_HOLES = 100_000
"""Most holes of a pattern. More are a typing error."""
_NAMES = {1: "SPCA SPCO STA1 FDIS DBH NUM", 2: "CPA CPO RAD STA1 INDA NUM"}
"""Arguments in their order. HOLES1: a point of the line, its angle, distance of the first hole from
the point, distance between holes, number. HOLES2: centre, radius, angle of the first hole, angle
between holes (0 divides the circle), number."""

Point = tuple[float, float]


class Pattern:
    """A line with a pattern. Its arguments are computed when the line is executed."""

    __slots__ = ("at", "control")

    def __init__(self, line: int, control: Control) -> None:
        self.at = Place(line, control.column, control.length)
        self.control = control

    def run(self, flow: Flow, line: int) -> int:
        """Drill the holes."""
        interpreter = flow.interpreter
        interpreter.begun = True
        if flow.modal is None:
            raise self._fault(flow, "cycle-not-active", " without MCALL and a cycle before it")
        modal = interpreter.modal
        if modal.diameter:
            message = " under DIAMON: its places may be diameters or radii"
            raise self._fault(flow, "code-not-supported", message)
        before = modal.motion, modal.absolute
        after = line + 1
        for x, y in self._holes(flow):
            first, second = (in_plane(letter, modal.plane) for letter in "XY")
            numbers = (("G", 90.0), ("G", 0.0), (first, x), (second, y))
            words = tuple(Word(letter, number, letter, 1, 1) for letter, number in numbers)
            interpreter.execute(Statement(words), line)
            after = flow.call_after(line)
        modal.motion, modal.absolute = before
        interpreter.update_plain()
        return after

    def _holes(self, flow: Flow) -> Iterator[Point]:
        """Yield the places of the holes."""
        kind = int(str(self.control.label))
        given = [value(flow.parameters) for value in self.control.values]
        names = _NAMES[kind].split()
        values = dict.fromkeys(names, 0.0)
        values |= {name: value for name, value in zip(names, given, strict=False) if value == value}
        count = values["NUM"]
        if len(given) > len(names) or not 1.0 <= count <= MOST_HOLES or count != int(count):
            message = f": its arguments are {', '.join(names)}; NUM is the number of holes"
            raise self._fault(flow, "cycle-word-missing", message)
        places = _on_line(values) if kind == 1 else _on_circle(values)
        if kind == 1:
            axes = (in_plane(letter, flow.interpreter.modal.plane) for letter in "XY")
            here = [flow.parameters.name(f"_{axis.lower()}", 1) for axis in axes]
            if math.dist(here, places[-1]) < math.dist(here, places[0]):
                places.reverse()
        yield from places

    def _fault(self, flow: Flow, code: str, message: str) -> CncError:
        return flow.listing.fault(self.at, code, f"HOLES{self.control.label}{message}")


def _on_line(values: dict[str, float]) -> list[Point]:
    angle = math.radians(values["STA1"])
    steps = (values["FDIS"] + values["DBH"] * index for index in range(int(values["NUM"])))
    return [
        (values["SPCA"] + step * math.cos(angle), values["SPCO"] + step * math.sin(angle))
        for step in steps
    ]


def _on_circle(values: dict[str, float]) -> list[Point]:
    between = values["INDA"] or 360.0 / values["NUM"]
    angles = (math.radians(values["STA1"] + between * index) for index in range(int(values["NUM"])))
    return [
        (
            values["CPA"] + values["RAD"] * math.cos(angle),
            values["CPO"] + values["RAD"] * math.sin(angle),
        )
        for angle in angles
    ]


def _maker(_: Flow, line: int, control: Control) -> Pattern:
    return Pattern(line, control)


MAKERS = {"s-holes": _maker}
