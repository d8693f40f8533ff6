"""The application without sockets, on the paced loopback board."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any

import httpx
import pytest

from cnc.machine.load import load_machine
from cnc.operate.operator_session import OperatorSession
from cnc.operate.probing import shipped_cycles
from cnc.server.console import Console
from cnc.server.library import Library
from cnc.server.security import Access, Rates
from cnc.server.serve import create_app

HOST = "127.0.0.1:8080"
JSON = {"content-type": "application/json"}


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return Library(tmp_path_factory.mktemp("library") / "jobs")


@pytest.fixture(scope="module")
def console(tmp_path_factory, library):
    """One console for the tests of a module."""
    tmp_path = tmp_path_factory.mktemp("machine")
    machine = load_machine(None)
    program = machine.program.model_copy(update={"parameters": tmp_path / "machine.var"})
    machine = machine.model_copy(update={"program": program})
    session = OperatorSession(machine, macros=library.macros, subroutines=(shipped_cycles(),))
    console = Console(session, library)
    yield console
    console.close()


class Client:
    """Requests of one client, each in an event loop of its own."""

    def __init__(self, app: Any, host: str = HOST, headers: dict[str, str] | None = None) -> None:
        self.app, self.host, self.headers = app, host, headers or {}

    def __call__(self, method: str, path: str, body: Any = None, **options: Any) -> httpx.Response:
        headers = self.headers | options.pop("headers", {})
        if method in ("POST", "PUT") and "content-type" not in headers:
            headers |= JSON
            options.setdefault("json", {} if body is None else body)

        async def send() -> httpx.Response:
            transport = httpx.ASGITransport(self.app, raise_app_exceptions=False)
            async with httpx.AsyncClient(
                transport=transport, base_url=f"http://{self.host}"
            ) as client:
                return await client.request(method, path, headers=headers, **options)

        return asyncio.run(send())

    def take_control(self) -> None:
        key = self("POST", "/api/control", {"client": "test"}).json()["key"]
        self.headers["x-control"] = key


@pytest.fixture(scope="session")
def client_of_console() -> Callable[..., Client]:
    def make(console, token: str | None = None, rates=None, **options: Any) -> Client:
        access = Access(frozenset({HOST, "localhost:8080"}), token)
        usual = rates or Rates(rate=1e6, burst=1e6)
        return Client(create_app(console, access, usual), **options)

    return make


@pytest.fixture(scope="module")
def client_of(console, client_of_console) -> Callable[..., Client]:
    return partial(client_of_console, console)


@pytest.fixture(scope="module")
def app(client_of):
    return client_of().app


@pytest.fixture
def client(app):
    return Client(app)


@pytest.fixture
def controller(client, console):
    """Return a client that has control of a connected machine."""
    client.take_control()
    if not console.session.state.board:
        assert client("POST", "/api/connect", {"board": "loopback"}).status_code == 200
    return client
