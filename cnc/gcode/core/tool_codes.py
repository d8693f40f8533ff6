"""Codes of the tool table and of tool offsets: G10 L0 to L13, G43, G43.1, G43.2, G44, G49.

With a tool table, an offset belongs to a tool and holds for all axes. FANUC's offset memory has
lengths (H) and radii (D), each a geometry and a wear; here number n of both is stored with tool n.
Source: LinuxCNC, "G-codes"; FANUC, "Tool length offset" and "Programmable data input".
"""

from __future__ import annotations

import math
from dataclasses import replace

from cnc.gcode.core.modal_groups import Code, Codes
from cnc.gcode.core.motion import Motion, MotionCodes
from cnc.gcode.core.tip_control import TipControlCodes
from cnc.gcode.core.tool_table import MAX_TOOL, ORIENTATIONS, ToolEntry, ToolTable
from cnc.gcode.reader.words import (
    G,
    LineWords,
    Word,
    fault,
    offset_missing,
    under_compensation,
    whole,
)

_HOMES = (28.0, 30.0, 53.0)


class ToolCodes(MotionCodes):
    """Execution of the codes of tools.

    Attributes:
        here: The current line.
        state: The modal state.
        motion: The moves.
        table: The tool table.
        offset_number: Number of the offset in effect; 0 for none, -1 for values without a number.
    """

    def __init__(
        self,
        motion: Motion,
        table: ToolTable,
        tip: TipControlCodes,
    ) -> None:
        super().__init__(motion)
        self._tip = tip
        self._zero_without_table = motion.context.policy.tool_lengths == "zero"
        self._zero_reported = False
        self._spindle_reported = False
        self.offset_number = 0
        self._last_h = 0
        self._length_code: G | None = None
        self.motion = motion
        self.table = table
        table.bind(self._coordinates.parameters, lambda: self._state.loaded)
        parameters = self._coordinates.parameters
        parameters.bind("_tool_offset", lambda: float(any(self._coordinates.tool_offset)))
        parameters.bind("_current_pocket", lambda: self._pocket(self._state.loaded))
        parameters.bind("_selected_pocket", lambda: self._pocket(self._state.tool))

    def _pocket(self, tool: int | None) -> float:
        """Pocket of a tool; 0 without one."""
        entry = None if tool is None else self.table.tool(tool)
        return 0.0 if entry is None else float(entry.pocket)

    # Offsets in effect

    def tool_length(self, words: LineWords, code: Code) -> None:
        """Execute G43, G43.1, G43.2, G43.4, G43.5, G44 or G49."""
        at, number = code.word, code.g
        if self._dialect.tools.own_offsets:
            self.motion.length_change = None
        self._length_code = None if number == G.G49 else number
        if number == G.G49:
            self.offset_number = 0
        if number == G.G49 and (self._dialect.tools.memory or self._dialect.lenient):
            self._take_zero(words)
        if number == G.G49 and not (any(self._coordinates.tool_offset) or self._tip.active):
            return
        if self.motion.compensated:
            raise under_compensation(at)
        nothing = [0.0] * len(self.motion.axes)
        if number == G.G49:
            offset = nothing
        elif number == G.G43_1:
            offset = self._with(self._coordinates.tool_offset, self._axis_words(words, "G43.1", at))
        elif number == G.G43_2:
            if "H" in words.rest and words.has_axis():
                message = f"{at.written} takes H or axis words, not both"
                raise fault(
                    "axis-words-wanted-twice",
                    message,
                    words.first_axis(),
                    "write a move on a line of its own",
                )
            added = (
                self._of_h(words, at)
                if "H" in words.rest
                else self._with(nothing, self._axis_words(words, "G43.2", at))
            )
            offset = [a + b for a, b in zip(self._coordinates.tool_offset, added, strict=True)]
        else:
            offset = self._of_h(words, at)
            if number == G.G44:
                offset = [-value for value in offset]
        if number in (G.G43_1, G.G43_2, G.G44):
            self.offset_number = -1
        # Where G43.4 is a length code, the others end its control. LinuxCNC keeps its kinematics.
        self._note_change(offset)
        stays = G.G43_4 not in self._dialect.g and self._tip.active
        on = stays or number in (G.G43_4, G.G43_5)
        self._tip.set_offset(offset, at, on=on, vectors=number == G.G43_5)

    def with_length(self, words: LineWords, codes: Codes) -> Codes:
        """Return the codes of a line, with that of the offset in effect if H stands alone.

        On FANUC's controls such an H changes the offset.
        """
        word, code = words.rest.get("H"), self._length_code
        if (
            word is None
            or code not in (G.G43, G.G44)
            or not self._dialect.tools.memory
            or self._dialect.turning.lathe
            or not codes.keys().isdisjoint(("tool-length", "non-modal"))
        ):
            return codes
        return codes | {"tool-length": Code(code, word)}

    @staticmethod
    def _take_zero(words: LineWords) -> None:
        """Take H0 beside G49: on FANUC's controls it ends the length, too."""
        number = words.rest.get("H")
        if number is not None and number.number == 0.0:
            words.take("H", "G49")

    def _note_change(self, offset: list[float]) -> None:
        """Note the change of the offset along Z, for a move along Z under G91."""
        motion = self.motion
        column = motion.column.get("Z")
        if self._dialect.tools.length_in_increments == "left" or column is None or self._tip.active:
            return
        before = motion.length_change[0] if motion.length_change else 0.0
        change = before + offset[column] - self._coordinates.tool_offset[column]
        motion.length_change = (change, self._here.line) if change else None

    def keep_length(self, words: LineWords) -> None:
        """Keep the H of a line without G43 or G44 for a later one, as FANUC does.

        Beside G28, G30 and G53, whose moves end without an offset, H0 ends the offset in effect.
        """
        if "H" not in words.rest or not self._dialect.tools.memory or self._dialect.turning.lathe:
            return
        word = words.rest["H"]
        ends = word.number == 0.0 and any(code.number in _HOMES for code in words.g)
        if self._length_code and (not ends or self._tip.active):
            return
        if self._length_code:
            nothing = [0.0] * len(self.motion.axes)
            self._note_change(nothing)
            self._tip.set_offset(nothing, word, on=False, vectors=False)
            self.offset_number = 0
        self._last_h = whole(words.rest.pop("H"), "the offset number", 0, MAX_TOOL)

    def _axis_words(self, words: LineWords, user: str, at: Word) -> dict[int, float]:
        for letter in "XYZABCUVW":
            if letter in words.rest and letter not in self._dialect.tools.length_axes:
                raise fault(
                    "axis-not-in-dialect",
                    f"{user} takes {self._dialect.tools.length_axes} only",
                    words.rest[letter],
                )
        values = self.motion.axis_values(words, user)
        if not values:
            raise fault(
                "axis-words-missing",
                f"{at.written} needs axis words" + (" or H" if user == "G43.2" else ""),
                at,
                "such as Z1.5",
            )
        return values

    @staticmethod
    def _with(offset: list[float], values: dict[int, float]) -> list[float]:
        return [values.get(index, old) for index, old in enumerate(offset)]

    def tool_in_spindle(self, letter: str, at: Word) -> int:
        """Return the tool for a code without H or D, with a warning where controllers differ."""
        loaded = self._state.loaded
        if self._dialect.tools.own_offsets and not loaded:
            message = f"{at.written} takes the offset of the tool in the spindle, and there is none"
            raise fault("tool-not-chosen", message, at, "give T, such as T1.1, and M6 before")
        if loaded and self._dialect.tools.unclear and not self._spindle_reported:
            self._spindle_reported = True
            message = (
                f"{at.written} without {letter} takes tool {loaded}, which is in the spindle; "
                f"FANUC and Haas need {letter} or take the one before"
            )
            hint = f"give {letter}{loaded}, or name the --dialect"
            self._here.report_warning("tool-offset-assumed", message, at, hint)
        return loaded

    def _of_h(self, words: LineWords, at: Word) -> list[float]:
        """Offset of H, or of the tool in the spindle."""
        word = words.take("H", at.written)
        if word is None and self._dialect.tools.memory and not self._last_h:
            raise offset_missing("tool-offset-missing", "H", words, at)
        number = whole(word, "the tool number", 0, MAX_TOOL) if word else 0
        if not self._dialect.tools.memory:
            number = number or self.tool_in_spindle("H", at)
        elif word is None:
            number = self._last_h
        else:
            self._last_h = number
        self.offset_number = number
        if number == 0:
            return [0.0] * len(self.motion.axes)
        entry = self.entry(number, word or at)
        # On a lathe a tool has a length in X and one in Z.
        letters = self._dialect.tools.length_axes + ("XZ" if self.context.policy.lathe else "")
        self._check_length(entry, word or at)
        return [
            entry.offset(axis) if axis in letters else 0.0
            for axis in (name.upper() for name in self.motion.axes)
        ]

    def entry(self, number: int, at: Word) -> ToolEntry:
        """Return a tool of the table.

        Raises:
            GcodeError: ``tool-unknown``, ``tool-table-missing``, at the word ``at``.
        """
        entry = self.table.tool(number)
        if entry is not None:
            return entry
        if self.table.file or (len(self.table) and not self._zero_without_table):
            hint = f"add T{number} to {self.table.file or 'the tool table'}"
            raise fault(
                "tool-unknown", f"{at.written}: tool {number} is not in the tool table", at, hint
            )
        if self._zero_without_table:
            self._report_zero(at)
            return ToolEntry(number)
        message = f"{at.written} needs the data of tool {number}, but there is no tool table"
        raise fault(
            "tool-table-missing",
            message,
            at,
            "name one in the machine file: tool_table under [program]; cncrun tools writes a "
            "skeleton; --tool-lengths zero takes every length as 0",
        )

    def _check_length(self, entry: ToolEntry, at: Word) -> None:
        """Report a tool of a table from a file that has no length."""
        if self.table.file and not entry.offsets and "Z" in self.motion.column:
            message = f"{at.written}: tool {entry.number} has no length in {self.table.file}"
            hint = f"measure it, and add Z to the line of T{entry.number}"
            self._here.report_warning("tool-length-zero", message, at, hint)

    def _report_zero(self, at: Word) -> None:
        """Report once that lengths and radii are taken as 0."""
        if not self._zero_reported:
            self._zero_reported = True
            message = (
                f"{at.written}: there is no tool table, so lengths and radii of tools are 0; "
                "positions are those of the gauge line"
            )
            hint = "cncrun tools PROGRAM writes a skeleton of the table"
            self._here.report_warning("tool-length-zero", message, at, hint)

    def check_change(self, number: int, at: Word) -> None:
        """Check that a table from a file has the tool of a tool change; T0 empties the spindle.

        Raises:
            GcodeError: ``tool-unknown``, at the word ``at``.
        """
        if number and self.table.file:
            self.entry(number, at)
        if self._dialect.tools.own_offsets and self._length_code:
            column = self.motion.column.get("Z")
            length = self.entry(number, at).offset("Z") if number else 0.0
            if column is not None and length != self._coordinates.tool_offset[column]:
                self.motion.length_change = (math.nan, self._here.line)

    def _report_diameter(self, at: Word) -> None:
        """Report an offset that a setting of the control makes a diameter or a radius."""
        message = f"{at.written} is read as a diameter, as Haas' controls have it by default"
        hint = "a control with setting 40 on RADIUS reads a radius"
        self._here.report_warning("offset-diameter", message, at, hint)

    # G10

    def g10(self, words: LineWords, kind: int, at: Word) -> None:
        """Execute G10 L0, L1 and L10 to L13.

        L0 reads the table's file again. L1, L10 and L11 change a tool; in FANUC's dialect L10 to
        L13 change the offset memory.
        """
        if kind == 0:
            if self._state.loaded:
                raise fault(
                    "tool-loaded",
                    f"{at.written} L0 with a tool in the spindle",
                    at,
                    "give T0 M6 before",
                )
            self.table.reload()
            return
        word = words.take("P", "G10")
        if word is None:
            raise fault(
                "tool-number-missing",
                f"{at.written} L{kind} needs a P word",
                at,
                "give P and the tool's number",
            )
        number = whole(word, "the tool number", 1, MAX_TOOL)
        if self._dialect.tools.memory:
            self._write_memory(words, kind, number, at)
        else:
            self._write_tool(words, kind, self.entry(number, word), at)

    def _write_tool(self, words: LineWords, kind: int, entry: ToolEntry, at: Word) -> None:
        """L1 sets the offsets; L10 and L11 set those that give the position the axis values.

        R, I, J and Q are the radius, the angles and the orientation of the tool.
        """
        values = self.motion.axis_values(words, "G10")
        letters = [name.upper() for name in self.motion.axes]
        if values and kind != 1:
            old = [entry.offset(letter) for letter in letters]
            values = self._coordinates.tool_for(
                old, values, self.motion.position, fixture=kind == 11
            )
        offsets = entry.offsets | {letters[index]: value for index, value in values.items()}
        radius, front, back, orientation = (words.take(letter, "G10") for letter in "RIJQ")
        if not (values or radius or front or back or orientation):
            raise fault(
                "axis-words-missing", f"{at.written} L{kind} needs axis words, R, I, J or Q", at
            )
        changed = replace(
            entry,
            offsets=offsets,
            diameter=2.0 * radius.number * self._state.scale if radius else entry.diameter,
            front_angle=front.number if front else entry.front_angle,
            back_angle=back.number if back else entry.back_angle,
            orientation=whole(orientation, "the orientation", 0, ORIENTATIONS)
            if orientation
            else entry.orientation,
        )
        self.table.put(changed)

    def _write_memory(self, words: LineWords, kind: int, number: int, at: Word) -> None:
        """L10 and L11 set geometry and wear of a length, L12 and L13 of a radius; G91 adds.

        L1 is Haas' other number of L11. Its L12 and L13 are diameters.
        """
        word = words.take("R", "G10")
        if word is None:
            raise fault(
                "tool-offset-missing",
                f"{at.written} L{kind} needs an R word",
                at,
                "give R and the offset",
            )
        value = word.number * self._state.scale
        if kind in (12, 13) and self._dialect.tools.diameters:
            value /= 2.0
            self._report_diameter(word)
        entry = self.table.tool(number) or ToolEntry(number)
        old = {
            10: entry.offsets.get("Z", 0.0),
            1: entry.wear.get("Z", 0.0),
            11: entry.wear.get("Z", 0.0),
            12: entry.diameter / 2.0,
            13: entry.radius_wear,
        }[kind]
        value += 0.0 if self._state.absolute else old
        if kind == 10:
            entry = replace(entry, offsets=entry.offsets | {"Z": value})
        elif kind in (1, 11):
            entry = replace(entry, wear=entry.wear | {"Z": value})
        elif kind == 12:
            entry = replace(entry, diameter=2.0 * value)
        else:
            entry = replace(entry, radius_wear=value)
        self.table.put(entry)
