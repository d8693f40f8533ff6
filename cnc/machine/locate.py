"""Where a key stands in a TOML file: the parser of the standard library doesn't tell, and a message
should point at the line.

Only a guide for messages: it reads tables, dotted and quoted keys, arrays over several lines and
the first level of inline tables, and gives the nearest enclosing place for anything it can't find.
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
class Place:
    """Line and column from 1, the length of the key, and the line's text."""

    line: int
    column: int
    length: int
    text: str


def _parts(dotted: str) -> tuple[str, ...]:
    return tuple(part.strip("\"'") for part in re.findall(_PART, dotted))


def _depth(text: str) -> int:
    """Brackets opened and not closed in a value, strings and comments aside."""
    bare = _STRING.sub("", text).split("#", 1)[0]
    return sum((c in "[{") - (c in "]}") for c in bare)


def places(text: str) -> dict[tuple[str, ...], Place]:
    """Every key of a TOML text by its full path, tables included."""
    found: dict[tuple[str, ...], Place] = {}
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
                    table[:depth], Place(number, heading.start(1) + 1, len(heading[1]), line)
                )
        elif pair := _PAIR.match(line):
            key = table + _parts(pair[1])
            for depth in range(len(table) + 1, len(key) + 1):
                found.setdefault(key[:depth], Place(number, pair.start(1) + 1, len(pair[1]), line))
            value = line[pair.end() :]
            if value.lstrip().startswith("{"):
                for inner in _INLINE_PAIR.finditer(line, pair.end()):
                    found.setdefault(
                        key + _parts(inner[1]),
                        Place(number, inner.start(1) + 1, len(inner[1]), line),
                    )
            open_brackets = _depth(value)
    return found


def locate(text: str, key: tuple[str, ...]) -> Place | None:
    """Place of ``key``, or of the nearest table around it that the file names."""
    found = places(text)
    while key:
        if key in found:
            return found[key]
        key = key[:-1]
    return None
