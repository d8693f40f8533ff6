"""The host's side of the stepper board's protocol: bytes in, events and bytes out, without I/O.

The format is in ``firmware/PROTOCOL.md``. The stream of segments and commands is sent in numbered
frames. After a loss they are sent again from the first frame without acknowledgement (go-back-N):

    acknowledged │ in flight: at most 96 bytes, and what the board's buffer can hold │ not sent yet
                 ^ base                                                              ^

Requests (start, stop, position ..) have a token, which the next status of the board repeats. Until
then they are sent again.
"""

from __future__ import annotations

import struct
from collections import deque
from dataclasses import dataclass
from enum import IntEnum

from cnc.boards.pulse_board import crc16

# Frames of the stepper board's protocol: CRC-16 and consistent overhead byte stuffing (COBS).


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


VERSION = 1
MAX_IN_FLIGHT = 96
"""Bytes sent that the board has not acknowledged: its ring buffer holds 128."""
FRAME_STREAM = 40
"""Bytes of the stream in a frame, so that two frames can be in flight."""
MAX_FRAME = 64
"""Longest frame, bytes; longer data without an end is not from the board."""
RESEND_S = 0.03
"""Time without progress, or without an answer to a request, after which frames are sent again."""
TURN_S = 0.004
"""A NAK within this time after frames were sent again is about the first transmission."""
HELLO_SEQUENCE = 0x71
"""No byte of a hello with this number is a line end or a real-time command of GRBL, so that a hello
has no effect on another kind of board.
"""
NO_TOKEN = -1
"""The token of a hello, which no status answers."""
PROMISE = 0x7FFF
"""Mask of a frame's promise, in milliseconds modulo its range."""
FOURTH_LIMIT = 0x01
"""Bit of the last byte of a welcome, which earlier firmware does not send."""
PROMISED_END = 0x8000
"""Bit of a promise: nothing need follow."""


class Kind(IntEnum):
    """Types of frames: those of the host, then those of the board."""

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
    """States of the board."""

    IDLE = 0
    RUNNING = 1
    RAMPING = 2
    ALARM = 3
    TOUCHED = 4


class Alarm(IntEnum):
    """Reasons for a stop of the board."""

    NONE = 0
    UNDERRUN = 1
    SILENCE = 2
    EMERGENCY_STOP = 3
    LIMIT = 4
    STOPPED_BY_HOST = 5
    BAD_STREAM = 6


@dataclass(frozen=True, slots=True)
class Welcome:
    """The board's description of itself.

    Attributes:
        version: Version of the protocol; for another version the other fields are not known.
        axes: Number of axes.
        tick_ns: Tick of its timer, ns.
        room: Capacity of its buffer for the stream, bytes.
        least_ticks: Least time between two grid moves, ticks.
        state: Its state.
        position_known: Whether it knows its position.
        fourth_limit: Whether A2 can be the limit input of the fourth output.
    """

    version: int
    axes: int = 0
    tick_ns: int = 0
    room: int = 0
    least_ticks: int = 0
    state: State = State.IDLE
    position_known: bool = False
    fourth_limit: bool = False


@dataclass(frozen=True, slots=True)
class Status:
    """A status of the board.

    Attributes:
        token: Token of the last request carried out.
        state: Its state.
        alarm: Reason for its stop.
        position_known: Whether it knows its position.
        inputs: Inputs: bits 0-3 limits, 4 probe, 5 e-stop, 6 hold, 7 resume.
        taken: Bytes of the stream decoded so far.
        board_ms: Its time in the stream, on the clock of the promises; None while it does not play.
        position: Count of each axis.
        holds: Presses of the hold button since the reset, modulo 256.
        resumes: Presses of the resume button since the reset, modulo 256.
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


@dataclass(slots=True)
class _Frame:
    sequence: int
    encoded: bytes
    size: int
    promise_ms: int
    note: int


class StepperLink:
    """State of the protocol with one board. ``now`` is the time of any monotonic clock, s.

    Attributes:
        welcome: The board's description of itself, None before the answer to a hello.
        state: State of the board.
        noise: Bytes before the first frame that were no frame.
        heard_at: Time of the last frame received.
        resent: Bytes sent again.
        confirmed_note: The note of the last part of the stream that the board has acknowledged.
    """

    def __init__(self) -> None:
        self.welcome: Welcome | None = None
        self.state = State.IDLE
        self.noise = bytearray()
        self.heard_at: float | None = None
        self.resent = 0
        self.confirmed_note = 0
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

    def hello(self, now: float) -> None:
        """Send a hello until the board answers."""
        self._request = (NO_TOKEN, b"\0" + frame(Kind.HELLO, HELLO_SEQUENCE, bytes((VERSION,))))
        self._send_request(now)

    def ask(self) -> None:
        """Request a status."""
        self._out += frame(Kind.ASK, self._token)

    def request(self, kind: Kind, payload: bytes, now: float) -> None:
        """Send a request; :attr:`requesting` until the board has carried it out."""
        self._token = self._token % 255 + 1
        self._request = (self._token, frame(kind, self._token, payload))
        self._send_request(now)

    def give_up(self) -> None:
        """Stop waiting for the answer to the request."""
        self._request = None

    @property
    def requesting(self) -> bool:
        """Whether a request is not answered yet."""
        return self._request is not None

    def stream(self, data: bytes, until_ms: int, *, end: bool = False, note: int = 0) -> None:
        """Append bytes to the stream.

        Args:
            data: Segments and commands.
            until_ms: Time at which they have been played, since the start of the stream, ms.
            end: Nothing need follow.
            note: Number that becomes ``confirmed_note`` when the board has acknowledged them.
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
        """Bytes of the stream that were never sent."""
        return sum(data.size for data in self._waiting)

    @property
    def unconfirmed(self) -> int:
        """Bytes of the stream that the board has not acknowledged."""
        return self.unsent + sum(data.size for data in self._flying)

    @property
    def full(self) -> bool:
        """Whether frames wait for space in the buffer of the board."""
        return bool(self._waiting) and not self._flying and self._waiting[0].size > self._room

    def drop(self) -> None:
        """Discard everything not acknowledged, because the board has stopped.

        Frames that have a number already are sent empty.
        """
        for data in (*self._flying, *self._waiting):
            data.encoded, data.size = (
                frame(Kind.DATA, data.sequence, PROMISED_END.to_bytes(2, "little")),
                0,
            )

    def outgoing(self, now: float) -> bytes:
        """Return the bytes to send now."""
        if self._request is not None and now - self._requested_at >= RESEND_S:
            self._send_request(now)
        if self._flying and now - self._moved_at >= RESEND_S:
            self._send_again(now)
        flying = sum(len(data.encoded) for data in self._flying)
        room = self._room - sum(data.size for data in self._flying)
        while (
            self._waiting
            and flying + len(self._waiting[0].encoded) <= MAX_IN_FLIGHT
            and self._waiting[0].size <= room
        ):
            data = self._waiting.popleft()
            if not self._flying:
                self._moved_at = now
            self._flying.append(data)
            flying += len(data.encoded)
            room -= data.size
            self._out += data.encoded
        out = bytes(self._out)
        self._out.clear()
        return out

    def receive(self, data: bytes, now: float) -> list[Event]:
        """Receive bytes, and return the events in them."""
        self._incoming += data
        *whole, rest = bytes(self._incoming).split(b"\0")
        events = []
        for piece in whole:
            parts = unframed(piece) if piece else None
            if parts is None:
                self._add_noise(piece + b"\0")
            else:
                event = self._event(*parts, now)
                if event is not None:
                    events.append(event)
        if len(rest) > MAX_FRAME:
            self._add_noise(rest)
            rest = b""
        self._incoming[:] = rest
        return events

    @property
    def foreign_bytes(self) -> bytes:
        """All bytes received while no frame came."""
        return bytes(self.noise + self._incoming)

    def _add_noise(self, data: bytes) -> None:
        if self.heard_at is None and len(self.noise) < 4096:
            self.noise += data

    def _event(self, kind: int, sequence: int, payload: bytes, now: float) -> Event | None:
        if kind == Kind.WELCOME and len(payload) >= 4 and payload[:3] == b"cnc":
            self.heard_at = now
            return self._welcome(sequence, payload)
        if kind in (Kind.ACK, Kind.NAK) and len(payload) >= 3:
            self.heard_at = now
            self._acknowledged(sequence, payload[0], payload[1] | payload[2] << 8, now)
            if kind == Kind.NAK and self._flying and now - self._sent_again_at >= TURN_S:
                self._send_again(now)
            return None
        if kind == Kind.STATUS and len(payload) >= 31:
            self.heard_at = now
            return self._status(sequence, payload, now)
        return None

    def _welcome(self, sequence: int, payload: bytes) -> Welcome:
        """Return the welcome; of another version only the number, as the format may differ."""
        welcome = Welcome(payload[3])
        if payload[3] == VERSION and len(payload) >= 13:
            axes, tick_ns, room, least, state, knows_position = struct.unpack_from(
                "<BHHHBB", payload, 4
            )
            welcome = Welcome(
                payload[3],
                axes,
                tick_ns,
                room,
                least,
                State(min(state, State.TOUCHED)),
                bool(knows_position),
                fourth_limit=len(payload) > 13 and bool(payload[13] & FOURTH_LIMIT),
            )
            if self.welcome is None:
                self._next, self.state = sequence, welcome.state
        self.welcome = welcome
        if self._request is not None and self._request[0] == NO_TOKEN:
            self._request = None
        return welcome

    def _status(self, token: int, payload: bytes, now: float) -> Status:
        (
            expected,
            state,
            room,
            alarm,
            knows_position,
            inputs,
            taken,
            left,
            *position,
            holds,
            resumes,
        ) = struct.unpack_from("<BBHBBBIh4iBB", payload)
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
            bool(knows_position),
            inputs,
            taken,
            board_ms,
            tuple(position),
            holds,
            resumes,
        )

    def _acknowledged(self, expected: int, state: int, room: int, now: float) -> None:
        """Remove the frames before ``expected``; ignore a number outside those in flight."""
        if state <= State.TOUCHED:
            self.state = State(state)
        arrived = (expected - self._flying[0].sequence) % 256 if self._flying else 0
        if arrived <= len(self._flying):
            self._room = room
            for _ in range(arrived):
                done = self._flying.popleft()
                self._promised_ms = done.promise_ms
                self.confirmed_note = done.note or self.confirmed_note
                self._moved_at = now

    def _send_again(self, now: float) -> None:
        for data in self._flying:
            self._out += data.encoded
            self.resent += len(data.encoded)
        self._moved_at = self._sent_again_at = now

    def _send_request(self, now: float) -> None:
        if self._request is not None:
            self._out += self._request[1]
            self._requested_at = now
