"""A soft-CNC controller: G-code text in, jerk-limited step and direction pulses out.

The public functions and types are imported when they are first used, because they need numba.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

from cnc.version import __version__ as __version__

if TYPE_CHECKING:
    from cnc.api import (
        Block,
        Callbacks,
        Control,
        Machine,
        Outputs,
        PlanChunk,
        Progress,
        Report,
        RunOptions,
        Selection,
        check,
        check_many,
        convert_program,
        from_points,
        from_text,
        home,
        load_machine,
        parse,
        plan,
        run,
    )

__all__ = [
    "Block",
    "Callbacks",
    "Control",
    "Machine",
    "Outputs",
    "PlanChunk",
    "Progress",
    "Report",
    "RunOptions",
    "Selection",
    "check",
    "check_many",
    "convert_program",
    "from_points",
    "from_text",
    "home",
    "load_machine",
    "parse",
    "plan",
    "run",
]

logging.getLogger(__name__).addHandler(logging.NullHandler())


def __getattr__(name: str) -> Any:
    if name in __all__:
        from cnc import api

        return getattr(api, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
