"""Offsets of a lathe's turret, set by a program (G10).

FANUC's P is the number of an offset: over 10000 its geometry, else its wear. Haas has L10 for the
geometry and L11 for the wear. X and Z are new values, U and W are added; R is the radius of the
nose and Q its orientation. An offset acts from the next T word on. Sources: FANUC, "Operator's
Manual for Lathe System", "Changing of tool offset value (G10)"; Haas, "Lathe Operator's Manual",
G10.
"""

from __future__ import annotations

from dataclasses import replace

from cnc.gcode.codes.tool_codes import ToolCodes
from cnc.gcode.dialects import Dialect
from cnc.gcode.state.tool_table import ORIENTATIONS, ToolEntry
from cnc.gcode.syntax.words import LineWords, Word, fault, whole

GEOMETRY = 10_000
"""Added to the number of an offset to mean its geometry (FANUC)."""
_GEOMETRY_KIND, _WEAR_KIND = 10, 11
_MOST = 99
"""Highest number of an offset: a T word has two digits for it."""


def set_turret_offset(
    tools: ToolCodes, words: LineWords, kind: Word | None, at: Word, dialect: Dialect
) -> None:
    """Execute G10 P (FANUC) or G10 L10 and L11 P (Haas).

    Raises:
        GcodeError: ``offset-kind-missing``, ``code-not-supported``, ``tool-number-missing``,
            ``axis-words-missing``, ``value-out-of-range``.
    """
    geometry, number = _offset(words, kind, at, dialect)
    entry = tools.table.tool(number) or ToolEntry(number)
    radius, orientation = words.take("R", "G10"), words.take("Q", "G10")
    values = dict(_values(tools, words, entry.offsets if geometry else entry.wear))
    if not values and radius is None and orientation is None:
        raise fault("axis-words-missing", f"{at.written} needs X, Z, R or Q", at, "such as Z-0.1")
    if geometry:
        entry = replace(entry, offsets=entry.offsets | values)
    else:
        entry = replace(entry, wear=entry.wear | values)
    if radius is not None:
        size = radius.number * tools.state.scale
        entry = (
            replace(entry, diameter=2.0 * size) if geometry else replace(entry, radius_wear=size)
        )
    if orientation is not None:
        tip = whole(orientation, "the orientation", 0, ORIENTATIONS)
        entry = replace(entry, orientation=tip)
    tools.table.put(entry)


def _offset(words: LineWords, kind: Word | None, at: Word, dialect: Dialect) -> tuple[bool, int]:
    """Return whether the geometry is meant, and the number of the offset."""
    by_kind = dialect.turret_offsets == "L"
    if by_kind and kind is None:
        hint = "L10 sets the geometry of an offset, L11 its wear, L2 an origin"
        raise fault("offset-kind-missing", f"{at.written} needs an L word", at, hint)
    if kind is not None and not (by_kind and kind.whole in (_GEOMETRY_KIND, _WEAR_KIND)):
        message = f"{at.written} {kind.written} is not in the {dialect.name} dialect"
        raise fault("code-not-supported", message, kind)
    word = words.take("P", "G10")
    if word is None:
        hint = "give P and the number of the offset"
        raise fault("tool-number-missing", f"{at.written} needs a P word", at, hint)
    if by_kind:
        assert kind is not None
        return kind.whole == _GEOMETRY_KIND, whole(word, "the number of the offset", 1, _MOST)
    geometry = word.number > GEOMETRY
    number = whole(word, "the number of the offset", 1, GEOMETRY + _MOST)
    number -= GEOMETRY if geometry else 0
    if number > _MOST:
        message = f"{word.written}: an offset has a number from 1 to {_MOST}"
        raise fault("value-out-of-range", message, word, "add 10000 for its geometry")
    return geometry, number


def _values(tools: ToolCodes, words: LineWords, old: dict[str, float]) -> list[tuple[str, float]]:
    """Take X and Z: the new offsets, mm. Diameters are halved, increments added."""
    state = tools.state
    found: list[tuple[str, float]] = []
    for letter in "XZ":
        word = words.take(letter, "G10")
        if word is None:
            continue
        value = word.number * state.scale
        if letter == "X" and state.diameter:
            value /= 2.0
        adds = word.letter != letter or not state.absolute
        found.append((letter, value + (old.get(letter, 0.0) if adds else 0.0)))
    return found
