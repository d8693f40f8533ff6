"""Records of a run on a machine: its checkpoint, and the position check of a GRBL board."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from cnc.boards.protocols import LineSink, PulseSink
from cnc.model.diagnostics import BoardError, CncError, Diagnostic
from cnc.session.board_offsets import named_offsets, offsets_in
from cnc.session.checkpoint import Checkpoint, CheckpointWriter, file_hash
from cnc.session.context import SessionContext
from cnc.session.kept_offsets import write_offsets
from cnc.session.observer import StoppedBeforeMotion
from cnc.session.required_capabilities import CapabilityCheck
from cnc.session.source import WITHOUT_FILE

if TYPE_CHECKING:
    from cnc.session.position_check import PositionCheck


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
        context, known = self._context, self._capabilities
        reader, report, line = context.reader, context.report, context.options.from_line
        if not known.real or report.program in WITHOUT_FILE:
            return
        self._hash = file_hash(reader.path)
        last, warnings = Checkpoint.read(report.program)
        for damaged in warnings:
            context.observer.warn(damaged)
        if last is None:
            return
        unchanged = last.sha256 == self._hash
        same_machine = (last.machine, last.board) == (reader.machine.name, known.board)
        if line is not None and unchanged and same_machine:
            self._last_run = last
        if unchanged and last.line and not last.ended:
            # A run that was killed has written the line itself, which may lie in a subprogram.
            last = last.model_copy(update={"line": self._line_to_continue_at(last.line)})
        warning = _checkpoint_warning(last, line, unchanged=unchanged)
        if warning is not None:
            context.observer.warn(warning)

    def check_position(self, board: LineSink) -> None:
        """Check the position that a GRBL board reports.

        Raises:
            BoardError: ``position-lost`` if the machine is not where the last run ended.
        """
        reader, options = self._context.reader, self._context.options
        from cnc.session.position_check import PositionCheck

        self._position_check = PositionCheck(
            board, reader.machine, self._last_run, trusted=options.trust_position
        )
        # Lines that --from-line skips do not home the machine.
        self._position_check.check(() if options.from_line is not None else reader.blocks())

    def begin(self, board: PulseSink | LineSink) -> None:
        """Begin the records of this run; the machine is about to move."""
        context, known = self._context, self._capabilities
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
                board=known.board,
                # The lines before were done by an earlier run.
                line=context.options.from_line or 0,
            )
            context.observer.checkpoint = CheckpointWriter(first, machine.of_joints.axis_names)

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
        found, line = error.diagnostic, self._context.report.resume_line
        if line is None:
            return error
        hint = f"continue with --from-line {line}"
        return type(error)(
            replace(found, hint=f"{found.hint}; then {hint}" if found.hint else hint)
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
