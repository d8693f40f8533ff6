"""Simulation of a cut: the path of a program removes material from the stock.

The tool tip goes along the programmed path; corners are not rounded. Positions are machine
coordinates less the tool offset in effect (G43), so a longer tool cuts at the same place. The tool
turns about Z and comes from above: what lies over the tool is removed, too.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Machine, Stock
from cnc.model.blocks import ROTARY_LETTERS, Block, Tool, ToolOffset
from cnc.model.diagnostics import Diagnostic, Severity
from cnc.path.chunk import PathChunk, bounding_box
from cnc.path.kernels.curve import Pieces
from cnc.stock.kernels.sweep import (
    BALL,
    BULL,
    CONE,
    FLAT,
    HOLDER,
    RAPID,
    SHANK,
    Assembly,
    Cutter,
    Depths,
    Field,
    Route,
    cut_pieces,
)

Floats = NDArray[np.float64]

# The material that is left: a grid of heights, lowered along a path.

Ints = NDArray[np.int64]

RESOLUTION = 0.1
"""mm. Width of a cell, unless another is asked for."""
MOST_CELLS = 4_000_000
"""Limit on the cells (32 MB) where no resolution is asked for; the cells are wider then."""
CHORD = 0.05
"""Cells. Largest distance of a chord from the short moves that it replaces."""
BAND = 64
"""Least number of columns for each processor."""
WORTH_THREADS = 256
"""Pieces of a path from which on it is cut by all processors."""


class Material:
    """The stock while it is cut.

    Args:
        stock: The cuboid at the start.
        resolution: Width of a cell, mm; None for the default.

    Attributes:
        heights: (nx, ny) height of the material at the centre of each cell, mm.
        low: (3,) lowest corner of the stock, mm.
        high: (3,) highest corner, mm.
        cell: Width of a cell, mm.
    """

    def __init__(self, stock: Stock, resolution: float | None = None) -> None:
        self.low, self.high = np.array([stock.x, stock.y, stock.z]).T.copy()
        self.cell = resolution or default_resolution(stock)
        nx, ny = np.ceil((self.high - self.low)[:2] / self.cell - 1e-9).astype(np.int64)
        self.heights: Floats = np.full((max(1, nx), max(1, ny)), self.high[2])
        bands = min(os.cpu_count() or 1, len(self.heights) // BAND)
        self._pool = ThreadPoolExecutor(bands) if bands > 1 else None
        edges = np.linspace(0, len(self.heights), max(1, bands) + 1).astype(np.int64).tolist()
        self._bands = list(pairwise(edges))

    def cut(self, path: PathChunk, columns: Ints, offset: Floats, tool: Assembly) -> Depths:
        """Remove the material along a path.

        Args:
            path: The path.
            columns: (3,) columns of x, y and z in a position.
            offset: (3,) tool offset, mm.
            tool: The tool.
        """
        # Kernels are compiled for arrays that may be written to.
        kind, at, data = np.array(path.kind), np.array(path.at), np.array(path.data)
        pieces = Pieces(kind, at, data)
        route = Route(pieces, np.isnan(path.feed), columns, offset)
        field = Field(self.heights, self.low[:2].copy(), self.cell, float(self.high[2]))
        count = len(path)

        def cut_band(band: tuple[int, int]) -> Depths:
            depths = Depths(np.zeros((count, 3)), np.zeros((count, 3, 2)))
            cut_pieces(field, band, route, tool, CHORD * self.cell, depths)
            return depths

        if self._pool is None or count < WORTH_THREADS:
            return _deepest([cut_band((0, len(self.heights)))])
        return _deepest(list(self._pool.map(cut_band, self._bands)))

    def removed_volume(self) -> float:
        """Return the volume that was removed so far, mm^3."""
        depth = self.high[2] - np.maximum(self.heights, self.low[2])
        return float(depth.sum()) * self.cell**2


def default_resolution(stock: Stock) -> float:
    """Return the width of a cell for a stock, mm; larger where there would be too many cells."""
    area = math.prod(high - low for low, high in (stock.x, stock.y))
    return max(RESOLUTION, math.sqrt(area / MOST_CELLS))


def _deepest(bands: list[Depths]) -> Depths:
    """Return the depths of all bands together."""
    if len(bands) == 1:
        return bands[0]
    depth = np.stack([band.depth for band in bands])
    best = depth.argmax(axis=0)
    rows, parts = np.indices(best.shape)
    place = np.stack([band.place for band in bands])
    return Depths(depth.max(axis=0), place[best, rows, parts])


# Shape of a tool, from its entry in the tool table and from comments.
#
# The table has diameters. What a tool looks like stands in the comment of its line, or in a comment
# of the program, as CAM systems write it. These words are read, in capitals or not:
#
#     ball, ball nose                 half a sphere
#     bull, CR=1, corner radius 1     flat with a rounded corner (the radius in mm)
#     drill                           a cone of 118 degrees; spot drill and centre drill: 90 degrees
#     V-bit, chamfer, engraver        a cone; its angle must stand beside it
#     60 deg, 60°, V60                the full angle of a cone
#     TAPER=45DEG                     as Fusion 360 writes it: of drills the full angle, else half
#     tip 0.2                         diameter of the flat tip of a cone, mm
#     flute 20, FL=20, LOC 20         length of the cutting part, mm
#     holder 40x35                    diameter of the holder, and its distance from the tip, mm
#     flat, end mill, face mill, ...  flat; other words, too, but this is then said to be assumed
#
# Lengths in comments of the table are in mm, those of a program in its unit.

_NUMBER = r"\s*[=:]?\s*([0-9]*\.?[0-9]+)"
_CORNER = re.compile(rf"\b(?:CR|CORNER\s*RAD(?:IUS)?){_NUMBER}", re.IGNORECASE)
_TAPER = re.compile(rf"\bTAPER{_NUMBER}", re.IGNORECASE)
_ANGLE = re.compile(
    r"\b(?:V-?)?([0-9]+\.?[0-9]*)\s*(?:DEG\b|DEGREES?\b|°)|\bV-?([0-9]{2,3})\b", re.IGNORECASE
)
_TIP = re.compile(rf"\bTIP{_NUMBER}", re.IGNORECASE)
_FLUTE = re.compile(rf"\b(?:FLUTE(?:\s*LENGTH)?|FL|LOC){_NUMBER}", re.IGNORECASE)
_HOLDER = re.compile(rf"\bHOLDER{_NUMBER}\s*X{_NUMBER}", re.IGNORECASE)
_BALL = re.compile(r"\bBALL", re.IGNORECASE)
_BULL = re.compile(r"\bBULL|\bRADIUSED\b", re.IGNORECASE)
_SPOT = re.compile(r"\b(?:SPOT|CENT(?:ER|RE))[\s-]*(?:DRILL|BIT)", re.IGNORECASE)
_DRILL = re.compile(r"\bDRILL", re.IGNORECASE)
_CONE = re.compile(r"\bV[\s-]?(?:BIT|CARVE)|\bCHAMFER|\bENGRAV|\bCONE\b|\bCONICAL", re.IGNORECASE)
_FLAT = re.compile(
    r"\bFLAT|\bEND[\s-]?MILL|\bFACE[\s-]?MILL|\bSLOT|\bROUTER|\bREAMER|\bTAP\b", re.IGNORECASE
)
DRILL_ANGLE, SPOT_ANGLE = 118.0, 90.0
"""Degrees. Point angles of drills whose comment names none."""


@dataclass(frozen=True, slots=True)
class ToolShape:
    """A tool as the simulation cuts with it.

    Attributes:
        assembly: Its parts.
        described: The shape for people, such as ``ball 6 mm``.
        assumed: What was assumed because nothing says it; empty if nothing was.
    """

    assembly: Assembly
    described: str
    assumed: str = ""


def tool_shape(diameter: float, comment: str, *, scale: float = 1.0) -> ToolShape:
    """Return the shape of a tool.

    Args:
        diameter: Diameter of the tool, mm; 0 if it is not known.
        comment: Comment that describes it.
        scale: Millimetres in a unit of the comment's lengths.
    """
    if diameter <= 0.0:
        assembly = Assembly(Cutter(FLAT, 0.0, 0.0, 0.0), math.inf, math.inf, 0.0)
        return ToolShape(
            assembly, "no diameter", "no diameter is known; it cuts one column of cells"
        )
    radius = diameter / 2.0
    cutter, name, assumed = _cutter(radius, comment, scale)
    flutes = _length(_FLUTE.search(comment), scale, math.inf)
    holder = _HOLDER.search(comment)
    stickout = math.inf if holder is None else float(holder[2]) * scale
    width = 0.0 if holder is None else float(holder[1]) * scale / 2.0
    return ToolShape(
        Assembly(cutter, flutes, stickout, width), f"{name} {diameter:.6g} mm", assumed
    )


def _cutter(radius: float, comment: str, scale: float) -> tuple[Cutter, str, str]:
    """Return the cutting part, its name, and what was assumed."""
    corner = _length(_CORNER.search(comment), scale, 0.0)
    if _BALL.search(comment) or corner >= radius * (1.0 - 1e-6):
        return Cutter(BALL, radius, 0.0, radius), "ball", ""
    if corner > 0.0:
        return Cutter(BULL, radius, radius - corner, corner), f"bull nose R{corner:.6g}", ""
    flat = Cutter(FLAT, radius, radius, 0.0)
    if _BULL.search(comment):
        return flat, "flat", "its corner radius is not known; it is taken as flat"
    angle, assumed = _angle(comment)
    if angle is not None:
        if not 0.0 < angle < 180.0:
            return flat, "flat", assumed
        tip = min(_length(_TIP.search(comment), scale, 0.0) / 2.0, radius)
        rise = 1.0 / math.tan(math.radians(angle) / 2.0)
        return Cutter(CONE, radius, tip, rise), f"cone of {angle:.6g} degrees", assumed
    if _CONE.search(comment):
        return flat, "flat", "its angle is not known; it is taken as flat"
    return flat, "flat", "" if _FLAT.search(comment) else "no shape is known; it is taken as flat"


def _angle(comment: str) -> tuple[float | None, str]:
    """Return the full angle of a cone in degrees, None without one, and what was assumed."""
    spot, drill = _SPOT.search(comment), _DRILL.search(comment)
    if taper := _TAPER.search(comment):
        return float(taper[1]) * (1.0 if drill or spot else 2.0), ""
    if angle := _ANGLE.search(comment):
        return float(angle[1] or angle[2]), ""
    if spot:
        return SPOT_ANGLE, f"a point angle of {SPOT_ANGLE:.6g} degrees is assumed"
    if drill:
        return DRILL_ANGLE, f"a point angle of {DRILL_ANGLE:.6g} degrees is assumed"
    return None, ""


def _length(match: re.Match[str] | None, scale: float, missing: float) -> float:
    """Return the number of a match in mm."""
    return missing if match is None else float(match[1]) * scale


TOLERANCE = 1e-3
"""mm. Rounding alone may take a part of the tool this far into material."""
COORDINATES = "positions are machine coordinates, after all offsets, of the tool tip"


class StockSimulation:
    """Cuts the stock: ``add`` the items of a path in order, then take the ``findings``.

    Args:
        machine: The machine; it has the axes x, y and z.
        stock: The raw part.
        shape_of: Returns the shape of a tool by number; 0 is the tool of a program without T words.
        resolution: Width of a cell, mm; None for the default.

    Attributes:
        material: The material that is left.
        tools: The tools that were used, by number.
    """

    def __init__(
        self,
        machine: Machine,
        stock: Stock,
        shape_of: Callable[[int], ToolShape],
        resolution: float | None = None,
    ) -> None:
        self.material = Material(stock, resolution)
        self.tools: dict[int, ToolShape] = {}
        names = machine.axis_names
        self._columns = np.array([names.index(axis) for axis in "xyz"], np.int64)
        self._rotary = [column for column, name in enumerate(names) if name in ROTARY_LETTERS]
        self._shape_of = shape_of
        self._tool = 0
        self._offset = np.zeros(3)
        self._findings: list[Diagnostic] = []
        self._reported: set[tuple[str, str, int]] = set()

    def add(self, item: PathChunk | Block) -> None:
        """Cut along a part of the path, or take note of a tool and its offset."""
        if isinstance(item, PathChunk):
            self._cut(item)
        elif isinstance(item, Tool):
            self._tool = item.number
        elif isinstance(item, ToolOffset):
            self._offset = np.array([item.offset[column] for column in self._columns])

    def findings(self) -> Iterator[Diagnostic]:
        """Yield the findings, without the text of their lines."""
        yield from self._findings
        for number, tool in sorted(self.tools.items()):
            if tool.assumed:
                name = f"tool {number}" if number else "the tool"
                message = f"the simulation takes {name} as {tool.described}: {tool.assumed}"
                hint = "write its diameter (D) and its shape, in the comment, into the tool table"
                yield Diagnostic("tool-shape-assumed", message, hint=hint, severity="note")

    def _cut(self, chunk: PathChunk) -> None:
        low, high = bounding_box(chunk)
        self._note_rotation(chunk, high - low)
        low, high = low[:, self._columns] - self._offset, high[:, self._columns] - self._offset
        if not (low[:, 2] < self.material.high[2]).any():
            return
        if self._tool not in self.tools:
            self.tools[self._tool] = self._shape_of(self._tool)
        tool = self.tools[self._tool]
        depths = self.material.cut(chunk, self._columns, self._offset, tool.assembly)
        self._note_contacts(chunk, depths, tool)
        self._note_depth(chunk, low, high)

    def _note_contacts(self, chunk: PathChunk, depths: Depths, tool: ToolShape) -> None:
        """Report the wrong contacts, each part once a line."""
        for piece, part in np.argwhere(depths.depth > TOLERANCE).tolist():
            depth = float(depths.depth[piece, part])
            x, y = depths.place[piece, part].tolist()
            line, place = int(chunk.line[piece]), f"at X{x:.6g} Y{y:.6g}"
            if part == RAPID:
                message = (
                    f"a rapid move enters the stock {place} and goes {depth:.6g} mm deep "
                    "where no feed move has been"
                )
                hint = f"plunge with G1, or start above the stock; {COORDINATES}"
                self._report("rapid-into-stock", message, chunk.file, line, hint)
            elif part == SHANK:
                message = (
                    f"material stands {depth:.6g} mm above the flutes of tool {self._tool} "
                    f"({tool.assembly.flutes:.6g} mm long) {place}"
                )
                hint = "cut in smaller steps of depth, or take a tool with longer flutes"
                self._report("shank-into-stock", message, chunk.file, line, hint)
            else:
                assert part == HOLDER
                message = (
                    f"the holder of tool {self._tool} goes {depth:.6g} mm into material {place}"
                )
                hint = "let the tool stick out further, or cut in smaller steps of depth"
                self._report("holder-into-stock", message, chunk.file, line, hint)

    def _note_rotation(self, chunk: PathChunk, travel: Floats) -> None:
        """Report rotary axes that turn the stock; ``travel`` (n, axes) of each piece."""
        turning = travel[:, self._rotary].any(axis=1)
        if turning.any():
            message = "a rotary axis turns; the simulation does not turn the stock with it"
            hint = "the part and the findings of the stock are wrong from here on"
            line = int(chunk.line[np.argmax(turning)])
            self._report("stock-turned", message, chunk.file, line, hint, once=True)

    def _note_depth(self, chunk: PathChunk, low: Floats, high: Floats) -> None:
        """Report a cut below the stock; lowest and highest tip (n, 3) of each piece."""
        box = self.material
        over = ((high >= box.low) & (low <= box.high))[:, :2].all(axis=1) & ~np.isnan(chunk.feed)
        below = np.where(over, box.low[2] - low[:, 2], 0.0)
        if below.max(initial=0.0) > TOLERANCE:
            piece = int(np.argmax(below > TOLERANCE))
            message = f"the tool cuts {float(below.max()):.6g} mm below the stock"
            hint = f"check that nothing but a spoilboard lies there; {COORDINATES}"
            line = int(chunk.line[piece])
            self._report("cut-below-stock", message, chunk.file, line, hint, once=True)

    def _report(
        self, code: str, message: str, file: str, line: int, hint: str, *, once: bool = False
    ) -> None:
        """Keep a finding, the first of its line, or of the program."""
        key = (code, "", 0) if once else (code, file, line)
        if key in self._reported:
            return
        self._reported.add(key)
        severity: Severity = "note" if code == "cut-below-stock" else "warning"
        self._findings.append(Diagnostic(code, message, file, line, hint=hint, severity=severity))
