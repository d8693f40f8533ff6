"""Programs in the style of the posts of CAM systems and of machinists, made from a seed.

Each style has the heads, safe lines, tool changes, cycles and ends that the post writes. The
geometry is random. All programs are our own.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Iterator

from tests.support.corpus import hobby, industrial, shops, workshops

Maker = Callable[[random.Random], str]

STYLES: dict[str, Maker] = industrial.STYLES | hobby.STYLES | shops.STYLES | workshops.STYLES
"""The styles by name."""
EXPECTED: dict[str, str] = (
    industrial.EXPECTED | hobby.EXPECTED | shops.EXPECTED | workshops.EXPECTED
)
"""The dialect in which each style must be read."""


def programs(each: int, styles: Iterable[str] = STYLES) -> Iterator[tuple[str, int, str]]:
    """Yield style, seed and text of ``each`` programs of every style, or of some styles."""
    for style in styles:
        for seed in range(each):
            yield style, seed, STYLES[style](random.Random(f"{style} {seed}"))
