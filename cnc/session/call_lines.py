"""Lines of subprograms, and the lines of the main program that call them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from cnc.model.blocks import Block, CallBoundary, Polyline
from cnc.model.motion_commands import apart


def line_of_call(blocks: Iterable[Block], file: str, line: int) -> int:
    """Return the line that first calls the subprogram which a line lies in.

    Args:
        blocks: Blocks of the program, with marks at its calls.
        file: The program.
        line: The line.

    Returns:
        The line of the call, 0 for a line of the main program.
    """
    call, low, high, found = 0, 0, 0, 0
    for block in apart(blocks):
        if isinstance(block, CallBoundary):
            call, low, high = block.line if block.inside else 0, 0, 0
        elif block.file == file:
            lines = block.lines if isinstance(block, Polyline) else np.array([block.line])
            if not call:
                if (lines == line).any():
                    return 0
                continue
            low, high = min(low or int(lines.min()), int(lines.min())), max(high, int(lines.max()))
            found = found or (call if low <= line <= high else 0)
    return found
