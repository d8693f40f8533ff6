"""The host's end of the protocol: numbered blocks, acknowledgements, and sending again.

The board takes blocks in the order of their sequence numbers (modulo 16) and answers each with the
number that it expects next. An empty block with a number that acknowledges nothing is a nak: the
board has received a damaged block, or one out of order. After a nak, or without an answer in time,
all blocks without acknowledgement are sent again (go-back-N).

      sent       0  1  2  3  4          2  3  4
                      x                 ↑
      answers      1  2     2  2  ──────┘          3  4  5     naks that the same loss has caused
                            nak (ignored)                      are ignored for a round trip

The timeout follows the measured round trips (RFC 6298). It is not doubled, because nobody else
uses the line. Responses of the board are not repeated:
who waits for one must ask again.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from cnc.boards.klipper.protocol.errors import LocalError, WireError
from cnc.boards.klipper.protocol.frames import (
    MAX_CONTENTS,
    SEQUENCE,
    SYNC,
    BlockReader,
    block_bytes,
)

MAX_BLOCKS = 12
"""Most blocks without acknowledgement, less than the 16 sequence numbers."""
DEFAULT_WINDOW = MAX_BLOCKS * 64
"""Most bytes without acknowledgement, for a firmware without RECEIVE_WINDOW."""
FIRST_TIMEOUT_S, LEAST_TIMEOUT_S, MOST_TIMEOUT_S = 0.1, 0.025, 0.2
"""Time without acknowledgement after which blocks are sent again: at first, and its bounds."""
LEAST_DEAF_S = 0.002
"""Least time after a repetition in which naks are ignored: they belong to the same loss."""
SMALL_CONTENTS, CLEAN_BLOCKS = 20, 64
"""Contents of a block on a bad cable, where a long block is seldom whole, bytes; and number of
blocks without a repetition after which the cable counts as good.
"""
SILENCE_S = 1.0
"""Time after which a board that acknowledges nothing counts as lost."""
STANDSTILL_S = 0.1
"""Time between two calls of the host that tells nothing about the board: the host stood still."""


@dataclass(slots=True)
class _Sent:
    """A block without acknowledgement.

    Attributes:
        data: Its bytes.
        last: Number of its last command.
        at: Time when it was first sent, s.
        repeated: Whether it was sent again.
    """

    data: bytes
    last: int
    at: float
    repeated: bool = False


@dataclass(frozen=True, slots=True)
class Received:
    """A block from the board.

    Attributes:
        contents: Its responses.
        acknowledged: Number of the last command that the board had taken when it sent the block.
    """

    contents: bytes
    acknowledged: int


class RoundTrip:
    """Estimate of the round trip, s, and of the timeout (RFC 6298, section 2)."""

    def __init__(self) -> None:
        self.mean = 0.0
        self.least = 0.0
        self._deviation = 0.0
        self.timeout = FIRST_TIMEOUT_S

    def add(self, seconds: float) -> None:
        """Add a measurement."""
        if self.mean == 0.0:
            self.mean, self._deviation = seconds, seconds / 2
            self.least = seconds
        else:
            self._deviation += (abs(seconds - self.mean) - self._deviation) / 4
            self.mean += (seconds - self.mean) / 8
            self.least = min(self.least, seconds)
        timeout = self.mean + 4 * self._deviation
        self.timeout = min(max(timeout, LEAST_TIMEOUT_S), MOST_TIMEOUT_S)


class KlipperLink:
    """Blocks to and from a board.

    Attributes:
        window: Most bytes without acknowledgement.
        byte_s: Time of a byte on the wire, s.
        round_trip: Estimate of the round trip.
        appended: Number of commands so far.
        acknowledged: Number of the last command that the board has acknowledged.
        resent: Number of blocks that were sent again.
        refused: Number of blocks that the board has received damaged, or not at all.
        synchronised: Whether the board has sent the sequence number that it expects.
        settled: Whether this number is certain. Before, bytes from earlier may tell an old one.
    """

    def __init__(self) -> None:
        self.window = DEFAULT_WINDOW
        self.round_trip = RoundTrip()
        self.appended = self.acknowledged = self.resent = self.refused = 0
        self.synchronised = self.settled = False
        self._reader = BlockReader()
        self._base = 0
        self._sent: deque[_Sent] = deque()
        self._waiting: deque[bytes] = deque()
        self._flying = 0
        self._sent_at = 0.0
        self._progress_at: float | None = None
        self._called_at = 0.0
        self.byte_s = 0.0
        self._wire_free = 0.0
        self._most = MAX_CONTENTS
        self._clean = 0
        self._again = False
        self._deaf_until = 0.0

    @property
    def damaged(self) -> int:
        """Number of damaged blocks received."""
        return self._reader.damaged

    @property
    def idle(self) -> bool:
        """Whether everything has been acknowledged."""
        return not self._sent and not self._waiting

    @property
    def waiting(self) -> int:
        """Number of commands that were not sent yet."""
        return len(self._waiting)

    def send(self, command: bytes) -> None:
        """Append an encoded command; short ones share a block.

        Raises:
            LocalError: It does not fit into a block.
        """
        if len(command) > MAX_CONTENTS:
            raise LocalError(f"a command of {len(command)} bytes does not fit into a block")
        self._waiting.append(command)
        self.appended += 1

    def drop_waiting(self) -> None:
        """Discard the commands that were not sent yet."""
        self._waiting.clear()

    def outgoing(self, now: float) -> bytes:
        """Return the bytes to send now.

        Raises:
            WireError: The board has acknowledged nothing for a long time.
        """
        parts: list[bytes] = []
        missed = now - self._called_at
        self._called_at = now
        if missed > STANDSTILL_S:
            # The answers may wait to be read.
            self._sent_at += missed
            if self._progress_at is not None:
                self._progress_at += missed
        if self._sent:
            if self._progress_at is not None and now - self._progress_at > SILENCE_S:
                raise WireError("the board acknowledges nothing")
            if now - self._sent_at >= self.round_trip.timeout:
                self._again = True
            if self._again:
                parts.append(bytes((SYNC,)))
                for each in self._sent:
                    each.repeated = True
                    parts.append(each.data)
                self.resent += len(self._sent)
                # Until then, naks tell of what was sent before.
                first = self._sent[0].data
                drained = max(now, self._wire_free) + len(first) * self.byte_s
                self._deaf_until = drained + max(self.round_trip.least, LEAST_DEAF_S)
                self._sent_at = now
                self._most = SMALL_CONTENTS
                self._clean = 0
        self._again = False
        while self._waiting and (self.synchronised or not self._sent):
            block = self._next_block()
            if not block:
                break
            if not self._sent:
                self._progress_at = now
            self._sent.append(_Sent(block, self.appended - len(self._waiting), now))
            self._flying += len(block)
            self._sent_at = now
            parts.append(block)
        data = b"".join(parts)
        self._wire_free = max(now, self._wire_free) + len(data) * self.byte_s
        return data

    def receive(self, data: bytes, now: float) -> list[Received]:
        """Take received bytes; return the blocks that have contents."""
        found: list[Received] = []
        for block in self._reader.receive(data):
            self._acknowledge(block.sequence, now, empty=not block.contents)
            if block.contents:
                found.append(Received(block.contents, self.acknowledged))
        return found

    def _acknowledge(self, expected: int, now: float, *, empty: bool) -> None:
        """Take the sequence number that the board expects next."""
        done = expected - self._base & SEQUENCE
        self.synchronised = True
        if done > len(self._sent):
            if not self.settled:
                # The board expects another number, such as that after an earlier program.
                self._renumber(expected)
            return
        if done == 0:
            if empty and self._sent and now >= self._deaf_until:
                self._again = True
                # After a repetition, a block that comes twice is out of order.
                self.refused += not self._sent[0].repeated
            return
        for _ in range(done):
            first = self._sent.popleft()
            self._flying -= len(first.data)
            self.acknowledged = first.last
            if not first.repeated:
                self.round_trip.add(max(now - first.at, 1e-6))
                self._clean += 1
        if self._clean >= CLEAN_BLOCKS:
            self._most = MAX_CONTENTS
        self._base += done
        self._progress_at = self._sent_at = now

    def _renumber(self, expected: int) -> None:
        """Continue from another sequence number; what was sent is sent again."""
        blocks = [each.data[2:-3] for each in self._sent]
        self._sent.clear()
        self._flying = 0
        self._base = expected
        self._waiting.extendleft(reversed(blocks))

    def _next_block(self) -> bytes:
        """Return the next block within the window, empty if there is no space."""
        if len(self._sent) >= MAX_BLOCKS:
            return b""
        whole = self.window - self._flying - 5
        room = min(self._most, whole)
        contents = bytearray()
        taken = 0
        for command in self._waiting:
            if len(contents) + len(command) > room and (contents or len(command) > whole):
                break
            contents += command
            taken += 1
        for _ in range(taken):
            self._waiting.popleft()
        return block_bytes(self._base + len(self._sent), bytes(contents)) if taken else b""
