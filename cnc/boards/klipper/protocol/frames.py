"""Message blocks: length, sequence number, contents, CRC, sync byte.

Klipper documentation, Protocol, "Message Blocks".

      length | 0x10 + sequence | contents, 0 to 59 bytes | CRC-16, high byte first | 0x7E
"""

from __future__ import annotations

from dataclasses import dataclass

from cnc.boards.crc import crc16
from cnc.boards.klipper.protocol.errors import LocalError

SYNC = 0x7E
MIN_LENGTH, MAX_LENGTH = 5, 64
HEAD, TAIL = 2, 3
MAX_CONTENTS = MAX_LENGTH - HEAD - TAIL
DESTINATION, SEQUENCE = 0x10, 0x0F
"""High and low bits of the second byte."""


@dataclass(frozen=True, slots=True)
class Block:
    """A message block: its sequence number, 0 to 15, and its contents."""

    sequence: int
    contents: bytes


def block_bytes(sequence: int, contents: bytes) -> bytes:
    """Return a message block as it is sent.

    Raises:
        LocalError: The contents are too long.
    """
    if len(contents) > MAX_CONTENTS:
        raise LocalError(f"{len(contents)} bytes do not fit into a message block")
    body = bytes((len(contents) + HEAD + TAIL, DESTINATION | sequence & SEQUENCE)) + contents
    return body + crc16(body).to_bytes(2, "big") + bytes((SYNC,))


class BlockReader:
    """Finds message blocks in received bytes.

    After a fault it skips to the next sync byte.

    Attributes:
        damaged: Number of faults so far: wrong length, CRC, or sync byte.
    """

    def __init__(self) -> None:
        self.damaged = 0
        self._data = bytearray()

    def receive(self, data: bytes) -> list[Block]:
        """Return the blocks that are complete with these bytes."""
        self._data += data
        found: list[Block] = []
        at = 0
        while at < len(self._data):
            if self._data[at] == SYNC:
                at += 1
                continue
            size = self._size(at)
            if size > 0 and at + size > len(self._data):
                break
            if size > 0 and self._is_block(at, size):
                sequence = self._data[at + 1] & SEQUENCE
                found.append(Block(sequence, bytes(self._data[at + HEAD : at + size - TAIL])))
                at += size
                continue
            self.damaged += 1
            sync = self._data.find(SYNC, at + 1)
            at = len(self._data) if sync < 0 else sync + 1
        del self._data[:at]
        return found

    def _size(self, at: int) -> int:
        """Return the length of the block that begins at a byte, 0 if none does."""
        size = self._data[at]
        if not MIN_LENGTH <= size <= MAX_LENGTH:
            return 0
        if at + 1 < len(self._data) and self._data[at + 1] & ~SEQUENCE != DESTINATION:
            return 0
        return size

    def _is_block(self, at: int, size: int) -> bool:
        end = at + size
        if self._data[end - 1] != SYNC:
            return False
        crc = crc16(bytes(self._data[at : end - TAIL]))
        return self._data[end - TAIL] == crc >> 8 and self._data[end - TAIL + 1] == crc & 0xFF
