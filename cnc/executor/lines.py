"""A program on a board that plans for itself: what the plan says becomes lines, sent as fast as the
board takes them.

    plan ──► translator ──► steps: lines, and at what block the board has to come to rest ──► sent, one after the other

Steps may be made on the way, where the board's answers decide how the program goes on, or before
anything moves: a list of them is small.

The board carries out the operator's wishes itself (:meth:`cnc.boards.protocols.LineSink.connect_operator`),
so the plan is made without them: hold, resume and override act on the motion under way, not on what
is still to come.
"""

from __future__ import annotations

import contextlib
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cnc.boards.protocols import LineSink, board_error
from cnc.executor.run import Progress
from cnc.model.blocks import Abort, Block, BoardCommand, End, Probe, Stop, Tool
from cnc.model.diagnostics import BoardError
from cnc.model.operator_control import Control
from cnc.model.streams import GcodeLine
from cnc.planner.plan import PlanChunk
from cnc.planner.run_clock import RunClock

ROUNDING = 0.003
"""mm by which a board's report of its position may differ from where it was sent, beside one step:
three decimals, of inches even.
"""


END = End("", 0)


class LineTranslator(Protocol):
    """What turns a plan into lines, such as :class:`cnc.grbl_lines.translator.Translator`."""

    @property
    def position(self) -> Sequence[float] | None:
        """Where the lines so far lead to, x y z in mm (machine coordinates); None where that is not
        known.
        """

    def lines(self, item: PlanChunk | Block) -> Iterator[GcodeLine]:
        """The lines for the next item of the plan, as far as they are certain."""

    def end(self) -> Iterator[GcodeLine]:
        """What is left."""


@dataclass(frozen=True, slots=True)
class Step:
    """What one thing of a plan has become.

    file: the program. text: lines, each with its end. numbers: source line of each. clock: seconds
    planned until its end. block: at which the board comes to rest behind the lines, None if at
    none. position: where the lines so far lead to, x y z in mm; None where that is not known.
    """

    file: str
    text: str
    numbers: Sequence[int]
    clock: float
    block: Block | None
    position: tuple[float, ...] | None

    def lines(self) -> Iterator[GcodeLine]:
        """The lines."""
        for text, number in zip(self.text.split("\n"), self.numbers, strict=False):
            yield GcodeLine(text, number)


def steps(planned: Iterable[PlanChunk | Block], translator: LineTranslator) -> Iterator[Step]:
    """The steps of a plan, each as soon as its lines are certain; a probe's answer is looked at
    when the next is asked for.
    """
    clock, file = RunClock(), ""
    for item in planned:
        file = item.path.file if isinstance(item, PlanChunk) else item.file
        lines = list(translator.lines(item))
        clock.add(item)
        if isinstance(item, BoardCommand):
            # A locked board takes nothing but $H and $X: they go before the modes of the first
            # line.
            lines.sort(key=lambda line: not line.text.startswith("$"))
        block = item if isinstance(item, Abort | BoardCommand | Probe | Stop | Tool) else None
        if lines or block is not None:
            yield _step(file, lines, clock.seconds, block, translator.position)
    yield _step(file, list(translator.end()), clock.seconds, None, translator.position)


def _step(
    file: str,
    lines: Sequence[GcodeLine],
    clock: float,
    block: Block | None,
    position: Sequence[float] | None,
) -> Step:
    text = "".join(line.text + "\n" for line in lines)
    return Step(
        file,
        text,
        array("i", [line.line for line in lines]),
        clock,
        block,
        None if position is None else tuple(position),
    )


@dataclass(frozen=True, slots=True)
class LineOutcome:
    """What came of a run.

    duration: seconds of machine time that were planned for what was sent. position (axes,): where
    the board says it is, mm. lines: that were sent. stopped_at_line: None after a whole run, else
    the last source line that the board has taken.
    """

    duration: float
    position: tuple[float, ...]
    lines: int
    stopped_at_line: int | None = None


class _Stream:
    """One run."""

    def __init__(
        self,
        board: LineSink,
        control: Control,
        on_progress: Callable[[Progress], None] | None,
        on_line: Callable[[GcodeLine], None] | None,
    ) -> None:
        self.board = board
        self.control = control
        self.on_progress = on_progress
        self.on_line = on_line
        self.clock = 0.0
        self.sent = 0
        self.file = ""
        self.wanted: tuple[float, ...] | None = None

    def tell(self) -> None:
        """The board has reported."""
        if self.on_progress is not None:
            board = self.board
            line = board.confirmed_line
            now = Progress(
                self.clock,
                line,
                self.sent,
                self.control.held,
                board.position,
                board.buffered,
                file=self.file,
                at=board.moving_line,
            )
            self.on_progress(now)

    def step(self, step: Step) -> None:
        """One thing of the plan."""
        self.file, block = step.file, step.block
        self.send(step.lines())
        self.clock, self.wanted = step.clock, step.position
        if block is None or self.control.stopped:
            return
        # Nothing goes on behind a pause before the operator has said so.
        answer = self.board.execute(block, round(self.clock * 1e9))
        if isinstance(block, Probe):
            block.answer.values = answer
        elif isinstance(block, BoardCommand):
            self.compare()

    def send(self, lines: Iterable[GcodeLine]) -> None:
        """Lines, until the operator stops."""
        for line in lines:
            if self.control.stopped:
                return
            self.board.send_line(line)
            self.sent += 1
            if self.on_line is not None:
                self.on_line(line)

    def compare(self) -> None:
        """The board stands still: where the lines led it? BoardError ``position-differs``."""
        wanted, board = self.wanted, self.board
        if wanted is None or self.control.stopped or board.check_only:
            return
        for letter, planned, reported, step in zip(
            "XYZ", wanted, board.position, board.resolution, strict=False
        ):
            if abs(planned - reported) > step + ROUNDING:
                message = f"the board stands at {letter}{reported:.3f}, the program has led it to {letter}{planned:.3f}"
                hint = "bytes were lost on the way, or the board has lost its position: check the part, home the machine"
                raise board_error(
                    "position-differs", message, line=self.board.confirmed_line, hint=hint
                )

    def outcome(self, *, stopped: bool) -> LineOutcome:
        board = self.board
        return LineOutcome(
            self.clock, board.position, self.sent, board.confirmed_line if stopped else None
        )


def stream(
    program: Iterable[Step],
    board: LineSink,
    *,
    control: Control | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    on_line: Callable[[GcodeLine], None] | None = None,
    afterwards: Callable[[], Iterable[GcodeLine]] | None = None,
) -> LineOutcome:
    """Run a program on a board that takes lines.

    on_progress is told whenever the board has reported, on_line of every line sent. ``afterwards``:
    lines to send when the program has come to its end and the machine stands where it should. When
    ``control`` says stop, the board comes to rest and forgets what it was sent; it is left stopped.

    Raises BoardError when the board or the link fails, at the source line that the fault names,
    else at the last one that the board has taken, and ``position-differs`` where the board ends
    elsewhere than the program. The board has been told to abort, as after any other exception.
    """
    control = control or Control()
    run = _Stream(board, control, on_progress, on_line)
    try:
        board.connect_operator(control, run.tell)
        board.start(np.zeros(board.capabilities.axes, np.int64))
        for step in program:
            run.step(step)
            if control.stopped:
                break
        if not control.stopped:
            board.execute(END, 0)
            run.compare()
            run.send(() if afterwards is None or board.check_only else afterwards())
            board.finish()
            run.tell()
        # The operator may have stopped the last of the motion.
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
    """Stop the board; what it says to that matters less than the fault that led here."""
    with contextlib.suppress(BoardError):
        board.abort()
