"""Distribution of events to the clients, in batches, without a wait for a slow one.

    machine threads ──► pending ──► every 20 ms one batch, encoded once ──► a queue for each client

A client whose queue is full reads too slowly: it is disconnected. The queues are bounded, so that
clients cost a bounded amount of memory.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
from collections import deque
from typing import Any

from cnc.operate.events import Event, as_object

BATCH_PERIOD = 0.02
"""Time in which events are gathered, s."""
MOST_PENDING = 5000
"""Events that wait for the next batch; of more, the oldest console lines are lost."""
MOST_BATCHES = 64
"""Batches that wait for a client."""
MOST_CLIENTS = 64
"""Connections for events."""
MOST_OF_ADDRESS = 16
"""Connections for events of one address."""
DIGITS = 4
"""Decimals of the positions."""


class Client:
    """The queue of one client.

    Attributes:
        number: Number of the connection.
        address: Where it comes from.
        lost: Whether the client read too slowly.
        dropped: Set when it is lost.
    """

    def __init__(self, number: int, address: str) -> None:
        self.number, self.address, self.lost = number, address, False
        self.dropped = asyncio.Event()
        self._queue: asyncio.Queue[str] = asyncio.Queue(MOST_BATCHES)

    def put(self, batch: str) -> None:
        """Add a batch; a full queue ends the connection."""
        if self.lost:
            return
        try:
            self._queue.put_nowait(batch)
        except asyncio.QueueFull:
            self.drop()

    def drop(self) -> None:
        """End the connection, even while it waits for its client."""
        self.lost = True
        self.dropped.set()

    async def next(self) -> str:
        """Return the next batch."""
        return await self._queue.get()


class Hub:
    """Takes events from any thread, and hands them to the clients in the event loop."""

    def __init__(self) -> None:
        self._pending: deque[dict[str, Any]] = deque(maxlen=MOST_PENDING)
        self._lock = threading.Lock()
        self._clients: dict[int, Client] = {}
        self._numbers = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._scheduled = False

    def start(self) -> None:
        """Use the running event loop from here on."""
        self._loop = asyncio.get_running_loop()

    def stop(self) -> None:
        """End all clients."""
        self._loop = None
        for client in self._clients.values():
            client.drop()

    def publish(self, event: Event) -> None:
        """Take an event of the session, from any thread."""
        self.publish_object(as_object(event))

    def publish_object(self, found: dict[str, Any]) -> None:
        """Take an event in its JSON form, from any thread."""
        loop = self._loop
        if loop is None or not self._clients:
            return
        with self._lock:
            self._pending.append(found)
            scheduled, self._scheduled = self._scheduled, True
        if not scheduled:
            with contextlib.suppress(RuntimeError):  # The loop may be closed by now.
                loop.call_soon_threadsafe(loop.call_later, BATCH_PERIOD, self._send)

    def join(self, address: str) -> Client | None:
        """Return a new client; None if there are too many, or too many of its address."""
        of_address = sum(each.address == address for each in self._clients.values())
        if len(self._clients) >= MOST_CLIENTS or of_address >= MOST_OF_ADDRESS:
            return None
        self._numbers += 1
        client = Client(self._numbers, address)
        self._clients[client.number] = client
        return client

    def leave(self, client: Client) -> None:
        """Forget a client."""
        self._clients.pop(client.number, None)

    def _send(self) -> None:
        with self._lock:
            events = list(self._pending)
            self._pending.clear()
            self._scheduled = False
        batch = encoded(events)
        for client in list(self._clients.values()):
            client.put(batch)


def encoded(events: list[dict[str, Any]]) -> str:
    """Return events as JSON, with rounded numbers."""
    return json.dumps(_rounded(events), allow_nan=False, separators=(",", ":"))


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, DIGITS) if abs(value) < 1e15 else None
    if isinstance(value, dict):
        return {name: _rounded(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(each) for each in value]
    return value
