"""Helpers that any test may import."""

import os
from typing import TypeVar

Amount = TypeVar("Amount")


def soaking() -> bool:
    """Whether the long runs were asked for (``make soak``)."""
    return os.environ.get("CNC_SOAK") == "1"


def share(full: Amount, quick: Amount) -> Amount:
    """The amount of work of a long test: ``full`` under ``make soak``, ``quick`` in every run."""
    return full if soaking() else quick
