"""The server process: its address and token, its limits, its application, and its life."""

from __future__ import annotations

import asyncio
import contextlib
import io
import ipaddress
import json
import os
import re
import secrets
import signal
import socket
import sys
import threading
from collections import Counter
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, suppress
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import uvicorn
from anyio.to_thread import current_default_thread_limiter
from fastapi import FastAPI, Request, WebSocket, WebSocketDisconnect
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, JSONResponse
from starlette.exceptions import HTTPException
from uvicorn.protocols.http.h11_impl import H11Protocol

from cnc.machine.models import Machine
from cnc.model import state_file
from cnc.model.diagnostics import BoardError, CncError, Diagnostic, UsageError
from cnc.operate.events import Finding, as_object
from cnc.operate.operator_session import OperatorSession
from cnc.operate.probing import shipped_cycles
from cnc.operate.remote_session import SWITCH_S, RemoteSession
from cnc.server import routes, writing
from cnc.server.console import Client, Console, encoded
from cnc.server.library import OWN, Library
from cnc.server.security import Access, Guard, Rates, link
from cnc.version import __version__

# The HTTP protocol of uvicorn with limits: connections in all, and time for a request.
#
# A connection that has not sent a whole request head in time is closed, and so is one that stays
# idle. At the limit a new connection takes the place of one that waits for its client, because a
# stop has to come through a crowd: that of the address with the most of them, and of these the one
# that has been silent for longest. A new connection is closed if none waits for its client.

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
        living = [
            connection for connection in self.connections if not connection.transport.is_closing()
        ]
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
    waiting = [connection for connection in connections if connection.waits_for_client]
    if not waiting:
        return None
    crowds = Counter(connection.address for connection in waiting)
    return min(waiting, key=lambda connection: (-crowds[connection.address], connection.heard))


# The application: routes, the WebSocket of events, the files of the page, and errors as JSON.

STATUS = {
    "machine-busy": 409,
    "no-control": 409,
    "not-connected": 409,
    "board-connected": 409,
    "job-changed": 409,
    "job-exists": 409,
    "repair-unsafe": 409,
    "measurement-gone": 409,
    "no-such-job": 404,
    "no-such-macro": 404,
    "no-such-cycle": 404,
    "job-kind": 404,
    "height-map-name": 404,
}
TYPES = {
    ".html": "text/html",
    ".js": "text/javascript",
    ".css": "text/css",
    ".svg": "image/svg+xml",
    ".po": "text/x-gettext-translation",
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
    app.include_router(writing.router)
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
    faults = [
        f"{'.'.join(map(str, fault['loc'][1:]))}: {fault['msg']}" for fault in error.errors()[:5]
    ]
    hint = "/api/openapi.json describes the bodies"
    return JSONResponse({"code": "wrong-body", "message": "; ".join(faults), "hint": hint}, 400)


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
        "rotations": session.rotations,
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
    file = next((candidate for candidate in folder.glob("*") if candidate.name == name), None)
    if file is None or file.suffix not in TYPES or not file.is_file():
        raise HTTPException(404)
    return FileResponse(file, media_type=TYPES[file.suffix])


TOKEN_BYTES = 18
TOKEN = re.compile(r"[A-Za-z0-9_-]{8,200}")
PING = 5.0
"""Time between two pings of a WebSocket, and for its answer, s."""
HOLD_TIME = 1.0
"""Longest time until the machine has taken a hold, s."""


@dataclass(frozen=True, slots=True)
class Address:
    """An open socket, and how clients reach it.

    Attributes:
        socket: The listening socket.
        access: The names of the server, and its token.
        link: The address of the page, with the token.
    """

    socket: socket.socket
    access: Access
    link: str


def open_address(host: str, port: int, token: str | None) -> Address:
    """Open the listening socket.

    Args:
        host: Address to listen at.
        port: Port; 0 for a free one.
        token: The token. Without one, an address that others reach gets a new one.

    Raises:
        UsageError: ``address-not-free``, ``token-format``.
    """
    if token is not None and not TOKEN.fullmatch(token):
        hint = "use at least 8 letters, digits, _ and -"
        raise UsageError(Diagnostic("token-format", "the token cannot be used", hint=hint))
    try:
        family, _, _, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listening = socket.create_server(place[:2], family=family, backlog=BACKLOG)
    except OSError as error:
        message = f"the server cannot listen at {host}:{port}: {error.strerror or error}"
        hint = "choose another --port, or --host"
        raise UsageError(Diagnostic("address-not-free", message, hint=hint)) from error
    bound, number = listening.getsockname()[:2]
    local = ipaddress.ip_address(bound).is_loopback
    if token is None and not local:
        token = secrets.token_urlsafe(TOKEN_BYTES)
    names = _names(bound, host)
    shown = [_with_port(name, number) for name in names]
    hosts = frozenset(shown) | (frozenset(names) if number == 80 else frozenset())
    return Address(listening, Access(hosts, token), link(shown[0], token))


def serve(
    machine: Machine,
    address: Address,
    library: Path | None,
    *,
    announce: Callable[[Address], None],
) -> None:
    """Serve until the process gets a signal to end.

    Args:
        machine: The machine.
        address: The open socket.
        library: Folder of the library, which also has the macros and the offsets; None for
            that of this user.
        announce: Called when the server is ready.
    """
    sys.setswitchinterval(SWITCH_S)
    jobs = Library(library or state_file.folder().parent / "jobs")
    program = machine.program
    if program.parameters is None:
        program = program.model_copy(update={"parameters": jobs.folder / OWN / "parameters.var"})
        machine = machine.model_copy(update={"program": program})
    session = RemoteSession(machine, macros=jobs.macros, subroutines=(shipped_cycles(),))
    _hold_when_suspended(session)
    console = Console(session, jobs)
    try:
        config = uvicorn.Config(
            create_app(console, address.access),
            http=LimitedProtocol,
            backlog=BACKLOG,
            ws="websockets-sansio",
            ws_ping_interval=PING,
            ws_ping_timeout=PING,
            ws_max_size=1 << 16,
            ws_per_message_deflate=False,
            log_config=None,
            access_log=False,
            server_header=False,
            proxy_headers=False,
            timeout_graceful_shutdown=2,
            h11_max_incomplete_event_size=1 << 14,
        )
        announce(address)
        console.prepare()
        uvicorn.Server(config).run(sockets=[address.socket])
    finally:
        console.close()


def _hold_when_suspended(session: RemoteSession) -> None:
    """Let Ctrl-Z hold the machine first: a suspended server takes no stop."""
    suspends = getattr(signal, "SIGTSTP", None)
    # A shell without job control ignores it.
    if suspends is None or signal.getsignal(suspends) is signal.SIG_IGN:
        return

    def hold() -> None:
        with suppress(CncError, TimeoutError):
            session.ask(OperatorSession.hold).result(HOLD_TIME)

    def suspend(*_: object) -> None:
        # In a thread: this one may be inside a lock of the session.
        holding = threading.Thread(target=hold, daemon=True)
        holding.start()
        holding.join(HOLD_TIME)
        os.kill(os.getpid(), signal.SIGSTOP)

    signal.signal(suspends, suspend)


def qr_code(text: str) -> str:
    """Return a QR code for a terminal; empty where segno is not installed."""
    try:
        import segno
    except ImportError:
        return ""
    target = io.StringIO()
    segno.make(text, micro=False).terminal(out=target, compact=True)
    return target.getvalue()


def _names(bound: str, host: str) -> list[str]:
    """Return the names of the server, the one for links first."""
    place = ipaddress.ip_address(bound)
    if place.is_unspecified:
        names = [*_own_addresses(place.version), "localhost", _local(place.version)]
    elif place.is_loopback:
        names = [bound, "localhost", host.lower()]
    else:
        names = [bound, host.lower()]
    return list(dict.fromkeys(names))


def _local(version: int) -> str:
    return "127.0.0.1" if version == 4 else "::1"


def _own_addresses(version: int) -> list[str]:
    """Return the addresses of this computer, the one of the way out first. Nothing is sent."""
    family, outside = (
        (socket.AF_INET, "192.0.2.1") if version == 4 else (socket.AF_INET6, "2001:db8::1")
    )
    addresses: list[str] = []
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((outside, 9))
            addresses.append(str(probe.getsockname()[0]))
        except OSError:
            pass
    try:
        entries = socket.getaddrinfo(socket.gethostname(), None, family)
        addresses += [str(item[4][0]) for item in entries]
    except OSError:
        pass
    return addresses


def _with_port(name: str, port: int) -> str:
    return f"[{name}]:{port}" if ":" in name else f"{name}:{port}"
