"""What every pulse board must do, whatever is behind it. The test of a driver subclasses
:class:`PulseBoardConformance`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cnc.boards.protocols import Capabilities, PulseSink
from cnc.model.blocks import Dwell, Spindle
from cnc.model.diagnostics import BoardError
from cnc.model.streams import PulseChunk

AXES = 3
MIN_PULSE_NS = 5000


def chunk(*rows: tuple[int, tuple[int, ...]], line: int = 1) -> PulseChunk:
    """Rows of (time_ns, steps); source lines count up from ``line``."""
    return PulseChunk(
        np.array([time for time, _ in rows], dtype=np.int64),
        np.array([step for _, step in rows], dtype=np.int8).reshape(
            len(rows), -1 if rows else AXES
        ),
        np.arange(line, line + len(rows), dtype=np.int32),
    )


class PulseBoardConformance:
    """Subclass and give :meth:`make`, and what differs."""

    least = MIN_PULSE_NS
    """Pulses of an axis must be so far apart, ns."""
    plays_at_once = True
    """Whether what was sent has been played when an abort comes."""
    revives = True
    """Whether the board takes another program after a stop."""

    def make(self, folder: Path) -> PulseSink:
        """A fresh board with AXES axes whose pulses must be ``least`` ns apart."""
        raise NotImplementedError

    @pytest.fixture
    def fresh(self, tmp_path: Path) -> Iterator[PulseSink]:
        board = self.make(tmp_path)
        yield board
        board.close()

    @pytest.fixture
    def board(self, fresh: PulseSink) -> PulseSink:
        fresh.start(np.zeros(AXES, dtype=np.int64))
        return fresh

    def fails(self, board: PulseSink, code: str, line: int | None, *chunks: PulseChunk) -> None:
        for part in chunks[:-1]:
            board.send(part)
        with pytest.raises(BoardError) as caught:
            board.send(chunks[-1])
        assert caught.value.diagnostic.code == code
        if line is not None:
            assert caught.value.diagnostic.line == line

    def test_capabilities(self, board: PulseSink) -> None:
        can = board.capabilities
        assert isinstance(can, Capabilities)
        assert can.axes == AXES
        assert board.takes == "pulses"
        assert 0.0 < can.stop_latency_s < 0.2
        assert can.max_step_rate == pytest.approx(1e9 / self.least)
        assert can.tick_ns > 0

    def test_a_board_gives_an_answer_to_each_switch_and_position_that_it_states(
        self, fresh: PulseSink
    ) -> None:
        known = fresh.known_steps
        assert known is None or len(known) == AXES
        assert len(fresh.switches) == len(fresh.motor_switches) <= AXES
        if fresh.capabilities.limit_switches:
            assert known is not None
        else:
            assert not fresh.switches

    def test_position_follows_the_pulses(self, fresh: PulseSink) -> None:
        board = fresh
        board.start(np.array([10, -5, 0]))
        board.send(
            chunk((0, (1, 0, 0)), (self.least + 1000, (1, -1, 0)), (self.least + 1000, (0, 0, 1)))
        )
        board.send(chunk((2 * self.least + 2000, (-1, 0, 0)), line=7))
        assert board.position_steps.tolist() == [11, -6, 1]
        assert board.confirmed_line == 7
        board.finish()
        assert board.position_steps.tolist() == [11, -6, 1]

    def test_empty_chunk_is_accepted(self, board: PulseSink) -> None:
        board.send(chunk())
        board.finish()
        assert board.position_steps.tolist() == [0, 0, 0]

    def test_second_program_after_finish(self, board: PulseSink) -> None:
        board.send(chunk((2 * self.least, (1, 0, 0))))
        board.finish()
        board.start(np.array([1, 0, 0]))
        board.send(chunk((0, (1, 0, 0))))
        board.finish()
        assert board.position_steps.tolist() == [2, 0, 0]

    def test_commands_are_in_order(self, board: PulseSink) -> None:
        board.execute(Spindle("p.nc", 3, "cw", 1000.0), 0)
        board.send(chunk((10, (1, 0, 0)), line=4))
        board.execute(Dwell("p.nc", 5, 0.5), 100)
        assert board.confirmed_line == 5
        with pytest.raises(BoardError) as caught:
            board.execute(Dwell("p.nc", 6, 0.5), 50)
        assert caught.value.diagnostic.code == "board-order"

    def test_decreasing_time_is_refused(self, board: PulseSink) -> None:
        self.fails(board, "board-order", 2, chunk((10, (1, 0, 0)), (9, (0, 1, 0))))
        assert board.position_steps.tolist() == [1, 0, 0]
        assert board.confirmed_line == 1

    def test_decreasing_time_between_chunks_is_refused(self, board: PulseSink) -> None:
        self.fails(board, "board-order", 9, chunk((10, (1, 0, 0))), chunk((9, (0, 1, 0)), line=9))

    def test_too_close_pulses_are_refused(self, board: PulseSink) -> None:
        self.fails(
            board,
            "board-step-rate",
            3,
            chunk((0, (1, 0, 0)), (self.least - 1000, (0, 1, 0)), (self.least - 2, (-1, 0, 0))),
        )
        assert board.position_steps.tolist() == [1, 1, 0]

    def test_too_close_pulses_between_chunks_are_refused(self, board: PulseSink) -> None:
        self.fails(
            board,
            "board-step-rate",
            8,
            chunk((0, (1, 0, 0))),
            chunk((100, (0, 1, 0))),
            chunk((self.least - 2, (1, 0, 0)), line=8),
        )

    def test_rounding_of_a_nanosecond_is_allowed(self, board: PulseSink) -> None:
        board.send(chunk((0, (1, 0, 0)), (self.least - 1, (1, 0, 0))))
        board.send(chunk((2 * self.least - 2, (1, 0, 0))))
        assert board.position_steps.tolist() == [3, 0, 0]

    @pytest.mark.parametrize("step", [(0, 0, 0), (2, 0, 0), (0, -2, 1), (-128, 0, 0)])
    def test_invalid_steps_are_refused(self, board: PulseSink, step: tuple[int, int, int]) -> None:
        self.fails(board, "board-step", 2, chunk((0, (1, 0, 0)), (self.least, step)))

    @pytest.mark.parametrize(
        "bad",
        [
            PulseChunk(np.zeros(1, np.int64), np.ones((1, 2), np.int8), np.zeros(1, np.int32)),
            PulseChunk(np.zeros(2, np.int64), np.ones((1, 3), np.int8), np.zeros(1, np.int32)),
            PulseChunk(np.zeros(1), np.ones((1, 3), np.int8), np.zeros(1, np.int32)),  # type: ignore[arg-type]
        ],
    )
    def test_wrong_shape_or_type_is_refused(self, board: PulseSink, bad: PulseChunk) -> None:
        self.fails(board, "board-format", None, bad)

    def test_wrong_number_of_axes_is_refused(self, fresh: PulseSink) -> None:
        with pytest.raises(BoardError) as caught:
            fresh.start(np.zeros(AXES + 1, dtype=np.int64))
        assert caught.value.diagnostic.code == "board-format"

    def test_pulses_before_the_start_are_refused(self, fresh: PulseSink) -> None:
        self.fails(fresh, "board-not-started", None, chunk((0, (1, 0, 0))))

    @pytest.mark.parametrize("how", ["stop", "abort", "close", "fault"])
    def test_stopped_board_refuses_all_calls(self, board: PulseSink, how: str) -> None:
        board.send(chunk((0, (1, 0, 0))))
        if how == "fault":
            self.fails(board, "board-order", None, chunk((-1, (1, 0, 0))))
        else:
            getattr(board, how)()
        later = (
            lambda: board.send(chunk((2 * self.least, (1, 0, 0)))),
            lambda: board.execute(Dwell("p.nc", 1, 1.0), 10_000),
            board.finish,
            lambda: board.start(np.zeros(AXES, dtype=np.int64)),
        )
        for call in later:
            with pytest.raises(BoardError) as caught:
                call()
            assert caught.value.diagnostic.code == "board-stopped"
        board.stop()
        board.abort()
        board.close()
        stands = (
            [[1, 0, 0]]
            if self.plays_at_once or how in ("stop", "fault")
            else [[0, 0, 0], [1, 0, 0]]
        )
        assert board.position_steps.tolist() in stands

    def test_a_stopped_board_takes_the_next_program_where_it_can_be_revived(
        self, board: PulseSink
    ) -> None:
        board.send(chunk((0, (1, 0, 0))))
        board.stop()
        if not self.revives:
            with pytest.raises(BoardError) as caught:
                board.revive()
            assert caught.value.diagnostic.code == "board-stopped"
            return
        board.revive()
        board.start(board.position_steps)
        board.send(chunk((0, (1, 0, 0))))
        board.finish()
        assert board.position_steps.tolist() == [2, 0, 0]
