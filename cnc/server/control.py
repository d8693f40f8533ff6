"""Control of the machine: one client has it, the others watch."""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Callable

KEY_BYTES = 16


class ControlOfMachine:
    """The client that has control.

    Args:
        on_change: Called with the name of the new holder, None for none.

    Attributes:
        holder: Its name; None for nobody.
    """

    def __init__(self, on_change: Callable[[str | None], None]) -> None:
        self.holder: str | None = None
        self._key: str | None = None
        self._on_change = on_change

    def take(self, client: str) -> str:
        """Give control to a client; return its key. The key before is void."""
        self.holder, self._key = client, secrets.token_urlsafe(KEY_BYTES)
        self._on_change(client)
        return self._key

    def release(self) -> None:
        """Give control up."""
        self.holder = self._key = None
        self._on_change(None)

    def has(self, key: str | None) -> bool:
        """Return whether a key is that of the client that has control."""
        return (
            key is not None
            and self._key is not None
            and hmac.compare_digest(key.encode(), self._key.encode())
        )
