"""Simulation of a cut: the path of a program removes material from the stock.

The tool tip goes along the programmed path; corners are not rounded. Positions are machine
coordinates less the tool offset in effect (G43), so a longer tool cuts at the same place. The tool
turns about Z and comes from above: what lies over the tool is removed, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.stock.sweep import HOLDER, RAPID, SHANK, Depths
from cnc.machine.models import Machine, Stock
from cnc.model.blocks import ROTARY_LETTERS, Block, Tool, ToolOffset
from cnc.model.diagnostics import Diagnostic, Severity
from cnc.path.bounds import bounding_box
from cnc.path.chunk import PathChunk
from cnc.stock.material import Material
from cnc.stock.tool_shape import ToolShape

TOLERANCE = 1e-3
"""mm. Rounding alone may take a part of the tool this far into material."""
COORDINATES = "positions are machine coordinates, after all offsets, of the tool tip"

Floats = NDArray[np.float64]


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
