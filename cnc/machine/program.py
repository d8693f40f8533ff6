"""The table [program] of a machine file: how programs are read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from cnc.machine.program_codes import Codes, RunFile
from cnc.model.choices import DialectName, GcodeSystem
from cnc.model.section import FilePath, Section, as_tuple


class Program(Section):
    """How programs are read. File names are relative to the machine file."""

    dialect: DialectName = Field(
        default="auto", description="Dialect of G-code; auto recognises it in the program."
    )
    g_code_system: GcodeSystem = Field(
        default="A",
        description=(
            "System of the G-codes of a FANUC or Haas lathe: in A G98 and G99 are the feed modes "
            "and G90, G92 and G94 cycles; in B and C G94 and G95 are the feed modes."
        ),
    )
    tool_table: FilePath | None = Field(
        default=None,
        description="File with the tool table. A run that changes the table writes the file.",
    )
    parameters: FilePath | None = Field(
        default=None,
        description=(
            "File with the parameters that are kept between programs. A run that changes "
            "them writes it."
        ),
    )
    subroutines: Annotated[tuple[FilePath, ...], BeforeValidator(as_tuple)] = Field(
        default=(),
        description="Folders with subprograms, searched after the folder of the program.",
    )
    codes: Codes = Field(
        default={},
        description=(
            'Effects of a builder\'s M-codes, such as M31 = "ignore", "pass-on" (to a GRBL board), '
            '"pause", { file = "m31.ngc" } or { output = 3, on = true }.'
        ),
    )
    max_repeated_lines: Annotated[int, Field(gt=0)] = Field(
        default=2_000_000,
        description="Repeated lines in loops and calls after which the program counts as endless.",
    )
    max_call_depth: Annotated[int, Field(gt=0, le=1000)] = Field(
        default=100, description="Nesting of calls beyond which the program counts as endless."
    )

    def files(self) -> Iterator[tuple[str, Path]]:
        """Yield key and path of each file that must exist; the first run makes the parameters."""
        if self.tool_table is not None:
            yield "tool_table", self.tool_table
        for path in self.subroutines:
            yield "subroutines", path
        for action in self.codes.values():
            if isinstance(action, RunFile):
                yield "codes", action.file
