"""Integers of variable length.

Klipper documentation, Protocol, "Variable Length Quantities": groups of 7 bits, the highest first,
with bit 7 set in all bytes but the last. The first byte holds -32 to 95, so that an integer of n
bytes is from ``-2**(7n - 2)`` to ``3 * 2**(7n - 2) - 1``.
"""

from __future__ import annotations

from cnc.boards.klipper.protocol.errors import LocalError, RemoteError

LEAST, MOST = -(2**31), 2**32 - 1
"""Range of the integers of the protocol."""
MAX_BYTES = 5
NEGATIVE = 0x60
"""Bits of the first byte that are set in a negative integer."""


def encode(value: int) -> bytes:
    """Return the bytes of an integer.

    Raises:
        LocalError: It needs more than 32 bits.
    """
    if -32 <= value < 96:
        return bytes((value & 0x7F,))
    if not LEAST <= value <= MOST:
        raise LocalError(f"{value} does not fit into 32 bits")
    size = 2
    while size < MAX_BYTES and not -(1 << 7 * size - 2) <= value < 3 << 7 * size - 2:
        size += 1
    return bytes(
        (value >> 7 * place & 0x7F) | (0x80 if place else 0) for place in range(size - 1, -1, -1)
    )


def decode(data: bytes, at: int) -> tuple[int, int]:
    """Return the integer that begins at a byte, and the place after it.

    The firmware encodes all integers as signed ones of 32 bits, and an integer of 5 bytes has the
    lowest 3 of the highest 4 bits in its first byte. So the sign may be lost or added: see
    :func:`unsigned` and :func:`signed`.

    Raises:
        RemoteError: The bytes end within the integer, or it is longer than 5 bytes.
    """
    if at >= len(data):
        raise RemoteError("the message ends before its last parameter")
    byte = data[at]
    value = byte & 0x7F
    if byte & NEGATIVE == NEGATIVE:
        value -= 0x80
    first = at
    while byte & 0x80:
        at += 1
        if at >= len(data) or at - first >= MAX_BYTES:
            raise RemoteError("an integer of the message has no end")
        byte = data[at]
        value = value << 7 | byte & 0x7F
    return value, at + 1


def unsigned(value: int) -> int:
    """Return the lowest 32 bits of an integer."""
    return value & 0xFFFFFFFF


def signed(value: int) -> int:
    """Return the lowest 32 bits of an integer as a signed one."""
    return (value + 2**31) % 2**32 - 2**31
