"""Lines of subprograms, the lines of the main program that call them, and unanswered lines."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from cnc.model.blocks import Block, CallBoundary, Polyline, Probe, WaitInput
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


def unanswered_line(blocks: Iterable[Block], file: str, line: int) -> int:
    """Return the first line at which a probe or an input decides how the program continues.

    Args:
        blocks: Blocks of the program, with marks at its calls.
        file: The program.
        line: The line up to which to look.

    Returns:
        The line in the main program, 0 for none before ``line``.
    """
    call = 0
    for block in apart(blocks):
        if isinstance(block, CallBoundary):
            call = block.line if block.inside else 0
            continue
        last = int(block.lines.max()) if isinstance(block, Polyline) else block.line
        here = call or (last if block.file == file else 0)
        if here >= line:
            return 0
        if here and isinstance(block, Probe | WaitInput):
            return here
    return 0
