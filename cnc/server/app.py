"""The application: routes, the WebSocket of events, the files of the page, and errors as JSON."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any

from anyio.to_thread import current_default_thread_limiter
from fastapi import FastAPI, Request, WebSocket, WebSocketDisconnect
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, JSONResponse
from starlette.exceptions import HTTPException

from cnc.model.diagnostics import BoardError, CncError
from cnc.operate.events import Finding, as_object
from cnc.operate.operator_session import OperatorSession
from cnc.server import height_map_routes, job_routes, routes
from cnc.server.connections import release
from cnc.server.console import Console
from cnc.server.hub import Client, encoded
from cnc.server.security import Access, Guard, Rates
from cnc.version import __version__

STATUS = {
    "machine-busy": 409,
    "no-control": 409,
    "not-connected": 409,
    "board-connected": 409,
    "no-such-job": 404,
    "no-such-macro": 404,
    "no-such-cycle": 404,
    "height-map-name": 404,
}
TYPES = {
    ".html": "text/html",
    ".js": "text/javascript",
    ".css": "text/css",
    ".svg": "image/svg+xml",
}
MOST_MESSAGE = 1000
"""Characters of a message of a client."""
REQUEST_THREADS = 4
"""Threads of the requests that read files: more of them would take turns with the machine's."""
CLOSING = 1.0
"""Longest time to close a connection, s."""


def create_app(console: Console, access: Access, rates: Rates | None = None) -> Guard:
    """Return the application behind its guard.

    Args:
        console: What the requests share.
        access: Who may use the server.
        rates: The limits of rates; None for the usual ones.
    """

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        console.hub.start()
        current_default_thread_limiter().total_tokens = REQUEST_THREADS
        asyncio.get_running_loop().set_default_executor(ThreadPoolExecutor(REQUEST_THREADS))
        yield
        console.hub.stop()

    app = FastAPI(
        title="cncrun",
        version=__version__,
        docs_url=None,
        redoc_url=None,
        openapi_url="/api/openapi.json",
        lifespan=lifespan,
    )
    app.state.console = console
    app.include_router(routes.router)
    app.include_router(job_routes.router)
    app.include_router(height_map_routes.router)
    app.add_api_websocket_route("/api/events", _events)
    app.add_api_route("/", _index, include_in_schema=False)
    app.add_api_route("/page/{name}", _page, include_in_schema=False)
    app.add_api_route("/view/{name}", _view, include_in_schema=False)
    app.add_exception_handler(CncError, _fault)
    app.add_exception_handler(HTTPException, _http_error)
    app.add_exception_handler(RequestValidationError, _invalid)
    return Guard(app, access, console.control.has, rates)


def _fault(_: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, CncError)
    status = 503 if isinstance(error, BoardError) else STATUS.get(error.diagnostic.code, 400)
    return JSONResponse(asdict(Finding.of(error.diagnostic)), status)


def _http_error(_: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    detail: Any = error.detail
    if not isinstance(detail, dict):
        detail = {"code": "http-error", "message": str(detail), "hint": ""}
    return JSONResponse(detail, error.status_code)


def _invalid(_: Request, error: Exception) -> JSONResponse:
    """Return what is wrong with a body, without its values."""
    assert isinstance(error, RequestValidationError)
    each = [
        f"{'.'.join(map(str, found['loc'][1:]))}: {found['msg']}" for found in error.errors()[:5]
    ]
    hint = "/api/openapi.json describes the bodies"
    return JSONResponse({"code": "wrong-body", "message": "; ".join(each), "hint": hint}, 400)


async def _events(websocket: WebSocket) -> None:
    """Send the events to one client, and take its signs of life."""
    console: Console = websocket.app.state.console
    client = console.hub.join((websocket.scope.get("client") or ("",))[0])
    if client is None:
        release(websocket.scope.get("client"), at_once=False)
        await websocket.close(1013)
        return
    await websocket.accept()
    keys: list[str] = []
    tasks = [
        asyncio.create_task(_send(websocket, console, client)),
        asyncio.create_task(_receive(websocket, console, keys)),
        asyncio.create_task(client.dropped.wait()),
    ]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        console.hub.leave(client)
        if any(console.control.has(key) for key in keys):
            console.session.ask(OperatorSession.release_jog)
        for task in tasks:
            task.cancel()
        # A client that does not read would not read the end either.
        release(websocket.scope.get("client"), at_once=client.lost)
        with contextlib.suppress(Exception):
            await asyncio.wait_for(websocket.close(), CLOSING)
        await asyncio.gather(*tasks, return_exceptions=True)


async def _send(websocket: WebSocket, console: Console, client: Client) -> None:
    session = console.session
    dialog = session.dialog
    hello = {
        "event": "hello",
        "client": client.number,
        "holder": console.control.holder,
        "state": as_object(session.state),
        "dialog": None if dialog is None else as_object(dialog),
        "offsets": session.offsets,
    }
    await websocket.send_text(encoded([hello]))
    while True:
        await websocket.send_text(await client.next())


async def _receive(websocket: WebSocket, console: Console, keys: list[str]) -> None:
    """Take messages until one is wrong, or the connection ends."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            text = await websocket.receive_text()
            if len(text) > MOST_MESSAGE:
                return
            try:
                message = json.loads(text)
            except (ValueError, RecursionError):
                return
            match message:
                case {"control": str(key)}:
                    keys[:] = [key]
                case {"jog": int(number)} if any(map(console.control.has, keys)):
                    console.session.ask(OperatorSession.keep_jog, number)
                case {"stop": True}:
                    console.session.ask(OperatorSession.stop)
                case _:
                    return


def _index() -> FileResponse:
    return _asset("cnc.server", "index.html")


def _page(name: str) -> FileResponse:
    return _asset("cnc.server", name)


def _view(name: str) -> FileResponse:
    if not name.endswith(".js"):
        raise HTTPException(404)
    return _asset("cnc.view", name)


def _asset(package: str, name: str) -> FileResponse:
    """Return a file of a page; 404 for any name that the folder does not list."""
    folder = Path(str(resources.files(package))) / "page"
    found = next((each for each in folder.glob("*") if each.name == name), None)
    if found is None or found.suffix not in TYPES or not found.is_file():
        raise HTTPException(404)
    return FileResponse(found, media_type=TYPES[found.suffix])
