"""Words of lathes in FANUC's language: state at power on, increments, and tools (T0101).

U, V, W and H are increments of X, Y, Z and C in G-code system A. A T word of four digits has the
number of a tool and that of its offset: it turns the turret and puts the offset into effect,
without a move. Offset 00 ends it. Source: FANUC, "Operator's Manual for Lathe System", "Tool
function", "Tool offset", "Absolute and incremental programming"; Haas, "Lathe Operator's Manual".
"""

from __future__ import annotations

from cnc.gcode.codes.tool_codes import ToolCodes
from cnc.gcode.dialects import Dialect
from cnc.gcode.state.block_buffer import BlockBuffer
from cnc.gcode.state.modal_groups import Codes, ModalState
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import LineWords, Word, fault
from cnc.model.blocks import Tool

THREADS = (G.G33, G.G76, G.G78)
"""Threads, of which F is the lead."""
_OWN_WORDS = (G.G4, G.G70, G.G71, G.G72, G.G73)
"""Codes that take U and W with a meaning of their own."""
_AXIS_OF = {"U": "X", "V": "Y", "W": "Z", "H": "C"}
_OFFSETS = 100
"""A T word is the number of the tool times this, plus that of the offset."""
_LONGEST = 9999


def power_on(state: ModalState, dialect: Dialect, diameters: bool | None) -> None:
    """Set the modes in effect at the start on a lathe; ``diameters`` None is the dialect's rule."""
    state.diameter = dialect.diameters if diameters is None else diameters
    if dialect.lathe or dialect.flavour == "siemens":
        state.plane = "ZX"
    if dialect.lathe:
        state.feed_mode = "per-revolution"


def take_increments(words: LineWords, codes: Codes, dialect: Dialect) -> None:
    """File U, V, W and H under the axes that they increment.

    Such a word keeps its letter, by which :meth:`AxisWords.axis_values` recognises an increment.

    Raises:
        GcodeError: ``axis-words-wanted-twice``: an axis has an increment and a coordinate.
    """
    rest = words.rest
    if rest.keys().isdisjoint(dialect.increments):
        return
    if any(code.number in _OWN_WORDS for code in codes.values()):
        return
    for letter in dialect.increments:
        word = rest.get(letter)
        if word is None:
            continue
        axis = _AXIS_OF[letter]
        if axis in rest:
            message = f"{word.written} is an increment of {axis}, which has {rest[axis].written}"
            raise fault("axis-words-wanted-twice", message, word, "remove one of the two words")
        rest[axis] = rest.pop(letter)


class Turret:
    """Execution of T words on a lathe."""

    def __init__(self, tools: ToolCodes, out: BlockBuffer) -> None:
        self._tools = tools
        self._out = out

    def turn(self, words: LineWords) -> None:
        """Execute the T word of a line.

        Raises:
            GcodeError: ``tool-word-form``, ``compensation-active``, and those of the tool table.
        """
        word = words.take("T", "T")
        if word is None:
            return
        tool, offset = self._numbers(word)
        motion, state, here = self._tools.motion, self._tools.state, self._tools.here
        if motion.compensated:
            message = f"{word.written} under tool nose compensation"
            raise fault("compensation-active", message, word, "give G40 and a move before")
        letters = [name.upper() for name in motion.axes]
        if offset:
            entry = self._tools.entry(offset, word)
            found = [entry.offset(axis) if axis in "XYZ" else 0.0 for axis in letters]
        else:
            found = [0.0] * len(letters)
        self._tools.turret_offset = offset
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
