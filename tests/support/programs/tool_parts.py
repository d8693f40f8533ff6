"""Shipped programs that are long on a simulated board, in parts of one tool each."""

from __future__ import annotations

import re
from pathlib import Path

from tests.support.paths import PROGRAMS

LONG = ("drilling.nc",)
"""Programs whose motion takes several minutes.

The simulation of a chip takes a fifth of the time of the motion on a quiet computer, and more than
that on a busy one. So the whole of such a program could take longer than a test may.
"""
CHANGE = re.compile(r"^T\d+ M6$", re.MULTILINE)
END = "M30\n%\n"


def parts_of(text: str) -> list[str]:
    """Return a program for each tool: the lines before the first tool, those of the tool, END."""
    begins = [found.start() for found in CHANGE.finditer(text)]
    ends = [*begins[1:], text.index(END)]
    head = text[: begins[0]]
    return [head + text[begin:end] + END for begin, end in zip(begins, ends, strict=True)]


def in_parts(names: list[str]) -> list[str]:
    """Return names of programs; a program of LONG has a name for each part."""
    found = []
    for name in names:
        tools = len(parts_of((PROGRAMS / name).read_text())) if name in LONG else 0
        found += [f"{name} tool {number + 1}" for number in range(tools)] or [name]
    return found


def file_of(part: str, folder: Path) -> Path:
    """Return the file of a name of :func:`in_parts`; a part is written to a folder."""
    name, _, tool = part.partition(" tool ")
    if not tool:
        return PROGRAMS / name
    file = folder / name
    file.write_text(parts_of((PROGRAMS / name).read_text())[int(tool) - 1])
    return file
