"""Tables of text for a terminal or a file: aligned columns, and styles where they are shown."""

from __future__ import annotations

import os
import sys
from collections.abc import Collection, Sequence
from typing import Literal, TextIO

GAP = "  "
"""Text between two columns."""
_CODES = {"bold": "1", "red": "31", "green": "32"}

Style = Literal["bold", "red", "green"]


def has_styles(stream: TextIO) -> bool:
    """Return whether a stream is a terminal that shows bold and coloured text.

    The console of Windows shows the codes of styles as text unless a program asks otherwise.
    """
    plain = os.environ.get("TERM") == "dumb" or bool(os.environ.get("NO_COLOR"))
    return stream.isatty() and sys.platform != "win32" and not plain


def styled(text: str, style: Style) -> str:
    """Return text with a style (SGR codes of ECMA-48, section 8.3.117)."""
    return f"\x1b[{_CODES[style]}m{text}\x1b[0m"


def aligned(rows: Sequence[Sequence[str]], *, right: Collection[int] = ()) -> list[list[str]]:
    """Return rows whose cells are as wide as their columns.

    Args:
        rows: cells of each row; all rows have as many.
        right: columns that are aligned at their right end.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        [
            cell.rjust(width) if index in right else cell.ljust(width)
            for index, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        for row in rows
    ]


def join(cells: Sequence[str]) -> str:
    """Return the cells of a row as a line."""
    return GAP.join(cells).rstrip()
