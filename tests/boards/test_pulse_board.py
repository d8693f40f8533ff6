"""The exchange of bytes with a pulse board between the calls of the planner."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cnc.boards import pulse_board
from cnc.model.streams import PulseChunk


def test_a_planner_at_work_exchanges_bytes_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread may wait too long for the lock of the interpreter; here it never runs."""
    pumped, now = [], [100.0]
    checks = SimpleNamespace(position_steps=np.zeros(1, np.int64), rows=0, send=lambda chunk: None)
    supervisor = SimpleNamespace(
        checks=checks,
        refuse_after_fault=lambda: None,
        pump_in_background=lambda: pumped.append(now[0]),
    )
    monkeypatch.setattr(pulse_board.threading.Thread, "start", lambda thread: None)
    monkeypatch.setattr(pulse_board.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(pulse_board.PulseBoard, "__abstractmethods__", frozenset())
    board = pulse_board.PulseBoard(None, supervisor)  # type: ignore[abstract, arg-type]
    chunk = PulseChunk(np.zeros(0, np.int64), np.zeros((0, 1), np.int8), np.zeros(0, np.int32))
    board.send(chunk)
    assert not pumped, "in virtual time there is no thread, and nothing to exchange"
    board.run_in_background(0.01)
    for now[0] in (101.0, 101.004, 101.008, 101.012, 101.016, 101.03):
        board.send(chunk)
    assert pumped == [101.0, 101.012, 101.03]
