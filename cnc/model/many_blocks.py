"""Many blocks of one kind at once, for readers of long programs."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import fields
from itertools import repeat
from typing import TypeVar

from cnc.model.blocks import Block

AnyBlock = TypeVar("AnyBlock", bound=Block)


def blocks_of(
    kind: type[AnyBlock], files: Iterable[str], lines: list[int], *columns: Iterable[object]
) -> list[AnyBlock]:
    """Return many blocks of one kind in a third of the time that the initialiser takes.

    Args:
        kind: The kind.
        files: File of each block.
        lines: Line of each block; their number is that of the blocks.
        columns: Values of the other attributes, in their order, all given. ``repeat`` may be one.
    """
    new = object.__new__
    found = list(map(new, repeat(kind, len(lines))))
    for each, values in zip(fields(kind), (files, lines, *columns), strict=True):
        # The classes are frozen, but their slots can be set.
        deque(map(getattr(kind, each.name).__set__, found, values), maxlen=0)
    return found
