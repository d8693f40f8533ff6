"""Discovery of boards at the serial ports: their settings, and the machine file that they give.

A port is first queried as a GRBL board, then as a stepper board, then as a Klipper board. The hello
of the stepper protocol is not a command of any other board, nor is the question of Klipper's.

All printed lines but those of the machine file are comments of TOML. Therefore
``cncrun boards /dev/ttyUSB0 > mill.toml`` makes the machine file.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace

from cnc.boards.grbl.faults import OtherFirmware
from cnc.boards.grbl.link import GrblLink, grbl_report
from cnc.boards.grbl.messages import Status
from cnc.boards.grbl.settings import BoardInfo
from cnc.boards.klipper.connection import BAUD as KLIPPER_BAUD
from cnc.boards.klipper.connection import Connection as KlipperConnection
from cnc.boards.klipper.connection import KlipperInfo, klipper_report, read_info
from cnc.boards.port import PortLost, SystemClock
from cnc.boards.serial_port import BY_NUMBER, FoundPort, found_ports, open_port, port_of
from cnc.boards.stepper.connection import BAUD, MIN_BAUD, Connection, stepper_report
from cnc.boards.stepper.protocol import Welcome
from cnc.model.diagnostics import BoardError

NOT_GRBL = ("no-answer", "board-not-grbl", "board-silent")
"""Codes of the faults at a port without a GRBL board."""
HELLO_S = 0.3
"""Timeout of a stepper or Klipper board that is up already: the queries for GRBL took seconds."""


@dataclass(frozen=True, slots=True)
class FoundBoard:
    """A port, and the board that answered there or the reason why none did.

    Attributes:
        port: Name of the port.
        description: The operating system's description of the device.
        serial_number: Serial number of the USB device; "" without one.
        info: Firmware and settings of a GRBL board.
        status: Status of a GRBL board.
        stepper: A stepper board's description of itself.
        klipper: A Klipper board's description of itself.
        baud: Speed at which the stepper or Klipper board answered, bits/s.
        fault: Reason why no board answered.
    """

    port: str
    description: str
    info: BoardInfo | None = None
    status: Status | None = None
    stepper: Welcome | None = None
    klipper: KlipperInfo | None = None
    baud: int = 0
    fault: BoardError | None = None
    serial_number: str = ""

    @property
    def lasting_port(self) -> str:
        """Name of the port that stays the same when the board is plugged in elsewhere."""
        return f"{BY_NUMBER}{self.serial_number}" if self.serial_number else self.port


def probe_ports(ports: Sequence[str] = (), baud: int = 115200) -> list[FoundBoard]:
    """Query ports for boards, all at the same time. Nothing moves.

    The first opening of a port resets most boards.

    Args:
        ports: Names of the ports; all ports of this computer if there are none.
        baud: Speed of the ports, bits/s.
    """
    present = found_ports()
    numbers = Counter(port.serial_number for port in present)
    by_name = {port.name: port for port in present}
    names = [port_of(name) for name in ports] or list(by_name)
    if not names:
        return []
    with ThreadPoolExecutor(len(names)) as pool:
        probed = list(
            pool.map(lambda name: _probe(name, by_name.get(name, FoundPort(name, "")), baud), names)
        )
    return [
        replace(board, serial_number=port.serial_number)
        if (port := by_name.get(board.port)) is not None and numbers[port.serial_number] == 1
        else board
        for board in probed
    ]


def _probe(name: str, port_seen: FoundPort, baud: int) -> FoundBoard:
    description = port_seen.description
    try:
        port = open_port(name, baud)
    except BoardError as error:
        return FoundBoard(name, description, fault=error)
    link = GrblLink(port, SystemClock(), name)
    try:
        link.connect()
        return FoundBoard(name, description, link.info, link.status)
    except PortLost as error:
        return FoundBoard(name, description, fault=error)
    except BoardError as error:
        # Stepper and Klipper boards send no text.
        if error.diagnostic.code not in NOT_GRBL or isinstance(error, OtherFirmware):
            return FoundBoard(name, description, fault=error)
        # A GRBL board has been reset by now, so the hello cannot disturb its motion.
        speed = baud if baud >= MIN_BAUD else BAUD
        with suppress(BoardError):
            port.change_baud(speed)
            connection = Connection(port, SystemClock(), name)
            return FoundBoard(name, description, stepper=connection.greet(HELLO_S), baud=speed)
        speed = baud if baud >= MIN_BAUD else KLIPPER_BAUD
        with suppress(BoardError):
            port.change_baud(speed)
            klipper = KlipperConnection(port, SystemClock(), name)
            return FoundBoard(name, description, klipper=read_info(klipper, HELLO_S), baud=speed)
        return FoundBoard(name, description, fault=error)
    finally:
        link.close()


def port_report(board: FoundBoard, baud: int = 115200) -> Iterator[str]:
    """Yield the lines of the report on a port: comments of TOML, then the machine file.

    Args:
        board: The port and its board.
        baud: Speed of the port for the machine file, bits/s.
    """
    number = f"serial number {board.serial_number}" if board.serial_number else ""
    yield "  ".join(part for part in (f"# {board.port}", board.description, number) if part)
    if board.stepper is not None:
        yield from stepper_report(board.port, board.stepper, board.baud)
    elif board.klipper is not None:
        yield from klipper_report(board.lasting_port, board.klipper, board.baud)
    elif board.info is not None and board.status is not None:
        yield from grbl_report(board.lasting_port, board.info, board.status, baud)
    elif board.fault is not None:
        yield f"# {board.fault.diagnostic.message}"
