"""SINUMERIK's grooves and undercuts: CYCLE93, CYCLE94 (DIN 509) and CYCLE96 (DIN 76).

The edge position, the radius of the nose and, for grooves, the width of the edge come from the tool
table and the machine file; a cycle without them is refused. The tool follows the contour with its
nose. A point is a complex number: the real part lies along the part, the imaginary part points out
of the material. Sources: Siemens, "SINUMERIK 840D/810D Programming Guide, Cycles", turning cycles;
DIN 509, series of the usual stress; DIN 76-1.
"""

from __future__ import annotations

import cmath
import math
from bisect import bisect_left
from typing import TYPE_CHECKING, NamedTuple

from cnc.gcode.core.compensation_codes import TIPS
from cnc.gcode.sinumerik.cycles import COARSE, TurningValues
from cnc.gcode.turning.codes import MOST_PASSES
from cnc.gcode.turning.profiles import ProfileCycles, offset_profile
from cnc.gcode.turning.roughing import (
    TINY,
    Cut,
    Piece,
    Profile,
    Traverse,
    TurningStep,
    View,
    arc_pieces,
)
from cnc.model.blocks import Dwell

if TYPE_CHECKING:
    from cnc.gcode.turning.cycles import TurningCycles

_SIDES = {1: (1, 1), 2: (-1, 1), 3: (-1, -1), 4: (1, -1)}
"""SINUMERIK's edge positions (VARI): direction of the tip along Z and X."""


class _Edge(NamedTuple):
    """The tool: direction of its tip along Z and X, radius of its nose and width, mm."""

    z: int
    x: int
    nose: float
    width: float = 0.0


def _edge_of(cycle: TurningValues, *, width: bool) -> _Edge:
    """Return the edge of the tool in use.

    Raises:
        CncError: ``tool-edge``, ``tool-width-missing``, and those of the tool table.
    """
    interpreter = cycle.flow.interpreter
    number = interpreter.modal.loaded
    if not number:
        hint = "give T before the cycle"
        raise cycle.fault("tool-edge", " takes its edge from the tool, and there is none", hint)
    entry = interpreter.tool_codes.entry(number, cycle.word)
    z, x = TIPS[entry.orientation]
    if not z or not x:
        message = f" needs the edge position of tool {number}, 1 to 4"
        hint = f"write Q (1 to 4) and D (twice the radius of the nose) at T{number} in the table"
        raise cycle.fault("tool-edge", message, hint)
    if entry.radius == 0.0:
        message = f"CYCLE{cycle.control.label} with a nose of radius 0 leaves material at slopes"
        hint = f"write D, twice the radius of the nose, at T{number} in the tool table"
        interpreter.here.report_warning("compensation-radius-zero", message, cycle.word, hint)
    size = interpreter.policy.tool_widths.get(number, 0.0) if width else 0.0
    if width and not size:
        message = f" needs the width of tool {number}"
        hint = f"write tool_widths = {{ T{number} = 3.0 }} under [program] of the machine file"
        raise cycle.fault("tool-width-missing", message, hint)
    return _Edge(z, x, entry.radius, size)


class _Cutter:
    """Moves of a cycle in a view, whose points count from an origin of the program."""

    def __init__(
        self, cycle: TurningValues, turning: TurningCycles, view: View, place: tuple[float, float]
    ) -> None:
        self.cycle, self.view, self._maker = cycle, view, ProfileCycles(turning)
        self.moves = turning.moves
        self._origin = view.point(self.moves.end(*place))

    @property
    def here(self) -> complex:
        """Where the tool is."""
        return self.view.point(self.moves.motion.position) - self._origin

    def make(self, step: TurningStep) -> None:
        """Make a step."""
        if isinstance(step, Cut):
            step = Cut(step.piece.shifted(self._origin))
        else:
            step = Traverse(step.to + self._origin)
        self._maker.make_step(step, self.view, self.cycle.word, rapid_in=True)

    def approach(self, along: float, clear: float) -> None:
        """Traverse to a place above the material: up, along, down.

        Raises:
            CncError: ``profile-start``: the tool is in the material.
        """
        here = self.here
        if here.imag < -TINY:
            hint = "start the cycle on the side of the stock"
            raise self.cycle.fault("profile-start", ": the tool is behind the contour", hint)
        above = max(here.imag, clear)
        for to in (complex(here.real, above), complex(along, above), complex(along, clear)):
            self.make(Traverse(to))

    def follow(self, profile: Profile) -> None:
        """Cut to the start of a profile and along it."""
        self.make(Cut(Piece(self.here, profile[0].start)))
        for piece in profile:
            self.make(Cut(piece))


def _view(moves_columns: tuple[int, int], along: int, out: int) -> View:
    return View(moves_columns, (along, out), z_along=True)


def _reference(cycle: TurningValues) -> tuple[float, float]:
    """Return SPL and SPD, z and x (a radius) of the contour, mm."""
    state = cycle.flow.interpreter.modal
    if state.x_factor(absolute=True) != 0.5:
        message = " needs DIAMON: whether SPD is a diameter under DIAMOF differs by control"
        raise cycle.fault("code-not-supported", message)
    x = cycle.needs("SPD", "the diameter at the start", 0.0) * state.scale / 2.0
    return cycle.needs("SPL", "the place along Z") * state.scale, x


# Grooves: CYCLE93.


class _Corner(NamedTuple):
    """A round or a chamfer between two lines at right angles: its length along each, mm."""

    leg: float
    is_round: bool

    def lift(self, edge: float, nose: float) -> float:
        """Return how far above the base a tool's edge must stay at a distance from the wall."""
        if not self.is_round:
            return max(self.leg + nose * (math.sqrt(2.0) - 2.0) - edge, 0.0)
        radius = self.leg - nose
        return radius - math.sqrt(max(radius**2 - max(radius - edge, 0.0) ** 2, 0.0))

    def reach(self, nose: float) -> float:
        """Return the distance from the wall at which an edge reaches the base."""
        return self.leg - nose * (1.0 if self.is_round else 2.0 - math.sqrt(2.0))


class Groove:
    """CYCLE93: a groove at right angles in a cylinder.

    The tool plunges side by side, by at most 95 % of its width without its noses, each time by
    IDEP, and lifts off by VRT (1 mm without it) between. The allowances FAL1 (base) and FAL2
    (flanks), and rounds and chamfers, are cut by one pass from each edge to the middle.
    """

    def __init__(self, cycle: TurningValues, turning: TurningCycles) -> None:
        self.cycle, self.turning = cycle, turning
        number = cycle.whole("VARI", 1, 18)
        kind = number % 10
        if not 1 <= kind <= 8:
            raise cycle.fault("value-out-of-range", ": VARI is 1 to 8 or 11 to 18")
        if kind % 2 == 0:
            raise cycle.fault("code-not-supported", ": grooves in a face are not supported")
        for name in ("STA1", "ANG1", "ANG2", "DN"):
            if cycle.get(name, 0.0):
                hint = "let the CAM system write the moves of the groove"
                raise cycle.fault("code-not-supported", f": {name} other than 0 is not read", hint)
        self.ahead, self.out = (1 if kind < 5 else -1), (1 if kind % 4 == 1 else -1)
        self.width, self.depth = (
            cycle.needs(name, what, 0.0) * cycle.scale
            for name, what in (("WIDG", "the width"), ("DIAG", "the depth"))
        )
        factor = 1.0 if number > 10 else math.sqrt(0.5)
        self.outer, self.inner = (
            [self._corner(f"{name}{side}", factor) for side in (1, 2)] for name in ("RCO", "RCI")
        )
        self.base, self.flank = cycle.size("FAL1"), cycle.size("FAL2")
        self.edge = _edge_of(cycle, width=True)
        self._check()

    def _corner(self, name: str, chamfer: float) -> _Corner:
        """A radius if it is positive, else a chamfer with a factor to the length of its legs."""
        value = self.cycle.get(name, 0.0) * self.cycle.scale
        return _Corner(value, is_round=True) if value > 0.0 else _Corner(-value * chamfer, False)

    def _check(self) -> None:
        """Refuse a tool that does not fit."""
        cycle, edge = self.cycle, self.edge
        if edge.x != -self.out:
            side = "outside" if self.out > 0 else "inside"
            raise cycle.fault("tool-edge", f" {side}: the edge of the tool points away")
        if edge.width <= 2.0 * edge.nose:
            raise cycle.fault("value-out-of-range", ": the tool is no wider than its two noses")
        if self.base >= self.depth or edge.width > self.width - 2.0 * self.flank + TINY:
            message = f": the tool of {edge.width:g} mm does not fit between the allowances"
            raise cycle.fault("value-out-of-range", message, "give a wider groove or another tool")
        for outer, inner in zip(self.outer, self.inner, strict=True):
            if inner.is_round and inner.leg < edge.nose:
                message = f": RCI {inner.leg:g} mm is smaller than the nose, {edge.nose:g} mm"
                raise cycle.fault("value-out-of-range", message)
            if inner.reach(edge.nose) > (self.width - edge.width) / 2.0 + TINY:
                message = ": the tool is too wide for the roundings at the base"
                raise cycle.fault("value-out-of-range", message)
            if outer.leg + inner.leg > self.depth - self.base:
                raise cycle.fault("value-out-of-range", ": RCO and RCI are more than the depth")

    def make(self) -> None:
        """Make the cycle; it ends above its start."""
        cycle, edge, moves = self.cycle, self.edge, self.turning.moves
        z, x = _reference(cycle)
        far = z + self.ahead * self.width
        cutters = [
            _Cutter(cycle, self.turning, _view(moves.columns, along, self.out), (place, x))
            for along, place in ((self.ahead, z), (-self.ahead, far))
        ]
        # From the edge at the side of each view to the point that the program moves.
        shifts = [0.0 if edge.z * along < 0 else edge.width for along in (self.ahead, -self.ahead)]
        with moves.context.exact_path():
            cutters[0].approach(shifts[0], cycle.lift)
            self._rough(cutters[0], shifts[0])
            if self.base or self.flank or any(corner.leg for corner in self.outer + self.inner):
                for cutter, shift, side in zip(cutters, shifts, (0, 1), strict=True):
                    self._finish(cutter, shift, side)
            cutters[0].make(Traverse(complex(shifts[0], cycle.lift)))

    def _rough(self, cutter: _Cutter, shift: float) -> None:
        """Plunge side by side from the start to the other flank."""
        cycle, edge = self.cycle, self.edge
        depth = cycle.size("IDEP")
        if not depth:
            raise cycle.fault("cycle-word-missing", " needs IDEP, the depth of an infeed")
        room = self.width - 2.0 * self.flank - edge.width
        count = math.ceil(room / (0.95 * (edge.width - 2.0 * edge.nose)) - TINY)
        if count * self.depth / depth > MOST_PASSES:
            raise cycle.fault("cycle-too-long", f" makes more than {MOST_PASSES} infeeds")
        for number in range(count + 1):
            off = room * number / count if count else 0.0
            lift = max(
                corner.lift(gap, edge.nose)
                for corner, gap in zip(self.inner, (off, room - off), strict=True)
            )
            self._plunge(cutter, self.flank + off + shift, self.depth - self.base - lift)

    def _plunge(self, cutter: _Cutter, along: float, depth: float) -> None:
        """Plunge by the infeeds, dwell at the base, and leave."""
        cycle, here = self.cycle, self.turning.moves.here
        lift, infeed = cycle.lift, cycle.size("IDEP")
        cutter.make(Traverse(complex(along, lift)))
        count = max(1, math.ceil(depth / infeed - TINY))
        for number in range(1, count + 1):
            at = -min(number * infeed, depth)
            cutter.make(Cut(Piece(cutter.here, complex(along, at))))
            if number < count:
                cutter.make(Traverse(complex(along, min(at + lift, lift))))
        if (wait := cycle.get("DTB", 0.0)) > 0.0:
            self.turning.moves.out.add(Dwell(here.file, here.line, wait))
        cutter.make(Traverse(complex(along, lift)))

    def _finish(self, cutter: _Cutter, shift: float, side: int) -> None:
        """Follow the contour of a side down to the middle of the groove, and leave."""
        nose, lift = self.edge.nose, self.cycle.lift
        tip = complex(shift - nose, -nose)
        path = [
            piece.shifted(tip)
            for piece in offset_profile(self._contour(side), nose, self.cycle.word)
        ]
        cutter.make(Traverse(complex(path[0].start.real, lift)))
        cutter.follow(path)
        cutter.make(Traverse(complex(cutter.here.real, lift)))

    def _contour(self, side: int) -> Profile:
        """The contour of a side from the surface to the middle of the base."""
        outer, inner, depth = self.outer[side], self.inner[side], self.depth
        middle = (self.width - self.edge.width) / 2.0 + self.edge.nose
        out, low = outer.leg, inner.leg
        profile: Profile = []
        if out:
            centre = complex(-out, -out) if outer.is_round else None
            profile.append(Piece(complex(-out, 0.0), complex(0.0, -out), centre, -1))
        profile.append(Piece(complex(0.0, -out), complex(0.0, low - depth)))
        if low:
            centre = complex(low, low - depth) if inner.is_round else None
            profile.append(Piece(profile[-1].end, complex(low, -depth), centre, 1))
        profile.append(Piece(profile[-1].end, complex(middle, -depth)))
        return [piece for piece in profile if abs(piece.end - piece.start) > TINY]


# Undercuts: CYCLE94 and CYCLE96.

_DIN_509 = (
    (3.0, 0.2, 0.1, 1.0, 0.1),
    (10.0, 0.4, 0.2, 2.0, 0.1),
    (18.0, 0.6, 0.2, 2.0, 0.1),
    (80.0, 0.6, 0.3, 2.5, 0.2),
    (math.inf, 1.0, 0.4, 4.0, 0.3),
)
"""Undercuts up to a diameter: radius r, depth t1 in the cylinder, width f, depth t2 in the face."""
_RUN_OUT, _FACE_RUN_OUT, _THREAD_RUN_OUT = (math.radians(angle) for angle in (15.0, 8.0, 30.0))
_PITCHES = COARSE | {52: 5, 56: 5.5, 60: 5.5, 64: 6, 68: 6}
_DIN_76 = {
    0.5: (0.8, 0.3, 0.2, (1.1, 1.75), (0.5, 1.25), (2.0, 2.7), (1.25, 2.0)),
    0.7: (1.1, 0.3, 0.4, (1.5, 2.45), (0.8, 1.75), (2.8, 3.8), (1.75, 2.75)),
    0.8: (1.3, 0.3, 0.4, (1.7, 2.8), (0.9, 2.0), (3.2, 4.2), (2.0, 3.0)),
    1.0: (1.6, 0.5, 0.6, (2.1, 3.5), (1.1, 2.5), (4.0, 5.2), (2.5, 3.7)),
    1.25: (2.0, 0.5, 0.6, (2.7, 4.4), (1.5, 3.2), (5.0, 6.7), (3.2, 4.9)),
    1.5: (2.3, 0.5, 0.8, (3.2, 5.2), (1.8, 3.8), (6.0, 7.8), (3.8, 5.6)),
    1.75: (2.6, 0.5, 1.0, (3.9, 6.1), (2.1, 4.3), (7.0, 9.1), (4.3, 6.4)),
    2.0: (3.0, 0.5, 1.0, (4.5, 7.0), (2.5, 5.0), (8.0, 10.3), (5.0, 7.3)),
    2.5: (3.6, 0.5, 1.2, (5.6, 8.7), (3.2, 6.3), (10.0, 13.0), (6.3, 9.3)),
    3.0: (4.4, 0.5, 1.6, (6.7, 10.5), (3.7, 7.5), (12.0, 15.2), (7.5, 10.7)),
    3.5: (5.0, 0.5, 1.6, (7.7, 12.0), (4.7, 9.0), (14.0, 17.7), (9.0, 12.7)),
    4.0: (5.7, 0.5, 2.0, (9.0, 14.0), (5.0, 10.0), (16.0, 20.0), (10.0, 14.0)),
    4.5: (6.4, 0.5, 2.0, (10.5, 16.0), (5.5, 11.0), (18.0, 23.0), (11.0, 16.0)),
    5.0: (7.0, 0.5, 2.5, (11.5, 17.5), (6.5, 12.5), (20.0, 26.0), (12.5, 18.5)),
    5.5: (7.7, 0.5, 3.2, (12.5, 19.0), (7.5, 14.0), (22.0, 28.0), (14.0, 20.0)),
    6.0: (8.3, 0.5, 3.2, (14.0, 21.0), (8.0, 15.0), (24.0, 30.0), (15.0, 21.0)),
}
"""By pitch: how far the diameter of the undercut is below that of an external thread and above that
of an internal one; radius r; width of the base (least) and of the whole (most), forms A to D."""


class Undercut:
    """CYCLE94 and CYCLE96: one pass along an undercut before a shoulder.

    The edge position says where the shoulder is: the tip points to it and to the cylinder.
    """

    def __init__(self, cycle: TurningValues, turning: TurningCycles) -> None:
        self.cycle, self.turning = cycle, turning
        self.edge = _edge_of(cycle, width=False)
        forms = "EF" if cycle.control.label == "94" else "ABCD"
        self.form = str(cycle.control.names[0]) if cycle.control.names else ""
        if self.form not in tuple(forms):
            listed = ", ".join(f'"{form}"' for form in forms)
            raise cycle.fault("value-out-of-range", f": the form is {listed}")
        position = cycle.whole("VARI", 0, 4, 0.0)
        if position and _SIDES[position] != self.edge[:2]:
            message = f": VARI {position} is not the edge position of the tool"
            raise cycle.fault("code-not-supported", message, "give 0, and Q of the tool table")
        self.outside = self.edge.x < 0
        if forms != "EF" and self.outside != (self.form in "AB"):
            side = "outside" if self.form in "AB" else "inside"
            raise cycle.fault("tool-edge", f": form {self.form} needs a tool for {side}")

    def make(self) -> None:
        """Make the cycle; it ends above its start."""
        cycle, edge, moves = self.cycle, self.edge, self.turning.moves
        if cycle.control.label == "94":
            place, contour, radius = self._cylinder()
        else:
            place, contour, radius = self._thread()
        if edge.nose > radius + TINY:
            message = f": the nose of {edge.nose:g} mm is larger than the radius {radius:g} mm"
            raise cycle.fault("value-out-of-range", message, "take another tool")
        view = _view(moves.columns, edge.z, -edge.x)
        cutter = _Cutter(cycle, self.turning, view, place)
        tip = complex(edge.nose, -edge.nose)
        path = [piece.shifted(tip) for piece in offset_profile(contour, edge.nose, cycle.word)]
        start = complex(path[0].start.real, cycle.lift)
        with moves.context.exact_path():
            cutter.approach(start.real, start.imag)
            cutter.follow(path)
            cutter.make(Traverse(start))

    def _note(self, text: str) -> None:
        message = f"CYCLE{self.cycle.control.label} makes {text}"
        here = self.cycle.flow.interpreter.here
        here.report_note("undercut-size", message, self.cycle.word, "compare it with the drawing")

    def _cylinder(self) -> tuple[tuple[float, float], Profile, float]:
        """Return the corner of cylinder and face, the contour before it, and its radius."""
        place = _reference(self.cycle)
        diameter = 2.0 * place[1]
        if diameter < 3.0:
            message = ": undercuts of DIN 509 are for diameters from 3 mm"
            raise self.cycle.fault("value-out-of-range", message)
        row = _DIN_509[bisect_left(_DIN_509, diameter, key=lambda each: each[0])]
        _, radius, depth, width, deep = row
        self._note(f"{self.form} {radius:g} x {depth:g} of DIN 509, {width:g} mm wide")
        into = deep if self.form == "F" else 0.0
        corner = complex(into - radius, radius - depth)
        foot = complex(depth / math.tan(_RUN_OUT) - width, -depth)
        contour = [Piece(complex(-width, 0.0), foot), Piece(foot, complex(corner.real, -depth))]
        turned = math.pi / 2.0 + (_FACE_RUN_OUT if into else 0.0)
        end = corner + radius * cmath.rect(1.0, turned - math.pi / 2.0)
        contour += arc_pieces(contour[-1].end, end, corner, turned / math.tau)
        if into:
            top = end.imag + end.real / math.tan(_FACE_RUN_OUT)
            contour.append(Piece(end, complex(0.0, top)))
        return place, contour, radius

    def _thread(self) -> tuple[tuple[float, float], Profile, float]:
        """Return the corner of thread and shoulder, the contour before it, and its radius."""
        cycle = self.cycle
        size = cycle.needs("DIATH", "the diameter of the thread", 0.0) * cycle.scale
        z = cycle.needs("SPL", "the place along Z") * cycle.scale
        if size not in _PITCHES:
            message = f": {size:g} mm is no size of a metric thread from M3 to M68"
            raise cycle.fault("value-out-of-range", message)
        pitch = float(_PITCHES[int(size)])
        below, above, radius, *widths = _DIN_76[pitch]
        base, most = widths["ABCD".index(self.form)]
        # An internal thread begins at its minor diameter (ISO 68-1).
        start = size if self.outside else size - 1.25 * math.sqrt(0.75) * pitch
        depth = (below if self.outside else size + above - start) / 2.0
        self._note(f"form {self.form} of DIN 76 for M{size:g} x {pitch:g}, {base:g} mm wide")
        slope = max(_THREAD_RUN_OUT, math.atan(depth / (most - base)))
        foot = complex(-base, -depth)
        tangent = radius * math.tan(slope / 2.0)
        top = complex(-base - depth / math.tan(slope), 0.0)
        first = foot - tangent * cmath.rect(1.0, -slope)
        contour = [Piece(top, first)]
        centre = complex(foot.real + tangent, radius - depth)
        contour += arc_pieces(first, foot + tangent, centre, slope / math.tau)
        contour.append(Piece(foot + tangent, complex(-radius, -depth)))
        corner = complex(-radius, radius - depth)
        contour += arc_pieces(contour[-1].end, corner + radius, corner, 0.25)
        return (z, start / 2.0), contour, radius
