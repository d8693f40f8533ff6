"""Lines of Fagor's controls: the head of a file, tools with their offsets, words that are refused.

Sources: Autodesk, posts "FAGOR 8037/8055" (the head, dwells in hundredths of a second, G53 beside
G0) and "FAGOR 8065" (dwells in seconds); a table of functions of older controls (G53 to G59 are
seven stored offsets). Commands of the high-level language stand in parentheses; no manual of them
was at hand, so whatever looks like one is refused.
"""

from __future__ import annotations

import re

from cnc.gcode.syntax.words import fault

HEAD = "the head of the file has no effect here"
"""Note of a line with ``%`` and a name."""
_HEAD = re.compile(r"\s*%\s*[^\s%].*")
_REMARK = re.compile(r"\(([^()]*)\)|;.*")
_COMMAND = re.compile(
    r"\s*(?:IF|GOTO|CALL|PCALL|MCALL|MDOFF|PROC|RPT|SUB|RET|ERROR|EXEC|REPOS|PROBE|DIGIT|OPEN|WRITE"
    r"|PAGE|SYMBOL|DW|ODW|IB|SK|WKEY|WBUF|SYSTEM|DSTBLK|ESTBLK|DSTOP|ESTOP|DFHOLD|EFHOLD|TRACE)\b"
    r"|\s*[A-Z_]\w*(?:\[[^\]]*\])?\s*=",
    re.IGNORECASE,
)
_TOOL = re.compile(r"T[ \t]*0*([0-9]+)(\.0*([0-9]*))", re.IGNORECASE)
_SYSTEM = re.compile(r"G[ \t]*0*5[3-9](?![0-9.])", re.IGNORECASE)
_MOTION = re.compile(r"G[ \t]*0*[0-3](?![0-9.])", re.IGNORECASE)
_AXIS = re.compile(r"[XYZABC][ \t]*[-+.0-9]", re.IGNORECASE)
_DWELL = re.compile(r"G[ \t]*0*4(?![0-9.]).*?(K[ \t]*[0-9]*\.[0-9]*)", re.IGNORECASE)


def is_head(text: str) -> bool:
    """Return whether a line is the head of a file: ``%`` and a name."""
    return _HEAD.fullmatch(text) is not None


def with_plain_tools(text: str) -> str:
    """Return a line with ``T5`` in place of ``T5.5``, at the same columns.

    Raises:
        GcodeError: ``code-not-supported``, ``decimal-point-place``, ``tool-offset-other``,
            ``offset-without-motion``.
    """
    for remark in _REMARK.finditer(text):
        if remark[1] is not None and (command := _COMMAND.match(remark[1])):
            name = command[0].strip()
            raise fault(
                "code-not-supported",
                f"({name} ..) is a command of Fagor's high-level language, which is not supported",
                column=remark.start() + 1,
                hint="if it is a comment, write it behind a semicolon",
            )
    code = _REMARK.sub(lambda remark: " " * len(remark[0]), text)
    if dwell := _DWELL.search(code):
        raise fault(
            "decimal-point-place",
            f"{dwell[1]} has a decimal point: K of G4 is in hundredths of a second on the 8037 and "
            "8055, and in seconds on others",
            column=dwell.start(1) + 1,
            hint="write whole hundredths, such as K150 for 1.5 s",
        )
    system = None if _MOTION.search(code) else _SYSTEM.search(code)
    if system and (_AXIS.search(code) or system[0].endswith("3")):
        raise fault(
            "offset-without-motion",
            f"{system[0]} without G0 or G1 is a move in machine coordinates or in this system on "
            "the 8037 and 8055, and the choice of an offset or an entry in its table on older ones",
            column=system.start() + 1,
            hint="write G0 or G1 in this line",
        )
    for tool in _TOOL.finditer(code):
        if tool[3] and int(tool[3]) != int(tool[1]):
            raise fault(
                "tool-offset-other",
                f"{tool[0]}: tool {tool[1]} with offset {tool[3]} is not supported, only an offset "
                "with the number of its tool",
                column=tool.start() + 1,
                hint=f"write T{tool[1]}.{tool[1]}, and its data in the tool table",
            )
        start, end = tool.span(2)
        text = text[:start] + " " * (end - start) + text[end:]
    return text
