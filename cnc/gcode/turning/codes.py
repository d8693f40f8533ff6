"""Words of lathes in FANUC's language: state at power on, increments, and tools (T0101).

U, V, W and H are increments of X, Y, Z and C in G-code system A. A T word of four digits has the
number of a tool and that of its offset: it turns the turret and puts the offset into effect,
without a move. Offset 00 ends it. Source: FANUC, "Operator's Manual for Lathe System", "Tool
function", "Tool offset", "Absolute and incremental programming"; Haas, "Lathe Operator's Manual".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from cnc.gcode.core.context import Executor
from cnc.gcode.core.modal_groups import Codes, ModalState
from cnc.gcode.core.tool_codes import ToolCodes
from cnc.gcode.core.tool_table import ORIENTATIONS, ToolEntry
from cnc.gcode.dialects import Dialect
from cnc.gcode.reader.words import G, LineWords, Word, fault, whole
from cnc.model.blocks import Tool

VARIABLE = (G.G34, G.G35)
"""Threads of variable lead."""
FOLLOWING = (G.G33, *VARIABLE)
"""Threads of which further lines go on without a stop."""
THREADS = (*FOLLOWING, G.G76, G.G78)
"""Threads, of which F is the lead."""
_OWN_WORDS = (G.G4, G.G70, G.G71, G.G72, G.G73)
"""Codes that take U and W with a meaning of their own."""
_AXIS_OF = {"U": "X", "V": "Y", "W": "Z", "H": "C"}
_OFFSETS = 100
"""A T word is the number of the tool times this, plus that of the offset."""
_LONGEST = 9999
MOST_PASSES = 10_000
"""Limit on the passes or pecks of a cycle."""


def power_on(state: ModalState, dialect: Dialect, diameters: bool | None) -> None:
    """Set the modes in effect at the start on a lathe; ``diameters`` None is the dialect's rule."""
    state.diameter = dialect.turning.diameters if diameters is None else diameters
    if dialect.turning.starts_in_zx:
        state.plane = "ZX"
    if dialect.turning.lathe:
        state.feed_mode = "per-revolution"


def take_increments(words: LineWords, codes: Codes, dialect: Dialect) -> None:
    """File U, V, W and H under the axes that they increment.

    Such a word keeps its letter, by which :meth:`AxisWords.axis_values` recognises an increment.

    Raises:
        GcodeError: ``axis-words-wanted-twice``: an axis has an increment and a coordinate.
    """
    rest = words.rest
    if rest.keys().isdisjoint(dialect.turning.increments):
        return
    if any(code.number in _OWN_WORDS for code in codes.values()):
        return
    for letter in dialect.turning.increments:
        word = rest.get(letter)
        if word is None:
            continue
        axis = _AXIS_OF[letter]
        if axis in rest:
            message = f"{word.written} is an increment of {axis}, which has {rest[axis].written}"
            raise fault("axis-words-wanted-twice", message, word, "remove one of the two words")
        rest[axis] = rest.pop(letter)


_LENGTHS = frozenset((*"XYZUVWIKR", ",C", ",R"))
"""Letters of lengths; P, Q and D of cycles have a rule of their own."""


def take_least_increments(words: LineWords, at: float, scale: float) -> None:
    """Read lengths without a decimal point as counts of the least input increment.

    Source: FANUC, parameter 3401, bit 0 (DPI); "Operator's Manual", "Decimal point programming".

    Args:
        words: Words of the line.
        at: The code of the line that takes its words, in system B; 0 for another one.
        scale: mm of a program unit.
    """
    counts = 1000.0 if scale == 1.0 else 10_000.0
    for letter in _LENGTHS & words.rest.keys():
        word = words.rest[letter]
        count = letter == "R" and at == G.G73.code and words.rest.keys().isdisjoint("PQ")
        if "." not in word.written and "#" not in word.written and not count:
            words.rest[letter] = replace(word, number=word.number / counts)


_CORNERS = {"R": ",R", "C": ",C", "I": ",C", "K": ",C", "A": ",A"}
"""Words of a straight move without the comma, and those that mean the same."""


def take_corners(words: LineWords, columns: Mapping[str, int]) -> None:
    """File R, C, I, K and A of a G1 as ,R ,C and ,A.

    R is a round, I (behind a move along Z) and K (along X) are the legs of a chamfer, whose signs
    say where the next move goes. C and A are words of axes where the machine has them. Source:
    FANUC, "Operator's Manual for Lathe System", "Chamfering and corner R", "Direct drawing
    dimension programming"; Haas, "Lathe Operator's Manual", G01.

    Args:
        words: Words of the line of a G1.
        columns: Axes of the machine.
    """
    if words.rest.keys().isdisjoint("XZUW"):
        return
    for letter in words.rest.keys() & _CORNERS.keys():
        meant = _CORNERS[letter]
        if letter not in columns and meant not in words.rest:
            word = words.rest.pop(letter)
            size = word.number if letter == "A" else abs(word.number)
            words.rest[meant] = replace(word, letter=meant, number=size)


class Turret(Executor):
    """Execution of T words on a lathe."""

    def __init__(self, tools: ToolCodes) -> None:
        super().__init__(tools.context)
        self._tools = tools

    def turn(self, words: LineWords) -> None:
        """Execute the T word of a line.

        Raises:
            GcodeError: ``tool-word-form``, ``compensation-active``, and those of the tool table.
        """
        word = words.take("T", "T")
        if word is None:
            return
        tool, offset = self._numbers(word)
        motion, state, here = self._tools.motion, self._state, self._here
        if motion.compensated:
            message = f"{word.written} under tool nose compensation"
            raise fault("compensation-active", message, word, "give G40 and a move before")
        letters = [name.upper() for name in motion.axes]
        if offset:
            entry = self._tools.entry(offset, word)
            found = [entry.offset(axis) if axis in "XYZ" else 0.0 for axis in letters]
        else:
            found = [0.0] * len(letters)
        self._tools.offset_number = offset
        motion.coordinates.tool_offset = found
        state.tool = tool
        if tool != state.loaded:
            state.loaded = tool
            self._out.add(Tool(here.file, here.line, tool))

    @staticmethod
    def _numbers(word: Word) -> tuple[int, int]:
        """Numbers of the tool and of the offset. T101 is T0101, and T0 is T0000."""
        number = word.whole
        if number is None or not 0 <= number <= _LONGEST or 0 < number < _OFFSETS:
            message = f"{word.written} has no number of an offset"
            if number is None or not 0 <= number <= _LONGEST:
                message = f"{word.written} is not a tool and an offset of two digits each"
            hint = "write the tool and its offset, such as T0101; T0100 cancels the offset"
            raise fault("tool-word-form", message, word, hint)
        return divmod(number, _OFFSETS)


# Offsets of a lathe's turret, set by a program (G10).
#
# FANUC's P is the number of an offset: over 10000 its geometry, else its wear. Haas has L10 for the
# geometry and L11 for the wear. X and Z are new values, U and W are added; R is the radius of the
# nose and Q its orientation. An offset acts from the next T word on. Sources: FANUC, "Operator's
# Manual for Lathe System", "Changing of tool offset value (G10)"; Haas, "Lathe Operator's Manual",
# G10.

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
        size = radius.number * tools.context.state.scale
        entry = (
            replace(entry, diameter=2.0 * size) if geometry else replace(entry, radius_wear=size)
        )
    if orientation is not None:
        tip = whole(orientation, "the orientation", 0, ORIENTATIONS)
        entry = replace(entry, orientation=tip)
    tools.table.put(entry)


def _offset(words: LineWords, kind: Word | None, at: Word, dialect: Dialect) -> tuple[bool, int]:
    """Return whether the geometry is meant, and the number of the offset."""
    by_kind = dialect.turning.turret_offsets == "L"
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
    state = tools.context.state
    values: list[tuple[str, float]] = []
    for letter in "XZ":
        word = words.take(letter, "G10")
        if word is None:
            continue
        value = word.number * state.scale
        if letter == "X" and state.diameter:
            value /= 2.0
        adds = word.letter != letter or not state.absolute
        values.append((letter, value + (old.get(letter, 0.0) if adds else 0.0)))
    return values
