"""Boards at a WebSocket (``ws://host:port``): the only module that imports websockets.

FluidNC and grblHAL offer one beside their TCP port. Bytes travel in binary frames, because
real-time commands above 0x7F are no text. Text frames carry lines, too, and messages to FluidNC's
web page, which are left out. Source: FluidNC's WSChannel.cpp.
"""

from __future__ import annotations

import contextlib
import re
from typing import TYPE_CHECKING

from cnc.boards.errors import board_error
from cnc.boards.port import port_lost

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

SCHEMES = ("ws://", "wss://")
OPENING, CLOSING = 3.0, 1.0
"""Longest time to open and to close a connection, s."""
_FOR_THE_PAGE = re.compile(r"(currentID|CURRENT_ID|activeID|ACTIVE_ID|PING)(?![A-Za-z_])")


class WebSocketLink:
    """An open connection (:class:`cnc.boards.port.Port`)."""

    def __init__(
        self, name: str, connection: ClientConnection, resources: contextlib.ExitStack
    ) -> None:
        """``resources`` closes the connection."""
        self._name = name
        self._connection = connection
        self._resources = resources

    def read(self, timeout: float) -> bytes:
        """Return the received bytes after at most ``timeout`` s.

        Raises:
            PortLost: The connection is lost.
        """
        from websockets.exceptions import ConnectionClosed

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
        except (ConnectionClosed, OSError) as error:
            # What came before the end counts; the next call finds the end again.
            if received:
                return received
            raise port_lost(self._name, "the board has closed it") from error

    def write(self, data: bytes) -> None:
        """Send bytes at once.

        Raises:
            PortLost: The connection is lost.
        """
        from websockets.exceptions import ConnectionClosed

        try:
            self._connection.send(data)
        except (ConnectionClosed, OSError) as error:
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
        from websockets.exceptions import WebSocketException
        from websockets.sync.client import connect
    except ImportError as error:
        message = f"the port {name} needs {error.name}, which is not installed"
        hint = "pip install 'cncrun[serve]', or use the TCP port of the board: socket://host:port"
        raise board_error("websocket-missing", message, hint=hint) from error
    resources = contextlib.ExitStack()
    try:
        # The driver itself notices a dead connection; and the board is no web site.
        opened = connect(
            name,
            open_timeout=OPENING,
            close_timeout=CLOSING,
            ping_interval=None,
            compression=None,
            proxy=None,
        )
        connection = resources.enter_context(opened)
    except (OSError, ValueError, WebSocketException) as error:
        hint = (
            "name the board's address and the port of its WebSocket, such as ws://192.168.1.20:81"
        )
        reason = " ".join(str(error).split()) or "no answer"
        message = f"the port {name} is not usable: {reason}"
        raise board_error("port-not-usable", message, hint=hint) from error
    return WebSocketLink(name, connection, resources)
