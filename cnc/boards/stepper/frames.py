"""Frames of the stepper board's protocol: CRC-16 and consistent overhead byte stuffing (COBS)."""

from __future__ import annotations

from cnc.boards.crc import crc16


def frame(kind: int, sequence: int, payload: bytes = b"") -> bytes:
    """Return a frame as it is sent."""
    body = bytes((kind, sequence)) + payload
    body += crc16(body).to_bytes(2, "little")
    # COBS (Cheshire, Baker 1999): each zero becomes the distance to the next one. Frames are too
    # short for blocks of 254.
    return b"".join(bytes((len(block) + 1,)) + block for block in body.split(b"\0")) + b"\0"


def unframed(data: bytes) -> tuple[int, int, bytes] | None:
    """Return kind, sequence and payload of the bytes between two zeros; None if not a frame."""
    body, at = bytearray(), 0
    while at < len(data):
        step = data[at]
        if step == 0 or at + step > len(data):
            return None
        body += data[at + 1 : at + step] + b"\0"
        at += step
    del body[-1:]
    if len(body) < 4 or crc16(bytes(body)) != 0:
        return None
    return body[0], body[1], bytes(body[2:-2])
