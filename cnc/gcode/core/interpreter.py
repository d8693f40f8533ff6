"""The interpreter: statements and modal state to canonical blocks.

A line is executed in the order of RS274/NGC, in whatever order its words stand: messages, feed
mode, F, S, T, inputs and outputs, tool change, spindle, saved state, coolant, overrides, dwell,
plane, units, compensation, length, coordinate system, path control, distance and retract modes, G10
to G92, motion, stop. A word that no code uses is an error, so no word is ignored. Source: LinuxCNC,
"G-code overview", order of execution.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cnc.gcode.core import circular_pocket, drilling, feed_codes, nurbs, probing, splines
from cnc.gcode.core.block_buffer import BlockBuffer, SourceLocation, UnusedWords, Warn
from cnc.gcode.core.builder_codes import BuilderCodes, ExtraCode, PreparedLine, prepare
from cnc.gcode.core.comments import Assignments, CommentCommands
from cnc.gcode.core.compensation_codes import CompensationCodes
from cnc.gcode.core.context import Context
from cnc.gcode.core.coordinates import Coordinates, bind_position
from cnc.gcode.core.cycle_runner import CycleRunner
from cnc.gcode.core.feed_codes import FeedCodes, take_idle, unused
from cnc.gcode.core.machine_codes import Dwells, InputOutputCodes, MachineCodes
from cnc.gcode.core.modal_groups import (
    PLANES,
    STRICT,
    Code,
    Codes,
    ModalState,
    ReadingPolicy,
    codes_of,
    feed_of,
)
from cnc.gcode.core.motion import Motion, MotionCodes
from cnc.gcode.core.offset_codes import OffsetCodes, OffsetVariables, TransformCodes
from cnc.gcode.core.tip_control import TipControlCodes
from cnc.gcode.core.tool_codes import ToolCodes
from cnc.gcode.core.tool_table import ToolTable
from cnc.gcode.dialects import Dialect
from cnc.gcode.macro_b import variables
from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.statements import DIAMETERS, DIRECTION, Statement
from cnc.gcode.reader.words import G, LineWords, M, Word, fault, whole
from cnc.gcode.turning import codes as turning
from cnc.gcode.turning import threads
from cnc.model.blocks import Abort, BoardCommand
from cnc.model.units import MM_PER_INCH

if TYPE_CHECKING:
    from cnc.gcode.turning.cycles import TurningCycles


# The saved modal state of each call: M70 to M73.

_Saved = tuple[ModalState, tuple[int, list[float]]]


class SavedState(MotionCodes):
    """Saves and restores the modal state. Each call has a saved state of its own."""

    def __init__(self, machine_codes: MachineCodes, motion: Motion) -> None:
        super().__init__(motion)
        self._machine_codes = machine_codes
        self._saved: list[_Saved | None] = [None]
        self._restore_at_return: list[bool] = [False]

    @property
    def calls(self) -> int:
        """Number of calls within each other."""
        return len(self._saved) - 1

    def enter(self) -> None:
        """Begin a call."""
        self._saved.append(None)
        self._restore_at_return.append(False)

    def leave(self) -> bool:
        """End a call; return whether M73 had saved a state in it, which is restored."""
        saved = self._saved.pop()
        if self._restore_at_return.pop() and saved is not None:
            self._restore(saved)
            return True
        return False

    def execute(self, code: Code) -> None:
        """Execute M70 and M73 (save), M71 (discard) or M72 (restore).

        Raises:
            GcodeError: ``state-not-saved``, ``compensation-active``.
        """
        if code.number in (M.M70, M.M73):
            self._saved[-1] = self._machine_codes.save(), self._motion.coordinates.save()
            self._restore_at_return[-1] = code.number == M.M73
        elif code.number == M.M71:
            self._saved[-1] = None
        else:
            saved = self._saved[-1]
            if saved is None:
                hint = "save it with M70 before, in the same program or subprogram"
                raise fault("state-not-saved", "M72 without a saved state", code.word, hint)
            self._restore(saved, code.word)

    def _restore(self, saved: _Saved, at: Word | None = None) -> None:
        modal, system = saved
        coordinates = self._motion.coordinates
        if self._motion.compensated and (
            modal.plane != self._state.plane or system != coordinates.save()
        ):
            message = "the saved plane or coordinate system differs, and cutter compensation is on"
            raise fault("compensation-active", message, at, "write G40 and a move before")
        self._machine_codes.restore(modal)
        self._unused_words.words.clear()
        coordinates.restore(system)
        self._motion.units_changed()


def _state_at_start(dialect: Dialect, policy: ReadingPolicy) -> ModalState:
    """Return the modal state in effect at the start of a program."""
    state = ModalState(motion=dialect.motion.at_start, initial_level=dialect.cycles.initial_level)
    if dialect.turning.lathe or policy.lathe:
        turning.power_on(state, dialect, policy.diameters)
    if policy.default_feed is not None:
        state.feed = feed_of(policy.default_feed, 1.0)
    return state


_WITHIN_THREADS = frozenset(
    ("motion", "distance", "arc-distance", "units", "plane", "feed-mode", "diameter")
)
"""Groups of codes beside which a thread goes on: they only change the meaning of words."""
MOST_PREPARED = 8192
"""Prepared statements that are kept."""


class Interpreter:
    """Executes the statements of a program.

    Attributes:
        ended: Whether the program has ended.
        aborted: Whether it has aborted itself.
        begun: Whether a word was executed.
        plain: Whether moves and cycles depend on units, offsets, distance mode and feed only.
        here: The current line.
        out: The blocks.
    """

    def __init__(
        self,
        file: str,
        axes: tuple[str, ...],
        dialect: Dialect,
        position: list[float],
        parameters: Parameters,
        warn: Warn | None,
        tools: ToolTable | None = None,
        policy: ReadingPolicy = STRICT,
    ) -> None:
        self.ended = self.aborted = self.begun = False
        self.plain = True
        self.here = SourceLocation(file, warn)
        self.out = BlockBuffer(self.here, len(axes))
        self.dialect, self.policy, self.parameters = dialect, policy, parameters
        self.coordinates = Coordinates(
            axes, parameters, systems=dialect.systems, fanuc=dialect.offsets.local_shift,
            shift_stays=dialect.offsets.shift_stays,
        )  # fmt: skip
        self.unused_words = UnusedWords(self.here)
        self.context = context = Context(
            dialect, policy, self.here, _state_at_start(dialect, policy), self.out, parameters,
            self.coordinates, self.unused_words,
        )  # fmt: skip
        self.motion = motion = Motion(context, position)
        self._add_codes(motion, ToolTable() if tools is None else tools)
        self.turning_cycles = self._register_curves_and_cycles()
        self._bind_parameters()
        self.points_wanted = dialect.lines.decimal_points and warn is not None
        self._prepared: dict[int, PreparedLine] = {}
        self.update_plain()

    @property
    def modal(self) -> ModalState:
        """The modal state."""
        return self.context.state

    def _add_codes(self, motion: Motion, tools: ToolTable) -> None:
        """Create the modules of the codes."""
        context = self.context
        self._assignments = Assignments(context)
        self._comment_commands = CommentCommands(context)
        self._builder_codes = BuilderCodes(context)
        self.machine_codes = MachineCodes(context)
        self._saved_state = SavedState(self.machine_codes, motion)
        self._dwells = Dwells(context)
        self.input_output_codes = InputOutputCodes(context)
        self.feed_codes = FeedCodes(motion)
        self.tip_control = TipControlCodes(motion)
        self.tool_codes = ToolCodes(motion, tools, self.tip_control)
        self._turret = turning.Turret(self.tool_codes) if self.dialect.turning.lathe else None
        self.offset_codes = OffsetCodes(motion, self.tool_codes)
        self.transform_codes = TransformCodes(motion)
        self.compensation_codes = CompensationCodes(motion, self.tool_codes)
        self.virtual_axis = None
        if G.G12_1 in self.dialect.g or G.G7_1 in self.dialect.g:
            from cnc.gcode.turning.virtual_axis import VirtualAxis

            self.virtual_axis = VirtualAxis(motion)

    def _register_curves_and_cycles(self) -> TurningCycles | None:
        """Register the curves and cycles as motion codes; return the cycles of a lathe."""
        motion = self.motion
        splines.register_g5(motion)
        nurbs.register_g6_2(motion)
        nurbs.register_g5_2(motion, self.feed_codes.feed)
        splines.register_bspline(motion, self.feed_codes.feed)
        runner = CycleRunner(motion)
        self.drilling_cycles = drilling.register(motion, runner, self._dwells)
        if self.dialect.cycles.hole_patterns:
            drilling.register_patterns(motion, self.drilling_cycles)
        threads.register_threading(motion, runner)
        circular_pocket.register(motion, self.tool_codes)
        self.probing = probing.Probing(motion)
        lathe_of_siemens = self.dialect.flavour == "siemens" and self.policy.lathe
        if not self.dialect.turning.lathe and not lathe_of_siemens:
            return None
        from cnc.gcode.turning import cycles

        if lathe_of_siemens:
            return cycles.register_thread(motion)
        return cycles.register(motion, self.compensation_codes)

    def _bind_parameters(self) -> None:
        """Let parameters read the position and the state."""
        parameters, context = self.parameters, self.context
        bind_position(self.coordinates, lambda: self.motion.position, lambda: context.state.scale)
        variables.bind_system_parameters(context)
        if self.dialect.flavour == "siemens":
            parameters.bind("_x_absolute", lambda: context.state.x_factor(absolute=True))
            parameters.bind("_x_incremental", lambda: context.state.x_factor(absolute=False))
        if parameters.macro:
            variables.bind_macro_variables(context, lambda: self.motion.position)
            OffsetVariables(self.tool_codes)
            variables.bind_control_variables(context)
        parameters.bind("_call_level", lambda: float(self._saved_state.calls))

    def execute(self, statement: Statement, line: int) -> None:
        """Execute the statement of a line; its blocks are in ``out``."""
        self.here.line = line
        prepared = self._prepared.get(id(statement))
        if prepared is None:
            prepared = self._prepare(statement)
        words = prepared.line_words(self.parameters) if statement.words else None
        if statement.assignments:
            self._assignments.execute(statement.assignments)
        for remark in statement.remarks:
            if remark.kind == DIRECTION:
                self.motion.turn_directions(remark.text)
            elif remark.kind == DIAMETERS:
                self.feed_codes.diameters(remark, is_lathe=self.policy.lathe)
                self.update_plain()
            elif error := self._comment_commands.execute(remark):
                self.compensation_codes.off()
                self.out.put(Abort(self.here.file, line))
                self.aborted = True
                raise error
        if words is not None:
            self._execute(words, prepared.codes, prepared.extra)
            self.begun = True
            self.update_plain()
        elif statement.board:
            command = BoardCommand(self.here.file, line, statement.board)
            if command.homes:
                self.out.ask(command, self.motion.homed)
            else:
                self.out.add(command)

    def end_of_file(self) -> None:
        """End a program that has no M2, M30 or ``%``.

        Raises:
            GcodeError: A spline is not complete.
        """
        if self.motion.corners.corner is not None:
            raise self.motion.corners.fault("the end of the program")
        if self.motion.collector:
            self.motion.collector.end("the program ends before the curve is complete")
        self.context.end_follow()
        self.compensation_codes.off()
        self.unused_words.end()
        self.out.flush()

    def entered(self) -> None:
        """Begin a subprogram, which has a saved state of its own."""
        self._saved_state.enter()

    def left(self) -> None:
        """End a subprogram and restore the state that M73 saved in it."""
        if self._saved_state.leave():
            self.update_plain()

    def _prepare(self, statement: Statement) -> PreparedLine:
        if len(self._prepared) >= MOST_PREPARED:
            self._prepared.clear()
        # The entry keeps its statement alive, so no other can have the same id.
        prepared = self._prepared[id(statement)] = prepare(
            statement, self.dialect, self._builder_codes
        )
        if self.points_wanted:
            collected = self.motion.collector is not None
            self.points_wanted = not feed_codes.report_missing(
                statement, self.dialect, self.here, collected=collected
            )
        return prepared

    def update_plain(self) -> None:
        """Find again whether moves are plain, after a change of the state."""
        state, motion = self.modal, self.motion
        self.plain = (
            state.feeds_are_plain
            and not self.dialect.turning.lathe
            and not state.radius_increments
            and motion.collector is None
            and not self.coordinates.turned
            and motion.length_change is None
            and not self.context.follows
            and self.motion.polar.plane is None
            and self.motion.corners.corner is None
            and self.out.map_move is None
        )

    def _execute(self, words: LineWords, codes: Codes | None, extra: tuple[ExtraCode, ...]) -> None:
        if codes is None:
            codes = codes_of(words.g, words.m, self.dialect)
        if extra:
            self._builder_codes.execute(words, extra)
        if self.dialect.turning.least_increments:
            self._take_least_increments(words, codes)
        if self.dialect.turning.lathe and "non-modal" not in codes:
            moving = codes.get("motion")
            if (moving.number if moving else self.modal.motion) == G.G1:
                turning.take_corners(words, self.motion.column)
        if self.dialect.turning.increments:
            turning.take_increments(words, codes, self.dialect)
        codes = self.tool_codes.with_length(words, codes)
        collector = self.motion.collector
        if not (collector and collector.line(words, codes)) and (
            codes or not self._is_program_number(words)
        ):
            self._in_order(words, codes)
        if words.rest:
            self.compensation_codes.keep_offset(words)
            self.tool_codes.keep_length(words)
        if words.rest and not (self.dialect.lenient and take_idle(words, self.modal, self.here)):
            raise unused(words, self.modal)
        if extra:
            self._builder_codes.pause(extra)
        if (corner := self.motion.corners.corner) is not None and corner.line != self.here.line:
            raise self.motion.corners.fault("a line without a move")

    def _take_least_increments(self, words: LineWords, codes: Codes) -> None:
        units, moving = codes.get("units"), codes.get("motion")
        scale = self.modal.scale
        if units is not None:
            scale = MM_PER_INCH if units.number == G.G20 else 1.0
        if (other := codes.get("non-modal")) and other.number == G.G4:
            scale = 1.0  # the time counts milliseconds
        turning.take_least_increments(words, moving.g.code if moving else 0.0, scale)

    def _is_program_number(self, words: LineWords) -> bool:
        is_number = (
            not self.begun and self.dialect.lines.program_number and words.rest.keys() == {"O"}
        )
        if is_number:
            whole(words.rest.pop("O"), "a program number", 0)
        return is_number

    def _in_order(self, words: LineWords, codes: Codes) -> None:
        """Execute the words of a line in the standard order."""
        if self.out.map_move is not None:
            assert self.virtual_axis is not None
            self.virtual_axis.check(words, codes)
        moving = self.feed_codes.moving = self.motion.check(words, codes)
        if self.context.follows and not self._goes_on(moving, words, codes):
            self.context.end_follow()
        explicit = codes.get("motion")
        if len(codes) == (explicit is not None):
            self.feed_codes.feed(words, codes)
            self.machine_codes.speed_and_tool(words, codes)
            if self._turret:
                self._turret.turn(words)
            self.motion.move(words, moving, explicit)
            return
        self._execute_machine_codes(words, codes)
        self._execute_settings(words, codes)
        if "exact-stop-once" in codes:
            self.machine_codes.stop_exactly(on=True)
        self.motion.move(words, moving, explicit)
        if self._stops_after(codes):
            self.machine_codes.spindle(words, codes)
        if "exact-stop-once" in codes:
            self.machine_codes.stop_exactly(on=False)
        if code := codes.get("skip-alarm"):
            self.probing.alarm(code)
        if code := codes.get("stop"):
            self.stop(code)

    def _goes_on(self, moving: G | None, words: LineWords, codes: Codes) -> bool:
        """Return whether a line goes on with the thread of the line before."""
        if moving not in turning.FOLLOWING:
            return False
        word = next((words.rest[letter] for letter in "ST" if letter in words.rest), None)
        if word is None:
            word = next(
                (code.word for group, code in codes.items() if group not in _WITHIN_THREADS), None
            )
        if word is not None:
            message = f"{word.written} between moves of a thread: the thread begins anew"
            hint = f"write {word.written} before the first move of the thread"
            self.here.report_warning("thread-interrupted", message, word, hint)
        return word is None

    def _stops_after(self, codes: Codes) -> bool:
        """Return whether the line has an M5 that takes effect behind its move."""
        code = codes.get("spindle")
        return (
            code is not None
            and code.number == M.M5
            and self.feed_codes.moving is not None
            and self.dialect.spindle.stops_after_move
        )

    def _execute_machine_codes(self, words: LineWords, codes: Codes) -> None:
        """Execute the first half of the order: feed mode to dwell."""
        state, functions = self.modal, self.machine_codes
        self.feed_codes.mode(codes)
        if self.dialect.feed.units_first:
            self.feed_codes.units(codes)
        self.feed_codes.feed(words, codes)
        self.compensation_codes.refuse(codes)
        functions.speed_and_tool(words, codes)
        if self._turret:
            self._turret.turn(words)
        self.input_output_codes.execute(words, codes)
        functions.tool_change(words, codes)
        if change := codes.get("tool-change"):
            self.tool_codes.check_change(state.loaded, change.word)
        if code := codes.get("kinematics"):
            self.tip_control.kinematics(code)
        if not self._stops_after(codes):
            functions.spindle(words, codes)
        if code := codes.get("state"):
            self._saved_state.execute(code)
        functions.coolant(codes)
        functions.overrides(words, codes)
        if (code := codes.get("non-modal")) and code.number == G.G4:
            self._dwells.execute(words, code)

    def _execute_settings(self, words: LineWords, codes: Codes) -> None:
        """Execute the second half of the order up to the motion: plane to G92."""
        state = self.modal
        if code := codes.get("plane"):
            state.plane = PLANES[code.g]
        self.feed_codes.units(codes)
        if code := codes.get("compensation"):
            self.compensation_codes.code(words, code)
        if code := codes.get("tool-length"):
            if self.out.map_move is None:
                self.tool_codes.tool_length(words, code)
            elif self.virtual_axis is not None:
                self.virtual_axis.execute(code.g, code.word)
        if code := codes.get("system"):
            self.offset_codes.system(words, code)
        if code := codes.get("path"):
            self.machine_codes.path_control(words, code)
        if code := codes.get("distance"):
            state.absolute = code.number == G.G90
            if state.radius_increments:
                self.motion.units_changed()
        if code := codes.get("arc-distance"):
            state.arc_absolute = code.number == G.G90_1
        if code := codes.get("retract"):
            state.initial_level = code.number == G.G98
        if (code := codes.get("face")) and self.virtual_axis is not None:
            self.virtual_axis.execute(code.g, code.word)
        self.transform_codes.execute(words, codes)
        if (code := codes.get("non-modal")) and code.number == G.G7_1:
            assert self.virtual_axis is not None
            self.virtual_axis.cylinder(words, code.word)
        elif code and code.number != G.G4:
            self.offset_codes.non_modal(words, code)

    def stop(self, code: Code) -> None:
        """Execute M0, M1, M60, M2 or M30."""
        if self.motion.collector:
            raise self.motion.collector.foreign(code.word)
        if code.number in (M.M2, M.M30):
            self.compensation_codes.off()
            self.unused_words.end()
        self.ended = self.machine_codes.stop(code)
        if self.ended:
            self.coordinates.end()
