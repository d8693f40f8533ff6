"""Modal groups and the modal state.

Codes of one group exclude each other in a line. Source: LinuxCNC, "G-code overview", modal groups;
RS274/NGC interpreter version 3 (NISTIR 6556), tables 3 and 4.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal, NamedTuple

from cnc.compiled.jit import interpreted
from cnc.gcode.core.tool_table import ToolTip
from cnc.gcode.dialects import Dialect
from cnc.gcode.kernels import rules
from cnc.gcode.reader.words import G, M, Word, fault
from cnc.machine.program_codes import CodeAction
from cnc.model.blocks import (
    AnalogOutput,
    Block,
    Coolant,
    DigitalOutput,
    Overrides,
    PathControl,
    PathMode,
    Plane,
    Spindle,
)
from cnc.model.choices import MissingPrograms, ToolLengths, UnknownCodes, WrapRule
from cnc.model.diagnostics import Fix, GcodeError

_GROUPS: dict[str, tuple[G, ...]] = {
    "motion": (
        G.G12, G.G13,
        G.G0, G.G1, G.G2, G.G3, G.G5, G.G5_1, G.G5_2, G.G5_3, G.G6_2, G.BSPLINE, G.G33, G.G33_1,
        G.G34, G.G35, G.G31, G.G38_2, G.G38_3, G.G38_4, G.G38_5, G.G73, G.G74, G.G76, G.G80,
        G.G81, G.G82, G.G83, G.G84, G.G85, G.G86, G.G87, G.G88, G.G89,
        G.G70, G.G71, G.G72, G.G75, G.G77, G.G78, G.G79,
    ),
    "non-modal": (
        G.G4, G.G7_1, G.G10, G.G28, G.G28_1, G.G30, G.G30_1, G.G52, G.G53, G.G53_1, G.G65, G.G66,
        G.G92, G.G92_1, G.G92_2, G.G92_3,
    ),
    "plane": (G.G17, G.G18, G.G19),
    "units": (G.G20, G.G21),
    "distance": (G.G90, G.G91),
    "arc-distance": (G.G90_1, G.G91_1),
    "feed-mode": (G.G93, G.G94, G.G95),
    "compensation": (G.G40, G.G41, G.G41_1, G.G42, G.G42_1),
    "tool-length": (G.G43, G.G43_1, G.G43_2, G.G43_4, G.G43_5, G.G44, G.G49),
    "system": (
        G.G54, G.G55, G.G56, G.G57, G.G58, G.G59, G.G59_1, G.G59_2, G.G59_3, G.G54_1,
    ),
    "path": (G.G61, G.G61_1, G.G64),
    "spindle-mode": (G.G96, G.G97),
    "retract": (G.G98, G.G99),
    "diameter": (G.G7, G.G8),
    "figure-polar": (G.G15, G.G16),
    "figure-scaling": (G.G50, G.G51),
    "figure-mirror": (G.G50_1, G.G51_1),
    "figure-rotation": (G.G68, G.G68_2, G.G69),
    "exact-stop-once": (G.G9,),
    "face": (G.G12_1, G.G13_1),
    "call": (G.G67,),
}  # fmt: skip
_M_GROUPS: dict[str, tuple[M, ...]] = {
    "stop": (M.M0, M.M1, M.M2, M.M30, M.M60, M.M97, M.M98, M.M99),
    "tool-change": (M.M6, M.M61),
    "spindle": (M.M3, M.M4, M.M5, M.M19),
    "coolant": (M.M7, M.M8, M.M9),
    "overrides": (M.M48, M.M49, M.M50, M.M51, M.M52, M.M53),
    "input-output": (M.M62, M.M63, M.M64, M.M65, M.M66, M.M67, M.M68),
    "kinematics": (M.M428, M.M429, M.M430),
    "state": (M.M70, M.M71, M.M72, M.M73),
    "skip-alarm": (M.M78, M.M79),
}
GROUP_OF_G = {code: group for group, codes in _GROUPS.items() for code in codes}
GROUP_OF_M = {code: group for group, codes in _M_GROUPS.items() for code in codes}

PLAIN_MOTIONS = (G.G0, G.G1, G.G2, G.G3)
"""Motion codes of straight moves and arcs."""
Turning = Literal["cw", "ccw"]
SPINDLE_STATES: tuple[Literal["off", "cw", "ccw"], ...] = ("off", "cw", "ccw")
"""States of the spindle by their number in :mod:`cnc.gcode.kernels.rules`."""
PLANES: dict[G, Plane] = {G.G17: "XY", G.G18: "ZX", G.G19: "YZ"}
SYSTEMS = {code: index for index, code in enumerate(_GROUPS["system"])}

FeedMode = Literal["per-minute", "inverse-time", "per-revolution"]
FEED_MODES: dict[G, FeedMode] = {
    G.G93: "inverse-time",
    G.G94: "per-minute",
    G.G95: "per-revolution",
}

_feeds_of_word = interpreted(rules.feeds_of_word)
_feed_status = interpreted(rules.feed_status)
_ENDS_ANYWAY = [{G.G80, motion} for motion in (*PLAIN_MOTIONS, G.G77, G.G78, G.G79)]


@dataclass(frozen=True, slots=True)
class Code:
    """A code of a line."""

    number: G | M
    word: Word

    @property
    def g(self) -> G:
        """The number of a G-code."""
        assert isinstance(self.number, G)
        return self.number


Codes = dict[str, Code]
"""The codes of a line by modal group."""


_CALLS, _MACRO_CALLS = (M.M97, M.M98, M.M99), (G.G65, G.G66, G.G67)
"""Codes that the flow of control takes out of a line before it is executed."""


_BOTH_COOLANTS = {M.M7, M.M8}


def codes_of(g: list[Word], m: list[Word], dialect: Dialect) -> Codes:
    """Return the codes of a line by modal group.

    Raises:
        GcodeError: The dialect lacks a code, or two codes belong to one group.
    """
    codes: Codes = {}
    for word in g:
        number = dialect.check_g(word) if word.letter == "G" else G.BSPLINE
        if number in _MACRO_CALLS and number is not G.G67:
            raise _call_left(word)
        _add(codes, GROUP_OF_G[number], Code(number, word), dialect)
    for word in m:
        code = dialect.check_m(word)
        if code in _CALLS:
            raise _call_left(word)
        group, before = GROUP_OF_M[code], codes.get("coolant")
        if before and {before.number, code} == _BOTH_COOLANTS and dialect.lines.both_coolants:
            group = "second-coolant"
        _add(codes, group, Code(code, word), dialect)
    return codes


def _call_left(word: Word) -> GcodeError:
    """The error for a call or return that the control flow did not execute.

    It was computed, or it is the second in its line.
    """
    message = f"{word.written} must be written as a number, once in a line"
    return fault(
        "call-not-alone", message, word, "write one M98, M99 or G65 in a line, not as an expression"
    )


def _add(codes: Codes, group: str, code: Code, dialect: Dialect) -> None:
    earlier = codes.get(group)
    if earlier and earlier.number == code.number and dialect.lines.same_code_twice:
        return
    if earlier and {earlier.number, code.number} in _ENDS_ANYWAY:
        # Moves and single cycles of lathes end cycles of holes too: G80 beside them is redundant.
        if code.number == G.G80:
            return
    elif earlier:
        if earlier.number == code.number:
            raise fault(
                "modal-conflict",
                f"{code.word.written} is given twice in this line",
                code.word,
                "remove one",
                fix=Fix.replace("remove one of them", code.word.column, code.word.length),
            )
        message = f"{earlier.word.written} and {code.word.written} exclude each other in a line"
        raise fault(
            "modal-conflict",
            message,
            code.word,
            "write them in two lines, in the intended order",
        )
    codes[group] = code


@dataclass(frozen=True, slots=True)
class Feed:
    """Feed of an F word, for moves of linear axes and for moves of rotary axes alone.

    Per minute: mm/s and deg/s. Per revolution: mm and degrees a revolution of the spindle.
    """

    linear: float
    rotary: float


@lru_cache(maxsize=1024)
def feed_of(number: float, scale: float, *, per_turn: bool = False) -> Feed:
    """Return the feed of an F word.

    Args:
        number: Program units, or degrees, a minute.
        scale: mm of a program unit.
        per_turn: The number is for a revolution of the spindle.
    """
    return Feed(*_feeds_of_word(number, scale, per_turn))


def check_feed(word: Word, rate: float) -> None:
    """Refuse an F word that is not more than 0, or whose feed (mm/s or degrees/s) is too slow.

    Raises:
        GcodeError: ``feed-not-positive``, ``feed-too-slow``.
    """
    status = _feed_status(word.number, rate)
    if status == rules.FEED_NOT_POSITIVE:
        raise fault("feed-not-positive", f"{word.written}: the feed must be more than 0", word)
    if status == rules.FEED_TOO_SLOW:
        message = f"{word.written}: the feed is less than {rules.MIN_FEED:g} mm/s"
        raise fault("feed-too-slow", message, word)


@dataclass(slots=True)
class ModalState:
    """State that stays in effect after a line.

    The defaults are LinuxCNC's: G17 G21 G90 G91.1 G94 G40 G49 G54 G97 G99 G8, M5 M9 M48 M53. One
    differs: LinuxCNC starts with G64, but here the path is exact until the program changes it.

    Attributes:
        scale: mm of a program unit.
        feed_scale: mm of a unit of feeds, which SINUMERIK's G70 and G71 leave as it was.
        diameter: X words are diameters (G7).
        radius_increments: X words are radii under G91 all the same (DIAM90).
        speed: rpm, or mm/s under G96.
        most_rpm: Limit of the spindle speed under G96; 0 for none.
        rpm_range: Lowest and highest speed of a spindle that turns (SINUMERIK's G25 and G26).
        tool: Number of the last T word.
        loaded: Number of the tool in the spindle; 0 for none.
        initial_level: Canned cycles end at the level before the first one, not at R (G98). It is
            unclear, and read as G98, until the program says so or is warned.
        compensation: The G41 or G42 in effect, or G40.
        scaled: Whether G51 is in effect.
    """

    motion: G | None = None
    plane: Plane = "XY"
    scale: float = 1.0
    feed_scale: float = 1.0
    diameter: bool = False
    radius_increments: bool = False
    absolute: bool = True
    arc_absolute: bool = False
    feed_mode: FeedMode = "per-minute"
    feed: Feed | None = None
    constant_surface: bool = False
    speed: float | None = None
    most_rpm: float = 0.0
    rpm_range: tuple[float, float] = (0.0, math.inf)
    spindle: Literal["cw", "ccw", "off"] = "off"
    mist: bool = False
    flood: bool = False
    tool: int | None = None
    loaded: int = 0
    initial_level: bool | Literal["unclear"] = False
    compensation: G = G.G40
    scaled: bool = False
    path: PathControl = "exact-path"
    tolerance: float = 0.0
    feed_override: bool = True
    speed_override: bool = True
    adaptive_feed: bool = False
    feed_stop: bool = True

    @property
    def turning(self) -> Turning:
        """Direction of the spindle; that of M3 if it is off."""
        return "ccw" if self.spindle == "ccw" else "cw"

    @property
    def rpm(self) -> float:
        """Speed of the spindle outside G96 while it turns; 0 without a speed."""
        return self.within_range(self.speed) if self.speed else 0.0

    def within_range(self, rpm: float) -> float:
        """Return a speed within its range."""
        lowest, highest = self.rpm_range
        return min(max(rpm, lowest), highest)

    @property
    def surface_limit(self) -> float:
        """Highest speed under G96, rpm; 0 for none."""
        highest = min(self.most_rpm or math.inf, self.rpm_range[1])
        return 0.0 if math.isinf(highest) else highest

    def surface_speed(self, file: str, line: int) -> Spindle:
        """Return the block of the spindle that turns under G96."""
        most, least = self.surface_limit, self.rpm_range[0]
        return Spindle(file, line, self.spindle, most, self.speed or 0.0, least_rpm=least)

    def x_factor(self, *, absolute: bool) -> float:
        """Return the length of a unit of X, which is a diameter or a radius."""
        return 0.5 if self.diameter and (absolute or not self.radius_increments) else 1.0

    @property
    def feeds_are_plain(self) -> bool:
        """Whether F counts units of distance a minute, or is one over the minutes of its move."""
        if self.feed_mode == "per-minute":
            return self.feed_scale == self.scale
        return self.feed_mode == "inverse-time"


# States of the machine that a block sets and that last, such as the spindle.


class Diverted(NamedTuple):
    """What a buffer had before its blocks were kept back."""

    ready: list[Iterable[Block]]
    in_effect: dict[tuple[str, int], tuple[object, ...]]
    turning: str


def lasting_state(block: Block) -> tuple[tuple[str, int], tuple[object, ...]] | None:
    """Return what a block sets, and its values; None for a block that sets nothing lasting."""
    match block:
        case Spindle(state=state, rpm=rpm, surface_speed=speed):
            return ("spindle", 0), (state, rpm, speed, block.least_rpm)
        case Coolant(mist=mist, flood=flood):
            return ("coolant", 0), (mist, flood)
        case Overrides(feed=feed, spindle=spindle, adaptive_feed=adaptive, feed_stop=stop):
            return ("overrides", 0), (feed, spindle, adaptive, stop)
        case PathMode(control=control, tolerance=tolerance):
            return ("path", 0), (control, tolerance)
        case DigitalOutput(number=number, on=on):
            return ("digital", number), (on,)
        case AnalogOutput(number=number, value=value):
            return ("analog", number), (value,)
    return None


# Choices of the user that change how every program is read.


@dataclass(frozen=True, slots=True)
class ReadingPolicy:
    """Choices of the user for reading.

    Attributes:
        tool_lengths: Without a tool table: refuse lengths and radii of tools, or take them as 0.
        unknown_codes: Refuse M-codes without a known meaning, or skip them with a warning.
        missing_programs: Refuse calls of missing programs, or skip them with a warning.
        codes: Effects of a builder's M-codes by number.
        default_feed: Feed before the first F word, mm/min; None for none.
        optional_stop: M1 stops like M0.
        lathe: The machine is a lathe.
        diameters: X is a diameter at the start on a lathe; None for the rule of the dialect.
        laser: S is the power of a laser, which changes in motion.
        wraps: Rule of each rotary axis that repeats after 360 degrees, by its letter.
        tool_tip: Positions of a machine with tool-tip control; None for another machine.
        tool_widths: Width of the edge of grooving tools by number, mm.
    """

    tool_lengths: ToolLengths = "table"
    unknown_codes: UnknownCodes = "error"
    missing_programs: MissingPrograms = "error"
    codes: Mapping[int, CodeAction] = field(default_factory=dict)
    default_feed: float | None = None
    optional_stop: bool = False
    lathe: bool = False
    diameters: bool | None = None
    laser: bool = False
    wraps: Mapping[str, WrapRule] = field(default_factory=dict)
    tool_tip: ToolTip | None = None
    tool_widths: Mapping[int, float] = field(default_factory=dict)


STRICT = ReadingPolicy()
