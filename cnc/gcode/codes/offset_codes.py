"""Codes of coordinate systems, shifts and reference positions: G10 L2 and L20, G28 to G92.3.

G53 is only checked here; its effect on the axis words is in the move. Source: LinuxCNC, "G-codes";
FANUC, "Programmable data input", "Reference position return" and "Local coordinate system".
"""

from __future__ import annotations

from cnc.gcode.codes.figure_codes import check_rotary_axes_at_zero
from cnc.gcode.codes.motion import Motion, MotionCodes
from cnc.gcode.codes.tip_control import refuse_under_tip_control
from cnc.gcode.codes.tool_codes import ToolCodes
from cnc.gcode.codes.turret_offsets import set_turret_offset
from cnc.gcode.state.coordinates import EXTERNAL, SYSTEM_CODES
from cnc.gcode.state.modal_groups import PLAIN_MOTIONS, Code
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import AXES, LineWords, Word, fault, under_compensation, whole

_HOME = {G.G28: G.G28, G.G28_1: G.G28, G.G30: G.G30, G.G30_1: G.G30}
"""The code that goes to the position of each code."""
_ORIGINS = (2, 20)
_BASIC_SYSTEMS = 6
_NO_CYCLE = (None, G.G80, *PLAIN_MOTIONS)
"""Modes of motion in which no cycle uses a P word."""
_WITHOUT_P = frozenset(
    (0, 1, 2, 3, 17, 18, 19, 20, 21, 40, 41, 42, 43, 49, 54, 69, 80, 90, 91, 94, 98, 99)
)
"""Codes that may stand beside G54 P: they have no P word."""


class OffsetCodes(MotionCodes):
    """Execution of the codes of offsets. Most are an error under cutter compensation."""

    def __init__(self, motion: Motion, tools: ToolCodes) -> None:
        super().__init__(motion)
        self._tools = tools

    def system(self, words: LineWords, code: Code) -> None:
        """Execute G54 to G59.3, or FANUC's G54.1 P, which is G54 P, too."""
        self._check_compensation(code.word)
        self._check_figure(code.word)
        further = code.number == G.G54 and self._dialect.system_word and "P" in words.rest
        if further:
            self._check_system_word(words, code.word)
        if further or code.number == G.G54_1:
            word = words.take("P", code.word.written)
            if word is None:
                hint = f"give P from 1 to {self._dialect.more_systems}"
                raise fault(
                    "offset-system-missing", f"{code.word.written} needs a P word", code.word, hint
                )
            basic = self._dialect.flavour == "siemens" and word.number == 0
            index = EXTERNAL if basic else self._more(word)
        else:
            index = SYSTEM_CODES.index(code.g)
        self._coordinates.select(index)

    def _check_system_word(self, words: LineWords, at: Word) -> None:
        """Refuse P beside G54 if a cycle, a dwell or another code of the line may use it."""
        if self._state.motion in _NO_CYCLE and all(word.number in _WITHOUT_P for word in words.g):
            return
        message = f"P of this line may belong to {at.written} or to another code"
        raise fault("word-wanted-twice", message, words.rest["P"], f"write {at.written} P alone")

    def _more(self, word: Word) -> int:
        """Index of the coordinate system that P of G54.1 names."""
        return (
            self._coordinates.systems
            + whole(word, "the coordinate system", 1, self._dialect.more_systems)
            - 1
        )

    def non_modal(self, words: LineWords, code: Code) -> None:
        """Execute G10, G28, G28.1, G30, G30.1, G52, G53 or G92 to G92.3."""
        number, coordinates = code.g, self._coordinates
        if number == G.G53_1:
            self._turn_tool(code.word)
            return
        if number not in (G.G28, G.G30, G.G53):
            self._check_figure(code.word)
        if number == G.G10:
            self._g10(words, code.word)
            return
        self._check_compensation(code.word)
        if number in (G.G28, G.G28_1, G.G30, G.G30_1, G.G53):
            refuse_under_tip_control(self._motion, code.word)
        if number in (G.G28, G.G30):
            self._go_home(words, code)
        elif number in (G.G28_1, G.G30_1):
            coordinates.set_home(_HOME[number], self._motion.position)
        elif number == G.G52:
            coordinates.set_local(self._values(words, "G52", code.word))
        elif number == G.G53:
            self._check_machine_move(code.word)
        elif number == G.G92 and self._dialect.lathe and "S" in words.users:
            if words.has_axis():
                message = f"{code.word.written} with S limits the speed, and sets no coordinates"
                raise fault("axis-words-unused", message, words.first_axis(), "write two lines")
        elif number == G.G92:
            coordinates.set_shift_here(self._values(words, "G92", code.word), self._motion.position)
        elif number == G.G92_1:
            coordinates.clear_shift()
        elif number == G.G92_2:
            coordinates.suspend_shift()
        else:
            coordinates.restore_shift()

    def _values(self, words: LineWords, user: str, at: Word) -> dict[int, float]:
        """Take the axis words, at least one. Those of axes that the machine lacks do nothing."""
        given = words.has_axis()
        values = self._motion.axis_values(words, user)
        if not given:
            raise fault("axis-words-missing", f"{at.written} needs axis words", at, "such as X0 Y0")
        return values

    def _turn_tool(self, at: Word) -> None:
        """G53.1: the tool is along Z of the plane of G68.2 already, which has no tilt here."""
        if not self._coordinates.figure.shift:
            message = f"{at.written} without G68.2 before it"
            raise fault("figure-missing", message, at, "give G68.2 before")
        check_rotary_axes_at_zero(self._motion, at)

    def _check_figure(self, at: Word) -> None:
        """Refuse an offset under G51, G51.1 or G68, in whose coordinates it would be unclear."""
        if self._coordinates.figure.changes:
            message = f"{at.written} under a figure that G51, G51.1, G68 or G101 changed"
            raise fault("figure-active", message, at, "give G50, G50.1, G69 or G100 before")

    def _check_compensation(self, at: Word) -> None:
        if self._motion.compensated:
            raise under_compensation(at)

    def _check_machine_move(self, at: Word) -> None:
        """Refuse G53 under G91 if the dialect does.

        Some controllers read its axis words as absolute. FANUC's ignore G53 there.
        """
        if self._state.absolute:
            return
        if not self._dialect.machine_in_incremental:
            raise fault(
                "machine-coordinates-incremental", f"{at.written} under G91", at, "give G90"
            )
        if self._dialect.name == "auto":
            message = f"{at.written} under G91: its axis words are read as machine coordinates"
            hint = "FANUC controls ignore G53 there: give G90"
            self._here.report_warning("machine-coordinates-absolute", message, at, hint)

    # Reference positions

    def _go_home(self, words: LineWords, code: Code) -> None:
        """Move through the point of the axis words to the stored position.

        Only the given axes go on from the point, or all if none is given. Words of axes that the
        machine lacks are no reason to move the others.
        """
        motion, stored = self._motion, self._home(words, code)
        given = [letter for letter in words.rest if letter in AXES]
        columns = [motion.column[letter] for letter in given if letter in motion.column]
        if words.has_axis():
            through = motion.target(words, code.word.written, motion.position)
            if not self._dialect.home_directly:
                motion.traverse(through)
        elif self._dialect.home_needs_axes and not self._dialect.lenient:
            raise fault(
                "axis-words-missing",
                f"{code.word.written} needs axis words",
                code.word,
                "give the axes that must move, such as Z0",
            )
        if given and not columns:
            return
        if not columns:
            motion.length_change = None
        motion.traverse(self._partly_home(columns, stored))

    def _partly_home(self, columns: list[int], stored: list[float]) -> list[float]:
        """The stored position for the axes of ``columns``, or for all if there are none.

        The axes are those of the coordinate system.
        """
        if not columns:
            return stored
        coordinates, here = self._coordinates, self._motion.position
        if not coordinates.rotation:
            return [
                stored[index] if index in columns else value for index, value in enumerate(here)
            ]
        end, there = coordinates.to_program(here), coordinates.to_program(stored)
        for index in columns:
            end[index] = there[index]
        return coordinates.to_machine(end)

    def _home(self, words: LineWords, code: Code) -> list[float]:
        """The stored position; FANUC's P2 to P4 of G30 select one."""
        home = _HOME[code.g]
        if (
            self._dialect.offset_memory
            and home == G.G30
            and (place := words.take("P", "G30"))
            and whole(place, "the reference position", 2, 4) > 2
        ):
            message = f"{place.written}: reference positions 3 and 4 are not stored on this machine"
            raise fault(
                "reference-position-missing",
                message,
                place,
                "the second one (P2) is parameters 5181 to 5189",
            )
        return self._coordinates.home(home)

    # G10

    def _g10(self, words: LineWords, at: Word) -> None:
        dialect = self._dialect
        kind = words.take("L", "G10")
        if dialect.turret_offsets and (kind is None or kind.whole not in _ORIGINS):
            self._check_compensation(at)
            set_turret_offset(self._tools, words, kind, at, dialect)
            return
        if kind is None:
            raise fault(
                "offset-kind-missing",
                f"{at.written} needs an L word",
                at,
                "L2 sets an origin, L20 sets it by the present position",
            )
        if kind.whole not in dialect.offsets:
            raise fault(
                "code-not-supported",
                f"{at.written} {kind.written} is not in the {dialect.name} dialect",
                kind,
                _kinds(dialect.offsets),
            )
        if kind.whole not in _ORIGINS:
            self._check_compensation(at)
            self._tools.g10(words, kind.whole, at)
            return
        system = words.take("P", "G10")
        if system is None:
            raise fault(
                "offset-system-missing",
                f"{at.written} needs a P word",
                at,
                "P1 is G54, P2 is G55, and so on",
            )
        here = kind.whole == 20
        if here and dialect.more_systems:
            index, here = self._more(system), False
        elif number := whole(system, "the coordinate system", 0, self._most_systems):
            index = number - 1
        else:
            index = self._coordinates.system if dialect.offsets_current else EXTERNAL
        if index in (self._coordinates.system, EXTERNAL):
            self._check_compensation(at)
        rotation = None if here else self._rotation(words)
        values = self._motion.axis_values(words, "G10")
        if not values and rotation is None and (here or not dialect.rotation):
            raise fault("axis-words-missing", f"{at.written} needs axis words", at, "such as X0 Y0")
        if here:
            self._coordinates.set_origin_here(index, values, self._motion.position)
        else:
            if values and not self._state.absolute and dialect.offsets_add == "unclear":
                message = f"{at.written} L2 under G91: FANUC adds to the offset, others set it"
                hint = "give G10 L2 under G90, or name the --dialect"
                raise fault("offset-incremental", message, at, hint)
            add = dialect.offsets_add == "yes" and not self._state.absolute
            self._coordinates.set_origin(index, values, rotation=rotation, add=add)

    @property
    def _most_systems(self) -> int:
        """Highest P of G10 L2. A control with G54.1 has G54 to G59 besides, and no G59.1."""
        return _BASIC_SYSTEMS if self._dialect.more_systems else self._coordinates.systems

    def _rotation(self, words: LineWords) -> float | None:
        """R of G10 L2, degrees."""
        word = words.take("R", "G10")
        if word is None:
            return None
        if not self._dialect.rotation:
            message = (
                "R of G10 (rotation of the coordinate system) is not in the "
                f"{self._dialect.name} dialect"
            )
            raise fault("word-not-in-dialect", message, word)
        if not self._coordinates.can_rotate:
            raise fault(
                "axis-missing",
                f"{word.written} rotates X and Y, and the machine does not have both",
                word,
            )
        return word.number


def _kinds(known: tuple[int, ...]) -> str:
    """A list of the L words that G10 has."""
    *most, last = (f"L{kind}" for kind in known)
    return f"the dialect has {', '.join(most)} and {last}"
