"""The server process: its address, its token, and its life."""

from __future__ import annotations

import ipaddress
import os
import re
import secrets
import signal
import socket
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import uvicorn

from cnc.machine.models import Machine
from cnc.model.diagnostics import CncError, Diagnostic, UsageError
from cnc.operate.operator_session import OperatorSession
from cnc.operate.probing import shipped_cycles
from cnc.operate.remote_session import RemoteSession
from cnc.server.app import create_app
from cnc.server.connections import BACKLOG, LimitedProtocol
from cnc.server.console import Console
from cnc.server.library import OWN, Library
from cnc.server.security import Access, link

TOKEN_BYTES = 18
TOKEN = re.compile(r"[A-Za-z0-9_-]{8,200}")
PING = 5.0
"""Time between two pings of a WebSocket, and for its answer, s."""
HOLD_TIME = 1.0
"""Longest time until the machine has taken a hold, s."""
SWITCH_S = 0.0005
"""Time after which a thread gives way to another, s: the machine does not wait for requests."""


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
    library: Path,
    *,
    announce: Callable[[Address], None],
) -> None:
    """Serve until the process gets a signal to end.

    Args:
        machine: The machine.
        address: The open socket.
        library: Folder of the library, which also has the macros and the offsets.
        announce: Called when the server is ready.
    """
    sys.setswitchinterval(SWITCH_S)
    jobs = Library(library)
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
    import io

    target = io.StringIO()
    segno.make(text, micro=False).terminal(out=target, compact=True)
    return target.getvalue()


def _names(bound: str, host: str) -> list[str]:
    """Return the names of the server, the one for links first."""
    place = ipaddress.ip_address(bound)
    if place.is_unspecified:
        found = [*_own_addresses(place.version), "localhost", _local(place.version)]
    elif place.is_loopback:
        found = [bound, "localhost", host.lower()]
    else:
        found = [bound, host.lower()]
    return list(dict.fromkeys(found))


def _local(version: int) -> str:
    return "127.0.0.1" if version == 4 else "::1"


def _own_addresses(version: int) -> list[str]:
    """Return the addresses of this computer, the one of the way out first. Nothing is sent."""
    family, outside = (
        (socket.AF_INET, "192.0.2.1") if version == 4 else (socket.AF_INET6, "2001:db8::1")
    )
    found: list[str] = []
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((outside, 9))
            found.append(str(probe.getsockname()[0]))
        except OSError:
            pass
    try:
        each = socket.getaddrinfo(socket.gethostname(), None, family)
        found += [str(item[4][0]) for item in each]
    except OSError:
        pass
    return found


def _with_port(name: str, port: int) -> str:
    return f"[{name}]:{port}" if ":" in name else f"{name}:{port}"
