"""The sender of lines calls few functions for each line: they are most of its CPU time."""

from __future__ import annotations

import sys
from types import FrameType

import pytest

import cnc
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from tests.boards.grbl.test_streaming_rate import LONG, MOVES
from tests.support.boards.grbl_rig import connected
from tests.support.boards.line_board_conformance import ORIGIN, feed

OURS = cnc.__file__.removesuffix("__init__.py")
FAST = {110: 2e4, 111: 2e4, 112: 2e4, 120: 5e3, 121: 5e3, 122: 5e3}


@pytest.mark.parametrize(
    ("lines", "check_only", "most"),
    [(LONG, True, 9.0), (MOVES, False, 10.5)],
    ids=["check", "moves"],
)
def test_calls_a_line(lines: list[str], check_only: bool, most: float) -> None:
    board = connected(GrblSimulator(settings=FAST))
    board.check_only = check_only
    board.start(ORIGIN)
    feed(board, "G21 G90 G94 G17 G54")
    calls = 0

    def count(frame: FrameType, event: str, _: object) -> None:
        nonlocal calls
        file = frame.f_code.co_filename
        calls += event == "call" and file.startswith(OURS) and "simulator" not in file

    sys.setprofile(count)
    try:
        feed(board, *lines)
        board.stream.drain()
    finally:
        sys.setprofile(None)
    assert calls < most * len(lines)
