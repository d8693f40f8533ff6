"""Execution of a plan on a pulse board: chunks become pulses, blocks become commands, in order.

The executor works ahead of time and never waits for a pulse. The board blocks the caller while its
buffer is full.

Requests of the operator (:class:`~cnc.model.operator_control.Control`) are read between two chunks
of the plan. A hold takes no machine time: the clock continues with the motion.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cnc.boards.protocols import LineSink, MachineReport, PulseSink
from cnc.model.blocks import Abort, Block, End, Held, Probe, Spindle, WaitInput
from cnc.model.diagnostics import BoardError, CncError, Diagnostic
from cnc.model.motion_commands import places_of
from cnc.model.operator_control import Control
from cnc.model.streams import PulseChunk
from cnc.planner.plan import PlanChunk, RunClock

# Commands that go with the motion: the time of each, and their place among the pulses.

SAME_PLACE = 1e-9
"""mm. A slice of a plan that begins this near to a piece begins at the piece."""


class CommandsInMotion:
    """Puts commands between the pulses of a plan, in order of time.

    Args:
        carry_out: Carries out a command at a time since the start of the program, ns.
    """

    def __init__(self, carry_out: Callable[[Block, int], object]) -> None:
        self._carry_out = carry_out
        self._due: deque[tuple[int, tuple[Block, ...]]] = deque()
        self._last: tuple[Block, ...] | None = None

    def add(self, chunk: PlanChunk) -> None:
        """Add the commands of a chunk of the plan, each once.

        A piece may extend over several chunks.
        """
        places = places_of(chunk.path.commands)
        if not places:
            return
        assert chunk.path.commands is not None
        starts = chunk.piece_s[places]
        last = float(chunk.phase_s[-1]) - SAME_PLACE
        times = chunk.times_at(starts)
        for place, start, time in zip(places, starts.tolist(), times.tolist(), strict=True):
            blocks = chunk.path.commands[place]
            if start < last and blocks is not self._last:
                self._last = blocks
                self._due.append((round((chunk.t0 + time) * 1e9), blocks))

    def among(self, chunks: Iterable[PulseChunk]) -> Iterator[PulseChunk]:
        """Yield the pulses, and carry out each command before the first pulse that follows it."""
        due = self._due
        for chunk in chunks:
            first, count = 0, len(chunk.time_ns)
            while due and count and due[0][0] <= chunk.time_ns[-1]:
                at = int(np.searchsorted(chunk.time_ns, due[0][0]))
                if at > first:
                    yield _part(chunk, slice(first, at))
                self._carry_out_first()
                first = at
            if first < count:
                yield _part(chunk, slice(first, count)) if first else chunk

    def finish(self) -> None:
        """Carry out the commands behind the last pulse."""
        while self._due:
            self._carry_out_first()

    def _carry_out_first(self) -> None:
        time_ns, blocks = self._due.popleft()
        for block in blocks:
            self._carry_out(block, time_ns)


def _part(chunk: PulseChunk, rows: slice) -> PulseChunk:
    return PulseChunk(chunk.time_ns[rows], chunk.step[rows], chunk.line[rows])


REST = 1e-9
"""Speed below which the end of a chunk is at rest, mm/s."""

REPORT_PERIOD = 0.05
"""Time between two reports while a board comes to rest in a hold, s."""

ARRIVED = 1e-9
"""Distance from the end of a path that rounding may leave, mm."""


class PulseInterpolator(Protocol):
    """An interpolator, such as :class:`cnc.pulses.reference_pulse.ReferencePulse`."""

    @property
    def origin_steps(self) -> NDArray[np.int64]:
        """Grid point of the start of the program (axes,)."""

    @property
    def position_steps(self) -> NDArray[np.int64]:
        """Grid point after the pulses so far (axes,)."""

    def pulses(self, chunk: PlanChunk) -> Iterator[PulseChunk]:
        """Yield the grid moves of a chunk of the plan."""

    def settle(self) -> Iterator[PulseChunk]:
        """Yield the last grid move at the end of the path."""

    def stand_at(self, grid: NDArray[np.int64]) -> None:
        """Continue from a grid point (axes,) that was not planned, such as that of a contact."""

    @property
    def steps_made(self) -> NDArray[np.int64]:
        """Number of steps of each axis (axes,) in all pulses so far."""


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of a run.

    Attributes:
        time: Machine time sent, s.
        line: Source line of the last motion sent. If ``ahead`` is known: line of the motion that
            the board plays, or an earlier one.
        rows: Grid moves sent; lines on a line board.
        held: Whether motion is held until it is resumed.
        position: Position of each axis that the board reports, mm; None without reports.
        buffered: Lines that the board has not carried out yet; None without reports.
        left: Time until the end of the program, s; None if it is not known.
        hold_reason: Reason for which the program holds.
        ahead: Motion that the board has not played yet, s.
        file: Program of the last motion sent.
        at: Line that the motion has reached with certainty, 0 if none is known.
        at_rest: Whether a hold has come to rest.
        axes: Letters of the machine's axes, in the order of the positions.
        machine: The last report of a board that plans its own motion.
        text: Text of the line.
        feed: Programmed feed of the line, mm/min; None for a traverse, or if it is not known.
        tool: Number of the tool; None before the first tool change.
        pending: Time until the requested feed override takes effect at the latest, s; 0 if it has.
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
    at_rest: bool = False
    axes: tuple[str, ...] = ()
    machine: MachineReport | None = None
    text: str = ""
    feed: float | None = None
    tool: int | None = None
    pending: float = 0.0

    def of_tip(self, tips: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Progress:
        """Return the progress with the position of the axes, from that of the joints."""
        if self.position is None:
            return self
        tip = tips(np.array([self.position]))[0]
        return replace(self, position=tuple(tip.tolist()))


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a run on a pulse board.

    Attributes:
        duration: Machine time sent, dwells included, s.
        position_steps: Grid point of the board (axes,).
        steps: Number of steps of each axis in both directions together (axes,).
        rows: Number of grid moves.
        stopped_at_line: None after a complete run. After a stop, the source line of the last motion
            or command sent, 0 if there was none.
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
    """State of a run, and the sending of the items of its plan."""

    def __init__(
        self,
        board: PulseSink,
        interpolator: PulseInterpolator,
        on_pulses: Callable[[PulseChunk], None] | None,
        on_progress: Callable[[Progress], None] | None,
        *,
        laser: bool,
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
        self.laser = laser
        self.beam: Spindle | None = None
        self.at_rest = True
        self._commands = CommandsInMotion(self.carry_out)
        self._probing: tuple[Probe, tuple[float, ...] | None] | None = None

    def carry_out(self, block: Block, time_ns: int) -> tuple[float, ...] | None:
        """Let the board carry out a block at a time of the program, ns."""
        if self.laser and isinstance(block, Spindle):
            self.beam = block
        return self.board.execute(block, time_ns)

    def command(self, block: Block) -> None:
        """Send a block, which the board carries out after the motion before it."""
        self.settle_probe()
        self._commands.finish()
        self.file = block.file
        reply = self.carry_out(block, round(self.clock.seconds * 1e9))
        if isinstance(block, WaitInput):
            block.answer.values = reply
        elif isinstance(block, Probe):
            self._probing = block, reply
        self.clock.add(block)
        self.line = block.line
        self._report()

    def motion(self, chunk: PlanChunk, control: Control | None = None) -> None:
        """Send a chunk of the plan until ``control`` stops the run."""
        self.file = chunk.path.file
        self._commands.add(chunk)
        self.send(self.interpolator.pulses(chunk), control)
        self.clock.add(chunk)

    def hold(self, block: Held, control: Control | None) -> None:
        """Wait until the operator resumes or stops the run; ``on_progress`` may do so at once.

        The beam of a laser is off meanwhile.
        """
        self._commands.finish()
        now_ns = round(self.clock.seconds * 1e9)
        beam = self.beam if self.beam is not None and self.beam.state != "off" else None
        if beam is not None:
            self.board.execute(replace(beam, state="off", rpm=0.0), now_ns)
        self.board.execute(block, now_ns)
        self._report(held=True, reason=block.reason)
        while (state := self.board.motion_state) is not None and state.ahead > 0.0:
            # The board still plays the motion before the hold.
            if control is None or not control.wait(REPORT_PERIOD):
                break
            self._report(held=True, reason=block.reason)
        if control is not None:
            control.wait()
        if beam is not None and not (control is not None and control.stopped):
            self.board.execute(beam, now_ns)

    def settle_probe(self) -> None:
        """Store the answer of a probe whose motion has ended.

        Raises:
            BoardError: ``probe-no-contact``, where a contact (or its loss) is required.
        """
        if self._probing is None:
            return
        block, reply = self._probing
        self._probing = None
        contact = self.board.probe_result()
        reply = reply if contact is None else contact
        block.answer.values = reply
        block.answer.of_joints = contact is not None
        if reply is not None:
            self.interpolator.stand_at(self.board.position_steps)
        if block.must and reply is not None and not reply[0]:
            what = "made no contact" if block.towards else "did not lose contact"
            hint = f"{'G38.3' if block.towards else 'G38.5'} continues without it"
            raise BoardError(
                Diagnostic(
                    "probe-no-contact",
                    f"the probe {what} during its move",
                    block.file,
                    block.line,
                    hint=hint,
                )
            )

    def send(self, chunks: Iterable[PulseChunk], control: Control | None = None) -> None:
        """Send pulses until ``control`` stops the run."""
        for pulses in self._commands.among(chunks):
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
            self._report()

    def settle(self) -> None:
        """Send the last pulses and commands of the path."""
        self.send(self.interpolator.settle())
        self._commands.finish()

    def outcome(self, *, stopped: bool) -> Outcome:
        return Outcome(
            self.clock.seconds,
            self.board.position_steps,
            self.steps,
            self.rows,
            self.line if stopped else None,
        )

    def _report(self, *, held: bool = False, reason: str = "") -> None:
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
            at_rest=held,
        )
        if (state := self.board.motion_state) is not None:
            # Under a hold, the motion has reached the last line sent.
            line = self.line if held else state.line
            now = replace(now, line=line, position=state.position, ahead=state.ahead, at=line)
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
    laser: bool = False,
) -> Outcome:
    """Run a plan on a pulse board.

    After a stop request, only the motion needed for the stop is sent, and the board is left
    stopped. Without ``ramp_down``, no motion is sent. With it, the rest of the current chunk
    follows. If that does not end at rest, the motion that ``ramp_down`` gives follows too. For a
    hold, the plan itself comes to rest and contains :class:`~cnc.model.blocks.Held`.

    A fault of the program can appear during the run: an answer of a probe or an input may lead to
    another path than in the check pass. Then a board with sensors comes to rest on the path, if
    ``ramp_down`` is given. After any other exception the board is aborted.

    Args:
        plan_stream: Chunks of the plan, and the blocks between them.
        board: The board.
        interpolator: Makes pulses of the plan.
        on_pulses: Called with each chunk of pulses that the board has accepted.
        on_progress: Called with the progress; may make requests to ``control``.
        control: Requests of the operator.
        ramp_down: Gives the motion to rest from the end of the last chunk.
        laser: The spindle is the beam of a laser, which is off during a hold.

    Returns:
        The result of the run.

    Raises:
        BoardError: The board failed. The source line is that of the fault, else that of the last
            motion that the board has accepted.
    """
    run = _Run(board, interpolator, on_pulses, on_progress, laser=laser)
    try:
        if control is not None:
            board.connect_operator(control)
        board.start(interpolator.origin_steps)
        return _run_program(run, plan_stream, control, ramp_down)
    except BoardError as error:
        abort(board)
        finding = error.diagnostic
        raise error.at(
            file=finding.file or run.file, line=finding.line or board.confirmed_line
        ) from error
    except CncError:
        # A fault of the program: a machine comes to rest on the path, a recording is discarded.
        moves = board.capabilities.senses or board.capabilities.probes
        if ramp_down is not None and not run.at_rest and moves:
            with contextlib.suppress(BoardError):
                for chunk in ramp_down():
                    run.motion(chunk)
                board.stop()
        else:
            abort(board)
        raise
    except BaseException:
        abort(board)
        raise


def _run_program(
    run: _Run,
    plan_stream: Iterable[PlanChunk | Block],
    control: Control | None,
    ramp_down: Callable[[], Iterable[PlanChunk]] | None,
) -> Outcome:
    """Send the items of a plan to a started board, and end the run."""
    board, items = run.board, iter(plan_stream)
    while control is None or not control.stopped:
        # An item that the planner has given is sent: the ramp begins at the end of its last chunk.
        item = next(items, None)
        if item is None:
            break
        if isinstance(item, PlanChunk):
            run.motion(item, control if ramp_down is None else None)
            run.at_rest = float(item.phase_v[-1]) <= REST
            if run.at_rest and _arrived(item):
                run.settle_probe()
        elif isinstance(item, Held):
            run.hold(item, control)
        elif isinstance(item, Abort):
            # The next item raises the fault; by then the board must be idle.
            run.settle_probe()
            run.settle()
            board.finish()
        else:
            if isinstance(item, End):
                run.settle()
            run.command(item)
    if control is not None and control.stopped:
        if ramp_down is not None and not run.at_rest:
            for chunk in ramp_down():
                run.motion(chunk)
        if ramp_down is not None:
            run.settle()
        board.stop()
        return run.outcome(stopped=True)
    run.settle()
    board.finish()
    return run.outcome(stopped=False)


def _arrived(chunk: PlanChunk) -> bool:
    """Return whether a chunk ends at a stop of the path itself; a hold may rest anywhere."""
    return (
        bool(chunk.path.stop_after[-1]) and float(chunk.piece_s[-1] - chunk.phase_s[-1]) <= ARRIVED
    )


def abort(board: PulseSink | LineSink) -> None:
    """Abort the board and ignore its faults, because the original fault matters more."""
    with contextlib.suppress(BoardError):
        board.abort()
