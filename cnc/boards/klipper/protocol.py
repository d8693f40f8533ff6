"""Klipper's message protocol, without input and output."""

from __future__ import annotations

import json
import re
import zlib
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from cnc.boards.pulse_board import crc16

# Errors of the protocol, by the side that is at fault.


class ProtocolError(Exception):
    """A message that cannot be sent or read."""


class LocalError(ProtocolError):
    """A command that this program must not send: unknown, or with wrong parameters."""


class RemoteError(ProtocolError):
    """A message or a dictionary of the board that does not follow the protocol."""


class WireError(ProtocolError):
    """The connection transfers nothing any more, or only damaged frames."""


# Integers of variable length.
#
# Klipper documentation, Protocol, "Variable Length Quantities": groups of 7 bits, the highest
# first, with bit 7 set in all bytes but the last. The first byte holds -32 to 95, so that an
# integer of n bytes is from ``-2**(7n - 2)`` to ``3 * 2**(7n - 2) - 1``.

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


# The data dictionary of a board: its commands, responses, enumerations and constants.
#
# Klipper documentation, Protocol, "Data Dictionary". A board sends it as zlib-compressed JSON in
# answers to ``identify``. Only ``identify`` and its response are known before.

IDENTIFY = "identify offset=%u count=%c"
IDENTIFY_RESPONSE = "identify_response offset=%u data=%.*s"
IDENTIFY_ID, IDENTIFY_RESPONSE_ID = 1, 0
RANGES = {
    "%u": (0, 2**32 - 1),
    "%i": (-(2**31), 2**31 - 1),
    "%hu": (0, 2**16 - 1),
    "%hi": (-(2**15), 2**15 - 1),
    "%c": (0, 255),
}
"""Range of each type of integer."""
BYTES = ("%s", "%.*s", "%*s")
_PARAMETER = re.compile(r"^([A-Za-z_]\w*)=(%\S+)$")

Value = int | bytes


@dataclass(frozen=True, slots=True)
class Message:
    """A message with its parameters.

    Attributes:
        name: Name of the message; "" for a message for people only.
        values: Value of each parameter by its name.
        acknowledged: Number of the last command that the board had taken when it sent the message.
    """

    name: str
    values: Mapping[str, Value]
    acknowledged: int = 0

    def __getitem__(self, name: str) -> int:
        """Return an integer of the message."""
        value = self.values[name]
        if not isinstance(value, int):
            raise RemoteError(f"{self.name} {name} is not a number")
        return value

    def data(self, name: str) -> bytes:
        """Return bytes of the message."""
        value = self.values[name]
        if not isinstance(value, bytes):
            raise RemoteError(f"{self.name} {name} is not a string")
        return value


@dataclass(frozen=True, slots=True)
class MessageFormat:
    """The format of a message, such as ``queue_step oid=%c interval=%u count=%hu add=%hi``.

    Attributes:
        number: Identifier of the message on the wire.
        name: First word of the format.
        parameters: Name and type of each parameter.
    """

    number: int
    name: str
    parameters: tuple[tuple[str, str], ...]
    head: bytes = field(repr=False, default=b"")

    @classmethod
    def parse(cls, text: str, number: int) -> MessageFormat:
        """Return the format of a text.

        Raises:
            RemoteError: It has a parameter of an unknown type.
        """
        words = text.split()
        if not words:
            raise RemoteError("a message of the dictionary has no name")
        parameters: list[tuple[str, str]] = []
        for word in words[1:]:
            match = _PARAMETER.match(word)
            if match is None or (match[2] not in RANGES and match[2] not in BYTES):
                raise RemoteError(f"the dictionary has the parameter {word!r} in {text!r}")
            parameters.append((match[1], match[2]))
        return cls(number, words[0], tuple(parameters), encode(number))

    def encode(self, values: Mapping[str, Value]) -> bytes:
        """Return the bytes of a message.

        Raises:
            LocalError: A parameter is missing, unknown, or outside the range of its type.
        """
        parts = [self.head]
        for name, kind in self.parameters:
            value = values.get(name)
            if value is None:
                raise LocalError(f"{self.name} needs the parameter {name}")
            if kind in BYTES:
                if not isinstance(value, bytes):
                    raise LocalError(f"{self.name} {name} must be bytes")
                parts += (encode(len(value)), value)
                continue
            if not isinstance(value, int):
                raise LocalError(f"{self.name} {name} must be an integer")
            least, most = RANGES[kind]
            if not least <= value <= most:
                raise LocalError(f"{self.name} {name}={value} is outside {least} to {most}")
            parts.append(encode(value))
        if len(values) > len(self.parameters):
            unknown = set(values) - {name for name, _ in self.parameters}
            raise LocalError(f"{self.name} has no parameter {', '.join(sorted(unknown))}")
        return b"".join(parts)

    def decode(self, data: bytes, at: int) -> tuple[Message, int]:
        """Return the message whose parameters begin at a byte, and the place after it.

        Raises:
            RemoteError: The bytes end too early.
        """
        values: dict[str, Value] = {}
        for name, kind in self.parameters:
            value, at = decode(data, at)
            if kind in BYTES:
                if value < 0 or at + value > len(data):
                    raise RemoteError(f"{self.name} {name} is longer than its message")
                values[name] = data[at : at + value]
                at += value
            else:
                values[name] = (signed if RANGES[kind][0] < 0 else unsigned)(value)
        return Message(self.name, values), at


class Dictionary:
    """The messages that a board understands and sends.

    Attributes:
        constants: Constants of the firmware, such as CLOCK_FREQ and MCU.
        enumerations: Number of each name, by the name of the enumeration.
        version: Version of the firmware.
    """

    def __init__(self, content: Mapping[str, Any] | None = None) -> None:
        known = content or {}
        try:
            commands = {IDENTIFY: IDENTIFY_ID, **known.get("commands", {})}
            responses = {IDENTIFY_RESPONSE: IDENTIFY_RESPONSE_ID, **known.get("responses", {})}
            self._commands = {each.name: each for each in _formats(commands)}
            self._by_number = {each.number: each for each in _formats(responses)}
            self._command_numbers = {each.number: each for each in self._commands.values()}
            self._outputs = {int(number) for number in known.get("output", {}).values()}
            self.constants: dict[str, Any] = dict(known.get("config", {}))
            self.enumerations = {
                str(name): dict(_members(members))
                for name, members in known.get("enumerations", {}).items()
            }
            self.version = str(known.get("version", ""))
        except (AttributeError, TypeError, ValueError) as error:
            raise RemoteError(f"the dictionary is malformed: {error}") from error

    @classmethod
    def of(cls, data: bytes) -> Dictionary:
        """Return the dictionary in the bytes that ``identify`` gives.

        Raises:
            RemoteError: They are not zlib-compressed JSON of a dictionary.
        """
        try:
            content = json.loads(zlib.decompress(data))
        except (zlib.error, ValueError, RecursionError) as error:
            raise RemoteError(f"the dictionary is not readable: {error}") from error
        if not isinstance(content, dict):
            raise RemoteError("the dictionary is not a table")
        return cls(content)

    @property
    def command_names(self) -> frozenset[str]:
        """Names of the commands."""
        return frozenset(self._commands)

    def parameters(self, command: str) -> frozenset[str]:
        """Return the names of the parameters of a command; empty for an unknown one."""
        known = self._commands.get(command)
        return frozenset(name for name, _ in known.parameters) if known else frozenset()

    def encode(self, command: str, **values: Value) -> bytes:
        """Return the bytes of a command.

        Raises:
            LocalError: The board does not know the command, or its parameters are wrong.
        """
        known = self._commands.get(command)
        if known is None:
            raise LocalError(f"the firmware of the board has no command {command}")
        return known.encode(values)

    def decode_responses(self, contents: bytes) -> Iterator[Message]:
        """Yield the messages in the contents of a block from the board.

        Raises:
            RemoteError: A message is unknown or too short.
        """
        yield from self._decode(contents, self._by_number)

    def decode_commands(self, contents: bytes) -> Iterator[Message]:
        """Yield the commands in the contents of a block from the host.

        Raises:
            RemoteError: A command is unknown or too short.
        """
        yield from self._decode(contents, self._command_numbers)

    def encode_response(self, name: str, **values: Value) -> bytes:
        """Return the bytes of a response, for a simulator.

        Raises:
            LocalError: There is no such response, or its parameters are wrong.
        """
        for each in self._by_number.values():
            if each.name == name:
                return each.encode(values)
        raise LocalError(f"there is no response {name}")

    def number(self, enumeration: str, name: str) -> int | None:
        """Return the number of a name in an enumeration, None if it has none."""
        return self.enumerations.get(enumeration, {}).get(name)

    def constant(self, name: str, default: float | None = None) -> float:
        """Return a constant that is a number.

        Raises:
            RemoteError: The firmware has no such number, and there is no default.
        """
        value = self.constants.get(name, default)
        try:
            if value is None:
                raise ValueError
            return float(value)
        except (TypeError, ValueError):
            raise RemoteError(f"the dictionary has no number {name}") from None

    def _decode(self, contents: bytes, formats: Mapping[int, MessageFormat]) -> Iterator[Message]:
        at = 0
        while at < len(contents):
            number, after = decode(contents, at)
            known = formats.get(number)
            if known is None:
                if number in self._outputs:
                    yield Message("", {"text": contents[after:]})
                    return
                raise RemoteError(f"the message {number} is not in the dictionary")
            message, at = known.decode(contents, after)
            yield message


def _formats(messages: Mapping[str, Any]) -> Iterator[MessageFormat]:
    for text, number in messages.items():
        yield MessageFormat.parse(text, int(number))


def _members(members: Mapping[str, Any]) -> Iterator[tuple[str, int]]:
    """Yield the names and numbers of an enumeration; ``"PA0": [0, 8]`` stands for eight."""
    for name, number in members.items():
        if isinstance(number, int):
            yield name, number
            continue
        first, count = (int(each) for each in number)
        stem = name.rstrip("0123456789")
        begin = int(name[len(stem) :] or 0)
        for k in range(count):
            yield f"{stem}{begin + k}", first + k


# Message blocks: length, sequence number, contents, CRC, sync byte.
#
# Klipper documentation, Protocol, "Message Blocks".
#
#       length | 0x10 + sequence | contents, 0 to 59 bytes | CRC-16, high byte first | 0x7E

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


# The host's end of the protocol: numbered blocks, acknowledgements, and sending again.
#
# The board takes blocks in the order of their sequence numbers (modulo 16) and answers each with an
# empty block, which has the number that it expects next. The same number in a second empty block is
# a nak: the board has received a damaged block, or one out of order. A response with this number
# before the first one changes nothing. After a nak, or without an answer in time, all blocks
# without acknowledgement are sent again (go-back-N).
#
#       sent       0  1  2  3  4          2  3  4
#                       x                 ↑
#       answers      1  2     2  2  ──────┘          3  4  5     naks that the same loss has caused
#                             nak (ignored)                      are ignored for a round trip
#
# The timeout follows the measured round trips (RFC 6298). It doubles with each repetition that it
# causes, until the board acknowledges a block: a busy board answers late, and what comes twice
# costs it more time. Responses of the board are not repeated: who waits for one must ask again.

MAX_BLOCKS = 12
"""Most blocks without acknowledgement, less than the 16 sequence numbers."""
DEFAULT_WINDOW = MAX_BLOCKS * 64
"""Most bytes without acknowledgement, for a firmware without RECEIVE_WINDOW."""
FIRST_TIMEOUT_S, LEAST_TIMEOUT_S, MOST_TIMEOUT_S = 0.1, 0.025, 0.1
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
        at: Time when its last byte was first on the board, s.
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
    """Estimate of the round trip, s, and of the timeout (RFC 6298, section 2).

    It begins when a block has left the wire, so a long one tells of a busy board.

    Attributes:
        mean, least: Its mean, and its least of late, s.
        timeout: Time without acknowledgement after which blocks are sent again, s.
    """

    def __init__(self) -> None:
        self.mean = self.least = 0.0
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
            self.least = min(seconds, self.least + (self.mean - self.least) / 8)
        self.in_time()

    def in_time(self) -> None:
        """Take back what :meth:`late` has done: the board has acknowledged a block."""
        if self.mean:
            timeout = self.mean + 4 * self._deviation
            self.timeout = min(max(timeout, LEAST_TIMEOUT_S), MOST_TIMEOUT_S)

    def late(self) -> None:
        """Double the timeout until the board acknowledges a block (RFC 6298, section 5.5)."""
        self.timeout = min(2 * self.timeout, MOST_TIMEOUT_S)


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
        self._told = 0  # Number in the last empty block.
        self._held = 0  # Bytes that the board still holds, although a response acknowledges them.

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
            late = now - self._sent_at >= self.round_trip.timeout
            if late or self._again:
                parts.append(bytes((SYNC,)))
                for each in self._sent:
                    each.repeated = True
                    parts.append(each.data)
                self.resent += len(self._sent)
                drained = self._drained(len(self._sent[0].data), now)
                self._sent_at = self._drained(self._flying - len(self._sent[0].data), now)
                self._deaf_until = drained + max(self.round_trip.least, LEAST_DEAF_S)
                if not self._again:
                    self.round_trip.late()
                self._most = SMALL_CONTENTS
                self._clean = 0
        self._again = False
        while self._waiting and (self.synchronised or not self._sent):
            block = self._next_block()
            if not block:
                break
            drained = self._drained(len(block), now)
            if not self._sent:
                self._progress_at, self._sent_at = now, drained
            self._sent.append(_Sent(block, self.appended - len(self._waiting), drained))
            self._flying += len(block)
            parts.append(block)
        return b"".join(parts)

    def _drained(self, size: int, now: float) -> float:
        """Return when bytes that are sent now have left the wire, s."""
        self._wire_free = max(now, self._wire_free) + size * self.byte_s
        return self._wire_free

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
            if empty and self._told == self._base:
                if self._sent and now >= self._deaf_until:
                    self._again = True
                    # After a repetition, a block that comes twice is out of order.
                    self.refused += not self._sent[0].repeated
            elif empty:
                self._told, self._held = self._base, 0
            return
        for _ in range(done):
            first = self._sent.popleft()
            self._flying -= len(first.data)
            self.acknowledged = first.last
            self._held = 0 if empty else len(first.data)
            if not first.repeated:
                self.round_trip.add(max(now - first.at, 1e-6))
                self._clean += 1
        self.round_trip.in_time()
        if self._clean >= CLEAN_BLOCKS:
            self._most = MAX_CONTENTS
        self._base += done
        if empty:
            self._told = self._base
        self._progress_at = now
        self._sent_at = max(now, self._sent_at)

    def _renumber(self, expected: int) -> None:
        """Continue from another sequence number; what was sent is sent again."""
        blocks = [each.data[2:-3] for each in self._sent]
        self._sent.clear()
        self._flying = 0
        self._base = self._told = expected
        self._held = 0
        self._waiting.extendleft(reversed(blocks))

    def _next_block(self) -> bytes:
        """Return the next block within the window, empty if there is no space."""
        if len(self._sent) >= MAX_BLOCKS:
            return b""
        whole = self.window - self._flying - self._held - 5
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
