"""The HTTP protocol of uvicorn with limits: connections in all, and time for a request.

A connection beyond the limit is closed before a byte is read. So is one that has not sent a whole
request head in time, or that stays idle.
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_CONNECTIONS = 256
"""Connections at a time."""
HEAD_TIME = 5.0
"""Time from the connection to its first request, s."""


_sockets: dict[tuple[str, int], asyncio.Transport] = {}
"""The connections that have become WebSockets, by the address of the client."""


def release(client: tuple[str, int] | None, *, at_once: bool) -> None:
    """Forget the WebSocket of a client; ``at_once`` closes it without its data that waits."""
    transport = None if client is None else _sockets.pop((client[0], client[1]), None)
    if transport is not None and at_once:
        transport.abort()


class LimitedProtocol(H11Protocol):
    """One connection."""

    def connection_made(self, transport: Any) -> None:
        """Close the connection if there are too many."""
        if len(self.connections) >= MOST_CONNECTIONS:
            self.transport = transport
            transport.abort()
            return
        super().connection_made(transport)
        self._deadline: asyncio.TimerHandle | None = self.loop.call_later(
            HEAD_TIME, self._close_unused
        )

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        if self in self.connections:
            self._end_deadline()
            super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take bytes; a request ends the wait for it."""
        super().data_received(data)
        if self.cycle is not None:
            self._end_deadline()

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Hand the connection to the WebSocket."""
        self._end_deadline()
        if self.client is not None:
            _sockets[self.client] = self.transport
        super().handle_websocket_upgrade(event)

    def _close_unused(self) -> None:
        if self.cycle is None and not self.transport.is_closing():
            self.transport.abort()

    def _end_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None
