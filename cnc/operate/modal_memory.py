"""Modal state between the lines that an operator enters.

Each line runs as a program of its own. The lines before it have set units, distance mode, plane,
coordinate system, feed mode, path control, motion, feed and speed. These are written into a first
line of that program, so that a line has the same meaning as in one file.

A line whose codes are expressions, or that calls a subroutine or a macro, may change any of them:
then all are forgotten, and the defaults of a program hold. The operator is told.

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
    "motion": ("G0", "G1"),
}
"""Codes that are kept, by modal group."""
ENDING = {"G93": "feed-mode", "G95": "feed-mode", "G64": "path", "G2": "motion", "G3": "motion"}
"""Codes that end the kept code of a group, because they need other words in their line."""
_GROUP_OF = {code: group for group, codes in GROUPS.items() for code in codes}
_REMARK = re.compile(r"\([^)]*\)|;.*")
_WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
_COMPUTED = re.compile(r"([FS])(?=[-+]*(?:[#\[]|[A-Z]))")
_INSIDE = re.compile(r"\[[^\[\]]*\]|<[^<>]*>")
_UNREADABLE = re.compile(r"[GMO][-+]*[#\[]|O[0-9<]|O$|[\[\]<>%]|M9[89]|G6[567]|M7[0-3]")


class ModalMemory:
    """The modal codes and words that the next line begins with."""

    def __init__(self) -> None:
        self._kept: dict[str, str] = {}
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
        order = (*GROUPS, *(letter for letter in "FS" if letter not in own))
        given = [f"#{number}={value:.12f}" for number, value in self._parameters.items()]
        modes = " ".join(self._kept[name] for name in order if name in self._kept)
        return "\n".join([*given, *([modes] if modes else [])])

    def forget(self) -> None:
        """Return to the defaults of a program."""
        self._kept.clear()

    def note(self, text: str) -> bool:
        """Take in a line that was carried out.

        Returns:
            Whether it was read; if not, everything is forgotten.
        """
        bare = _bare(text)
        computed = set(_COMPUTED.findall(bare))
        while (shorter := _INSIDE.sub("#", bare)) != bare:
            bare = shorter
        if _UNREADABLE.search(bare):
            self.forget()
            return False
        for letter in computed:
            self._kept.pop(letter, None)
        words = _WORD.findall(bare)
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
        return True


def _bare(text: str) -> str:
    return re.sub(r"\s+", "", _REMARK.sub("", text)).upper()
