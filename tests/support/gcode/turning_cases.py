"""Random profiles of turned parts, their programs, and a simulation of the stock.

A profile is drawn in coordinates (along, across) with the stock on the side of larger ``across``.
A :class:`Setup` maps them to a lathe: turning outside or inside with G71, facing with G72.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from cnc.gcode import dialects
from cnc.gcode.core.modal_groups import ReadingPolicy
from cnc.model.blocks import ArcFeed, Block, Polyline
from tests.support.gcode.gcode_cases import run

Kind = Literal["outside", "inside", "facing"]
Floats = NDArray[np.float64]
TOP = 30.0
"""Level of the start point."""


@dataclass(frozen=True)
class Element:
    """A line, or an arc of a quarter turn (spin 1 or -1), by its end."""

    along: float
    across: float
    spin: int = 0


@dataclass(frozen=True)
class Part:
    """A profile from (0, first): the elements, all with ``along`` from 0 upwards."""

    first: float
    elements: tuple[Element, ...]

    @property
    def falls(self) -> bool:
        """Whether the profile has a pocket."""
        levels = [self.first, *(each.across for each in self.elements)]
        return any(b < a for a, b in pairwise(levels))

    def points(self) -> Floats:
        """The profile as many points (n, 2), arcs by samples."""
        found = [(0.0, TOP), (0.0, self.first)]
        for element in self.elements:
            (a, b), end = found[-1], (element.along, element.across)
            if not element.spin:
                found.append(end)
                continue
            center = _center((a, b), end, element.spin)
            begin = math.atan2(b - center[1], a - center[0])
            radius = math.dist((a, b), center)
            for share in np.linspace(0.0, 1.0, 400)[1:]:
                angle = begin + element.spin * share * math.pi / 2
                found.append(
                    (center[0] + radius * math.cos(angle), center[1] + radius * math.sin(angle))
                )
        return np.array(found)


def _center(start: tuple[float, float], end: tuple[float, float], spin: int) -> tuple[float, float]:
    """Centre of a quarter turn, which is one end's coordinate in each direction."""
    for center in ((start[0], end[1]), (end[0], start[1])):
        a = (start[0] - center[0], start[1] - center[1])
        b = (end[0] - center[0], end[1] - center[1])
        if (a[0] * b[1] - a[1] * b[0]) * spin > 0.0:
            return center
    raise AssertionError((start, end, spin))


@st.composite
def parts(draw: st.DrawFn, *, pockets: bool) -> Part:
    """Draw a profile; without pockets it never falls."""
    across = draw(st.sampled_from((4.0, 7.5, 12.0)))
    along, first = 0.0, across
    elements: list[Element] = []
    for _ in range(draw(st.integers(1, 7))):
        kind = draw(st.sampled_from(("along", "across", "taper", "convex", "concave")))
        rise = draw(st.sampled_from((0.5, 1.0, 2.5, 4.0, 7.0)))
        if pockets and draw(st.booleans()):
            rise = -rise
        if not 1.0 <= across + rise <= TOP - 0.5:
            continue
        step = draw(st.sampled_from((0.4, 3.0, 6.5))) if kind == "taper" else abs(rise)
        if kind == "along":
            elements.append(Element(along := along + abs(rise), across))
            continue
        across += rise
        if kind == "across":
            elements.append(Element(along, across))
            continue
        along += step
        spin = 0
        if kind in ("convex", "concave"):
            spin = 1 if kind == "concave" else -1
        elements.append(Element(along, across, spin))
    if along == 0.0:
        elements.append(Element(5.0, across))
        along = 5.0
    if draw(st.booleans()):
        elements.append(Element(along, TOP))
    return Part(first, tuple(elements))


@dataclass(frozen=True)
class Setup:
    """A part on the machine.

    Attributes:
        kind: How it is turned.
        part: The profile.
        depth: Depth of a pass, mm.
        retract: Retract, mm.
        allowance: Allowances along and across, mm.
        pockets: Type II.
    """

    kind: Kind
    part: Part
    depth: float
    retract: float
    allowance: tuple[float, float]
    pockets: bool

    def z_x(self, along: float, across: float) -> tuple[float, float]:
        """The place of a point: z and the radius x."""
        if self.kind == "outside":
            return 2.0 - along, across
        if self.kind == "inside":
            return 2.0 - along, 40.0 - across
        return across - TOP, 60.0 - along

    def seen(self, position: Floats) -> Floats:
        """The points (along, across) of machine positions (n, 2), x and z."""
        x, z = position[:, 0], position[:, 1]
        if self.kind == "outside":
            return np.column_stack([2.0 - z, x])
        if self.kind == "inside":
            return np.column_stack([2.0 - z, 40.0 - x])
        return np.column_stack([60.0 - x, z + TOP])

    def program(self, *, finish: bool = True) -> str:
        """The program, with X as diameters."""
        code, axis = ("G72", "W") if self.kind == "facing" else ("G71", "U")
        z, x = self.z_x(0.0, TOP)
        along, across = self.allowance
        if self.kind == "facing":
            u, w = 2.0 * along, across
        else:
            u, w = (2.0 if self.kind == "outside" else -2.0) * across, along
        lines = [
            "G21 G97 S600 M3",
            f"G0 X{2 * x:.4f} Z{z:.4f}",
            f"{code} {axis}{self.depth:.4f} R{self.retract:.4f}",
            f"{code} P100 Q200 U{u:.4f} W{w:.4f} F0.3",
            *self.profile_lines(),
            "G70 P100 Q200" if finish else "",
            "M30",
        ]
        return "\n".join(filter(None, lines))

    def profile_lines(self) -> list[str]:
        """The lines N100 to N200."""
        z, x = self.z_x(0.0, self.part.first)
        given = f"X{2 * x:.4f}", f"Z{z:.4f}"
        both = " ".join(given)
        first = both if self.pockets else given[1 if self.kind == "facing" else 0]
        lines = [f"N100 G0 {first}"]
        place = (0.0, self.part.first)
        for element in self.part.elements:
            end = element.along, element.across
            z, x = self.z_x(*end)
            text = f"G1 X{2 * x:.4f} Z{z:.4f} F0.1"
            if element.spin:
                # A mirror image turns the other way; all three setups are mirror images of (z, x).
                left = element.spin * self._handedness() > 0
                radius = abs(element.across - place[1])
                text = f"{'G3' if left else 'G2'} X{2 * x:.4f} Z{z:.4f} R{radius:.4f}"
            lines.append(text)
            place = end
        lines[-1] = f"N200 {lines[-1]}"
        return lines

    def _handedness(self) -> int:
        origin, right, up = self.z_x(0.0, 0.0), self.z_x(1.0, 0.0), self.z_x(0.0, 1.0)
        a = right[0] - origin[0], right[1] - origin[1]
        b = up[0] - origin[0], up[1] - origin[1]
        return 1 if a[0] * b[1] - a[1] * b[0] > 0 else -1


def lathe_blocks(
    source: str, dialect: str = "fanuc", system: str = "A", **options: object
) -> list[Block]:
    """The blocks of a program on a lathe with the axes X and Z."""
    rules = dialects.load(dialect, lathe=system)  # type: ignore[arg-type]
    policy = ReadingPolicy(tool_lengths="zero")
    return run(source, dialect=rules, axes=("x", "z"), policy=policy, **options)


@dataclass(frozen=True)
class Move:
    """A move as samples (n, 2) of machine positions, x and z."""

    rapid: bool
    points: Floats
    line: int


def moves_of(blocks: list[Block], start: tuple[float, float] = (0.0, 0.0)) -> list[Move]:
    """The moves of blocks, sampled at most 0.02 mm apart."""
    here, found = np.array(start), []
    for block in blocks:
        if isinstance(block, Polyline):
            for end, feed, line in zip(block.points, block.feeds, block.lines, strict=True):
                count = max(2, math.ceil(math.dist(here, end) / 0.02) + 1)
                share = np.linspace(0.0, 1.0, count)[:, None]
                found.append(Move(bool(np.isnan(feed)), here + share * (end - here), int(line)))
                here = end
        elif isinstance(block, ArcFeed):
            z, x = block.center
            begin = math.atan2(here[0] - x, here[1] - z)
            count = max(3, math.ceil(abs(block.turns) * math.tau * block.radius / 0.02) + 1)
            angle = begin + np.linspace(0.0, block.turns * math.tau, count)
            points = np.column_stack(
                [x + block.radius * np.sin(angle), z + block.radius * np.cos(angle)]
            )
            np.testing.assert_allclose(points[-1], block.end, atol=2e-3)
            found.append(Move(False, points, block.line))
            here = block.end
    return found


class Stock:
    """The stock as its level over a grid along; a point tool removes what it passes."""

    STEP = 0.01

    def __init__(self, length: float) -> None:
        self.along = np.arange(self.STEP / 2, length, self.STEP)
        self.level = np.full(len(self.along), TOP)

    def between(self, a: float, b: float) -> slice:
        """The cells from a to b."""
        low, high = sorted((a, b))
        return slice(int(np.searchsorted(self.along, low)), int(np.searchsorted(self.along, high)))

    def _levels(self, points: Floats) -> tuple[slice, Floats]:
        """The cells that a move passes, and its level over each; lowest for a move across."""
        along, across = points[:, 0], points[:, 1]
        order = np.argsort(along, kind="stable")
        cells = self.between(along.min(), along.max())
        return cells, np.interp(self.along[cells], along[order], across[order])

    def check_rapid(self, points: Floats) -> float:
        """The largest depth of a traverse in the stock, mm."""
        cells, level = self._levels(points)
        return float((self.level[cells] - level).max()) if len(level) else 0.0

    def cut(self, points: Floats) -> float:
        """Remove what a move passes; return the largest depth, mm."""
        cells, level = self._levels(points)
        if not len(level):
            return 0.0
        worst = float((self.level[cells] - level).max())
        self.level[cells] = np.minimum(self.level[cells], level)
        return worst
