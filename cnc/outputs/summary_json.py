"""Summaries as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from cnc.model.shown_text import shown_json
from cnc.outputs.targets import TextTarget
from cnc.report.result import Report


def write_json(name: str, summary: Report | Sequence[Report]) -> None:
    """Write the summary of a program, or a list of the summaries of several."""
    write_object(
        name,
        summary.as_json()
        if isinstance(summary, Report)
        else [report.as_json() for report in summary],
    )


def write_object(name: str, value: Any) -> None:
    """Write ``value`` (numbers, texts, lists, tables) as JSON to the file ``name``.

    Raises:
        UsageError: ``can-not-write``.
    """
    target = TextTarget(name)
    try:
        target.write(shown_json(json.dumps(value, indent=2, allow_nan=False)) + "\n")
        target.close()
    finally:
        target.discard()
