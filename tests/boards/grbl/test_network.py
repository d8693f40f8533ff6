"""Boards at a network port (``socket://host:port``): GRBL, grblHAL and FluidNC."""

import contextlib
import select
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from cnc.boards.discovery import port_report, probe_ports
from cnc.boards.grbl.driver import GrblBoard
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError
from cnc.session.session import Session
from cnc.simulators.grbl.firmware_profile import (
    FLUIDNC,
    GRBL,
    GRBLHAL,
    FirmwareProfile,
    settings_of,
)
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import LONGEST_SLEEP, ScaledTime

MACHINE = load_machine("grbl-uno")
FASTER = 20.0
"""How many times as fast as a real board the simulated one moves."""


class NetworkServer:
    """A board behind a TCP port, as an ESP32 or a serial server makes it. It is not reset.

    Args:
        simulator: The board, which has started.
    """

    def __init__(self, simulator: GrblSimulator) -> None:
        self.simulator = simulator
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self._listener.close()

    def _serve(self) -> None:
        clock = ScaledTime(self.simulator, FASTER)
        while not self._ended.is_set():
            if not select.select([self._listener], [], [], 0.05)[0]:
                continue
            host, _ = self._listener.accept()
            with host, contextlib.suppress(OSError):
                while not self._ended.is_set():
                    clock.catch_up()
                    if select.select([host], [], [], LONGEST_SLEEP)[0]:
                        data = host.recv(4096)
                        if not data:
                            break
                        self.simulator.write(data)
                    host.sendall(self.simulator.read())


@pytest.fixture(params=[GRBL, GRBLHAL, FLUIDNC], ids=lambda profile: profile.name)
def server(request: pytest.FixtureRequest) -> Iterator[NetworkServer]:
    profile: FirmwareProfile = request.param
    simulator = GrblSimulator(profile, settings=settings_of(MACHINE))
    simulator.raise_dtr()
    simulator.advance(3.0)
    simulator.read()
    running = NetworkServer(simulator)
    yield running
    running.close()


def machine_at(server: NetworkServer) -> Machine:
    return MACHINE.model_copy(
        update={"board": MACHINE.board.model_copy(update={"port": server.port})}
    )


def test_a_program_is_streamed_over_the_network(server: NetworkServer, tmp_path: Path) -> None:
    moves = [f"X{k % 9 * 0.3:.3f} Y{k % 5 * 0.4:.3f}" for k in range(60)]
    program = ["G21 G90 G94", "G1 X0 F2000", *moves, "G2 I2 J2", "G4 P0.1", "G1 X1.5 Y-2", "M2"]
    (tmp_path / "p.nc").write_text("\n".join(program) + "\n")
    machine = machine_at(server)
    board = GrblBoard.from_machine(machine)
    try:
        report = Session(str(tmp_path / "p.nc"), machine).run(board, "grbl")
    finally:
        board.close()
    assert report.ok, report.faults
    names = {"grbl": "GRBL", "grblhal": "grblHAL", "fluidnc": "FluidNC"}
    assert board.info.firmware.startswith(names[server.simulator.core.profile.name])
    assert server.simulator.position == pytest.approx((1.5, -2.0, 0.0), abs=0.003)
    assert not server.simulator.lost


@pytest.mark.parametrize("server", [FLUIDNC], indirect=True)
def test_fluidnc_tells_no_settings_by_number(server: NetworkServer) -> None:
    """So there is no machine file; the report says where the settings are."""
    (found,) = probe_ports([server.port], 115200)
    lines = list(port_report(found, 115200))
    assert lines[-1].startswith("# no machine file: FluidNC keeps its settings in a file")


def test_a_laser_on_fluidnc_needs_no_setting(server: NetworkServer) -> None:
    """FluidNC has no $32: the file of its settings says that the spindle is a laser."""
    laser = machine_at(server).model_copy(update={"kind": "laser"})
    board = GrblBoard.from_machine(laser)
    try:
        if server.simulator.core.profile is FLUIDNC:
            assert board.limited_to_board(laser).kind == "laser"
        else:
            with pytest.raises(BoardError, match="laser-mode-off"):
                board.limited_to_board(laser)
    finally:
        board.close()


def test_a_second_connection_keeps_the_position(server: NetworkServer, tmp_path: Path) -> None:
    (tmp_path / "p.nc").write_text("G21 G91\nG1 X1 F2000\nM2\n")
    machine = machine_at(server)
    for expected in (1.0, 2.0):
        board = GrblBoard.from_machine(machine)
        try:
            report = Session(str(tmp_path / "p.nc"), machine).run(board, "grbl")
        finally:
            board.close()
        assert report.ok, report.faults
        assert report.end_position["x"] == pytest.approx(expected, abs=0.003)
