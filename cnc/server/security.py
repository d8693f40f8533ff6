"""Rules of every request, before anything else sees it: host, origin, token, type, size, rate.

- Host: an exact list, so that a name of an attacker that resolves to this computer (DNS rebinding)
  is refused.
- Origin: where a browser sends it, it is the address of the server itself. There is no CORS.
- Token: in every request, once one is set. It is compared in constant time.
- Content type: JSON alone, which a form of another page cannot send (CSRF).

Sources: WHATWG Fetch, section 3 (``Origin``, ``Sec-Fetch-Site``); RFC 6750, section 2.1 (bearer
tokens); RFC 6265bis, section 5.6.7 (``SameSite``); CSP level 3.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable, MutableMapping
from contextlib import suppress
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlencode

from starlette.exceptions import HTTPException

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

COOKIE = "cncrun-token"
MOST_BODY = 1 << 20
"""Bytes of a body, but of an upload."""
SHORT_BODY = 1 << 16
"""Bytes of a body whose unread rest does not end the connection."""
MOST_UPLOAD = 256 << 20
"""Bytes of an upload."""
LINGER = 2.0
"""Time for which the rest of a body that was refused is read, s."""
RATE, BURST = 200.0, 400.0
"""Requests per second of one address, and at once."""
MOST_ADDRESSES = 1024
"""Addresses whose rates are kept."""
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = (
    (b"content-security-policy", POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)
STOP = "/api/stop"


@dataclass(frozen=True, slots=True)
class Access:
    """Who may use the server.

    Attributes:
        hosts: Values of the header Host that are accepted.
        token: The token; None for none.
    """

    hosts: frozenset[str]
    token: str | None = None

    @property
    def origins(self) -> frozenset[str]:
        """Values of the header Origin that are accepted."""
        return frozenset(f"http://{host}" for host in self.hosts)


@dataclass(frozen=True, slots=True)
class Refusal:
    """The answer to a request that breaks a rule."""

    status: int
    code: str
    message: str
    hint: str = ""


class TooLarge(HTTPException):
    """A body is longer than its limit."""

    def __init__(self, most: int) -> None:
        super().__init__(413, finding(too_large(most)))  # type: ignore[arg-type]


class Rates:
    """Token buckets of the addresses."""

    def __init__(self, rate: float = RATE, burst: float = BURST) -> None:
        self._rate, self._burst = rate, burst
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def allow(self, address: str, now: float) -> bool:
        """Take a request of an address at a time in s; return whether it is within the rate."""
        left, last = self._buckets.pop(address, (self._burst, now))
        left = min(self._burst, left + (now - last) * self._rate)
        allowed = left >= 1.0
        self._buckets[address] = (left - 1.0 if allowed else left), now
        if len(self._buckets) > MOST_ADDRESSES:
            self._buckets.popitem(last=False)
        return allowed


class Guard:
    """Refuses requests that break a rule; adds the security headers to all answers.

    Args:
        app: The application.
        access: Who may use the server.
        has_control: Whether a key is that of the client that has control: no rate limits it.
        rates: The limits of rates.
    """

    def __init__(
        self,
        app: App,
        access: Access,
        has_control: Callable[[str | None], bool],
        rates: Rates | None = None,
    ) -> None:
        self._app, self._access, self._rates = app, access, rates or Rates()
        self._has_control = has_control

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check one request; ASGI."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        headers = _headers(scope)
        refusal = self._refusal(scope, headers)
        if scope["type"] == "websocket":
            if refusal is None:
                await self._app(scope, receive, send)
            else:
                await receive()
                await send({"type": "websocket.close", "code": 1008, "reason": refusal.code})
            return
        if refusal is not None:
            await _refuse(send, refusal, receive if _has_long_body(headers) else None)
            return
        query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
        if "token" in query and scope["path"] == "/" and self._access.token is not None:
            await _set_cookie(send, self._access.token)
            return
        await self._guarded(scope, receive, send, is_long=_has_long_body(headers))

    async def _guarded(self, scope: Scope, receive: Receive, send: Send, *, is_long: bool) -> None:
        """Call the application, with a limit of the body, and the headers."""
        most, taken, is_complete = _most_body(scope), 0, False

        async def limited() -> Message:
            nonlocal taken, is_complete
            message = await receive()
            is_complete = not message.get("more_body", False)
            taken += len(message.get("body", b""))
            if taken > most:
                raise TooLarge(most)
            return message

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                own = {name for name, _ in message.get("headers", ())}
                added = [each for each in HEADERS if each[0] not in own]
                if is_long and not is_complete:
                    # The rest of a body that was refused is of no use.
                    added.append((b"connection", b"close"))
                message = {**message, "headers": [*message.get("headers", ()), *added]}
            elif is_long and not is_complete and not message.get("more_body", False):
                await send({**message, "more_body": True})
                await _linger(receive)
                message = {"type": "http.response.body"}
            await send(message)

        await self._app(scope, limited, with_headers)

    def _refusal(self, scope: Scope, headers: dict[str, str]) -> Refusal | None:
        """Return the rule that a request breaks, or None."""
        access, path = self._access, scope["path"]
        address = (scope.get("client") or ("",))[0]
        # A flood from the same address delays neither a stop nor the operator.
        exempt = path == STOP or self._has_control(headers.get("x-control"))
        if not exempt and not self._rates.allow(address, time.monotonic()):
            return Refusal(429, "too-many-requests", "too many requests", "wait a second")
        if headers.get("host", "").lower() not in access.hosts:
            hint = f"use one of {', '.join(sorted(access.hosts))}"
            return Refusal(403, "host-refused", "the server does not have this name", hint)
        origin = headers.get("origin")
        if origin is not None and origin.lower() not in access.origins:
            return Refusal(403, "origin-refused", "a page of another origin may not do this")
        # Links from elsewhere lead to the page itself, and to nothing else.
        is_link = path == "/" and headers.get("sec-fetch-mode") == "navigate"
        if origin is None and headers.get("sec-fetch-site") == "cross-site" and not is_link:
            return Refusal(403, "origin-refused", "a page of another origin may not do this")
        if access.token is not None and not self._has_token(scope, headers):
            hint = "open the link that cncrun serve has printed"
            return Refusal(401, "token-wrong", "the token is missing or wrong", hint)
        if scope["type"] == "http" and scope["method"] in ("POST", "PUT", "PATCH"):
            kind = headers.get("content-type", "").partition(";")[0].strip().lower()
            if kind != "application/json":
                hint = "send Content-Type: application/json"
                return Refusal(415, "content-type", "the body is not JSON", hint)
            length = headers.get("content-length", "0")
            if not length.isdigit() or int(length) > _most_body(scope):
                return too_large(_most_body(scope))
        return None

    def _has_token(self, scope: Scope, headers: dict[str, str]) -> bool:
        wanted = (self._access.token or "").encode()
        scheme, _, given = headers.get("authorization", "").partition(" ")
        tokens = [given.strip()] if scheme.lower() == "bearer" else []
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        except CookieError:
            cookie = None
        if cookie is not None:
            tokens.append(cookie.value)
        if scope["path"] == "/" or scope["type"] == "websocket":
            query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
            tokens += query.get("token", [])
        return any(hmac.compare_digest(token.encode(), wanted) for token in tokens)


def too_large(most: int) -> Refusal:
    """Return the refusal of a body that is longer than ``most`` bytes."""
    message = f"the body is longer than {most >> 20} MB"
    return Refusal(413, "body-too-large", message, "cut the program into parts")


def finding(refusal: Refusal) -> dict[str, str]:
    """Return the body of a refusal."""
    return {"code": refusal.code, "message": refusal.message, "hint": refusal.hint}


def link(host: str, token: str | None) -> str:
    """Return the address of the page."""
    query = "" if token is None else "?" + urlencode({"token": token})
    return f"http://{host}/{query}"


def _most_body(scope: Scope) -> int:
    is_upload = scope["method"] == "PUT" and scope["path"].startswith("/api/jobs/")
    return MOST_UPLOAD if is_upload else MOST_BODY


def _has_long_body(headers: dict[str, str]) -> bool:
    length = headers.get("content-length", "0")
    return "transfer-encoding" in headers or (length.isdigit() and int(length) > SHORT_BODY)


def _headers(scope: Scope) -> dict[str, str]:
    """Return the headers; one that is given twice has both values, so that no rule accepts it."""
    headers: dict[str, str] = {}
    for name, value in scope["headers"]:
        key, text = name.decode("latin-1").lower(), value.decode("latin-1")
        separator = "; " if key == "cookie" else ", "
        headers[key] = f"{headers[key]}{separator}{text}" if key in headers else text
    return headers


async def _linger(receive: Receive) -> None:
    """Read the rest of a body that was refused, for a while, until its client closes.

    A connection that is closed with unread data is reset, and the client loses the answer.
    """
    with suppress(asyncio.TimeoutError):
        async with asyncio.timeout(LINGER):
            message = await receive()
            while message["type"] == "http.request" and message.get("more_body", False):
                message = await receive()


async def _refuse(send: Send, refusal: Refusal, receive: Receive | None = None) -> None:
    """Answer with a refusal, and close the connection.

    Args:
        send: Takes the answer.
        refusal: The answer.
        receive: Source of a long body, whose rest is read; None without one.
    """
    body = json.dumps(finding(refusal)).encode()
    headers = [
        (b"content-type", b"application/json"),
        (b"content-length", str(len(body)).encode()),
        (b"connection", b"close"),
        *HEADERS,
    ]
    await send({"type": "http.response.start", "status": refusal.status, "headers": headers})
    await send({"type": "http.response.body", "body": body, "more_body": receive is not None})
    if receive is not None:
        await _linger(receive)
        await send({"type": "http.response.body"})


async def _set_cookie(send: Send, token: str) -> None:
    """Keep the token of the link in a cookie, and lead to the page without it."""
    cookie = f"{COOKIE}={token}; Path=/; HttpOnly; SameSite=Strict"
    headers = [
        (b"location", b"/"),
        (b"set-cookie", cookie.encode()),
        (b"content-length", b"0"),
        *HEADERS,
    ]
    await send({"type": "http.response.start", "status": 303, "headers": headers})
    await send({"type": "http.response.body", "body": b""})
