"""A skeleton of the tool table from the T, H and D words and the comments of a program.

CAM systems list the tools in comments, such as ``(T1 D=6. CR=0. - ZMIN=-5. - flat end mill)``. A
diameter that such a comment names is taken over in mm. A length is never guessed: each line lacks
its Z, and stands behind a semicolon until somebody has measured the tool.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from cnc.gcode.core.tool_table import MAX_TOOL
from cnc.model.diagnostics import printable
from cnc.model.units import MM_PER_INCH

_COMMENT = re.compile(r"\(((?:[^()]|\([^()]*\))*)\)|;(.*)")
_WORDS = re.compile(r"(?<![A-Z])([THD])\s*0*([0-9]{1,5})(?![0-9.])", re.IGNORECASE)
_WITH_OFFSET = re.compile(r"(?<![A-Z])T\s*0*([0-9]{1,5})\.0*\1(?![0-9.])", re.IGNORECASE)
"""Fagor's ``T5.5``: tool 5 with offset 5."""
_TOOL_CALL = re.compile(r"TOOL\s+CALL\s+(?=[0-9])", re.IGNORECASE)
"""Klartext's word of a tool."""
_NAMED = re.compile(
    r"^\W*(?:TOOL\s*(?:NUMBER|NO\.?|#)?\s*[:#=-]?\s*|T\s*)0*([0-9]{1,5})\b(?!\s*M?0?6)[\s|:,=-]*(.*)",
    re.IGNORECASE,
)
_DIAMETER = re.compile(
    r"\bD(?:IA(?:METER)?)?\.?\s*[=:]\s*([0-9]*\.?[0-9]+)|([0-9]*\.?[0-9]+)\s*(?:MM|\")?\s*DIA\b"
    r"|\b([0-9]*\.?[0-9]+)\s*MM\b",
    re.IGNORECASE,
)
_INCHES = re.compile(r"(?<![A-Z0-9.])G(?:20|70)(?![0-9.])", re.IGNORECASE)


@dataclass(slots=True)
class ListedTool:
    """A tool of a program.

    Attributes:
        number: Its number.
        line: Line of the first T word, or of the comment.
        comment: Text of the comment that names it.
        lengths: Numbers of H words while it is in use.
        radii: Numbers of D words while it is in use.
    """

    number: int
    line: int
    comment: str = ""
    lengths: set[int] = field(default_factory=set)
    radii: set[int] = field(default_factory=set)


@dataclass(slots=True)
class ToolList:
    """The tools of a program by number, and whether it is in inches."""

    tools: dict[int, ListedTool] = field(default_factory=dict)
    inches: bool = False

    @classmethod
    def of(cls, lines: Iterable[str]) -> ToolList:
        """Return the tools of a program from its lines."""
        listing, used = cls(), 0
        named: dict[int, ListedTool] = {}
        for number, line in enumerate(lines, start=1):
            for comment in _COMMENT.finditer(line):
                if name := _NAMED.match((comment[1] or comment[2] or "").strip()):
                    tool = int(name[1])
                    named.setdefault(tool, ListedTool(tool, number, " ".join(name[2].split())))
            code = _TOOL_CALL.sub("T", _WITH_OFFSET.sub(r"T\1", _COMMENT.sub(" ", line)))
            listing.inches = listing.inches or _INCHES.search(code) is not None
            for letter, digits in _WORDS.findall(code):
                value = int(digits)
                if not 0 < value <= MAX_TOOL:
                    continue
                if letter.upper() == "T":
                    used = value
                    listing.tools.setdefault(value, ListedTool(value, number))
                elif used:
                    tool_used = listing.tools[used]
                    (tool_used.lengths if letter in "Hh" else tool_used.radii).add(value)
        for tool, listed in named.items():
            if tool in listing.tools:
                listing.tools[tool].comment = listed.comment
        return listing

    def diameter(self, tool: ListedTool) -> float | None:
        """Return the diameter that the comment of a tool names, in mm."""
        match = _DIAMETER.search(tool.comment)
        if match is None:
            return None
        value = float(match[1] or match[2] or match[3])
        is_metric = match[3] is not None or "mm" in match[0].lower()
        return value * (MM_PER_INCH if self.inches and not is_metric else 1.0)

    def skeleton(self, program: str) -> Iterator[str]:
        """Yield the lines of the table."""
        yield f"; Tools of {printable(program)}, lengths in mm."
        yield "; Measure each tool, add Z and its length, and remove the semicolon before T."
        numbers = sorted(
            {*self.tools, *(length for t in self.tools.values() for length in t.lengths)}
        )
        for number in numbers:
            tool = self.tools.get(number)
            diameter = self.diameter(tool) if tool else None
            words = f"; T{number} P{number}" + (f" D{diameter:.6g}" if diameter else "")
            yield f"{words} ;{_remark(number, tool)}".rstrip()


def _remark(number: int, tool: ListedTool | None) -> str:
    """Return the comment of a line: the CAM system's, and offsets with other numbers."""
    if tool is None:
        return f"length H{number}"
    others = [f"H{number_used}" for number_used in sorted(tool.lengths - {number})]
    others += [f"D{number_used}" for number_used in sorted(tool.radii - {number})]
    parts = [
        tool.comment or f"line {tool.line}",
        *([f"used with {' '.join(others)}"] * bool(others)),
    ]
    return ", ".join(parts)
