"""Waiting for a condition that another thread or process makes true."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

HANG = 300.0
"""Seconds after which a test gives up; none comes near it, even on a busy machine."""
POLL = 0.005
"""Seconds between two looks."""


def wait_until(condition: Callable[[], object]) -> None:
    """Return when the condition is true.

    Raises:
        TimeoutError: It is still false after ``HANG``.
    """
    end = time.monotonic() + HANG
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError("the condition does not become true")
        time.sleep(POLL)


def cpu_seconds(process: int) -> float:
    """Return the processor time of a running process, s (Linux: proc(5), fields 14 and 15)."""
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(") ", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
