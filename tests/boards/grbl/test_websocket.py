"""Boards at a WebSocket (``ws://host:port``): FluidNC in binary frames, grblHAL in text frames."""

from __future__ import annotations

import builtins
import contextlib
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import Server, ServerConnection, serve

from cnc.boards.discovery import port_report, probe_ports
from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.serial_port import open_port
from cnc.machine.load import load_machine
from cnc.model.diagnostics import BoardError
from cnc.session.session import Session
from cnc.simulators.grbl.firmware_profile import FLUIDNC, GRBLHAL, FirmwareProfile, settings_of
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import LONGEST_SLEEP, ScaledTime

MACHINE = load_machine("grbl-uno")
FASTER = 5.0
"""How many times as fast as a real board the simulated one moves."""
PAGE_MESSAGES = ("currentID:3", "CURRENT_ID:3", "PING\n")
"""What FluidNC sends to its web page."""


class Board:
    """A simulated board, which has started, behind a WebSocket."""

    def __init__(self, profile: FirmwareProfile) -> None:
        self.simulator = GrblSimulator(profile, settings=settings_of(MACHINE))
        self.simulator.raise_dtr()
        self.simulator.advance(3.0)
        self.simulator.read()
        self.unplugged = threading.Event()
        self._text = profile is GRBLHAL
        self._server: Server = serve(self._connected, "127.0.0.1", 0)
        self.port = f"ws://127.0.0.1:{self._server.socket.getsockname()[1]}"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._server.shutdown()
        self._thread.join()

    def _connected(self, host: ServerConnection) -> None:
        for message in PAGE_MESSAGES:
            host.send(message)
        clock = ScaledTime(self.simulator, FASTER)
        with contextlib.suppress(ConnectionClosed):
            while not self.unplugged.is_set():
                with contextlib.suppress(TimeoutError):
                    data = host.recv(timeout=LONGEST_SLEEP)
                    assert isinstance(data, bytes)
                    self.simulator.write(data)
                clock.catch_up()
                if answer := self.simulator.read():
                    host.send(answer.decode("ascii") if self._text else answer)


@pytest.fixture(params=[FLUIDNC, GRBLHAL], ids=lambda profile: profile.name)
def server(request: pytest.FixtureRequest) -> Iterator[Board]:
    board = Board(request.param)
    yield board
    board.close()


def connected(server: Board) -> GrblBoard:
    place = MACHINE.board.model_copy(update={"port": server.port})
    return GrblBoard.from_machine(MACHINE.model_copy(update={"board": place}))


def test_a_program_is_streamed(server: Board, tmp_path: Path) -> None:
    moves = [f"X{k % 9 * 0.3:.3f} Y{k % 5 * 0.4:.3f}" for k in range(40)]
    program = ["G21 G90 G94", "G1 X0 F2000", *moves, "G2 I2 J2", "G1 X1.5 Y-2", "M2"]
    (tmp_path / "p.nc").write_text("\n".join(program) + "\n")
    board = connected(server)
    try:
        report = Session(str(tmp_path / "p.nc"), MACHINE).run(board, "grbl")
    finally:
        board.close()
    assert report.ok, report.faults
    assert server.simulator.position == pytest.approx((1.5, -2.0, 0.0), abs=0.005)


def test_real_time_commands_above_ascii_arrive(server: Board) -> None:
    board = connected(server)
    try:
        board.link.write(b"\x91")
        assert board.link.until(
            lambda event: server.simulator.core.planner.feed_override == 110, 5.0
        )
    finally:
        board.close()


def test_the_board_is_recognised(server: Board) -> None:
    (answer,) = probe_ports([server.port])
    assert server.simulator.core.profile.version in "\n".join(port_report(answer))


def test_a_lost_connection_is_reported(server: Board) -> None:
    board = connected(server)
    server.unplugged.set()
    with pytest.raises(BoardError) as lost:
        board.link.until(lambda event: False, 5.0)
    assert lost.value.diagnostic.code == "port-lost"
    board.close()


def test_a_port_without_a_websocket_is_not_usable() -> None:
    with pytest.raises(BoardError) as refused:
        open_port("ws://127.0.0.1:9", 115200)
    assert refused.value.diagnostic.code == "port-not-usable"


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    imported = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name.startswith("websockets"):
            raise ImportError(name=name)
        return imported(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(BoardError) as missing:
        open_port("ws://127.0.0.1:9", 115200)
    assert missing.value.diagnostic.code == "websocket-missing"
