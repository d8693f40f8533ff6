"""Messages of SINUMERIK: MSG with texts and values.

Source: Siemens, "SINUMERIK 840D sl/828D Programming Manual, Fundamentals", MSG, and "Job Planning",
concatenation of strings.
"""

from __future__ import annotations

import re
from collections.abc import Callable

_MESSAGE = re.compile(r"MSG\s*\((.*)\)", re.I)
_EXECUTION = re.compile(r",\s*[01]\s*$")
"""Whether the message has a block of its own, which changes no path."""
_PIECE = re.compile(r'\s*("[^"]*"|[^"<]+?)\s*(?:<<|$)')
_NAME = re.compile(r"R[0-9]+|[A-Z_]{2}[A-Z0-9_]*", re.I)
_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)")


def message_of(line: str, stored: Callable[[str], str | None]) -> str | None:
    """Return texts in quotes and ``#<name>`` for values; None if the line is no message.

    A value that only a control knows, such as ``$AA_IW[X]``, and one that is computed in the
    message have the name ``?``; they are shown as unknown.

    Args:
        line: The line without its number.
        stored: Returns the name of the parameter that holds a variable; None for another name.
    """
    found = _MESSAGE.fullmatch(line)
    if found is None:
        return None
    inside = _EXECUTION.sub("", found[1]).strip()
    if inside.endswith("<<"):
        return None
    parts, at = [], 0
    while at < len(inside):
        piece = _PIECE.match(inside, at)
        if piece is None:
            return None
        parts.append(_part(piece[1], stored))
        at = piece.end()
    return "".join(parts)


def _part(piece: str, stored: Callable[[str], str | None]) -> str:
    if piece.startswith('"'):
        return piece
    if _NUMBER.fullmatch(piece):
        return f'"{float(piece):.10g}"'
    name = stored(piece) if _NAME.fullmatch(piece) else None
    return f"#<{name or '?'}>"
