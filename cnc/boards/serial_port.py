"""Ports of boards, serial ones and WebSockets.

Only this module imports pyserial and websockets, and only when a port is used.

A port has the name that the operating system gives it (``/dev/ttyUSB0``, ``COM3``, a
pseudo-terminal), or it is one of pyserial's URLs (``socket://host:port``, ``loop://``,
``rfc2217://..``): pyserial documentation, "URL Handlers". ``ws://host:port`` is a WebSocket.
``usb:NUMBER`` is the port of the USB device with this serial
number, whatever name it has now.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import select
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cnc.boards.port import port_lost
from cnc.boards.protocols import board_error
from cnc.model.diagnostics import BoardError

if sys.platform != "win32":
    import termios

if TYPE_CHECKING:
    from serial import SerialBase
    from websockets.sync.client import ClientConnection


# Boards at a WebSocket (``ws://host:port``).
#
# FluidNC and grblHAL offer one beside their TCP port. Bytes travel in binary frames, because
# real-time commands above 0x7F are no text. Text frames carry lines, too, and messages to FluidNC's
# web page, which are left out. Source: FluidNC's WSChannel.cpp.

SCHEMES = ("ws://", "wss://")
OPENING, CLOSING = 3.0, 1.0
"""Longest time to open and to close a connection, s."""
_FOR_THE_PAGE = re.compile(r"(currentID|CURRENT_ID|activeID|ACTIVE_ID|PING)(?![A-Za-z_])")


class WebSocketLink:
    """An open connection (:class:`cnc.boards.port.Port`)."""

    def __init__(
        self,
        name: str,
        connection: ClientConnection,
        resources: contextlib.ExitStack,
        failure: type[Exception],
    ) -> None:
        """``resources`` closes the connection; ``failure`` is the error of a lost one."""
        self._name = name
        self._connection = connection
        self._resources = resources
        self._failure = failure

    def read(self, timeout: float) -> bytes:
        """Return the received bytes after at most ``timeout`` s.

        Raises:
            PortLost: The connection is lost.
        """
        received = b""
        try:
            while True:
                data = self._connection.recv(timeout=0.0 if received else max(timeout, 0.0))
                if isinstance(data, bytes):
                    received += data
                elif not _FOR_THE_PAGE.match(data):
                    received += data.encode("latin-1", "replace")
        except TimeoutError:
            return received
        except (self._failure, OSError) as error:
            # What came before the end counts; the next call finds the end again.
            if received:
                return received
            raise port_lost(self._name, "the board has closed it") from error

    def write(self, data: bytes) -> None:
        """Send bytes at once.

        Raises:
            PortLost: The connection is lost.
        """
        try:
            self._connection.send(data)
        except (self._failure, OSError) as error:
            raise port_lost(self._name, "the board has closed it") from error

    def change_baud(self, baud: int) -> None:
        """Do nothing: a network has no speed to set."""

    def raise_lines(self) -> bool:
        """Return False: a network has no DTR."""
        return False

    def close(self) -> None:
        """Close the connection."""
        with contextlib.suppress(OSError):
            self._resources.close()


def open_websocket(name: str) -> WebSocketLink:
    """Open a connection to a board.

    Raises:
        BoardError: ``port-not-usable``; ``websocket-missing`` if the package is not installed.
    """
    try:
        import websockets.sync.client
    except ImportError as error:
        message = f"the port {name} needs {error.name}, which is not installed"
        hint = "pip install 'cncrun[serve]', or use the TCP port of the board: socket://host:port"
        raise board_error("websocket-missing", message, hint=hint) from error
    resources = contextlib.ExitStack()
    try:
        # The driver itself notices a dead connection; and the board is no web site.
        opened = websockets.sync.client.connect(
            name,
            open_timeout=OPENING,
            close_timeout=CLOSING,
            ping_interval=None,
            compression=None,
            proxy=None,
        )
        connection = resources.enter_context(opened)
    except (OSError, ValueError, websockets.WebSocketException) as error:
        hint = (
            "name the board's address and the port of its WebSocket, such as ws://192.168.1.20:81"
        )
        reason = " ".join(str(error).split()) or "no answer"
        message = f"the port {name} is not usable: {reason}"
        raise board_error("port-not-usable", message, hint=hint) from error
    return WebSocketLink(name, connection, resources, websockets.ConnectionClosed)


WRITE_TIMEOUT = 2.0
"""Time after which a connection that accepts no bytes counts as lost, s."""
READ_SIZE = 4096
BY_NUMBER = "usb:"
"""Begin of the name of a port by the serial number of its device."""
MISSING_ERRORS = (errno.ENOENT, errno.ENODEV, errno.ENXIO)
TAKEN_ERRORS = (errno.EBUSY, errno.EWOULDBLOCK)
LINES_LOW = sys.platform == "win32"
"""Windows lowers DTR when a port is closed. There DTR and RTS stay low, so that they never change.
"""


@dataclass(frozen=True, slots=True)
class FoundPort:
    """A port of this computer.

    Attributes:
        name: Its name.
        description: The operating system's description of the device.
        serial_number: Serial number of the USB device; "" without one.
    """

    name: str
    description: str
    serial_number: str = ""


class SerialLink:
    """An open port (:class:`cnc.boards.port.Port`)."""

    def __init__(self, name: str, serial: SerialBase) -> None:
        self._name = name
        self._serial = serial
        try:
            self._file: int | None = serial.fileno()
        except OSError:
            # On Windows and for some URLs, pyserial itself has to wait.
            self._file = None

    def read(self, timeout: float) -> bytes:
        """Return the received bytes after at most ``timeout`` s.

        Raises:
            PortLost: The connection is lost.
        """
        try:
            if self._file is None:
                return self._read_by_pyserial(timeout)
            # Waiting and reading here takes a third of the system calls of pyserial.
            try:
                if data := os.read(self._file, READ_SIZE):
                    return data
            except BlockingIOError:
                pass
            if timeout <= 0.0 or not select.select((self._file,), (), (), timeout)[0]:
                return b""
            try:
                # Only a connection that has ended is ready without data: pyserial tells how.
                return os.read(self._file, READ_SIZE) or self._serial.read(1)
            except BlockingIOError:
                return b""
        except (OSError, ValueError) as error:
            raise port_lost(self._name, _reason(error)) from error

    def _read_by_pyserial(self, timeout: float) -> bytes:
        serial = self._serial
        # Setting the timeout is a request to the device.
        if serial.timeout != timeout:
            serial.timeout = timeout
        data: bytes = serial.read(1)
        return data + serial.read(serial.in_waiting) if data and serial.in_waiting else data

    def write(self, data: bytes) -> None:
        """Send bytes at once.

        Raises:
            PortLost: The connection is lost, or accepts nothing for WRITE_TIMEOUT.
        """
        try:
            if self._file is not None:
                try:
                    written = os.write(self._file, data)
                except BlockingIOError:
                    written = 0
                data = data[written:]
            if data:
                self._serial.write(data)
        except OSError as error:
            raise port_lost(self._name, _reason(error)) from error

    def change_baud(self, baud: int) -> None:
        """Change the speed and discard received bytes. A new opening would reset the board.

        Args:
            baud: Speed, bits/s.

        Raises:
            PortLost: The connection is lost.
        """
        try:
            self._serial.baudrate = baud
            self._serial.reset_input_buffer()
        except (OSError, ValueError) as error:
            raise port_lost(self._name, _reason(error)) from error

    def raise_lines(self) -> bool:
        """Raise DTR and RTS if :func:`open_port` left them low.

        Returns:
            Whether they were low.

        Raises:
            PortLost: The connection is lost.
        """
        try:
            low = not self._serial.dtr
            if low:
                self._serial.dtr = self._serial.rts = True
            return low
        except (OSError, ValueError) as error:
            raise port_lost(self._name, _reason(error)) from error

    def close(self) -> None:
        """Close the port."""
        self._file = None
        with contextlib.suppress(OSError):
            self._serial.close()


def open_port(name: str, baud: int) -> SerialLink | WebSocketLink:
    """Open a port with 8 bits and no parity, for this program alone; discard received bytes.

    A rise of DTR resets most Arduinos. Therefore the line is kept as it is: high for good where the
    system can do that (HUPCL of termios), else low. The system itself raises it when a port is
    first opened, and after another program has lowered it. That reset is unavoidable.

    Args:
        name: Name of the port, or a URL of pyserial, or of a WebSocket.
        baud: Speed, bits/s.

    Raises:
        BoardError: ``no-such-port``, ``port-taken``, ``port-not-permitted``, ``port-not-usable``,
            ``websocket-missing``.
    """
    if name.startswith(SCHEMES):
        return open_websocket(name)
    import serial

    name = port_of(name)
    try:
        opened = serial.serial_for_url(
            name,
            baudrate=baud,
            timeout=0,
            write_timeout=WRITE_TIMEOUT,
            exclusive=True,
            do_not_open=True,
        )
        if LINES_LOW and "://" not in name:
            opened.dtr = opened.rts = False
        opened.open()
    except (OSError, ValueError) as error:
        raise _not_opened(name, error) from error
    _keep_dtr(opened)
    return SerialLink(name, opened)


def port_of(name: str) -> str:
    """Return the present name of a port that is named by its serial number; others stay.

    Raises:
        BoardError: ``no-such-port`` if no device, or more than one, has the number.
    """
    if not name.startswith(BY_NUMBER):
        return name
    number = name.removeprefix(BY_NUMBER)
    ports = found_ports()
    names = [port.name for port in ports if port.serial_number == number]
    if len(names) == 1:
        return names[0]
    numbers = ", ".join(
        f"{port.serial_number} ({port.name})" for port in ports if port.serial_number
    )
    if names:
        message = f"several devices have the serial number {number}: {', '.join(names)}"
        raise board_error("no-such-port", message, hint="name one of these ports instead")
    hint = f"numbers at this computer: {numbers}" if numbers else "is the board plugged in?"
    raise board_error("no-such-port", f"no device has the serial number {number}", hint=hint)


def identity(name: str) -> str:
    """Return an identity of the board at a port: its USB serial number, else the name of the port.

    A new pseudo-terminal may have the name of a former one, so its creation time is added.
    """
    if "://" in name:
        return name
    if name.startswith(BY_NUMBER):
        return f"usb {name.removeprefix(BY_NUMBER)}"
    # Windows does not distinguish com3 and COM3.
    port = os.path.normcase(os.path.realpath(name) if os.path.exists(name) else name)
    numbers = (
        device.serial_number for device in found_ports() if os.path.normcase(device.name) == port
    )
    number = next(numbers, "")
    if number:
        return f"usb {number}"
    if port.startswith("/dev/pts/") and os.path.exists(port):
        return f"{port} {os.stat(port).st_ctime_ns}"
    return port


def _keep_dtr(serial: SerialBase) -> None:
    """Keep DTR high when the port is closed, where the system supports that."""
    if sys.platform != "win32":
        with contextlib.suppress(OSError, ValueError, AttributeError, termios.error):
            settings = termios.tcgetattr(serial.fileno())
            settings[2] &= ~termios.HUPCL
            termios.tcsetattr(serial.fileno(), termios.TCSANOW, settings)


def found_ports() -> list[FoundPort]:
    """Return the serial ports of this computer, sorted by name."""
    from serial.tools.list_ports import comports

    return sorted(
        (
            FoundPort(device.device, device.description or "", device.serial_number or "")
            for device in comports()
        ),
        key=lambda port: port.name,
    )


def _not_opened(name: str, error: OSError | ValueError) -> BoardError:
    """Return the fault for an error of pyserial; on Windows only its text tells the cause."""
    number, text = getattr(error, "errno", None), str(error)
    if number in MISSING_ERRORS or "FileNotFoundError" in text:
        ports = ", ".join(port.name for port in found_ports())
        hint = (
            f"ports of this computer: {ports}"
            if ports
            else "this computer has no serial port: is the board plugged in and switched on?"
        )
        return board_error("no-such-port", f"there is no port {name}", hint=hint)
    if number in TAKEN_ERRORS or "PermissionError" in text:
        hint = "close that program (another sender, a serial monitor)"
        return board_error("port-taken", f"the port {name} is in use by another program", hint=hint)
    if number in (errno.EACCES, errno.EPERM):
        hint = (
            "add your user to the group: sudo usermod -aG dialout $USER, then log out and in again"
        )
        return board_error(
            "port-not-permitted", f"you do not have permission to open the port {name}", hint=hint
        )
    hint = (
        "name a serial port or a pyserial URL such as socket://host:port; "
        "cncrun boards lists the ports of this computer"
    )
    return board_error(
        "port-not-usable", f"the port {name} is not usable: {_reason(error)}", hint=hint
    )


def _reason(error: OSError | ValueError) -> str:
    """Return the text of an error in one line."""
    return " ".join(str(getattr(error, "strerror", None) or error).split())
