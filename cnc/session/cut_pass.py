"""The simulated cut of a program that has no faults, and the part that it leaves.

Most machines have no stock, so a session imports this module for one that has.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from cnc.checks.tool_list import ToolList
from cnc.gcode.reader.source_text import Text
from cnc.machine.models import Stock
from cnc.model.diagnostics import Diagnostic
from cnc.model.units import MM_PER_INCH
from cnc.path.build import exact_path
from cnc.report.result import Cut
from cnc.report.targets import BytesTarget
from cnc.session.context import SessionContext
from cnc.session.program_reader import ProgramReader
from cnc.stock.simulation import StockSimulation, ToolShape, tool_shape
from cnc.stock.stl import write_stl


def cut(
    context: SessionContext, stock: Stock, warn: Callable[[Iterable[Diagnostic]], None]
) -> None:
    """Simulate the cut, fill the report, and write the part if requested.

    Args:
        context: The session.
        stock: The raw part.
        warn: Reports the findings.
    """
    reader, options = context.reader, context.options
    machine = reader.machine
    simulation = StockSimulation(machine, stock, _shapes(reader), options.stock_resolution)
    blocks = reader.simulated_blocks()
    for item in exact_path(blocks, axes=machine.axis_names, start=reader.start):
        simulation.add(item)
    warn(simulation.findings())
    material = simulation.material
    context.report.cut = Cut(material.cell, material.removed_volume())
    if (on_cut := context.observer.callbacks.on_cut) is not None:
        on_cut(material)
    if options.outputs.stl is not None:
        write_stl(material, context.files.opened(BytesTarget(options.outputs.stl)))


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
