"""What a line means, and every reason to refuse it: the error codes 1 to 38 of the interface
documentation.

A line is read into words (:func:`words`), the words into modal groups and values, and the whole is
checked before anything is carried out: a line with an error does nothing (interface.md, "error:X").
Lengths are mm here and after, whatever the units of the program.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace

from cnc.boards.grbl.simulator.planner import Point

MM_PER_INCH = 25.4
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
    "coolant": ("M7", "M8", "M9"),
}
"""The modal groups (commands.md, ``$G``), and the words that hold for one line."""
GROUP_OF = {word: group for group, members in GROUPS.items() for word in members}
STORES = ("G28.1", "G30.1", "G92.1")
"""CommandLines beside which axis words are a motion, by the mode in force: seen on GRBL 1.1h, and
easily overlooked.
"""
SUBCOMMANDS = (28, 30, 38, 43, 61, 90, 91, 92)
"""G numbers that have others behind a point: one of those that does not exist is not known (20),
behind other numbers too precise (23).
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
"""CommandLines that use axis words; two of them in a line are one too many (error 24)."""
VALUES = "FIJKLNPRSTXYZ"
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)")

LARGEST_LINE_NUMBER = 10_000_000
LARGEST_TOOL = 255
ARC_ERROR_MOST = 0.5
ARC_ERROR_LEAST = 0.005
ARC_ERROR_SHARE = 0.001
"""An arc's end may lie 0.005 mm off its circle, or 0.1 % of the radius where that is more, never
0.5 mm (config.h, as the wiki tells).
"""


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
class Line:
    """A line that has passed the checks. ``modes``: those after it. Lengths in mm; ``target`` in
    machine coordinates.

    action: what is done last and may move: "" or one of WITH_AXES, G4 excepted (``dwell``). before:
    one of STORES, done before it.
    """

    modes: Modes
    action: str = ""
    before: str = ""
    target: Point = (0.0, 0.0, 0.0)
    axes: frozenset[int] = frozenset()
    words: tuple[float | None, float | None, float | None] = (None, None, None)
    center: tuple[float, float] = (0.0, 0.0)
    clockwise: bool = False
    feed: float = 0.0
    inverse: bool = False
    dwell: float | None = None
    number: int = 0
    flow: str = ""
    coolant: str = ""
    length_offset: float | None = None
    select: str = ""
    store: str = ""
    relative: bool = False
    sets_spindle: bool = False


@dataclass(frozen=True, slots=True)
class Place:
    """Where the parser stands: machine position, stored offsets by name (G54.., G28, G30, G92),
    tool length.
    """

    position: Point
    stored: dict[str, Point]
    length: float
    mist: bool = False

    def offset(self, coordinates: str) -> Point:
        """Work coordinate offset: system, G92 and tool length together (interface.md, WCO)."""
        (a, b, c), (d, e, f) = self.stored[coordinates], self.stored["G92"]
        return (a + d, b + e, c + f + self.length)


@dataclass(slots=True)
class Found:
    """Words of a line, sorted: commands by modal group, values by letter."""

    commands: dict[str, str] = field(default_factory=dict)
    values: dict[str, float] = field(default_factory=dict)

    def use(self, letter: str) -> float | None:
        """The value of a letter, which counts as used from now on."""
        return self.values.pop(letter, None)


def words(text: str) -> list[tuple[str, float]]:
    """Letters and numbers of a line without spaces. Error 1: no letter; 2: no number."""
    found: list[tuple[str, float]] = []
    at = 0
    while at < len(text):
        letter = text[at]
        if not "A" <= letter <= "Z":
            raise Refused(1)
        number = NUMBER.match(text, at + 1)
        if number is None:
            raise Refused(2)
        found.append((letter, float(number.group())))
        at = number.end()
    return found


def sort(text: str, mist: bool) -> Found:
    """CommandLines and values of a line. Errors 4, 20, 21, 23 to 25, 27, 29, 38."""
    line = Found()
    user_of_axes = ""
    for letter, value in words(text):
        if letter in "GM":
            word = f"{letter}{value:g}"
            if word not in GROUP_OF or (word == "M7" and not mist):
                raise Refused(_unknown(letter, value))
            group = GROUP_OF[word]
            if word in WITH_AXES:
                if user_of_axes:
                    raise Refused(24)
                user_of_axes = word
            if group in line.commands:
                raise Refused(21)
            line.commands[group] = word
        else:
            if letter not in VALUES:
                raise Refused(20)
            if letter in line.values:
                raise Refused(25)
            if value < 0.0 and letter in "FNPST":
                raise Refused(4)
            line.values[letter] = float(int(value)) if letter in "LNT" else value
    if line.values.get("N", 0.0) > LARGEST_LINE_NUMBER:
        raise Refused(27)
    if line.values.get("T", 0.0) > LARGEST_TOOL:
        raise Refused(38)
    return line


def _unknown(letter: str, value: float) -> int:
    """Why a command is refused: a fraction where there is none, or not known at all."""
    whole = int(value) if value < 1000.0 else -1
    if (
        value != whole
        and f"{letter}{whole}" in GROUP_OF
        and (letter != "G" or whole not in SUBCOMMANDS)
    ):
        return 23
    return 20


def check(text: str, modes: Modes, place: Place) -> Line:
    """What the line does from where the parser stands. Refused if anything in it is wrong."""
    found = sort(text, place.mist)
    commands = found.commands
    number = found.use("N")
    line = Line(modes, number=int(number or 0))
    modes = _set_modes(line, found)
    scale = MM_PER_INCH if modes.units == "G20" else 1.0
    other = commands.get("other", "")
    given = [found.values.get(axis) for axis in AXES]
    line.axes = frozenset(index for index, value in enumerate(given) if value is not None)
    scaled = tuple(None if value is None else value * scale for value in given)
    line.words = (scaled[0], scaled[1], scaled[2])
    line.relative = modes.distance == "G91"
    if other == "G4":
        line.dwell = found.use("P")
        if line.dwell is None:
            raise Refused(28)
    if commands.get("length"):
        _set_length(line, commands["length"])
    action = _action(line, commands, modes)
    if other == "G53" and modes.motion not in ("G0", "G1"):
        raise Refused(30)
    feed_word = found.use("F")
    modes = _set_feed(
        line, modes, feed_word, scale, action or ("G1" if commands.get("motion") == "G1" else "")
    )
    after = replace(
        place, length=line.length_offset if line.length_offset is not None else place.length
    )
    line.target = _target(line, modes, after, machine=other == "G53")
    if action == "G10":
        _store(line, found, modes, after)
    elif action == "G92" and not line.axes:
        raise Refused(26)
    elif action in ("G2", "G3"):
        _arc(line, found, modes, place, scale)
    elif action.startswith("G38"):
        if not line.axes:
            raise Refused(26)
        if line.target == place.position:
            raise Refused(33)
    if action:
        for letter in AXES:
            found.use(letter)
    for letter in "ST":
        found.use(letter)
    if found.values:
        raise Refused(36)
    line.action, line.modes = action, modes
    return line


def _set_modes(line: Line, found: Found) -> Modes:
    """The modes after the line, but for the feed."""
    commands, modes = found.commands, line.modes
    line.flow, line.coolant = commands.get("flow", ""), commands.get("coolant", "")
    line.select = commands.get("coordinates", "")
    line.sets_spindle = "spindle" in commands or found.values.get("S", modes.speed) != modes.speed
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
        tool=int(found.values.get("T", modes.tool)),
        speed=found.values.get("S", modes.speed),
    )


def _set_length(line: Line, word: str) -> None:
    """Tool length: G49, or G43.1 with a Z and nothing else."""
    if word == "G49":
        line.length_offset = 0.0
    elif line.axes != {2} or line.words[2] is None:
        raise Refused(37)
    else:
        line.length_offset = line.words[2]


def _action(line: Line, commands: dict[str, str], modes: Modes) -> str:
    """Which command the axis words belong to."""
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


def _set_feed(line: Line, modes: Modes, word: float | None, scale: float, action: str) -> Modes:
    """The feed in mm/min, or 1/min in G93, where each motion has its own. Error 22 without."""
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


def _target(line: Line, modes: Modes, place: Place, machine: bool) -> Point:
    """Machine coordinates that the axis words name."""
    offset = (0.0, 0.0, 0.0) if machine else place.offset(modes.coordinates)
    target = list(place.position)
    for index in line.axes:
        word = line.words[index] or 0.0
        if modes.distance == "G91" and not machine:
            target[index] = place.position[index] + word
        else:
            target[index] = word + offset[index]
    return (target[0], target[1], target[2])


def _store(line: Line, found: Found, modes: Modes, place: Place) -> None:
    """G10 L2 and L20: into which system (P0: the one in use), and what, which is kept in
    ``target``.
    """
    if not line.axes:
        raise Refused(26)
    how, system = found.use("L"), found.use("P")
    if how is None and system is None:
        raise Refused(28)
    # one of them is enough for GRBL 1.1h, the other is 0 then
    system = system or 0.0
    if how not in (2, 20) or "R" in found.values:
        raise Refused(20)
    if system >= 7.0:
        raise Refused(29)
    line.store = f"G{53 + int(system)}" if system >= 1.0 else modes.coordinates
    stored, shift = list(place.stored[line.store]), place.stored["G92"]
    for index in line.axes:
        word = line.words[index] or 0.0
        length = place.length if index == 2 else 0.0
        # L2: as told. L20: so that the tool stands at the words.
        stored[index] = word if how == 2 else place.position[index] - shift[index] - length - word
    line.target = (stored[0], stored[1], stored[2])


def _arc(line: Line, found: Found, modes: Modes, place: Place, scale: float) -> None:
    """The centre of G2 and G3, relative to the start. Errors 26, 32 to 35."""
    if not line.axes:
        raise Refused(26)
    first, second, _ = PLANES[modes.plane]
    if not line.axes & {first, second}:
        raise Refused(32)
    line.clockwise = modes.motion == "G2"
    start, end = place.position, line.target
    x, y = end[first] - start[first], end[second] - start[second]
    radius = found.use("R")
    if radius is not None:
        if line.target == place.position:
            raise Refused(33)
        line.center = _center_of_radius(x, y, radius * scale, line.clockwise)
        return
    i, j = found.values.get("IJK"[first]), found.values.get("IJK"[second])
    if i is None and j is None:
        raise Refused(35)
    found.use("IJK"[first])
    found.use("IJK"[second])
    i, j = (i or 0.0) * scale, (j or 0.0) * scale
    of_start, of_end = math.hypot(i, j), math.hypot(x - i, y - j)
    wrong = abs(of_end - of_start)
    if wrong > ARC_ERROR_LEAST and (wrong > ARC_ERROR_MOST or wrong > ARC_ERROR_SHARE * of_start):
        raise Refused(33)
    line.center = (i, j)


def _center_of_radius(x: float, y: float, radius: float, clockwise: bool) -> tuple[float, float]:
    """Centre of the arc to (x, y) with that radius; a negative one asks for the longer way round.
    Error 34 if the points are too far apart.

    The centre is on the chord's bisector, h off the chord: h^2 = r^2 - (chord/2)^2.
    """
    chord = math.hypot(x, y)
    h_sq = radius * radius - chord * chord / 4.0
    if chord == 0.0 or h_sq < 0.0:
        raise Refused(34)
    side = math.sqrt(h_sq) / chord
    if clockwise != (radius < 0.0):
        side = -side
    return (x / 2.0 - side * y, y / 2.0 + side * x)
