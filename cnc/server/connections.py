"""The HTTP protocol of uvicorn with limits: connections in all, and time for a request.

A connection that has not sent a whole request head in time is closed, and so is one that stays
idle. At the limit a new connection takes the place of one that waits for its client, because a stop
has to come through a crowd: that of the address with the most of them, and of these the one that
has been silent for longest. A new connection is closed if none waits for its client.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_CONNECTIONS = 512
"""Connections at a time."""
BACKLOG = 100
"""Connections that wait to be accepted. The event loop accepts as many at once, and reads the first
request of a connection three turns later: until then fewer must come than there are places.
"""
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
        """Take the connection, if there is a place for it or one can be made."""
        living = [each for each in self.connections if not each.transport.is_closing()]
        if len(living) >= MOST_CONNECTIONS:
            waiting = _longest_silent([e for e in living if isinstance(e, LimitedProtocol)])
            if waiting is None:
                self.transport = transport
                transport.abort()
                return
            waiting.transport.abort()
        super().connection_made(transport)
        self._heard = self.loop.time()
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
        self._heard = self.loop.time()
        super().data_received(data)
        if self.cycle is not None:
            self._end_deadline()

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Hand the connection to the WebSocket."""
        self._end_deadline()
        if self.client is not None:
            _sockets[self.client] = self.transport
        super().handle_websocket_upgrade(event)

    @property
    def waits_for_client(self) -> bool:
        """Whether there is no request that is complete and not answered yet."""
        return self.cycle is None or self.cycle.response_complete or self.cycle.more_body

    @property
    def heard(self) -> float:
        """Time at which the client sent something, s."""
        return self._heard

    @property
    def address(self) -> str:
        """Address of the client."""
        return "" if self.client is None else self.client[0]

    def _close_unused(self) -> None:
        if self.cycle is None and not self.transport.is_closing():
            self.transport.abort()

    def _end_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


def _longest_silent(connections: list[LimitedProtocol]) -> LimitedProtocol | None:
    """Return the connection to close for a new one; None if all have a request at work."""
    waiting = [each for each in connections if each.waits_for_client]
    if not waiting:
        return None
    crowds = Counter(each.address for each in waiting)
    return min(waiting, key=lambda each: (-crowds[each.address], each.heard))
