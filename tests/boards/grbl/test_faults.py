"""The GRBL driver and every fault of the simulator at random times.

Each fault is reported in time, at its line, and the machine is at rest afterwards.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest

from cnc.boards.grbl.faults import refused
from cnc.boards.grbl.messages import Firmware, Reply, Reported
from cnc.model.diagnostics import BoardError
from cnc.simulators.grbl.grbl_simulator import (
    Alarm,
    Corrupt,
    Drop,
    Duplicate,
    Error,
    Fault,
    Freeze,
    GrblSimulator,
    Swallow,
    Unplug,
)
from tests.support.boards.grbl_rig import LATEST, ROUTER, fails, outcome, started
from tests.support.boards.line_board_conformance import ORIGIN, PREAMBLE, feed
from tests.support.soak import share

NEVER = "none"
GARBLED = {"board-error", "reply-lost", "reply-missing", "off-path", "position-differs", NEVER}
FAULTS: list[tuple[str, Callable[[random.Random], Fault], set[str]]] = [
    ("drop", lambda rng: Drop(rng.randint(1, 30)), {*GARBLED, "board-silent"}),
    ("corrupt", lambda rng: Corrupt(rng.randint(1, 3)), {*GARBLED, "board-alarm"}),
    ("duplicate", lambda rng: Duplicate(rng.randint(1, 9)), GARBLED),
    ("swallow", lambda rng: Swallow(), {"reply-lost", "reply-missing"}),
    ("freeze", lambda rng: Freeze(), {"board-silent"}),
    ("unplug", lambda rng: Unplug(), {"port-lost"}),
    *(
        (f"alarm {code}", lambda rng, code=code: Alarm(code), {"board-alarm"})
        for code in range(1, 11)
    ),
    *(
        (f"error {code}", lambda rng, code=code: Error(code), {"board-error"})
        for code in (*range(1, 18), *range(20, 39))[:: share(1, 6)]
    ),
]


@pytest.mark.parametrize(("name", "make", "codes"), FAULTS, ids=[name for name, _, _ in FAULTS])
def test_faults_are_reported_in_time_and_motion_ends(
    name: str, make: Callable[[random.Random], Fault], codes: set[str]
) -> None:
    # In every run some faults strike a slow machine, and the others a quick one.
    for seed in share(range(40), [len(name) % 2]):
        rng = random.Random(f"{name} {seed}")
        slow = seed % 2 == 0
        simulator = GrblSimulator(settings=None if slow else ROUTER)
        board = started(simulator)
        lines = [
            PREAMBLE,
            *(f"G1 X{rng.uniform(0, 9):.3f} Y{rng.uniform(0, 9):.3f} F1500" for _ in range(60)),
        ]
        struck = simulator.now + rng.uniform(0.3, 60.0 if slow else 7.0)
        simulator.inject(make(rng), time=struck)
        error = outcome(board, lines)
        code = NEVER if error is None else error.diagnostic.code
        assert code in codes, (seed, code)
        if error is None:
            # What was lost did no harm: the board is where the last line leads to.
            assert board.position == pytest.approx(end_of(lines), abs=0.1)
            continue
        assert error.exit_code == 3
        assert error.diagnostic.hint
        assert simulator.now - struck <= LATEST, (seed, code)
        # Not before what the board was moving on, nor behind what it was sent; a line that it took
        # may have been a question.
        assert (
            min(board.confirmed_line - 12, on_its_way(simulator, struck))
            <= error.diagnostic.line
            <= board.confirmed_line + 6
        ), (seed, code)
        if name != "unplug":
            stands, moved = simulator.position, len(simulator.moves)
            simulator.advance(simulator.now + 10.0)
            assert (simulator.position, len(simulator.moves)) == (stands, moved), (seed, code)


def on_its_way(simulator: GrblSimulator, when: float) -> int:
    """Source line of the move at a position, in a program of moves after one line of modes."""
    return sum(move.begin_time <= when for move in simulator.moves)


@pytest.mark.parametrize("settings", share([None, ROUTER], [ROUTER]))
@pytest.mark.parametrize(
    "lines",
    [
        [f"G1 X{k % 2 * 8} Y{k * 0.3:.1f} F1500" for k in range(30)],
        [f"G1 X{5 * math.cos(k / 50):.3f} Y{5 * math.sin(k / 50):.3f} F1500" for k in range(400)],
        [f"G2 X{(-1) ** k * 5} Y0 I{(-1) ** k * 5} J0 F1500" for k in range(8)],
        [f"G1 X{k % 2 * 8} F1500" for k in range(30)],
    ],
    ids=["zigzag", "chords", "arcs", "to and fro"],
)
def test_motion_ahead_is_limited_without_loss_of_speed(
    lines: list[str], settings: dict[int, float] | None
) -> None:
    times = []
    for ahead in (None, math.inf):
        simulator = GrblSimulator(settings=settings)
        board = started(simulator)
        if ahead is not None:
            board.stream.monitor._ahead = ahead
        feed(board, PREAMBLE, "G1 X5 Y0 F500")
        feed(board, *lines, first=3)
        left = simulator.now
        board.finish()
        times.append(
            (
                simulator.moves[-1].end_time - simulator.moves[0].begin_time,
                simulator.moves[-1].end_time - left,
            )
        )
    assert times[0][0] == pytest.approx(times[1][0], rel=0.002)
    assert times[0][1] < 4.0


def test_two_wrong_reports_are_a_fault() -> None:
    """An AVR reads its position while it steps: a number may be half old and half new."""
    simulator = GrblSimulator()
    board = started(simulator)
    feed(board, PREAMBLE, "G1 X9 F300")
    board.stream.serve(0.5)
    right = board.status
    assert right.position is not None
    x = right.position[0]
    wrong = replace(right, position=(x, 1.28, 0.0))
    ahead = replace(right, position=(x + 1.28, 0.0, 0.0))
    for status in (wrong, right, wrong, right, ahead, right, right, right):
        board.stream.receive(Reported(status), board.link.now())
    board.stream.receive(Reported(wrong), board.link.now())
    with pytest.raises(BoardError) as caught:
        board.stream.receive(Reported(wrong), board.link.now())
    assert (caught.value.diagnostic.code, caught.value.diagnostic.line) == ("off-path", 2)


def test_a_shortened_move_is_found_before_a_pause() -> None:
    simulator = GrblSimulator()
    board = started(simulator)
    feed(board, PREAMBLE)
    board.finish()
    board.start(ORIGIN)
    sent = simulator.core.receiver.received
    # "G1 X12.5 F600": without its 2 it goes to 1.5
    simulator.inject(Drop(1), byte=sent + len("G1 X1") + 1)
    found = fails(board, "G1 X12.5 F600").diagnostic
    assert (found.code, found.line) == ("position-differs", 1)


def end_of(lines: Sequence[str]) -> tuple[float, float, float]:
    x, y = (float(word[1:]) for word in lines[-1].split()[1:3])
    return x, y, 0.0


@pytest.mark.parametrize("code", range(1, 11))
def test_alarms_have_number_meaning_and_advice(code: int) -> None:
    simulator = GrblSimulator()
    board = started(simulator)
    feed(board, PREAMBLE, "G1 X5 F200")
    simulator.inject(Alarm(code), time=simulator.now + 0.4)
    with pytest.raises(BoardError) as caught:
        board.finish()
    assert f"ALARM:{code}:" in caught.value.diagnostic.message
    assert (
        not simulator.core.locked
    )  # GRBL had forgotten the reset that came while it told of its limit


def test_queued_lines_do_not_move_after_an_error() -> None:
    simulator = GrblSimulator()
    board = started(simulator)
    feed(board, PREAMBLE, "G1 X1 F300")
    found = fails(board, "G999", *(f"G1 X{k} Y9" for k in range(2, 9)), first=3).diagnostic
    assert (found.code, found.line) == ("board-error", 3)
    assert "error:20" in found.message
    simulator.advance(simulator.now + 5.0)
    # it had gone on to a line behind the error for as long as the answer takes to come and the hold
    # to go
    assert simulator.position[1] < 0.5
    assert board.position == pytest.approx(simulator.position, abs=0.002)
    assert simulator.core.state == "Idle"


@pytest.mark.parametrize(
    ("text", "said"), [("M36", "[program.codes]"), ("m0117", "[program.codes]"), ("M3", "report")]
)
def test_the_advice_for_a_line_is_that_of_its_writer(text: str, said: str) -> None:
    """The program's own code was passed on; the translator wrote the others."""
    assert said in refused(Reply(20), text, 3, Firmware.GRBL).diagnostic.hint
