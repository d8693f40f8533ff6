"""The conformance tests of boards that take lines.

The test of a driver subclasses :class:`LineBoardConformance`.
"""

from __future__ import annotations

from collections.abc import Iterator
from weakref import WeakKeyDictionary

import numpy as np
import pytest

from cnc.boards.protocols import Capabilities, LineSink
from cnc.model.blocks import Dwell
from cnc.model.diagnostics import BoardError
from cnc.model.operator_control import Control
from cnc.model.streams import PackedLines
from tests.support.boards.line_reader import LineReader

AXES = 3
PREAMBLE = "G21 G90 G94 G17 G54"
ORIGIN = np.zeros(AXES, np.int64)
READERS: WeakKeyDictionary[LineSink, LineReader] = WeakKeyDictionary()
"""A reader of lines for each board: modes stay from one call of :func:`feed` to the next."""


def feed(board: LineSink, *texts: str, first: int = 1) -> None:
    """Send lines with their effects, as their writer knows them."""
    reader = READERS.setdefault(board, LineReader())
    lines = [reader.read(text, line) for line, text in enumerate(texts, start=first)]
    board.send_lines(PackedLines.of(lines))


class LineBoardConformance:
    """Subclass and implement :meth:`make`."""

    def make(self) -> LineSink:
        """Return a new board with AXES axes at zero, 10 mm of travel each way, no offsets."""
        raise NotImplementedError

    @pytest.fixture
    def fresh(self) -> Iterator[LineSink]:
        board = self.make()
        yield board
        board.close()

    @pytest.fixture
    def board(self, fresh: LineSink) -> LineSink:
        fresh.connect_operator(Control(), lambda: None)
        fresh.start(ORIGIN)
        return fresh

    def test_is_a_line_sink_with_capabilities(self, fresh: LineSink) -> None:
        can = fresh.capabilities
        assert isinstance(can, Capabilities)
        assert (can.axes, fresh.takes) == (AXES, "lines")
        assert 0.0 < can.stop_latency_s < 0.2
        assert len(fresh.position) == len(fresh.work_offset) == len(fresh.resolution) == AXES
        assert all(0.0 < step < 0.1 for step in fresh.resolution)
        assert set(fresh.stored_offsets) >= {
            "G54",
            "G55",
            "G56",
            "G57",
            "G58",
            "G59",
            "G28",
            "G30",
            "G92",
        }

    def test_moves_to_the_end_of_the_lines(self, board: LineSink) -> None:
        feed(board, PREAMBLE, "G0 X2 Y1", "G1 Z-1 F600", "G3 X4 Y3 I0 J2", "G1 X5")
        board.finish()
        assert board.position == pytest.approx((5.0, 3.0, -1.0), abs=0.002)
        assert board.confirmed_line == 5
        assert board.buffered == 0

    def test_runs_again_after_finish(self, board: LineSink) -> None:
        feed(board, PREAMBLE, "G1 X1 F600")
        board.finish()
        board.start(ORIGIN)
        feed(board, PREAMBLE, "G1 X2 F600")
        board.finish()
        assert board.position == pytest.approx((2.0, 0.0, 0.0), abs=0.002)

    def test_execute_waits_for_the_lines_before(self, board: LineSink) -> None:
        feed(board, PREAMBLE, "G1 X3 F600")
        assert board.execute(Dwell("p.nc", 2, 0.0), 0) is None
        assert board.position == pytest.approx((3.0, 0.0, 0.0), abs=0.002)

    def test_a_stop_keeps_the_position(self, board: LineSink) -> None:
        feed(board, PREAMBLE, *(f"G1 X{k % 2 * 8} F600" for k in range(1, 20)))
        board.stop()
        x, y, z = board.position
        assert 0.0 <= x <= 8.0
        assert (y, z) == pytest.approx((0.0, 0.0), abs=0.002)

    def test_a_stop_request_ends_all_waiting(self, fresh: LineSink) -> None:
        control = Control()
        fresh.connect_operator(control, lambda: None)
        fresh.start(ORIGIN)
        control.stop()
        feed(fresh, PREAMBLE, *["G1 X8 F60", "X0"] * 50)
        fresh.finish()
        fresh.stop()
        assert fresh.position == pytest.approx((0.0, 0.0, 0.0), abs=0.002)

    def test_check_only_moves_nothing(self, fresh: LineSink) -> None:
        fresh.check_only = True
        fresh.connect_operator(Control(), lambda: None)
        fresh.start(ORIGIN)
        feed(fresh, PREAMBLE, "G1 X5 F600", "G4 P100", "G1 Y5")
        fresh.finish()
        assert fresh.position == pytest.approx((0.0, 0.0, 0.0), abs=0.002)

    def test_refuses_lines_before_the_start(self, fresh: LineSink) -> None:
        with pytest.raises(BoardError) as caught:
            feed(fresh, PREAMBLE)
        assert caught.value.diagnostic.code == "board-not-started"

    @pytest.mark.parametrize("how", ["stop", "abort", "close", "fault"])
    def test_refuses_everything_once_stopped(self, board: LineSink, how: str) -> None:
        feed(board, PREAMBLE)
        if how == "fault":
            feed(board, "G1 X")
            with pytest.raises(BoardError):
                board.finish()
        else:
            getattr(board, how)()
        for call in (
            lambda: feed(board, "G1 X1 F100"),
            lambda: board.execute(Dwell("p.nc", 1, 1.0), 0),
            board.finish,
            lambda: board.start(ORIGIN),
        ):
            with pytest.raises(BoardError) as caught:
                call()
            assert caught.value.diagnostic.code == "board-stopped"
        board.stop()
        board.abort()
        board.close()
