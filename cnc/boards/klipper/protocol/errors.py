"""Errors of the protocol, by the side that is at fault."""

from __future__ import annotations


class ProtocolError(Exception):
    """A message that cannot be sent or read."""


class LocalError(ProtocolError):
    """A command that this program must not send: unknown, or with wrong parameters."""


class RemoteError(ProtocolError):
    """A message or a dictionary of the board that does not follow the protocol."""


class WireError(ProtocolError):
    """The connection transfers nothing any more, or only damaged frames."""
