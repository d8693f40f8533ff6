"""Modal groups and the modal state.

Codes of one group exclude each other in a line. Source: LinuxCNC, "G-code overview", modal groups;
RS274/NGC interpreter version 3 (NISTIR 6556), tables 3 and 4.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from cnc.gcode.dialects import Dialect
from cnc.gcode.syntax.words import Word, fault
from cnc.model.blocks import PathControl, Plane
from cnc.model.diagnostics import GcodeError
from cnc.model.units import per_second

NURBS = 62
"""G6.2, ten times its number as everywhere."""
CANCEL = 800
COMPENSATION_OFF = 400
BSPLINE = -10
"""Siemens' motion code that is a word."""

_GROUPS: dict[str, tuple[int, ...]] = {
    "motion": (
        0, 10, 20, 30, 50, 51, 52, 53, NURBS, BSPLINE, 330, 331, 382, 383, 384, 385, 730, 740, 760,
        CANCEL, 810, 820, 830, 840, 850, 860, 870, 880, 890,
    ),
    "non-modal": (40, 100, 280, 281, 300, 301, 520, 530, 650, 920, 921, 922, 923),
    "plane": (170, 180, 190),
    "units": (200, 210),
    "distance": (900, 910),
    "arc-distance": (901, 911),
    "feed-mode": (930, 940, 950),
    "compensation": (COMPENSATION_OFF, 410, 411, 420, 421),
    "tool-length": (430, 431, 432, 440, 490),
    "system": (540, 550, 560, 570, 580, 590, 591, 592, 593, 541),
    "path": (610, 611, 640),
    "spindle-mode": (960, 970),
    "retract": (980, 990),
    "diameter": (70, 80),
    # Ends of what no dialect has the beginning of. Headers of CAM posts hold them; there is nothing
    # to end.
    "polar": (150,),
    "call": (670,),
    "rotation": (690,),
}  # fmt: skip
_M_GROUPS: dict[str, tuple[int, ...]] = {
    "stop": (0, 1, 2, 30, 60, 98, 99),
    "tool-change": (6, 61),
    "spindle": (3, 4, 5, 19),
    "coolant": (7, 8, 9),
    "overrides": (48, 49, 50, 51, 52, 53),
    "input-output": (62, 63, 64, 65, 66, 67, 68),
    "state": (70, 71, 72, 73),
}
GROUP_OF_G = {code: group for group, codes in _GROUPS.items() for code in codes}
GROUP_OF_M = {code: group for group, codes in _M_GROUPS.items() for code in codes}

PLANES: dict[int, Plane] = {170: "XY", 180: "ZX", 190: "YZ"}
SYSTEMS = {code: index for index, code in enumerate(_GROUPS["system"])}

FeedMode = Literal["per-minute", "inverse-time", "per-revolution"]
FEED_MODES: dict[int, FeedMode] = {930: "inverse-time", 940: "per-minute", 950: "per-revolution"}


_ENDS_ANYWAY = [{CANCEL, plain} for plain in (0, 10, 20, 30)]


@dataclass(frozen=True, slots=True)
class Code:
    """A code of a line: ``number`` is ten times the code for G, the code for M."""

    number: int
    word: Word


Codes = dict[str, Code]
"""The codes of a line by modal group."""


CALLS_M, CALL_G = (98, 99), 650
"""Codes that the flow of control takes out of a line before it is executed."""


def codes_of(g: list[Word], m: list[Word], dialect: Dialect) -> Codes:
    """The codes of a line by modal group. Refuses what the dialect lacks, and two codes of one
    group.
    """
    found: Codes = {}
    for word in g:
        number = dialect.check_g(word) if word.letter == "G" else BSPLINE
        if number == CALL_G:
            raise _call_left(word)
        _add(found, GROUP_OF_G[number], Code(number, word))
    for word in m:
        number = dialect.check_m(word)
        if number in CALLS_M:
            raise _call_left(word)
        _add(found, GROUP_OF_M[number], Code(number, word))
    return found


def _call_left(word: Word) -> GcodeError:
    """The error for a call or return that the flow of control did not take: it was computed, or is
    the second of its line.
    """
    message = f"{word.written} can't be understood as a call or a return here"
    return fault("call-not-alone", message, word, "write M98, M99 or G65 as it is, one in a line")


def _add(found: Codes, group: str, code: Code) -> None:
    other = found.get(group)
    if other and {other.number, code.number} in _ENDS_ANYWAY:
        # G80 beside a plain motion code, which ends the cycles anyway.
        if code.number == CANCEL:
            return
    elif other:
        if other.number == code.number:
            raise fault(
                "modal-conflict",
                f"{code.word.written} is given twice in this line",
                code.word,
                "once is enough",
            )
        message = f"{other.word.written} and {code.word.written} can't stand in one line"
        raise fault(
            "modal-conflict",
            message,
            code.word,
            "write them in two lines, in the order that is meant",
        )
    found[group] = code


@dataclass(frozen=True, slots=True)
class Feed:
    """An F word as it was understood when it was read: for moves of linear axes, and for moves of
    rotary axes alone.

    Per minute: mm/s and deg/s. Per revolution: mm and deg a turn of the spindle.
    """

    linear: float
    rotary: float


@lru_cache(maxsize=1024)
def feed_of(number: float, scale: float) -> Feed:
    """The feed of an F word: ``number`` in program units of ``scale`` mm (or degrees), a minute."""
    return Feed(per_second(number * scale), per_second(number))


@dataclass(slots=True)
class Modal:
    """The state that lines leave behind, with LinuxCNC's defaults: G17 G21 G90 G91.1 G94 G40 G49
    G54 G97 G99 G8, M5 M9 M48 M53.

    One of them is not taken over: LinuxCNC begins with G64, but here a program leaves its path only
    where it says so.

    ``scale`` is mm a program unit; ``diameter`` (G7): X words are diameters. ``speed`` is in rpm,
    or mm/s under G96, where ``most_rpm`` limits the spindle (0: no limit). ``tool`` is the number
    of the last T word, ``loaded`` that of the tool in the spindle (0: none). ``compensation`` is
    ten times the code of the G41 or G42 in effect (0: none). ``initial_level`` (G98): cycles end at
    the level that they began from, not at R.
    """

    motion: int | None = None
    plane: Plane = "XY"
    scale: float = 1.0
    diameter: bool = False
    absolute: bool = True
    arc_absolute: bool = False
    feed_mode: FeedMode = "per-minute"
    feed: Feed | None = None
    constant_surface: bool = False
    speed: float | None = None
    most_rpm: float = 0.0
    spindle: Literal["cw", "ccw", "off"] = "off"
    mist: bool = False
    flood: bool = False
    tool: int | None = None
    loaded: int = 0
    initial_level: bool = False
    compensation: int = 0
    path: PathControl = "exact-path"
    tolerance: float = 0.0
    feed_override: bool = True
    speed_override: bool = True
    adaptive_feed: bool = False
    feed_stop: bool = True
