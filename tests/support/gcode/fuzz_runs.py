"""Runs of random programs, with limits of time and size."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cnc.gcode.core.call_stack import Limits
from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from cnc.gcode.reader.source_text import Text
from cnc.model.blocks import (
    Block,
)
from tests.support.gcode.fuzzing import Program
from tests.support.gcode.gcode_cases import read

SECONDS = 5.0
"""Limit of the CPU time of a program. Most take a millisecond."""
LIMITS = Limits(repeated_lines=500, depth=10)

TOOLS = tuple(
    ToolEntry(number, number, {"X": 0.5, "Z": 10.0 * number}, diameter=0.5 * number)
    for number in (1, 2, 3, 11)
)

FOLDERS = (Path(__file__).parent / "subroutines",)


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise TimeoutError in the block after this CPU time, if the platform has such a timer."""
    if not hasattr(signal, "setitimer"):
        yield
        return

    def stop(*_: Any) -> None:
        raise TimeoutError(f"more than {seconds} s")

    before = signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)


def blocks_of(sample: Program, **options: Any) -> list[Block]:
    """Run a program."""
    text = Text.of_lines(sample.lines, "test.nc")
    options |= {
        "block_delete": sample.block_delete,
        "limits": LIMITS,
        "folders": FOLDERS,
        "tools": ToolTable(TOOLS),
    }
    return list(read(text, axes=sample.axes, dialect=sample.dialect, **options))
