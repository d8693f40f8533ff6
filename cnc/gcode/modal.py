"""Modal groups and the modal state.

Codes of one group exclude each other in a line. Source: RS274/NGC interpreter version 3 (NISTIR 6556), tables 3 and 4, and LinuxCNC's
"G-code overview", modal groups.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from cnc.canon import Plane
from cnc.gcode.dialects import Dialect
from cnc.gcode.words import Word, fault

NURBS = 62
"""G6.2, ten times its number as everywhere."""
CANCEL = 800

_GROUPS: dict[str, tuple[int, ...]] = {
    "motion": (0, 10, 20, 30, NURBS, CANCEL),
    "non-modal": (40, 100, 530, 920, 921, 922, 923),
    "plane": (170, 180, 190),
    "units": (200, 210),
    "distance": (900, 910),
    "arc-distance": (901, 911),
    "feed-mode": (930, 940),
    "compensation": (400,),
    "tool-length": (490,),
    "system": (540, 550, 560, 570, 580, 590, 591, 592, 593),
    "path": (610, 611, 640),
}
_M_GROUPS: dict[str, tuple[int, ...]] = {
    "stop": (0, 1, 2, 30),
    "tool-change": (6,),
    "spindle": (3, 4, 5),
    "coolant": (7, 8, 9),
}
GROUP_OF_G = {code: group for group, codes in _GROUPS.items() for code in codes}
GROUP_OF_M = {code: group for group, codes in _M_GROUPS.items() for code in codes}

PLANES: dict[int, Plane] = {170: "XY", 180: "ZX", 190: "YZ"}
SYSTEMS = {code: index for index, code in enumerate(_GROUPS["system"])}


@dataclass(frozen=True, slots=True)
class Code:
    """A code of a line: ``number`` is ten times the code for G, the code for M."""

    number: int
    word: Word


def codes_of(g: list[Word], m: list[Word], dialect: Dialect) -> dict[str, Code]:
    """The codes of a line by modal group. Refuses what the dialect lacks, and two codes of one group."""
    found: dict[str, Code] = {}
    for word in g:
        number = dialect.check_g(word)
        _add(found, GROUP_OF_G[number], Code(number, word))
    for word in m:
        number = dialect.check_m(word)
        _add(found, GROUP_OF_M[number], Code(number, word))
    return found


def _add(found: dict[str, Code], group: str, code: Code) -> None:
    if other := found.get(group):
        raise fault("modal-conflict", f"{other.word.written} and {code.word.written} can't stand in one line", code.word)
    found[group] = code


@dataclass(frozen=True, slots=True)
class Feed:
    """An F word as it was understood when it was read: mm/s for moves of linear axes, deg/s for moves of rotary axes alone."""

    linear: float
    rotary: float


@dataclass(slots=True)
class Modal:
    """The state that lines leave behind, with LinuxCNC's defaults: G17 G21 G90 G91.1 G94 G40 G49 G54 G64.

    ``scale`` is mm a program unit; ``speed`` rpm; ``tool`` the number of the last T word.
    """

    motion: int | None = None
    plane: Plane = "XY"
    scale: float = 1.0
    absolute: bool = True
    arc_absolute: bool = False
    inverse_time: bool = False
    compensation: bool = False
    feed: Feed | None = None
    speed: float | None = None
    spindle: Literal["cw", "ccw", "off"] = "off"
    mist: bool = False
    flood: bool = False
    tool: int | None = None
