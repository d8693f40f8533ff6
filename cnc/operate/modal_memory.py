"""Modal state between the lines that an operator enters.

Each line runs as a program of its own. The lines before it have set units, distance mode, plane,
coordinate system, feed mode, path control, motion, feed and speed. These are written into a first
line of that program, so that a line has the same meaning as in one file.

A line whose codes are expressions, or that calls a subroutine or a macro, may change any of them:
then all are forgotten, and the defaults of a program hold. The operator is told.
"""

from __future__ import annotations

import re

GROUPS = {
    "units": ("G20", "G21"),
    "plane": ("G17", "G18", "G19"),
    "distance": ("G90", "G91"),
    "arc-distance": ("G90.1", "G91.1"),
    "feed-mode": ("G94",),
    "system": ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3"),
    "path": ("G61", "G61.1"),
    "motion": ("G0", "G1"),
}
"""Codes that are kept, by modal group."""
ENDING = {"G93": "feed-mode", "G95": "feed-mode", "G64": "path", "G2": "motion", "G3": "motion"}
"""Codes that end the kept code of a group, because they need other words in their line."""
_GROUP_OF = {code: group for group, codes in GROUPS.items() for code in codes}
_REMARK = re.compile(r"\([^)]*\)|;.*")
_WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
_UNREADABLE = re.compile(r"[#\[=O%]|M9[89]|G6[567]|M7[0-3]")


class ModalMemory:
    """The modal codes and words that the next line begins with."""

    def __init__(self) -> None:
        self._kept: dict[str, str] = {}

    def before(self, text: str) -> str:
        """Return the line that restores the state before a line; empty for the defaults."""
        own = {letter for letter, _ in _WORD.findall(_bare(text))}
        order = (*GROUPS, *(letter for letter in "FS" if letter not in own))
        return " ".join(self._kept[name] for name in order if name in self._kept)

    def forget(self) -> None:
        """Return to the defaults of a program."""
        self._kept.clear()

    def note(self, text: str) -> bool:
        """Take in a line that was carried out.

        Returns:
            Whether it was read; if not, everything is forgotten.
        """
        bare = _bare(text)
        if _UNREADABLE.search(bare):
            self.forget()
            return False
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
