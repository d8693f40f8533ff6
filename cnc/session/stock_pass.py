"""The simulation of the cut in a check: the program is read once more, and cuts the stock."""

from __future__ import annotations

from collections.abc import Callable

from cnc.checks.tool_list import ToolList
from cnc.gcode.syntax.source_text import Text
from cnc.grbl_lines.exact_path import exact_path
from cnc.machine.models import Stock
from cnc.model.units import MM_PER_INCH
from cnc.session.program_reader import ProgramReader
from cnc.stock.simulation import StockSimulation
from cnc.stock.tool_shape import ToolShape, tool_shape


def simulate(
    reader: ProgramReader, stock: Stock, resolution: float | None = None
) -> StockSimulation:
    """Return the simulation of a program that has no faults.

    Args:
        reader: Reads the program.
        stock: The raw part.
        resolution: Width of a cell, mm; None for the default.
    """
    machine = reader.machine
    simulation = StockSimulation(machine, stock, _shapes(reader), resolution)
    blocks = reader.simulated_blocks()
    for item in exact_path(blocks, axes=machine.axis_names, start=reader.start):
        simulation.add(item)
    return simulation


def _shapes(reader: ProgramReader) -> Callable[[int], ToolShape]:
    """Return a function that finds the shape of a tool by number.

    The tool table comes first. A comment of the program gives what the table lacks.
    """
    table, listed = reader.saved.tools(), None

    def shape(number: int) -> ToolShape:
        nonlocal listed
        entry = table.tool(number)
        if entry is not None and entry.diameter > 0.0:
            return tool_shape(2.0 * entry.radius, entry.comment)
        if listed is None:
            listed = ToolList.of(Text.of_file(reader.path, reader.name).all_lines())
        tool = listed.tools.get(number)
        if tool is None:
            return tool_shape(0.0, "")
        scale = MM_PER_INCH if listed.inches else 1.0
        return tool_shape(listed.diameter(tool) or 0.0, tool.comment, scale=scale)

    return shape
