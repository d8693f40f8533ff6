"""A job: a program, a machine, and what is wanted of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np

from cnc.boards.loopback import Loopback
from cnc.boards.protocols import HasLimitSwitches, LineSink, PulseSink, RemembersPosition
from cnc.checks.hints import step_rate
from cnc.checks.portable import ProgramText, dialects_of, portability
from cnc.checks.selection import Selection, unknown_codes
from cnc.executor.homing import home, homed_steps, homing_sequence
from cnc.grbl_lines.grbl_timing import BoardTime
from cnc.grbl_lines.line_program import LineProgram
from cnc.machine.models import DialectName, Machine
from cnc.model.blocks import Block
from cnc.model.diagnostics import BoardError, CncError, Diagnostic, GcodeError, UsageError
from cnc.model.operator_control import Control
from cnc.outputs.blocks import BlockWriter
from cnc.outputs.targets import TextTarget
from cnc.planner.plan import PlanChunk
from cnc.pulses.reference_pulse import Algorithm
from cnc.report.result import Extremes, Report
from cnc.session.board_offsets import adopted
from cnc.session.check_pass import FirstPass
from cnc.session.checkpoint import Checkpoint, Recorder, digest
from cnc.session.kernel_cache import ensure_compiled
from cnc.session.observer import Lookout, Pauses, Stopped, Watch
from cnc.session.outputs import OpenOutputs, Outputs
from cnc.session.program_reader import Reading, start_position
from cnc.session.required_capabilities import Abilities
from cnc.session.run_pass import SecondPass
from cnc.session.saved_state import Memory
from cnc.session.source import STANDARD_INPUT_NAME, Source, readable, shown_name, with_texts
from cnc.session.standing import Standing


class Job:
    """Fills ``report`` as it goes; see :func:`cnc.api.run` for the arguments. UsageError
    ``output-format`` for an unknown suffix.
    """

    def __init__(
        self,
        program: Source,
        machine: Machine,
        dialect: DialectName | None,
        sampled: bool,
        outputs: Outputs,
        watch: Watch,
        control: Control | None = None,
        algorithm: Algorithm | None = None,
        selection: Selection | None = None,
        portable: Sequence[str] = (),
        on_plan: Callable[[PlanChunk], None] | None = None,
        pauses: Pauses = "wait",
        from_line: int | None = None,
        home: bool = False,
        trust_position: bool = False,
    ) -> None:
        outputs.check()
        name = shown_name(program)
        self.report = Report(name, machine, limits=Extremes.limits(machine))
        self._program = program
        self._outputs, self._files = outputs, OpenOutputs()
        self._lookout = Lookout(watch, control or Control(), selection or Selection(), self.report)
        self._reading = Reading(
            name,
            Path(name),
            machine,
            dialect or machine.program.dialect,
            start_position(machine),
            Memory(machine),
            self._lookout.checking,
        )
        self._sampled = sampled or outputs.trace is not None
        self._operated = control is not None
        self._algorithm = algorithm
        self._portable = dialects_of(portable)
        self._on_plan = on_plan
        self._pauses: Pauses = pauses
        self._from_line = from_line
        self._hash = ""
        self._home = home
        self._trust_position = trust_position
        self._last_run: Checkpoint | None = None
        self._standing: Standing | None = None

    def blocks(self) -> Iterator[Block]:
        """The canonical blocks of the program, read as in the first pass."""
        return self._reading.blocks()

    def carry_out(
        self, board: PulseSink | LineSink | None = None, board_name: str | None = None
    ) -> Report:
        """Both passes, the second on ``board`` or on none; what goes wrong with program or board
        ends up in the report.
        """
        ensure_compiled(self._lookout.watch.on_compiling)
        report, reading, began = self.report, self._reading, perf_counter()
        report.board = board_name
        if isinstance(board, LineSink):
            self._adopt(board)
        try:
            with ExitStack() as stack:
                reading.path = stack.enter_context(readable(self._program))
                stack.callback(self._files.discard)
                try:
                    self._carry_out(board)
                except CncError as error:
                    report.faults.append(error)
                if self._portable and report.stopped_at_line is None:
                    report.faults += portability(
                        ProgramText(reading.path, report.program, reading.under),
                        reading.dialect,
                        self._portable,
                        report.faults,
                    )
                report.faults = with_texts(report.faults, {report.program: reading.path})
        except Stopped:
            report.stopped_at_line = 0
        except CncError as error:
            report.faults.append(error)
        report.timing.total_s = perf_counter() - began
        return report

    def _adopt(self, board: LineSink) -> None:
        """The board's own travel, offsets and position: the program is read with them."""
        if self._outputs.pulses is not None:
            hint = "leave --pulses out, or check the program without the board"
            raise UsageError(
                Diagnostic(
                    "no-pulses",
                    "a board that plans for itself is sent lines, not pulses",
                    hint=hint,
                )
            )
        reading = self._reading
        reading.machine = board.limited_to_board(reading.machine)
        reading.start = np.array(board.position)
        reading.memory.adopt(adopted(board, reading.machine))

    def _locate(self, board: RemembersPosition) -> None:
        """Where the program begins: where the board knows that it stands, or will when it has come
        home.
        """
        reading, machine = self._reading, self._reading.machine
        standing = board.known_steps
        ways = (
            homing_sequence(machine, (), len(board.switches))
            if self._home and isinstance(board, HasLimitSwitches)
            else ()
        )
        steps = homed_steps(machine, ways, standing, reading.start)
        reading.start = steps / machine.steps_per_mm
        coming = {way.letter for way in ways}
        lost = [
            letter
            for letter, known in zip(machine.axes, standing, strict=True)
            if known is None and letter not in coming
        ]
        if lost and not ways:
            names = " ".join(letter.upper() for letter in lost)
            what = (
                f"the board does not know where {names} {'stands' if len(lost) == 1 else 'stand'}"
            )
            if machine.can_home:
                why = "it was reset or switched off, or a limit switch or the e-stop has stopped it at once"
                hint = (
                    "let it find out first: --home does that before the program, cncrun home alone"
                )
                raise BoardError(Diagnostic("not-homed", f"{what}: {why}", hint=hint))
            places = " ".join(
                f"{letter.upper()}{place:g}"
                for letter, place in zip(machine.axes, reading.start.tolist(), strict=True)
            )
            message = f"{what}; the program begins as if the machine stood at {places}"
            hint = "on a machine with limit switches --home finds out, or cncrun home"
            self._lookout.warn(
                Diagnostic("position-assumed", message, hint=hint, severity="warning")
            )

    def _compare_position(self, board: LineSink) -> None:
        """BoardError ``position-lost`` where the machine does not stand where the last run left
        it.
        """
        self._standing = Standing(
            board, self._reading.machine, self._last_run, trusted=self._trust_position
        )
        # What is left out by --from-line homes nothing.
        self._standing.check(() if self._from_line is not None else self._reading.blocks())

    def _carry_out(self, board: PulseSink | LineSink | None) -> None:
        report, reading, lookout = self.report, self._reading, self._lookout
        abilities = Abilities.of(board, report.board, reading.machine, self._attended(board))
        self._recall(abilities)
        if isinstance(board, RemembersPosition):
            self._locate(board)
        if isinstance(board, LineSink):
            self._compare_position(board)
        reading.begin_at(self._from_line)
        first = FirstPass(reading, report, lookout, abilities)
        shown = None
        if self._outputs.blocks is not None:
            shown = self._files.opened(
                BlockWriter(self._outputs.blocks, reading.machine.axis_names, report.program)
            )
        try:
            # Lines come from a path of their own, which is not the one that is surveyed.
            kept = first.carry_out(shown, keep=not isinstance(board, LineSink))
        finally:
            report.timing.parse_s = first.watch_reading.seconds
            # The path is drawn through the reader, so its watch ran meanwhile.
            report.timing.plan_s = first.watch_path.seconds - first.watch_reading.seconds
        if first.hints is not None:
            self._hint([*first.hints.findings(), *unknown_codes(reading.path, report.program)])
        lookout.checking(report.lines)
        if not report.ok:
            return
        self._confirm_beginning()
        board_time = self._translate(board, abilities)
        second = SecondPass(
            reading,
            report,
            lookout,
            self._outputs,
            self._files,
            algorithm=self._algorithm,
            sampled=self._sampled,
            pauses=self._pauses,
            operated=self._operated,
            asks=first.asks,
            on_plan=self._on_plan,
        )
        try:
            second.carry_out(board, kept, lambda: self._begin(board, abilities))
        except BoardError as error:
            self._over(error.diagnostic.code, report.end_position)
            raise self._resumable(error) from error
        except BaseException as error:
            self._over(error.diagnostic.code if isinstance(error, CncError) else "broken off", {})
            raise
        finally:
            report.timing.plan_s += max(
                0.0, second.watch_planning.seconds - second.watch_reading.seconds
            )
            report.timing.interpolate_s = second.watch_interpolating.seconds
        exact = report.stopped_at_line if isinstance(board, PulseSink) else None
        self._over("" if report.stopped_at_line is None else "stopped", report.end_position, exact)
        board_time = second.board_time or board_time
        if board_time is not None and abilities.lines and report.stopped_at_line is None:
            report.duration_s = board_time.seconds
        if board is None:
            self._hint(step_rate(report))
        if report.ok and report.stopped_at_line is None:
            self._files.close()
            if board is not None and reading.state is not None:
                reading.memory.keep(*reading.state)

    def _attended(self, board: PulseSink | LineSink | None) -> bool:
        """Whether a pause does not end the program: a board that plans for itself waits, and
        somebody has to tell it to go on.
        """
        return self._pauses == "skip" or (
            self._pauses == "wait" and (self._operated or not isinstance(board, LineSink))
        )

    def _begin(self, board: PulseSink | LineSink | None, abilities: Abilities) -> None:
        """The motion begins: the machine comes home, if it is to, and a record is kept from there.
        Raises HomingStopped.
        """
        lookout, reading = self._lookout, self._reading
        if board is None:
            return
        if self._home:
            home(
                board,
                reading.machine,
                (),
                reading.start,
                control=lookout.control,
                on_progress=lookout.tell,
            )
        if self._standing is not None:
            self._standing.begin()
        if (
            self._hash
            and (abilities.moves or isinstance(board, Loopback))
            and not (isinstance(board, LineSink) and board.check_only)
        ):
            first = Checkpoint(
                self.report.program, self._hash, reading.machine.name, abilities.board
            )
            lookout.recorder = Recorder(first, reading.machine.axis_names)

    def _recall(self, abilities: Abilities) -> None:
        """What is known of a run of this program that did not come to its end."""
        reading, report = self._reading, self.report
        if not abilities.real or report.program == STANDARD_INPUT_NAME:
            return
        self._hash = digest(reading.path)
        last = Checkpoint.read(report.program)
        if last is None:
            return
        same, line = last.sha256 == self._hash, self._from_line
        if (
            line is not None
            and same
            and (last.machine, last.board) == (reading.machine.name, abilities.board)
        ):
            self._last_run = last
        if line is not None and not same:
            message = f"the program has changed since the run that came to its line {last.line}: line {line} may be another one now"
            self._lookout.warn(
                Diagnostic(
                    "checkpoint-differs",
                    message,
                    hint="look up in the program where to begin",
                    severity="warning",
                )
            )
        elif line is not None and line > last.line:
            message = f"the last run came to line {last.line}: what lies between it and line {line} is left out"
            hint = f"--from-line {last.line} leaves out nothing"
            self._lookout.warn(
                Diagnostic("checkpoint-before", message, hint=hint, severity="warning")
            )
        elif line is None and same:
            message = f"the last run of this program came to line {last.line} and not to its end"
            hint = f"--from-line {last.line} goes on there; this run begins anew"
            self._lookout.warn(Diagnostic("run-unfinished", message, hint=hint, severity="note"))

    def _over(self, ended: str, position: Mapping[str, float], line: int | None = None) -> None:
        """The run is over; ``ended``: why, if that was not the end of the program."""
        recorder, self._lookout.recorder = self._lookout.recorder, None
        if self._standing is not None:
            self._standing.end(
                ended or "end", None if recorder is None else recorder.latest.position
            )
        if recorder is None:
            return
        if ended:
            self.report.resume_line = (
                recorder.end(ended, line, position, self._place_to_begin) or None
            )
        else:
            recorder.done()

    def _place_to_begin(self, line: int) -> int:
        """Where a run that came to this line is gone on with."""
        try:
            return self._reading.place_to_begin(line)
        except (CncError, Stopped):
            return line

    def _resumable(self, error: BoardError) -> BoardError:
        """The same, with how to go on behind it."""
        found, line = error.diagnostic, self.report.resume_line
        if line is None:
            return error
        hint = (
            f"{found.hint}; then go on with --from-line {line}"
            if found.hint
            else f"go on with --from-line {line}"
        )
        return type(error)(replace(found, hint=hint))

    def _confirm_beginning(self) -> None:
        """Tell how the machine will get to the line to begin at, and ask."""
        beginning, ask = self._reading.beginning, self._lookout.watch.on_beginning
        if beginning is not None and ask is not None and not ask(beginning.story):
            raise Stopped

    def _translate(
        self, board: PulseSink | LineSink | None, abilities: Abilities
    ) -> BoardTime | None:
        """The program as lines for any board, where they are asked for: how long a board takes for
        them, if it takes lines.
        """
        if self._outputs.lines is None and (board is not None or not abilities.lines):
            return None
        reading = self._reading
        target = (
            None
            if self._outputs.lines is None
            else self._files.opened(TextTarget(self._outputs.lines))
        )
        program = LineProgram(
            reading.machine,
            reading.start,
            reading.memory.parameters(macro=False).values,
            self.report.bounding_box,
        )
        return program.write(reading.blocks(), None if target is None else target.write)

    def _hint(self, findings: Iterable[Diagnostic]) -> None:
        """Tell findings that were made without the source line at hand."""
        for found in with_texts(
            [GcodeError(finding) for finding in findings], {self.report.program: self._reading.path}
        ):
            self._lookout.warn(found.diagnostic)
