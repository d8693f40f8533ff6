"""Log of a connection: each line or frame in both directions, at level DEBUG.

    /dev/ttyUSB0 -> G1X10F600
    /dev/ttyUSB0 <- ok

Bytes that are not printable are escaped. Binary protocols are logged in hexadecimal, as they are
written and read.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from cnc.boards.port import Port


class LoggedPort:
    """A port that logs what passes it.

    Args:
        port: The port, which stays reachable as an attribute.
        name: Name of the port.
        log: The logger.
        text: Whether the bytes are lines of text.

    Attributes:
        on_line: Called with the direction (``->`` or ``<-``) and the text of each line; None for
            no call.
    """

    def __init__(self, port: Port, name: str, log: logging.Logger, *, text: bool) -> None:
        self.port = port
        self._name, self._log, self._text = name, log, text
        self._partial_line = b""
        self.on_line: Callable[[str, str], None] | None = None

    @property
    def logs(self) -> bool:
        """Whether anybody reads the log. If not, the port itself is quicker."""
        return self.on_line is not None or self._log.isEnabledFor(logging.DEBUG)

    def read(self, timeout: float) -> bytes:
        """Return the received bytes; see :meth:`Port.read`."""
        data = self.port.read(timeout)
        if data and self.logs:
            self._log_received(data)
        return data

    def write(self, data: bytes) -> None:
        """Send bytes at once; see :meth:`Port.write`."""
        if self.logs:
            for line in data.splitlines() if self._text else [data]:
                self._log_line("->", line)
        self.port.write(data)

    def raise_lines(self) -> bool:
        """Raise DTR and RTS; see :meth:`Port.raise_lines`."""
        self._log.debug("%s: raise DTR and RTS", self._name)
        return self.port.raise_lines()

    def close(self) -> None:
        """Close the connection."""
        self._log.debug("%s: close", self._name)
        self.port.close()

    def _log_received(self, data: bytes) -> None:
        """Log complete lines; the rest waits for its end."""
        if not self._text:
            self._log_line("<-", data)
            return
        *lines, self._partial_line = (self._partial_line + data).split(b"\n")
        for line in lines:
            self._log_line("<-", line.rstrip(b"\r"))

    def _log_line(self, arrow: str, data: bytes) -> None:
        shown = ascii(data.decode("latin-1"))[1:-1] if self._text else data.hex(" ")
        if shown:
            self._log.debug("%s %s %s", self._name, arrow, shown)
            if self.on_line is not None:
                self.on_line(arrow, shown)
