"""Modal state between the lines that an operator enters.

Each line runs as a program of its own. The lines before it have set units, distance mode, plane,
coordinate system, feed mode, path control, motion, feed and speed, the tool and its length. These
are written into first lines of that program, so that a line has the same meaning as in one file.
Other modes (cutter compensation, a rotated figure) end with their line, with a warning.

A line whose codes are expressions, or that calls a subroutine or a macro, may change any of them:
then all are forgotten, and the defaults of a program hold. A warning says so.

The numbered parameters below 5000 that a line leaves are assigned in the first line, too.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from cnc.model.parameter_numbers import SYSTEMS

MOST_PARAMETERS = 500
"""Parameters that are kept. With more of them all are forgotten."""
FIRST_SYSTEM = 5000
"""The parameters from here on belong to the machine."""
GROUPS = {
    "units": ("G20", "G21"),
    "plane": ("G17", "G18", "G19"),
    "distance": ("G90", "G91"),
    "arc-distance": ("G90.1", "G91.1"),
    "feed-mode": ("G94",),
    "system": SYSTEMS,
    "path": ("G61", "G61.1"),
    "diameter": ("G7", "G8"),
    "motion": ("G0", "G1"),
}
"""Codes that are kept, by modal group."""
_MOTIONS = "2 3 5 5.1 5.2 33 33.1 38.2 38.3 38.4 38.5 73 74 76 80 81 82 83 84 85 86 87 88 89"
ENDING = {
    "G93": "feed-mode",
    "G95": "feed-mode",
    "G64": "path",
    **{f"G{number}": "motion" for number in _MOTIONS.split()},
}
"""Codes that end the kept code of a group, because they need other words in their line."""
LENGTHS = ("G43", "G44", "G43.1")
"""Tool lengths that are kept, with their H, or with the distances of G43.1."""
ENDS_LENGTH = ("G49", "G43.2", "G43.4")
LOST = frozenset(
    ("G16", "G41", "G41.1", "G42", "G42.1", "G43.2", "G43.4", "G51", "G51.1", "G68", "G68.2", "G96")
)
"""Codes whose modes are not kept."""
_GROUP_OF = {code: group for group, codes in GROUPS.items() for code in codes}
_REMARK = re.compile(r"\([^)]*\)|;.*")
_WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
_COMPUTED = re.compile(r"([FS])(?=[-+]*(?:[#\[]|[A-Z]))")
_INSIDE = re.compile(r"\[[^\[\]]*\]|<[^<>]*>")
_UNREADABLE = re.compile(r"[GMO][-+]*[#\[]|O[0-9<]|O$|[\[\]<>%]|M9[89]|G6[567]|M7[0-3]")


class ModalMemory:
    """The modal codes and words that the next line begins with.

    Args:
        has_m61: The dialect of the lines has M61, which states the tool in the spindle.

    Attributes:
        lost: Codes of the last line whose modes have ended with it.
    """

    def __init__(self, *, has_m61: bool = True) -> None:
        self._has_m61 = has_m61
        self._kept: dict[str, str] = {}
        self._tool = self._length = ""
        self.lost: tuple[str, ...] = ()
        self._parameters: dict[int, float] = {}

    def note_parameters(self, values: Mapping[int, float]) -> bool:
        """Take over the parameters that a line leaves.

        Returns:
            Whether they are kept; if not, there are too many, and all are forgotten.
        """
        kept = {
            number: value
            for number, value in values.items()
            if 0 < number < FIRST_SYSTEM and math.isfinite(value)
        }
        self._parameters = kept if len(kept) <= MOST_PARAMETERS else {}
        return len(kept) <= MOST_PARAMETERS

    def before(self, text: str) -> str:
        """Return the lines that restore the state before a line; empty for the defaults."""
        own = {letter for letter, _ in _WORD.findall(_bare(text))}
        given = [f"#{number}={value:.12f}" for number, value in self._parameters.items()]
        return "\n".join([*given, *self._modes(own)])

    @property
    def modes(self) -> str:
        """The modes that the next line begins with; empty for the defaults."""
        return " ".join(self._modes(set()))

    def _modes(self, own: set[str]) -> list[str]:
        """Return lines: the tool, its length in the units of its line, and the other modes."""
        order = (*GROUPS, *(letter for letter in "FS" if letter not in own))
        modes = " ".join(self._kept[name] for name in order if name in self._kept)
        tool = f"M61 Q{self._tool}" if self._tool else ""
        return [line for line in (tool, self._length, modes) if line]

    def forget(self) -> None:
        """Return to the defaults of a program."""
        self._kept.clear()
        self._tool = self._length = ""

    def note(self, text: str) -> bool:
        """Take in a line that was carried out.

        Returns:
            Whether it was read; if not, everything is forgotten.
        """
        bare = _bare(text)
        self.lost = ()
        computed = set(_COMPUTED.findall(bare))
        while (shorter := _INSIDE.sub("#", bare)) != bare:
            bare = shorter
        if _UNREADABLE.search(bare):
            self.forget()
            return False
        for letter in computed:
            self._kept.pop(letter, None)
        words = _WORD.findall(bare)
        if not self._note_tool(bare, words):
            self.forget()
            return False
        codes = {f"G{float(number):g}" for letter, number in words if letter == "G"}
        values = {letter: f"{letter}{number}" for letter, number in words if letter in "FS"}
        if codes & {"G20", "G21", "G93", "G94", "G95"}:
            # The number of the feed has another meaning from here on.
            self._kept.pop("F", None)
        for code in codes:
            if code in _GROUP_OF:
                self._kept[_GROUP_OF[code]] = code
            elif code in ENDING:
                self._kept.pop(ENDING[code], None)
        if "feed-mode" not in self._kept and codes & {"G93", "G95"}:
            values.pop("F", None)
        self._kept |= values
        if any(letter == "M" and float(number) in (2.0, 30.0) for letter, number in words):
            self.forget()
        self.lost = tuple(sorted(codes & LOST))
        return True

    def _note_tool(self, bare: str, words: list[tuple[str, str]]) -> bool:
        """Take in the tool and its length; return whether both are known."""
        values = {letter: number for letter, number in words if letter not in "GM"}
        codes = {f"{letter}{float(number):g}" for letter, number in words if letter in "GM"}
        if self._has_m61 and codes & {"M6", "M61"}:
            letter = "T" if "M6" in codes else "Q"
            if letter not in values:
                return False
            self._tool = values[letter]
        if codes & set(ENDS_LENGTH):
            self._length = ""
        for code in codes & set(LENGTHS):
            # The number of an H that is left out is that of the tool.
            letters = "XYZABCUVW" if code == "G43.1" else "H"
            if re.search(rf"[{letters}][-+]*[#\[A-Z]", bare):
                return False
            given = [f"{letter}{values[letter]}" for letter in letters if letter in values]
            units = codes & {"G20", "G21"} or {self._kept.get("units", "G21")}
            self._length = " ".join([*units, code, *given])
        return True


def starts_outputs(text: str) -> bool:
    """Return whether a line starts spindle or coolant by a plain code."""
    words = _WORD.findall(_bare(text))
    return any(letter == "M" and float(number) in (3.0, 4.0, 7.0, 8.0) for letter, number in words)


def _bare(text: str) -> str:
    return re.sub(r"\s+", "", _REMARK.sub("", text)).upper()
