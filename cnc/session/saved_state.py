"""State that a machine keeps between programs: the parameters and the tool table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from cnc.gcode.state.tool_table import ToolTable
from cnc.gcode.syntax.parameter_file import read_parameters, write_parameters
from cnc.gcode.syntax.parameters import Parameters
from cnc.machine.models import Machine


class SavedState:
    """Parameters and tools before a program, for each reading of it.

    A parameter file that does not exist yet is read as an empty one.

    Raises:
        MachineFileError, UsageError: If a file cannot be read.
    """

    def __init__(self, machine: Machine) -> None:
        program = machine.program
        self._parameter_file, self._tool_file = program.parameters, program.tool_table
        file = self._parameter_file
        self._values = read_parameters(file) if file is not None and file.exists() else {}
        self._tools = ToolTable() if self._tool_file is None else ToolTable.load(self._tool_file)

    def adopt(self, values: Mapping[int, float]) -> None:
        """Replace parameters by the values that a board keeps itself."""
        self._values = {**self._values, **values}

    @property
    def given(self) -> Mapping[int, float]:
        """Parameters that the file or the board has given, by number."""
        return self._values

    def parameters(self, *, macro: bool) -> Parameters:
        """Return the parameters for one reading; ``macro``: with the ranges of FANUC's macros."""
        return Parameters(self._values, macro=macro)

    def tools(self) -> ToolTable:
        """Return the tools for one reading."""
        return ToolTable(self._tools, file=self._tools.file)

    def save(self, parameters: Parameters, tools: ToolTable) -> None:
        """Write the state after a program that ran to its end. UsageError ``can-not-write``."""
        if self._parameter_file is not None:
            write_parameters(self._parameter_file, parameters.stored())
        if self._tool_file is not None and tools.changed:
            tools.save(self._tool_file)


def subroutine_folders(program: Path | None, machine: Machine) -> Sequence[Path]:
    """Return the folders in which subroutine files are searched for, in order.

    The folder of the program comes first (``program`` None: it has no folder), then those of the
    machine file.
    """
    own = [] if program is None else [program.absolute().parent]
    return [*own, *machine.program.subroutines]
