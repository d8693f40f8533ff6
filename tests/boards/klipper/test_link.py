"""Klipper's numbered blocks over a bad cable: everything arrives, once and in order."""

from __future__ import annotations

import random

import numpy as np
import pytest

from cnc.boards.klipper.protocol import (
    DEFAULT_WINDOW,
    MAX_CONTENTS,
    MOST_TIMEOUT_S,
    SILENCE_S,
    BlockReader,
    KlipperLink,
    LocalError,
    WireError,
    block_bytes,
)
from cnc.simulators.klipper.devices import Cable
from tests.support.boards.klipper_rig import MCUS, board, machine
from tests.support.boards.stepper_rig import chunks, eased
from tests.support.soak import share

TRIP_S = 0.004


class Receiver:
    """The board's end as documented: blocks in order, acks, and naks. Commands have 2 bytes."""

    def __init__(self, sequence: int = 0) -> None:
        self.sequence = sequence
        self.reader = BlockReader()
        self.got: list[int] = []

    def receive(self, data: bytes) -> bytes:
        out = bytearray()
        damaged = self.reader.damaged
        for block in self.reader.receive(data):
            if block.sequence == self.sequence:
                self.sequence = (self.sequence + 1) % 16
                body = block.contents
                self.got += [int.from_bytes(body[k : k + 2], "big") for k in range(0, len(body), 2)]
            out += block_bytes(self.sequence, b"")
        if self.reader.damaged > damaged:
            out += block_bytes(self.sequence, b"")
        return bytes(out)


def spoilt(data: bytes, chance: float, draw: random.Random) -> bytes:
    out = bytearray()
    for byte in data:
        if draw.random() >= chance:
            out.append(byte)
        elif draw.random() < 0.5:
            out.append(byte ^ draw.randint(1, 255))
    return bytes(out)


def exchange(
    link: KlipperLink, board: Receiver, chance: float, seed: int, seconds: float = 30.0
) -> float:
    """Exchange bytes until the link is idle; return the time that it took."""
    draw, now = random.Random(seed), 0.0
    up: list[tuple[float, bytes]] = []
    down: list[tuple[float, bytes]] = []
    while not link.idle:
        assert now < seconds
        if out := link.outgoing(now):
            down.append((now + TRIP_S / 2, spoilt(out, chance, draw)))
        while down and down[0][0] <= now:
            up.append((now + TRIP_S / 2, spoilt(board.receive(down.pop(0)[1]), chance, draw)))
        while up and up[0][0] <= now:
            link.receive(up.pop(0)[1], now)
        now += 0.001
    return now


@pytest.mark.parametrize("seed", range(share(200, 6)))
@pytest.mark.parametrize("chance", [0.0, 0.001, 0.01])
def test_commands_arrive_once_and_in_order(chance: float, seed: int) -> None:
    link, board = KlipperLink(), Receiver(sequence=random.Random(seed).choice((0, 5, 15)))
    link.send((0xFFFF).to_bytes(2, "big"))
    exchange(link, board, 0.0, seed)
    sent = list(range(3000))
    for each in sent:
        link.send(each.to_bytes(2, "big"))
    exchange(link, board, chance, seed)
    # The first command has no effect, so it may be repeated until the numbers agree.
    assert board.got[-3000:] == sent
    assert set(board.got[:-3000]) <= {0xFFFF}
    assert (link.resent == 0) == (chance == 0.0) or link.resent <= 1


def test_one_loss_is_repeated_once_after_a_nak() -> None:
    """The nak makes the repetition quicker than the timeout, and happens once for a loss."""
    link, board = KlipperLink(), Receiver()
    link.send(bytes(2))
    exchange(link, board, 0.0, 1)
    blocks = [bytes(MAX_CONTENTS - 1)] * 6
    for each in blocks:
        link.send(each)
    data = link.outgoing(1.0)
    size = len(data) // 6
    answers = board.receive(data[:size] + data[2 * size :])
    link.receive(answers, 1.0 + TRIP_S)
    again = link.outgoing(1.0 + TRIP_S)
    assert again.count(data[size : 2 * size]) == 1
    assert link.resent == 5
    link.receive(board.receive(again), 1.0 + 2 * TRIP_S)
    assert link.idle
    assert link.outgoing(1.0 + 2 * TRIP_S) == b""


def test_acknowledgement_after_a_response_is_no_nak() -> None:
    """A response already has the number that the acknowledgement of its block has."""
    link = KlipperLink()
    link.send(bytes(2))
    exchange(link, Receiver(), 0.0, 1)
    for _ in range(2):
        link.send(bytes(MAX_CONTENTS - 1))
    data = link.outgoing(1.0)
    link.receive(block_bytes(2, b"\x01"), 1.001)
    link.receive(block_bytes(2, b""), 1.002)
    assert link.outgoing(1.003) == b""
    assert link.refused == 0
    link.receive(block_bytes(2, b""), 1.004)
    assert link.outgoing(1.005).endswith(data[len(data) // 2 :])
    assert link.refused == 1


@pytest.mark.parametrize("mcu", MCUS)
def test_nothing_is_repeated_on_a_good_cable(mcu: str) -> None:
    known = machine(mcu)
    with board(known) as (driver, simulator):
        driver.start(np.zeros(3, np.int64))
        for part in chunks(*eased(2000, 400_000), 100):
            driver.send(part)
        driver.finish()
        link = driver._supervisor.connection.link
    assert (link.refused, link.resent, simulator.blocks_refused) == (0, 0, 0)


def test_timeout_doubles_until_the_board_answers() -> None:
    """RFC 6298, 5.5: what comes twice costs a busy board more time."""
    link, peer = KlipperLink(), Receiver()
    for _ in range(20):
        link.send(bytes(2))
        exchange(link, peer, 0.0, 1)
    link.send(bytes(2))
    first, times = link.outgoing(1.0), []
    for k in range(1, 500):
        if link.outgoing(1.0 + k * 0.001):
            times.append(k)
    gaps = np.diff([0, *times])
    assert gaps[0] <= 26
    np.testing.assert_allclose(gaps[1:3] / gaps[:2], 2.0, rtol=0.05)
    assert gaps.max() <= 1000 * MOST_TIMEOUT_S + 1
    link.receive(peer.receive(first), 1.5)
    assert link.round_trip.timeout < 0.026


def test_round_trip_is_measured_and_sets_the_timeout() -> None:
    link, board = KlipperLink(), Receiver()
    for _ in range(60):
        link.send(bytes(2))
        exchange(link, board, 0.0, 1)
    assert link.round_trip.mean == pytest.approx(TRIP_S, abs=0.0021)
    assert link.round_trip.timeout < 0.05


def test_window_limits_the_bytes_on_their_way() -> None:
    link, board = KlipperLink(), Receiver()
    link.send(bytes(2))
    exchange(link, board, 0.0, 1)
    link.window = 192
    for _ in range(100):
        link.send(bytes(20))
    data = link.outgoing(1.0)
    assert 100 < len(data) <= 192
    assert link.outgoing(1.001) == b""


def test_response_leaves_its_block_in_the_window() -> None:
    """The board gives the room free after the command, when it sends the empty block."""
    link, peer = KlipperLink(), Receiver()
    link.send(bytes(2))
    exchange(link, peer, 0.0, 1)
    link.window = 192
    for _ in range(100):
        link.send(bytes(MAX_CONTENTS - 1))
    size = 4 + MAX_CONTENTS
    assert len(link.outgoing(1.0)) == 192 // size * size
    link.receive(block_bytes(2, b"\x01"), 1.001)
    assert link.outgoing(1.002) == b""
    link.receive(block_bytes(2, b""), 1.003)
    assert len(link.outgoing(1.004)) == size


def test_silence_is_a_fault_of_the_wire() -> None:
    link = KlipperLink()
    link.send(bytes(2))
    link.outgoing(0.0)
    times = [0.05 * k for k in range(round(SILENCE_S / 0.05) + 1)]
    for now in times:
        link.outgoing(now)
    with pytest.raises(WireError):
        link.outgoing(SILENCE_S + 0.01)


def test_time_in_which_the_host_stands_still_is_no_silence() -> None:
    link, board = KlipperLink(), Receiver()
    link.send(bytes(2))
    answer = board.receive(link.outgoing(0.0))
    assert link.outgoing(3.0) == b""
    link.receive(answer, 3.001)
    assert link.idle
    assert link.resent == 0


def test_too_long_commands_are_our_fault() -> None:
    with pytest.raises(LocalError):
        KlipperLink().send(bytes(MAX_CONTENTS + 1))


def throughput(baud: int, window: int, damaged: float, seed: int) -> float:
    """Return the bytes of commands per second that pass a cable in 4 s.

    As the firmware, the board sends one nak for damage until a block without damage comes.
    """
    link, cable, clock, told = KlipperLink(), Cable(baud, seed), 0.0, False
    reader, sequence, bytes_taken = BlockReader(), 0, 0
    link.window, link.byte_s = window, cable.byte_s if baud else 0.0
    cable.noise.damaged = damaged
    arriving: list[tuple[float, bytes]] = []
    while clock < 4.0:
        while link.waiting < 50:
            link.send(bytes(9))
        arriving += cable.down(link.outgoing(clock), clock)
        clock += 0.0005
        while arriving and arriving[0][0] <= clock:
            at, part = arriving.pop(0)
            before = reader.damaged
            for block in reader.receive(part):
                told = False
                if block.sequence == sequence:
                    sequence = (sequence + 1) % 16
                    bytes_taken += len(block.contents)
                cable.up(block_bytes(sequence, b""), at)
            if reader.damaged > before and not told:
                told = True
                cable.up(block_bytes(sequence, b""), at)
        link.receive(cable.received(clock), clock)
    return bytes_taken / clock


@pytest.mark.parametrize("seed", range(share(20, 1)))
@pytest.mark.parametrize(
    ("baud", "window", "least"), [(250_000, 192, 4_500.0), (0, DEFAULT_WINDOW, 15_000.0)]
)
def test_bad_cable_still_transfers_dense_motion(
    baud: int, window: int, least: float, seed: int
) -> None:
    """Dense motion needs some kB/s; 1 % of the bytes are damaged in both directions."""
    assert throughput(baud, window, 0.01, seed) > least


def test_good_cable_is_used_by_long_blocks() -> None:
    assert throughput(250_000, 192, 0.0, 0) > 0.8 * 25_000
