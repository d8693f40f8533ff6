"""The stepper board's side of the connection: bytes in, events out, and bytes to be sent; nothing here
reads, writes or waits.

The format is in ``firmware/PROTOCOL.md``. The stream of segments and commands goes out in numbered
frames, resent from the first one that was not acknowledged (go-back-N):

    acknowledged │ on their way, at most 96 bytes on the connection and no more than the board has room for │ not sent yet
                 ^ base                                                                               ^

Requests (start, stop, position ..) carry a token that the board's next status repeats; until then
they are sent again.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections import deque
from dataclasses import dataclass
from enum import IntEnum

VERSION = 1
MOST_IN_FLIGHT = 96
"""Bytes on the connection that the board has not acknowledged: its ring holds 128."""
FRAME_STREAM = 40
"""Bytes of the stream in a frame: two frames fit into what may be in flight."""
LONGEST_FRAME = 64
"""Bytes; what is longer without an end is not the board's."""
RESEND_S = 0.03
"""After so long without progress frames are sent again; a request after as long without an
answer.
"""
TURN_S = 0.004
"""A nak that comes sooner after frames were sent again speaks of the first time."""
HELLO_SEQUENCE = 0x71
"""Chosen so that no byte of a hello is a real-time command of GRBL or ends a line: it must do
nothing to another kind of board.
"""
NO_TOKEN = -1
"""A hello's: no status answers it, though the board may say one by itself before."""
PROMISE = 0x7FFF
"""A frame's promise counts milliseconds to here, and then from 0."""
PROMISED_END = 0x8000


class Kind(IntEnum):
    """Types of frames: the host's, then the board's."""

    DATA = 0x01
    HELLO = 0x02
    ASK = 0x03
    CONFIGURE = 0x04
    SET_POSITION = 0x05
    RUN = 0x06
    STOP = 0x07
    CLEAR = 0x08
    ACK = 0x81
    NAK = 0x82
    STATUS = 0x83
    WELCOME = 0x84


class State(IntEnum):
    """What the board does."""

    IDLE = 0
    RUNNING = 1
    RAMPING = 2
    ALARM = 3
    TOUCHED = 4


class Alarm(IntEnum):
    """Why the board has stopped."""

    NONE = 0
    UNDERRUN = 1
    SILENCE = 2
    EMERGENCY_STOP = 3
    LIMIT = 4
    STOPPED_BY_HOST = 5
    BAD_STREAM = 6


@dataclass(frozen=True, slots=True)
class Welcome:
    """The board tells what it is. room: bytes of the stream that it holds; least_ticks: smallest
    time between two grid moves.
    """

    version: int
    axes: int = 0
    tick_ns: int = 0
    room: int = 0
    least_ticks: int = 0
    state: State = State.IDLE
    position_known: bool = False


@dataclass(frozen=True, slots=True)
class Status:
    """How the board does. inputs: bits 0-3 limits, 4 probe, 5 e-stop, 6 hold, 7 resume. taken:
    bytes of the stream decoded so far.

    board_ms: where in the stream it plays, by the clock that the promises are in; None while it
    doesn't. holds, resumes: how often these buttons were pressed since the board's reset, modulo
    256.
    """

    token: int
    state: State
    alarm: Alarm
    position_known: bool
    inputs: int
    taken: int
    board_ms: int | None
    position: tuple[int, ...]
    holds: int = 0
    resumes: int = 0


Event = Welcome | Status

_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def crc16(data: bytes) -> int:
    """CRC-16/MCRF4XX: polynomial 0x1021 reflected, begun with 0xFFFF; 0 over data and its own CRC,
    low byte first.
    """
    straight = crc_hqx(data.translate(_REVERSED), 0xFFFF)
    return _REVERSED[straight >> 8] | _REVERSED[straight & 0xFF] << 8


def frame(kind: int, sequence: int, payload: bytes = b"") -> bytes:
    """A frame as it goes over the connection."""
    body = bytes((kind, sequence)) + payload
    body += crc16(body).to_bytes(2, "little")
    # COBS (Cheshire, Baker 1999): each zero becomes the distance to the next; frames are far too
    # short for blocks of 254
    return b"".join(bytes((len(block) + 1,)) + block for block in body.split(b"\0")) + b"\0"


def unframed(data: bytes) -> tuple[int, int, bytes] | None:
    """Kind, sequence and payload of what stood between two zeros; None if it is no frame."""
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


@dataclass(slots=True)
class _Frame:
    sequence: int
    encoded: bytes
    size: int
    promise_ms: int
    note: int


class StepperLink:
    """One conversation with a board. ``now`` is seconds by any clock that is never set back."""

    def __init__(self) -> None:
        self.welcome: Welcome | None = None
        self.state = State.IDLE
        self.noise = bytearray()
        """What came and was no frame, before the first one that was: the words of another kind of
        board.
        """
        self.heard_at: float | None = None
        self.resent = 0
        self.confirmed_note = 0
        """The note of the last stretch of the stream that the board has taken in."""
        self._incoming = bytearray()
        self._waiting: deque[_Frame] = deque()
        self._flying: deque[_Frame] = deque()
        self._next = 0
        self._room = 0
        self._promised_ms: int | None = None
        self._moved_at = 0.0
        self._sent_again_at = -1.0
        self._token = 0
        self._request: tuple[int, bytes] | None = None
        self._requested_at = 0.0
        self._out = bytearray()

    # -------------------------------------------------------------------------------------------------------------
    # the host's side

    def hello(self, now: float) -> None:
        """Ask the board what it is, until it answers."""
        self._request = (NO_TOKEN, b"\0" + frame(Kind.HELLO, HELLO_SEQUENCE, bytes((VERSION,))))
        self._send_request(now)

    def ask(self) -> None:
        """Ask for a status."""
        self._out += frame(Kind.ASK, self._token)

    def request(self, kind: Kind, payload: bytes, now: float) -> None:
        """Ask for something to be done; :attr:`requesting` until the board says that it was."""
        self._token = self._token % 255 + 1
        self._request = (self._token, frame(kind, self._token, payload))
        self._send_request(now)

    def give_up(self) -> None:
        """The request will not be answered."""
        self._request = None

    @property
    def requesting(self) -> bool:
        """Whether a request has not been answered yet."""
        return self._request is not None

    def stream(self, data: bytes, until_ms: int, *, end: bool = False, note: int = 0) -> None:
        """Append to the stream. until_ms: when what is appended has been played, since it was
        started; end: nothing need follow.
        """
        for at in range(0, len(data), FRAME_STREAM):
            part = data[at : at + FRAME_STREAM]
            promise = until_ms & PROMISE | (
                PROMISED_END if end and at + FRAME_STREAM >= len(data) else 0
            )
            encoded = frame(Kind.DATA, self._next, promise.to_bytes(2, "little") + part)
            self._waiting.append(_Frame(self._next, encoded, len(part), until_ms, note))
            self._next = (self._next + 1) % 256

    @property
    def unsent(self) -> int:
        """Bytes of the stream that have not been sent once."""
        return sum(each.size for each in self._waiting)

    @property
    def unconfirmed(self) -> int:
        """Bytes of the stream that the board has not acknowledged."""
        return self.unsent + sum(each.size for each in self._flying)

    @property
    def full(self) -> bool:
        """Whether something waits because the board has no room for it."""
        return bool(self._waiting) and not self._flying and self._waiting[0].size > self._room

    def drop(self) -> None:
        """Forget what has not been acknowledged: the board has stopped. What is numbered already
        goes out as empty frames.
        """
        for each in (*self._flying, *self._waiting):
            each.encoded, each.size = (
                frame(Kind.DATA, each.sequence, PROMISED_END.to_bytes(2, "little")),
                0,
            )

    def outgoing(self, now: float) -> bytes:
        """What is to be written now."""
        if self._request is not None and now - self._requested_at >= RESEND_S:
            self._send_request(now)
        if self._flying and now - self._moved_at >= RESEND_S:
            self._send_again(now)
        flying = sum(len(each.encoded) for each in self._flying)
        room = self._room - sum(each.size for each in self._flying)
        while (
            self._waiting
            and flying + len(self._waiting[0].encoded) <= MOST_IN_FLIGHT
            and self._waiting[0].size <= room
        ):
            each = self._waiting.popleft()
            if not self._flying:
                self._moved_at = now
            self._flying.append(each)
            flying += len(each.encoded)
            room -= each.size
            self._out += each.encoded
        out = bytes(self._out)
        self._out.clear()
        return out

    # ------------------------------------------------------------------------------------------------------------
    # the board's side

    def receive(self, data: bytes, now: float) -> list[Event]:
        """Take in bytes; what the board has said with them."""
        self._incoming += data
        *whole, rest = bytes(self._incoming).split(b"\0")
        events = []
        for each in whole:
            found = unframed(each) if each else None
            if found is None:
                self._is_noise(each + b"\0")
            else:
                event = self._said(*found, now)
                if event is not None:
                    events.append(event)
        if len(rest) > LONGEST_FRAME:
            self._is_noise(rest)
            rest = b""
        self._incoming[:] = rest
        return events

    @property
    def murmur(self) -> bytes:
        """All that came and was no frame, the last bytes included, while no frame ever came."""
        return bytes(self.noise + self._incoming)

    def _is_noise(self, data: bytes) -> None:
        if self.heard_at is None and len(self.noise) < 4096:
            self.noise += data

    def _said(self, kind: int, sequence: int, payload: bytes, now: float) -> Event | None:
        if kind == Kind.WELCOME and len(payload) >= 4 and payload[:3] == b"cnc":
            self.heard_at = now
            return self._welcomed(sequence, payload)
        if kind in (Kind.ACK, Kind.NAK) and len(payload) >= 3:
            self.heard_at = now
            self._acknowledged(sequence, payload[0], payload[1] | payload[2] << 8, now)
            if kind == Kind.NAK and self._flying and now - self._sent_again_at >= TURN_S:
                self._send_again(now)
            return None
        if kind == Kind.STATUS and len(payload) >= 31:
            self.heard_at = now
            return self._reported(sequence, payload, now)
        return None

    def _welcomed(self, sequence: int, payload: bytes) -> Welcome:
        """A board of another version is known by that alone: the rest may look otherwise."""
        welcome = Welcome(payload[3])
        if payload[3] == VERSION and len(payload) >= 13:
            axes, tick_ns, room, least, state, known = struct.unpack_from("<BHHHBB", payload, 4)
            welcome = Welcome(
                payload[3],
                axes,
                tick_ns,
                room,
                least,
                State(min(state, State.TOUCHED)),
                bool(known),
            )
            if self.welcome is None:
                self._next, self.state = sequence, welcome.state
        self.welcome = welcome
        if self._request is not None and self._request[0] == NO_TOKEN:
            self._request = None
        return welcome

    def _reported(self, token: int, payload: bytes, now: float) -> Status:
        expected, state, room, alarm, known, inputs, taken, left, *position, holds, resumes = (
            struct.unpack_from("<BBHBBBIh4iBB", payload)
        )
        self._acknowledged(expected, state, room, now)
        if self._request is not None and self._request[0] == token:
            self._request = None
        board_ms = (
            None
            if self.state != State.RUNNING or self._promised_ms is None
            else self._promised_ms - left
        )
        reason = Alarm(alarm) if alarm <= Alarm.BAD_STREAM else Alarm.NONE
        return Status(
            token,
            self.state,
            reason,
            bool(known),
            inputs,
            taken,
            board_ms,
            tuple(position),
            holds,
            resumes,
        )

    def _acknowledged(self, expected: int, state: int, room: int, now: float) -> None:
        """All frames before ``expected`` have arrived; one of none that is under way speaks of
        nothing.
        """
        if state <= State.TOUCHED:
            self.state = State(state)
        known = (expected - self._flying[0].sequence) % 256 if self._flying else 0
        if known <= len(self._flying):
            self._room = room
            for _ in range(known):
                done = self._flying.popleft()
                self._promised_ms = done.promise_ms
                self.confirmed_note = done.note or self.confirmed_note
                self._moved_at = now

    def _send_again(self, now: float) -> None:
        for each in self._flying:
            self._out += each.encoded
            self.resent += len(each.encoded)
        self._moved_at = self._sent_again_at = now

    def _send_request(self, now: float) -> None:
        if self._request is not None:
            self._out += self._request[1]
            self._requested_at = now
