"""A real server: many sockets, slow readers, floods, and the pulses of a run meanwhile."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections import deque

import httpx
import pytest
import uvicorn

from cnc.boards.loopback import PacedLoopback
from cnc.server import console as hub
from cnc.server import security, serve
from cnc.server.library import Library
from cnc.server.security import Access, Rates
from cnc.server.serve import BACKLOG, REQUEST_THREADS, LimitedProtocol, create_app
from tests.support.soak import share
from tests.support.waiting import HANG, wait_until

PROGRAM = (
    "G21 G90 G64\n"
    + "".join(
        f"G1 X{10 + 3 * (n % 3)} Y{10 + 2 * (n % 5)} F6000\nG3 X{11 + n % 4} Y12 R9\n"
        for n in range(12)
    )
    + "M2\n"
)


class RealServer:
    """A server at a free port, in a thread."""

    def __init__(self, console, rates=None):
        self.socket = socket.create_server(("127.0.0.1", 0), backlog=BACKLOG)
        self.port = self.socket.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}"
        access = Access(frozenset({f"127.0.0.1:{self.port}"}))
        config = uvicorn.Config(
            create_app(console, access, rates),
            http=LimitedProtocol,
            backlog=BACKLOG,
            ws="websockets-sansio",
            log_config=None,
            # The connections of these tests answer no ping.
            ws_ping_interval=None,
            timeout_graceful_shutdown=1,
        )
        self.server = uvicorn.Server(config)
        self.thread = threading.Thread(target=self.server.run, args=([self.socket],), daemon=True)
        self.thread.start()
        wait_until(lambda: self.server.started)

    def close(self):
        self.server.should_exit = True
        self.thread.join()
        self.socket.close()

    def connect(self):
        return socket.create_connection(("127.0.0.1", self.port))

    def get(self, path):
        with httpx.Client(base_url=self.url, timeout=HANG) as client:
            return client.get(path)


@pytest.fixture
def server(console):
    found = RealServer(console, Rates(rate=1e6, burst=1e6))
    yield found
    found.close()


def is_closed(connection):
    """Return whether the server has closed a connection."""
    connection.setblocking(False)
    try:
        return connection.recv(1) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True


def test_connections_beyond_the_limit_are_closed(server, monkeypatch):
    monkeypatch.setattr(serve, "MOST_CONNECTIONS", 10)
    sockets = [server.connect() for _ in range(60)]
    wait_until(lambda: sum(is_closed(each) for each in sockets) >= 50)
    assert len(server.server.server_state.connections) <= 10
    for each in sockets:
        each.close()
    wait_until(lambda: not server.server.server_state.connections)
    assert server.get("/api/state").status_code == 200


CROWD = share(10_000, 700)
POST = b" HTTP/1.1\r\nHost: {}\r\nContent-Type: application/json\r\n"
STOP = b"POST /api/stop" + POST + b"Content-Length: 2\r\n\r\n{}"


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(b"", id="silent", marks=pytest.mark.soak),
        pytest.param(b"POST /api/mdi" + POST + b"Content-Length: 9\r\n\r\n{", id="half a body"),
    ],
)
def test_a_stop_comes_through_a_crowd(server, data):
    """A crowd of the same address takes all places, and goes on to connect."""
    assert CROWD > serve.MOST_CONNECTIONS
    host = f"127.0.0.1:{server.port}"
    crowd, ended = deque(), threading.Event()

    def connect():
        while not ended.is_set():
            crowd.append(server.connect())
            if len(crowd) > CROWD:
                oldest = crowd.popleft()
                # The system drops connections where too many wait for a busy server.
                wait_until(lambda oldest=oldest: ended.is_set() or is_closed(oldest))
                oldest.close()
            with contextlib.suppress(OSError):
                crowd[-1].sendall(data.replace(b"{}", host.encode()))

    thread = threading.Thread(target=connect)
    thread.start()
    wait_until(lambda: len(crowd) >= CROWD)
    try:
        for _ in range(share(50, 5)):
            with server.connect() as connection:
                connection.settimeout(HANG)
                connection.sendall(STOP.replace(b"{}", host.encode(), 1))
                assert connection.recv(12) == b"HTTP/1.1 200"
    finally:
        ended.set()
        thread.join()
        for each in crowd:
            each.close()


def test_the_largest_crowd_makes_a_place(server, monkeypatch):
    """The connection of another address stays, although it is silent for longer."""
    monkeypatch.setattr(serve, "MOST_CONNECTIONS", 10)
    other = socket.create_connection(("127.0.0.1", server.port), source_address=("127.0.0.2", 0))
    crowd = [server.connect() for _ in range(30)]
    wait_until(lambda: sum(is_closed(each) for each in crowd) == 21)
    assert not is_closed(other)
    assert all(is_closed(each) for each in crowd[:21])
    for each in (other, *crowd):
        each.close()


@pytest.mark.parametrize("data", [b"", b"GET /api/state HTT", b"GET / HTTP/1.1\r\nHost: x\r\n"])
def test_a_connection_without_a_whole_request_is_closed(server, monkeypatch, data):
    monkeypatch.setattr(serve, "HEAD_TIME", 0.2)
    connection = server.connect()
    connection.sendall(data)
    wait_until(lambda: is_closed(connection))
    connection.close()


@pytest.mark.parametrize("refused", ["too long", "of another type"])
def test_the_client_of_a_long_upload_gets_its_refusal(server, monkeypatch, refused):
    """A client that first sends all would get a reset instead of the answer."""
    monkeypatch.setattr(security, "MOST_UPLOAD", 100_000)
    kind = "application/json" if refused == "too long" else "text/plain"
    piece = b"10000\r\n" + b"x" * 0x10000 + b"\r\n"
    with server.connect() as connection:
        connection.settimeout(HANG)
        connection.sendall(
            f"PUT /api/jobs/a.nc HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n"
            f"Content-Type: {kind}\r\nTransfer-Encoding: chunked\r\n\r\n".encode()
            + b'a\r\n{"text": "\r\n'
        )
        for _ in range(200):
            connection.sendall(piece)
        connection.sendall(b"0\r\n\r\n")
        answer = b""
        while data := connection.recv(4096):
            answer += data
    assert answer.startswith(b"HTTP/1.1 413" if refused == "too long" else b"HTTP/1.1 415")
    assert b"connection: close" in answer


def test_the_rest_of_a_refused_upload_is_not_waited_for(server, monkeypatch):
    monkeypatch.setattr(security, "LINGER", 0.1)
    with server.connect() as connection:
        connection.settimeout(HANG)
        connection.sendall(
            f"PUT /api/jobs/a.nc HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n"
            "Content-Type: application/json\r\nTransfer-Encoding: chunked\r\n\r\n"
            '9\r\n{"x": 1, \r\n'.encode()
        )
        answer = b""
        while piece := connection.recv(4096):
            answer += piece
    assert answer.startswith(b"HTTP/1.1 400")
    assert b"upload-format" in answer


def handshake(server):
    """Return a connection that has become a WebSocket, and reads nothing."""
    connection = handshake_from(server, "127.0.0.1")
    assert connection.recv(12) == b"HTTP/1.1 101"
    return connection


def handshake_from(server, address):
    """Return a connection from an address that has asked to become a WebSocket."""
    connection = socket.create_connection(("127.0.0.1", server.port), source_address=(address, 0))
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection.sendall(
        f"GET /api/events HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        "Sec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    return connection


def test_few_threads_serve_a_flood_of_requests(server, monkeypatch):
    """Each thread would take its turn with that of the machine."""
    at_work, most, lock = [0], [0], threading.Lock()
    real = Library.history

    def history(*arguments):
        with lock:
            at_work[0] += 1
            most[0] = max(most[0], at_work[0])
        found = real(*arguments)
        with lock:
            at_work[0] -= 1
        return found

    async def flood():
        async with httpx.AsyncClient(base_url=server.url, timeout=HANG) as client:
            each = [client.get("/api/history") for _ in range(60)]
            return {answer.status_code for answer in await asyncio.gather(*each)}

    monkeypatch.setattr(Library, "history", history)
    assert asyncio.run(flood()) == {200}
    assert 1 <= most[0] <= REQUEST_THREADS


def test_a_slow_reader_is_disconnected(server, console):
    connection = handshake(server)
    wait_until(lambda: len(console.hub._clients) == 1)
    wait_until(
        lambda: console.hub.publish_object({"event": "x" * 50_000}) or not console.hub._clients
    )
    connection.close()


def test_event_connections_are_limited(server, console, monkeypatch):
    monkeypatch.setattr(hub, "MOST_CLIENTS", 2)
    first, second = handshake(server), handshake(server)
    wait_until(lambda: len(console.hub._clients) == 2)
    third = handshake_from(server, "127.0.0.1")
    assert b"403" in third.recv(1000)
    for each in (first, second, third):
        each.close()
    wait_until(lambda: not console.hub._clients)


def test_event_connections_of_one_address_leave_room_for_others(server, console, monkeypatch):
    monkeypatch.setattr(hub, "MOST_OF_ADDRESS", 1)
    first = handshake(server)
    wait_until(lambda: len(console.hub._clients) == 1)
    second = handshake_from(server, "127.0.0.1")
    assert b"403" in second.recv(1000)
    third = handshake_from(server, "127.0.0.2")
    assert third.recv(12) == b"HTTP/1.1 101"
    for each in (first, second, third):
        each.close()
    wait_until(lambda: not console.hub._clients)


@pytest.fixture
def pulses(monkeypatch):
    """Return the rows of grid moves that the board has got: time in ns, and steps."""
    rows = []
    real = PacedLoopback.send

    def send(board, chunk):
        rows.extend(zip(chunk.time_ns.tolist(), chunk.step.tolist(), strict=True))
        real(board, chunk)

    monkeypatch.setattr(PacedLoopback, "send", send)
    return rows


def pulses_of_run(console, library, controller, pulses):
    """Run the program from X0 Y0; return its grid moves."""
    controller("POST", "/api/mdi", {"line": "G0 X0 Y0"})
    wait_until(lambda: not console.session._worker._busy)
    (library.folder / "pulses.nc").write_text(PROGRAM)
    pulses.clear()
    assert controller("POST", "/api/jobs/pulses.nc/run").status_code == 200
    wait_until(lambda: library.history()[0]["outcome"] != "running")
    wait_until(lambda: not console.session._worker._busy)
    assert library.history()[0]["outcome"] == "done"
    return pulses.copy()


@pytest.mark.soak
def test_the_pulses_are_the_same_with_clients_and_in_a_flood(
    server, console, library, pulses, controller
):
    alone = pulses_of_run(console, library, controller, pulses)
    answers, ended = [], threading.Event()

    async def flood():
        async with httpx.AsyncClient(base_url=server.url, timeout=HANG) as client:
            while not ended.is_set():
                each = [client.get("/api/state") for _ in range(8)]
                answers.extend(answer.status_code for answer in await asyncio.gather(*each))

    readers = [handshake(server) for _ in range(5)]
    thread = threading.Thread(target=lambda: asyncio.run(flood()))
    thread.start()
    flooded = pulses_of_run(console, library, controller, pulses)
    ended.set()
    thread.join()
    for each in readers:
        each.close()
    assert len(answers) >= 16
    assert len(alone) > 1000
    assert flooded == alone
