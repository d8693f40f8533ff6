"""Counts of work, in place of bounds on time: a busy computer must not fail a test."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def at_most(calls: int) -> Iterator[None]:
    """Refuse more calls of functions than ``calls``, of Python and of C, at the first too many.

    Raises:
        AssertionError: Where the work is more; so a loop that never ends is an error as well.
    """
    left = calls

    def count(_frame: object, event: str, _argument: object) -> None:
        nonlocal left
        if event in ("call", "c_call"):
            left -= 1
            if left < 0:
                sys.setprofile(None)
                raise AssertionError(f"more than {calls} calls")

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        yield
    finally:
        sys.setprofile(before)
