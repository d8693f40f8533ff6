"""A plan on a board: chunks become pulses, blocks between them become commands, in the program's
order.

The executor works ahead of time. It never waits for a pulse: the board plays what it has been sent
and holds the caller back when it is full.

The operator's :class:`~cnc.model.operator_control.Control` is looked at between two stretches of
the plan. A hold takes no machine time: the clock goes on with the motion.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cnc.boards.protocols import HasButtons, PlaysAhead, ProbesByMotion, PulseSink
from cnc.model.blocks import Abort, Block, End, Held, Probe, WaitInput
from cnc.model.diagnostics import BoardError, CncError, Diagnostic
from cnc.model.operator_control import Control
from cnc.model.streams import PulseChunk
from cnc.planner.plan import PlanChunk
from cnc.planner.run_clock import RunClock

REST = 1e-9
"""Speed in mm/s below which a chunk's end is at rest."""

ARRIVED = 1e-9
"""mm; what rounding may leave of a path that has been gone to its end."""


class PulseInterpolator(Protocol):
    """What turns a plan into pulses, such as :class:`cnc.pulses.reference_pulse.ReferencePulse`."""

    @property
    def origin_steps(self) -> NDArray[np.int64]:
        """Grid point at which the program begins (axes,)."""

    @property
    def position_steps(self) -> NDArray[np.int64]:
        """Grid point after the pulses made so far (axes,)."""

    def pulses(self, chunk: PlanChunk) -> Iterator[PulseChunk]:
        """The grid moves of a stretch of the plan."""

    def settle(self) -> Iterator[PulseChunk]:
        """The last grid move at the end of the path."""

    def stand_at(self, grid: NDArray[np.int64]) -> None:
        """The machine stands at a grid point (axes,) that was not planned, such as where a probe
        made contact.
        """


@dataclass(frozen=True, slots=True)
class Progress:
    """How far the program has been sent: seconds of machine time, source line, grid moves (or
    lines, to a board that takes those).

    held: the motion rests until it is resumed. position: where the board says it is, mm. buffered:
    lines that it has not taken yet. The last two are None of a board that does not tell. left:
    seconds until the program is over, None where nobody has counted them. why: what the program
    holds for. ahead: seconds of motion that the board has yet; line then is that which it is at, or
    one before. at: a line that the motion has come to for certain, 0 where that is not known. file:
    where that is, as what is sent says.
    """

    time: float
    line: int
    rows: int
    held: bool = False
    position: tuple[float, ...] | None = None
    buffered: int | None = None
    left: float | None = None
    hold_reason: str = ""
    ahead: float | None = None
    file: str = ""
    at: int = 0


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a run.

    duration: seconds of machine time sent, dwells included. position_steps (axes,): where the board
    is. steps (axes,): steps made by each axis, in both directions together. rows: grid moves.
    stopped_at_line: None after a whole run; after a stop the source line of the last motion or
    command sent, 0 if there was none.
    """

    duration: float
    position_steps: NDArray[np.int64]
    steps: NDArray[np.int64]
    rows: int
    stopped_at_line: int | None = None

    @property
    def finished(self) -> bool:
        """Whether the program ran to its end."""
        return self.stopped_at_line is None


class _Run:
    """One run: what has been sent, and how the next thing is sent."""

    def __init__(
        self,
        board: PulseSink,
        interpolator: PulseInterpolator,
        on_pulses: Callable[[PulseChunk], None] | None,
        on_progress: Callable[[Progress], None] | None,
    ) -> None:
        self.board = board
        self.interpolator = interpolator
        self.on_pulses = on_pulses
        self.on_progress = on_progress
        self.clock = RunClock()
        self.line = 0
        self.rows = 0
        self.steps = np.zeros(len(interpolator.origin_steps), dtype=np.int64)
        self.file = ""
        self.playing = board if isinstance(board, PlaysAhead) else None
        self._probing: tuple[Probe, tuple[float, ...] | None] | None = None

    def command(self, block: Block) -> None:
        """A block between moves: the board carries it out when the motion before it has come to
        rest.
        """
        self.probed()
        self.file = block.file
        reply = self.board.execute(block, round(self.clock.seconds * 1e9))
        if isinstance(block, WaitInput):
            block.answer.values = reply
        elif isinstance(block, Probe):
            self._probing = block, reply
        self.clock.add(block)
        self.line = block.line
        self._tell()

    def motion(self, chunk: PlanChunk, control: Control | None = None) -> None:
        """A stretch of the plan, as far as ``control`` lets it."""
        self.file = chunk.path.file
        self.send(self.interpolator.pulses(chunk), control)
        self.clock.add(chunk)

    def hold(self, block: Held, control: Control | None) -> None:
        """Wait until the operator goes on, or stops the run; whoever watches may do either at
        once.
        """
        self.board.execute(block, round(self.clock.seconds * 1e9))
        self._tell(held=True, reason=block.reason)
        if control is not None:
            control.wait()

    def probed(self) -> None:
        """The motion rests: if it was that of a probe, its answer counts now. BoardError
        ``probe-no-contact`` where there had to be one.
        """
        if self._probing is None:
            return
        block, reply = self._probing
        self._probing = None
        found = self.board.probe_result() if isinstance(self.board, ProbesByMotion) else None
        reply = reply if found is None else found
        block.answer.values = reply
        if reply is not None:
            self.interpolator.stand_at(self.board.position_steps)
        if block.must and reply is not None and not reply[0]:
            what = "made no contact" if block.towards else "did not lose contact"
            hint = f"{'G38.3' if block.towards else 'G38.5'} goes on without"
            raise BoardError(
                Diagnostic(
                    "probe-no-contact",
                    f"the probe {what} on its way",
                    block.file,
                    block.line,
                    hint=hint,
                )
            )

    def send(self, chunks: Iterable[PulseChunk], control: Control | None = None) -> None:
        """Pulses, as far as ``control`` lets them."""
        for pulses in chunks:
            if control is not None and control.stopped:
                return
            self.board.send(pulses)
            if self.on_pulses is not None:
                self.on_pulses(pulses)
            self.rows += len(pulses.step)
            self.steps += [np.count_nonzero(column) for column in pulses.step.T]
            if len(pulses.step):
                self.line = int(pulses.line[-1])
                self.clock.seconds = float(pulses.time_ns[-1]) * 1e-9
            self._tell()

    def outcome(self, stopped: bool) -> Outcome:
        return Outcome(
            self.clock.seconds,
            self.board.position_steps,
            self.steps,
            self.rows,
            self.line if stopped else None,
        )

    def _tell(self, *, held: bool = False, reason: str = "") -> None:
        if self.on_progress is None:
            return
        now = Progress(
            self.clock.seconds,
            self.line,
            self.rows,
            held,
            hold_reason=reason,
            file=self.file,
            at=self.line,
        )
        if self.playing is not None:
            where = self.playing.motion_state
            # What the motion is held for has been come to.
            line = self.line if held else where.line
            now = replace(now, line=line, position=where.position, ahead=where.ahead, at=line)
        self.on_progress(now)


def execute(
    plan_stream: Iterable[PlanChunk | Block],
    board: PulseSink,
    interpolator: PulseInterpolator,
    *,
    on_pulses: Callable[[PulseChunk], None] | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    control: Control | None = None,
    ramp_down: Callable[[], Iterable[PlanChunk]] | None = None,
) -> Outcome:
    """Run a plan on a board.

    on_pulses is shown every chunk that the board has taken, on_progress how far things are; either
    may tell ``control`` what to do. When it says stop, no more than the stop needs is sent: without
    ``ramp_down`` nothing at all; with it the rest of the stretch under way, then, unless that ends
    at rest, the motion that ``ramp_down`` gives, which begins where the stretch ends. The board is
    left stopped. For a hold the plan itself comes to rest and says so
    (:class:`~cnc.model.blocks.Held`): all before it has been sent, and the board is told to wait.

    Raises BoardError when the board fails, at the source line that the fault names, else at the
    last one that the board has taken; the board has been told to abort, as after any other
    exception. After the fault of a program (it went another way than in the first pass, by what a
    probe or an input answered) a board that senses has come to rest on the path, if ``ramp_down``
    says how.
    """
    run = _Run(board, interpolator, on_pulses, on_progress)
    at_rest = True
    try:
        if control is not None and isinstance(board, HasButtons):
            board.connect_operator(control)
        board.start(interpolator.origin_steps)
        items = iter(plan_stream)
        while control is None or not control.stopped:
            # What has been handed out is sent: the ramp begins where the last stretch ends.
            item = next(items, None)
            if item is None:
                break
            if isinstance(item, PlanChunk):
                run.motion(item, control if ramp_down is None else None)
                at_rest = float(item.phase_v[-1]) <= REST
                if at_rest and _arrived(item):
                    run.probed()
            elif isinstance(item, Held):
                run.hold(item, control)
            elif isinstance(item, Abort):
                # The fault comes when the next item is asked for. The board is idle by then.
                run.probed()
                run.send(interpolator.settle())
                board.finish()
            else:
                if isinstance(item, End):
                    run.send(interpolator.settle())
                run.command(item)
        if control is not None and control.stopped:
            if ramp_down is not None and not at_rest:
                for chunk in ramp_down():
                    run.motion(chunk)
            board.stop()
            return run.outcome(stopped=True)
        run.send(interpolator.settle())
        board.finish()
        return run.outcome(stopped=False)
    except BoardError as error:
        _abort(board)
        found = error.diagnostic
        raise error.at(
            file=found.file or run.file, line=found.line or board.confirmed_line
        ) from error
    except CncError:
        # The program turned out to be faulty: what moves comes to rest on the path. What only
        # records motion forgets it.
        if (
            ramp_down is not None
            and not at_rest
            and (board.capabilities.senses or board.capabilities.probes)
        ):
            with contextlib.suppress(BoardError):
                for chunk in ramp_down():
                    run.motion(chunk)
                board.stop()
        else:
            _abort(board)
        raise
    except BaseException:
        _abort(board)
        raise


def _arrived(chunk: PlanChunk) -> bool:
    """Whether the motion has come to where the path itself stops: a hold may rest anywhere."""
    return (
        bool(chunk.path.stop_after[-1]) and float(chunk.piece_s[-1] - chunk.phase_s[-1]) <= ARRIVED
    )


def _abort(board: PulseSink) -> None:
    """Stop the board; what it says to that matters less than the fault that led here."""
    with contextlib.suppress(BoardError):
        board.abort()
