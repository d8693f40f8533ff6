"""Serial ports: the one module that imports pyserial, and only when a port is wanted.

A port is named as the system names it (``/dev/ttyUSB0``, ``COM3``, a pseudo-terminal) or by one of
pyserial's URLs (``socket://host:port``, ``loop://``, ``rfc2217://..``): pyserial documentation,
"URL Handlers".
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cnc.boards.port import port_lost
from cnc.boards.protocols import board_error
from cnc.model.diagnostics import BoardError

if TYPE_CHECKING:
    from serial import SerialBase

WRITE_PATIENCE = 2.0
"""Seconds after which a link that takes no more bytes counts as gone."""
READ_SIZE = 4096
MISSING = (errno.ENOENT, errno.ENODEV, errno.ENXIO)
TAKEN = (errno.EBUSY, errno.EWOULDBLOCK)
LOWERED = sys.platform == "win32"
"""Windows drops DTR whenever a port is closed. So the lines stay down there: what was never up does
not fall and rise.
"""


@dataclass(frozen=True, slots=True)
class FoundPort:
    """A port of this computer: the name to open it by, and what the system knows of the device
    behind it.
    """

    name: str
    description: str


class SerialLink:
    """An open port (:class:`cnc.boards.port.Port`)."""

    def __init__(self, name: str, serial: SerialBase) -> None:
        self._name = name
        self._serial = serial
        try:
            self._file: int | None = serial.fileno()
        except OSError:
            # Windows, and some URLs: pyserial has to wait itself.
            self._file = None

    def read(self, timeout: float) -> bytes:
        """What has arrived, after ``timeout`` s at most. PortLost if the link is gone."""
        try:
            if self._file is None:
                return self._read_slowly(timeout)
            # pyserial's time-out stays 0: to wait here takes half of the calls.
            if timeout > 0.0 and not select.select((self._file,), (), (), timeout)[0]:
                return b""
            data: bytes = self._serial.read(READ_SIZE)
            return data
        except (OSError, ValueError) as error:
            raise port_lost(self._name, _reason(error)) from error

    def _read_slowly(self, timeout: float) -> bytes:
        serial = self._serial
        # To set the time-out talks to the device: not for nothing.
        if serial.timeout != timeout:
            serial.timeout = timeout
        data: bytes = serial.read(1)
        return data + serial.read(serial.in_waiting) if data and serial.in_waiting else data

    def write(self, data: bytes) -> None:
        """Hand over at once. PortLost if the link is gone, or takes nothing for WRITE_PATIENCE."""
        try:
            self._serial.write(data)
        except OSError as error:
            raise port_lost(self._name, _reason(error)) from error

    def change_baud(self, baud: int) -> None:
        """Go on at another speed, without opening the port anew, which would reset the board; what
        has arrived is dropped. PortLost.
        """
        try:
            self._serial.baudrate = baud
            self._serial.reset_input_buffer()
        except (OSError, ValueError) as error:
            raise port_lost(self._name, _reason(error)) from error

    def raise_lines(self) -> None:
        """Raise DTR and RTS where :func:`open_port` has left them down. PortLost."""
        try:
            if not self._serial.dtr:
                self._serial.dtr = self._serial.rts = True
        except (OSError, ValueError) as error:
            raise port_lost(self._name, _reason(error)) from error

    def close(self) -> None:
        """Let go of the port."""
        self._file = None
        with contextlib.suppress(OSError):
            self._serial.close()


def open_port(name: str, baud: int) -> SerialLink:
    """The port called ``name`` at ``baud``, 8 bits, no parity, for this program alone; what had
    arrived before is dropped.

    A rise of DTR resets most Arduinos, so the line is left as it is: up for good where the system
    can do that (termios' HUPCL), else down. A system raises it by itself when it opens a port for
    the first time, and after another program let it fall: that reset can't be helped. BoardError
    ``no-such-port``, ``port-taken``, ``port-not-permitted``, ``port-not-usable``.
    """
    import serial

    try:
        opened = serial.serial_for_url(
            name,
            baudrate=baud,
            timeout=0,
            write_timeout=WRITE_PATIENCE,
            exclusive=True,
            do_not_open=True,
        )
        if LOWERED and "://" not in name:
            opened.dtr = opened.rts = False
        opened.open()
    except (OSError, ValueError) as error:
        raise _not_opened(name, error) from error
    _leave_up(opened)
    return SerialLink(name, opened)


def identity(name: str) -> str:
    """What tells the board at a port from others: the serial number of its USB device, else the
    port's own name.

    A pseudo-terminal gets its name from another that has ended; the time at which it was made tells
    them apart.
    """
    if "://" in name:
        return name
    from serial.tools.list_ports import comports

    port = os.path.realpath(name) if os.path.exists(name) else name
    number = next((each.serial_number for each in comports() if each.device == port), None)
    if number:
        return f"usb {number}"
    if port.startswith("/dev/pts/") and os.path.exists(port):
        return f"{port} {os.stat(port).st_ctime_ns}"
    return port


def _leave_up(serial: SerialBase) -> None:
    """Nothing hangs up when the port is closed; not a fault where that can't be had."""
    with contextlib.suppress(ImportError, OSError, ValueError, AttributeError):
        import termios

        with contextlib.suppress(termios.error):
            settings = termios.tcgetattr(serial.fileno())
            settings[2] &= ~termios.HUPCL
            termios.tcsetattr(serial.fileno(), termios.TCSANOW, settings)


def found_ports() -> list[FoundPort]:
    """The serial ports of this computer, sorted by name."""
    from serial.tools.list_ports import comports

    return sorted(
        (FoundPort(each.device, each.description or "") for each in comports()),
        key=lambda port: port.name,
    )


def _not_opened(name: str, error: OSError | ValueError) -> BoardError:
    """What pyserial said, in our words. On Windows the system's error stands in its text alone."""
    number, text = getattr(error, "errno", None), str(error)
    if number in MISSING or "FileNotFoundError" in text:
        there = ", ".join(port.name for port in found_ports())
        hint = (
            f"ports of this computer: {there}"
            if there
            else "this computer has no serial port: is the board plugged in and switched on?"
        )
        return board_error("no-such-port", f"there is no port {name}", hint=hint)
    if number in TAKEN or "PermissionError" in text:
        hint = "close the program that has it open (another sender, a serial monitor)"
        return board_error("port-taken", f"the port {name} is in use", hint=hint)
    if number in (errno.EACCES, errno.EPERM):
        hint = "let your user in: sudo usermod -aG dialout $USER, then log out and in again"
        return board_error("port-not-permitted", f"you may not open the port {name}", hint=hint)
    hint = "name a serial port or a pyserial URL such as socket://host:port; cncrun boards lists the ports of this computer"
    return board_error(
        "port-not-usable", f"the port {name} can't be used: {_reason(error)}", hint=hint
    )


def _reason(error: OSError | ValueError) -> str:
    """The error's text in one line."""
    return " ".join(str(getattr(error, "strerror", None) or error).split())
