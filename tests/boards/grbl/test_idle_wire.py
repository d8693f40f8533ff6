"""A wire that is slower than the board is never idle while lines are left."""

from __future__ import annotations

import pytest

from cnc.boards.grbl import line_stream
from tests.boards.grbl.test_streaming_rate import LASER, NEVER, overscanned, streamed


def test_the_first_answer_after_a_long_move_is_served_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A long move stops the answers; the moves behind it take less time than their lines."""
    gathering, lines = line_stream.SHORTEST, list(overscanned(4, 40))
    seconds, readings = streamed(
        monkeypatch, NEVER, lines, check_only=False, baud=57600, settings=LASER
    )
    fewer = streamed(monkeypatch, gathering, lines, check_only=False, baud=57600, settings=LASER)
    assert fewer[0] < 1.003 * seconds
    assert fewer[1] < 0.6 * readings
