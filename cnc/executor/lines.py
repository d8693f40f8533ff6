"""Execution of a path on a line board, as lines that are sent as fast as the board accepts them.

    path ──► translator ──► steps (lines, then a block at which the board rests) ──► board

Steps can be made during the run, where the board's answers decide how the program continues, or
before any motion: a list of them is small.

The board itself carries out the requests of the operator
(:meth:`cnc.boards.protocols.LineSink.connect_operator`), so the lines do not contain them. Hold,
resume and override act on the current motion.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cnc.boards.errors import board_error
from cnc.boards.protocols import LineSink
from cnc.executor.run import Progress
from cnc.model.blocks import Abort, Block, BoardCommand, End, Probe, Stop, Tool
from cnc.model.diagnostics import BoardError
from cnc.model.operator_control import Control
from cnc.model.packed_lines import PackedLines
from cnc.model.streams import GcodeLine
from cnc.path.chunk import PathChunk

POSITION_ROUNDING = 0.003
"""Rounding error of a reported position, beside one step, mm: three decimals, even in inches."""

END = End("", 0)


class LineTranslator(Protocol):
    """A translator of paths, such as :class:`cnc.grbl_lines.translator.Translator`."""

    @property
    def position(self) -> Mapping[str, float] | None:
        """End point of the lines so far by axis, mm (machine coordinates); None if not known."""

    def lines(self, item: PathChunk | Block) -> Iterator[GcodeLine]:
        """Yield lines for the next item of the path, as far as they are final."""

    def end(self) -> Iterator[GcodeLine]:
        """Yield the remaining lines."""


@dataclass(frozen=True, slots=True)
class Step:
    """The lines of one item of a path.

    Attributes:
        file: The program.
        lines: Lines for the board.
        block: Block after the lines at which the board rests, or None.
        position: End point of the lines so far for each axis of the machine, mm; None if not known.
    """

    file: str
    lines: PackedLines
    block: Block | None
    position: Mapping[str, float] | None


def steps(
    path: Iterable[PathChunk | Block],
    translator: LineTranslator,
    on_lines: Callable[[PackedLines], None] | None = None,
) -> Iterator[Step]:
    """Yield the steps of a path, each as soon as its lines are final.

    The answer of a probe must be set before the next step is requested.

    Args:
        path: Chunks of the path, and the blocks between them.
        translator: Makes lines of them.
        on_lines: Called with the lines of each step.
    """
    file = ""

    def step(lines: Sequence[GcodeLine], block: Block | None) -> Step:
        packed = PackedLines.of(lines)
        if on_lines is not None:
            on_lines(packed)
        return Step(file, packed, block, translator.position)

    for item in path:
        file = item.file
        lines = list(translator.lines(item))
        if isinstance(item, BoardCommand):
            # A locked board accepts only $H and $X, so they precede the modes of the first line.
            lines.sort(key=lambda line: not line.text.startswith("$"))
        block = item if isinstance(item, Abort | BoardCommand | Probe | Stop | Tool) else None
        if lines or block is not None:
            yield step(lines, block)
    yield step(list(translator.end()), None)


@dataclass(frozen=True, slots=True)
class LineOutcome:
    """Result of a run on a line board.

    Attributes:
        position: Position of each axis that the board reports, mm.
        lines: Number of lines sent.
        stopped_at_line: None after a complete run. After a stop, the source line of the last
            motion, else the last line that the board has accepted.
        began: Time of the first line with an effect other than modes, by the clock of the board, s;
            None without one.
        ended: Time of the first report that showed the machine at rest behind the lines of the
            program, by that clock, s.
    """

    position: tuple[float, ...]
    lines: int
    stopped_at_line: int | None = None
    began: float | None = None
    ended: float = 0.0


class _Stream:
    """State of a run, and the sending of its steps."""

    def __init__(
        self,
        board: LineSink,
        control: Control,
        on_progress: Callable[[Progress], None] | None,
        pause_text: Callable[[Block], str] | None,
    ) -> None:
        self.board = board
        self.control = control
        self.on_progress = on_progress
        self.pause_text = pause_text
        self.pause: Block | None = None
        self.text: tuple[Block | None, str] = (None, "")
        self.ended: float | None = None
        self.file = ""
        self.wanted: Mapping[str, float] | None = None

    def report(self) -> None:
        """Pass on a report of the board."""
        if self.on_progress is not None:
            board = self.board
            line, reason = board.confirmed_line, board.hold_reason
            if self.pause is not None and self.control.held and not self.differing():
                # The board has not answered M0 yet.
                line, reason = self.pause.line, reason or self.text_of(self.pause)
            now = Progress(
                0.0,
                line,
                board.lines_sent.number,
                self.control.held,
                board.position,
                board.buffered,
                hold_reason=reason,
                file=self.file,
                at=board.moving_line,
                at_rest=self.control.held and board.holds,
                machine=board.report,
            )
            self.on_progress(now)

    def text_of(self, pause: Block) -> str:
        """Return what a pause asks of the operator."""
        if self.text[0] is not pause:
            self.text = pause, "" if self.pause_text is None else self.pause_text(pause)
        return self.text[1]

    def step(self, step: Step) -> None:
        """Send a step, and carry out its block."""
        self.file, block = step.file, step.block
        self.send(step.lines)
        self.wanted = step.position
        if block is None or self.control.stopped:
            return
        # The board continues after a pause only when the operator resumes.
        self.pause = block if isinstance(block, Stop | Tool) else None
        answer = self.board.execute(block, 0)
        self.pause = None
        if isinstance(block, Probe):
            block.answer.values = answer
        elif isinstance(block, BoardCommand) and block.homes:
            block.answer.values = self.board.position
        elif isinstance(block, BoardCommand):
            self.compare()

    def send(self, lines: PackedLines) -> None:
        """Send lines until the operator stops the run."""
        if not self.control.stopped:
            self.board.send_lines(lines)

    def compare(self) -> None:
        """Compare the position of the board, which is at rest, with that of the lines.

        Raises:
            BoardError: ``position-differs``.
        """
        if self.control.stopped or self.board.check_only:
            return
        for letter, planned, reported in self.differing():
            message = (
                f"the board is at {letter}{reported:.3f}, "
                f"but the program ends at {letter}{planned:.3f}"
            )
            hint = (
                "bytes were lost, or the board lost its position: "
                "check the part, and home the machine"
            )
            raise board_error(
                "position-differs", message, line=self.board.confirmed_line, hint=hint
            )

    def differing(self) -> list[tuple[str, float, float]]:
        """Return letter, planned and reported position of the axes that are not where they end."""
        return [
            (letter.upper(), planned, reported)
            for (letter, planned), reported, step in zip(
                (self.wanted or {}).items(),
                self.board.position,
                self.board.resolution,
                strict=False,
            )
            if abs(planned - reported) > step + POSITION_ROUNDING
        ]

    def outcome(self, *, stopped: bool) -> LineOutcome:
        board = self.board
        line = board.moving_line or board.confirmed_line
        number, began, rested_at = board.lines_sent
        ended = rested_at if self.ended is None else self.ended
        return LineOutcome(board.position, number, line if stopped else None, began, ended)


def stream(
    program: Iterable[Step],
    board: LineSink,
    *,
    control: Control | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    afterwards: Callable[[], Iterable[GcodeLine]] | None = None,
    pause_text: Callable[[Block], str] | None = None,
) -> LineOutcome:
    """Run a program on a line board.

    After a stop request, the board comes to rest, discards its lines, and is left stopped. After
    any exception, the board is aborted.

    Args:
        program: Steps of the program.
        board: The board.
        control: Requests of the operator.
        on_progress: Called after each report of the board.
        afterwards: Gives lines to send after the program, when the position has been checked.
        pause_text: Gives the text for the operator at a pause of the program.

    Returns:
        The result of the run.

    Raises:
        BoardError: The board or its connection failed, or ``position-differs``. The source line is
            that of the fault, else the last one that the board has accepted.
    """
    control = control or Control()
    run = _Stream(board, control, on_progress, pause_text)
    try:
        board.connect_operator(control, run.report)
        board.start(np.zeros(board.capabilities.axes, np.int64))
        for step in program:
            run.step(step)
            if control.stopped:
                break
        if not control.stopped:
            board.execute(END, 0)
            run.ended = board.lines_sent.rested_at
            run.compare()
            if afterwards is not None and not board.check_only:
                run.send(PackedLines.of(list(afterwards())))
            board.finish()
            run.report()
        # A stop request may have come during the last motion.
        if control.stopped:
            board.stop()
        return run.outcome(stopped=control.stopped)
    except BoardError as error:
        _abort(board)
        found = error.diagnostic
        raise error.at(
            file=found.file or run.file, line=found.line or board.confirmed_line
        ) from error
    except BaseException:
        _abort(board)
        raise


def _abort(board: LineSink) -> None:
    """Abort the board and ignore its faults, because the original fault matters more."""
    with contextlib.suppress(BoardError):
        board.abort()
