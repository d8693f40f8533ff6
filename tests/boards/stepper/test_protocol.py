"""The stepper board's protocol without a board: frames as documented, and a stream that survives
line faults.
"""

from __future__ import annotations

import random
import re
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.boards.pulse_board import crc16
from cnc.boards.stepper.protocol import (
    HELLO_SEQUENCE,
    MAX_FRAME,
    MAX_IN_FLIGHT,
    VERSION,
    Alarm,
    Kind,
    State,
    Status,
    StepperLink,
    Welcome,
    frame,
    unframed,
)
from tests.support.paths import ROOT
from tests.support.soak import share


def test_crc_equals_the_check_value_of_the_catalogue() -> None:
    """The check value of CRC-16/MCRF4XX in the catalogue of parametrised CRC algorithms."""
    assert crc16(b"123456789") == 0x6F91


def by_bits(data: bytes) -> int:
    """Return the CRC of x^16 + x^12 + x^5 + 1, bit by bit, lowest bit first."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
    return crc


@given(st.binary(max_size=60))
def test_crc_equals_polynomial_division(data: bytes) -> None:
    assert crc16(data) == by_bits(data)
    assert crc16(data + crc16(data).to_bytes(2, "little")) == 0


@given(st.integers(0, 255), st.integers(0, 255), st.binary(max_size=50))
def test_frames_decode_and_have_one_zero(kind: int, sequence: int, payload: bytes) -> None:
    data_sent = frame(kind, sequence, payload)
    assert data_sent.index(0) == len(data_sent) - 1
    assert unframed(data_sent[:-1]) == (kind, sequence, payload)


@given(st.binary(min_size=0, max_size=50), st.data())
def test_changed_frame_is_rejected(payload: bytes, data: st.DataObject) -> None:
    data_sent = bytearray(frame(1, 7, payload)[:-1])
    at = data.draw(st.integers(0, len(data_sent) - 1))
    data_sent[at] ^= data.draw(st.integers(1, 255))
    if 0 not in data_sent:
        assert unframed(bytes(data_sent)) is None


@given(st.binary(max_size=80))
def test_random_bytes_raise_nothing(data: bytes) -> None:
    link = StepperLink()
    link.receive(data, 0.0)
    unframed(data)


def test_hello_has_no_bytes_that_grbl_obeys() -> None:
    """It has no real-time command (GRBL 1.1, "Real-time Commands": ! ~ ? Ctrl-X, 0x80 and above)
    and no line end.
    """
    link = StepperLink()
    link.hello(0.0)
    data_sent = link.outgoing(0.0)
    assert frame(Kind.HELLO, HELLO_SEQUENCE, bytes((VERSION,))) in data_sent
    assert not set(data_sent) & (set(b"!~?\x18\r\n$") | set(range(0x80, 0x100)))


def test_welcome_of_another_version_has_only_its_number() -> None:
    link = StepperLink()
    assert link.receive(frame(Kind.WELCOME, 0, b"cnc\x09"), 0.0) == [Welcome(9)]


def test_bytes_of_another_board_are_kept() -> None:
    link = StepperLink()
    link.receive(b"\r\nGrbl 1.1h ['$' for help]\r\n", 0.0)
    assert b"Grbl 1.1h" in link.foreign_bytes
    assert link.heard_at is None


class ModelBoard:
    """The board's side of PROTOCOL.md.

    It takes frames in order, has a small buffer, and plays slowly.
    """

    def __init__(self, room: int, pace: int) -> None:
        self.room, self.pace = room, pace
        self.taken = bytearray()
        self.held = 0
        self.expected = 0
        self.naked = False
        self.incoming = bytearray()
        self.worst = 0

    def receive(self, data: bytes) -> bytes:
        self.incoming += data
        answers = b""
        while 0 in self.incoming:
            part, _, rest = bytes(self.incoming).partition(b"\0")
            self.incoming[:] = rest
            if not part:
                continue
            found = unframed(part) if len(part) <= MAX_FRAME else None
            if found is None or found[0] != Kind.DATA:
                answers += self.nak()
            else:
                ahead = (found[1] - self.expected) % 256
                if ahead == 0:
                    self.expected = (self.expected + 1) % 256
                    self.naked = False
                    self.taken += found[2][2:]
                    self.held += len(found[2]) - 2
                    self.worst = max(self.worst, self.held)
                    answers += self.says(Kind.ACK)
                elif ahead >= 128:
                    answers += self.says(Kind.ACK)
                else:
                    answers += self.nak()
        return answers

    def nak(self) -> bytes:
        if self.naked:
            return b""
        self.naked = True
        return self.says(Kind.NAK)

    def plays(self) -> bytes:
        self.held = max(0, self.held - self.pace)
        return self.says(Kind.ACK)

    def says(self, kind: Kind) -> bytes:
        return frame(
            kind,
            self.expected,
            bytes((State.RUNNING,)) + (self.room - self.held).to_bytes(2, "little"),
        )


def spoilt(data: bytes, chance: float, dice: random.Random) -> bytes:
    out = bytearray()
    for byte in data:
        fate = dice.random()
        out += (
            b""
            if fate < chance
            else bytes((byte ^ 1 << dice.randrange(8),))
            if fate < 2 * chance
            else bytes((byte,))
        )
        if fate > 1 - chance:
            out.append(byte)
    return bytes(out)


@pytest.mark.parametrize("chance", [0.0, 0.001, 0.01][:: share(1, 2)])
@pytest.mark.parametrize("seed", range(share(10, 3)))
def test_stream_arrives_complete_and_in_order(chance: float, seed: int) -> None:
    dice = random.Random(seed)
    link, board = StepperLink(), ModelBoard(room=200, pace=30)
    stream = dice.randbytes(6000)
    link.receive(
        frame(Kind.WELCOME, 0, b"cnc" + bytes((VERSION, 3, 0xF4, 1, 200, 0, 36, 0, 0, 1))), 0.0
    )
    board.expected = 0
    link.receive(board.says(Kind.ACK), 0.0)
    sent = 0
    now = 0.0
    while link.unconfirmed or sent < len(stream):
        now += 0.002
        assert now < 100, "it does not get on"
        if link.unsent < 100 and sent < len(stream):
            size = dice.randrange(1, 90)
            link.stream(stream[sent : sent + size], 0)
            sent = min(sent + size, len(stream))
        out = link.outgoing(now)
        assert len(out) <= 2 * MAX_IN_FLIGHT
        back = board.receive(spoilt(out, chance, dice))
        link.receive(spoilt(back, chance, dice), now)
        link.receive(spoilt(board.plays(), chance, dice), now)
    assert bytes(board.taken) == stream
    assert board.worst <= 200
    assert (link.resent == 0) == (chance == 0.0)


def test_status_contains_all_fields() -> None:
    link = StepperLink()
    link.request(Kind.RUN, b"", 0.0)
    payload = (
        bytes((0, State.ALARM, 1020 & 255, 1020 >> 8, Alarm.LIMIT, 1, 0x12))
        + (70_000).to_bytes(4, "little")
        + b"\0\0"
    )
    payload += b"".join(
        each.to_bytes(4, "little", signed=True) for each in (1, -2, 300_000, 0)
    ) + bytes((3, 250))
    [said] = link.receive(frame(Kind.STATUS, 1, payload), 0.1)
    assert said == Status(
        1, State.ALARM, Alarm.LIMIT, True, 0x12, 70_000, None, (1, -2, 300_000, 0), 3, 250
    )
    assert not link.requesting


# ----------------------------------------------------------------------
# the page

FIRMWARE = ROOT / "firmware"
PAGE = (FIRMWARE / "PROTOCOL.md").read_text()
ROWS = {
    name: (int(number, 16), fields)
    for number, name, fields in re.findall(r"^\| (0x\w+) (\w+) \| \w+ \| (.*?) \|", PAGE, re.M)
}


def size(fields: str) -> int:
    """Return the bytes of a payload as documented: each field is followed by its length."""
    total = 0
    for field in re.sub(r" \(\w+\)", "", fields).split(", "):
        name, _, length = field.partition(" ")
        total += len(name) - 2 if name.startswith('"') else 16 if length == "4 x 4" else int(length)
    return total


def counted(enumeration: str) -> dict[str, int]:
    """Return the names of a C enumeration with their consecutive numbers."""
    number, found = -1, {}
    for each in enumeration.split(","):
        name, _, value = each.partition("=")
        number = int(value, 16) if value else number + 1
        found[name.strip()] = number
    return found


def test_documented_types_are_those_of_both_sides() -> None:
    told = {name: number for name, (number, _) in ROWS.items()}
    assert told == {kind.name: kind.value for kind in Kind}
    in_c = re.findall(r"enum \{ ((?:DATA|ACK) .*?) \}", (FIRMWARE / "link.c").read_text())
    assert told == {name: number for each in in_c for name, number in counted(each).items()}


@pytest.mark.parametrize(
    ("name", "form"),
    [
        ("STATUS", "<BBHBBBIh4iBB"),
        ("WELCOME", "<3sBBHHHBBB"),
        ("CONFIGURE", "<6B"),
        ("ACK", "<BH"),
        ("DATA", "<H"),
    ],
)
def test_documented_lengths_are_those_of_the_code(name: str, form: str) -> None:
    assert size(ROWS[name][1].replace(", stream 0 to 40", "")) == struct.calcsize(form)


@pytest.mark.parametrize(("word", "known"), [("state", State), ("alarm", Alarm)])
def test_documented_numbers_are_those_of_the_code(
    word: str, known: type[State] | type[Alarm]
) -> None:
    sentence = re.search(rf"\b{word}: (0 [^.]*)\.", PAGE, re.S)
    assert sentence is not None
    assert [int(number) for number in re.findall(r"\b(\d) [a-z]", sentence[1])] == [
        each.value for each in known
    ]
    in_c = counted(
        re.search(
            rf"enum {{ ({'IDLE' if word == 'state' else 'NO_ALARM'}.*?) }}",
            (FIRMWARE / "board.h").read_text(),
        )[1]
    )
    assert list(in_c.values()) == [each.value for each in known]
    assert [name.removesuffix("_ALARM") if word == "alarm" else name for name in in_c][1:] == [
        each.name for each in known
    ][1:]
