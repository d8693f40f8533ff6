"""The command ``cncrun tools``: a skeleton of the tool table from a program."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from cnc.cli.options import check_files, output
from cnc.model.diagnostics import Diagnostic, UsageError


def tools(
    program: Annotated[str, output("The program (- is standard input).")],
    /,
    *,
    file: Annotated[
        str | None,
        Parameter(name=["--output", "-o"], help="The file to write; by default it is printed."),
    ] = None,
) -> int:
    """Write a skeleton of the tool table of a program.

    The tools come from T, H and D words and from the comments of CAM systems. Measure each tool,
    add its length, and name the file in the machine file: tool_table under [program].
    """
    check_files((file,), (program,))
    from cnc.checks.tool_list import ToolList
    from cnc.gcode.syntax.source_text import Text
    from cnc.outputs.targets import TextTarget
    from cnc.session.source import display_name, readable_file

    with readable_file(program) as path:
        name = display_name(program)
        found = ToolList.of(Text.of_file(path, name).all_lines())
    if not found.tools:
        message, hint = "the program has no T word", "a program without tools needs no table"
        raise UsageError(Diagnostic("no-tools", message, name, hint=hint))
    text = "".join(line + "\n" for line in found.skeleton(name))
    if file is None:
        print(text, end="")
        return 0
    target = TextTarget(file)
    try:
        target.write(text)
        target.close()
    finally:
        target.discard()
    return 0
