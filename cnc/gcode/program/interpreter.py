"""The interpreter: statements and modal state to canonical blocks.

A line is executed in the order of RS274/NGC, in whatever order its words stand: messages, feed
mode, F, S, T, inputs and outputs, tool change, spindle, saved state, coolant, overrides, dwell,
plane, units, compensation, length, coordinate system, path control, distance and retract modes, G10
to G92, motion, stop. A word that no code uses is an error, so no word is ignored. Source: LinuxCNC,
"G-code overview", order of execution.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cnc.gcode import dialects
from cnc.gcode.codes import (
    circular_pocket,
    control_variables,
    decimal_points,
    macro_variables,
    probing,
    system_parameters,
    turning,
)
from cnc.gcode.codes.builder_codes import BuilderCodes, ExtraCode
from cnc.gcode.codes.compensation_codes import CompensationCodes
from cnc.gcode.codes.dwells import Dwells
from cnc.gcode.codes.feed_codes import FeedCodes
from cnc.gcode.codes.figure_codes import FigureCodes
from cnc.gcode.codes.input_output_codes import InputOutputCodes
from cnc.gcode.codes.machine_codes import MachineCodes
from cnc.gcode.codes.motion import Motion
from cnc.gcode.codes.offset_codes import OffsetCodes
from cnc.gcode.codes.offset_variables import OffsetVariables
from cnc.gcode.codes.prepared_lines import PreparedLine, prepare
from cnc.gcode.codes.tip_control import TipControlCodes
from cnc.gcode.codes.tool_codes import ToolCodes
from cnc.gcode.codes.unused import take_idle, unused
from cnc.gcode.cycles import drilling, hole_patterns, threading
from cnc.gcode.cycles.cycle_runner import CycleRunner
from cnc.gcode.program.assignments import Assignments
from cnc.gcode.program.comment_commands import CommentCommands
from cnc.gcode.program.saved_state import SavedState
from cnc.gcode.splines import bezier, bspline, g5_2, g6_2
from cnc.gcode.state.block_buffer import BlockBuffer
from cnc.gcode.state.context import Context
from cnc.gcode.state.coordinates import Coordinates
from cnc.gcode.state.modal_groups import PLANES, Code, Codes, ModalState, codes_of, feed_of
from cnc.gcode.state.position_parameters import bind_position
from cnc.gcode.state.reading_policy import STRICT, ReadingPolicy
from cnc.gcode.state.rotary_axes import RotaryAxes
from cnc.gcode.state.source_location import SourceLocation, Warn
from cnc.gcode.state.tool_table import ToolTable
from cnc.gcode.state.unused_words import UnusedWords
from cnc.gcode.syntax.code_numbers import G, M
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.statement import DIAMETERS, DIRECTION, Statement
from cnc.gcode.syntax.words import LineWords, whole
from cnc.model.blocks import Abort, BoardCommand

if TYPE_CHECKING:
    from cnc.gcode.cycles.turning_cycles import TurningCycles

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
        dialect: dialects.Dialect,
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
        self.modal = ModalState(motion=dialect.motion, initial_level=dialect.initial_level)
        if dialect.lathe or policy.lathe:
            turning.power_on(self.modal, dialect, policy.diameters)
        if policy.default_feed is not None:
            self.modal.feed = feed_of(policy.default_feed, 1.0)
        self.dialect, self.policy = dialect, policy
        self.parameters = parameters
        own_zero = dialect.offset_memory or dialect.flavour in ("siemens", "klartext")
        self.coordinates = Coordinates(
            axes, parameters, systems=dialect.systems, fanuc=own_zero,
            shift_stays=dialect.shift_stays,
        )  # fmt: skip
        single = dialect.flavour == "siemens"
        self._assignments = Assignments(
            parameters, self.coordinates, self.here, self.out, one_by_one=single
        )
        self.unused_words = UnusedWords(self.here)
        self._builder_codes = BuilderCodes(dialect, policy, self.here, self.out, axes)
        context = Context(dialect, self.here, self.modal, self.out, parameters, self.unused_words)
        self.machine_codes = MachineCodes(
            context, laser=policy.laser, optional_stop=policy.optional_stop
        )
        self._dwells = Dwells(context)
        self.input_output_codes = InputOutputCodes(context, tilting=policy.tool_tip is not None)
        self.motion = motion = Motion(context, axes, position, self.coordinates)
        motion.rotary = RotaryAxes(axes, policy.wraps, dialect.wrap)
        self.feed_codes = FeedCodes(motion)
        self.tip_control = TipControlCodes(motion, policy.tool_tip)
        self.tool_codes = ToolCodes(
            motion,
            ToolTable() if tools is None else tools,
            self.tip_control,
            zero_without_table=policy.tool_lengths == "zero",
        )
        self._turret = turning.Turret(self.tool_codes, self.out) if dialect.lathe else None
        self.offset_codes = OffsetCodes(motion, self.tool_codes)
        self.figure_codes = FigureCodes(motion)
        self.compensation_codes = CompensationCodes(motion, self.tool_codes)
        self.turning_cycles = self._register_curves_and_cycles()
        self._bind_parameters()
        self.points_wanted = dialect.decimal_points
        self._prepared: dict[int, PreparedLine] = {}
        self._saved_state = SavedState(
            self.machine_codes, self.modal, self.motion, self.unused_words
        )
        self._comment_commands = CommentCommands(
            self.here, self.out, parameters, aborts=dialect.flavour == "ngc"
        )
        self.update_plain()

    def _register_curves_and_cycles(self) -> TurningCycles | None:
        """Register the curves and cycles as motion codes; return the cycles of a lathe."""
        motion = self.motion
        bezier.register(motion)
        g6_2.register(motion)
        g5_2.register(motion, self.feed_codes.feed)
        bspline.register(motion, self.feed_codes.feed)
        runner = CycleRunner(motion)
        self.drilling_cycles = drilling.register(motion, runner, self._dwells)
        if self.dialect.hole_patterns:
            hole_patterns.register(motion, self.drilling_cycles)
        threading.register(motion, runner)
        circular_pocket.register(motion, self.tool_codes)
        self.probing = probing.Probing(motion)
        if not self.dialect.lathe:
            return None
        from cnc.gcode.cycles import turning_cycles

        return turning_cycles.register(motion, self.compensation_codes)

    def _bind_parameters(self) -> None:
        """Let parameters read the position and the state."""
        parameters, modal = self.parameters, self.modal
        bind_position(self.coordinates, lambda: self.motion.position, lambda: modal.scale)
        system_parameters.bind(parameters, modal, self.here)
        if self.dialect.flavour == "siemens":
            parameters.bind("_x_absolute", lambda: modal.x_factor(absolute=True))
            parameters.bind("_x_incremental", lambda: modal.x_factor(absolute=False))
        if parameters.macro:
            macro_variables.bind(
                parameters, modal, self.here, self.coordinates, self.out,
                lambda: self.motion.position,
            )  # fmt: skip
            OffsetVariables(self.tool_codes)
            control_variables.bind(parameters, self.here, self.policy, self.dialect.variables)
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
        if self.turning_cycles is not None:
            self.turning_cycles.moves.end_follow()
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
            self.points_wanted = not decimal_points.report_missing(
                statement, self.dialect, self.here, collected=collected
            )
        return prepared

    def update_plain(self) -> None:
        """Find again whether moves are plain, after a change of the state."""
        state, motion = self.modal, self.motion
        self.plain = (
            state.feeds_are_plain
            and not self.dialect.lathe
            and not state.radius_increments
            and motion.collector is None
            and not self.coordinates.turned
            and motion.length_change is None
            and self.motion.polar.plane is None
            and self.motion.corners.corner is None
        )

    def _execute(self, words: LineWords, codes: Codes | None, extra: tuple[ExtraCode, ...]) -> None:
        if codes is None:
            codes = codes_of(words.g, words.m, self.dialect)
        if extra:
            self._builder_codes.execute(words, extra)
        if self.dialect.increments:
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

    def _is_program_number(self, words: LineWords) -> bool:
        found = not self.begun and self.dialect.program_number and words.rest.keys() == {"O"}
        if found:
            whole(words.rest.pop("O"), "a program number", 0)
        return found

    def _in_order(self, words: LineWords, codes: Codes) -> None:
        """Execute the words of a line in the standard order."""
        moving = self.feed_codes.moving = self.motion.check(words, codes)
        if self.turning_cycles is not None and moving != G.G33:
            self.turning_cycles.moves.end_follow()
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

    def _stops_after(self, codes: Codes) -> bool:
        """Return whether the line has an M5 that takes effect behind its move."""
        code = codes.get("spindle")
        return (
            code is not None
            and code.number == M.M5
            and self.feed_codes.moving is not None
            and self.dialect.stops_after_move
        )

    def _execute_machine_codes(self, words: LineWords, codes: Codes) -> None:
        """Execute the first half of the order: feed mode to dwell."""
        state, functions = self.modal, self.machine_codes
        self.feed_codes.mode(codes)
        if self.dialect.units_before_feed:
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
            self.tool_codes.tool_length(words, code)
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
        self.figure_codes.execute(words, codes)
        if (code := codes.get("non-modal")) and code.number != G.G4:
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
