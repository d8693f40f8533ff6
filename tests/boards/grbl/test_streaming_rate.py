"""Short lines are streamed as fast as the wire allows, with few wake-ups of this computer."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from cnc.boards.grbl import line_stream
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from tests.support.boards.grbl_rig import MACHINE, connected
from tests.support.boards.line_board_conformance import ORIGIN, feed
from tests.support.soak import share

LONG = ["G1 F600", *(f"X{k % 7}.125Y{k % 9}.25Z-{k % 3}.375" for k in range(900))]
SHORT = ["G1 F600", *(f"X{k % 70}.1S{k}" for k in range(900))]
MOVES = ["G1 F3000", *(f"X{0.2 * k:.3f}" for k in range(1, 900))]
TINY = ["G1 F855", *(f"X{110 + k / 20:.2f} Z-{1 + k % 7 / 1000:.3f} S{k}" for k in range(1, 700))]
FAST = {110: 5000.0, 120: 500.0}
LASER = {110: 6000.0, 111: 6000.0, 112: 6000.0, 120: 5000.0, 121: 5000.0, 122: 5000.0}
PROMPT = {110: 2e4, 111: 2e4, 112: 2e4, 120: 5e3, 121: 5e3, 122: 5e3}
NEVER = 1.0
"""A shortest gathering, s, that is longer than any."""
LIGHT = {110: 6000.0, 112: 3000.0, 120: 1500.0, 122: 400.0}


def overscanned(rows: int, pixels: int) -> Iterator[str]:
    """Yield rows of short moves, there and back, and a long one behind each."""
    yield "G1 F1600"
    for row in range(rows):
        begin, way = (pixels * 0.05, -1) if row % 2 else (0.0, 1)
        for k in range(1, pixels + 1):
            yield f"X{begin + way * 0.05 * k:.3f}Y{0.05 * row:.3f}Z0.000S{100 + k}"
        yield f"X{begin + way * (0.05 * pixels + 5.0):.3f}S0"


def streamed(
    monkeypatch: pytest.MonkeyPatch,
    shortest: float,
    lines: list[str],
    *,
    check_only: bool,
    baud: int = 115200,
    settings: Mapping[int, float] = FAST,
) -> tuple[float, int]:
    """Return the seconds of the lines on the board, and the number of readings."""
    monkeypatch.setattr(line_stream, "SHORTEST", shortest)
    simulator = GrblSimulator(settings=settings, baud=baud)
    changed = MACHINE.board.model_copy(update={"baud": baud})
    board = connected(simulator, MACHINE.model_copy(update={"board": changed}))
    board.check_only = check_only
    board.start(ORIGIN)
    readings, pump = 0, board.link.pump

    def counted(timeout: float, poll: float = 0.2):
        nonlocal readings
        readings += 1
        return pump(timeout, poll)

    monkeypatch.setattr(board.link, "pump", counted)
    began = simulator.now
    feed(board, *lines)
    board.finish()
    return simulator.now - began, readings


@pytest.mark.parametrize("lines", [LONG, SHORT], ids=["long", "short"])
def test_answers_gather_while_the_wire_stays_busy(
    lines: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    gathering = line_stream.SHORTEST
    seconds, readings = streamed(monkeypatch, NEVER, lines, check_only=True)
    fewer = streamed(monkeypatch, gathering, lines, check_only=True)
    assert fewer[0] < 1.004 * seconds
    assert fewer[1] < 0.6 * readings


@pytest.mark.soak
@pytest.mark.parametrize("baud", share([57600, 115200], [115200]))
def test_a_long_move_delays_no_line_after_it(baud: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The full planner answers nothing meanwhile, and then answers as fast as before."""
    hard: Any = {"check_only": False, "baud": baud, "settings": LASER}
    gathering, lines = line_stream.SHORTEST, list(overscanned(12, 60))
    seconds, _ = streamed(monkeypatch, NEVER, lines, **hard)
    fewer, _ = streamed(monkeypatch, gathering, lines, **hard)
    assert fewer < 1.01 * seconds


def test_a_board_that_waits_for_the_wire_gets_its_lines_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    slow: Any = {"check_only": False, "baud": 57600, "settings": LIGHT}
    gathering = line_stream.SHORTEST
    seconds, readings = streamed(monkeypatch, NEVER, TINY, **slow)
    fewer = streamed(monkeypatch, gathering, TINY, **slow)
    assert fewer[0] < 1.002 * seconds
    assert fewer[1] < 0.6 * readings


def test_short_moves_take_a_wake_up_for_three_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    gathering = line_stream.SHORTEST
    seconds, readings = streamed(monkeypatch, NEVER, MOVES, check_only=False)
    fewer = streamed(monkeypatch, gathering, MOVES, check_only=False)
    assert fewer[0] < 1.002 * seconds
    assert fewer[1] < len(MOVES) / 3 < readings


@pytest.mark.soak
def test_a_board_that_reads_more_slowly_than_the_wire_takes_few_wake_ups(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Lines of 25 bytes: four of them fill the receive buffer of GRBL."""
    angles = (0.02 * k for k in range(900))
    circle = (
        f"X{20 + 9 * math.cos(a):.3f}Y{20 + 9 * math.sin(a):.3f}Z-{1 + k % 3 * 0.01:.3f}"
        for k, a in enumerate(angles)
    )
    lines, gathering = ["G1 F6000", *circle], line_stream.SHORTEST
    hard: Any = {"check_only": False, "settings": PROMPT}
    seconds, _ = streamed(monkeypatch, NEVER, lines, **hard)
    fewer = streamed(monkeypatch, gathering, lines, **hard)
    assert fewer[0] < 1.004 * seconds
    assert fewer[1] < 0.8 * len(lines)
