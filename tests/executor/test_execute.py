"""The executor: order, times of commands, stops and faults, on boards that record their calls."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cnc.boards.loopback import Loopback
from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import Block, Dwell, End, Message, Polyline, Probe, Spindle
from cnc.model.diagnostics import BoardError, Diagnostic, GcodeError
from cnc.model.operator_control import Control
from cnc.model.streams import PulseChunk
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.pulses.reference_pulse import ReferencePulse
from cnc.session.run_pulses import Outcome, Progress, execute

FILE = "p.nc"


def stretch(line: int, t0: float, seconds: float = 1.0, speed_at_end: float = 0.0) -> PlanChunk:
    """Return a stretch of a plan; only its times, line and end speed matter here."""
    one = np.ones(1)
    path = PathChunk(
        ("x",),
        FILE,
        one.astype(np.int8),
        one.astype(np.int64),
        one,
        one,
        one,
        np.array([line], np.int32),
        one.astype(np.bool_),
        0 * one,
    )
    ends = np.array([0.0, 1.0])
    return PlanChunk(
        path,
        ends,
        t0,
        0.0,
        ends * seconds,
        ends,
        np.array([0.0, speed_at_end]),
        np.zeros(2),
        np.zeros(1),
    )


class Ticker:
    """An interpolator that gives each stretch two chunks of two pulses at equal intervals."""

    def __init__(self) -> None:
        self.position_steps: NDArray[np.int64] = np.zeros(1, dtype=np.int64)
        self.origin_steps: NDArray[np.int64] = np.zeros(1, dtype=np.int64)

    def pulses(self, chunk: PlanChunk) -> Iterator[PulseChunk]:
        line = chunk.path.line.repeat(2)
        for part in (0.0, 0.5):
            time = np.rint(
                (chunk.t0 + (part + np.array([0.1, 0.3])) * chunk.duration) * 1e9
            ).astype(np.int64)
            self.position_steps += 2
            yield PulseChunk(time, np.ones((2, 1), dtype=np.int8), line)

    def settle(self) -> Iterator[PulseChunk]:
        return iter(())

    def stand_at(self, grid: NDArray[np.int64]) -> None:
        self.position_steps = grid.copy()


def go(
    *items: PlanChunk | Block, board: Loopback | None = None, **options: Any
) -> tuple[Outcome, Loopback]:
    used = Loopback(1) if board is None else board
    return execute(iter(items), used, Ticker(), **options), used


def test_pulses_and_commands_are_in_order() -> None:
    shown: list[PulseChunk] = []
    reported: list[Progress] = []
    spindle, dwell, end = Spindle(FILE, 1, "cw", 100.0), Dwell(FILE, 3, 0.5), End(FILE, 5)
    outcome, board = go(
        spindle,
        stretch(2, 0.0),
        dwell,
        stretch(4, 1.5),
        end,
        on_pulses=shown.append,
        on_progress=reported.append,
    )
    assert outcome.finished
    assert outcome.stopped_at_line is None
    assert outcome.duration == 2.5
    assert outcome.rows == 8
    assert outcome.steps.tolist() == [8]
    assert outcome.position_steps.tolist() == [8]
    assert board.commands == [(0, spindle), (1_000_000_000, dwell), (2_500_000_000, end)]
    assert board.state == "idle"
    assert [c.line[0] for c in shown] == [2, 2, 4, 4]
    assert [p.line for p in reported] == [1, 2, 2, 3, 4, 4, 5]
    assert [p.rows for p in reported] == [0, 2, 4, 4, 6, 8, 8]
    assert np.all(np.diff([p.time for p in reported]) >= 0)


def test_an_empty_program() -> None:
    outcome, board = go()
    assert outcome.finished
    assert outcome.duration == 0.0
    assert board.state == "idle"


def test_board_starts_at_the_origin_of_the_interpolator() -> None:
    ticker = Ticker()
    ticker.origin_steps[:] = 40
    board = Loopback(1)
    assert execute([stretch(1, 0.0)], board, ticker).position_steps.tolist() == [44]


def test_dwell_without_motion_advances_the_clock() -> None:
    outcome, board = go(Dwell(FILE, 1, 2.0), Message(FILE, 2, "hello"))
    assert outcome.duration == 2.0
    assert board.commands[1][0] == 2_000_000_000


class TestStop:
    """The operator stops the run during its first chunk of pulses."""

    def stopping(self, **options: Any) -> tuple[Outcome, Loopback, list[int]]:
        control = Control()
        lines: list[int] = []

        def on_pulses(chunk: PulseChunk) -> None:
            lines.append(int(chunk.line[0]))
            control.stop()

        items = (stretch(2, 0.0, speed_at_end=5.0), stretch(4, 1.0), Spindle(FILE, 5, "off", 0.0))
        outcome, board = go(*items, on_pulses=on_pulses, control=control, **options)
        return outcome, board, lines

    def test_without_a_ramp_no_more_motion_is_sent(self) -> None:
        outcome, board, lines = self.stopping()
        assert lines == [2]
        assert not outcome.finished
        assert outcome.stopped_at_line == 2
        assert outcome.rows == 2
        assert outcome.position_steps.tolist() == [2]
        assert board.commands == []
        assert board.state == "stopped"

    def test_with_a_ramp_the_chunk_comes_to_rest(self) -> None:
        outcome, board, lines = self.stopping(ramp_down=lambda: [stretch(4, 1.0, 0.25)])
        assert lines == [2, 2, 4, 4]
        assert outcome.stopped_at_line == 4
        assert outcome.duration == 1.25
        assert outcome.position_steps.tolist() == [8]
        assert board.commands == []
        assert board.state == "stopped"

    def test_no_ramp_after_a_chunk_that_ends_at_rest(self) -> None:
        control = Control()

        def never() -> list[PlanChunk]:
            raise AssertionError

        outcome, _ = go(
            stretch(2, 0.0),
            stretch(3, 1.0),
            control=control,
            on_pulses=lambda _: control.stop(),
            ramp_down=never,
        )
        assert outcome.stopped_at_line == 2
        assert outcome.rows == 4

    def test_stop_requested_before_the_start(self) -> None:
        control = Control()
        control.stop()
        outcome, board = go(Spindle(FILE, 1, "cw", 1.0), stretch(2, 0.0), control=control)
        assert outcome.stopped_at_line == 0
        assert outcome.rows == 0
        assert board.commands == []
        assert board.state == "stopped"

    def test_no_stop_request(self) -> None:
        outcome, board = go(stretch(2, 0.0), control=Control(), ramp_down=list)
        assert outcome.finished
        assert board.state == "idle"


class Aborting(Loopback):
    """Counts the requests to abort. It can fail at them, with or without a line."""

    aborted = False

    def abort(self) -> None:
        self.aborted = True
        super().abort()
        raise BoardError(Diagnostic("link-lost", "nobody there"))


class Silent(Loopback):
    """Its faults have no line."""

    def send(self, chunk: PulseChunk) -> None:
        if self.rows >= 4:
            raise BoardError(Diagnostic("link-lost", "nobody there"))
        super().send(chunk)


def test_fault_aborts_and_has_file_and_line() -> None:
    board = Aborting(1, fail_after=5)
    with pytest.raises(BoardError) as caught:
        go(stretch(2, 0.0), stretch(7, 1.0), board=board)
    assert caught.value.diagnostic.code == "board-fault"
    assert caught.value.diagnostic.location() == "p.nc:7"
    assert board.aborted
    assert board.state == "stopped"
    assert board.position_steps.tolist() == [5]


def test_fault_without_a_line_gets_the_last_confirmed_one() -> None:
    with pytest.raises(BoardError) as caught:
        go(stretch(2, 0.0), stretch(7, 1.0), board=Silent(1))
    assert caught.value.diagnostic.location() == "p.nc:2"
    assert caught.value.exit_code == 3


@pytest.mark.parametrize("fault", [GcodeError(Diagnostic("bad-word", "no")), KeyboardInterrupt()])
def test_other_exceptions_abort(fault: BaseException) -> None:
    def items() -> Iterator[PlanChunk | Block]:
        yield stretch(2, 0.0)
        raise fault

    board = Aborting(1)
    with pytest.raises(type(fault)) as caught:
        execute(items(), board, Ticker())
    assert caught.value is fault
    assert board.aborted


class ProbesByMotion(Loopback):
    """A board whose probe makes contact at a height of the third axis.

    It does not play pulses below.
    """

    def __init__(self, height: int | None) -> None:
        super().__init__(3)
        self.height = height
        self.armed = False

    def execute(self, block: Any, time_ns: int) -> tuple[float, ...] | None:
        super().execute(block, time_ns)
        self.armed = isinstance(block, Probe)
        if not self.armed:
            return None
        height = block.end[2] if self.height is None else self.height / 100.0
        return (0.0 if self.height is None else 1.0, *block.end[:2].tolist(), height)

    def send(self, chunk: PulseChunk) -> None:
        if self.armed and self.height is not None:
            heights = self.position_steps[2] + np.cumsum(chunk.step[:, 2])
            kept = heights >= self.height
            chunk = PulseChunk(chunk.time_ns[kept], chunk.step[kept], chunk.line[kept])
        super().send(chunk)


def probing(board: ProbesByMotion, must: bool = True) -> Outcome:
    """Return a probe to -1 mm, then a traverse to 0 that uses the probe's result."""
    mill = Machine(
        name="mill",
        axes={
            letter: Axis(
                steps_per_mm=100.0, max_velocity=50.0, max_acceleration=500.0, max_jerk=5000.0
            )
            for letter in "xyz"
        },
    )
    found = Probe(FILE, 2, np.array([0.0, 0.0, -1.0]), 10.0, True, must)

    def blocks() -> Iterator[Block]:
        yield found
        assert found.answer.values is not None
        x = found.answer.values[3]
        yield Polyline(
            FILE, 3, np.array([[x, 0.0, 0.0]]), np.array([np.nan]), np.array([3], np.int32)
        )

    path = build(blocks(), axes=("x", "y", "z"), start=np.zeros(3))
    return execute(LookAhead(mill).plan(path), board, ReferencePulse([100.0] * 3, np.zeros(3)))


def test_motion_continues_from_the_contact() -> None:
    board = ProbesByMotion(-40)
    outcome = probing(board)
    assert outcome.position_steps.tolist() == board.position_steps.tolist() == [-40, 0, 0]
    assert board.steps.tolist() == [40, 0, 80]
    assert outcome.finished


def test_required_contact_that_is_missing_is_a_fault() -> None:
    with pytest.raises(BoardError) as caught:
        probing(ProbesByMotion(None))
    found = caught.value.diagnostic
    assert (found.code, found.line, found.file) == ("probe-no-contact", 2, FILE)


def test_optional_contact_may_be_missing() -> None:
    board = ProbesByMotion(None)
    assert probing(board, must=False).position_steps.tolist() == [-100, 0, 0]


def test_stop_at_any_time_rests_on_the_path() -> None:
    """With the real planner nothing is missing between the last stretch and the ramp, at any time
    of the stop.
    """
    axis = Axis(steps_per_mm=100.0, max_velocity=100.0, max_acceleration=1500.0, max_jerk=40000.0)
    machine = Machine(axes={"x": axis}, path=PathLimits(max_feed=100.0))
    ends = np.arange(1, 4001)[:, None] * 0.05
    moves = Polyline(FILE, 1, ends, np.full(4000, 100.0), np.arange(1, 4001, dtype=np.int32))
    for sent in range(1, 6):
        control = Control()
        ahead, board = LookAhead(machine, control), Loopback(1)
        interpolator = ReferencePulse([100.0], [0.0], 1e9 / 200_000)
        chunks: list[PulseChunk] = []

        def look(
            pulses: PulseChunk,
            chunks: list[PulseChunk] = chunks,
            control: Control = control,
            sent: int = sent,
        ) -> None:
            chunks.append(pulses)
            if len(chunks) == sent:
                control.stop()

        plans = ahead.plan(build([moves], axes=("x",), start=np.zeros(1)))
        outcome = execute(
            plans, board, interpolator, on_pulses=look, control=control, ramp_down=ahead.ramp_down
        )
        assert outcome.stopped_at_line is not None
        times = np.concatenate([chunk.time_ns for chunk in chunks])
        assert np.diff(times).min() > 0.99e9 / (100.0 * 100.0)
        # At rest: the last steps come ever slower.
        assert np.diff(times)[-1] > 10 * np.diff(times).min()
        assert board.position_steps[0] == len(times)
