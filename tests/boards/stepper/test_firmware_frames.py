"""Frames that the firmware refuses, repeats or ignores, and resets of the board."""

from __future__ import annotations

import numpy as np
import pytest

from cnc.boards.stepper.protocol import Kind, frame
from cnc.model.diagnostics import BoardError
from tests.support.boards.stepper_host import (
    ALARM,
    BAD_STREAM,
    END_OF_STREAM,
    IDLE,
    RUNNING,
    Host,
    straight,
)
from tests.support.boards.stepper_rig import (
    board,
    line,
    send_all,
)
from tests.support.boards.stepper_simulator import (
    Simulator,
    SimulatorPort,
)
from tests.support.soak import share


def test_invalid_configurations_are_refused(host: Host) -> None:
    for wrong in ({"pulse": 0}, {"pulse": 121}, {"setup": 121}, {"ramp": 0}):
        assert not host.configure(**wrong)
    assert not host.request(Kind.CONFIGURE, bytes(5))
    assert not host.request(Kind.SET_POSITION, bytes(15))
    assert not host.request(Kind.RUN), "nothing has come"
    assert host.configure(pulse=120, setup=120, ramp=255)
    assert host.ask().state == IDLE


def test_request_is_carried_out_once(host: Host) -> None:
    host.stream(straight(10, 200) + END_OF_STREAM, 1)
    run_again = frame(Kind.RUN, 77)
    host.said(run_again)
    host.hear(0.05)
    host.stream(straight(10, 200) + END_OF_STREAM, 1)
    host.said(run_again)
    host.hear(0.05)
    assert len(host.simulator.moves()[0]) == 10
    host.said(frame(Kind.RUN, 78))
    host.hear(0.05)
    assert len(host.simulator.moves()[0]) == 20
    assert host.ask().position[:3] == (120, -200, 300)


def test_damaged_frame_has_no_effect(host: Host) -> None:
    """Each bit of a request and of a data frame is inverted.

    The CRC is wrong, even where COBS is valid.
    """
    before = host.ask()
    for whole in (
        frame(Kind.SET_POSITION, 99, bytes(range(16))),
        frame(Kind.DATA, 0, b"\1\x80" + straight(9, 300)),
    ):
        for bit in range(share(8 * (len(whole) - 1), 40)):
            wrong = bytearray(whole)
            wrong[bit // 8] ^= 1 << bit % 8
            host.simulator.send(bytes(wrong) + b"\0")
            host.hear(0.001)
    after = host.ask()
    assert after == before
    assert any(each[0] == Kind.NAK and each[1] == 0 for each in host.frames)


def test_reset_discards_earlier_moves(host: Host) -> None:
    """Frames on their way are ignored, even if the board expects their numbers after its reset."""
    host.stream(b"".join(straight(100, 200) for _ in range(10)), 100, end=False)
    assert host.request(Kind.RUN)
    host.hear(0.02)
    assert host.ask().state == RUNNING
    host.simulator.reset()
    host.hear(0.01)
    made = len(host.simulator.moves()[0])
    host.sequence = 0
    host.stream(straight(100, 200) + END_OF_STREAM, 10)
    assert not host.request(Kind.RUN)
    said = host.ask()
    assert (said.known, said.state, said.position) == (0, IDLE, (0, 0, 0, 0))
    host.hear(0.5)
    assert len(host.simulator.moves()[0]) == made


def test_driver_detects_a_reset(simulator: Simulator) -> None:
    time_ns, step = line(6_000, 50_000)
    reset_at = 0.0

    def reset(sent: int) -> None:
        nonlocal reset_at
        if not reset_at and simulator.now > 0.2:
            simulator.reset()
            reset_at = simulator.now

    with board(simulator) as driver:
        driver.start(np.zeros(3, np.int64))
        with pytest.raises(BoardError) as caught:
            send_all(driver, time_ns, step, reset)
        assert caught.value.diagnostic.code == "board-reset"
        assert "position is lost" in caught.value.diagnostic.message
        assert simulator.now - reset_at < 1.0
        assert driver.known_steps == (None,) * 3
        _, made = simulator.moves()
        places = made.cumsum(axis=0, dtype=np.int64)
        behind = (
            len(places) - 1 - int(np.flatnonzero((places == driver.position_steps).all(axis=1))[0])
        )
        assert behind < 0.03 / 50e-6, "where it was when it last told"
        simulator.run(0.5)
        assert len(simulator.moves()[0]) == len(made)


def test_driver_detects_a_slow_reset(simulator: Simulator) -> None:
    """A bootloader is silent for a second or more."""
    time_ns, step = line(6_000, 50_000)
    port = SimulatorPort(simulator)
    reset_at = 0.0

    def reset(sent: int) -> None:
        nonlocal reset_at
        if not reset_at and simulator.now > 0.2:
            simulator.reset()
            reset_at = simulator.now
            port.write = lambda data: None  # type: ignore[method-assign]

    with board(simulator, port) as driver:
        driver.start(np.zeros(3, np.int64))
        with pytest.raises(BoardError) as caught:
            send_all(driver, time_ns, step, reset)
        assert caught.value.diagnostic.code == "board-silent"
        assert "ome the machine" in caught.value.diagnostic.hint
        assert simulator.now - reset_at < 1.0
        assert driver.known_steps == (None,) * 3


@pytest.mark.parametrize(
    "wrong",
    [
        bytes((0, 0)) + bytes(6),
        bytes((10, 0)) + bytes(5) + b"\x70" + bytes(24),
        bytes((10, 0)) + bytes(5) + b"\x11" + bytes(8),
        bytes((200, 0x18)) + bytes(30),
    ],
    ids=["no slots", "three phases", "a phase of an axis that always steps", "a long command"],
)
def test_invalid_stream_is_an_alarm(host: Host, wrong: bytes) -> None:
    host.stream(straight(20, 400) + wrong + END_OF_STREAM, 10)
    assert host.request(Kind.RUN)
    host.hear(0.1)
    said = host.ask()
    assert (said.state, said.alarm) == (ALARM, BAD_STREAM)
    assert list(said.position[:3]) == [100 + len(host.simulator.moves()[0]), -200, 300]
