"""Opening the port of a board leaves DTR as it is, so that the board keeps its position."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from cnc.boards import serial_port
from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.serial_port import SerialLink, identity, open_port
from cnc.simulators.grbl.firmware_profile import GRBLHAL
from cnc.simulators.grbl.grbl_simulator import BOOT_TIME, GrblSimulator, Unplug
from cnc.simulators.grbl.ports import GrblSimulatorPort, PtyServer
from tests.support.boards.grbl_rig import MACHINE
from tests.support.waiting import HANG, wait_until

FAST = {110: 5000.0, 111: 5000.0, 112: 5000.0, 120: 500.0, 121: 500.0, 122: 500.0}
GREETING = b"help]\r\n"
TERMINALS = pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals here")


def listen(port: GrblSimulatorPort, seconds: float) -> bytes:
    said, end = b"", port.clock.now() + seconds
    while port.clock.now() < end:
        said += port.read(0.05)
    return said


def moved(simulator: GrblSimulator) -> None:
    """Open a port that keeps DTR up, move to X5, set offsets in both memories, and close it."""
    port = GrblSimulatorPort(simulator, hang_up=False)
    listen(port, BOOT_TIME + 0.2)
    port.write(b"G0X5\nG92X1\nG10L2P2Y3\n")
    assert listen(port, 5.0).count(b"ok") == 3
    assert simulator.position == (5.0, 0.0, 0.0)
    port.close()


# The simulator


def test_only_a_rise_of_dtr_resets_the_simulator() -> None:
    simulator = GrblSimulator(settings=FAST)
    moved(simulator)
    again = GrblSimulatorPort(simulator)
    again.write(b"?")
    assert b"MPos:5.000" in listen(again, 0.2)
    again.close()
    last = GrblSimulatorPort(simulator)
    last.write(b"?G0X9\n")
    assert listen(last, 1.0) == b"", "the boot loader's silence"
    assert GREETING in listen(last, 1.0)
    last.write(b"?")
    assert b"MPos:0.000" in listen(last, 2.0), "bytes sent to the boot loader are lost"
    assert simulator.position == (0.0, 0.0, 0.0)
    assert simulator.core.environment.offset == (-95.0, -100.0, -100.0), (
        "the tool stands where it stood"
    )
    assert simulator.core.shift == (0.0, 0.0, 0.0)
    assert simulator.core.eeprom.systems["G55"][1] == 3.0


def test_an_unplugged_board_restarts() -> None:
    simulator = GrblSimulator(settings=FAST)
    moved(simulator)
    simulator.inject(Unplug())
    assert GREETING in listen(GrblSimulatorPort(simulator), 3.0)
    assert simulator.position == (0.0, 0.0, 0.0)


# The port


def heard(link: SerialLink, until: bytes) -> bytes:
    said, end = b"", time.monotonic() + HANG
    while until not in said and time.monotonic() < end:
        said += link.read(0.1)
    return said


@TERMINALS
def test_a_second_opening_does_not_reset_the_board() -> None:
    with PtyServer(GrblSimulator(settings=FAST), 10.0) as server:
        link = open_port(server.name, 115200)
        assert GREETING in heard(link, GREETING)
        link.write(b"G1X5F3000\nG4P0\n")
        heard(link, b"ok\r\nok\r\n")
        link.close()
        wait_until(lambda: not server.is_open)
        link = open_port(server.name, 115200)
        link.write(b"?")
        assert b"MPos:5.000" in heard(link, b">")
        link.close()


@TERMINALS
def test_a_program_that_drops_dtr_resets_the_simulator_at_a_terminal() -> None:
    import termios

    with PtyServer(GrblSimulator(settings=FAST), 10.0) as server:
        link = open_port(server.name, 115200)
        heard(link, GREETING)
        link.close()
        wait_until(lambda: not server.is_open)
        other = os.open(server.name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        settings = termios.tcgetattr(other)
        settings[2] |= termios.HUPCL
        termios.tcsetattr(other, termios.TCSANOW, settings)
        wait_until(lambda: server.is_open)
        os.close(other)
        wait_until(lambda: not server.is_open)
        link = open_port(server.name, 115200)
        assert GREETING in heard(link, GREETING)
        link.close()


class Opened:
    """The object of pyserial on Windows, with its modem lines at the opening of the port."""

    def __init__(self) -> None:
        self.dtr = self.rts = True
        self.at_opening: tuple[bool, bool] | None = None

    def __setattr__(self, name: str, value: object) -> None:
        if name in ("dtr", "rts") and getattr(self, "at_opening", None) is not None:
            raise AssertionError("a line is changed while the port is open")
        object.__setattr__(self, name, value)

    def open(self) -> None:
        self.at_opening = self.dtr, self.rts

    def fileno(self) -> int:
        raise OSError("no file")


@pytest.mark.parametrize(
    ("lowered", "name", "lines"),
    [
        (True, "COM3", (False, False)),
        (True, "rfc2217://host:1", (True, True)),
        (False, "/dev/ttyUSB0", (True, True)),
    ],
)
def test_opening_toggles_no_modem_line(
    monkeypatch: pytest.MonkeyPatch, lowered: bool, name: str, lines: tuple[bool, bool]
) -> None:
    """On Windows they are down from the first opening on; elsewhere they stay as they are."""
    opened = Opened()
    monkeypatch.setattr(serial_port, "LINES_LOW", lowered)
    monkeypatch.setattr("serial.serial_for_url", lambda *_, **__: opened)
    open_port(name, 115200)
    assert opened.at_opening == lines


# Which board


@TERMINALS
def test_each_terminal_is_a_board_of_its_own() -> None:
    with PtyServer(GrblSimulator()) as server:
        name, first = server.name, identity(server.name)
        link = open_port(name, 115200)
        link.write(b"?")
        link.close()
        assert identity(name) == first
        created = os.stat(name).st_ctime_ns
    # The kernel's clock for files has ticks of some ms: the next terminal must be of a later one.
    while True:
        with PtyServer(GrblSimulator()) as server:
            if os.stat(server.name).st_ctime_ns > created:
                assert identity(server.name) != first
                break


@TERMINALS
def test_a_board_is_identified_by_serial_number_or_port(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    device, link = tmp_path / "ttyACM0", tmp_path / "usb-Arduino-if00"
    device.touch()
    link.symlink_to(device)

    def numbered(number: str | None) -> None:
        found = [SimpleNamespace(device=str(device), description="", serial_number=number)]
        monkeypatch.setattr("serial.tools.list_ports.comports", lambda: found)

    numbered("7543")
    assert identity(str(link)) == identity(str(device)) == "usb 7543"
    numbered(None)
    assert identity(str(link)) == identity(str(device)) == str(device)
    assert identity("socket://host:23") == "socket://host:23"


def test_windows_does_not_distinguish_capitals(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [SimpleNamespace(device="COM3", description="", serial_number="7543")]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: found)
    monkeypatch.setattr("os.path.normcase", str.lower)
    assert identity("com3") == identity("COM3") == "usb 7543"
    assert identity("com4") == identity("COM4")


# The driver


def connected(simulator: GrblSimulator) -> GrblBoard:
    port = GrblSimulatorPort(simulator, hang_up=False)
    board = GrblBoard(port, MACHINE, port.clock, "the simulator")
    board.connect()
    return board


def test_a_restart_at_opening_is_detected() -> None:
    simulator = GrblSimulator(settings=FAST)
    assert connected(simulator).restarted
    moved(simulator)
    board = connected(simulator)
    assert not board.restarted
    assert board.position == (5.0, 0.0, 0.0)
    simulator.power_up()
    assert connected(simulator).restarted


def test_a_welcome_without_a_restart_is_not_a_restart() -> None:
    """grblHAL greets each new network connection."""
    simulator = GrblSimulator(GRBLHAL, settings=FAST)
    moved(simulator)
    simulator.core.say(GRBLHAL.banner)
    board = connected(simulator)
    assert board.link.greeted_unasked
    assert not board.restarted
    assert board.position == (5.0, 0.0, 0.0)


class NativeUsb:
    """A board that sends only while DTR is up, where opening its port leaves DTR down."""

    def __init__(self, simulator: GrblSimulator) -> None:
        self.port = GrblSimulatorPort(simulator, lowered=True)
        self.clock = self.port.clock

    def read(self, timeout: float) -> bytes:
        said = self.port.read(timeout)
        return said if self.port.simulator.dtr else b""

    def write(self, data: bytes) -> None:
        self.port.write(data)

    def raise_lines(self) -> bool:
        # The line is no reset to it.
        self.port.simulator.dtr = True
        return True

    def close(self) -> None:
        self.port.close()


def test_a_board_that_needs_dtr_is_found() -> None:
    simulator = GrblSimulator(settings=FAST)
    moved(simulator)
    port = NativeUsb(simulator)
    board = GrblBoard(port, MACHINE, port.clock, "the simulator")
    board.connect()
    assert not board.restarted
    assert board.position == (5.0, 0.0, 0.0)


def test_dtr_stays_down_for_a_board_that_answers() -> None:
    simulator = GrblSimulator(settings=FAST)
    moved(simulator)
    port = GrblSimulatorPort(simulator, lowered=True)
    board = GrblBoard(port, MACHINE, port.clock, "the simulator")
    board.connect()
    assert not simulator.dtr
    assert board.position == (5.0, 0.0, 0.0)


def test_only_lowered_lines_are_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    for lowered in (False, True):
        opened = Opened()
        monkeypatch.setattr(serial_port, "LINES_LOW", lowered)
        monkeypatch.setattr("serial.serial_for_url", lambda *_, opened=opened, **__: opened)
        link = open_port("COM3", 115200)
        if not lowered:
            link.raise_lines()
            continue
        opened.at_opening = None
        link.raise_lines()
        assert opened.dtr and opened.rts
