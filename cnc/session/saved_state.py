"""What a machine remembers from one program to the next: the parameters and the tool table of its
machine file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from cnc.gcode.state.tool_table import ToolTable
from cnc.gcode.syntax.parameters import Parameters, read_parameters, write_parameters
from cnc.machine.models import Machine


class Memory:
    """Parameters and tools as they are before a program, for as many readings of it as need be.

    Raises MachineFileError or UsageError for files that can't be read. A parameter file that does
    not exist yet is an empty one.
    """

    def __init__(self, machine: Machine) -> None:
        program = machine.program
        self._parameter_file, self._tool_file = program.parameters, program.tool_table
        kept = self._parameter_file
        self._values = read_parameters(kept) if kept is not None and kept.exists() else {}
        self._tools = ToolTable() if self._tool_file is None else ToolTable.load(self._tool_file)

    def adopt(self, values: Mapping[int, float]) -> None:
        """What a board remembers itself counts for more than what the file says."""
        self._values = {**self._values, **values}

    def parameters(self, *, macro: bool) -> Parameters:
        """The parameters for one reading; ``macro``: with FANUC's ranges."""
        return Parameters(self._values, macro=macro)

    def tools(self) -> ToolTable:
        """The tools for one reading."""
        return ToolTable(self._tools, file=self._tools.file)

    def keep(self, parameters: Parameters, tools: ToolTable) -> None:
        """Write back what a program that ran to its end has left. UsageError ``can-not-write``."""
        if self._parameter_file is not None:
            write_parameters(self._parameter_file, parameters.stored())
        if self._tool_file is not None and tools.changed:
            tools.save(self._tool_file)


def folders(program: Path | None, machine: Machine) -> Sequence[Path]:
    """Where subroutines in files are looked for: beside the program (None: it has no place), then
    where the machine file says.
    """
    own = [] if program is None else [program.absolute().parent]
    return [*own, *machine.program.subroutines]
