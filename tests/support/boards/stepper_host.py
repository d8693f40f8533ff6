"""A host of the stepper board by `firmware/PROTOCOL.md`, byte by byte.

It may send wrong, late or foreign bytes.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from cnc.boards.stepper.protocol import Kind, frame, unframed
from tests.support.boards.stepper_simulator import Simulator

IDLE, RUNNING, RAMPING, ALARM, TOUCHED = range(5)
NO_ALARM, UNDERRUN, SILENCE, EMERGENCY_STOP, LIMIT, STOPPED_BY_HOST, BAD_STREAM = range(7)
END_OF_STREAM = bytes((0, 0x0C))
"""The command that means nothing, with the end flag."""


@dataclass(frozen=True)
class Said:
    """A status, field by field."""

    token: int
    next: int
    state: int
    room: int
    alarm: int
    known: int
    inputs: int
    taken: int
    left: int
    position: tuple[int, ...]
    holds: int
    resumes: int


class Host:
    """Sends the given bytes, and waits 5 ms of the board's time for the answer."""

    def __init__(self, simulator: Simulator) -> None:
        self.simulator = simulator
        self.frames: list[tuple[int, int, bytes]] = []
        self.rest = b""
        self.token = 0
        self.sequence = 0

    def hear(self, seconds: float = 0.005) -> list[tuple[int, int, bytes]]:
        self.simulator.run(seconds)
        *whole, self.rest = (self.rest + self.simulator.received()).split(b"\0")
        found = [unframed(each) for each in whole if each]
        assert None not in found
        self.frames += [each for each in found if each is not None]
        return [each for each in found if each is not None]

    def said(self, data: bytes) -> Said | None:
        """Send bytes and return the last status of the answer, or None."""
        self.simulator.send(data)
        statuses = [each for each in self.hear() if each[0] == Kind.STATUS]
        if not statuses:
            return None
        _, token, payload = statuses[-1]
        following, state, room, alarm, known, inputs, taken, left, *position, holds, resumes = (
            struct.unpack("<BBHBBBIh4iBB", payload)
        )
        return Said(
            token,
            following,
            state,
            room,
            alarm,
            known,
            inputs,
            taken,
            left,
            tuple(position),
            holds,
            resumes,
        )

    def ask(self) -> Said:
        answer = self.said(b"\0" + frame(Kind.ASK, 0))
        assert answer is not None
        return answer

    def request(self, kind: Kind, payload: bytes = b"") -> bool:
        """Return whether the board has carried out the request."""
        self.token = self.token % 255 + 1
        answer = self.said(frame(kind, self.token, payload))
        return answer is not None and answer.token == self.token

    def configure(self, **changes: int) -> bool:
        known = {
            "pulse": 10,
            "setup": 10,
            "ramp": 60,
            "limits": 7,
            "inverted": 0,
            "drivers": 0,
            **changes,
        }
        return self.request(Kind.CONFIGURE, bytes(known.values()))

    def stand_at(self, *position: int) -> bool:
        return self.request(
            Kind.SET_POSITION, struct.pack("<4i", *position, *[0] * (4 - len(position)))
        )

    def stream(self, data: bytes, until_ms: int, end: bool = True) -> None:
        for at in range(0, len(data), 40):
            last = at + 40 >= len(data)
            promise = until_ms | (0x8000 if end and last else 0)
            self.simulator.send(
                frame(Kind.DATA, self.sequence, promise.to_bytes(2, "little") + data[at : at + 40])
            )
            self.sequence = (self.sequence + 1) % 256
            self.hear(0.002)


def straight(slots: int, ticks: int, axes: int = 1, down: int = 0, end: bool = False) -> bytes:
    """Return an even segment: a number of steps of some axes, ticks apart."""
    return (
        bytes((slots, 4 * end | down << 4))
        + (ticks << 8).to_bytes(3, "little")
        + bytes((0, 0, axes))
    )


def outputs(bits: int, duty: int = 0) -> bytes:
    return bytes((2, 0x18, bits, duty))


def arm(which: int, level: int) -> bytes:
    return bytes((2, 0x28, which, level))
