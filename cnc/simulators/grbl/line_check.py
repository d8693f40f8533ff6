"""The checks of a line, with every reason to refuse it: error codes 1 to 38 of the documentation.

The words of a line are read and sorted (:mod:`cnc.simulators.grbl.line_check`). Then the whole
line is checked before anything is carried out: a line with an error does nothing (interface.md,
"error:X"). Lengths are mm from here on, whatever the units of the program.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace

from cnc.model.units import MM_PER_INCH
from cnc.simulators.grbl.planner import Point

# The words of a line: modal groups, the parser's modes, and the errors of single words.

AXES = "XYZ"
PLANES = {"G17": (0, 1, 2), "G18": (2, 0, 1), "G19": (1, 2, 0)}
"""First, second and normal axis."""

MOTION = ("G0", "G1", "G2", "G3", "G38.2", "G38.3", "G38.4", "G38.5", "G80")
GROUPS: dict[str, tuple[str, ...]] = {
    "other": ("G4", "G10", "G28", "G28.1", "G30", "G30.1", "G53", "G92", "G92.1"),
    "motion": MOTION,
    "plane": tuple(PLANES),
    "distance": ("G90", "G91"),
    "arc distance": ("G91.1",),
    "feed": ("G93", "G94"),
    "units": ("G20", "G21"),
    "compensation": ("G40",),
    "length": ("G43.1", "G49"),
    "coordinates": ("G54", "G55", "G56", "G57", "G58", "G59"),
    "path": ("G61",),
    "flow": ("M0", "M1", "M2", "M30"),
    "spindle": ("M3", "M4", "M5"),
    "tool": ("M6",),
    "coolant": ("M7", "M8", "M9"),
}
"""The modal groups (commands.md, ``$G``), and the words that hold for one line."""
GROUP_OF = {word: group for group, members in GROUPS.items() for word in members}
STORES = ("G28.1", "G30.1", "G92.1")
"""Commands beside which axis words are a motion by the mode in effect.

Observed on GRBL 1.1h, and easily overlooked.
"""
SUBCOMMANDS = (28, 30, 38, 43, 61, 90, 91, 92)
"""G numbers with subcommands after a point.

A subcommand that does not exist is unknown (20); after other numbers a fraction is an error (23).
"""
WITH_AXES = (
    "G10",
    "G28",
    "G30",
    "G92",
    "G0",
    "G1",
    "G2",
    "G3",
    "G38.2",
    "G38.3",
    "G38.4",
    "G38.5",
    "G43.1",
)
"""Commands that use axis words; two of them in a line are an error (24)."""
VALUES = "FIJKLNPRST"
"""Letters of values beside the axes."""
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)")

LARGEST_LINE_NUMBER = 10_000_000
LARGEST_TOOL = 255


class Refused(Exception):
    """A line that gets ``error:code``."""

    def __init__(self, code: int) -> None:
        super().__init__(f"error:{code}")
        self.code = code


@dataclass(frozen=True, slots=True)
class Modes:
    """The parser's state, ``$G``."""

    motion: str = "G0"
    coordinates: str = "G54"
    plane: str = "G17"
    units: str = "G21"
    distance: str = "G90"
    feed_mode: str = "G94"
    spindle: str = "M5"
    flood: bool = False
    mist: bool = False
    tool: int = 0
    feed: float = 0.0
    speed: float = 0.0


@dataclass(slots=True)
class SortedWords:
    """The words of a line: commands by modal group, values by letter."""

    commands: dict[str, str] = field(default_factory=dict)
    values: dict[str, float] = field(default_factory=dict)

    def use(self, letter: str) -> float | None:
        """Return the value of a letter, and mark it as used."""
        return self.values.pop(letter, None)


def words(text: str) -> list[tuple[str, float]]:
    """Return letters and numbers of a line without spaces. Error 1: no letter; 2: no number."""
    pairs: list[tuple[str, float]] = []
    at = 0
    while at < len(text):
        letter = text[at]
        if not "A" <= letter <= "Z":
            raise Refused(1)
        number = NUMBER.match(text, at + 1)
        if number is None:
            raise Refused(2)
        pairs.append((letter, float(number.group())))
        at = number.end()
    return pairs


OPTIONAL = frozenset(("M6", "M7"))
"""Codes that some builds do not have."""


def sort_words(text: str, codes: frozenset[str] = frozenset(), axes: str = AXES) -> SortedWords:
    """Return commands and values of a line. Errors 4, 20, 21, 23 to 25, 27, 29, 38.

    Args:
        text: The line without spaces.
        codes: Those of OPTIONAL that the firmware has.
        axes: Letters of its axes.
    """
    line = SortedWords()
    for letter, value in words(text):
        if letter in "GM":
            _add_command(line, letter, value, codes)
        else:
            _add_value(line, letter, value, axes)
    if line.values.get("N", 0.0) > LARGEST_LINE_NUMBER:
        raise Refused(27)
    if line.values.get("T", 0.0) > LARGEST_TOOL:
        raise Refused(38)
    return line


def _add_command(line: SortedWords, letter: str, value: float, codes: frozenset[str]) -> None:
    word = f"{letter}{value:g}"
    if word not in GROUP_OF or word in OPTIONAL - codes:
        raise Refused(_unknown(letter, value))
    group = GROUP_OF[word]
    if word in WITH_AXES and any(other in WITH_AXES for other in line.commands.values()):
        raise Refused(24)
    if group in line.commands:
        raise Refused(21)
    line.commands[group] = word


def _add_value(line: SortedWords, letter: str, value: float, axes: str) -> None:
    if letter not in VALUES and letter not in axes:
        raise Refused(20)
    if letter in line.values:
        raise Refused(25)
    if value < 0.0 and letter in "FNPST":
        raise Refused(4)
    line.values[letter] = float(int(value)) if letter in "LNT" else value


def _unknown(letter: str, value: float) -> int:
    """Return why a command is refused: 23 for a wrong fraction, 20 if it is unknown."""
    whole = int(value) if value < 1000.0 else -1
    if (
        value != whole
        and f"{letter}{whole}" in GROUP_OF
        and (letter != "G" or whole not in SUBCOMMANDS)
    ):
        return 23
    return 20


ARC_ERROR_MOST = 0.5
ARC_ERROR_LEAST = 0.005
ARC_ERROR_SHARE = 0.001
"""The end of an arc may lie 0.005 mm off its circle, or 0.1 % of the radius where that is more, but
never 0.5 mm (config.h, by the wiki).
"""


@dataclass(slots=True)
class CheckedLine:
    """A line that has passed the checks. Lengths are mm.

    Attributes:
        modes: The modes after the line.
        action: The last command, which may move: "" or one of WITH_AXES.
        before: One of STORES that comes before it.
        target: Target, or the values to store, in machine coordinates.
        axes: Numbers of the axes that the line names.
        words: Values of the axis words.
        center: Centre of an arc from its start, along the axes of its plane.
        clockwise: Sense of an arc.
        feed: mm/min, or 1/min with ``inverse``.
        inverse: Whether the feed is an inverse time (G93).
        dwell: Seconds of G4.
        number: The N word; 0 without.
        flow: M0, M1, M2 or M30.
        coolant: M7, M8 or M9.
        changes_tool: Whether it has M6.
        length_offset: New tool length; None without.
        select: New coordinate system.
        store: Coordinate system that G10 stores.
        relative: Whether G91 is in effect.
        sets_spindle: Whether the line has a spindle command or a new speed.
    """

    modes: Modes
    action: str = ""
    before: str = ""
    target: Point = (0.0, 0.0, 0.0)
    axes: frozenset[int] = frozenset()
    words: tuple[float | None, ...] = (None, None, None)
    center: tuple[float, float] = (0.0, 0.0)
    clockwise: bool = False
    feed: float = 0.0
    inverse: bool = False
    dwell: float | None = None
    number: int = 0
    flow: str = ""
    coolant: str = ""
    changes_tool: bool = False
    length_offset: float | None = None
    select: str = ""
    store: str = ""
    relative: bool = False
    sets_spindle: bool = False


@dataclass(frozen=True, slots=True)
class ParserPosition:
    """The position of the parser.

    Attributes:
        position: Machine position, mm.
        stored: Stored offsets by name (G54.., G28, G30, G92), mm.
        length: Tool length, mm.
        codes: Codes that only some builds have.
        axes: Letters of the axes.
        rotary: Numbers of the axes that inches do not scale.
    """

    position: Point
    stored: dict[str, Point]
    length: float
    codes: frozenset[str] = frozenset()
    axes: str = AXES
    rotary: frozenset[int] = frozenset()

    def offset(self, coordinates: str) -> Point:
        """Return the work offset: system, G92 and tool length together (interface.md, WCO)."""
        sums = [a + b for a, b in zip(self.stored[coordinates], self.stored["G92"], strict=True)]
        sums[2] += self.length
        return tuple(sums)


def check_line(text: str, modes: Modes, place: ParserPosition) -> CheckedLine:
    """Return the line with its effect; Refused if anything in it is wrong."""
    words = sort_words(text, place.codes, place.axes)
    number = words.use("N")
    line = CheckedLine(modes, number=int(number or 0))
    modes = _set_modes(line, words)
    scale = MM_PER_INCH if modes.units == "G20" else 1.0
    _set_words(line, words, modes, scale, place)
    other = words.commands.get("other", "")
    if other == "G4":
        line.dwell = words.use("P")
        if line.dwell is None:
            raise Refused(28)
    if words.commands.get("length"):
        _set_length(line, words.commands["length"])
    action = _action(line, words.commands, modes)
    if other == "G53" and modes.motion not in ("G0", "G1"):
        raise Refused(30)
    moves_by = action or ("G1" if words.commands.get("motion") == "G1" else "")
    modes = _set_feed(line, modes, words.use("F"), scale, moves_by)
    after = replace(
        place, length=line.length_offset if line.length_offset is not None else place.length
    )
    line.target = _target(line, modes, after, machine=other == "G53")
    if action == "G10":
        _store(line, words, modes, after)
    elif action in ("G2", "G3"):
        _arc(line, words, modes, place, scale)
    else:
        _check_axes(line, action, place)
    for letter in "ST" if not action else place.axes + "ST":
        words.use(letter)
    if words.values:
        raise Refused(36)
    line.action, line.modes = action, modes
    return line


def _set_words(
    line: CheckedLine, words: SortedWords, modes: Modes, scale: float, place: ParserPosition
) -> None:
    given = [words.values.get(axis) for axis in place.axes]
    line.axes = frozenset(index for index, value in enumerate(given) if value is not None)
    line.words = tuple(
        None if value is None else value * (1.0 if index in place.rotary else scale)
        for index, value in enumerate(given)
    )
    line.relative = modes.distance == "G91"


def _check_axes(line: CheckedLine, action: str, place: ParserPosition) -> None:
    """Check that G92 and probes have axis words. Errors 26, 33."""
    if action != "G92" and not action.startswith("G38"):
        return
    if not line.axes:
        raise Refused(26)
    if action != "G92" and line.target == place.position:
        raise Refused(33)


def _set_modes(line: CheckedLine, words: SortedWords) -> Modes:
    """Return the modes after the line, except for the feed."""
    commands, modes = words.commands, line.modes
    line.flow, line.coolant = commands.get("flow", ""), commands.get("coolant", "")
    line.select = commands.get("coordinates", "")
    line.changes_tool = "tool" in commands
    line.sets_spindle = "spindle" in commands or words.values.get("S", modes.speed) != modes.speed
    coolant = line.coolant
    return replace(
        modes,
        motion=commands.get("motion", modes.motion),
        coordinates=line.select or modes.coordinates,
        plane=commands.get("plane", modes.plane),
        units=commands.get("units", modes.units),
        distance=commands.get("distance", modes.distance),
        feed_mode=commands.get("feed", modes.feed_mode),
        spindle=commands.get("spindle", modes.spindle),
        flood=coolant == "M8" or (modes.flood and coolant != "M9"),
        mist=coolant == "M7" or (modes.mist and coolant != "M9"),
        tool=int(words.values.get("T", modes.tool)),
        speed=words.values.get("S", modes.speed),
    )


def _set_length(line: CheckedLine, word: str) -> None:
    """Set the tool length: G49, or G43.1 with Z alone."""
    if word == "G49":
        line.length_offset = 0.0
    elif line.axes != {2} or line.words[2] is None:
        raise Refused(37)
    else:
        line.length_offset = line.words[2]


def _action(line: CheckedLine, commands: dict[str, str], modes: Modes) -> str:
    """Return the command that the axis words belong to."""
    other, motion = commands.get("other", ""), commands.get("motion", "")
    if other in WITH_AXES:
        return other
    if other in STORES:
        line.before = other
    if commands.get("length") == "G43.1":
        return "G43.1"
    if motion in ("G2", "G3") or motion.startswith("G38"):
        return motion
    if line.axes:
        if modes.motion == "G80":
            raise Refused(31)
        return modes.motion
    return ""


def _set_feed(
    line: CheckedLine, modes: Modes, word: float | None, scale: float, action: str
) -> Modes:
    """Set the feed, and return the modes with it.

    It is in mm/min, or in 1/min in G93, where each motion has its own. Error 22 without one.
    """
    line.inverse = modes.feed_mode == "G93"
    moves = action in MOTION and action not in ("G0", "G80")
    if line.inverse:
        if moves and not word:
            raise Refused(22)
        line.feed = word or 0.0
        return replace(modes, feed=word or 0.0)
    kept = modes.feed if line.modes.feed_mode == "G94" else 0.0
    line.feed = kept if word is None else word * scale
    if moves and line.feed == 0.0:
        raise Refused(22)
    return replace(modes, feed=line.feed)


def _target(line: CheckedLine, modes: Modes, place: ParserPosition, machine: bool) -> Point:
    """Return the machine coordinates that the axis words name."""
    offset = (0.0,) * len(place.axes) if machine else place.offset(modes.coordinates)
    target = list(place.position)
    for index in line.axes:
        word = line.words[index] or 0.0
        if modes.distance == "G91" and not machine:
            target[index] = place.position[index] + word
        else:
            target[index] = word + offset[index]
    return tuple(target)


def _store(line: CheckedLine, words: SortedWords, modes: Modes, place: ParserPosition) -> None:
    """Set the system (P0: the present one) and values that G10 L2 or L20 stores."""
    if not line.axes:
        raise Refused(26)
    how, system = words.use("L"), words.use("P")
    if how is None and system is None:
        raise Refused(28)
    # GRBL 1.1h accepts one of them alone; the other is 0 then
    system = system or 0.0
    if how not in (2, 20) or "R" in words.values:
        raise Refused(20)
    if system >= 7.0:
        raise Refused(29)
    line.store = f"G{53 + int(system)}" if system >= 1.0 else modes.coordinates
    stored, shift = list(place.stored[line.store]), place.stored["G92"]
    for index in line.axes:
        word = line.words[index] or 0.0
        length = place.length if index == 2 else 0.0
        # L2: the words themselves. L20: offsets with which the tool stands at the words.
        stored[index] = word if how == 2 else place.position[index] - shift[index] - length - word
    line.target = tuple(stored)


def _arc(
    line: CheckedLine, words: SortedWords, modes: Modes, place: ParserPosition, scale: float
) -> None:
    """Set the centre of G2 or G3 from the start. Errors 26, 32 to 35."""
    if not line.axes:
        raise Refused(26)
    first, second, _ = PLANES[modes.plane]
    if not line.axes & {first, second}:
        raise Refused(32)
    line.clockwise = modes.motion == "G2"
    start, end = place.position, line.target
    x, y = end[first] - start[first], end[second] - start[second]
    radius = words.use("R")
    if radius is not None:
        if line.target == place.position:
            raise Refused(33)
        line.center = _center_of_radius(x, y, radius * scale, line.clockwise)
        return
    i, j = words.values.get("IJK"[first]), words.values.get("IJK"[second])
    if i is None and j is None:
        raise Refused(35)
    words.use("IJK"[first])
    words.use("IJK"[second])
    i, j = (i or 0.0) * scale, (j or 0.0) * scale
    of_start, of_end = math.hypot(i, j), math.hypot(x - i, y - j)
    wrong = abs(of_end - of_start)
    if wrong > ARC_ERROR_LEAST and (wrong > ARC_ERROR_MOST or wrong > ARC_ERROR_SHARE * of_start):
        raise Refused(33)
    line.center = (i, j)


def _center_of_radius(x: float, y: float, radius: float, clockwise: bool) -> tuple[float, float]:
    """Return the centre of the arc to (x, y) with a radius; a negative one gives the longer arc.

    Error 34 if the points are too far apart. The centre is on the bisector of the chord, h off the
    chord: h^2 = r^2 - (chord/2)^2.
    """
    chord = math.hypot(x, y)
    h_sq = radius * radius - chord * chord / 4.0
    if chord == 0.0 or h_sq < 0.0:
        raise Refused(34)
    side = math.sqrt(h_sq) / chord
    if clockwise != (radius < 0.0):
        side = -side
    return (x / 2.0 - side * y, y / 2.0 + side * x)
