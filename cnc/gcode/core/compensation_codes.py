"""Codes of cutter compensation, G40 to G42.1, and the codes that it excludes.

G41 and G42 take the radius from the tool table: of tool D, or of the tool in the spindle without D
or with D0. G41.1 and G42.1 have the diameter as D. In the plane G18 the tool may be a turning tool:
its orientation (Q of the table, L of G41.1) gives the position of the control point relative to the
centre of the nose. FANUC's D is the number of an offset, and stays in effect.

Source: LinuxCNC, "G41, G42", "G41.1, G42.1", "Lathe Tool Orientation"; FANUC, "Cutter
compensation".
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from cnc.gcode.core.compensation import Side
from cnc.gcode.core.modal_groups import PLANES, Code, Codes
from cnc.gcode.core.motion import Motion, MotionCodes
from cnc.gcode.core.tip_control import refuse_under_tip_control
from cnc.gcode.core.tool_codes import ToolCodes
from cnc.gcode.core.tool_table import MAX_TOOL, ORIENTATIONS
from cnc.gcode.reader.words import (
    G,
    LineWords,
    M,
    Word,
    fault,
    offset_missing,
    under_compensation,
    whole,
)
from cnc.model.blocks import Plane

_DYNAMIC = (G.G41_1, G.G42_1)
_LEFT = (G.G41, G.G41_1)

TIPS = ((0, 0), (1, -1), (-1, -1), (-1, 1), (1, 1), (1, 0), (0, -1), (-1, 0), (0, 1), (0, 0))
"""Control point of a turning tool relative to the centre of its nose: Z and X in radii, by
orientation.
"""


class CompensationCodes(MotionCodes):
    """Execution of the codes of cutter compensation."""

    def __init__(self, motion: Motion, tools: ToolCodes) -> None:
        super().__init__(motion)
        self._tools = tools
        self._offset = 0
        self._active: tuple[Side, float, Plane, tuple[float, float]] | None = None

    def refuse(self, codes: Codes) -> None:
        """Check the codes of a line that are executed before the move.

        A change of plane or tool is an error, and so is M66: the next moves may depend on its
        answer, so the held move would have to end.

        Raises:
            GcodeError: ``compensation-active``.
        """
        if not self._motion.compensated:
            return
        for group, number in (("tool-change", M.M6), ("input-output", M.M66)):
            if (code := codes.get(group)) and code.number == number:
                raise under_compensation(code.word)
        if (code := codes.get("plane")) and PLANES[code.g] != self._state.plane:
            raise under_compensation(code.word)

    def code(self, words: LineWords, code: Code) -> None:
        """Execute G40, G41, G42, G41.1 or G42.1."""
        if code.number == G.G40:
            self.off()
            return
        at = code.word
        refuse_under_tip_control(self._motion, at)
        radius, orientation = (
            self._given(words, at) if code.number in _DYNAMIC else self._of_tool(words, at)
        )
        if radius == 0.0:
            message = f"{at.written} with a radius of 0 does not change the path"
            self._here.report_warning(
                "compensation-radius-zero",
                message,
                at,
                "enter the tool's diameter in the tool table",
            )
        side: Side = "left" if code.number in _LEFT else "right"
        columns = self._motion.arcs.plane_columns(at, "cutter compensation")
        shift = (0.0, 0.0)
        # On a mantle the plane has a rotary axis, and the tool is a milling cutter.
        if self._state.plane == "ZX" and columns == tuple(map(self._motion.column.get, "ZX")):
            shift = (TIPS[orientation][0] * abs(radius), TIPS[orientation][1] * abs(radius))
        if self._motion.coordinates.transform.mirrors(columns):
            side = "right" if side == "left" else "left"
        given = side, radius, self._state.plane, shift
        again = self._dialect.tools.compensation_again
        idle = again == "same" or (again == "zero" and radius == 0.0)
        if idle and self._motion.compensated and given == self._active:
            return
        self._active = given
        self._start(code.g, at)

    def _start(self, code: G, at: Word) -> None:
        """Start the compensation of the last G41 or G42 at the position."""
        assert self._active is not None
        side, radius, plane, shift = self._active
        columns = self._motion.arcs.plane_columns(at, "cutter compensation")
        compensation = self._motion.compensation
        compensation.start(side, radius, plane, columns, self._motion.position, at, shift=shift)
        self._state.compensation = code
        self._out.defer = compensation.add

    @contextmanager
    def suspended(self, at: Word) -> Iterator[None]:
        """Make a cycle of a lathe without the compensation, as FANUC does, with a warning.

        The tool goes to the programmed start point before the cycle. The next move behind the cycle
        leads in again.
        """
        motion, code = self._motion, self._state.compensation
        if not motion.compensated:
            yield
            return
        message = f"{at.written} roughs without the nose compensation of {code.written}"
        hint = "the allowance of the finish must be larger than the difference; G70 compensates"
        self._here.report_warning("cycle-not-compensated", message, at, hint)
        self.off()
        if motion.compensation.active:
            motion.traverse(motion.position.copy())
        yield
        self._start(code, at)

    def keep_offset(self, words: LineWords) -> None:
        """Keep the D of a line without G41 or G42 for a later one, as FANUC does.

        Raises:
            GcodeError: ``compensation-active``.
        """
        if not self._dialect.tools.memory or "D" not in words.rest:
            return
        word = words.rest.pop("D")
        if self._motion.compensated:
            raise under_compensation(word)
        self._offset = whole(word, "the offset number", 0, MAX_TOOL)

    def off(self) -> None:
        """End the compensation. The held move ends at its natural end."""
        self._motion.compensation.stop()
        self._state.compensation = G.G40
        self._out.defer = None

    def _given(self, words: LineWords, at: Word) -> tuple[float, int]:
        """Radius and orientation of G41.1 and G42.1."""
        diameter, orientation = words.take("D", at.written), words.take("L", at.written)
        if diameter is None:
            raise fault(
                "compensation-diameter-missing",
                f"{at.written} needs a D word",
                at,
                "give D and the tool's diameter",
            )
        if orientation and self._state.plane != "ZX":
            raise fault(
                "compensation-orientation",
                f"{orientation.written}: an orientation is for turning tools, in the plane G18",
                orientation,
            )
        number = whole(orientation, "the orientation", 0, ORIENTATIONS) if orientation else 0
        return diameter.number * self._state.scale / 2.0, number

    def _of_tool(self, words: LineWords, at: Word) -> tuple[float, int]:
        """Radius and orientation of a tool of the table."""
        word = words.take("D", at.written)
        if word and word.whole is None and G.G41_1 in self._dialect.g:
            message = f"{word.written}: D of {at.written} is the number of a tool, without decimals"
            hint = f"for the diameter of the tool write {at.written}.1 {word.written}"
            raise fault("value-out-of-range", message, word, hint)
        number = whole(word, "the tool number", 0, MAX_TOOL) if word else 0
        if word and self._dialect.tools.own_offsets and number != self._state.loaded:
            message = f"{word.written} is not the offset of the tool in the spindle"
            hint = "it would change the length of the tool, too, which is not supported"
            raise fault("tool-offset-other", message, word, hint)
        if self._dialect.turning.lathe:
            number = number or self._tools.offset_number
        elif self._dialect.tools.memory:
            self._offset = number if word else self._offset
            number = self._offset
            if word is None and number == 0:
                raise offset_missing("compensation-offset-missing", "D", words, at)
        else:
            number = number or self._tools.tool_in_spindle("D", at)
        if number == 0:
            return 0.0, 0
        entry = self._tools.entry(number, word or at)
        return entry.radius, entry.orientation
