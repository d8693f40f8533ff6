"""The command ``cncrun boards``: devices at ports, and the machine file from GRBL's settings."""

from __future__ import annotations

import socket
import sys
from pathlib import Path

import pytest

from cnc.api import check
from cnc.boards import discovery
from cnc.boards.discovery import FoundBoard, port_report
from cnc.boards.grbl.link import machine_file
from cnc.boards.grbl.messages import Firmware
from cnc.boards.grbl.settings import BoardInfo
from cnc.boards.stepper.protocol import VERSION, Welcome
from cnc.boards.stepper.protocol import State as StepperState
from cnc.cli import exit_code
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import PtyServer

SETTINGS = {
    100: 250,
    101: 400,
    102: 800,
    110: 6000,
    111: 3000,
    112: 600,
    120: 500,
    121: 250,
    122: 50,
    130: 300,
    131: 180,
    132: 45,
    11: 0.02,
    12: 0.005,
    22: 1,
}


def loaded(text: str, folder: Path) -> Machine:
    file = folder / "mill.toml"
    file.write_text(text)
    return load_machine(file)


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals")
def test_the_output_is_a_machine_file(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    with PtyServer(
        GrblSimulator(settings={number: float(value) for number, value in SETTINGS.items()}), 4.0
    ) as server:
        assert exit_code(["boards", server.name]) == 0
    text = capsys.readouterr().out
    assert "GRBL 1.1h" in text
    assert "# $110 = 6000.000  X highest rate, mm/min" in text
    machine = loaded(text, tmp_path)
    x, y, z = machine.axes.values()
    assert (x.steps_per_mm, y.steps_per_mm, z.steps_per_mm) == (250.0, 400.0, 800.0)
    assert (x.max_velocity, y.max_velocity, z.max_velocity) == pytest.approx((100.0, 50.0, 10.0))
    assert (x.max_acceleration, y.max_acceleration, z.max_acceleration) == (500.0, 250.0, 50.0)
    assert (x.travel, y.travel, z.travel) == ((-300.0, 0.0), (-180.0, 0.0), (-45.0, 0.0))
    assert (machine.path.chord_error, machine.path.tolerance) == (0.005, 0.02)
    assert (machine.board.kind, machine.board.port) == ("grbl", server.name)


def test_missing_settings_are_an_error() -> None:
    with pytest.raises(BoardError) as caught:
        machine_file("COM3", BoardInfo("1.1h", Firmware.GRBL), 115200)
    assert caught.value.diagnostic.code == "board-settings"


def described(**settings: float) -> BoardInfo:
    """Return a board with changed settings, each as S22=1.0."""
    changed = {int(name[1:]): value for name, value in settings.items()}
    values = {number: str(value) for number, value in (SETTINGS | changed).items()}
    return BoardInfo("1.1h", Firmware.GRBL, settings=values)


def test_a_machine_that_does_not_home_has_no_travel(tmp_path: Path) -> None:
    text = machine_file("COM3", described(S22=0), 115200)
    machine = loaded(text, tmp_path)
    assert [axis.travel for axis in machine.axes.values()] == [None, None, None]
    assert "does not home" in text
    # A program that counts from where the tool stands is within any travel.
    assert check(Path(__file__).parents[2] / "programs" / "trident.nc", machine).ok


@pytest.mark.parametrize(("laser_mode", "kind"), [(0, "mill"), (1, "laser")])
def test_laser_mode_makes_the_machine_a_laser(laser_mode: float, kind: str, tmp_path: Path) -> None:
    text = machine_file("COM3", described(S32=laser_mode), 115200)
    assert loaded(text, tmp_path).kind == kind


def test_names_are_quoted(tmp_path: Path) -> None:
    info = BoardInfo(
        '1.1h"\n[axes',
        Firmware.HAL,
        settings={number: str(value) for number, value in SETTINGS.items()},
    )
    machine = loaded(machine_file('C:\\x"', info, 9600), tmp_path)
    assert machine.board.port == 'C:\\x"'
    assert machine.board.baud == 9600


def test_a_missing_port_is_named_and_gives_exit_code_3(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert exit_code(["boards", str(tmp_path / "ttyUSB0")]) == 3
    shown = capsys.readouterr()
    assert shown.out.splitlines()[1].startswith("# there is no port")
    assert "no-such-port" in shown.err


def test_another_device_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        import threading

        def talk() -> None:
            peer, _ = server.accept()
            with peer:
                # when it is asked: what comes while the port is opened is dropped
                peer.recv(64)
                peer.sendall(b"start\r\necho:Marlin 2.1.2\r\n")
                while peer.recv(64):
                    pass

        thread = threading.Thread(target=talk)
        thread.start()
        assert exit_code(["boards", f"socket://127.0.0.1:{server.getsockname()[1]}"]) == 3
        thread.join()
    assert "is not a GRBL board: it sends 'start'" in capsys.readouterr().out


BOARD = Welcome(VERSION, 3, 500, 1020, 36, StepperState.IDLE, True)


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (FoundBoard("/dev/ttyS0", "n/a"), ""),
        (FoundBoard("/dev/ttyUSB0", "", stepper=BOARD, baud=1_000_000), "its position is known"),
        (
            FoundBoard(
                "/dev/ttyUSB0", "", stepper=Welcome(VERSION, 4, 500, 1020, 40), baud=500_000
            ),
            "4 axes (X Y Z A)",
        ),
        (
            FoundBoard("/dev/ttyUSB0", "", stepper=Welcome(VERSION + 1), baud=1_000_000),
            "make flash PORT=/dev/ttyUSB0",
        ),
    ],
)
def test_a_port_without_a_board_gives_only_comments(found: FoundBoard, said: str) -> None:
    lines = list(port_report(found))
    assert all(line.startswith("#") for line in lines)
    assert said in "\n".join(lines)


class Recorded:
    """A silent port that records the bytes sent at each speed."""

    def __init__(self) -> None:
        self.baud = 115200
        self.heard: list[tuple[int, bytes]] = []

    def read(self, timeout: float) -> bytes:
        return b""

    def write(self, data: bytes) -> None:
        self.heard.append((self.baud, data))

    def change_baud(self, baud: int) -> None:
        self.baud = baud

    def raise_lines(self) -> bool:
        """They are up."""
        return False

    def close(self) -> None:
        """Nothing to let go of."""


def test_nothing_is_sent_that_could_move_an_unknown_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """GRBL's queries and reset, then a stepper hello without real-time characters and line end."""
    port, clock = Recorded(), 0.0

    class Clock:
        def now(self) -> float:
            nonlocal clock
            clock += 0.02
            return clock

        def sleep(self, seconds: float) -> None:
            """Time goes on by itself."""

    monkeypatch.setattr(discovery, "open_port", lambda name, baud: port)
    monkeypatch.setattr(discovery, "SystemClock", Clock)
    (found,) = discovery.probe_ports(["COM9"])
    assert found.fault is not None and found.fault.diagnostic.code == "no-answer"
    assert {data for baud, data in port.heard if baud == 115200} <= {b"?", b"\n", b"\x18"}
    hello = {data for baud, data in port.heard if baud == 1_000_000}
    assert len(hello) == 1
    assert not set(b"".join(hello)) & {*b"\r\n?!~", 0x18, *range(0x80, 0xA5)}
