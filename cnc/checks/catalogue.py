"""The findings that end nothing, by their codes: what a user may select, ignore and silence. No
error is among them.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

from cnc.model.diagnostics import Diagnostic, UsageError

LESSER = (
    "abort-possible",
    "arc-not-closed",
    "arc-radius-drift",
    "checkpoint-before",
    "checkpoint-differs",
    "comment-not-active",
    "compensation-radius-zero",
    "decimal-point-missing",
    "dwell-long",
    "feed-before-units",
    "feed-unreachable",
    "ignored-code-unknown",
    "move-below-step",
    "position-assumed",
    "rapid-into-stock",
    "run-unfinished",
    "spindle-off",
    "spindle-speed-missing",
    "step-rate",
    "word-shadowed",
    "word-without-effect",
)
"""Codes of warnings and notes."""

TOLD_ONCE = frozenset(("arc-radius-drift", "feed-unreachable", "move-below-step"))
"""Those that are told at the first of many places, with their number."""


def check_codes(codes: Iterable[str]) -> None:
    """UsageError ``unknown-finding`` for the first code that no warning and no note has."""
    for code in sorted(codes):
        if code not in LESSER:
            message = f"no warning or note is called {code!r}; errors are always shown"
            raise UsageError(Diagnostic("unknown-finding", message, hint=meant(code)))


def meant(code: str) -> str:
    """A hint for a code that there is not: those that are like it, or all."""
    close = difflib.get_close_matches(code.lower(), LESSER, n=3, cutoff=0.6)
    return f"did you mean {' or '.join(close)}?" if close else f"there are {', '.join(LESSER)}"
