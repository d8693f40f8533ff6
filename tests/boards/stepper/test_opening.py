"""Faults of a stepper board before anything moves: each has a clear error."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cnc.boards.registry import board_names, open_board
from cnc.boards.stepper.driver import Stepper
from cnc.boards.stepper.protocol import Kind, frame, unframed
from cnc.machine.models import Axis
from cnc.model.diagnostics import BoardError, UsageError
from tests.support.boards.stepper_rig import board, machine
from tests.support.boards.stepper_simulator import Simulator, SimulatorPort


class Peer:
    """Another device on the port, which always gives the same answer."""

    def __init__(self, words: bytes) -> None:
        self.words = words
        self.time = 0.0
        self.waiting = b""
        self.heard = b""

    def read(self, timeout: float) -> bytes:
        self.time += timeout if not self.waiting else 0.0
        said, self.waiting = self.waiting, b""
        return said

    def write(self, data: bytes) -> None:
        self.heard += data
        self.waiting += self.words

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        self.time += seconds


def welcome(version: int = 1, axes: int = 3, least: int = 36) -> bytes:
    return frame(
        Kind.WELCOME,
        0,
        b"cnc" + bytes((version, axes, 0xF4, 1, 0xFC, 3, least & 255, least >> 8, 0, 0)),
    )


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (b"", "board-silent"),
        (b"\r\nGrbl 1.1h ['$' for help]\r\n", "board-not-stepper"),
        (b"\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n", "board-not-stepper"),
        (b"ok\r\n", "board-not-stepper"),
        (bytes(range(1, 200)) * 3, "board-not-stepper"),
        (b"\0" * 50, "board-not-stepper"),
        (welcome(version=2), "board-version"),
        (frame(Kind.WELCOME, 0, b"cnc\x07"), "board-version"),
        (welcome(axes=4), "board-axes"),
        (welcome(least=2000), "board-step-rate"),
    ],
)
def test_unsuitable_boards_are_reported(words: bytes, code: str) -> None:
    peer = Peer(words)
    with pytest.raises(BoardError) as caught:
        Stepper(peer, machine(), "PORT", clock=peer)
    assert caught.value.diagnostic.code == code
    assert caught.value.diagnostic.hint
    assert peer.time < 5.0
    sent = [unframed(each) for each in peer.heard.split(b"\0") if each]
    assert all(each is not None and each[0] == Kind.HELLO for each in sent), (
        "nothing but hellos before it is known what answers"
    )


@pytest.fixture
def simulator() -> Iterator[Simulator]:
    made = Simulator()
    yield made
    made.close()


@pytest.mark.parametrize(("pin", "code"), [(14, "board-emergency-stop"), (10, "board-limit")])
def test_pressed_switch_is_reported(simulator: Simulator, pin: int, code: str) -> None:
    """The error comes before anything moves.

    A limit switch does not prevent homing, so it counts from the start of a program.
    """
    simulator.set_pin(pin, 0)
    port = SimulatorPort(simulator)
    with pytest.raises(BoardError) as caught:
        Stepper(port, machine(), "PORT", clock=port).start(np.zeros(3, np.int64))
    assert caught.value.diagnostic.code == code
    assert not len(simulator.moves()[0])


def test_fourth_axis(simulator: Simulator) -> None:
    axes = machine().axes
    port = SimulatorPort(simulator)
    with pytest.raises(BoardError) as caught:
        Stepper(port, machine(axes={**axes, "a": axes["x"]}), "PORT", clock=port)
    assert caught.value.diagnostic.code == "board-axes"


def test_axes_in_another_order_are_refused(simulator: Simulator) -> None:
    """Each axis would turn the motor of another."""
    axes = machine().axes
    port = SimulatorPort(simulator)
    with pytest.raises(BoardError) as caught:
        Stepper(
            port,
            machine(axes={letter: axes[letter] for letter in ("x", "z", "y")}),
            "PORT",
            clock=port,
        )
    assert caught.value.diagnostic.code == "board-axes"
    assert "X Z Y" in caught.value.diagnostic.message


def test_too_fast_axis_is_refused(simulator: Simulator) -> None:
    axes = machine().axes
    port = SimulatorPort(simulator)
    fast = Axis(steps_per_mm=400, max_velocity=200, max_acceleration=400, max_jerk=15000)
    with pytest.raises(BoardError) as caught:
        Stepper(port, machine(axes={**axes, "x": fast}), "PORT", clock=port)
    assert caught.value.diagnostic.code == "board-step-rate"
    assert "80000" in caught.value.diagnostic.message


def test_board_is_opened_after_a_reset(simulator: Simulator) -> None:
    """An Uno is reset when its port is opened, and loses the bytes of the next moments."""
    port = SimulatorPort(simulator)
    write = port.write
    port.write = lambda data: write(data) if simulator.now > 1.6 else None  # type: ignore[method-assign]
    with_board = Stepper(port, machine(), "PORT", clock=port)
    assert with_board.known_steps == (None, None, None)
    with_board.close()


def test_position_survives_a_new_host_but_not_a_reset(simulator: Simulator) -> None:
    with board(simulator) as driver:
        driver.start(np.array([100, -200, 300]))
        driver.finish()
    with board(simulator) as driver:
        assert driver.known_steps == (100, -200, 300)
    simulator.reset()
    with board(simulator) as driver:
        assert driver.known_steps == (None, None, None)


def test_port_must_be_named_and_exist(tmp_path: Path) -> None:
    assert "stepper" in board_names()
    with pytest.raises(UsageError) as caught:
        open_board(machine(), kind="stepper")
    assert caught.value.diagnostic.code == "no-port"
    with pytest.raises(BoardError) as missing:
        open_board(machine(), kind="stepper", target=tmp_path / "ttyUSB7")
    assert missing.value.diagnostic.code == "no-such-port"
