"""A GRBL board at a port of Windows: pyserial waits there, and no modem line is ever raised."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.api import run
from cnc.boards import serial_port
from cnc.boards.grbl.driver import GrblBoard
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort
from tests.support.boards.grbl_rig import MACHINE
from tests.support.session.position_runs import END, FAST, SQUARE


class WindowsSerial:
    """The object of pyserial on Windows: no file, and each change of a setting is a request.

    Opening applies the modem lines that were set before; closing lowers them.
    """

    def __init__(self, port: GrblSimulatorPort) -> None:
        self.dtr = self.rts = True
        self.is_open = False
        self.requests: list[str] = []
        self._port, self._received, self._timeout = port, bytearray(), 0.0
        self._baud = 115200

    def open(self) -> None:
        if self.dtr or self.rts:
            self._port.simulator.raise_dtr()
        self.is_open = True

    def close(self) -> None:
        self.is_open = False

    def fileno(self) -> int:
        raise OSError("a handle of Windows is no file")

    @property
    def timeout(self) -> float:
        return self._timeout

    @timeout.setter
    def timeout(self, seconds: float) -> None:
        self.requests.append(f"timeout {seconds:g}")
        self._timeout = seconds

    @property
    def baudrate(self) -> int:
        return self._baud

    @baudrate.setter
    def baudrate(self, baud: int) -> None:
        self.requests.append(f"baud {baud}")
        self._baud = baud

    @property
    def in_waiting(self) -> int:
        self._received += self._port.read(0.0)
        return len(self._received)

    def reset_input_buffer(self) -> None:
        self._received.clear()

    def read(self, size: int) -> bytes:
        if not self._received:
            self._received += self._port.read(self._timeout)
        found, self._received = bytes(self._received[:size]), self._received[size:]
        return found

    def write(self, data: bytes) -> int:
        self._port.write(data)
        return len(data)


def opened(
    monkeypatch: pytest.MonkeyPatch, simulator: GrblSimulator
) -> tuple[WindowsSerial, GrblBoard]:
    """Return the port of a simulator that is switched on, and the driver at it."""
    port = GrblSimulatorPort(simulator, lowered=True)
    made = WindowsSerial(port)
    monkeypatch.setattr(serial_port, "LINES_LOW", True)
    monkeypatch.setattr("serial.serial_for_url", lambda *_, **__: made)
    link = serial_port.open_port("COM3", 115200)
    return made, GrblBoard(link, MACHINE, port.clock, "COM3", identity="COM3")


def test_two_programs_in_a_row_run_without_a_reset(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    program = tmp_path / "p.ngc"
    program.write_text(SQUARE)
    simulator = GrblSimulator(settings=FAST)
    for _ in range(2):
        made, board = opened(monkeypatch, simulator)
        board.connect()
        assert run(program, MACHINE, board=board).ok
        assert simulator.position == pytest.approx(END)
        assert not (made.dtr or made.rts)
        # Each change of the timeout is a request to the device.
        assert len(made.requests) <= 4
        board.close()
        assert not made.is_open
    assert not [each for each in simulator.events if (each.kind, each.value) == ("reset", "power")]


def test_a_change_of_the_speed_raises_no_line(monkeypatch: pytest.MonkeyPatch) -> None:
    simulator = GrblSimulator(settings=FAST)
    made, _ = opened(monkeypatch, simulator)
    link = serial_port.open_port("COM3", 115200)
    made.requests.clear()
    link.change_baud(57600)
    assert made.requests == ["baud 57600"]
    assert not (made.dtr or made.rts)
