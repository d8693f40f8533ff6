"""Klipper's protocol without a board: integers, blocks, and the dictionary."""

from __future__ import annotations

import contextlib
import json
import random
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.boards.klipper import protocol
from cnc.boards.klipper.protocol import (
    MAX_CONTENTS,
    MAX_LENGTH,
    Block,
    BlockReader,
    Dictionary,
    LocalError,
    MessageFormat,
    RemoteError,
    block_bytes,
)
from cnc.boards.pulse_board import crc16

SIZES = [
    (-32, 95, 1),
    (-4096, 12287, 2),
    (-524288, 1572863, 3),
    (-67108864, 201326591, 4),
    (-2147483648, 4294967295, 5),
]
"""Table of Klipper's documentation (Protocol, "Variable Length Quantities")."""


@pytest.mark.parametrize(("least", "most", "size"), SIZES)
def test_integers_have_the_documented_sizes(least: int, most: int, size: int) -> None:
    assert len(protocol.encode(least)) == len(protocol.encode(most)) == size
    if size < 5:
        assert len(protocol.encode(least - 1)) == len(protocol.encode(most + 1)) == size + 1


@given(st.integers(protocol.LEAST, protocol.MOST))
def test_integers_survive(value: int) -> None:
    data = protocol.encode(value)
    found, end = protocol.decode(data + b"\xff", 0)
    assert end == len(data)
    assert protocol.unsigned(found) == protocol.unsigned(value)
    assert protocol.signed(found) == protocol.signed(value)


def firmware_bytes(value: int) -> bytes:
    """Return an integer as 32-bit code encodes it: 5 bytes have no sign above bit 31."""
    bits, parts = value & 0xFFFFFFFF, 1
    signed = (bits ^ 0x80000000) - 0x80000000
    while parts < 5 and not -(1 << 7 * parts - 2) <= signed < 3 << 7 * parts - 2:
        parts += 1
    return bytes((bits >> 7 * k) & 0x7F | (0x80 if k else 0) for k in reversed(range(parts)))


@given(st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1))
def test_integers_of_32_bit_code_keep_their_sign(signed: int, unsigned: int) -> None:
    known = MessageFormat.parse("place pos=%i clock=%u", 5)
    data = known.head + firmware_bytes(signed) + firmware_bytes(unsigned)
    message, end = known.decode(data, 1)
    assert end == len(data)
    assert message.values == {"pos": signed, "clock": unsigned}


@pytest.mark.parametrize("number", [-32, -1, 95, 96, 12287])
def test_message_numbers_may_be_negative_or_of_two_bytes(number: int) -> None:
    text = "place pos=%i"
    known = Dictionary({"commands": {text: number}, "responses": {text: number}})
    data = known.encode("place", pos=-7)
    assert len(data) == (3 if number > 95 else 2)
    assert next(known.decode_responses(data))["pos"] == -7


@pytest.mark.parametrize("value", [2**32, -(2**31) - 1])
def test_integers_of_more_than_32_bits_are_refused(value: int) -> None:
    with pytest.raises(LocalError):
        protocol.encode(value)


@pytest.mark.parametrize("data", [b"", b"\x81", b"\x80" * 6])
def test_integers_without_end_are_refused(data: bytes) -> None:
    with pytest.raises(RemoteError):
        protocol.decode(data, 0)


def test_block_has_the_documented_form() -> None:
    data = block_bytes(18, b"ab")
    assert data[:2] == bytes((7, 0x12))
    assert data[2:4] == b"ab"
    assert int.from_bytes(data[4:6], "big") == crc16(data[:4])
    assert data[6] == 0x7E


def test_too_long_contents_are_refused() -> None:
    assert len(block_bytes(0, bytes(MAX_CONTENTS))) == MAX_LENGTH
    with pytest.raises(LocalError):
        block_bytes(0, bytes(MAX_CONTENTS + 1))


contents = st.binary(max_size=MAX_CONTENTS)


@given(st.lists(st.tuples(st.integers(0, 15), contents)), st.randoms())
def test_blocks_are_found_in_any_pieces(
    blocks: list[tuple[int, bytes]], chance: random.Random
) -> None:
    data = b"".join(b"\x7e" * chance.randint(0, 2) + block_bytes(*each) for each in blocks)
    reader, found = BlockReader(), []
    at = 0
    while at < len(data):
        end = at + chance.randint(1, 70)
        found += reader.receive(data[at:end])
        at = end
    assert found == [Block(*each) for each in blocks]
    assert reader.damaged == 0


@given(st.binary(max_size=300))
def test_any_bytes_are_read_without_a_fault(data: bytes) -> None:
    reader = BlockReader()
    reader.receive(data)
    # Whatever came before, blocks are found again after at most the length of a block.
    found = reader.receive(block_bytes(3, b"again") * 20)
    assert Block(3, b"again") in found


@given(st.integers(0, 15), contents, st.data())
def test_damaged_blocks_are_not_taken(sequence: int, body: bytes, data: st.DataObject) -> None:
    good = block_bytes(sequence, body)
    at = data.draw(st.integers(0, len(good) - 1))
    bad = bytearray(good)
    bad[at] ^= data.draw(st.integers(1, 255))
    assert Block(sequence, body) not in BlockReader().receive(bytes(bad))


CONTENT = {
    "version": "v1",
    "commands": {"queue_step oid=%c interval=%u count=%hu add=%hi": 7, "get_clock": 9},
    "responses": {"clock clock=%u": 4, "spi_transfer_response oid=%c response=%*s": 5},
    "output": {"The value of %u is %s with size %u.": 30},
    "config": {"CLOCK_FREQ": 16000000, "MCU": "atmega328p"},
    "enumerations": {"pin": {"PC0": [16, 8], "ADC_TEMPERATURE": 254}, "spi_bus": {"spi": 0}},
}


def dictionary() -> Dictionary:
    return Dictionary.of(zlib.compress(json.dumps(CONTENT).encode()))


def test_dictionary() -> None:
    known = dictionary()
    assert known.version == "v1"
    assert known.constant("CLOCK_FREQ") == 16e6
    assert known.constants["MCU"] == "atmega328p"
    assert known.number("pin", "PC0") == 16
    assert known.number("pin", "PC7") == 23
    assert known.number("pin", "PC8") is None
    assert known.number("pin", "ADC_TEMPERATURE") == 254
    assert known.parameters("queue_step") == {"oid", "interval", "count", "add"}


def test_command_bytes() -> None:
    """Integers of Klipper's documented encoding, computed by hand."""
    data = dictionary().encode("queue_step", oid=7, interval=7458, count=10, add=331)
    assert data == bytes((7, 7, 0x80 | 7458 >> 7, 7458 & 0x7F, 10, 0x80 | 331 >> 7, 331 & 0x7F))


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("no_such", {}),
        ("queue_step", {"oid": 1, "interval": 1, "count": 1}),
        ("queue_step", {"oid": 1, "interval": 1, "count": 1, "add": 1, "more": 1}),
        ("queue_step", {"oid": 256, "interval": 1, "count": 1, "add": 1}),
        ("queue_step", {"oid": 1, "interval": -1, "count": 1, "add": 1}),
        ("queue_step", {"oid": 1, "interval": 1, "count": 65536, "add": 1}),
        ("queue_step", {"oid": 1, "interval": 1, "count": 1, "add": 32768}),
        ("queue_step", {"oid": 1, "interval": 1, "count": 1, "add": b"1"}),
    ],
)
def test_wrong_commands_are_our_fault(name: str, values: dict[str, int]) -> None:
    with pytest.raises(LocalError):
        dictionary().encode(name, **values)


def test_responses() -> None:
    known = dictionary()
    both = known.encode_response("clock", clock=2**32 - 1) + known.encode_response(
        "spi_transfer_response", oid=3, response=b"\x00\x7e"
    )
    clock, spi = known.decode_responses(both)
    assert clock["clock"] == 2**32 - 1
    assert spi.data("response") == b"\x00\x7e"
    assert [each.name for each in known.decode_responses(bytes((30, 1, 2, 3)))] == [""]


@pytest.mark.parametrize("data", [b"\x40", b"\x04", b"\x05\x01\x09ab", b"\x04\x81"])
def test_wrong_responses_are_their_fault(data: bytes) -> None:
    with pytest.raises(RemoteError):
        list(dictionary().decode_responses(data))


@given(st.binary(max_size=59))
def test_any_response_is_read_or_refused(data: bytes) -> None:
    with contextlib.suppress(RemoteError):
        list(dictionary().decode_responses(data))


@pytest.mark.parametrize(
    "content",
    [
        b"no zlib",
        zlib.compress(b"no json"),
        zlib.compress(b"[]"),
        zlib.compress(b'{"commands": {"a b=%q": 3}}'),
        zlib.compress(b'{"commands": 3}'),
        zlib.compress(b'{"commands": {"": 3}}'),
        zlib.compress(b'{"enumerations": {"pin": {"PA0": ["x", 3]}}}'),
    ],
)
def test_malformed_dictionaries_are_their_fault(content: bytes) -> None:
    with pytest.raises(RemoteError):
        Dictionary.of(content)


KINDS = {"%u": (0, 2**32 - 1), "%i": (-(2**31), 2**31 - 1), "%hu": (0, 65535), "%c": (0, 255)}


@given(st.lists(st.sampled_from([*KINDS, "%*s", "%.*s", "%s"]), max_size=6), st.data())
def test_messages_survive(kinds: list[str], data: st.DataObject) -> None:
    text = "name" + "".join(f" p{k}={kind}" for k, kind in enumerate(kinds))
    values = {
        f"p{k}": data.draw(st.integers(*KINDS[kind]) if kind in KINDS else st.binary(max_size=9))
        for k, kind in enumerate(kinds)
    }
    known = MessageFormat.parse(text, 12)
    encoded = known.encode(values)
    message, end = known.decode(encoded, 1)
    assert end == len(encoded)
    assert message.values == values
