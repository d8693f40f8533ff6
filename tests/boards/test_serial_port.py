"""Ports: bytes go both ways over a pseudo-terminal and a socket, and whatever is wrong with a port
is said in our words.
"""

from __future__ import annotations

import errno
import os
import pty
import select
import socket
import tty
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.boards import serial_port
from cnc.boards.port import PortLost, SystemClock
from cnc.boards.serial_port import open_port
from cnc.model.diagnostics import BoardError
from tests.support.waiting import HANG


class Pty:
    """A pseudo-terminal; the board's end is ``master``."""

    def __init__(self) -> None:
        self.master, self.slave = pty.openpty()
        tty.setraw(self.master)
        self.name = os.ttyname(self.slave)

    def pull(self) -> None:
        """Take the board away."""
        for end in (self.master, self.slave):
            if end >= 0:
                os.close(end)
        self.master = self.slave = -1


@pytest.fixture
def line() -> Iterator[Pty]:
    opened = Pty()
    yield opened
    opened.pull()


@settings(max_examples=25)
@given(st.binary(min_size=1, max_size=600))
def test_all_bytes_arrive_in_both_directions(data: bytes) -> None:
    line = Pty()
    port = open_port(line.name, 115200)
    try:
        port.write(data)
        arrived = b""
        while len(arrived) < len(data):
            arrived += os.read(line.master, 4096)
        os.write(line.master, arrived)
        back = b""
        while len(back) < len(data):
            more = port.read(1.0)
            assert more
            back += more
        assert back == data
    finally:
        port.close()
        line.pull()


def test_read_returns_after_its_timeout(line: Pty, monkeypatch: pytest.MonkeyPatch) -> None:
    port = open_port(line.name, 115200)
    clock, waits = SystemClock(), []

    def selected(*arguments: Any) -> Any:
        waits.append(arguments[-1])
        return select.select(*arguments)

    monkeypatch.setattr(serial_port, "select", SimpleNamespace(select=selected))
    began = clock.now()
    assert port.read(0.05) == b""
    assert clock.now() - began >= 0.045
    assert waits == [0.05]
    assert port.read(0.0) == b""
    assert waits == [0.05], "no wait"
    assert port._serial.timeout == 0, "nor one of pyserial"
    port.close()
    port.close()


@pytest.mark.timeout(HANG)
def test_read_returns_when_bytes_arrive(line: Pty) -> None:
    port = open_port(line.name, 115200)
    os.write(line.master, b"ok\r\n")
    assert port.read(2.0 * HANG) == b"ok\r\n"
    port.close()


@pytest.mark.timeout(HANG)
def test_disconnected_cable_is_reported_at_once(line: Pty) -> None:
    port = open_port(line.name, 115200)
    line.pull()
    with pytest.raises(PortLost) as caught:
        port.read(2.0 * HANG)
    assert caught.value.diagnostic.code == "port-lost"
    assert caught.value.exit_code == 3
    with pytest.raises(PortLost):
        port.write(b"?")
    port.close()


def test_socket_can_be_a_port() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = open_port(f"socket://127.0.0.1:{server.getsockname()[1]}", 115200)
        peer, _ = server.accept()
        with peer:
            port.write(b"$I\n")
            assert peer.recv(10) == b"$I\n"
            peer.sendall(b"ok\r\n")
            assert port.read(1.0) == b"ok\r\n"
        with pytest.raises(PortLost):
            port.read(1.0)
        port.close()


def test_missing_port_is_reported(tmp_path: Path) -> None:
    fails(str(tmp_path / "ttyUSB7"), "no-such-port")


def test_port_in_use_is_reported(line: Pty) -> None:
    port = open_port(line.name, 115200)
    fails(line.name, "port-taken")
    port.close()
    open_port(line.name, 115200).close()


def test_file_is_not_a_port(tmp_path: Path) -> None:
    file = tmp_path / "program.nc"
    file.write_text("G0 X0\n")
    fails(str(file), "port-not-usable")
    fails("nonsense://here", "port-not-usable")
    assert file.read_text() == "G0 X0\n"


def test_refused_socket_is_reported() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        free = server.getsockname()[1]
    fails(f"socket://127.0.0.1:{free}", "port-not-usable")


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (OSError(errno.ENODEV, "No such device"), "no-such-port"),
        (OSError(errno.EBUSY, "Device or resource busy"), "port-taken"),
        (OSError(errno.EACCES, "Permission denied"), "port-not-permitted"),
        (OSError(errno.EPERM, "Operation not permitted"), "port-not-permitted"),
        (OSError(errno.EIO, "Input/output error"), "port-not-usable"),
        (
            OSError(
                "could not open port 'COM9': FileNotFoundError(2, "
                "'The system cannot find the file specified.', None, 2)"
            ),
            "no-such-port",
        ),
        (
            OSError(
                "could not open port 'COM3': PermissionError(13, 'Access is denied.', None, 5)"
            ),
            "port-taken",
        ),
    ],
)
def test_system_errors_become_faults(
    error: OSError, code: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("serial.serial_for_url", refuse)
    fails("/dev/ttyUSB0", code)


def test_hint_lists_the_ports_of_the_computer(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(
        serial_port, "found_ports", lambda: [serial_port.FoundPort("/dev/ttyACM0", "Arduino Uno")]
    )
    with pytest.raises(BoardError) as caught:
        open_port(str(tmp_path / "none"), 115200)
    assert "/dev/ttyACM0" in caught.value.diagnostic.hint


def test_ports_are_sorted() -> None:
    names = [port.name for port in serial_port.found_ports()]
    assert names == sorted(names)


def fails(name: str, code: str) -> None:
    with pytest.raises(BoardError) as caught:
        open_port(name, 115200)
    assert caught.value.diagnostic.code == code
    assert caught.value.diagnostic.hint
    assert caught.value.exit_code == 3


@pytest.fixture
def two_boards(monkeypatch: pytest.MonkeyPatch) -> None:
    from serial.tools import list_ports
    from serial.tools.list_ports_common import ListPortInfo

    def device(name: str, number: str | None) -> ListPortInfo:
        info = ListPortInfo(name)
        info.serial_number, info.description = number, "USB Serial"
        return info

    listed = [device("/dev/ttyUSB7", "A1"), device("/dev/ttyUSB3", "B2"), device("/dev/x", "C3")]
    listed += [device("/dev/ttyS0", None), device("/dev/y", "C3")]
    monkeypatch.setattr(list_ports, "comports", lambda: listed)


@pytest.mark.usefixtures("two_boards")
def test_a_board_is_found_by_its_serial_number() -> None:
    assert serial_port.port_of("usb:A1") == "/dev/ttyUSB7"
    assert serial_port.port_of("/dev/ttyUSB3") == "/dev/ttyUSB3"
    assert serial_port.identity("usb:B2") == serial_port.identity("/dev/ttyUSB3")


@pytest.mark.usefixtures("two_boards")
@pytest.mark.parametrize(
    ("name", "said"), [("usb:Z9", "no device has"), ("usb:C3", "several devices have")]
)
def test_a_serial_number_that_names_no_single_port_is_refused(name: str, said: str) -> None:
    with pytest.raises(BoardError) as caught:
        serial_port.open_port(name, 115200)
    assert caught.value.diagnostic.code == "no-such-port"
    assert said in caught.value.diagnostic.message


@pytest.mark.usefixtures("two_boards")
def test_the_machine_file_names_the_board_by_its_number(monkeypatch: pytest.MonkeyPatch) -> None:
    from cnc.boards import discovery
    from cnc.boards.discovery import port_report, probe_ports
    from cnc.simulators.grbl.grbl_simulator import GrblSimulator
    from cnc.simulators.grbl.ports import GrblSimulatorPort

    port = GrblSimulatorPort(GrblSimulator())
    monkeypatch.setattr(discovery, "open_port", lambda name, baud: port)
    monkeypatch.setattr(discovery, "SystemClock", lambda: port.clock)
    (found,) = probe_ports(["/dev/ttyUSB7"])
    text = "\n".join(port_report(found))
    assert "serial number A1" in text
    assert 'port = "usb:A1"' in text
