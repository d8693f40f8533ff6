"""ASGI by hand, for requests that a client library would not send."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any


def chunked(app: Any, host: str, method: str, path: str, pieces: Sequence[bytes]) -> int:
    """Send a body in pieces without a length; return the status."""
    waiting = list(pieces)
    sent: list[Any] = []

    async def receive() -> dict[str, Any]:
        piece = waiting.pop(0) if waiting else b""
        return {"type": "http.request", "body": piece, "more_body": bool(waiting)}

    async def send(message: Any) -> None:
        sent.append(message)

    scope = {
        "type": "http",
        "http_version": "1.1",
        "method": method,
        "path": path,
        "raw_path": path.encode(),
        "query_string": b"",
        "scheme": "http",
        "headers": [(b"host", host.encode()), (b"content-type", b"application/json")],
        "client": ("127.0.0.1", 1),
        "server": ("127.0.0.1", 8080),
    }
    asyncio.run(app(scope, receive, send))
    status = sent[0]["status"]
    assert isinstance(status, int)
    return status


def websocket(
    app: Any, headers: dict[str, str], query: str = "", messages: Sequence[str] = ()
) -> list[Any]:
    """Open a WebSocket, send messages, and leave; return what the application sent."""
    events: list[Any] = [{"type": "websocket.connect"}]
    events += [{"type": "websocket.receive", "text": text} for text in messages]
    if not messages:
        events.append({"type": "websocket.disconnect", "code": 1000})
    sent: list[Any] = []

    async def receive() -> Any:
        if events:
            return events.pop(0)
        await asyncio.Event().wait()
        return None

    async def send(message: Any) -> None:
        sent.append(message)

    scope = {
        "type": "websocket",
        "http_version": "1.1",
        "path": "/api/events",
        "raw_path": b"/api/events",
        "query_string": query.encode(),
        "scheme": "ws",
        "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
        "client": ("127.0.0.1", 1),
        "server": ("127.0.0.1", 8080),
        "subprotocols": [],
    }
    asyncio.run(app(scope, receive, send))
    return sent
