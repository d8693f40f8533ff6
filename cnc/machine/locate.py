"""Line and column of a key in a TOML file, for messages.

The TOML parser of the standard library does not give locations. This search reads tables, dotted
and quoted keys, arrays over several lines and the first level of inline tables. For other keys it
gives the nearest enclosing table.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

_PART = r"""(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')"""
_DOTTED = rf"{_PART}(?:\s*\.\s*{_PART})*"
_TABLE = re.compile(rf"\s*\[{{1,2}}\s*({_DOTTED})\s*\]")
_PAIR = re.compile(rf"\s*({_DOTTED})\s*=")
_INLINE_PAIR = re.compile(rf"[{{,]\s*({_DOTTED})\s*=")
_STRING = re.compile(r'"(?:[^"\\]|\\.)*"|' + r"'[^']*'")


@dataclass(frozen=True, slots=True)
class KeyLocation:
    """Line and column of a key from 1, its length, and the text of the line."""

    line: int
    column: int
    length: int
    text: str


def _parts(dotted: str) -> tuple[str, ...]:
    return tuple(part.strip("\"'") for part in re.findall(_PART, dotted))


def _depth(text: str) -> int:
    """Return the number of unclosed brackets in a value, outside strings and comments."""
    bare = _STRING.sub("", text).split("#", 1)[0]
    return sum((c in "[{") - (c in "]}") for c in bare)


def key_locations(text: str) -> dict[tuple[str, ...], KeyLocation]:
    """Return the location of every key and table of a TOML text, by its full path."""
    found: dict[tuple[str, ...], KeyLocation] = {}
    table: tuple[str, ...] = ()
    open_brackets = 0
    for number, line in enumerate(text.splitlines(), start=1):
        if open_brackets > 0:
            open_brackets += _depth(line)
            continue
        if heading := _TABLE.match(line):
            table = _parts(heading[1])
            for depth in range(1, len(table) + 1):
                found.setdefault(
                    table[:depth], KeyLocation(number, heading.start(1) + 1, len(heading[1]), line)
                )
        elif pair := _PAIR.match(line):
            key = table + _parts(pair[1])
            for depth in range(len(table) + 1, len(key) + 1):
                found.setdefault(
                    key[:depth], KeyLocation(number, pair.start(1) + 1, len(pair[1]), line)
                )
            value = line[pair.end() :]
            if value.lstrip().startswith("{"):
                for inner in _INLINE_PAIR.finditer(line, pair.end()):
                    found.setdefault(
                        key + _parts(inner[1]),
                        KeyLocation(number, inner.start(1) + 1, len(inner[1]), line),
                    )
            open_brackets = _depth(value)
    return found


def locate(text: str, key: tuple[str, ...]) -> KeyLocation | None:
    """Return the location of ``key`` or of its nearest enclosing table; None without either."""
    found = key_locations(text)
    while key:
        if key in found:
            return found[key]
        key = key[:-1]
    return None
