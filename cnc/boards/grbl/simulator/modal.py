"""The words of a line: modal groups, the parser's modes, and the errors of single words."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

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
