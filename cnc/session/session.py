"""A session: one program on one machine, checked and, with a board, run; and its records."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cnc.boards.protocols import LineSink, PulseSink
from cnc.checks.hints import empty_program, step_rate
from cnc.checks.portable import ProgramText, dialects_of, portability
from cnc.checks.selection import unknown_codes
from cnc.gcode.core.line_trace import LineTrace
from cnc.gcode.dialects import Dialect
from cnc.machine.models import Machine, Stock
from cnc.model.blocks import Block
from cnc.model.diagnostics import (
    BoardError,
    CncError,
    Diagnostic,
    GcodeError,
    UsageError,
    printable,
)
from cnc.model.operator_control import Control, StoppedAtOnce
from cnc.path.build import DueTimes
from cnc.planner.plan import PlanChunk
from cnc.report.blocks import BlockWriter
from cnc.report.result import Extremes, Report
from cnc.report.targets import TextTarget
from cnc.session.check_pass import CheckPass
from cnc.session.checkpoint import Checkpoint, CheckpointWriter, file_hash
from cnc.session.context import (
    Callbacks,
    Observer,
    OpenOutputs,
    SessionContext,
    StoppedBeforeMotion,
    check_outputs,
)
from cnc.session.kernel_needs import KernelNeeds
from cnc.session.options import RunOptions
from cnc.session.pipeline import PathItems, PlannedMotion
from cnc.session.position_check import (
    PositionCheck,
    named_offsets,
    offsets_in,
    write_offsets,
)
from cnc.session.program_reader import (
    WITHOUT_FILE,
    ProgramReader,
    ProgramWarp,
    SavedState,
    Source,
    display_name,
    readable_file,
    start_position,
    with_source_lines,
)
from cnc.session.pulse_pass import PulsePass
from cnc.session.required_capabilities import (
    Board,
    CapabilityCheck,
    adopt_board,
    adopt_kept_offsets,
    assumed_offset,
    is_attended,
    reading_policy,
    refuse_lines,
)
from cnc.session.resume import PausePlace

if TYPE_CHECKING:
    from cnc.grbl_lines.grbl_timing import BoardTime

# Records of a run on a machine: its checkpoint, and the position check of a GRBL board.


class RunRecord:
    """Reads the records of the last run, and writes those of this one.

    Args:
        context: The session.
        capabilities: The board.
    """

    def __init__(self, context: SessionContext, capabilities: CapabilityCheck) -> None:
        self._context, self._capabilities = context, capabilities
        self._hash = ""
        self._last_run: Checkpoint | None = None
        self._position_check: PositionCheck | None = None
        self._board: str | None = None

    def read_checkpoint(self) -> None:
        """Read the checkpoint of the last run of this program, and warn if it matters."""
        context, capabilities = self._context, self._capabilities
        reader, report, line = context.reader, context.report, context.first_line
        if not capabilities.real or report.program in WITHOUT_FILE:
            return
        self._hash = file_hash(reader.path)
        last, warnings = Checkpoint.read(report.program)
        for damaged in warnings:
            context.observer.warn(damaged)
        if last is None:
            return
        unchanged = last.sha256 == self._hash
        same_machine = (last.machine, last.board) == (reader.machine.name, capabilities.board)
        if line is not None and unchanged and same_machine:
            self._last_run = last
        if unchanged and last.line and not last.ended:
            # A run that was killed has written the line itself, which may lie in a subprogram.
            last = last.model_copy(update={"line": self._line_to_continue_at(last.line)})
        warning = _checkpoint_warning(last, line, unchanged=unchanged)
        # The operator of a run that goes on after a pause has seen where it stopped.
        if warning is not None and context.after is None:
            context.observer.warn(warning)

    def check_position(self, board: LineSink) -> None:
        """Check the position that a GRBL board reports.

        Raises:
            BoardError: ``position-lost`` if the machine is not where the last run ended.
        """
        context, reader = self._context, self._context.reader
        self._position_check = PositionCheck(
            board, reader.machine, self._last_run, trusted=context.options.trust_position
        )
        # Lines that are skipped do not home the machine.
        self._position_check.check(() if context.first_line is not None else reader.blocks())

    def begin(self, board: PulseSink | LineSink) -> None:
        """Begin the records of this run; the machine is about to move."""
        context, capabilities = self._context, self._capabilities
        if self._position_check is not None:
            self._position_check.begin()
        checks_only = board.takes == "lines" and board.check_only
        if board.takes == "lines" and board.identity is not None and not checks_only:
            self._board = board.identity
            write_offsets(self._board, named_offsets(board, context.reader.machine))
        if self._hash and board.capabilities.resumable and not checks_only:
            machine = context.reader.machine
            first = Checkpoint(
                program=context.report.program,
                sha256=self._hash,
                machine=machine.name,
                board=capabilities.board,
                # The lines before were done by an earlier run.
                line=context.first_line or 0,
            )
            context.observer.checkpoint = CheckpointWriter(first, machine.axis_names)

    def end(self, ended: str, position: Mapping[str, float], line: int | None = None) -> None:
        """Complete the records.

        Args:
            ended: Why the run did not reach its end; empty if it did.
            position: The final position, mm; empty if it is unknown.
            line: The line reached, if it is known exactly.
        """
        observer, reader = self._context.observer, self._context.reader
        if self._board is not None and not ended and reader.state is not None:
            # G10 has changed them on the board, too.
            write_offsets(self._board, offsets_in(reader.state[0].values, reader.machine))
        checkpoint, observer.checkpoint = observer.checkpoint, None
        if self._position_check is not None:
            seen = None if checkpoint is None else checkpoint.latest.position
            self._position_check.end(ended or "end", seen)
        if checkpoint is None:
            return
        if ended:
            resume = checkpoint.end(ended, line, position, self._line_to_continue_at)
            self._context.report.resume_line = resume or None
        else:
            checkpoint.done()

    def with_resume_hint(self, error: BoardError) -> BoardError:
        """Return the error with a hint of the line to continue at, if it is known."""
        finding, line = error.diagnostic, self._context.report.resume_line
        if line is None:
            return error
        hint = f"continue with --from-line {line}"
        return type(error)(
            replace(finding, hint=f"{finding.hint}; then {hint}" if finding.hint else hint)
        )

    def _line_to_continue_at(self, line: int) -> int:
        try:
            return self._context.reader.line_to_continue_at(line)
        except (CncError, StoppedBeforeMotion):
            return line


def _checkpoint_warning(
    last: Checkpoint, line: int | None, *, unchanged: bool
) -> Diagnostic | None:
    """Return the finding about a run that begins at ``line`` after an unfinished one."""
    if line is None:
        if not unchanged:
            return None
        message = f"the last run of this program reached line {last.line} and not its end"
        hint = f"--from-line {last.line} continues there; this run begins at the first line"
        return Diagnostic("run-unfinished", message, hint=hint, severity="note")
    if not unchanged:
        message = (
            f"the program has changed since the run that reached its line {last.line}; "
            f"line {line} may be another one now"
        )
        hint = "check in the program where to begin"
        return Diagnostic("checkpoint-differs", message, hint=hint, severity="warning")
    if line > last.line:
        message = (
            f"the last run reached line {last.line}; the lines from there to {line} are skipped"
        )
        hint = f"--from-line {last.line} skips nothing"
        return Diagnostic("checkpoint-before", message, hint=hint, severity="warning")
    return None


# The beginning and the end of a session in the log.


def log_begin(context: SessionContext, report: Report) -> None:
    """Log the program, the machine and the options."""
    machine = context.reader.machine
    log.info("program %s", printable(report.program))
    log.info(
        "machine %s, board %s, dialect %s",
        machine.name,
        report.board or "none",
        context.reader.dialect,
    )
    log.debug("%s", context.options)
    log.debug("%r", machine)


def log_end(context: SessionContext, report: Report) -> None:
    """Log the operator's requests, the faults and how the session ended."""
    context.observer.log_requests()
    for fault in report.faults:
        log.error("%s", fault.diagnostic.render())
    if report.stopped_at_line is not None:
        log.info("stopped at line %d; position %s", report.stopped_at_line, report.end_position)
    log.info(
        "end: %d faults, %d warnings, total %.3f s",
        len(report.faults) + report.hidden_faults,
        len(report.warnings) + report.hidden_warnings,
        report.timing.total_s,
    )


log = logging.getLogger(__name__)


class Session:
    """Checks or runs one program.

    Args:
        program: The program.
        machine: The machine.
        options: Options of the check or run; None for the defaults.
        callbacks: Functions that follow the session.
        control: The operator's requests; None if there is no operator.
        on_plan: Called with each chunk of the plan that the report describes.
        after: The pause after which to go on (:meth:`place_of_pause`); None to begin as the
            options say.

    Attributes:
        report: Filled as the session proceeds.
        moved: Whether the motion has begun.

    Raises:
        UsageError: ``output-format`` for an unknown suffix, or if another option is wrong.
    """

    def __init__(
        self,
        program: Source,
        machine: Machine,
        options: RunOptions | None = None,
        *,
        callbacks: Callbacks | None = None,
        control: Control | None = None,
        on_plan: Callable[[PlanChunk], None] | None = None,
        after: PausePlace | None = None,
    ) -> None:
        options = options or RunOptions()
        check_outputs(options.outputs)
        if options.outputs.stl is not None and machine.stock is None:
            message = "--stl writes the cut part, but there is no stock"
            hint = "give --stock X0:100,Y0:60,Z-12:0, or a table [stock] in the machine file"
            raise UsageError(Diagnostic("stock-missing", message, hint=hint))
        if machine.kinematics.joints or machine.is_compensated:
            refuse_lines(machine, options)
        name = display_name(program)
        self.report = Report(name, machine, limits=Extremes.limits(machine))
        self._program = program
        self._portable = dialects_of(options.portable)
        observer = Observer(
            callbacks or Callbacks(),
            control or Control(options.feed_override),
            options.selection,
            self.report,
        )
        reader = ProgramReader(
            name,
            Path(name),
            machine,
            options.dialect or machine.program.dialect,
            start_position(machine),
            SavedState(machine),
            observer.checking,
            block_delete=options.block_delete,
        )
        if options.height_map is not None:
            reader.warp = ProgramWarp(options.height_map, machine)
        self._home: Callable[[], None] | None = None
        self._context = SessionContext(
            reader,
            self.report,
            observer,
            options,
            OpenOutputs(),
            control is not None,
            on_plan,
            after,
        )
        self.moved = False
        self._plans = True
        self._kernels = KernelNeeds(self._context)

    def read_from(self, path: Path) -> None:
        """Read the program from a file that has its text."""
        self._context.reader.path = path

    def rules(self) -> Dialect:
        """Return the dialect of the program, as the check pass reads it."""
        return self._context.reader.rules()

    def blocks(self, warn: Callable[[Diagnostic], None] | None = None) -> Iterator[Block]:
        """Yield the canonical blocks of the program, read as in the check pass.

        Args:
            warn: Called with each warning and note of the language.
        """
        context = self._context
        if context.options.tool_lengths is not None:
            context.reader.policy = reading_policy(context.options, context.reader.machine, None)
        with readable_file(self._program) as context.reader.path:
            yield from context.reader.blocks(warn)

    def traced(self, trace: LineTrace) -> Iterator[Block]:
        """Yield the canonical blocks of the program, with a mark behind each line."""
        context = self._context
        context.reader.policy = reading_policy(context.options, context.reader.machine, None)
        with readable_file(self._program) as context.reader.path:
            yield from context.reader.traced_blocks(trace)

    @property
    def start(self) -> NDArray[np.float64]:
        """Position of the machine before the program (axes,), mm."""
        return self._context.reader.start

    @property
    def parameters(self) -> Mapping[int, float]:
        """Parameters by number with locals, as the latest reading of the program leaves them."""
        state = self._context.reader.state
        return {} if state is None else state[0].locals | state[0].values

    def place_of_pause(self) -> PausePlace:
        """Return the place of the pause at which the run waits.

        Any thread may call it during the run. The program is read up to there.

        Raises:
            GcodeError: ``from-line-unknown`` if no run can go on there.
        """
        observer = self._context.observer
        return self._context.reader.place_of_pause(observer.pauses, observer.paused_at)

    def read(self) -> Report:
        """Carry out the check pass alone: language and travel, and no plan.

        The travel is that of the path as it is programmed, without the splines of G64.
        """
        self._plans = False
        return self.run()

    def run(self, board: Board | None = None, board_name: str | None = None) -> Report:
        """Check the program, then plan it and send it to the board, if there is one.

        Returns:
            The report, with the faults of program and board.

        Raises:
            UsageError: ``no-pulses`` if the board takes lines and pulses are to be written.
        """
        context, report, began = self._context, self.report, perf_counter()
        reader = context.reader
        reader.policy = reading_policy(context.options, reader.machine, board)
        report.board = board_name
        log_begin(self._context, self.report)
        try:
            if board is not None and board.takes == "lines":
                adopt_board(context, board)
        except BoardError as error:
            report.faults.append(error)
            return report
        if board is None:
            adopt_kept_offsets(context)
            # With a board the operator's override changes the times.
            reader.due_times = DueTimes()
        else:
            context.observer.control.take_board(overrides=board.capabilities.overrides)
        try:
            with ExitStack() as stack:
                reader.path = stack.enter_context(readable_file(self._program))
                stack.callback(context.files.discard)
                try:
                    self._process(board)
                except CncError as error:
                    report.faults.append(error)
                report.dialect = reader.dialect_in_use
                if reader.recognition is not None:
                    report.recognition = reader.recognition.described()
                report.assumed = context.observer.assumed(reader.assumed)
                if self._portable and report.stopped_at_line is None:
                    report.faults += portability(
                        ProgramText(reader.path, report.program, reader.blocks_in_dialect),
                        reader.dialect,
                        self._portable,
                        report.faults,
                    )
                report.faults = with_source_lines(report.faults, {report.program: reader.path})
        except StoppedBeforeMotion:
            report.stopped_at_line = 0
        except CncError as error:
            report.faults.append(error)
        report.timing.total_s = perf_counter() - began
        log_end(self._context, self.report)
        return report

    def _process(self, board: Board | None) -> None:
        """Carry out both passes; raise the first fault that ends them."""
        context, report, reader = self._context, self.report, self._context.reader
        capabilities = CapabilityCheck.of(
            board, report.board, reader.machine, is_attended(context, board)
        )
        capabilities = replace(capabilities, skips_commands=reader.dialect == "auto")
        record = RunRecord(context, capabilities)
        record.read_checkpoint()
        lines = board if board is not None and board.takes == "lines" else None
        if board is not None:
            self._home = self._homing(board)
            self._warn(board.unlike(report.machine))
        if lines is not None and self._home is None:
            record.check_position(lines)
        reader.begin_at(context.options.from_line, context.after)
        check, kept = self._check_pass(capabilities, for_lines=lines is not None)
        context.observer.checking(report.lines)
        if reader.warp is not None:
            report.height_map = reader.warp.used()
            # Without an offset file, a check knows no zero of a GRBL board.
            if report.offset is None or report.offset.kept or reader.saved.given:
                self._warn(reader.warp.moved_zero(reader.saved.given))
        if not report.ok:
            self._warn(assumed_offset(report))
            return
        if not self._plans:
            return
        if board is None and reader.machine.stock is not None:
            self._cut(reader.machine.stock)
        self._kernels.before_motion(board, reads_again=kept is None)
        self._confirm_restart()
        if lines is not None and self._home is not None:
            self._home()
            record.check_position(lines)
        control = context.observer.control
        overrides = control.feed_override, float(control.rapid_override)
        timing = self._write_lines(board, capabilities)
        timing = self._run_pass(board, record, kept, check.depends_on_answers) or timing
        exact = report.stopped_at_line
        if lines is not None and exact != lines.moving_line:
            # The last line that the board has accepted may lie ahead of the motion.
            exact = None
        stopped = report.stopped_at_line is not None
        record.end("stopped" if stopped else "", report.end_position, exact)
        if timing is not None and capabilities.lines and not stopped:
            report.duration_s = timing.remaining(0, *overrides)
        if board is None:
            self._warn(empty_program(report))
            self._warn(step_rate(report))
        if report.ok and not stopped:
            context.files.close()
            if board is not None and reader.state is not None:
                reader.saved.save(*reader.state)

    def _homing(self, board: Board) -> Callable[[], None] | None:
        """Return how the board homes the machine before the program; None if it shall not.

        A machine on a board that plays pulses begins where the board knows that it stands.

        Raises:
            BoardError: As :func:`cnc.session.homing.locate`.
        """
        from cnc.session import homing  # a check does not need it

        context = self._context
        if board.takes == "pulses":
            homing.locate(context, board)
            home = partial(homing.home_pulse_board, context, board)
        elif not board.check_only:
            home = partial(homing.home_line_board, context, board)
        else:
            return None
        return home if context.options.home else None

    def _check_pass(
        self, capabilities: CapabilityCheck, *, for_lines: bool
    ) -> tuple[CheckPass, PathItems | None]:
        """Carry out the check pass; return the path if the run pass can use it."""
        context, report, reader = self._context, self.report, self._context.reader
        check, target = CheckPass(context, capabilities, self._kernels), None
        if context.options.outputs.blocks is not None:
            target = context.files.opened(
                BlockWriter(
                    context.options.outputs.blocks, reader.machine.axis_names, report.program
                )
            )
        try:
            with self._kernels.reading(reader.path):
                kept = check.run(target, for_lines=for_lines, rounds=self._plans)
        finally:
            report.timing.parse_s = check.reading_time.seconds
            # Path building draws from the reader, so its time includes the reading time.
            report.timing.plan_s = check.path_time.seconds - check.reading_time.seconds
        log.info(
            "check pass: %d lines, %d blocks, %d faults; reading %.3f s, path %.3f s",
            report.lines,
            report.blocks,
            len(report.faults) + report.hidden_faults,
            report.timing.parse_s,
            report.timing.plan_s,
        )
        if check.hints is not None:
            self._warn([*check.hints.findings(), *unknown_codes(reader.path, report.program)])
        return check, kept

    def _cut(self, stock: Stock) -> None:
        """Simulate the cut, report what it finds, and write the part if requested."""
        from cnc.session.cut_pass import cut  # most machines have no stock

        self._kernels.before_simulation()
        cut(self._context, stock, self._warn)

    def _run_pass(
        self,
        board: Board | None,
        record: RunRecord,
        kept: PathItems | None,
        depends_on_answers: bool,
    ) -> BoardTime | None:
        """Carry out the run pass; return the timing of the lines, if the board takes lines."""
        context, report, motion = self._context, self.report, PlannedMotion(self._context)
        began, timing = perf_counter(), None

        def before_motion() -> None:
            if board is not None:
                self._begin_motion(board, record)

        try:
            if board is not None and board.takes == "lines":
                from cnc.session.run_lines import LinePass  # a check does not need it

                lines = LinePass(
                    context, motion, board, self._warn, depends_on_answers=depends_on_answers
                )
                timing = lines.timing
                lines.run(before_motion)
            else:
                PulsePass(context, motion, board).run(kept, before_motion)
        except BoardError as error:
            record.end(error.diagnostic.code, report.end_position)
            raise record.with_resume_hint(error) from error
        except StoppedAtOnce as stop:
            record.end("broken off", {})
            text = str(stop)
            if board is not None and board.takes == "lines" and not board.position_lost:
                text = "stopped by the operator at once; the board has kept its position"
            if report.resume_line is not None:
                text = f"to continue: --from-line {report.resume_line}\n{text}"
            raise StoppedAtOnce(text) from stop
        except BaseException as error:
            record.end(error.diagnostic.code if isinstance(error, CncError) else "broken off", {})
            raise
        finally:
            planning = motion.planning_time.seconds - motion.reading_time.seconds
            report.timing.plan_s += max(0.0, planning)
            report.timing.interpolate_s = motion.interpolating_time.seconds
            log.info(
                "run pass: %.3f s; planning %.3f s, interpolating %.3f s, motion %.3f s",
                perf_counter() - began,
                planning,
                report.timing.interpolate_s,
                report.duration_s,
            )
        return timing

    def _begin_motion(self, board: Board, record: RunRecord) -> None:
        """Home the machine on a pulse board if requested, and begin the records.

        Raises:
            BoardError, HomingStopped: As :func:`cnc.session.homing.home`.
        """
        if board.takes == "pulses" and self._home is not None:
            self._home()
        record.begin(board)
        self.moved = True
        log.info("motion begins")

    def _confirm_restart(self) -> None:
        """Show the steps to the line to begin at, and ask for confirmation."""
        restart, ask = self._context.reader.restart, self._context.observer.callbacks.on_beginning
        if restart is None:
            return
        log.info("%s", "; ".join(restart.steps))
        if (draw := self._context.observer.callbacks.on_approach) is not None:
            draw(restart.approach)
        if ask is not None and not ask(restart.steps):
            raise StoppedBeforeMotion

    def _write_lines(self, board: Board | None, capabilities: CapabilityCheck) -> BoardTime | None:
        """Write the program as lines for a GRBL board, if requested.

        Returns:
            The timing of the lines, if a board takes lines or lines are written.
        """
        target = self._context.options.outputs.lines
        if target is None and (board is not None or not capabilities.lines):
            return None
        from cnc.grbl_lines.translator import LineProgram  # a check does not need it

        reader = self._context.reader
        file = None if target is None else self._context.files.opened(TextTarget(target))
        program = LineProgram(
            reader.machine,
            reader.start,
            reader.saved.parameters(macro=False).values,
            self.report.bounding_box,
        )
        timing = program.write(reader.blocks(), None if file is None else file.write)
        self._warn(program.lowered.findings())
        return timing

    def _warn(self, findings: Iterable[Diagnostic]) -> None:
        """Report findings that lack their source line."""
        name = self.report.program
        faults = [GcodeError(finding).at(file=finding.file or name) for finding in findings]
        for fault in with_source_lines(faults, {self.report.program: self._context.reader.path}):
            self._context.observer.warn(fault.diagnostic)
